//! A second law to tune on for the effects whose names travel worst, of other physics than the first in [`super::laws`].

use super::draw::{Draw, STEP_S, ThresholdLaw};
use super::laws::{self, Drawn, first_order, stage};
use crate::command::Excitation;

/// Draws the second law of the effect `name` from the tuning set, or the first where there is one only.
pub(super) fn tuning(name: &str, draw: &mut Draw<'_>) -> Drawn {
    let (span, range) = (draw.span_bar, draw.range_mm);
    match name {
        "pneumatic-lag" => {
            // A line and a muscle, two volumes in series.
            let (line_s, muscle_s) = (draw.log(0.02, 0.08), draw.log(0.06, 0.3));
            draw.tell("pneumatic-lag.time_constant_s", line_s + muscle_s);
            let mut line = 0.0;
            Drawn::Before(first_order(move |value, state| {
                let flow = (line - state) / muscle_s;
                line += STEP_S * (value - line) / line_s;
                flow
            }))
        }
        "valve-dead-band" => {
            // A solenoid that takes its time to open and to shut: what it lets through meanwhile depends on the flow.
            let (band, share, flow_s) = (span * draw.log(0.03, 0.12), draw.even(0.2, 0.5), draw.log(0.03, 0.1));
            draw.tell("valve-dead-band.band_bar", band);
            let switching_s = draw.even(0.003, 0.015);
            let (mut state, mut open, mut waited_s) = (0.0_f64, false, 0.0);
            Drawn::Before(stage(move |value, _| {
                let error = value - state;
                let wanted = error.abs() > if open { share * band } else { band };
                waited_s = if wanted == open { 0.0 } else { waited_s + STEP_S };
                if waited_s > switching_s {
                    (open, waited_s) = (wanted, 0.0);
                }
                if open {
                    state += error * STEP_S / flow_s;
                }
                state
            }))
        }
        "asymmetric-hysteresis" => {
            // Branches that saturate, one more than the other.
            let mut bends = [draw.even(0.1, 0.5), draw.even(0.9, 1.5)];
            if draw.sign() < 0.0 {
                bends.reverse();
            }
            Drawn::Muscle(ThresholdLaw { saturations: Some(bends), ..ThresholdLaw::default() })
        }
        "rate-dependent-hysteresis" => Drawn::Muscle(ThresholdLaw { root_of_rate: draw.even(0.15, 0.5), ..ThresholdLaw::default() }),
        "creep" => {
            // A power of time: many elements, as many in each decade.
            let (size, first_s) = (draw.even(0.01, 0.03), draw.log(0.05, 0.2));
            let mut strains = [0.0; 7];
            Drawn::Behind(stage(move |value, _| {
                let mut sum = value;
                for (element, strain) in (0..7).zip(&mut strains) {
                    *strain += STEP_S * (size * value - *strain) / (first_s * 2.8_f64.powi(element));
                    sum += *strain;
                }
                sum
            }))
        }
        "first-cycle-softening" => {
            // A structure that work destroys and rest builds up again.
            let (size, travel, again_s) = (draw.even(0.1, 0.25), range * draw.log(0.8, 4.0), draw.log(15.0, 60.0));
            let (mut structure, mut last) = (1.0, 0.0_f64);
            Drawn::Behind(stage(move |value, moment| {
                if moment.begins {
                    (structure, last) = (1.0, value);
                }
                structure += STEP_S * (1.0 - structure) / again_s - (value - last).abs() / travel * structure;
                last = value;
                value * (1.0 + size * structure)
            }))
        }
        "stick-slip" => {
            // Static friction grows while it holds, and a slip is no faster than its damping lets it.
            let (hold, kinetic, ageing) = (range * draw.log(0.025, 0.07), draw.even(0.3, 0.7), draw.even(0.05, 0.2));
            let slip_s = draw.log(0.008, 0.025);
            let (mut place, mut held_s) = (0.0_f64, Some(0.0_f64));
            Drawn::Behind(stage(move |value: f64, _| {
                let stretch: f64 = value - place;
                match &mut held_s {
                    Some(time_s) if stretch.abs() <= hold * (1.0 + ageing * (*time_s / 0.1).ln_1p()) => *time_s += STEP_S,
                    _ if stretch.abs() > 1.02 * kinetic * hold => {
                        held_s = None;
                        place += (stretch - kinetic * hold * stretch.signum()) * STEP_S / slip_s;
                    }
                    _ => held_s = Some(0.0),
                }
                place
            }))
        }
        "resonance" => {
            // Air: drag that grows with the square of the speed.
            let fastest_hz = if draw.excitation == Excitation::Rich { 6.0 } else { 4.0 };
            let (frequency_hz, damping) = (draw.log(1.5, fastest_hz), draw.log(0.05, 0.2));
            draw.tell("resonance.frequency_hz", frequency_hz);
            let omega = 2.0 * std::f64::consts::PI * frequency_hz;
            let (mut place, mut speed) = (0.0, 0.0_f64);
            Drawn::Behind(stage(move |value, _| {
                let drag = damping * (0.5 + speed.abs() / (0.15 * range * omega));
                speed += STEP_S * (omega * omega * (value - place) - 2.0 * drag * omega * speed);
                place += STEP_S * speed;
                place
            }))
        }
        "hold-after-reversal" => {
            // Shut anew by each turn of the command; a valve that lets through so much and no more catches up.
            let (hold_s, most) = (draw.log(0.1, 0.4), span * draw.log(1.0, 4.0));
            draw.tell("hold-after-reversal.hold_s", hold_s);
            let (mut state, mut last, mut falls, mut left_s) = (0.0_f64, 0.0_f64, false, 0.0_f64);
            Drawn::Before(stage(move |value, _| {
                let turns = if falls { value > last + 1e-9 } else { value < last - 1e-9 };
                left_s = if turns { hold_s } else { left_s - STEP_S };
                (falls, last) = (falls != turns, value);
                if left_s <= 0.0 {
                    state += (value - state).clamp(-most * STEP_S, most * STEP_S);
                }
                state
            }))
        }
        other => laws::tuning(other, draw),
    }
}
