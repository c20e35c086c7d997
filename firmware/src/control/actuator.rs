//! The actuator as a controller sees it: the equations of [`model_export::compensation`] in `f32` at 1 kHz, forwards and backwards.
//!
//! Backwards there is no closed form, because thresholds grow with the pressure and the curve bends the sum. But displacement rises with
//! pressure everywhere, piecewise almost straight, so Newton's method inside a bracket finds the pressure in a few steps, and the number of
//! steps is bounded.

use hysteresis::play;
use model_export::compensation::Compensation;
use model_export::schema::{MAX_CREEP, MAX_PLAY};
use model_export::validate::Invalid;

/// A tick in s.
pub const TICK_S: f32 = 0.001;
/// Most steps of Newton's method; each halves the bracket at least.
const MOST_STEPS: u8 = 24;
/// Displacement error at which Newton's method is done, mm: a tenth of the laser's resolution.
const CLOSE_MM: f32 = 1e-4;

/// Steps of Newton's method in [`hinge`].
const HINGE_STEPS: u8 = 5;

/// The actuator, ready to run; immutable.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Actuator {
    parameters: Compensation,
    hinge_at_rest_bar: f32,
}

/// Where the actuator is.
#[derive(Clone, Debug, PartialEq)]
pub struct ActuatorState {
    /// Pressure behind the first lag, bar.
    first_bar: f32,
    /// Pressure in the muscle, bar.
    muscle_bar: f32,
    plays_bar: [f32; MAX_PLAY],
    creeps_mm: [f32; MAX_CREEP],
}

impl Default for ActuatorState {
    fn default() -> Self {
        Self { first_bar: 0.0, muscle_bar: 0.0, plays_bar: [0.0; MAX_PLAY], creeps_mm: [0.0; MAX_CREEP] }
    }
}

impl ActuatorState {
    /// Forgets everything, in place.
    pub fn clear(&mut self) {
        (self.first_bar, self.muscle_bar) = (0.0, 0.0);
        self.plays_bar.fill(0.0);
        self.creeps_mm.fill(0.0);
    }

    /// Pressure behind the first lag, bar.
    pub fn first_bar(&self) -> f32 {
        self.first_bar
    }

    /// Pressure in the muscle, bar.
    pub fn muscle_bar(&self) -> f32 {
        self.muscle_bar
    }
}

impl Actuator {
    /// Builds the actuator from a blob's parameters.
    ///
    /// # Errors
    /// When a parameter is out of its domain.
    pub fn new(mut parameters: Compensation) -> Result<Self, Invalid> {
        let mut actuator = Self::default();
        actuator.rebuild(&mut parameters)?;
        Ok(actuator)
    }

