//! The limiter: the only way to the valve, and it believes nobody.
//!
//! Whatever the control law, the model, the host or the settings ask for, the output stays between zero and the ceiling and moves no
//! faster than the slew limits. The arithmetic is in whole microbars, so that the limits hold exactly. A demand must be renewed within its
//! time-to-live. Only venting is faster than the slew limit, and only downwards.
//!
//! The output is kept twice, plain and inverted; if the two ever disagree the memory was damaged and the output goes to zero.

use model_export::link::fault::{Fault, Notice, NoticeSet};

use crate::control::Demand;
use crate::number::{MicroBar, truncate_to_i32};
use crate::tick::TICKS_PER_S;

/// No settings raise the ceiling above this: burst pressure of the thinnest muscles in use is several times higher, and the paper's
/// excitations stay below 3 bar.
pub const ABSOLUTE_CEILING: MicroBar = MicroBar(4_000_000);

/// Limits in SI-like units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LimiterConfig {
    /// Highest pressure to ask for, bar.
    pub ceiling_bar: f32,
    /// Fastest rise, bar/s.
    pub slew_up_bar_per_s: f32,
    /// Fastest fall except venting, bar/s.
    pub slew_down_bar_per_s: f32,
    /// Ticks of 1 ms within which a demand must be renewed.
    pub output_time_to_live_ms: u16,
}

/// The limits, ready to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limiter {
    ceiling_ubar: i32,
    up_per_tick_ubar: i32,
    down_per_tick_ubar: i32,
    time_to_live_ticks: u16,
}

/// The output in force.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LimiterState {
    output_ubar: i32,
    output_inverted: i32,
    demand_ubar: i32,
    demand_age_ticks: u16,
}

/// What one step of the limiter gives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Limited {
    /// What goes to the valve.
    pub output: MicroBar,
    /// What was limited.
    pub notices: NoticeSet,
    /// Why the device must vent; the output is zero then.
    pub fault: Option<Fault>,
}

/// A limit is not a number or not positive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotALimit;

impl LimiterConfig {
    /// Builds the limits; a ceiling above [`ABSOLUTE_CEILING`] becomes that.
    ///
    /// # Errors
    /// [`NotALimit`] if a limit is not a number, negative, or a slew limit rounds down to nothing.
    pub fn build(&self) -> Result<Limiter, NotALimit> {
        // Rounded down: the built limit is never above the configured one.
        let ubar = |bar: f32| truncate_to_i32(bar * 1e6).filter(|ubar| *ubar >= 0).ok_or(NotALimit);
        let limiter = Limiter {
            ceiling_ubar: ubar(self.ceiling_bar)?.min(ABSOLUTE_CEILING.0),
            up_per_tick_ubar: ubar(self.slew_up_bar_per_s / TICKS_PER_S)?,
            down_per_tick_ubar: ubar(self.slew_down_bar_per_s / TICKS_PER_S)?,
            time_to_live_ticks: self.output_time_to_live_ms,
        };
        if limiter.up_per_tick_ubar > 0 && limiter.down_per_tick_ubar > 0 { Ok(limiter) } else { Err(NotALimit) }
    }
}

impl Default for LimiterState {
    fn default() -> Self {
        Self { output_ubar: 0, output_inverted: !0, demand_ubar: 0, demand_age_ticks: 0 }
    }
}

impl LimiterState {
    /// What goes to the valve now.
    pub fn output(&self) -> MicroBar {
        MicroBar(self.output_ubar)
    }
}

impl Limiter {
    /// The ceiling in force.
    pub fn ceiling(&self) -> MicroBar {
        MicroBar(self.ceiling_ubar)
    }

    /// Largest rise in one tick.
    pub fn up_per_tick(&self) -> MicroBar {
        MicroBar(self.up_per_tick_ubar)
    }

    /// Largest fall in one tick except venting.
    pub fn down_per_tick(&self) -> MicroBar {
        MicroBar(self.down_per_tick_ubar)
    }

    /// The output for this tick.
    ///
    /// `energised` is the supervisor's word that there may be pressure at all; without it the output is zero at once.
    ///
    /// # Deadline
    /// No loops: a few integer comparisons.
    pub fn step(&self, state: &mut LimiterState, energised: bool, demand: Demand) -> Limited {
        if !energised {
            *state = LimiterState::default();
            return Limited::default();
        }
        if state.output_inverted != !state.output_ubar {
            *state = LimiterState::default();
            return Limited { fault: Some(Fault::InternalInconsistent), ..Limited::default() };
        }
        let mut notices = NoticeSet::EMPTY;
        let fault = match demand {
            Demand::Pressure(bar) => match MicroBar::from_bar(bar).filter(|_| bar.is_finite()) {
                Some(MicroBar(ubar)) => {
                    state.demand_ubar = ubar;
                    state.demand_age_ticks = 0;
                    None
                }
                None => Some(Fault::ControlNotFinite),
            },
            Demand::Hold => {
                notices.insert(Notice::DemandHeld);
                state.demand_age_ticks = state.demand_age_ticks.saturating_add(1);
                (state.demand_age_ticks > self.time_to_live_ticks).then_some(Fault::ControlExpired)
            }
        };
        if fault.is_some() {
            *state = LimiterState::default();
            return Limited { output: MicroBar::ZERO, notices, fault };
        }
        let within = state.demand_ubar.clamp(0, self.ceiling_ubar);
        notices.insert_if(state.demand_ubar > self.ceiling_ubar, Notice::Ceiling);
        notices.insert_if(state.demand_ubar < 0, Notice::Floor);
        let lowest = state.output_ubar.saturating_sub(self.down_per_tick_ubar);
        let highest = state.output_ubar.saturating_add(self.up_per_tick_ubar);
        // `clamp` would panic on crossed bounds; these two cannot cross, and min/max need no proof of it.
        let output_ubar = within.max(lowest).min(highest).clamp(0, self.ceiling_ubar);
        notices.insert_if(output_ubar != within, Notice::Slew);
        state.output_ubar = output_ubar;
        state.output_inverted = !output_ubar;
        Limited { output: MicroBar(output_ubar), notices, fault: None }
    }
}
