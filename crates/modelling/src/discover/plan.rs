//! The next experiment: of many excitations that the rig may be asked for, the one that best tells two explanations apart.
//!
//! Each explanation is a model. One plays the rig, the other is fitted to what it does, parameters and weights anew; what that leaves is
//! what the experiment can see. Over `N` samples of noise `s` it adds `N d^2 / (2 s^2)` to the expected logarithm of the likelihood ratio,
//! where `d` is the root mean square left over (Box and Hill 1967). The worse of the two directions counts.

use std::path::Path;

use serde::Serialize;

use discovery::SessionError;
use discovery::file::DiscoveredModel;
use discovery::files::separation;
use recording::{Recording, RecordingError};
use simulation::excitation::{ExcitationConfig, Limits, Segment, Signal};

/// One excitation with what it is expected to tell.
#[derive(Clone, Debug, Serialize)]
pub struct Plan {
    /// What it is, in words.
    pub name: String,
    /// The excitation.
    #[serde(skip)]
    pub excitation: ExcitationConfig,
    /// Root mean square by which the explanations differ when the other one is fitted, output units; the smaller of both directions.
    pub difference: f64,
    /// Expected logarithm of the likelihood ratio.
    pub log_likelihood_ratio: f64,
}

/// What can go wrong.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// Models of different rigs.
    #[error("the two models are of different signals ({first} and {second}); give two models that `catheter discover` wrote of one rig")]
    Different {
        /// Signals of the first.
        first: String,
        /// Signals of the second.
        second: String,
    },
    /// A model cannot be run.
    #[error("a model cannot be run: {0}")]
    Model(String),
    /// No excitation of the list fits the limits.
    #[error("no excitation fits the rig's limits; is the range of pressure or the fastest change next to nothing?")]
    NoneFits,
    /// A simulated recording makes no sense.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A simulated session makes no sense.
    #[error(transparent)]
    Session(#[from] SessionError),
}

/// Length of an experiment, s.
const DURATION_S: f64 = 40.0;

/// Excitations of many kinds that fill the rig's range and keep its limits, each begun with two seconds of rest.
#[must_use]
pub fn library(limits: &Limits, sample_period_s: f64, seed: u64) -> Vec<(String, ExcitationConfig)> {
    let (minimum_bar, maximum_bar) = (limits.minimum_bar, limits.maximum_bar);
    let range_bar = maximum_bar - minimum_bar;
    // A sine of the whole range is fastest in its middle: pi f range. A tenth is left in hand.
    let fastest_hz = 0.9 * limits.maximum_slew_bar_per_s / (std::f64::consts::PI * range_bar);
    let highest_hz = (0.1 / sample_period_s).min(6.0);
    let rise_s = (1.1 * range_bar / limits.maximum_slew_bar_per_s).max(2.0 * sample_period_s);
    let level = |share: f64| minimum_bar + share * range_bar;
    let steps: Vec<f64> = [0.0, 1.0, 0.3, 0.8, 0.1, 0.6, 0.5, 0.9, 0.0, 0.4, 0.2, 0.7, 0.0].into_iter().map(level).collect();
    let stairs: Vec<f64> = (0..=10).chain((0..10).rev()).map(|step| level(f64::from(step) / 10.0)).collect();
    let sine = |frequency_hz: f64| Signal::DescendingSine {
        amplitude_bar: 0.5 * range_bar,
        frequency_hz,
        decay_per_s: 0.04,
        offset_bar: minimum_bar,
    };
    let lines = |low_hz: f64, high_hz: f64| (0..12).map(|line| low_hz * (high_hz / low_hz).powf(f64::from(line) / 11.0)).collect();
    let kinds: Vec<(&str, Signal)> = vec![
        ("decaying sine, 0.2 Hz (as in the paper)", sine(0.2)),
        ("decaying sine, 0.8 Hz (as in the paper)", sine(0.8)),
        ("decaying sine, as fast as the rig goes", sine(fastest_hz.min(highest_hz))),
        ("steps with holds of three seconds", Signal::Staircase { levels_bar: steps, ramp_s: rise_s }),
        ("slow stairs up and down", Signal::Staircase { levels_bar: stairs, ramp_s: 0.5_f64.max(rise_s) }),
        ("slow triangle", Signal::Triangle { minimum_bar, maximum_bar, frequency_hz: 0.05 }),
        (
            "sweep to as fast as the rig goes",
            Signal::Chirp { minimum_bar, maximum_bar, frequency_start_hz: 0.1, frequency_end_hz: fastest_hz.min(highest_hz) },
        ),
        (
            "small fast sweep about the middle",
            Signal::Chirp {
                minimum_bar: level(0.4),
                maximum_bar: level(0.6),
                frequency_start_hz: 0.3,
                frequency_end_hz: (4.0 * fastest_hz).min(highest_hz),
            },
        ),
        ("multisine, slow lines", Signal::Multisine { minimum_bar, maximum_bar, frequencies_hz: lines(0.05, 0.8_f64.min(fastest_hz)) }),
        ("multisine, fast lines", Signal::Multisine { minimum_bar, maximum_bar, frequencies_hz: lines(0.2, fastest_hz.min(highest_hz)) }),
        ("first-order reversal curves", Signal::FirstOrderReversalCurves { minimum_bar, maximum_bar, reversals: 6 }),
        ("random steps and holds", Signal::RandomSteps { minimum_bar, maximum_bar, rise_s, shortest_hold_s: 0.4, longest_hold_s: 4.0 }),
    ];
    kinds
        .into_iter()
        .map(|(name, signal)| {
            let rest = Segment { duration_s: 2.0, signal: Signal::Hold { pressure_bar: minimum_bar } };
            let segments = vec![rest, Segment { duration_s: DURATION_S, signal }];
            (name.to_owned(), ExcitationConfig { sample_period_s, noise_bar: 0.0, seed, segments })
        })
        .filter(|(_, excitation)| excitation.sample_within(limits).is_ok())
        .collect()
}

