//! Identification: physics models from recordings, by least squares with non-negative weights, with confidence intervals.
//!
//! Terms. The *bank* is a set of play operators on the input less the *rest input*, the value at which the actuator is taken to have
//! rested before the recording: eq. (2) starts its operators from zero, which is a rest input of 0 bar; a piezo that starts in the
//! middle of its range rests there. A *stop family* is a bank of stop operators, for forces of friction, which lead the motion.
//!
//! The fit is an output-error fit: the operators have no other input than the recorded one, so the error reported is that of the model
//! running freely. Recordings that start after an unknown history move the operators within their first reversals to where they
//! belong; [`FitConfig::skip_s`] keeps that time out of the fit, [`FitConfig::offsets`] fits a constant for each recording where a
//! sensor was set to zero anew.

mod bank;
pub mod choose;
mod curve;
mod intervals;
mod model;
mod thresholds;

pub use identification::{linear, nnls};

pub use bank::{Family, Run, input_path, linear_problem};
pub use curve::{Bent, Rows, fit as fit_curve};
pub use model::{ChannelRange, CreepFilters, Curve, FORMAT_VERSION, InputPath, Kind, ModelError, PhysicsModel, Provenance, Source};

use model::range;
use recording::Recording;
use thresholds::{Found, Search};

/// At most `count` thresholds, ascending and up to `largest`, that explain prepared runs best: free thresholds by variable projection.
#[must_use]
pub fn free_thresholds(runs: &[Run], family: Family, count: usize, largest: f64) -> Vec<f64> {
    Search { runs, family, sign: 1.0, offsets: false, largest, every: thresholds::every(runs) }.run(count).thresholds
}

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

/// An identified model and what the fit tells besides.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The model.
    pub model: PhysicsModel,
    /// Root mean square error over the samples that count, in the output's unit.
    pub rmse: f64,
    /// The same as a share of the output's range.
    pub nrmse: f64,
    /// Largest error.
    pub max_abs: f64,
    /// Play or stop operators.
    pub family: Family,
    /// Factor by which autocorrelated residuals widened the mean interval, against white residuals.
    pub interval_widening: f64,
    /// Slopes at the low end, the middle and the high end of the modified model's curve: equal means neither asymmetry nor saturation.
    pub curve_slopes: Option<[f64; 3]>,
}

