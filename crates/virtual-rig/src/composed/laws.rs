//! The laws of the composed rig: for every effect one to tune on and another to report on. A dead time, a skewed clock and wrong
//! readings have one law only: operators without rates take no notice on which side of them something is late.

use std::collections::VecDeque;
use std::f64::consts::{PI, TAU};

use rand::RngExt;

use super::draw::{Draw, Moment, STEP_S, Set, Stage, ThresholdLaw};
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

fn stage(step: impl FnMut(f64, &Moment) -> f64 + 'static) -> Stage {
    Box::new(step)
}

/// A stage without memory.
fn map(law: impl Fn(f64) -> f64 + 'static) -> Stage {
    Box::new(move |value, _| law(value))
}

/// A delay of a whole number of steps.
fn delay(delay_s: f64) -> Stage {
    let mut waiting = VecDeque::from(vec![0.0; (delay_s / STEP_S).round() as usize]);
    stage(move |value, _| {
        waiting.push_back(value);
        waiting.pop_front().unwrap_or(value)
    })
}

/// A state that changes by `rate(input, state)` per second.
fn first_order(rate: impl Fn(f64, f64) -> f64 + 'static) -> Stage {
    let mut state = 0.0;
    stage(move |value, _| {
        state += STEP_S * rate(value, state);
        state
    })
}

/// A swing with a stiffness that grows by `hardening` times the square of the deflection over `range`.
fn swing(frequency_hz: f64, damping: f64, hardening: f64, range: f64) -> Stage {
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
struct Turn {
    farthest: f64,
    falls: bool,
    left_s: f64,
}

impl Turn {
    /// Whether the command turned within the last `hold_s`; turning back within that time changes nothing.
    fn holds(&mut self, value: f64, hold_s: f64) -> bool {
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

/// Draws a law of the effect `name` from a set.
pub fn draw(name: &str, set: Set, draw: &mut Draw<'_>) -> Drawn {
    match set {
        Set::Tuning => tuning(name, draw),
        Set::Reporting => reporting(name, draw),
    }
}

fn tuning(name: &str, draw: &mut Draw<'_>) -> Drawn {
    let (span, range) = (draw.span_bar, draw.range_mm);
    let rich = draw.excitation == Excitation::Rich;
    match name {
        "dead-time" => {
            let delay_s = draw.log(0.04, 0.25);
            Drawn::Before(delay(draw.tell("dead-time.delay_s", delay_s)))
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

fn reporting(name: &str, draw: &mut Draw<'_>) -> Drawn {
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

/// What no catalogue has.
fn alien(name: &str, draw: &mut Draw<'_>) -> Drawn {
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
