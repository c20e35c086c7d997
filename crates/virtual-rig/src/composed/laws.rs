//! The laws of the composed rig to tune on; another one to report on is in `reporting`, for every effect. A dead time, a skewed clock and wrong
//! readings have one law only: operators without rates take no notice on which side of them something is late.

use std::collections::VecDeque;
use std::f64::consts::{PI, TAU};

use rand::RngExt;

use super::draw::{Draw, Moment, STEP_S, Stage, ThresholdLaw};
use crate::command::Excitation;

/// What a law comes to.
pub enum Drawn {
    /// A stage before the muscle: bar to bar.
    Before(Stage),
    /// The muscle's own deviation.
    Muscle(ThresholdLaw),
    /// A stage behind the muscle: mm to mm.
    Behind(Stage),
    /// Relative error of the displacement's clock.
    Clock(f64),
    /// Share of wrong readings.
    Readings(f64),
}

pub(super) fn stage(step: impl FnMut(f64, &Moment) -> f64 + 'static) -> Stage {
    Box::new(step)
}

/// A stage without memory.
pub(super) fn map(law: impl Fn(f64) -> f64 + 'static) -> Stage {
    Box::new(move |value, _| law(value))
}

/// A delay of a whole number of steps.
pub(super) fn delay(delay_s: f64) -> Stage {
    let mut waiting = VecDeque::from(vec![0.0; (delay_s / STEP_S).round() as usize]);
    stage(move |value, _| {
        waiting.push_back(value);
        waiting.pop_front().unwrap_or(value)
    })
}

/// A state that changes by `rate(input, state)` per second.
pub(super) fn first_order(mut rate: impl FnMut(f64, f64) -> f64 + 'static) -> Stage {
    let mut state = 0.0;
    stage(move |value, _| {
        // What stood when this input came: the step of Euler's is behind it, and a ramp is followed as late as in continuous time.
        let stood = state;
        state += STEP_S * rate(value, state);
        stood
    })
}

/// A swing with a stiffness that grows by `hardening` times the square of the deflection over `range`.
pub(super) fn swing(frequency_hz: f64, damping: f64, hardening: f64, range: f64) -> Stage {
    let omega = 2.0 * PI * frequency_hz;
    let (mut place, mut speed) = (0.0, 0.0);
    stage(move |value, _| {
        for _ in 0..4 {
            let away: f64 = value - place;
            let force = omega * omega * away * (1.0 + hardening * (away / range).powi(2));
            speed += 0.25 * STEP_S * (force - 2.0 * damping * omega * speed);
            place += 0.25 * STEP_S * speed;
        }
        place
    })
}

/// Where a command turned last, and for how long that still counts.
#[derive(Default)]
pub(super) struct Turn {
    farthest: f64,
    falls: bool,
    left_s: f64,
}

impl Turn {
    /// Whether the command turned within the last `hold_s`; turning back within that time changes nothing.
    pub(super) fn holds(&mut self, value: f64, hold_s: f64) -> bool {
        self.left_s -= STEP_S;
        let back = if self.falls { value - self.farthest } else { self.farthest - value };
        if back <= 0.0 {
            self.farthest = value;
        } else if back > 1e-6 {
            (self.farthest, self.falls) = (value, !self.falls);
            if self.left_s <= 0.0 {
                self.left_s = hold_s;
            }
        }
        self.left_s > 0.0
    }
}

