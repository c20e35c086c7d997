//! The suite on a known plant: it answers new signals, so every criterion compares with truth.

use anyhow::{Context, Result};

use super::plants::KnownPlant;
use super::report::{Criterion, HOLD_S, Hold, LONG_RUN, Request, SEED_OFFSET, SuiteReport, at_hold_times, largest, span};
use crate::evaluate::compare::{STRETCHES, growth, stretches};
use crate::evaluate::metrics::{mean, range, root_mean_square};
use crate::evaluate::{Errors, for_each};
use simulation::excitation::sets::{self, Named, SetConfig};
use simulation::excitation::{ExcitationConfig, Segment, Signal};

/// Levels of the holds: spread evenly over the range, none at its very ends.
const HOLDS: usize = 21;
/// Time before a hold, and before the signal that follows a random history, in s.
const HISTORY_S: f64 = 10.0;
/// Random histories before the same signal.
const HISTORIES: usize = 16;
/// Test signals of each family.
const SIGNALS: usize = 2;

struct Scene<'a> {
    request: &'a Request<'a>,
    plant: &'a KnownPlant,
    period_s: f64,
    low: f64,
    high: f64,
    seed: u64,
}

/// A prediction and the plant's answer.
struct Answer {
    predicted: Vec<f64>,
    truth: Vec<f64>,
}

impl Answer {
    fn errors(&self, from: usize) -> Vec<f64> {
        self.predicted[from..].iter().zip(&self.truth[from..]).map(|(predicted, truth)| predicted - truth).collect()
    }
}

impl Scene<'_> {
    fn play(&self, excitation: &ExcitationConfig) -> Result<Answer> {
        self.answer(&excitation.sample().context("a signal of the suite")?.pressure_bar, excitation.seed)
    }

    fn answer(&self, input: &[f64], seed: u64) -> Result<Answer> {
        let truth = self.plant.plant.simulate(input, self.period_s, seed);
        let predicted = self.request.model.predict(input, &[])?;
        Ok(Answer { predicted, truth })
    }

    fn excitation(&self, index: usize, segments: Vec<(f64, Signal)>) -> ExcitationConfig {
        ExcitationConfig {
            sample_period_s: self.period_s,
            noise_bar: 0.0,
            seed: self.seed.wrapping_add(index as u64),
            segments: segments.into_iter().map(|(duration_s, signal)| Segment { duration_s, signal }).collect(),
        }
    }

    /// Moves between random points of the range, as fast as the paper's sines, now and then resting.
    fn random_points(&self, longest_hold_s: f64, start_bar: Option<f64>, end_bar: Option<f64>) -> Signal {
        let span = self.high - self.low;
        Signal::RandomPoints {
            minimum_bar: self.low,
            maximum_bar: self.high,
            slowest_bar_per_s: 0.05 * span,
            fastest_bar_per_s: 1.2 * span,
            hold_share: 0.25,
            longest_hold_s,
            start_bar,
            end_bar,
        }
    }

    fn samples(&self, duration_s: f64) -> usize {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count of samples")]
        let count = (duration_s / self.period_s).round() as usize;
        count
    }
}

/// Adds every criterion that needs truth; gives the input of the long run.
pub(super) fn run(request: &Request<'_>, plant: &KnownPlant, report: &mut SuiteReport) -> Result<Vec<f64>> {
    let (low, high) = span(request.recordings.iter().flat_map(|recording| &recording.input)).context("no recordings")?;
    let recorded_s = request.recordings.first().context("no recordings")?.sample_period_s;
    let scene = Scene {
        request,
        plant,
        period_s: request.model.description().sample_period_s.unwrap_or(recorded_s),
        low: low.max(0.0),
        high,
        seed: request.seed.wrapping_add(SEED_OFFSET),
    };
    let output_range = families(&scene, report)?;
    holds(&scene, output_range, report)?;
    histories(&scene, output_range, report)?;
    long_run(&scene, output_range, report)
}

/// The paper's four families at full amplitude, at half amplitude and without noise; gives the range of the plant's output.
fn families(scene: &Scene<'_>, report: &mut SuiteReport) -> Result<f64> {
    // Eq. (1) reaches twice its amplitude; the noise of the paper is a twentieth of that.
    let amplitude_bar = scene.high / 2.1;
    let config = SetConfig {
        seed: scene.seed,
        amplitude_bar,
        noise_bar: 0.1 * amplitude_bar,
        sample_period_s: scene.period_s,
        tests_per_family: SIGNALS,
    };
    let kinds = [
        ("families", "", config),
        ("half-amplitude", " at half amplitude", SetConfig { amplitude_bar: 0.5 * amplitude_bar, ..config }),
        ("noise-free", " without noise on the input", SetConfig { noise_bar: 0.0, ..config }),
    ];
    let unit = &scene.request.model.description().output.unit;
    let mut output_range = 0.0;
    for (name, what, config) in kinds {
        let signals = sets::families(&config);
        let answers = for_each(&signals, scene.request.threads, |signal: &Named| {
            let answer = scene.play(&signal.excitation)?;
            let errors = Errors::between(&answer.predicted, &answer.truth);
            Ok((errors.rmse, answer.truth))
        })?;
        if name == "families" {
            let truth: Vec<f64> = answers.iter().flat_map(|(_, truth)| truth.iter().copied()).collect();
            output_range = range(&truth);
        }
        let each: Vec<f64> = answers.iter().map(|(rmse, _)| *rmse).collect();
        let value = mean(&each).unwrap_or(f64::NAN);
        let what = format!("mean RMSE on {} new signals of the paper's four families{what}", signals.len());
        report.criteria.push(Criterion::at_most(name, what, value, scene.request.limits.signals * output_range, unit));
    }
    Ok(output_range)
}