/// Fits a physics model to recordings.
///
/// # Errors
/// When the recordings do not go together, hold too little, or never move.
pub fn fit(recordings: &[Recording], config: &FitConfig) -> Result<Fit, IdentifyError> {
    let first = check(recordings, config)?;
    let rest_input = config.rest_input.unwrap_or_else(|| default_rest(recordings));
    let period_s = first.sample_period_s;
    let (dead_time, lag) = input_path_of(recordings, config, rest_input, period_s);
    let runs = runs(recordings, config, rest_input, dead_time, lag);
    let left = bank::counted(&runs);
    let wanted = 20.max(4 * operators(config));
    if left < wanted {
        return Err(IdentifyError::TooFew { left, skip_s: config.skip_s, wanted });
    }
    let (input_low, input_high) = counted_range(&runs, |run| &run.input);
    let (output_low, output_high) = counted_range(&runs, |run| &run.output);
    if input_high <= input_low {
        return Err(IdentifyError::Still { channel: "input" });
    }
    if output_high <= output_low {
        return Err(IdentifyError::Still { channel: "output" });
    }
    // Wider plays than half the span are only ever moved by the way from rest to the first loop.
    let largest = 0.5 * (input_high - input_low);
    let starts = match (config.kind, &config.thresholds) {
        // Thresholds that are free without the curve may have been bent to stand in for it: a fine grid leaves the choice to the weights.
        // Where there is no curve to stand in for, the free ones are exact.
        (Kind::ModifiedPrandtlIshlinskii, Thresholds::Free(count)) => {
            let grid = FitConfig { thresholds: Thresholds::Grid(2 * count), ..config.clone() };
            vec![best_family(&runs, &grid, largest), best_family(&runs, config, largest)]
        }
        _ => vec![best_family(&runs, config, largest)],
    };
    let straight = |(found, family, sign): (Found, Family, f64)| Shaped {
        weights: found.coefficients[..found.thresholds.len()].iter().map(|weight| sign * weight).collect(),
        constant: match config.offsets {
            true => mean_residual(&runs, &found, family, sign),
            false => sign * found.coefficients[found.thresholds.len()],
        },
        squared_residual: found.squared_residual,
        thresholds: found.thresholds,
        family,
        curve: None,
    };
    let bent = |straight: Shaped| match config.kind {
        Kind::ModifiedPrandtlIshlinskii => straight.bend(&runs, config),
        _ => straight,
    };
    let shaped = starts.into_iter().map(|start| bent(straight(start)));
    // Of equals the first.
    let better = |one: Shaped, other: Shaped| if other.squared_residual < one.squared_residual { other } else { one };
    let Some(Shaped { thresholds, weights, constant, family, curve: shape, .. }) = shaped.reduce(better) else {
        return Err(IdentifyError::NoData);
    };
    let free = matches!(config.thresholds, Thresholds::Free(_)) && config.kind == Kind::PrandtlIshlinskii;
    let intervals = intervals::intervals(&intervals::Fitted {
        runs: &runs,
        thresholds: &thresholds,
        family,
        weights: &weights,
        constant,
        curve: shape.as_ref(),
        free_thresholds: free,
        offsets: config.offsets,
    });
    let mut model = PhysicsModel {
        format_version: FORMAT_VERSION,
        kind: config.kind,
        sample_period_s: period_s,
        rest_input,
        input_gain: 0.0,
        thresholds: Vec::new(),
        weights: Vec::new(),
        constant,
        thresholds_95: Vec::new(),
        weights_95: Vec::new(),
        constant_95: intervals.constant,
        input: channel(&first.input_signal, recordings, |recording| &recording.input),
        output: channel(&first.output_signal, recordings, |recording| &recording.output),
        input_path: InputPath { dead_time_s: dead_time * period_s, lag_time_constant_s: time_constant(lag, period_s) },
        curve: shape,
        creep: CreepFilters::default(),
        provenance: Provenance {
            program: format!("catheter {}", env!("CARGO_PKG_VERSION")),
            method: method(config, family),
            rmse: 0.0,
            nrmse: 0.0,
            samples: left,
            data: recordings.iter().map(source).collect(),
        },
        expected: None,
        nuisances: Vec::new(),
    };
    for (index, (&threshold, &weight)) in thresholds.iter().zip(&weights).enumerate() {
        let interval = intervals.weights[index];
        match family {
            Family::Play => {
                model.weights.push(weight);
                model.weights_95.push(interval);
            }
            // A stop operator is the input less a play operator; that of threshold zero stands for the input itself.
            Family::Stop => {
                model.input_gain += weight;
                if threshold == 0.0 {
                    continue;
                }
                model.weights.push(-weight);
                model.weights_95.push([-interval[1], -interval[0]]);
            }
        }
        model.thresholds.push(threshold);
        if free {
            model.thresholds_95.push(intervals.thresholds[index]);
        }
    }
    let (rmse, max_abs) = errors(&model, recordings, &runs);
    let nrmse = rmse / (output_high - output_low);
    (model.provenance.rmse, model.provenance.nrmse) = (rmse, nrmse);
    let curve_slopes = model.curve.as_ref().map(|curve| {
        let slopes = &curve.slopes;
        [slopes[0], slopes[slopes.len() / 2], slopes[slopes.len() - 1]]
    });
    Ok(Fit { model, rmse, nrmse, max_abs, family, interval_widening: intervals.widening, curve_slopes })
}

/// Operators with their weights, with or without a curve behind their sum.
struct Shaped {
    thresholds: Vec<f64>,
    weights: Vec<f64>,
    constant: f64,
    family: Family,
    curve: Option<Curve>,
    squared_residual: f64,
}

impl Shaped {
    /// Behind the best curve; operators that carry nothing go where the thresholds were ours to choose.
    fn bend(mut self, runs: &[Run], config: &FitConfig) -> Self {
        let rows = curve::BankRows { runs, thresholds: &self.thresholds, family: self.family };
        let bent = curve::fit(&rows, &self.weights, config.curve_segments);
        let kept = |index: &usize| bent.weights[*index] != 0.0 || !matches!(config.thresholds, Thresholds::Free(_));
        let kept: Vec<usize> = (0..bent.weights.len()).filter(kept).collect();
        self.thresholds = kept.iter().map(|&index| self.thresholds[index]).collect();
        self.weights = kept.iter().map(|&index| bent.weights[index]).collect();
        Self { constant: bent.constant, curve: Some(bent.curve), squared_residual: bent.squared_residual, ..self }
    }
}

