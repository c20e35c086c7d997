//! The hybrid's front end: physics identified from the training recordings, frozen before the network is trained.
//!
//! In order, each step judged by cross-validation over recordings: the *input path* (dead time and lag, a coarse grid, then a pattern
//! search), the *bank* (how many operators, how wide, play or stop type), the *thresholds* (moved freely where that pays), the
//! *creep filters* of the play sum and the *curve* that bends it. Weights are non-negative least squares on the normal equations throughout. Play type is a
//! Prandtl-Ishlinskii sum that follows its input; stop type, `L = k v + sum e_i (v - H_i) / r_i`, is a force that saturates, and
//! becomes play operators with negative weights.

use model_export::schema::{self, Feature, FeatureSource, MAX_DEAD_TIME_SAMPLES, MAX_PLAY};

use super::fit::TrainError;
use super::tracks::{Track, tracks};
use crate::identify::nnls::{Normal, solve};
use crate::identify::{Family, Rows, Run, fit_curve, free_thresholds, input_path};
use crate::network::Channel;
use crate::recording::Recording;

/// Most folds of the cross-validation.
const FOLDS: usize = 8;
/// Samples that the search for the input path looks at; longer data are thinned evenly.
const SEARCH_SAMPLES: usize = 30_000;
/// A more complex front end must lower the cross-validated error at least by this factor.
const WORTH: f64 = 0.98;
/// Mean square error, of a normalised output, below which the operators nearly explain the data.
const NEARLY_EXACT: f64 = 1e-4;
/// Mean square error, of a normalised output, below which there is nothing left to bend.
const EXACT: f64 = 1e-10;
/// Segments of the curves that are tried.
const CURVE_SEGMENTS: [usize; 2] = [3, 8];
/// Samples that the search for a curve looks at.
const CURVE_SAMPLES: usize = 4_000;
/// Free thresholds of stop operators at most.
const FREE_STOPS: usize = 4;
/// Share of all weights that a stop operator must have to stay.
const CARRIES: f64 = 0.01;
/// Share of the operators' slope below which a force does not depend on where in the range it acts.
const NO_SPRING: f64 = 0.02;
/// Free thresholds at most.
const FREE_OPERATORS: usize = 12;
/// Time constants offered for creep, in s; those too short or too long for the recordings are left out.
const CREEP_S: [f64; 3] = [0.8, 4.0, 20.0];

/// What the bank is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Play,
    Stop,
}

/// A front end being identified.
#[derive(Clone, Debug)]
struct Candidate {
    dead_time_samples: f64,
    /// Lag time constant in samples; 0 is none.
    lag_samples: f64,
    kind: Kind,
    thresholds: Vec<f64>,
    /// Creep coefficients, and the play weights that their sum is made with.
    creep: Vec<f64>,
    creep_sum: Vec<f64>,
    /// Segments of the curve that bends the sum; 0 is none.
    segments: usize,
}

/// What the training samples say about a candidate: a row of signals each.
struct Samples {
    /// Operators, path, creeps, constant.
    columns: usize,
    rows: Vec<f64>,
    outputs: Vec<f64>,
    /// The fold that each sample is left out with.
    folds: Vec<usize>,
}

/// The samples of some folds: operators and path, which a curve bends.
struct Folds<'a> {
    samples: &'a Samples,
    width: usize,
    left_out: Option<usize>,
}

impl Rows for Folds<'_> {
    fn width(&self) -> usize {
        self.width
    }

    fn visit(&self, each: &mut dyn FnMut(&[f64], f64)) {
        for (row, output, fold) in self.samples.iter() {
            if self.left_out != Some(fold) {
                each(&row[..self.width], output);
            }
        }
    }
}

impl Samples {
    fn iter(&self) -> impl Iterator<Item = (&[f64], f64, usize)> {
        self.rows.chunks_exact(self.columns).zip(&self.outputs).zip(&self.folds).map(|((row, output), fold)| (row, *output, *fold))
    }
}

/// A candidate's weights and how well it does.
#[derive(Clone, Debug)]
struct Fit {
    weights: Vec<f64>,
    input_weight: f64,
    creep_weights: Vec<f64>,
    bias: f64,
    curve: Option<schema::Curve>,
    /// Mean square error over the training samples.
    in_sample: f64,
    /// Mean square error over the folds left out; not a number where nobody judges by it.
    left_out: f64,
}

