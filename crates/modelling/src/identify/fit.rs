//! The fit itself.

use super::bank::{self, Family, Run};
use super::config::{FitConfig, IdentifyError, Thresholds, check, method, operators};
use super::start::{best_family, counted_range, default_rest, input_path_of, runs, time_constant};
use super::thresholds::Found;
use super::{curve, intervals, thresholds};
use crate::physics::{ChannelRange, CreepFilters, Curve, FORMAT_VERSION, InputPath, Kind, PhysicsModel, Provenance, Source, range};
use recording::Recording;

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
    /// Free thresholds were searched on each so many-th sample; 1 where on all.
    pub searched_every: usize,
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
    let searched_every = if matches!(config.thresholds, Thresholds::Free(_)) { thresholds::every(&runs, config.most_equations) } else { 1 };
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
        stages: crate::physics::Stages::default(),
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
    Ok(Fit { model, rmse, nrmse, max_abs, family, interval_widening: intervals.widening, curve_slopes, searched_every })
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