    /// As [`Self::new`], over an actuator that is there already, whose parameters are left behind instead.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn rebuild(&mut self, parameters: &mut Compensation) -> Result<(), Invalid> {
        parameters.validate()?;
        core::mem::swap(&mut self.parameters, parameters);
        self.hinge_at_rest_bar = hinge(-self.parameters.touch_bar, self.parameters.touch_width_bar);
        Ok(())
    }

    /// The parameters it was built from.
    pub fn parameters(&self) -> &Compensation {
        &self.parameters
    }

    /// Time constant of the first lag in the direction of `rate`, s.
    pub fn time_constant_s(&self, rate: f32) -> f32 {
        if rate > 0.0 { self.parameters.fill_time_constant_s } else { self.parameters.vent_time_constant_s }
    }

    /// A tick at this command, bar, without the dead time; gives the displacement in mm.
    ///
    /// # Deadline
    /// Two loops over the play operators.
    pub fn step(&self, state: &mut ActuatorState, command_bar: f32) -> f32 {
        let gap_bar = command_bar - state.first_bar;
        state.first_bar += TICK_S / self.time_constant_s(gap_bar).max(TICK_S) * gap_bar;
        let second_s = self.parameters.second_time_constant_s.max(TICK_S);
        let muscle_bar = state.muscle_bar + TICK_S / second_s * (state.first_bar - state.muscle_bar);
        self.follow(state, muscle_bar)
    }

    /// A tick in which the muscle came to this pressure, bar; gives the displacement in mm.
    ///
    /// # Deadline
    /// Two loops over the play operators.
    pub fn follow(&self, state: &mut ActuatorState, muscle_bar: f32) -> f32 {
        state.muscle_bar = muscle_bar;
        let effective_bar = self.effective(muscle_bar);
        let wider = 1.0 + self.parameters.friction_per_bar * effective_bar.max(0.0);
        let mut sum_mm = 0.0;
        for ([threshold_bar, weight], memory) in self.parameters.plays.iter().zip(&mut state.plays_bar) {
            *memory = play::step(threshold_bar * wider, effective_bar, *memory);
            sum_mm += weight * *memory;
        }
        let mut creep_mm = 0.0;
        for ([time_s, gain], memory) in self.parameters.creep.iter().zip(&mut state.creeps_mm) {
            *memory += TICK_S / (TICK_S + time_s) * (sum_mm - *memory);
            creep_mm += gain * *memory;
        }
        self.curve(sum_mm + creep_mm)
    }

    /// The pressure in the muscle, bar, that brings the tip to `wanted_mm` from where it is, as near as the supply allows.
    ///
    /// # Deadline
    /// At most `MOST_STEPS` loops over the play operators; four to six as a rule.
    pub fn pressure_for(&self, state: &ActuatorState, wanted_mm: f32) -> f32 {
        let creep_mm: f32 = self.parameters.creep.iter().zip(&state.creeps_mm).map(|([_, gain], memory)| gain * memory).sum();
        let wanted_sum_mm = self.inverse_curve(wanted_mm) - creep_mm;
        let (mut low_bar, mut high_bar) = (self.effective(0.0), self.effective(self.parameters.highest_bar));
        let mut effective_bar = self.effective(state.muscle_bar).max(low_bar).min(high_bar);
        for _ in 0..MOST_STEPS {
            let (sum_mm, slope) = self.sum_and_slope(state, effective_bar);
            let error_mm = sum_mm - wanted_sum_mm;
            if error_mm.abs() <= CLOSE_MM {
                break;
            }
            if error_mm > 0.0 {
                high_bar = effective_bar;
            } else {
                low_bar = effective_bar;
            }
            let newton_bar = effective_bar - error_mm / slope;
            // Also false for what is not a number.
            let inside = newton_bar > low_bar && newton_bar < high_bar;
            effective_bar = if inside { newton_bar } else { 0.5 * (low_bar + high_bar) };
        }
        self.muscle_pressure(effective_bar)
    }

    /// The operators' sum at a pressure, and its slope there; nothing moves.
    fn sum_and_slope(&self, state: &ActuatorState, effective_bar: f32) -> (f32, f32) {
        let friction = self.parameters.friction_per_bar;
        let above_bar = effective_bar.max(0.0);
        let (mut sum_mm, mut slope) = (0.0, 0.0);
        for ([threshold_bar, weight], memory) in self.parameters.plays.iter().zip(&state.plays_bar) {
            let gap_bar = threshold_bar * (1.0 + friction * above_bar);
            let growth = if effective_bar > 0.0 { threshold_bar * friction } else { 0.0 };
            let (value, moves) = if effective_bar - gap_bar > *memory {
                (effective_bar - gap_bar, 1.0 - growth)
            } else if effective_bar + gap_bar < *memory {
                (effective_bar + gap_bar, 1.0 + growth)
            } else {
                (*memory, if gap_bar > 0.0 { 0.0 } else { 1.0 })
            };
            sum_mm += weight * value;
            slope += weight * moves;
        }
        (sum_mm, slope)
    }

    /// Displacement of the operators' sum with creep, mm.
    fn curve(&self, sum_mm: f32) -> f32 {
        let Compensation { square_per_mm, cube_per_mm2, .. } = self.parameters;
        self.parameters.constant_mm + sum_mm * (1.0 + sum_mm * (square_per_mm + sum_mm * cube_per_mm2))
    }

    /// The sum that the curve bends to `wanted_mm`.
    fn inverse_curve(&self, wanted_mm: f32) -> f32 {
        let Compensation { square_per_mm, cube_per_mm2, .. } = self.parameters;
        let straight_mm = wanted_mm - self.parameters.constant_mm;
        let mut sum_mm = straight_mm;
        // The curve is almost straight: each step squares the relative error.
        for _ in 0..5 {
            let error_mm = sum_mm * (1.0 + sum_mm * (square_per_mm + sum_mm * cube_per_mm2)) - straight_mm;
            let slope = 1.0 + sum_mm * (2.0 * square_per_mm + 3.0 * sum_mm * cube_per_mm2);
            sum_mm -= error_mm / slope.max(0.05);
        }
        sum_mm
    }

    /// The part of a muscle pressure that moves the tip, bar.
    fn effective(&self, muscle_bar: f32) -> f32 {
        hinge(muscle_bar - self.parameters.touch_bar, self.parameters.touch_width_bar) - self.hinge_at_rest_bar
    }

    /// The muscle pressure whose effective part this is, bar.
    fn muscle_pressure(&self, effective_bar: f32) -> f32 {
        let width_bar = self.parameters.touch_width_bar;
        let hinged_bar = (effective_bar + self.hinge_at_rest_bar).max(1e-6);
        let muscle_bar = self.parameters.touch_bar + hinged_bar - width_bar * width_bar / (4.0 * hinged_bar);
        muscle_bar.max(0.0).min(self.parameters.highest_bar)
    }
}

/// `(d + sqrt(d^2 + width^2)) / 2`: zero far below, `d` far above; the positive root of `h^2 - d h - width^2 / 4`.
///
/// By Newton's method, because a square root in software is larger and slower, and that of the crate `micromath` is off by up to 6 %, which
/// would be 0.08 bar here: from above the steps fall onto the root and each squares
/// the relative error, which is 0.25 at most to begin with, or twice the root far below, where one step more is needed.
fn hinge(distance_bar: f32, width_bar: f32) -> f32 {
    let quarter = 0.25 * width_bar * width_bar;
    let mut root_bar = distance_bar.max(0.0) + 0.5 * width_bar;
    for _ in 0..HINGE_STEPS {
        root_bar = (root_bar * root_bar + quarter) / (2.0 * root_bar - distance_bar);
    }
    root_bar
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hinge_is_the_root_to_the_last_places_wherever_it_is_asked() {
        for width_bar in [1e-3_f32, 0.02, 0.3, 1.0] {
            for step in -4000..=4000_i16 {
                let distance_bar = 0.005 * f32::from(step);
                let (distance, width) = (f64::from(distance_bar), f64::from(width_bar));
                let far = (distance * distance + width * width).sqrt();
                // Of two forms the one without cancellation.
                let root = if distance > 0.0 { 0.5 * (distance + far) } else { 0.5 * width * width / (far - distance) };
                let found = f64::from(hinge(distance_bar, width_bar));
                assert!((found / root - 1.0).abs() < 2e-6, "{found} instead of {root} at {distance_bar} bar, {width_bar} bar wide");
            }
        }
    }
}