/// Draws a law of the effect `name` from the tuning set.
pub fn tuning(name: &str, draw: &mut Draw<'_>) -> Drawn {
    let (span, range) = (draw.span_bar, draw.range_mm);
    let rich = draw.excitation == Excitation::Rich;
    match name {
        "dead-time" => {
            let delay_s = draw.log(0.04, 0.25);
            // A whole number of steps.
            Drawn::Before(delay(draw.tell("dead-time.delay_s", (delay_s / STEP_S).round() * STEP_S)))
        }
        "pneumatic-lag" => {
            // An isothermal line into a volume that grows with its pressure: slower when full.
            let time_s = draw.log(0.06, 0.4);
            draw.tell("pneumatic-lag.time_constant_s", time_s);
            let growth = draw.even(0.0, 0.3);
            Drawn::Before(first_order(move |value, state| (value - state) / (time_s * (1.0 + growth * (state / span - 0.5)))))
        }
        "fill-vent-asymmetry" => {
            let (fill_s, ratio) = (draw.log(0.04, 0.2), draw.log(2.0, 4.5));
            Drawn::Before(first_order(move |value, state| (value - state) / if value > state { fill_s } else { fill_s * ratio }))
        }
        "slew-limit" => {
            let most = span * if rich { draw.log(1.0, 3.0) } else { draw.log(0.6, 1.8) };
            draw.tell("slew-limit.limit_bar_per_s", most);
            Drawn::Before(first_order(move |value, state| ((value - state) / 0.008).clamp(-most, most)))
        }
        "valve-dead-band" => {
            // A solenoid that opens at the band and shuts when the error has changed sign or is a small share of it.
            let (band, share, flow_s) = (span * draw.log(0.03, 0.12), draw.even(0.05, 0.3), draw.log(0.01, 0.04));
            draw.tell("valve-dead-band.band_bar", band);
            let (mut state, mut open) = (0.0_f64, false);
            Drawn::Before(stage(move |value, _| {
                let error = value - state;
                open = error.abs() > if open { share * band } else { band };
                if open {
                    state += error * STEP_S / flow_s;
                }
                state
            }))
        }
        "supply-saturation" => {
            let limit = draw.even(0.6, 0.9) * span;
            draw.tell("supply-saturation.limit_bar", limit);
            Drawn::Before(map(move |value| value.min(limit)))
        }
        "activation-threshold" => {
            let threshold = draw.even(0.06, 0.28) * span;
            draw.tell("activation-threshold.threshold_bar", threshold);
            Drawn::Before(map(move |value| (value - threshold).max(0.0)))
        }
        "static-nonlinearity" => {
            let bend = draw.even(0.25, 0.7) * draw.sign();
            if draw.generator.random_bool(0.5) {
                Drawn::Behind(map(move |value| value * (1.0 + bend * (1.0 - value / range))))
            } else {
                Drawn::Before(map(move |value| value * (1.0 + bend * (1.0 - value / span))))
            }
        }
        "asymmetric-hysteresis" => {
            Drawn::Muscle(ThresholdLaw { powers: Some([draw.even(1.15, 1.5), draw.even(0.75, 0.95)]), ..ThresholdLaw::default() })
        }
        "rate-dependent-hysteresis" => Drawn::Muscle(ThresholdLaw { logarithmic_rate: draw.even(0.25, 0.8), ..ThresholdLaw::default() }),
        "creep" => {
            let (size, first_s, ratio) = (draw.even(0.03, 0.09), draw.log(0.4, 1.5), draw.even(3.0, 6.0));
            let mut strains = [0.0; 3];
            Drawn::Behind(stage(move |value, _| {
                let mut sum = value;
                for (element, strain) in (0..3).zip(&mut strains) {
                    *strain += STEP_S * (size * value - *strain) / (first_s * ratio.powi(element));
                    sum += *strain;
                }
                sum
            }))
        }
        "first-cycle-softening" => {
            let (size, travel) = (draw.even(0.07, 0.22), range * draw.log(0.8, 4.0));
            let (mut travelled, mut last) = (0.0, 0.0_f64);
            Drawn::Behind(stage(move |value, moment| {
                if moment.begins {
                    (travelled, last) = (0.0, value);
                }
                travelled += (value - last).abs();
                last = value;
                value * (1.0 + size * (-travelled / travel).exp())
            }))
        }
        "stick-slip" => {
            // Karnopp: held until the spring passes the static friction, then sliding fast until it is down to the kinetic one.
            let (hold, ratio) = (range * draw.log(0.025, 0.08), draw.even(0.2, 0.7));
            let (mut place, mut slides) = (0.0, false);
            Drawn::Behind(stage(move |value: f64, _| {
                let stretch: f64 = value - place;
                slides = stretch.abs() > if slides { ratio * hold } else { hold };
                if slides {
                    place += (stretch - 0.5 * ratio * hold * stretch.signum()) * STEP_S / 0.006;
                }
                place
            }))
        }
        "resonance" => {
            let (frequency_hz, damping) = (draw.log(1.5, if rich { 6.0 } else { 4.0 }), draw.log(0.05, 0.3));
            draw.tell("resonance.frequency_hz", frequency_hz);
            draw.tell("resonance.damping_ratio", damping);
            Drawn::Behind(swing(frequency_hz, damping, 0.0, range))
        }
        "periodic-disturbance" => {
            let (frequency_hz, size, phase) = (draw.log(0.7, 5.0), range * draw.log(0.012, 0.04), draw.even(0.0, TAU));
            draw.tell("periodic-disturbance.frequency_hz", frequency_hz);
            Drawn::Behind(stage(move |value, moment| value + size * (2.0 * PI * frequency_hz * moment.session_s + phase).sin()))
        }
        "offset-drift" => {
            let (size, session_s) = (range * draw.log(0.03, 0.12) * draw.sign(), draw.session_s);
            Drawn::Behind(stage(move |value, moment| value + size * moment.session_s / session_s))
        }
        "gain-drift" => {
            let (size, session_s) = (draw.even(0.07, 0.22) * draw.sign(), draw.session_s);
            Drawn::Behind(stage(move |value, moment| value * (1.0 + size * moment.session_s / session_s)))
        }
        "setup-change" => {
            let (at, shift) = (draw.generator.random_range(5..15), range * draw.even(0.025, 0.1) * draw.sign());
            Drawn::Behind(stage(move |value, moment| if moment.recording >= at { value + shift } else { value }))
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
            let time_s = draw.log(4.0, 30.0);
            let (mut state, mut last) = (0.0_f64, 0.0);
            Drawn::Before(stage(move |value, _| {
                state = (state + value - last - STEP_S * state / time_s).max(0.0);
                last = value;
                state
            }))
        }
        "sample-and-hold" => {
            let (period_s, first) = (draw.log(0.08, 0.5), draw.even(0.0, 1.0));
            draw.tell("sample-and-hold.period_s", period_s);
            let (mut held, mut left_s) = (0.0, 0.0);
            Drawn::Before(stage(move |value, moment| {
                left_s = if moment.begins { first * period_s } else { left_s - STEP_S };
                if left_s < 0.5 * STEP_S {
                    held = value;
                    left_s += period_s;
                }
                held
            }))
        }
        "hold-after-reversal" => {
            // It follows its command like a volume behind a restriction, and shuts for a time when the command turns.
            let (hold_s, flow_s) = (draw.log(0.1, 0.4), draw.log(0.02, 0.1));
            draw.tell("hold-after-reversal.hold_s", hold_s);
            let mut turn = Turn::default();
            let mut state = 0.0;
            Drawn::Before(stage(move |value, _| {
                if !turn.holds(value, hold_s) {
                    state += (value - state) * STEP_S / flow_s;
                }
                state
            }))
        }
        alien => self::alien(alien, draw),
    }
}

