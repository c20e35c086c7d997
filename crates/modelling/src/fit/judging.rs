//! How a rung is judged by its predictions of what it took no part in: as they are, after a start-up calibration, and by their shape.
//!
//! Terms. *As is*: nothing is known of the recording but its inputs. *Calibrated*: the zero is set over a stated stretch at the start,
//! which does not count. *Shape*: what is left with the recording's own nuisances taken off; rungs are compared by it where the data
//! name nuisances, and nothing is promised by it.

use identification::search::{Search, errors};
use identification::{Partition, SplitKind, interval};

use super::prepare::Prepared;
use crate::evaluate::{self, Errors};
use crate::physics::Calibrated;

/// Share of the shortest recording that a start-up calibration takes at most, where none is stated.
const CALIBRATION_SHARE: f64 = 0.1;

/// What left-out predictions are worth.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// Error on each unit, as is.
    pub errors: Vec<f64>,
    /// Error on each unit with its own nuisances taken off; the same as `errors` where none are named.
    pub shape_errors: Vec<f64>,
    /// Mean of `errors`.
    pub cv_rmse: f64,
    /// Central 95 % prediction interval of the next one.
    pub cv_interval: [f64; 2],
    /// The same after a start-up calibration; absent for blocks, whose starts are no start-up.
    pub calibrated: Option<Calibrated>,
}

/// What judges.
pub struct Judging<'a> {
    /// The data.
    pub prepared: &'a Prepared,
    /// What is left out.
    pub partition: &'a Partition,
    /// The search, which knows the nuisances.
    pub search: &'a Search<'a>,
    /// Seconds at the start of each recording that set its zero.
    pub calibrate_s: f64,
}

impl Judging<'_> {
    /// Judges predictions, one list a recording.
    #[must_use]
    pub fn of(&self, predictions: &[Vec<f64>]) -> Verdict {
        let errors = errors(predictions, &self.prepared.series, self.partition);
        let named = !self.search.nuisances(&self.partition.training()).is_empty();
        let shape_errors = if named { self.search.shape_errors(predictions) } else { errors.clone() };
        let whole = self.partition.kind() != SplitKind::Blocks;
        let cv_interval = match named && whole {
            true => interval::next_with_zeros(&shape_errors, &self.zeros(predictions), Some(self.partition.folds())),
            false => self.next(&errors),
        };
        Verdict { cv_rmse: mean(&errors), cv_interval, calibrated: self.calibrated(predictions), errors, shape_errors }
    }

    /// What the next recording may bring after such errors.
    #[must_use]
    pub fn next(&self, errors: &[f64]) -> [f64; 2] {
        interval::next(errors, (self.partition.kind() != SplitKind::Blocks).then(|| self.partition.folds()))
    }

    /// Mean error of each recording, with its sign.
    fn zeros(&self, predictions: &[Vec<f64>]) -> Vec<f64> {
        let pairs = predictions.iter().zip(&self.prepared.series);
        pairs.map(|(predicted, one)| Errors::between(predicted, &one.output).mean_error).collect()
    }

    fn calibrated(&self, predictions: &[Vec<f64>]) -> Option<Calibrated> {
        if self.partition.kind() == SplitKind::Blocks {
            return None;
        }
        let pairs = self.prepared.recordings.iter().zip(predictions);
        let errors: Option<Vec<f64>> = pairs
            .map(|(recording, predicted)| {
                let first = evaluate::first_behind(recording, self.calibrate_s);
                let mut predicted = predicted.clone();
                evaluate::set_zero(&mut predicted, recording, self.calibrate_s);
                (first < recording.len()).then(|| Errors::between(&predicted[first..], &recording.output[first..]).rmse)
            })
            .collect();
        let errors = errors?;
        Some(Calibrated { calibrate_s: self.calibrate_s, rmse: mean(&errors), interval: self.next(&errors) })
    }
}

/// The start-up stretch that is stated where nobody states one: 1, 2 or 5 times a power of ten in s, a tenth of the shortest recording at
/// most, and at least one sample.
#[must_use]
pub fn calibration_s(prepared: &Prepared) -> f64 {
    let shortest = prepared.recordings.iter().map(recording::Recording::len).min().unwrap_or(0);
    let most_s = (CALIBRATION_SHARE * shortest as f64).max(1.0) * prepared.period_s;
    let decade = 10.0_f64.powf(most_s.log10().floor());
    let neat = [5.0, 2.0, 1.0].into_iter().map(|digit| digit * decade).find(|&neat| neat <= most_s * (1.0 + 1e-9)).unwrap_or(decade);
    neat.max(prepared.period_s)
}

/// Mean of some values; zero of none.
pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}