struct Data<'a> {
    recordings: &'a [Recording],
    parts: &'a [Vec<bool>],
    input: &'a Channel,
    output: &'a Channel,
    /// Half-width of the stick band in normalised output; 0 is none.
    stick_band: f32,
    /// Every how many samples the normal equations take one.
    stride: usize,
}

/// Identifies the front end from the training part of the recordings.
///
/// # Errors
/// When the recordings carry too little to identify from.
pub fn front_end(
    recordings: &[Recording],
    parts: &[Vec<bool>],
    input: &Channel,
    output: &Channel,
    sample_period_s: f64,
    sticks: bool,
) -> Result<schema::FrontEnd, TrainError> {
    let samples = parts.iter().flatten().filter(|part| **part).count();
    let stick_band = if sticks { narrow(stick_band(recordings, parts) / f64::from(output.scale)) } else { 0.0 };
    let search = Data { recordings, parts, input, output, stick_band, stride: samples.div_ceil(SEARCH_SAMPLES).max(1) };
    let all = Data { stride: 1, ..search };

    let (low, high) = normalised_range(input);
    let bank = |count: usize, width: f64| -> Vec<f64> {
        // Denser near zero, where small loops are; the widest operator is half the range times `width`.
        (1..=count).map(|i| 0.5 * (high - low) * width * (i as f64 / count as f64).powf(1.5)).collect()
    };
    let start = Candidate {
        dead_time_samples: 0.0,
        lag_samples: 0.0,
        kind: Kind::Play,
        thresholds: bank(12, 0.9),
        creep: Vec::new(),
        creep_sum: Vec::new(),
        segments: 0,
    };

    // Kind first at rest, then path, then shape: the path hardly depends on the shape, the kind hardly on the path.
    let mut best = (start.clone(), search.fit(&start)?);
    let stop = Candidate { kind: Kind::Stop, ..start };
    search.improve(&mut best, stop, WORTH)?;
    search.path(&mut best)?;
    for (count, width) in [(6, 0.9), (8, 0.5), (16, 0.9), (8, 0.25), (4, 0.25)] {
        let fewer = count < best.0.thresholds.len();
        let candidate = Candidate { thresholds: bank(count, width), ..best.0.clone() };
        search.improve(&mut best, candidate, if fewer { 1.0 } else { WORTH })?;
    }
    search.free_thresholds(&mut best)?;
    search.creep(&mut best, sample_period_s)?;
    search.refine_path(&mut best, 0.5)?;
    search.bend(&mut best, &bank(MAX_PLAY, 1.0))?;

    if best.0.kind == Kind::Stop {
        best.0.keep_carrying(&best.1);
    }
    let fit = all.weights(&best.0)?;
    Ok(schema::FrontEnd { stick_band, ..assemble(&best.0, &fit) })
}

/// Half-width of the stick band in output units, 0 when nothing sticks.
///
/// A tip that sticks gives itself away: for a good part of the time the output does not move at all, and when it moves it moves by
/// more than the band, so that small motions are missing. A coarse analogue-to-digital converter does much the same, but its motions
/// are whole steps, most of them the smallest.
fn stick_band(recordings: &[Recording], parts: &[Vec<bool>]) -> f64 {
    let mut motions = Vec::new();
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for (recording, part) in recordings.iter().zip(parts) {
        for segment in recording.segments() {
            for index in segment.skip(1).filter(|index| part[*index]) {
                // Only while the input moves: a rest of the rig is no sticking.
                if recording.input[index] != recording.input[index - 1] {
                    motions.push((recording.output[index] - recording.output[index - 1]).abs());
                }
                low = low.min(recording.output[index]);
                high = high.max(recording.output[index]);
            }
        }
    }
    motions.sort_by(f64::total_cmp);
    let count = motions.len();
    let tolerance = 1e-6 * (high - low);
    let resting = motions.partition_point(|motion| *motion <= tolerance);
    let slips = &motions[resting..];
    if count < 200 || resting < count / 10 || slips.len() < 50 {
        return 0.0;
    }
    // A few small motions may come from noise or from edges of the recordings.
    let band = slips[slips.len() / 100];
    let smaller = slips.partition_point(|motion| *motion < 0.8 * band);
    let steps = slips.partition_point(|motion| *motion < 1.01 * band);
    let sticks = band > 0.002 * (high - low) && smaller * 100 < count && steps * 5 < slips.len();
    if sticks { band } else { 0.0 }
}

