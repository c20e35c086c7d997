//! The feedback: a PID on the displacement error, in mm of correction, one step a window of the decimation filter.
//!
//! Terms. The **correction** is added to the displacement that the feed-forward is asked for, so the gains do not depend on which
//! feed-forward is used: proportional gain in mm/mm, integral gain in 1/s, derivative gain in s. The derivative acts on the error behind a
//! first-order filter. The integral stops where it would push the correction further into its limit, or while the limiter behind holds
//! the output back and the error pushes on (conditional integration; K. J. Astrom, T. Hagglund, *PID Controllers*, 2nd ed., section 3.5).

/// Gains and limits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PidConfig {
    /// Correction per error, mm/mm.
    pub proportional: f32,
    /// Correction rate per error, 1/s.
    pub integral_per_s: f32,
    /// Correction per error rate, s.
    pub derivative_s: f32,
    /// Time constant of the derivative's filter, s.
    pub derivative_filter_s: f32,
    /// Largest correction, mm.
    pub limit_mm: f32,
}

/// A PID, ready to run; it needs no building.
pub type Pid = PidConfig;

/// Integral and filter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PidState {
    integral_mm: f32,
    filtered_error_mm: Option<f32>,
    correction_mm: f32,
}

impl PidState {
    /// The correction in force, mm.
    pub fn correction_mm(&self) -> f32 {
        self.correction_mm
    }

    /// Goes on from this correction as if it had been there for long.
    pub fn start(&mut self, correction_mm: f32) {
        *self = Self { integral_mm: correction_mm, filtered_error_mm: None, correction_mm };
    }

    /// No measurement this time: the correction stays, and the derivative begins afresh when the sensor is back.
    pub fn hold(&mut self) {
        self.filtered_error_mm = None;
    }
}

impl PidConfig {
    /// One step: reference less measurement in mm, `period_s` after the last one; gives the correction in mm.
    ///
    /// `limited` says that the output could not follow the last demand.
    ///
    /// # Deadline
    /// No loops.
    pub fn step(&self, state: &mut PidState, error_mm: f32, period_s: f32, limited: bool) -> f32 {
        let last_mm = state.filtered_error_mm.unwrap_or(error_mm);
        let share = period_s / (period_s + self.derivative_filter_s);
        let filtered_mm = last_mm + share * (error_mm - last_mm);
        let rate_mm_per_s = (filtered_mm - last_mm) / period_s;
        state.filtered_error_mm = Some(filtered_mm);

        let integral_mm = state.integral_mm + self.integral_per_s * period_s * error_mm;
        let direct_mm = self.proportional * error_mm + self.derivative_s * rate_mm_per_s;
        let wanted_mm = direct_mm + integral_mm;
        let correction_mm = wanted_mm.max(-self.limit_mm).min(self.limit_mm);
        // Winding up means: the correction is held back and the error pushes it on in the same direction.
        let held_back = correction_mm != wanted_mm && (wanted_mm > 0.0) == (error_mm > 0.0);
        let pushes_on = limited && (state.correction_mm > 0.0) == (error_mm > 0.0);
        if !held_back && !pushes_on {
            state.integral_mm = integral_mm.max(-self.limit_mm).min(self.limit_mm);
        }
        state.correction_mm = if correction_mm.is_finite() { correction_mm } else { state.correction_mm };
        state.correction_mm
    }
}
