//! What a model leaves of what another missed.

use crate::data::noise;
use crate::data::session::{Role, Run, Session};
use crate::model::structure::Model;
use crate::observers::law::SlipLaw;
use crate::selection::criterion::densities;
use crate::selection::settings::{GRID_ERROR, STANDS_OUT, UNEXPLAINED};
use crate::selection::switching_likelihood::QuasiStatic;
use crate::selection::switching_refits::{with_lag, without_jumps};

/// Share of samples with the largest errors that do not count: a step of the command between two samples leaves as much as the step itself in one
/// sample, whatever the model. The criterion's noise model has as many anywhere in the range.
const TRIMMED: f64 = 0.01;

/// Mean square of a normal deviate that is left when that share is taken away: `1 - 2 q f(q) / 0.99` with the 99.5 % quantile `q` and the density `f`.
const OF_A_NORMAL_DEVIATE: f64 = 0.9248;

/// Mean square on the samples that a model was found with, without the largest errors, that of a normal deviate for white noise; masked samples count if
/// `all`.
pub fn worked(session: &Session, residual: &[Vec<f64>], all: bool) -> f64 {
    let samples = session.runs.iter().zip(residual).flat_map(|(run, residual)| {
        residual.iter().enumerate().filter(move |&(at, _)| run.role[at].is_worked_with() && (all || run.keep[at])).map(|(_, value)| value)
    });
    let mut squares: Vec<f64> = samples.map(|value| value * value).collect();
    let kept = squares.len() - (TRIMMED * squares.len() as f64) as usize;
    if kept < squares.len() {
        squares.select_nth_unstable_by(kept, f64::total_cmp);
    }
    squares[..kept].iter().sum::<f64>() / (kept.max(1) as f64 * OF_A_NORMAL_DEVIATE)
}

/// Root mean square over the samples of a role in recordings that are not `in_a_gap`, or over all that are worked with when there are none; masked
/// samples count if `all`.
pub fn rmse(session: &Session, residual: &[Vec<f64>], of: Role, in_a_gap: &[bool], all: bool) -> f64 {
    let reports = |run: usize, sample: usize| session.runs[run].role[sample] == of && !in_a_gap[run];
    let any = (0..session.runs.len()).any(|run| (0..session.runs[run].role.len()).any(|sample| reports(run, sample)));
    let mut sum = 0.0;
    let mut count = 0.0_f64;
    for (index, (run, residual)) in session.runs.iter().zip(residual).enumerate() {
        for (sample, value) in residual.iter().enumerate() {
            let counts = if any { reports(index, sample) } else { run.role[sample].is_worked_with() };
            if counts && (all || run.keep[sample]) {
                sum += value * value;
                count += 1.0;
            }
        }
    }
    (sum / count.max(1.0)).sqrt()
}

/// Where something jumps: the model without it, what the best smooth observer misses one step ahead, and what the one misses that knows the jumps.
pub fn one_step_ahead(session: &Session, model: &Model, threads: usize) -> Option<(Model, [Vec<Vec<f64>>; 2])> {
    let slot = model.slots.iter().find(|slot| slot.form.jumps().is_some())?;
    let (law, _) = SlipLaw::of_parameters(slot.form.jumps()?, &slot.parameters);
    let residual = model.residuals(session);
    let smooth = with_lag(&without_jumps(model), law.drive, law.lag_s);
    let floor = noise::floor(session, &residual);
    let missed = QuasiStatic::new(session, &smooth, floor, slot.form.spec().feels_sensor).by(threads).missed_smoothly();
    Some((smooth, [missed, residual]))
}

/// What one fitted model gains over another in the log predictive density, nats per sample behind the start-up of both: where it was found, and on test
/// recordings, if there are any.
pub fn gains(session: &Session, model: &Model, over: &Model) -> [f64; 2] {
    let both = [model, over];
    let floor = both.map(|model| noise::floor(session, &model.residuals(session))).into_iter().fold(f64::MAX, f64::min);
    let start_up_s = both.map(Model::start_up_s).into_iter().fold(0.0, f64::max);
    let [own, other] = both.map(|model| densities(model, session, floor, start_up_s));
    let gain = |counts: fn(Role) -> bool| {
        let of = |run: &Run| {
            let sample_counts = |at: &usize| run.keep[*at] && run.time_s[*at] >= start_up_s && counts(run.role[*at]);
            (0..run.role.len()).filter(sample_counts).map(|at| own[run.index][at] - other[run.index][at]).collect::<Vec<f64>>()
        };
        let gained: Vec<f64> = session.runs.iter().flat_map(of).collect();
        (!gained.is_empty()).then(|| gained.iter().sum::<f64>() / gained.len() as f64)
    };
    let worked = gain(Role::is_worked_with).unwrap_or(0.0);
    [worked, gain(|role| role == Role::Test).unwrap_or(worked)]
}

/// How much of the mean square above the noise stays unexplained, from the mean squares before, after and of the noise.
pub struct Left {
    /// Whether it stands out of the noise and of what the baseline's grid leaves.
    pub stands_out: bool,
    /// As a share of what there was.
    pub share: f64,
}

impl Left {
    pub fn new(was: f64, is: f64, floor: f64) -> Self {
        let excess = |square: f64| (square - floor).max(0.0);
        let stands_out = is > STANDS_OUT * STANDS_OUT * floor && excess(is) > GRID_ERROR * GRID_ERROR;
        let share = if was > STANDS_OUT * STANDS_OUT * floor { (excess(is) / excess(was)).clamp(0.0, 1.0) } else { 0.0 };
        Self { stands_out, share }
    }

    /// What `after` leaves of what `before` missed, on the samples that both were found with, beside a mean square (`scatter`) that no model is without.
    pub fn between(session: &Session, before: &Model, after: &Model, scatter: f64) -> Self {
        let (before, after) = (before.residuals(session), after.residuals(session));
        let floor = noise::floor(session, &after).powi(2);
        Self::new(worked(session, &before, false), worked(session, &after, false) - scatter, floor)
    }

    /// Whether that is more than may stay unexplained.
    pub fn is_too_much(&self) -> bool {
        self.stands_out && self.share > UNEXPLAINED[0]
    }

    /// Whether it is more than another law of the same effect leaves.
    pub fn is_another_cause(&self) -> bool {
        self.stands_out && self.share > UNEXPLAINED[1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stays_is_by_its_share_a_forms_error_another_law_or_another_cause() {
        let floor = 0.01;
        let of = |share: f64| Left::new(1.0 + floor, share + floor, floor);
        let judged = [0.0, 0.1, 0.2, 0.3].map(|share| (of(share).is_too_much(), of(share).is_another_cause()));
        assert_eq!(judged, [(false, false), (false, false), (true, false), (true, true)]);
        // What is within the noise is no share of anything.
        assert!(!Left::new(1.2 * floor, 1.2 * floor, floor).is_another_cause());
    }
}
