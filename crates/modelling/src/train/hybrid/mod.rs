//! The hybrid's front end: physics identified from the training recordings, frozen before the network is trained.
//!
//! In order, each step judged by cross-validation over recordings: the *input path* (dead time and lag, a coarse grid, then a pattern
//! search), the *bank* (how many operators, how wide, play or stop type), the *thresholds* (moved freely where that pays), the
//! *creep filters* of the play sum and the *curve* that bends it. Play type is a Prandtl-Ishlinskii sum that follows its input; stop
//! type, `L = k v + sum e_i (v - H_i) / r_i`, is a force that saturates, and becomes play operators with negative weights.
//!
//! Several inputs share dead time and lag; each has a bank of its own from the same shares of its range. The output may rise with one
//! input and fall with another (*falling*), which least squares with free signs tells beforehand; the sum then sees that input with its
//! sign changed. Only play type on the grid is offered to them.

mod candidate;
mod stick_band;
mod weights;

use model_export::schema::{self, MAX_DEAD_TIME_SAMPLES, MAX_FEATURES, MAX_PLAY};

use self::candidate::{Candidate, Fit, Kind, Operator, assemble, coefficient, narrow};
use self::stick_band::stick_band;
use self::weights::{FOLDS, Samples, bent, falling, left_out, straight};
use super::front_end::Channels;
use super::report::TrainError;
use super::tracks::{Track, tracks};
use crate::identify::{Family, Run, free_thresholds, input_path};
use crate::network::Channel;
use recording::Recording;

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
/// Free thresholds at most.
const FREE_OPERATORS: usize = 12;
/// Time constants offered for creep, in s; those too short or too long for the recordings are left out.
const CREEP_S: [f64; 3] = [0.8, 4.0, 20.0];

/// What a front end is identified from.
struct Data<'a> {
    recordings: &'a [Recording],
    parts: &'a [Vec<bool>],
    channels: &'a Channels,
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
    channels: &Channels,
    sample_period_s: f64,
    sticks: bool,
) -> Result<schema::FrontEnd, TrainError> {
    let samples = parts.iter().flatten().filter(|part| **part).count();
    let stick_band = if sticks { narrow(stick_band(recordings, parts) / f64::from(channels.output.scale)) } else { 0.0 };
    let search = Data { recordings, parts, channels, stick_band, stride: samples.div_ceil(SEARCH_SAMPLES).max(1) };
    let all = Data { stride: 1, ..search };

    let inputs = channels.inputs();
    let most = most_operators(inputs) / inputs;
    let bank = |count: usize, width: f64| -> Vec<Operator> {
        let mut bank = Vec::new();
        for input in 0..inputs {
            let (low, high) = normalised_range(channels.input(input));
            let count = count.min(most);
            // Denser near zero, where small loops are; the widest operator is half the range times `width`.
            let threshold = |i| 0.5 * (high - low) * width * (i as f64 / count as f64).powf(1.5);
            bank.extend((1..=count).map(|i| Operator { threshold: threshold(i), input }));
        }
        // As the schema wants them.
        bank.sort_by(|a, b| a.threshold.total_cmp(&b.threshold));
        bank
    };
    let start = Candidate {
        dead_time_samples: 0.0,
        lag_samples: 0.0,
        kind: Kind::Play,
        falling: vec![false; inputs],
        operators: bank(12, 0.9),
        creep: Vec::new(),
        creep_sum: Vec::new(),
        segments: 0,
    };

    let start = Candidate { falling: search.falling(&start)?, ..start };

    // Kind first at rest, then path, then shape: the path hardly depends on the shape, the kind hardly on the path.
    let mut best = (start.clone(), search.fit(&start)?);
    if inputs == 1 {
        let stop = Candidate { kind: Kind::Stop, ..start };
        search.improve(&mut best, stop, WORTH)?;
    }
    search.path(&mut best)?;
    for (count, width) in [(6, 0.9), (8, 0.5), (16, 0.9), (8, 0.25), (4, 0.25)] {
        let operators = bank(count, width);
        let fewer = operators.len() < best.0.operators.len();
        let candidate = Candidate { operators, ..best.0.clone() };
        search.improve(&mut best, candidate, if fewer { 1.0 } else { WORTH })?;
    }
    if inputs == 1 {
        search.free_thresholds(&mut best)?;
    }
    search.creep(&mut best, sample_period_s)?;
    search.refine_path(&mut best, 0.5)?;
    search.bend(&mut best, &bank(MAX_PLAY, 1.0))?;

    if best.0.kind == Kind::Stop {
        best.0.keep_carrying(&best.1);
    }
    let fit = all.weights(&best.0)?;
    Ok(schema::FrontEnd { stick_band, ..assemble(&best.0, &fit) })
}

