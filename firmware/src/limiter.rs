//! The limiter: the only way to the valve, and it believes nobody.
//!
//! Whatever the control law, the model, the host or the settings ask for, the output stays between zero and the ceiling and moves no
//! faster than the slew limits. The arithmetic is in whole microbars, so that the limits hold exactly. A demand must be renewed within its
//! time-to-live. Only venting is faster than the slew limit, and only downwards.
//!
//! The output is kept twice, plain and inverted; if the two ever disagree the memory was damaged and the output goes to zero.

use model_export::link::fault::{Fault, Notice, NoticeSet};

use crate::control::Demand;
use crate::number::{MicroBar, scaled_to_i32};
use crate::time::TICKS_IN_A_SECOND;

/// No settings raise the ceiling above this: burst pressure of the thinnest muscles in use is several times higher, and the paper's
/// excitations stay below 3 bar.
pub const ABSOLUTE_CEILING: MicroBar = MicroBar(4_000_000);

/// What the limiter counts in.
const UBAR_PER_BAR: u32 = 1_000_000;

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
        // Rounded down and exact, so that the built limit is never above the configured one.
        let ubar = |bar: f32, ubar_per_bar: u32| scaled_to_i32(bar, ubar_per_bar).ok_or(NotALimit);
        let limiter = Limiter {
            ceiling_ubar: ubar(self.ceiling_bar, UBAR_PER_BAR)?.min(ABSOLUTE_CEILING.0),
            up_per_tick_ubar: ubar(self.slew_up_bar_per_s, UBAR_PER_BAR / TICKS_IN_A_SECOND)?,
            down_per_tick_ubar: ubar(self.slew_down_bar_per_s, UBAR_PER_BAR / TICKS_IN_A_SECOND)?,
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
        let within = state.demand_ubar.max(0).min(self.ceiling_ubar);
        notices.insert_if(state.demand_ubar > self.ceiling_ubar, Notice::Ceiling);
        notices.insert_if(state.demand_ubar < 0, Notice::Floor);
        let lowest = state.output_ubar.saturating_sub(self.down_per_tick_ubar);
        let highest = state.output_ubar.saturating_add(self.up_per_tick_ubar);
        // `clamp` would panic on crossed bounds; these cannot cross, and min/max need no proof of it.
        let output_ubar = within.max(lowest).min(highest).max(0).min(self.ceiling_ubar);
        notices.insert_if(output_ubar != within, Notice::Slew);
        state.output_ubar = output_ubar;
        state.output_inverted = !output_ubar;
        Limited { output: MicroBar(output_ubar), notices, fault: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn limiter() -> Limiter {
        LimiterConfig { ceiling_bar: 3.0, slew_up_bar_per_s: 20.0, slew_down_bar_per_s: 30.0, output_time_to_live_ms: 100 }.build().unwrap()
    }

    #[test]
    fn the_output_reaches_a_demand_at_the_slew_limit_and_stays_there() {
        let limiter = limiter();
        let mut state = LimiterState::default();
        let outputs: [i32; 4] = core::array::from_fn(|_| limiter.step(&mut state, true, Demand::Pressure(0.05)).output.0);
        assert_eq!(outputs, [20_000, 40_000, 50_000, 50_000]);
        let limited = limiter.step(&mut state, true, Demand::Pressure(0.0));
        assert_eq!(limited.output.0, 20_000);
        assert!(limited.notices.contains(Notice::Slew));
    }

    #[test]
    fn a_demand_above_the_ceiling_is_held_there_with_a_notice() {
        let limiter = limiter();
        let mut state = LimiterState::default();
        let last = (0..1_000).map(|_| limiter.step(&mut state, true, Demand::Pressure(f32::MAX))).last().unwrap();
        assert_eq!(last.output, limiter.ceiling());
        assert!(last.notices.contains(Notice::Ceiling) && !last.notices.contains(Notice::Floor));
    }

    #[test]
    fn a_demand_lives_for_its_time_and_not_a_tick_longer() {
        let limiter = limiter();
        let mut state = LimiterState::default();
        limiter.step(&mut state, true, Demand::Pressure(1.0));
        for tick in 1..=100 {
            assert_eq!(limiter.step(&mut state, true, Demand::Hold).fault, None, "tick {tick}");
        }
        let expired = limiter.step(&mut state, true, Demand::Hold);
        assert_eq!((expired.fault, expired.output), (Some(Fault::ControlExpired), MicroBar::ZERO));
    }

    #[test]
    fn what_is_not_a_number_and_damaged_memory_put_the_output_to_zero() {
        let limiter = limiter();
        for demand in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut state = LimiterState::default();
            limiter.step(&mut state, true, Demand::Pressure(1.0));
            let limited = limiter.step(&mut state, true, Demand::Pressure(demand));
            assert_eq!((limited.fault, limited.output), (Some(Fault::ControlNotFinite), MicroBar::ZERO));
        }
        for bit in 0..32 {
            let mut state = LimiterState::default();
            limiter.step(&mut state, true, Demand::Pressure(1.0));
            state.output_ubar ^= 1 << bit;
            let limited = limiter.step(&mut state, true, Demand::Pressure(1.0));
            assert_eq!((limited.fault, limited.output), (Some(Fault::InternalInconsistent), MicroBar::ZERO), "bit {bit}");
        }
    }

    #[test]
    fn limits_that_are_none_are_refused_and_the_absolute_ceiling_stays() {
        let good = LimiterConfig { ceiling_bar: 3.0, slew_up_bar_per_s: 20.0, slew_down_bar_per_s: 30.0, output_time_to_live_ms: 100 };
        for bad in [
            LimiterConfig { ceiling_bar: f32::NAN, ..good },
            LimiterConfig { ceiling_bar: -0.1, ..good },
            LimiterConfig { slew_up_bar_per_s: 0.0, ..good },
            LimiterConfig { slew_down_bar_per_s: f32::NAN, ..good },
            LimiterConfig { slew_up_bar_per_s: 0.0009, ..good },
        ] {
            assert_eq!(bad.build(), Err(NotALimit), "{bad:?}");
        }
        let absolute = LimiterConfig { ceiling_bar: f32::INFINITY, ..good }.build().unwrap();
        assert_eq!(absolute.ceiling(), ABSOLUTE_CEILING);
    }

    fn demand() -> impl Strategy<Value = Demand> {
        prop_oneof![
            4 => (-1.0f32..5.0).prop_map(Demand::Pressure),
            1 => any::<u32>().prop_map(|bits| Demand::Pressure(f32::from_bits(bits))),
            1 => Just(Demand::Hold),
        ]
    }

    proptest! {
        #[test]
        fn no_sequence_of_demands_leaves_ceiling_or_slew(
            steps in prop::collection::vec((prop::bool::weighted(0.97), demand()), 1..400),
            ceiling_bar in 0.0f32..6.0,
            slew_up_bar_per_s in 0.1f32..100.0,
            slew_down_bar_per_s in 0.1f32..100.0,
        ) {
            let config = LimiterConfig { ceiling_bar, slew_up_bar_per_s, slew_down_bar_per_s, output_time_to_live_ms: 100 };
            let limiter = config.build().unwrap();
            let mut state = LimiterState::default();
            let mut last = 0.0f64;
            for (energised, demand) in steps {
                let limited = limiter.step(&mut state, energised, demand);
                let output = f64::from(limited.output.0) * 1e-6;
                // In bar from the configured numbers, without the limiter's own rounding: not a microbar beyond.
                prop_assert!((0.0..=f64::from(ceiling_bar).min(4.0)).contains(&output));
                prop_assert!(output - last <= f64::from(slew_up_bar_per_s) * 1e-3 + 1e-12);
                let vented = !energised || limited.fault.is_some();
                prop_assert!(!vented || output == 0.0);
                prop_assert!(vented || last - output <= f64::from(slew_down_bar_per_s) * 1e-3 + 1e-12);
                last = output;
            }
        }
    }
}