fn normalised_range(channel: &Channel) -> (f64, f64) {
    let normalised = |value: f32| f64::from((value - channel.offset) / channel.scale);
    (normalised(channel.minimum), normalised(channel.maximum))
}

#[expect(clippy::cast_possible_truncation, reason = "the estimator works in f32")]
fn narrow(value: f64) -> f32 {
    value as f32
}

/// Coefficient of a first-order lag of this time constant for steps of one sample (exact for a held input).
fn coefficient(time_constant_samples: f64) -> f64 {
    if time_constant_samples > 0.0 { -(-1.0 / time_constant_samples).exp_m1() } else { 1.0 }
}

impl Candidate {
    /// Drops the stop operators that carry next to nothing. A force of friction has few; what a network does with the others on motions
    /// smaller than those it was trained on is guesswork.
    fn keep_carrying(&mut self, fit: &Fit) {
        let total: f64 = fit.weights.iter().sum();
        let mut carries = fit.weights.iter().map(|weight| *weight > CARRIES * total);
        self.thresholds.retain(|_| carries.next().unwrap_or(true));
    }

    /// Drops the operators without weight, unless that is all of them; the creep filters follow the sum of the others.
    fn drop_idle(&mut self, fit: &Fit) {
        let carrying = self.thresholds.iter().copied().zip(fit.weights.iter().copied()).filter(|(_, weight)| *weight > 0.0);
        let (thresholds, weights): (Vec<f64>, Vec<f64>) = carrying.unzip();
        if !thresholds.is_empty() {
            (self.thresholds, self.creep_sum) = (thresholds, weights);
        }
    }

    /// The front end whose features are what the fit needs: path, plays, creeps.
    fn probe(&self) -> schema::FrontEnd {
        let mut front_end = self.bare();
        let plain = |source| Feature { source, offset: 0.0, gain: 1.0 };
        let _ = front_end.features.push(plain(FeatureSource::Path));
        for index in 0..self.thresholds.len() {
            let _ = front_end.features.push(plain(FeatureSource::Play(index_u8(index))));
        }
        for index in 0..self.creep.len() {
            let _ = front_end.features.push(plain(FeatureSource::Creep(index_u8(index))));
        }
        front_end
    }

    /// Path, thresholds and creep filters, with the play weights that the creep filters are fed by.
    fn bare(&self) -> schema::FrontEnd {
        let weight = |index: usize| self.creep_sum.get(index).copied().unwrap_or(0.0);
        schema::FrontEnd {
            dead_time_samples: narrow(self.dead_time_samples),
            lag_coefficient: narrow(coefficient(self.lag_samples)),
            play_thresholds: self.thresholds.iter().map(|value| narrow(*value)).collect(),
            play_weights: (0..self.thresholds.len()).map(|index| narrow(weight(index))).collect(),
            creep_coefficients: self.creep.iter().map(|value| narrow(*value)).collect(),
            creep_weights: self.creep.iter().map(|_| 0.0).collect(),
            ..schema::FrontEnd::default()
        }
    }
}

fn index_u8(index: usize) -> u8 {
    u8::try_from(index).unwrap_or(u8::MAX)
}

