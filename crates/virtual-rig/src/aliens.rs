//! Effects that no catalogue knows.

use std::f64::consts::PI;

use crate::stages::{Moment, STEP_S, Stage};

/// Things no catalogue knows: the aliens.
pub enum Alien {
    /// The gain breathes with a rhythm of its own.
    BreathingGain {
        /// Depth of the modulation.
        depth: f64,
        /// Frequency, Hz.
        frequency_hz: f64,
    },
    /// A loose joint that is sometimes in one place and sometimes in the other: the gain jumps at random.
    LooseJoint {
        /// Size of the jump.
        depth: f64,
        /// Times of the jumps in session time, s.
        jumps_s: Vec<f64>,
    },
    /// The wall snaps over at one displacement and back at a lower one.
    SnapThrough {
        /// Snaps forward here, mm.
        forward_mm: f64,
        /// Snaps back here, mm.
        back_mm: f64,
        /// Size, mm.
        size_mm: f64,
        /// Whether it is over.
        over: bool,
        /// Smoothed position, mm.
        place_mm: f64,
    },
    /// A regulator that hunts above a pressure.
    Hunting {
        /// Pressure it begins at, as a share of the range.
        above: f64,
        /// Size per unit above.
        size: f64,
        /// Frequency, Hz, drifting with the phase.
        frequency_hz: f64,
        /// Phase.
        phase: f64,
    },
    /// Friction heat: fast work makes the muscle longer, cooling takes minutes.
    Heat {
        /// Gain per unit of heat.
        size: f64,
        /// Speed that heats by one, squared per s.
        speed: f64,
        /// Cooling time, s.
        time_s: f64,
        /// Heat.
        heat: f64,
        /// Last input.
        last: f64,
    },
    /// An unseen hand that pulls in proportion to the stroke: a random walk times the signal.
    WanderingGain {
        /// Spread.
        depth: f64,
        /// Values of the slow drift at equal distances.
        knots: Vec<f64>,
        /// Distance of the knots, s.
        spacing_s: f64,
    },
    /// A second axis that pulls every other time the first one turns.
    EveryOtherStroke {
        /// Shift, mm at full range.
        size: f64,
        /// Last direction.
        rising: bool,
        /// Turns so far.
        turns: u32,
        /// Extreme since the turn.
        extreme: f64,
        /// Travel that counts as a turn.
        travel: f64,
        /// Smoothed state.
        state: f64,
    },
}

impl Stage for Alien {
    fn step(&mut self, input: f64, moment: &Moment) -> f64 {
        match self {
            Self::BreathingGain { depth, frequency_hz } => input * (1.0 + *depth * (2.0 * PI * *frequency_hz * moment.session_s).sin()),
            Self::LooseJoint { depth, jumps_s } => {
                let count = jumps_s.partition_point(|&time| time <= moment.session_s);
                input * (1.0 + if count % 2 == 1 { *depth } else { 0.0 })
            }
            Self::SnapThrough { forward_mm, back_mm, size_mm, over, place_mm } => {
                *over = if *over { input > *back_mm } else { input > *forward_mm };
                *place_mm += STEP_S / 0.02 * (if *over { *size_mm } else { 0.0 } - *place_mm);
                input + *place_mm
            }
            Self::Hunting { above, size, frequency_hz, phase } => {
                *phase += STEP_S * 2.0 * PI * *frequency_hz * (1.0 + 0.3 * (0.37 * moment.session_s).sin());
                input + *size * (input - *above).max(0.0) * phase.sin()
            }
            Self::Heat { size, speed, time_s, heat, last } => {
                let rate = (input - *last) / STEP_S / *speed;
                *last = input;
                *heat += STEP_S * (rate * rate - *heat / *time_s);
                input * (1.0 + *size * *heat / *time_s)
            }
            Self::WanderingGain { depth, knots, spacing_s } => {
                let place = moment.session_s / *spacing_s;
                let knot = (place as usize).min(knots.len() - 2);
                let share = (place - knot as f64).min(1.0);
                let smooth = 0.5 - 0.5 * (PI * share).cos();
                input * (1.0 + *depth * (knots[knot] * (1.0 - smooth) + knots[knot + 1] * smooth))
            }
            Self::EveryOtherStroke { size, rising, turns, extreme, travel, state } => {
                if *rising {
                    *extreme = extreme.max(input);
                    if input < *extreme - *travel {
                        *rising = false;
                        *extreme = input;
                        *turns += 1;
                    }
                } else {
                    *extreme = extreme.min(input);
                    if input > *extreme + *travel {
                        *rising = true;
                        *extreme = input;
                        *turns += 1;
                    }
                }
                let aim = if *turns % 4 >= 2 { *size } else { 0.0 };
                *state += STEP_S / 0.1 * (aim - *state);
                input + *state
            }
        }
    }
}
