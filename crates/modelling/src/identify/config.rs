//! What to fit, and what is refused.

use super::bank::Family;
use super::thresholds::MOST_EQUATIONS;
use crate::physics::Kind;
use recording::Recording;

/// Where the thresholds come from.
#[derive(Clone, Debug, PartialEq)]
pub enum Thresholds {
    /// So many, evenly from zero to just below half the input's span.
    Grid(usize),
    /// These, in the input's unit.
    Given(Vec<f64>),
    /// At most so many, free.
    Free(usize),
}

/// A number that is given or found from the data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Choice {
    /// This value.
    Given(f64),
    /// The one that fits best.
    Auto,
}

/// What to fit.
#[derive(Clone, Debug, PartialEq)]
pub struct FitConfig {
    /// Kind of model.
    pub kind: Kind,
    /// Thresholds of the play operators.
    pub thresholds: Thresholds,
    /// Play or stop operators; both are tried when absent.
    pub family: Option<Family>,
    /// Rest input in the input's unit; when absent 0 for pressure, else the median of the recordings' first inputs.
    pub rest_input: Option<f64>,
    /// Seconds at the start of each recording that do not count.
    pub skip_s: f64,
    /// Whether each recording has a constant of its own; the model gets their mean.
    pub offsets: bool,
    /// Dead time of the input path in s.
    pub dead_time_s: Choice,
    /// Time constant of the input path's lag in s.
    pub lag_time_constant_s: Choice,
    /// Segments of the modified model's curve.
    pub curve_segments: usize,
    /// Samples that thresholds are searched on, at most: of more, every so many-th. Weights and intervals are always those of all.
    pub most_equations: usize,
}

impl Default for FitConfig {
    /// Up to twelve free thresholds, nothing else assumed.
    fn default() -> Self {
        Self {
            kind: Kind::PrandtlIshlinskii,
            thresholds: Thresholds::Free(12),
            family: None,
            rest_input: None,
            skip_s: 0.0,
            offsets: false,
            dead_time_s: Choice::Given(0.0),
            lag_time_constant_s: Choice::Given(0.0),
            curve_segments: 8,
            most_equations: MOST_EQUATIONS,
        }
    }
}

/// Why data cannot be identified.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what each field is")]
pub enum IdentifyError {
    /// No data.
    #[error("there are no recordings to identify from; give at least one")]
    NoData,
    /// Different quantities or units.
    #[error("{path}: measures {found}, the first recording measures {wanted}; give recordings of one kind")]
    Mixed { path: String, found: String, wanted: String },
    /// Different sample periods.
    #[error(
        "{path}: has a sample period of {found_s} s, the first recording of {wanted_s} s; dead time and lag need one period, resample or leave them out"
    )]
    Periods { path: String, found_s: f64, wanted_s: f64 },
    /// Nothing left after skipping.
    #[error("only {left} samples are left after skipping {skip_s} s of each recording, {wanted} are wanted; skip less or record longer")]
    TooFew { left: usize, skip_s: f64, wanted: usize },
    /// A signal that never moves.
    #[error("the {channel} never changes: hysteresis cannot be seen in it; check the columns, or excite the actuator")]
    Still { channel: &'static str },
    /// A setting that makes no sense.
    #[error("{0}")]
    Setting(String),
}

/// How many operators a fit may have.
pub(super) fn operators(config: &FitConfig) -> usize {
    match &config.thresholds {
        Thresholds::Grid(count) | Thresholds::Free(count) => *count,
        Thresholds::Given(thresholds) => thresholds.len(),
    }
}

/// Checks settings and that the recordings go together; returns the first.
pub(super) fn check<'a>(recordings: &'a [Recording], config: &FitConfig) -> Result<&'a Recording, IdentifyError> {
    let setting = |text: &str| Err(IdentifyError::Setting(text.to_owned()));
    if operators(config) == 0 || operators(config) > 200 {
        return setting("1 to 200 operators are possible; change --operators, --free-thresholds or --thresholds");
    }
    if let Thresholds::Given(given) = &config.thresholds {
        if given.iter().any(|&threshold| !(threshold.is_finite() && threshold >= 0.0)) {
            return setting("a threshold is negative or not finite; give zero or positive numbers to --thresholds");
        }
        if given.windows(2).any(|pair| pair[1] <= pair[0]) {
            return setting("the thresholds do not ascend; sort them and leave out doubles");
        }
    }
    if !(config.skip_s.is_finite() && config.skip_s >= 0.0) || config.rest_input.is_some_and(|rest| !rest.is_finite()) {
        return setting("--skip-s must be zero or positive and --rest-input finite");
    }
    if config.curve_segments == 0 || config.curve_segments > 100 {
        return setting("1 to 100 curve segments are possible");
    }
    let timed = config.dead_time_s != Choice::Given(0.0) || config.lag_time_constant_s != Choice::Given(0.0);
    for time in [config.dead_time_s, config.lag_time_constant_s] {
        if matches!(time, Choice::Given(time_s) if !(time_s.is_finite() && time_s >= 0.0)) {
            return setting("dead time and lag must be zero or positive times, or `auto`");
        }
    }
    let Some(first) = recordings.first() else { return Err(IdentifyError::NoData) };
    for recording in recordings {
        let path = recording.path.display().to_string();
        if !recording.more_inputs.is_empty() {
            return setting("these recordings have several inputs, this model has one; `catheter fit` takes them all");
        }
        let kind = |recording: &Recording| format!("{} -> {}", recording.input_signal.column(), recording.output_signal.column());
        if kind(recording) != kind(first) {
            return Err(IdentifyError::Mixed { path, found: kind(recording), wanted: kind(first) });
        }
        if timed && (recording.sample_period_s / first.sample_period_s - 1.0).abs() > 0.02 {
            return Err(IdentifyError::Periods { path, found_s: recording.sample_period_s, wanted_s: first.sample_period_s });
        }
    }
    Ok(first)
}

pub(super) fn method(config: &FitConfig, family: Family) -> String {
    let operators = match family {
        Family::Play => "play",
        Family::Stop => "stop",
    };
    let thresholds = match &config.thresholds {
        Thresholds::Grid(count) => format!("{count} thresholds on an even grid"),
        Thresholds::Given(given) => format!("{} given thresholds", given.len()),
        Thresholds::Free(count) if config.kind == Kind::ModifiedPrandtlIshlinskii => {
            format!(
                "at most {count} free thresholds or some of {} on an even grid, a curve of {} segments",
                2 * count,
                config.curve_segments
            )
        }
        Thresholds::Free(count) => format!("at most {count} free thresholds by variable projection"),
    };
    let offsets = if config.offsets { ", a constant for each recording" } else { "" };
    format!(
        "non-negative least squares over {operators} operators, {thresholds}, first {} s of each recording skipped{offsets}",
        config.skip_s
    )
}