fn holds(scene: &Scene<'_>, output_range: f64, report: &mut SuiteReport) -> Result<()> {
    let levels: Vec<f64> = (0..HOLDS).map(|index| scene.low + (index as f64 + 0.5) / HOLDS as f64 * (scene.high - scene.low)).collect();
    let numbered: Vec<(usize, f64)> = levels.into_iter().enumerate().collect();
    let start = scene.samples(HISTORY_S);
    report.holds = for_each(&numbered, scene.request.threads, |&(index, level)| {
        let segments =
            vec![(HISTORY_S, scene.random_points(1.0, Some(scene.low), Some(level))), (HOLD_S, Signal::Hold { pressure_bar: level })];
        let answer = scene.play(&scene.excitation(1000 + index, segments))?;
        let errors = answer.errors(start);
        let max_abs = largest(errors.iter().copied());
        Ok(Hold { level, max_abs, errors: at_hold_times(&errors, scene.period_s) })
    })?;
    // A tip that sticks may rest anywhere within its band.
    let band = scene.plant.plant.config().stick_slip.map_or(0.0, |stick| stick.band_mm);
    let limit = scene.request.limits.hold * output_range + band;
    let worst = largest(report.holds.iter().map(|hold| hold.max_abs));
    let within = if band > 0.0 { format!(" (limit includes the stick-slip band of {band} mm)") } else { String::new() };
    let what = format!("largest error in {HOLDS} holds of {HOLD_S} s over the whole range, each after a random history{within}");
    report.criteria.push(Criterion::at_most("holds", what, worst, limit, &scene.request.model.description().output.unit));
    Ok(())
}

fn histories(scene: &Scene<'_>, output_range: f64, report: &mut SuiteReport) -> Result<()> {
    let numbers: Vec<usize> = (0..HISTORIES).collect();
    let start = scene.samples(HISTORY_S);
    let each = for_each(&numbers, scene.request.threads, |&index| {
        let signal = Signal::DescendingSine {
            amplitude_bar: 0.5 * (scene.high - scene.low),
            frequency_hz: 0.3,
            decay_per_s: 0.12,
            offset_bar: scene.low,
        };
        let segments = vec![(HISTORY_S, scene.random_points(2.0, None, Some(scene.low))), (20.0, signal)];
        let answer = scene.play(&scene.excitation(2000 + index, segments))?;
        Ok(root_mean_square(answer.errors(start)))
    })?;
    let what = format!("worst RMSE on one descending sine after {HISTORIES} random starting histories");
    let limit = 1.5 * scene.request.limits.signals * output_range;
    let worst = largest(each);
    report.criteria.push(Criterion::at_most("histories", what, worst, limit, &scene.request.model.description().output.unit));
    Ok(())
}

/// The same random moves and holds again and again: from the second pass on, nothing but the model's own drift can change its error.
fn long_run(scene: &Scene<'_>, output_range: f64, report: &mut SuiteReport) -> Result<Vec<f64>> {
    let length = LONG_RUN / STRETCHES;
    let signal = scene.random_points(30.0, Some(scene.low), Some(scene.low));
    let excitation = scene.excitation(3000, vec![(length as f64 * scene.period_s, signal)]);
    let pass = excitation.sample().context("the long run of the suite")?.pressure_bar;
    let input: Vec<f64> = pass.iter().copied().cycle().take(LONG_RUN).collect();
    let errors = scene.answer(&input, excitation.seed)?.errors(0);
    report.long_run = stretches(&errors);
    let unit = &scene.request.model.description().output.unit;
    let limit = scene.request.limits.signals * output_range;
    let what = format!("RMSE over {LONG_RUN} samples: {STRETCHES} passes of the same random moves and holds");
    report.criteria.push(Criterion::at_most("long-run", what, root_mean_square(errors.iter().copied()), limit, unit));
    let what = "growth of that error from the first to the last three passes, without the very first".to_owned();
    report.criteria.push(Criterion::at_most("long-run-growth", what, growth(&report.long_run[1..]), 0.25 * limit, unit));
    Ok(input)
}