/// How many operators a fit may have.
fn operators(config: &FitConfig) -> usize {
    match &config.thresholds {
        Thresholds::Grid(count) | Thresholds::Free(count) => *count,
        Thresholds::Given(thresholds) => thresholds.len(),
    }
}

/// Checks settings and that the recordings go together; returns the first.
fn check<'a>(recordings: &'a [Recording], config: &FitConfig) -> Result<&'a Recording, IdentifyError> {
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

/// Pressure rests at zero; anything else where the recordings start.
fn default_rest(recordings: &[Recording]) -> f64 {
    if recordings[0].input_signal.quantity.starts_with("pressure") {
        return 0.0;
    }
    let mut firsts: Vec<f64> = recordings.iter().map(|recording| recording.input[0]).collect();
    firsts.sort_by(f64::total_cmp);
    firsts[firsts.len() / 2]
}

fn runs(recordings: &[Recording], config: &FitConfig, rest_input: f64, dead_time: f64, lag: f64) -> Vec<Run> {
    let run = |recording: &Recording| {
        let mut input = input_path(&recording.input, dead_time, lag);
        input.iter_mut().for_each(|value| *value -= rest_input);
        let begin_s = recording.time_s[0] + config.skip_s;
        let skip = recording.time_s.partition_point(|&time_s| time_s < begin_s);
        Run { input, output: recording.output.clone(), skip }
    };
    recordings.iter().map(run).collect()
}

/// Operators of the bank that judges dead time, lag and family.
const SCOUTS: usize = 16;
/// Samples that are enough to judge them by.
const SCOUT_SAMPLES: usize = 30_000;

/// Dead time in samples and lag coefficient: given, or by turns the best of ever finer grids, judged by the residual of a bank.
fn input_path_of(recordings: &[Recording], config: &FitConfig, rest_input: f64, period_s: f64) -> (f64, f64) {
    if let (Choice::Given(dead_time_s), Choice::Given(time_constant_s)) = (config.dead_time_s, config.lag_time_constant_s) {
        return (dead_time_s / period_s, coefficient(period_s, time_constant_s));
    }
    let samples: usize = recordings.iter().map(Recording::len).sum();
    let every = samples.div_ceil(SCOUT_SAMPLES).max(1);
    let some: Vec<Recording> = recordings.iter().step_by(every).cloned().collect();
    let residual = |dead_time: f64, time_constant: f64| {
        let runs = runs(&some, config, rest_input, dead_time, coefficient(period_s, time_constant * period_s));
        let (low, high) = counted_range(&runs, |run| &run.input);
        let scout = FitConfig { thresholds: Thresholds::Grid(SCOUTS), ..config.clone() };
        if high > low { best_family(&runs, &scout, 0.5 * (high - low)).0.squared_residual } else { f64::INFINITY }
    };
    let given = |choice: Choice| match choice {
        Choice::Given(time_s) => Some(time_s / period_s),
        Choice::Auto => None,
    };
    // In samples.
    let mut dead_time = given(config.dead_time_s).unwrap_or(0.0);
    let mut time_constant = given(config.lag_time_constant_s).unwrap_or(0.0);
    let mut best = f64::INFINITY;
    for round in 0..4 {
        let step = 0.5_f64.powi(round);
        if config.lag_time_constant_s == Choice::Auto {
            let candidates: Vec<f64> = match round {
                0 => vec![0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0],
                _ => [-2.0, -1.0, 1.0, 2.0].iter().map(|k| time_constant * (1.0 + 0.25 * k * step)).collect(),
            };
            for candidate in candidates {
                let trial = residual(dead_time, candidate);
                if trial < best {
                    (best, time_constant) = (trial, candidate);
                }
            }
        }
        if config.dead_time_s == Choice::Auto {
            let centre = dead_time;
            let candidates: Vec<f64> = match round {
                0 => (0..=12).map(f64::from).collect(),
                _ => [-2.0, -1.0, 1.0, 2.0].iter().map(|k| (centre + k * step).max(0.0)).collect(),
            };
            for candidate in candidates {
                let trial = residual(candidate, time_constant);
                if trial < best {
                    (best, dead_time) = (trial, candidate);
                }
            }
        }
    }
    (dead_time, coefficient(period_s, time_constant * period_s))
}

