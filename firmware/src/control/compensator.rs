//! Feed-forward by the inverse of the physics: what pressure takes the tip along the reference.
//!
//! ```text
//! reference, dead time and smoothing ahead ─► inverse hysteresis, creep, curve, threshold ─► w, the muscle's pressure
//! w ─► three short means ─► w, dw/dt, d2w/dt2 ─► inverse of both lags ─► demand
//!          modelled actuator, driven by the output in force ─► memory of the operators, pressures behind the lags
//! ```
//!
//! The memory is that of the modelled actuator under the output that the limiter let through, not under the demand. So a saturated or
//! slewing output does not spoil it, and what the muscle then lacks is made up for: the demand also closes the gap between the
//! modelled and the wanted pressure with a time constant of [`CATCH_UP_S`].

use hysteresis::play;
use model_export::compensation::Compensation;
use model_export::schema::MAX_PLAY;
use model_export::validate::Invalid;

use super::actuator::{Actuator, ActuatorState, TICK_S};
use crate::number::round_to_i32;

/// Length of each of the three means that make derivatives of the wanted pressure, ticks.
const MEAN_TICKS: usize = 12;
/// The same as a number.
const MEAN_TICKS_F32: f32 = 12.0;
/// Delay of the three means together, ticks: half of 3 x 11, rounded up, and one for the way to the valve.
const DELAY_TICKS: u16 = 18;
/// Time constant with which the demand closes the gap to the wanted pressure, s.
pub const CATCH_UP_S: f32 = 0.04;
/// Time constant with which the way from another law's pressure to the wanted one is made, s.
const HAND_OVER_S: f32 = 0.2;

/// The inverses of an actuator, ready to run; immutable.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Compensator {
    actuator: Actuator,
    dead_time_ticks: u16,
}

/// The memory of a [`Compensator`].
#[derive(Clone, Debug, PartialEq)]
pub struct CompensatorState {
    actuator: ActuatorState,
    /// Play operators of the plain inverse, mm.
    plain_mm: [f32; MAX_PLAY],
    means: [Mean; 3],
    rate_bar_per_s: f32,
    smooth_bar: f32,
    started: bool,
    /// Whether it takes over from another law, and what is left of the way from there, bar.
    takes_over: bool,
    gap_bar: f32,
    modelled: ModelledTip,
}

/// Windows that the modelled tip is kept for: the longest dead time in windows of 10 ms.
const KEPT_WINDOWS: usize = 32;

/// Where the modelled actuator had the tip: means over windows, the newest first.
#[derive(Clone, Debug, Default, PartialEq)]
struct ModelledTip {
    means_mm: [f32; KEPT_WINDOWS],
    sum_mm: f32,
    ticks: u16,
}

impl ModelledTip {
    fn step(&mut self, tip_mm: f32, window_begins: bool) {
        if window_begins && self.ticks > 0 {
            let mut newer = self.sum_mm / f32::from(self.ticks);
            for mean_mm in &mut self.means_mm {
                core::mem::swap(mean_mm, &mut newer);
            }
            (self.sum_mm, self.ticks) = (0.0, 0);
        }
        self.sum_mm += tip_mm;
        self.ticks = self.ticks.saturating_add(1);
    }

    /// The mean over a window this many windows ago, between two of them by a straight line.
    fn ago(&self, windows: f32) -> Option<f32> {
        // Counted down: there are at most as many windows as are kept, and it needs no cast.
        let (mut index, mut rest) = (0, windows);
        while rest >= 1.0 && index < KEPT_WINDOWS {
            index += 1;
            rest -= 1.0;
        }
        let (younger, older) = (self.means_mm.get(index)?, self.means_mm.get(index + 1)?);
        Some(younger + rest * (older - younger))
    }
}

/// A moving mean.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Mean {
    values: [f32; MEAN_TICKS],
    oldest: usize,
}

impl Mean {
    const fn at(value: f32) -> Self {
        Self { values: [value; MEAN_TICKS], oldest: 0 }
    }

    fn step(&mut self, value: f32) -> f32 {
        if let Some(slot) = self.values.get_mut(self.oldest) {
            *slot = value;
        }
        self.oldest = if self.oldest + 1 < MEAN_TICKS { self.oldest + 1 } else { 0 };
        // Summed anew each time: a running sum would drift.
        self.values.iter().sum::<f32>() / MEAN_TICKS_F32
    }
}

impl Default for CompensatorState {
    fn default() -> Self {
        Self {
            actuator: ActuatorState::default(),
            plain_mm: [0.0; MAX_PLAY],
            means: [Mean::at(0.0); 3],
            rate_bar_per_s: 0.0,
            smooth_bar: 0.0,
            started: false,
            takes_over: false,
            gap_bar: 0.0,
            modelled: ModelledTip::default(),
        }
    }
}