impl Data<'_> {
    /// The rows of a candidate; the folds are whole recordings, or blocks where there are few.
    fn samples(&self, candidate: &Candidate) -> Result<Samples, TrainError> {
        let (n, creeps) = (candidate.thresholds.len(), candidate.creep.len());
        let columns = n + 1 + creeps + 1;
        let mut samples = Samples { columns, rows: Vec::new(), outputs: Vec::new(), folds: Vec::new() };
        let mut row = vec![1.0; columns];
        let prepared: Vec<Track> = tracks(
            self.recordings,
            self.parts,
            &schema::FrontEnd { stick_band: self.stick_band, ..candidate.probe() },
            self.input,
            self.output,
        )?;
        let alone = prepared.len() < FOLDS;
        for (number, track) in prepared.iter().enumerate() {
            let width = track.features.len() / track.len().max(1);
            for sample in (0..track.len()).step_by(self.stride) {
                // Where the tip sticks, the output says nothing exact.
                if !track.training[sample] || track.slack[sample] > 0.0 {
                    continue;
                }
                let features = &track.features[sample * width..(sample + 1) * width];
                let path = f64::from(features[0]);
                row[n] = path;
                for (index, threshold) in candidate.thresholds.iter().enumerate() {
                    let play = f64::from(features[1 + index]);
                    row[index] = match candidate.kind {
                        Kind::Play => play,
                        Kind::Stop => (path - play) / threshold,
                    };
                }
                for index in 0..creeps {
                    row[n + 1 + index] = f64::from(features[1 + n + index]);
                }
                samples.rows.extend(&row);
                samples.outputs.push(f64::from(track.output[sample]));
                samples.folds.push(if alone { sample * FOLDS / track.len() } else { number % FOLDS });
            }
        }
        if samples.outputs.len() < 10 * columns {
            return Err(TrainError::Data(format!(
                "only {} training samples: too few to identify {columns} weights of the hybrid's physics; record more or use a stream preset",
                samples.outputs.len()
            )));
        }
        Ok(samples)
    }

    /// Fits the candidate's weights, and its curve where it has one.
    fn fit(&self, candidate: &Candidate) -> Result<Fit, TrainError> {
        let samples = self.samples(candidate)?;
        let straight = straight(candidate, &samples);
        Ok(if candidate.segments == 0 {
            straight
        } else {
            Fit { left_out: left_out(candidate, &samples, &straight), ..bent(candidate, &samples, &straight) }
        })
    }

    /// The same without the judgement by the folds, which costs a curve ten times as much.
    fn weights(&self, candidate: &Candidate) -> Result<Fit, TrainError> {
        let samples = self.samples(candidate)?;
        let straight = straight(candidate, &samples);
        Ok(if candidate.segments == 0 { straight } else { bent(candidate, &samples, &straight) })
    }

    /// Takes the candidate when its cross-validated error is below `worth` times the best one's (both as root mean squares).
    fn improve(&self, best: &mut (Candidate, Fit), candidate: Candidate, worth: f64) -> Result<bool, TrainError> {
        let fit = self.fit(&candidate)?;
        let better = fit.left_out < best.1.left_out * worth * worth;
        if better {
            *best = (candidate, fit);
        }
        Ok(better)
    }

    /// Dead time and lag: a coarse grid, then a pattern search.
    fn path(&self, best: &mut (Candidate, Fit)) -> Result<(), TrainError> {
        let at_rest = best.clone();
        for lag_samples in [0.0, 1.0, 2.5, 5.0, 10.0, 20.0] {
            for dead_time_samples in [0.0, 1.0, 2.0, 4.0, 7.0, 12.0] {
                let candidate = Candidate { dead_time_samples, lag_samples, ..at_rest.0.clone() };
                self.improve(best, candidate, 1.0)?;
            }
        }
        self.refine_path(best, 2.0)?;
        // Dead time and lag are claims about the rig: they must pay.
        if best.1.left_out > at_rest.1.left_out * WORTH * WORTH {
            *best = at_rest;
        }
        Ok(())
    }

    /// Pattern search around the best path, from steps of `start` samples down.
    fn refine_path(&self, best: &mut (Candidate, Fit), start: f64) -> Result<(), TrainError> {
        if best.0.dead_time_samples == 0.0 && best.0.lag_samples == 0.0 {
            return Ok(());
        }
        let longest = MAX_DEAD_TIME_SAMPLES as f64;
        let mut step = start;
        while step > 0.02 {
            let mut moved = false;
            for (dead_time, lag) in [(step, 0.0), (-step, 0.0), (0.0, step), (0.0, -step), (step, -step), (-step, step)] {
                let candidate = Candidate {
                    dead_time_samples: (best.0.dead_time_samples + dead_time).clamp(0.0, longest),
                    lag_samples: (best.0.lag_samples + lag).max(0.0),
                    ..best.0.clone()
                };
                moved |= self.improve(best, candidate, 1.0)?;
            }
            if !moved {
                step *= 0.5;
            }
        }
        Ok(())
    }

    /// Lets the thresholds go where they fit best, where that pays; elsewhere a grid serves the network as well.
    fn free_thresholds(&self, best: &mut (Candidate, Fit)) -> Result<(), TrainError> {
        let candidate = &best.0;
        let (family, count) = match candidate.kind {
            Kind::Play if best.1.in_sample > NEARLY_EXACT => return Ok(()),
            Kind::Play => (Family::Play, FREE_OPERATORS),
            // Few operators in their right places carry over to motions that were not recorded.
            Kind::Stop => (Family::Stop, FREE_STOPS),
        };
        let mut runs = Vec::new();
        let mut samples = 0;
        for (recording, part) in self.recordings.iter().zip(self.parts) {
            for segment in recording.segments() {
                // Only the beginning of a run, up to what is for validation: the operators need their past.
                let length = part[segment.clone()].iter().take_while(|part| **part).count();
                let segment = segment.start..segment.start + length;
                if samples < SEARCH_SAMPLES && length > 0 {
                    let scaled = |value: f64, channel: &Channel| (value - f64::from(channel.offset)) / f64::from(channel.scale);
                    let input: Vec<f64> = recording.input[segment.clone()].iter().map(|value| scaled(*value, self.input)).collect();
                    samples += input.len();
                    runs.push(Run {
                        input: input_path(&input, candidate.dead_time_samples, coefficient(candidate.lag_samples)),
                        output: recording.output[segment].iter().map(|value| scaled(*value, self.output)).collect(),
                        skip: 0,
                    });
                }
            }
        }
        if runs.is_empty() {
            return Ok(());
        }
        let (low, high) = normalised_range(self.input);
        let mut thresholds = free_thresholds(&runs, family, count, 0.5 * (high - low));
        // The operator of threshold zero is the path itself, which has its own weight.
        thresholds.retain(|threshold| *threshold > 0.0);
        if thresholds.is_empty() {
            return Ok(());
        }
        let candidate = Candidate { thresholds, creep: Vec::new(), creep_sum: Vec::new(), ..candidate.clone() };
        let worth = if candidate.kind == Kind::Stop { 1.0 / WORTH } else { 1.0 };
        self.improve(best, candidate, worth)?;
        Ok(())
    }

    /// Offers a curve behind the sum. Creep then carries no weight of its own and is left to the network, which sees the filters. The
    /// operators that suit a straight sum may have been bent to stand in for the curve, so a fine grid is offered too.
    fn bend(&self, best: &mut (Candidate, Fit), grid: &[f64]) -> Result<(), TrainError> {
        if best.1.in_sample < EXACT {
            return Ok(());
        }
        let samples = self.parts.iter().flatten().filter(|part| **part).count();
        let thinned = Self { stride: samples.div_ceil(CURVE_SAMPLES).max(self.stride), ..*self };
        let mut chosen = (best.0.clone(), thinned.fit(&best.0)?);
        for thresholds in [best.0.thresholds.clone(), grid.to_vec()] {
            for segments in CURVE_SEGMENTS {
                let mut candidate = Candidate { segments, thresholds: thresholds.clone(), ..best.0.clone() };
                let fit = thinned.fit(&candidate)?;
                // What carries nothing goes: it would only be one more signal for the network to misread.
                candidate.drop_idle(&fit);
                thinned.improve(&mut chosen, candidate, WORTH)?;
            }
        }
        if chosen.0.segments > 0 {
            *best = chosen;
        }
        Ok(())
    }

    /// Offers creep filters of the play sum, one after another.
    fn creep(&self, best: &mut (Candidate, Fit), sample_period_s: f64) -> Result<(), TrainError> {
        if best.0.kind == Kind::Stop {
            return Ok(());
        }
        let longest = self.recordings.iter().map(Recording::len).max().unwrap_or(0);
        for time_constant_s in CREEP_S {
            let samples = time_constant_s / sample_period_s;
            // Too fast to tell from the operators, or too slow to have been seen to settle.
            if samples < 10.0 || 4.0 * samples > longest as f64 {
                continue;
            }
            let mut candidate = best.0.clone();
            candidate.creep.push(coefficient(samples));
            candidate.creep_sum = best.1.weights.clone();
            let mut fit = self.fit(&candidate)?;
            // The filters follow the sum whose weights they change: two passes settle it.
            for _ in 0..2 {
                candidate.creep_sum = fit.weights.clone();
                fit = self.fit(&candidate)?;
            }
            if fit.left_out < best.1.left_out * WORTH * WORTH {
                *best = (candidate, fit);
            }
        }
        Ok(())
    }
}

