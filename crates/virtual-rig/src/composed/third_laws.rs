//! A third law to tune on, of the plainest kind that a stranger would write, or of physics that neither [`super::laws`] nor [`super::second_laws`] has.

use std::f64::consts::{PI, TAU};

use rand::RngExt;

use super::draw::{Draw, STEP_S, ThresholdLaw};
use super::laws::{self, Drawn, delay, first_order, map, stage};
use crate::command::Excitation;

/// Draws the third law of the effect `name` from the tuning set, or the first where there is none.
pub(super) fn tuning(name: &str, draw: &mut Draw<'_>) -> Drawn {
    let (span, range, session_s) = (draw.span_bar, draw.range_mm, draw.session_s);
    let rich = draw.excitation == Excitation::Rich;
    match name {
        "dead-time" => {
            let delay_s = draw.log(0.04, 0.25);
            Drawn::Behind(delay(draw.tell("dead-time.delay_s", (delay_s / STEP_S).round() * STEP_S)))
        }
        "pneumatic-lag" => {
            // Turbulent flow through an orifice, laminar near the end.
            let (time_s, laminar) = (draw.log(0.06, 0.3), span * draw.even(0.05, 0.2));
            draw.tell("pneumatic-lag.time_constant_s", time_s);
            let rate = (span * laminar).sqrt() / time_s;
            Drawn::Before(first_order(move |value, state| {
                let error: f64 = value - state;
                rate * error / (laminar * (error.abs() + laminar)).sqrt() * (laminar / span).sqrt()
            }))
        }
        "fill-vent-asymmetry" => {
            // Two volumes, the valve's and the muscle's; the way out is the narrower one.
            let (fill_s, ratio, line_s) = (draw.log(0.04, 0.15), draw.log(2.0, 4.5), draw.log(0.005, 0.02));
            let mut line = 0.0;
            Drawn::Before(first_order(move |value, state| {
                line += STEP_S * (value - line) / line_s;
                (line - state) / if line > state { fill_s } else { fill_s * ratio }
            }))
        }
        "slew-limit" => {
            // Another limit for each direction, behind a short lag.
            let up = span * if rich { draw.log(1.0, 3.0) } else { draw.log(0.6, 1.5) };
            let (down, lag_s) = (up * draw.even(0.6, 1.5), draw.log(0.005, 0.02));
            draw.tell("slew-limit.limit_bar_per_s", up.min(down));
            Drawn::Before(first_order(move |value, state| ((value - state) / lag_s).clamp(-down, up)))
        }
        "valve-dead-band" => {
            // An open solenoid lets through so much a second, and shuts when little error is left.
            let (band, share, rate) = (span * draw.log(0.03, 0.1), draw.even(0.1, 0.4), span * draw.log(3.0, 10.0));
            draw.tell("valve-dead-band.band_bar", band);
            let (mut state, mut open) = (0.0_f64, false);
            Drawn::Before(stage(move |value, _| {
                let error: f64 = value - state;
                open = error.abs() > if open { share * band } else { band };
                if open {
                    state += error.clamp(-rate * STEP_S, rate * STEP_S);
                }
                state
            }))
        }
        "supply-saturation" => {
            // It bends before it ends.
            let limit = draw.even(0.6, 0.85) * span;
            draw.tell("supply-saturation.limit_bar", limit);
            let sharp = draw.even(6.0, 14.0);
            Drawn::Before(map(move |value| value.max(0.0) / (1.0 + (value.max(0.0) / limit).powf(sharp)).powf(1.0 / sharp)))
        }
        "activation-threshold" => {
            // A sleeve that lies ever closer.
            let (threshold, width) = (draw.even(0.08, 0.28) * span, draw.even(0.01, 0.03) * span);
            draw.tell("activation-threshold.threshold_bar", threshold);
            let soft = move |value: f64| width * ((value - threshold) / width).exp().ln_1p();
            Drawn::Before(map(move |value| soft(value) - soft(0.0)))
        }
        "static-nonlinearity" => {
            // A geometry: the sine of an angle, or what it takes to reach it.
            let angle = draw.even(0.8, 1.4);
            if draw.generator.random_bool(0.5) {
                Drawn::Behind(map(move |value| range * (angle * value / range).sin() / angle.sin()))
            } else {
                Drawn::Before(map(move |value| span * (angle * value / span).tan() / angle.tan()))
            }
        }
        "asymmetric-hysteresis" => {
            // One branch bends, the other does not.
            let mut powers = [1.0, draw.even(1.25, 1.6)];
            if draw.sign() < 0.0 {
                powers.reverse();
            }
            Drawn::Muscle(ThresholdLaw { powers: Some(powers), ..ThresholdLaw::default() })
        }
        "rate-dependent-hysteresis" => Drawn::Muscle(ThresholdLaw { linear_rate: draw.even(0.1, 0.35), ..ThresholdLaw::default() }),
        "creep" => {
            // One element behind the muscle that gives faster than it comes back.
            let (size, time_s, slower) = (draw.even(0.05, 0.15), draw.log(1.0, 6.0), draw.even(1.0, 3.0));
            let mut strain = 0.0;
            Drawn::Behind(stage(move |value, _| {
                let missing: f64 = size * value - strain;
                strain += STEP_S * missing / (time_s * if missing > 0.0 { 1.0 } else { slower });
                value + strain
            }))
        }
        "first-cycle-softening" => {
            // Each cycle that is done softens it by so much; a pause brings all back.
            let (size, cycles) = (draw.even(0.08, 0.25), draw.log(0.7, 3.0));
            let (mut done, mut high) = (0.0, false);
            Drawn::Behind(stage(move |value, moment| {
                if moment.begins {
                    (done, high) = (0.0, false);
                }
                if high && value < 0.3 * range {
                    (done, high) = (done + 1.0, false);
                } else if value > 0.4 * range {
                    high = true;
                }
                value * (1.0 + size * (-done / cycles).exp())
            }))
        }
        "stick-slip" => {
            // It stays until the force is too much, and is there at once.
            let (hold, left) = (range * draw.log(0.025, 0.07), draw.even(0.0, 0.3));
            let mut place = 0.0;
            Drawn::Behind(stage(move |value: f64, _| {
                if (value - place).abs() > hold {
                    place = value - left * hold * (value - place).signum();
                }
                place
            }))
        }
        "resonance" => {
            // Two modes, the second one small.
            let (frequency_hz, damping) = (draw.log(1.5, if rich { 5.0 } else { 3.5 }), draw.log(0.05, 0.2));
            draw.tell("resonance.frequency_hz", frequency_hz);
            draw.tell("resonance.damping_ratio", damping);
            let (share, above) = (draw.even(0.05, 0.2), draw.even(2.0, 3.0));
            let (mut first, mut second) =
                (laws::swing(frequency_hz, damping, 0.0, range), laws::swing(above * frequency_hz, damping, 0.0, range));
            Drawn::Behind(stage(move |value, moment| (1.0 - share) * first(value, moment) + share * second(value, moment)))
        }
        "periodic-disturbance" => {
            // Breath: no sine, and larger on some recordings.
            let (frequency_hz, size, phase) = (draw.log(0.3, 2.0), range * draw.log(0.015, 0.04), draw.even(0.0, TAU));
            draw.tell("periodic-disturbance.frequency_hz", frequency_hz);
            Drawn::Behind(stage(move |value, moment| {
                let angle = 2.0 * PI * frequency_hz * moment.session_s + phase;
                value + size * (angle.sin() + 0.4 * (2.0 * angle + 1.0).sin())
            }))
        }
        "offset-drift" => {
            // It warms up.
            let (size, warm_s) = (range * draw.log(0.04, 0.12) * draw.sign(), session_s * draw.even(0.2, 0.6));
            Drawn::Behind(stage(move |value, moment| value + size * (1.0 - (-moment.session_s / warm_s).exp())))
        }
        "gain-drift" => {
            let (size, warm_s) = (draw.even(0.08, 0.22) * draw.sign(), session_s * draw.even(0.2, 0.6));
            Drawn::Behind(stage(move |value, moment| value * (1.0 + size * (1.0 - (-moment.session_s / warm_s).exp()))))
        }
        "setup-change" => {
            // Another gain and another zero.
            let at = draw.generator.random_range(4..16);
            let (gain, shift) = (1.0 + draw.even(0.04, 0.15) * draw.sign(), range * draw.even(0.0, 0.03) * draw.sign());
            Drawn::Behind(stage(move |value, moment| if moment.recording >= at { gain * value + shift } else { value }))
        }
        "leakage" => {
            // Turbulent: what is held goes with the root of what is left.
            let rate = span.sqrt() / draw.log(4.0, 20.0);
            let (mut state, mut last) = (0.0_f64, 0.0);
            Drawn::Before(stage(move |value, _| {
                state = (state + value - last - STEP_S * rate * state.sqrt()).max(0.0);
                last = value;
                state
            }))
        }
        "sample-and-hold" => {
            // A clock that no recording begins anew.
            let (period_s, first) = (draw.log(0.1, 0.5), draw.even(0.0, 1.0));
            draw.tell("sample-and-hold.period_s", period_s);
            let (mut held, mut look) = (0.0, f64::MIN);
            Drawn::Before(stage(move |value, moment| {
                let now = (moment.session_s / period_s + first).floor();
                if now != look {
                    (held, look) = (value, now);
                }
                held
            }))
        }
        "hold-after-reversal" => {
            // It holds at peaks only, where it has to vent.
            let (hold_s, flow_s) = (draw.log(0.1, 0.4), draw.log(0.01, 0.05));
            draw.tell("hold-after-reversal.hold_s", hold_s);
            let (mut state, mut last, mut falls, mut left_s) = (0.0_f64, 0.0_f64, false, 0.0_f64);
            Drawn::Before(stage(move |value, _| {
                let turns = if falls { value > last + 1e-9 } else { value < last - 1e-9 };
                left_s = if turns && !falls { hold_s } else { left_s - STEP_S };
                (falls, last) = (falls != turns, value);
                if left_s <= 0.0 {
                    state += (value - state) * STEP_S / flow_s;
                }
                state
            }))
        }
        other => laws::tuning(other, draw),
    }
}