/// What no catalogue has.
pub(super) fn alien(name: &str, draw: &mut Draw<'_>) -> Drawn {
    let range = draw.range_mm;
    match name {
        "alien-two-way-gain" => {
            // The displacement is smaller on every stroke that begins soon after the last one.
            let (size, rest_s) = (draw.even(0.1, 0.3), draw.even(0.6, 2.0));
            let (mut high, mut since_s, mut gain) = (false, 9.0, 1.0);
            Drawn::Behind(stage(move |value, _| {
                since_s += STEP_S;
                if high && value < 0.3 * range {
                    (high, since_s) = (false, 0.0);
                } else if !high && value > 0.4 * range {
                    high = true;
                    gain = if since_s < rest_s { 1.0 - size } else { 1.0 };
                }
                value * gain
            }))
        }
        "alien-temperature-steps" => {
            // Someone opens a window now and then.
            let (size, every_s) = (draw.even(0.05, 0.15), draw.even(5.0, 15.0));
            let offset = draw.even(0.0, 10.0);
            Drawn::Behind(stage(move |value, moment| {
                let knot = (moment.session_s / every_s + offset).floor() as i64;
                let hash = (knot.wrapping_mul(0x9E37_79B9) ^ (knot >> 3)).rem_euclid(7);
                value * (1.0 + size * (hash as f64 / 3.0 - 1.0))
            }))
        }
        _ => {
            // A regulator that answers a command with an error of its own each time it moves.
            let size = draw.even(0.03, 0.08) * draw.span_bar;
            let (mut state, mut drift, mut seed) = (0.0_f64, 0.0_f64, 12345_u64);
            Drawn::Before(stage(move |value, _| {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                let kick = ((seed >> 33) as f64 / 2f64.powi(30)) - 1.0;
                let moved = (value - state).abs();
                state = value;
                drift += kick * (moved * size).sqrt() * 1.5 - 0.002 * drift;
                value + drift.clamp(-3.0 * size, 3.0 * size)
            }))
        }
    }
}
