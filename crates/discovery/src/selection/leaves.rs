//! What a model leaves of what another missed.

use crate::data::noise;
use crate::data::session::Session;
use crate::model::structure::Model;
use crate::selection::settings::{GRID_ERROR, MOST_UNEXPLAINED, STANDS_OUT};

/// Mean square on the samples that a model was found with; masked samples count if `all`.
pub fn worked(session: &Session, residual: &[Vec<f64>], all: bool) -> f64 {
    let samples = session.runs.iter().zip(residual).flat_map(|(run, residual)| {
        residual.iter().enumerate().filter(move |&(at, _)| run.role[at].is_worked_with() && (all || run.keep[at])).map(|(_, value)| value)
    });
    let (sum, count) = samples.fold((0.0, 0.0_f64), |(sum, count), value| (sum + value * value, count + 1.0));
    sum / count.max(1.0)
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
}

/// What a model leaves of what another missed, on the samples that both were found with.
pub struct Leaves {
    /// Whether it stands out of the noise.
    pub stands_out: bool,
    share: f64,
}

impl Leaves {
    /// What `after` leaves of what `before` missed.
    pub fn new(session: &Session, before: &Model, after: &Model) -> Self {
        Self::beside(session, before, after, 0.0)
    }

    /// As [`Self::new`], beside a mean square that no model is without.
    pub fn beside(session: &Session, before: &Model, after: &Model, scatter: f64) -> Self {
        let (before, after) = (before.residuals(session), after.residuals(session));
        let floor = noise::floor(session, &after).powi(2);
        let Left { stands_out, share } = Left::new(worked(session, &before, false), worked(session, &after, false) - scatter, floor);
        Self { stands_out, share }
    }

    /// Whether that is more than may stay unexplained.
    pub fn too_much(&self) -> bool {
        self.stands_out && self.share > MOST_UNEXPLAINED
    }
}