/// The weights of the linear sum, by non-negative least squares.
fn straight(candidate: &Candidate, samples: &Samples) -> Fit {
    let (n, columns) = (candidate.thresholds.len(), samples.columns);
    let mut folds = vec![Normal::new(columns); FOLDS];
    for (row, output, fold) in samples.iter() {
        folds[fold].add(row, output);
    }
    folds.iter_mut().for_each(Normal::complete);
    let total = Normal::sum(&folds, columns);
    let bounded: Vec<bool> = (0..columns).map(|index| index != columns - 1 && (index != n || candidate.kind == Kind::Play)).collect();
    let solution = |normal: &Normal| solve(&normal.gram, &normal.right, &bounded);
    let x = solution(&total);
    let mut left_out = 0.0;
    for out in 0..FOLDS {
        let rest = Normal::sum(folds.iter().enumerate().filter(|(index, _)| *index != out).map(|(_, fold)| fold), columns);
        left_out += folds[out].residual_square(&solution(&rest));
    }
    let rows = total.rows as f64;
    Fit {
        weights: x[..n].to_vec(),
        input_weight: x[n],
        creep_weights: x[n + 1..columns - 1].to_vec(),
        bias: x[columns - 1],
        curve: None,
        in_sample: total.residual_square(&x) / rows,
        left_out: left_out / rows,
    }
}

