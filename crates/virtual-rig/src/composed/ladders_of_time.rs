//! Further ladders of laws to tune on: creep, and what swings.
//!
//! Creep: elements of Kelvin and Voigt, before the operators or behind them; powers of time; flow above a yield stress (Bingham). What swings: Duffing's
//! spring, a spring that the load stiffens, two modes, friction beside drag, a mode beside the direct path, and the line before the muscle.

use std::f64::consts::TAU;

use super::draw::{Draw, STEP_S};
use super::laws::{Drawn, stage};

/// How many laws of creep there are.
pub(super) const CREEPS: u64 = 6;
/// How many of what swings.
pub(super) const SWINGS: u64 = 6;

/// Laws of a material that goes on giving.
pub(super) fn creep(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let (range, size, time_s) = (draw.range_mm, draw.even(0.06, 0.18), draw.log(1.0, 12.0));
    let mut strain = 0.0;
    match law {
        // One element before the operators, which the pressure strains.
        0 => Drawn::Before(stage(move |value, _| {
            strain += STEP_S * (size * value - strain) / time_s;
            value + strain
        })),
        // A power of time there.
        1 => {
            let mut strains = [0.0; 7];
            Drawn::Before(stage(move |value, _| {
                let mut sum = value;
                for (element, strain) in (0..7).zip(&mut strains) {
                    *strain += STEP_S * (0.2 * size * value - *strain) / (0.1 * 2.8_f64.powi(element));
                    sum += *strain;
                }
                sum
            }))
        }
        // It comes back slower than it gives.
        2 => {
            let slower = draw.even(1.5, 4.0);
            Drawn::Before(stage(move |value, _| {
                let missing: f64 = size * value - strain;
                strain += STEP_S * missing / (time_s * if missing > 0.0 { 1.0 } else { slower });
                value + strain
            }))
        }
        // More than in proportion to the load.
        3 => Drawn::Behind(stage(move |value: f64, _| {
            strain += STEP_S * (1.5 * size * value * (value / range).abs() - strain) / time_s;
            value + strain
        })),
        // It flows above a yield stress only.
        4 => {
            let yield_mm = 0.2 * size * range;
            Drawn::Behind(stage(move |value, _| {
                let stress: f64 = size * value - strain;
                strain += STEP_S * stress.signum() * (stress.abs() - yield_mm).max(0.0) / time_s;
                value + strain
            }))
        }
        // A quick element and one slower than a recording is long.
        _ => {
            let mut quick = 0.0;
            Drawn::Behind(stage(move |value, _| {
                quick += STEP_S * (0.6 * size * value - quick) / (0.1 * time_s);
                strain += STEP_S * (size * value - strain) / (10.0 * time_s);
                value + quick + strain
            }))
        }
    }
}

/// Laws of a tip, or a line, that swings.
pub(super) fn resonance(law: u64, draw: &mut Draw<'_>) -> Drawn {
    let (frequency_hz, damping) = (draw.log(1.5, 5.0), draw.even(0.08, 0.35));
    draw.tell("resonance.frequency_hz", frequency_hz);
    draw.tell("resonance.damping_ratio", damping);
    let (omega, range, span) = (TAU * frequency_hz, draw.range_mm, draw.span_bar);
    let (mut place, mut speed) = (0.0, 0.0);
    let mut swing = move |towards: f64, stiffness: &dyn Fn(f64) -> f64, drag: &dyn Fn(f64) -> f64| {
        speed += STEP_S * (omega * omega * stiffness(towards - place) - 2.0 * damping * omega * speed - drag(speed));
        place += STEP_S * speed;
        place
    };
    match law {
        // Duffing's: stiffer the further it swings out.
        0 => Drawn::Behind(stage(move |value, _| swing(value, &|away| away * (1.0 + 40.0 * (away / range).powi(2)), &|_| 0.0))),
        // The load stiffens it.
        1 => {
            let stiffer = draw.even(0.4, 1.2);
            Drawn::Behind(stage(move |value: f64, _| {
                let factor = 1.0 + stiffer * (value / range).clamp(0.0, 1.0);
                swing(value, &|away| away * factor, &|_| 0.0)
            }))
        }
        // A second mode.
        2 => {
            let (share, higher) = (draw.even(0.15, 0.3), omega * draw.even(2.2, 3.2));
            let (mut other, mut other_speed) = (0.0, 0.0);
            Drawn::Behind(stage(move |value, _| {
                other_speed += STEP_S * (higher * higher * (value - other) - 2.0 * damping * higher * other_speed);
                other += STEP_S * other_speed;
                (1.0 - share) * swing(value, &|away| away, &|_| 0.0) + share * other
            }))
        }
        // Dry friction beside the drag.
        3 => {
            let friction = 0.004 * range * omega * omega;
            Drawn::Behind(stage(move |value, _| swing(value, &|away| away, &|speed| friction * (speed / (0.01 * range * omega)).tanh())))
        }
        // Part of the tip follows directly.
        4 => {
            let share = draw.even(0.4, 0.8);
            Drawn::Behind(stage(move |value, _| (1.0 - share) * value + share * swing(value, &|away| away, &|_| 0.0)))
        }
        // The air in the line swings against the muscle, with a drag that grows as the square of the speed.
        _ => Drawn::Before(stage(move |value, _| swing(value, &|away| away, &|speed| 1.5 / span * speed * speed.abs()))),
    }
}