/// How many operators of so many inputs have room, as operators and as features beside the inputs, their paths, readout and creep.
fn most_operators(inputs: usize) -> usize {
    MAX_PLAY.min(MAX_FEATURES - 4 * inputs - 1 - CREEP_S.len())
}

fn normalised_range(channel: &Channel) -> (f64, f64) {
    let normalised = |value: f32| f64::from((value - channel.offset) / channel.scale);
    (normalised(channel.minimum), normalised(channel.maximum))
}

impl Data<'_> {
    /// The rows of a candidate; the folds are whole recordings, or blocks where there are few.
    fn samples(&self, candidate: &Candidate) -> Result<Samples, TrainError> {
        let (n, inputs, creeps) = (candidate.operators.len(), candidate.falling.len(), candidate.creep.len());
        let columns = n + inputs + creeps + 1;
        let mut samples = Samples { columns, rows: Vec::new(), outputs: Vec::new(), folds: Vec::new() };
        let mut row = vec![1.0; columns];
        let prepared: Vec<Track> =
            tracks(self.recordings, self.parts, &schema::FrontEnd { stick_band: self.stick_band, ..candidate.probe() }, self.channels)?;
        let alone = prepared.len() < FOLDS;
        for (number, track) in prepared.iter().enumerate() {
            let width = track.features.len() / track.len().max(1);
            for sample in (0..track.len()).step_by(self.stride) {
                // Where the tip sticks, the output says nothing exact.
                if !track.training[sample] || track.slack[sample] > 0.0 {
                    continue;
                }
                let features = &track.features[sample * width..(sample + 1) * width];
                for input in 0..inputs {
                    row[n + input] = candidate.sign(input) * f64::from(features[input]);
                }
                for (index, operator) in candidate.operators.iter().enumerate() {
                    let play = candidate.sign(operator.input) * f64::from(features[inputs + index]);
                    row[index] = match candidate.kind {
                        Kind::Play => play,
                        Kind::Stop => (row[n + operator.input] - play) / operator.threshold,
                    };
                }
                for index in 0..creeps {
                    row[n + inputs + index] = f64::from(features[inputs + n + index]);
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

    /// With which inputs the output falls.
    fn falling(&self, candidate: &Candidate) -> Result<Vec<bool>, TrainError> {
        let inputs = candidate.falling.len();
        // Of one input the free weight of stop type tells.
        Ok(if inputs == 1 { vec![false] } else { falling(candidate, &self.samples(candidate)?) })
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

    /// The same without the errors of the folds, which costs a curve ten times as much.
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
                    let input: Vec<f64> =
                        recording.input[segment.clone()].iter().map(|value| scaled(*value, &self.channels.input)).collect();
                    samples += input.len();
                    runs.push(Run {
                        input: input_path(&input, candidate.dead_time_samples, coefficient(candidate.lag_samples)),
                        output: recording.output[segment].iter().map(|value| scaled(*value, &self.channels.output)).collect(),
                        skip: 0,
                    });
                }
            }
        }
        if runs.is_empty() {
            return Ok(());
        }
        let (low, high) = normalised_range(&self.channels.input);
        let mut thresholds = free_thresholds(&runs, family, count, 0.5 * (high - low));
        // The operator of threshold zero is the path itself, which has its own weight.
        thresholds.retain(|threshold| *threshold > 0.0);
        if thresholds.is_empty() {
            return Ok(());
        }
        let operators = thresholds.into_iter().map(|threshold| Operator { threshold, input: 0 }).collect();
        let candidate = Candidate { operators, creep: Vec::new(), creep_sum: Vec::new(), ..candidate.clone() };
        let worth = if candidate.kind == Kind::Stop { 1.0 / WORTH } else { 1.0 };
        self.improve(best, candidate, worth)?;
        Ok(())
    }

    /// Offers a curve behind the sum. Creep then carries no weight of its own and is left to the network, which sees the filters. The
    /// operators that suit a straight sum may have been bent to stand in for the curve, so a fine grid is offered too.
    fn bend(&self, best: &mut (Candidate, Fit), grid: &[Operator]) -> Result<(), TrainError> {
        if best.1.in_sample < EXACT {
            return Ok(());
        }
        let samples = self.parts.iter().flatten().filter(|part| **part).count();
        let thinned = Self { stride: samples.div_ceil(CURVE_SAMPLES).max(self.stride), ..*self };
        let mut chosen = (best.0.clone(), thinned.fit(&best.0)?);
        for operators in [best.0.operators.clone(), grid.to_vec()] {
            for segments in CURVE_SEGMENTS {
                let mut candidate = Candidate { segments, operators: operators.clone(), ..best.0.clone() };
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