impl CompensatorState {
    /// Forgets everything, in place.
    pub fn clear(&mut self) {
        let Self { actuator, plain_mm, means, rate_bar_per_s, smooth_bar, started, takes_over, gap_bar, modelled } = self;
        actuator.clear();
        plain_mm.fill(0.0);
        *means = [Mean::at(0.0); 3];
        (*rate_bar_per_s, *smooth_bar, *started) = (0.0, 0.0, false);
        (*takes_over, *gap_bar) = (false, 0.0);
        modelled.means_mm.fill(0.0);
        (modelled.sum_mm, modelled.ticks) = (0.0, 0);
    }

    /// The next wanted pressure begins from where the actuator is; its memory stays. One that takes over from another law leaves there slowly.
    pub fn start(&mut self, takes_over: bool) {
        (self.started, self.takes_over) = (false, takes_over);
    }
}

impl Compensator {
    /// Builds the inverses.
    ///
    /// # Errors
    /// When a parameter is out of its domain.
    pub fn new(mut parameters: Compensation) -> Result<Self, Invalid> {
        let mut compensator = Self::default();
        compensator.rebuild(&mut parameters)?;
        Ok(compensator)
    }

    /// As [`Self::new`], over inverses that are there already, whose parameters are left behind instead.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn rebuild(&mut self, parameters: &mut Compensation) -> Result<(), Invalid> {
        self.actuator.rebuild(parameters)?;
        let ticks = round_to_i32(self.actuator.parameters().dead_time_s / TICK_S);
        self.dead_time_ticks = ticks.and_then(|ticks| u16::try_from(ticks).ok()).unwrap_or(0);
        Ok(())
    }

    /// The actuator.
    pub fn actuator(&self) -> &Actuator {
        &self.actuator
    }

    /// How far ahead of now the reference must be looked at, ticks.
    pub fn look_ahead_ticks(&self) -> u16 {
        self.dead_time_ticks.saturating_add(DELAY_TICKS)
    }

    /// Tells the modelled actuator what was in force during the last tick, bar; once a tick, running or not.
    ///
    /// # Deadline
    /// Two loops over the play operators.
    pub fn follow(&self, state: &mut CompensatorState, output_bar: f32, window_begins: bool) {
        let tip_mm = self.actuator.step(&mut state.actuator, output_bar);
        state.modelled.step(tip_mm, window_begins);
    }

    /// Mean displacement of the modelled actuator over the window of `window_s` that ended last, mm: a sensor without hardware.
    pub fn modelled_mm(&self, state: &CompensatorState, window_s: f32) -> Option<f32> {
        state.modelled.ago(self.actuator.parameters().dead_time_s / window_s)
    }

    /// The demand, bar, for the displacement wanted [`Self::look_ahead_ticks`] from now, mm.
    ///
    /// # Deadline
    /// That of [`Actuator::pressure_for`] and three short means.
    pub fn demand(&self, state: &mut CompensatorState, wanted_mm: f32) -> f32 {
        let wanted_bar = self.actuator.pressure_for(&state.actuator, wanted_mm);
        if !state.started {
            let here_bar = state.actuator.muscle_bar();
            state.means = [Mean::at(here_bar); 3];
            (state.smooth_bar, state.rate_bar_per_s) = (here_bar, 0.0);
            state.gap_bar = if state.takes_over { here_bar - wanted_bar } else { 0.0 };
            state.started = true;
        }
        let wanted_bar = wanted_bar + state.gap_bar;
        state.gap_bar *= 1.0 - TICK_S / HAND_OVER_S;
        let smooth_bar = state.means.iter_mut().fold(wanted_bar, |value, mean| mean.step(value));
        let rate = (smooth_bar - state.smooth_bar) / TICK_S;
        let curvature = (rate - state.rate_bar_per_s) / TICK_S;
        (state.smooth_bar, state.rate_bar_per_s) = (smooth_bar, rate);

        let second_s = self.actuator.parameters().second_time_constant_s;
        let muscle_rate = rate + (smooth_bar - state.actuator.muscle_bar()) / CATCH_UP_S;
        let first_bar = state.actuator.muscle_bar() + second_s * muscle_rate;
        let first_rate = rate + second_s * curvature + (first_bar - state.actuator.first_bar()) / CATCH_UP_S;
        state.actuator.first_bar() + self.actuator.time_constant_s(first_rate) * first_rate
    }

    /// The pressure, bar, by the closed-form inverse of the plain Prandtl-Ishlinskii model for the displacement wanted now, mm.
    ///
    /// # Deadline
    /// One loop over the play operators.
    pub fn plain_pressure(&self, state: &mut CompensatorState, wanted_mm: f32) -> f32 {
        let parameters = self.actuator.parameters();
        let moved_mm = wanted_mm - parameters.plain_constant_mm;
        let mut demand_bar = 0.0;
        for ([threshold_mm, weight], memory) in parameters.plain_inverse.iter().zip(&mut state.plain_mm) {
            *memory = play::step(*threshold_mm, moved_mm, *memory);
            demand_bar += weight * *memory;
        }
        demand_bar
    }
}