/// The thresholds and weights of the family that fits best; play operators and a rising output win a tie.
fn best_family(runs: &[Run], config: &FitConfig, largest: f64) -> (Found, Family, f64) {
    let grid = |count: usize| -> Vec<f64> { (0..count).map(|index| largest * index as f64 / count as f64).collect() };
    let every = thresholds::every(runs);
    let search = |family, sign| Search { runs, family, sign, offsets: config.offsets, largest, every };
    let scout = grid(SCOUTS);
    let families = config.family.map_or_else(|| vec![Family::Play, Family::Stop], |family| vec![family]);
    let mut best: Option<(f64, Family, f64)> = None;
    for family in families {
        for sign in [1.0, -1.0] {
            let left = search(family, sign).project(&scout).squared_residual;
            if best.is_none_or(|(before, ..)| left < before * (1.0 - 1e-6)) {
                best = Some((left, family, sign));
            }
        }
    }
    // Note(unwrap): there is at least one family.
    let (_, family, sign) = best.expect("a family was tried");
    let search = search(family, sign);
    let found = match &config.thresholds {
        Thresholds::Grid(count) => search.project(&grid(*count)),
        Thresholds::Given(thresholds) => search.project(thresholds),
        Thresholds::Free(count) => search.run(*count),
    };
    // The weights, and what they leave, are those of all samples.
    let found = if every > 1 { Search { every: 1, ..search }.project(&found.thresholds) } else { found };
    (found, family, sign)
}

/// Mean of what the operators leave of the output, in the output's unit.
fn mean_residual(runs: &[Run], found: &Found, family: Family, sign: f64) -> f64 {
    let mut sum = 0.0;
    for run in runs {
        let mut bank = bank::Bank::new(&found.thresholds, family);
        for (index, &input) in run.input.iter().enumerate() {
            bank.step(input);
            if index >= run.skip {
                let modelled: f64 = (0..found.thresholds.len()).map(|k| found.coefficients[k] * bank.signal(k, input)).sum();
                sum += run.output[index] - sign * modelled;
            }
        }
    }
    sum / bank::counted(runs).max(1) as f64
}

/// Root mean square and largest error of the free-running model over the samples that count.
fn errors(model: &PhysicsModel, recordings: &[Recording], runs: &[Run]) -> (f64, f64) {
    let (mut squares, mut largest, mut count) = (0.0, 0.0_f64, 0);
    for (recording, run) in recordings.iter().zip(runs) {
        let simulated = model.simulate(&recording.input);
        for index in run.counted() {
            let error = simulated[index] - recording.output[index];
            squares += error * error;
            largest = largest.max(error.abs());
            count += 1;
        }
    }
    ((squares / f64::from(u32::try_from(count.max(1)).unwrap_or(u32::MAX))).sqrt(), largest)
}

fn counted_range(runs: &[Run], signal: impl Fn(&Run) -> &Vec<f64>) -> (f64, f64) {
    runs.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), run| {
        let (lowest, highest) = range(&signal(run)[run.counted()]);
        (low.min(lowest), high.max(highest))
    })
}

fn channel(signal: &recording::Signal, recordings: &[Recording], values: impl Fn(&Recording) -> &Vec<f64>) -> ChannelRange {
    let (minimum, maximum) = recordings.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), recording| {
        let (lowest, highest) = range(values(recording));
        (low.min(lowest), high.max(highest))
    });
    ChannelRange { quantity: signal.quantity.clone(), unit: signal.unit.clone(), minimum, maximum }
}

fn source(recording: &Recording) -> Source {
    // The name only: paths differ between machines, the hash does not.
    let file = recording.path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    Source { file, sha256: recording.sha256.clone(), samples: recording.len() }
}

fn method(config: &FitConfig, family: Family) -> String {
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

fn coefficient(period_s: f64, time_constant_s: f64) -> f64 {
    if time_constant_s > 0.0 { -(-period_s / time_constant_s).exp_m1() } else { 1.0 }
}

fn time_constant(coefficient: f64, period_s: f64) -> f64 {
    if coefficient < 1.0 { -period_s / (-coefficient).ln_1p() } else { 0.0 }
}

#[cfg(test)]
mod tests;
