//! The laws that report: no choice about discovery looks at them.

use std::f64::consts::PI;

use rand::RngExt;

use super::draw::{Draw, STEP_S, ThresholdLaw};
use super::laws::{Drawn, Turn, alien, delay, first_order, map, stage, swing};
use crate::command::Excitation;

/// Draws a law of the effect `name` from the reporting set.
pub fn reporting(name: &str, draw: &mut Draw<'_>) -> Drawn {
    let (span, range) = (draw.span_bar, draw.range_mm);
    let rich = draw.excitation == Excitation::Rich;
    match name {
        "dead-time" => {
            let delay_s = draw.log(0.04, 0.25);
            Drawn::Behind(delay(draw.tell("dead-time.delay_s", delay_s)))
        }
        "pneumatic-lag" => {
            // Two equal volumes in a row.
            let time_s = draw.log(0.04, 0.25);
            let mut states = [0.0; 2];
            Drawn::Before(stage(move |value, _| {
                states[0] += STEP_S * (value - states[0]) / time_s;
                states[1] += STEP_S * (states[0] - states[1]) / time_s;
                states[1]
            }))
        }
        "fill-vent-asymmetry" => {
            // Turbulent orifices: the flow goes with the root of the difference, two orifices of different size.
            let (fill_s, ratio) = (draw.log(0.03, 0.12), draw.log(2.0, 4.5));
            let knee = 0.02 * span;
            Drawn::Before(first_order(move |value, state| {
                let away: f64 = value - state;
                span * away / (away.abs() + knee).sqrt() / span.sqrt() / if away > 0.0 { fill_s } else { fill_s * ratio }
            }))
        }
        "slew-limit" => {
            // A flow that saturates like a Langmuir curve.
            let most = span * if rich { draw.log(1.0, 3.0) } else { draw.log(0.6, 1.8) };
            Drawn::Before(first_order(move |value, state| {
                let wanted = (value - state) / 0.01;
                wanted / (1.0 + (wanted / most).powi(4)).powf(0.25)
            }))
        }
        "valve-dead-band" => {
            // A bang-bang valve: constant flow while open, and it shuts at the aim.
            let (band, flow) = (span * draw.log(0.03, 0.12), span * draw.log(3.0, 12.0));
            draw.tell("valve-dead-band.band_bar", band);
            let (mut state, mut drive) = (0.0_f64, 0.0);
            Drawn::Before(stage(move |value, _| {
                let error = value - state;
                if error.abs() > band {
                    drive = error.signum();
                } else if error * drive <= 0.0 {
                    drive = 0.0;
                }
                state += drive * flow * STEP_S;
                state
            }))
        }
        "supply-saturation" => {
            // The regulator droops before it gives out.
            let (limit, droop) = (draw.even(0.6, 0.9) * span, draw.even(0.02, 0.08));
            draw.tell("supply-saturation.limit_bar", limit);
            Drawn::Before(map(move |value| {
                let past = value - limit;
                if past > 0.0 { limit + droop * past } else { value }
            }))
        }
        "activation-threshold" => {
            // A braid with slack: the square grows first, then the line.
            let (threshold, width) = (draw.even(0.08, 0.28) * span, 0.04 * span);
            draw.tell("activation-threshold.threshold_bar", threshold);
            Drawn::Before(map(move |value| {
                let past = value - threshold;
                if past <= -width {
                    0.0
                } else if past < width {
                    (past + width).powi(2) / (4.0 * width)
                } else {
                    past
                }
            }))
        }
        "static-nonlinearity" => {
            let (size, sign) = (draw.even(0.5, 1.1), draw.sign());
            if draw.generator.random_bool(0.5) {
                Drawn::Behind(map(move |value| {
                    if sign > 0.0 { range * (size * value / range).tanh() / size } else { range * (size * value / range).exp_m1() / size }
                }))
            } else {
                let power = if sign > 0.0 { 1.0 + 0.4 * size } else { 1.0 - 0.25 * size };
                Drawn::Before(map(move |value| span * (value.max(0.0) / span).powf(power)))
            }
        }
        "asymmetric-hysteresis" => Drawn::Muscle(ThresholdLaw { taper: draw.even(0.8, 2.5), ..ThresholdLaw::default() }),
        "rate-dependent-hysteresis" => Drawn::Muscle(ThresholdLaw { sliding_s: draw.log(0.03, 0.2), ..ThresholdLaw::default() }),
        "creep" => {
            // Logarithmic creep: eight elements at equal ratios over three decades.
            let size = draw.even(0.012, 0.035);
            let mut strains = [0.0; 8];
            Drawn::Before(stage(move |value, _| {
                let mut sum = value;
                for (element, strain) in (0..8).zip(&mut strains) {
                    *strain += STEP_S * (size * value - *strain) / (0.2 * 2.6_f64.powi(element));
                    sum += *strain;
                }
                sum
            }))
        }
        "first-cycle-softening" => {
            // Mullins: soft up to the farthest that it has been, stiff beyond.
            let size = draw.even(0.08, 0.25);
            let mut farthest = 0.0_f64;
            Drawn::Behind(stage(move |value, moment| {
                if moment.begins {
                    farthest = 0.0;
                }
                farthest = farthest.max(value + (farthest - value) * (1.0 - STEP_S));
                value * (1.0 - size * (farthest / range).clamp(0.0, 1.0))
            }))
        }
        "stick-slip" => {
            // A mass on a spring with Coulomb and Stribeck friction.
            let (hold, ratio) = (range * draw.log(0.025, 0.08), draw.even(0.3, 0.7));
            let (stribeck, omega, damping) = (range * 0.05, 2.0 * PI * 25.0, 0.3);
            let (mut place, mut speed) = (0.0, 0.0_f64);
            Drawn::Behind(stage(move |value: f64, _| {
                for _ in 0..10 {
                    let step_s = 0.1 * STEP_S;
                    let spring: f64 = value - place;
                    if speed == 0.0 && spring.abs() <= hold {
                        continue;
                    }
                    let direction = if speed == 0.0 { spring.signum() } else { speed.signum() };
                    let friction = hold * (ratio + (1.0 - ratio) * (-(speed / stribeck).powi(2)).exp());
                    let next = speed + step_s * (omega * omega * (spring - friction * direction) - 2.0 * damping * omega * speed);
                    // It stops when it would turn.
                    speed = if speed * next < 0.0 { 0.0 } else { next };
                    place += step_s * speed;
                }
                place
            }))
        }
        "resonance" => {
            let (frequency_hz, damping) = (draw.log(1.5, if rich { 6.0 } else { 4.0 }), draw.log(0.05, 0.3));
            let hardening = draw.even(5.0, 40.0);
            draw.tell("resonance.frequency_hz", frequency_hz);
            Drawn::Behind(swing(frequency_hz, damping, hardening, range))
        }
        "periodic-disturbance" => {
            // Breath: a short push and a long pause.
            let (frequency_hz, size, phase) = (draw.log(0.25, 1.6), range * draw.log(0.02, 0.06), draw.even(0.0, 1.0));
            draw.tell("periodic-disturbance.frequency_hz", frequency_hz);
            Drawn::Behind(stage(move |value, moment| {
                let turn = (frequency_hz * moment.session_s + phase).rem_euclid(1.0);
                value + if turn < 0.45 { size * (PI * turn / 0.45).sin().powi(2) } else { 0.0 }
            }))
        }
        "offset-drift" => {
            let (size, time_s) = (range * draw.log(0.04, 0.12) * draw.sign(), draw.session_s * draw.even(0.2, 0.6));
            Drawn::Behind(stage(move |value, moment| value + size * (1.0 - (-(moment.session_s.max(0.0)) / time_s).exp())))
        }
        "gain-drift" => {
            let (size, time_s) = (draw.even(0.08, 0.22) * draw.sign(), draw.session_s * draw.even(0.2, 0.6));
            Drawn::Behind(stage(move |value, moment| value * (1.0 + size * (1.0 - (-(moment.session_s.max(0.0)) / time_s).exp()))))
        }
        "setup-change" => {
            let (at, gain, shift) =
                (draw.generator.random_range(5..15), 1.0 + draw.even(0.05, 0.15) * draw.sign(), range * draw.even(-0.05, 0.05));
            Drawn::Behind(stage(move |value, moment| if moment.recording >= at { shift + gain * value } else { value }))
        }
        "clock-skew" => {
            let skew = draw.even(0.002, 0.008) * draw.sign();
            Drawn::Clock(draw.tell("clock-skew.skew", skew))
        }
        "outliers" => {
            let share = draw.log(0.004, 0.02);
            Drawn::Readings(draw.tell("outliers.share", share))
        }
        "leakage" => {
            // A leak beside a regulator that refills slowly: a pressure divider at rest.
            let (time_s, refill_s) = (draw.log(4.0, 15.0), draw.even(20.0, 60.0));
            let (mut state, mut last) = (0.0_f64, 0.0);
            Drawn::Before(stage(move |value, _| {
                state = (state + value - last - STEP_S * state / time_s + STEP_S * (value - state) / refill_s).max(0.0);
                last = value;
                state
            }))
        }
        "sample-and-hold" => {
            // The converter settles in a few milliseconds.
            let (period_s, first) = (draw.log(0.08, 0.5), draw.even(0.0, 1.0));
            draw.tell("sample-and-hold.period_s", period_s);
            let (mut held, mut state, mut since_s) = (0.0, 0.0, 0.0);
            Drawn::Before(stage(move |value, moment| {
                since_s = if moment.begins { (1.0 - first) * period_s } else { since_s + STEP_S };
                if since_s >= period_s {
                    held = value;
                    since_s -= period_s;
                }
                state += (held - state) * STEP_S / 0.008;
                state
            }))
        }
        "hold-after-reversal" => {
            // It catches up at a constant rate.
            let (hold_s, rate) = (draw.log(0.1, 0.4), span * draw.log(3.0, 12.0));
            draw.tell("hold-after-reversal.hold_s", hold_s);
            let mut turn = Turn::default();
            let mut state = 0.0_f64;
            Drawn::Before(stage(move |value, _| {
                if !turn.holds(value, hold_s) {
                    state += (value - state).clamp(-rate * STEP_S, rate * STEP_S);
                }
                state
            }))
        }
        alien => self::alien(alien, draw),
    }
}