/// Judges every excitation of the [`library`], the most telling first; `watch` hears how many are judged, and of how many.
///
/// # Errors
/// When the models do not belong together or cannot be run, or nothing fits the limits.
pub fn rank(
    first: &DiscoveredModel,
    second: &DiscoveredModel,
    noise: f64,
    limits: &Limits,
    seed: u64,
    watch: &dyn Fn(usize, usize),
) -> Result<Vec<Plan>, PlanError> {
    if (&first.input, &first.output) != (&second.input, &second.output) {
        let signals = |model: &DiscoveredModel| format!("{} to {}", model.input.column(), model.output.column());
        return Err(PlanError::Different { first: signals(first), second: signals(second) });
    }
    let mut plans = Vec::new();
    let library = library(limits, first.sample_period_s, seed);
    let count = library.len();
    for (index, (name, excitation)) in library.into_iter().enumerate() {
        watch(index, count);
        let Ok(samples) = excitation.sample_within(limits) else { continue };
        let one_way = left_over(first, second, &samples.time_s, &samples.pressure_bar)?;
        let other_way = left_over(second, first, &samples.time_s, &samples.pressure_bar)?;
        let difference = one_way.min(other_way);
        let log_likelihood_ratio = samples.time_s.len() as f64 * (difference / noise).powi(2) / 2.0;
        plans.push(Plan { name, excitation, difference, log_likelihood_ratio });
    }
    if plans.is_empty() {
        return Err(PlanError::NoneFits);
    }
    plans.sort_by(|x, y| y.difference.total_cmp(&x.difference));
    Ok(plans)
}

/// What fitting `pupil` to the output of `rig` leaves, root mean square in output units.
fn left_over(rig: &DiscoveredModel, pupil: &DiscoveredModel, time_s: &[f64], input: &[f64]) -> Result<f64, PlanError> {
    let output = rig.simulate(input).map_err(PlanError::Model)?;
    let recording =
        Recording::new(Path::new("simulated.csv"), rig.input.clone(), rig.output.clone(), time_s.to_vec(), input.to_vec(), output)?;
    separation::left_over(pupil, recording)?.map_err(PlanError::Model)
}