/// Where the search for weights behind a curve starts: the weights without one.
fn start(straight: &Fit) -> Vec<f64> {
    straight.weights.iter().copied().chain([straight.input_weight.max(0.0)]).collect()
}

/// The weights behind the best curve.
fn bent(candidate: &Candidate, samples: &Samples, straight: &Fit) -> Fit {
    let n = candidate.thresholds.len();
    let all = fit_curve(&Folds { samples, width: n + 1, left_out: None }, &start(straight), candidate.segments);
    Fit {
        curve: all.curve.dead_zones(all.constant, 0.0, 1.0),
        weights: all.weights[..n].to_vec(),
        input_weight: all.weights[n],
        creep_weights: vec![0.0; candidate.creep.len()],
        bias: 0.0,
        in_sample: all.squared_residual / samples.outputs.len() as f64,
        left_out: f64::NAN,
    }
}

/// Mean square error of a curve and its weights on the folds left out.
fn left_out(candidate: &Candidate, samples: &Samples, straight: &Fit) -> f64 {
    let start = start(straight);
    let mut sum = 0.0;
    for out in 0..FOLDS {
        let folds = Folds { samples, width: candidate.thresholds.len() + 1, left_out: Some(out) };
        let bent = fit_curve(&folds, &start, candidate.segments);
        for (row, output, _) in samples.iter().filter(|(.., fold)| *fold == out) {
            let signal: f64 = bent.weights.iter().zip(row).map(|(weight, signal)| weight * signal).sum();
            sum += (output - bent.constant - bent.curve.at(signal)).powi(2);
        }
    }
    sum / samples.outputs.len() as f64
}

/// The front end with its weights, and everything that may help the network as features.
fn assemble(candidate: &Candidate, fit: &Fit) -> schema::FrontEnd {
    let mut front_end = candidate.bare();
    let (weights, input_weight): (Vec<f64>, f64) = match candidate.kind {
        Kind::Play => (fit.weights.clone(), fit.input_weight),
        Kind::Stop => {
            let slopes: Vec<f64> = fit.weights.iter().zip(&candidate.thresholds).map(|(weight, threshold)| weight / threshold).collect();
            (slopes.iter().map(|slope| -slope).collect(), fit.input_weight + slopes.iter().sum::<f64>())
        }
    };
    front_end.play_weights = weights.iter().map(|value| narrow(*value)).collect();
    front_end.input_weight = narrow(input_weight);
    // The creep filters were fitted behind `creep_sum`, which settled on these weights.
    front_end.creep_weights = fit.creep_weights.iter().map(|value| narrow(*value)).collect();
    front_end.bias = narrow(fit.bias);
    front_end.curve = fit.curve.clone();

    // A friction force without a spring beside it is the same anywhere in the range: then the network must not see where it is.
    let slope: f64 = fit.weights.iter().zip(&candidate.thresholds).map(|(weight, threshold)| weight / threshold).sum();
    let anywhere = candidate.kind == Kind::Stop && fit.input_weight.abs() < NO_SPRING * slope;
    let mut sources = vec![FeatureSource::InputDifference];
    if !anywhere {
        sources.push(FeatureSource::Input);
    }
    if candidate.dead_time_samples > 0.0 || candidate.lag_samples > 0.0 {
        sources.push(FeatureSource::PathDifference);
        if !anywhere {
            sources.push(FeatureSource::Path);
        }
    }
    sources.extend((0..candidate.thresholds.len()).map(|index| FeatureSource::Stop(index_u8(index))));
    sources.push(FeatureSource::Readout);
    sources.extend((0..candidate.creep.len()).map(|index| FeatureSource::Creep(index_u8(index))));
    // Offset and gain are set from the data afterwards.
    front_end.features = sources.into_iter().map(|source| Feature { source, offset: 0.0, gain: 1.0 }).collect();
    front_end
}
