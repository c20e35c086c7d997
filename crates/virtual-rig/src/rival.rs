//! A second virtual rig, as somebody else would write it: discrete laws at 1 kHz, one whole signal after the other.
//!
//! Discovery is tuned on no single generator: what it names on the physics of [`super::stages`] it must name here too, where a lag has
//! one pole, a slew limit a hard corner, creep two terms, and thresholds, weights and strengths have other ranges. Recordings carry no
//! `session_time_s`: the order of the files is all that is known.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::command::{Excitation, REST_S, Shape};

/// Integration step, s.
const STEP_S: f64 = 1e-3;
/// Steps per sample: 50 Hz.
const STEPS_PER_SAMPLE: usize = 20;
/// Largest command, bar.
const SPAN_BAR: f64 = 2.0;

/// Effects that the catalogue does not have, of this rig.
pub const ALIENS: [&str; 5] = ["alien-unseen-force", "alien-wall", "alien-alternating-cycles", "alien-two-tone-gain", "alien-forgetting"];

/// One raw recording: times in s, commands in bar, displacements in mm.
pub type Raw = (Vec<f64>, Vec<f64>, Vec<f64>);

/// What one effect does, with what it draws once.
struct Law {
    name: String,
    /// Numbers between zero and one, drawn once for the session.
    draw: [f64; 6],
}

/// The rig.
pub struct Rival {
    /// Half widths of the play operators, bar.
    pub thresholds: Vec<f64>,
    /// Their weights, mm/bar.
    pub weights: Vec<f64>,
    states: Vec<f64>,
    /// Whether the muscle remembers one recording in the next.
    pub carries: bool,
    laws: Vec<Law>,
    length_s: f64,
    recordings: usize,
    /// Values drawn, `effect.parameter_unit`.
    pub values: BTreeMap<String, f64>,
}

/// A value between `low` and `high` at `share` of the way, even in its logarithm.
fn between(share: f64, low: f64, high: f64) -> f64 {
    low * (high / low).powf(share)
}

/// A hash of two numbers as a number between -1 and 1.
fn noise_of(seed: f64, index: usize) -> f64 {
    let mixed = (seed * 1e9) as u64 ^ (index as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mixed = (mixed ^ (mixed >> 31)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    ((mixed ^ (mixed >> 29)) % 2_000_001) as f64 / 1e6 - 1.0
}

fn lag(signal: &mut [f64], up_s: f64, down_s: f64) {
    let mut state = signal[0];
    for value in signal {
        state += STEP_S * (*value - state) / if *value > state { up_s } else { down_s };
        *value = state;
    }
}

/// The commands of a session.
pub fn commands(kind: Excitation, generator: &mut ChaCha8Rng) -> Vec<(String, Shape)> {
    let mut all = Vec::new();
    for index in 0..24_u32 {
        let frequency_hz = [0.15, 0.3, 0.45, 0.6, 0.75, 0.9][(index % 6) as usize];
        let decay_per_s = [0.01, 0.04, 0.09, 0.18][(index / 6) as usize];
        let sine = Shape::Sine { amplitude_bar: 0.5 * SPAN_BAR, decay_per_s, frequency_hz, sweep_hz_per_s: 0.0 };
        let levels = |generator: &mut ChaCha8Rng, dwell_s: f64, ramp_s: f64| Shape::Levels {
            levels_bar: (0..(20.0 / dwell_s) as usize).map(|_| generator.random_range(0.0..SPAN_BAR)).collect(),
            dwell_s,
            ramp_s,
        };
        let shape = match (kind, index % 4) {
            (Excitation::Rich, 1) => levels(generator, 1.25, 0.001),
            (Excitation::Rich, 2) => levels(generator, 0.8, 0.8),
            (Excitation::Rich, 3) => Shape::Triangle { peak_bar: 0.9 * SPAN_BAR, decay_per_s: 0.05, frequency_hz: 2.0 * frequency_hz },
            _ => sine,
        };
        all.push((format!("run{index:02}"), shape));
    }
    all
}

/// Commands of other kinds.
pub fn kept_out() -> Vec<(String, Shape)> {
    let sine =
        |amplitude_bar, decay_per_s, frequency_hz, sweep_hz_per_s| Shape::Sine { amplitude_bar, decay_per_s, frequency_hz, sweep_hz_per_s };
    vec![
        ("kept_sine".into(), sine(1.0, 0.07, 0.5, 0.0)),
        ("kept_triangle".into(), Shape::Triangle { peak_bar: 1.8, decay_per_s: 0.05, frequency_hz: 0.35 }),
        ("kept_sweep".into(), sine(0.9, 0.03, 0.1, 0.03)),
    ]
}

impl Rival {
    /// Draws a rig with these effects.
    pub fn new(effects: &[String], recordings: usize, plant: &mut ChaCha8Rng, generator: &mut ChaCha8Rng) -> Self {
        let widest = SPAN_BAR * plant.random_range(0.3..0.95);
        let mut thresholds: Vec<f64> = (0..20).map(|index| if index == 0 { 0.0 } else { widest * plant.random::<f64>() }).collect();
        thresholds.sort_by(f64::total_cmp);
        let weights: Vec<f64> = thresholds.iter().map(|_| plant.random::<f64>() / 10.0).collect();
        let laws = effects.iter().map(|name| Law { name: name.clone(), draw: std::array::from_fn(|_| generator.random()) }).collect();
        Self {
            states: vec![0.0; thresholds.len()],
            thresholds,
            weights,
            carries: plant.random_bool(0.4),
            laws,
            length_s: REST_S + super::command::COMMAND_S,
            recordings,
            values: BTreeMap::new(),
        }
    }

    fn tell(&mut self, name: &str, key: &str, value: f64) {
        self.values.insert(format!("{name}.{key}"), value);
    }

    /// One recording.
    pub fn record(&mut self, recording: usize, shape: &Shape) -> Raw {
        let samples = (self.length_s / STEP_S).round() as usize / STEPS_PER_SAMPLE;
        // A few samples more, for a clock that runs ahead.
        let steps = samples * STEPS_PER_SAMPLE + 2000;
        let command: Vec<f64> = (0..steps).map(|step| shape.at(step as f64 * STEP_S - REST_S)).collect();
        let session_s: Vec<f64> = (0..steps).map(|step| recording as f64 * self.length_s + step as f64 * STEP_S).collect();
        let laws = std::mem::take(&mut self.laws);
        let mut path = command.clone();
        for law in &laws {
            self.before(law, &mut path);
        }
        let mut output = self.operators(&laws, &path, (samples - 1) * STEPS_PER_SAMPLE);
        let mut skew = 0.0;
        for law in &laws {
            self.behind(law, recording, &session_s, &mut output);
            if law.name == "clock-skew" {
                skew = (0.002 + 0.008 * law.draw[0]) * if law.draw[1] > 0.5 { 1.0 } else { -1.0 };
                self.tell("clock-skew", "skew", skew);
            }
        }
        let sampled = |signal: &[f64], skew: f64| -> Vec<f64> {
            (0..samples)
                .map(|sample| {
                    let place = (sample * STEPS_PER_SAMPLE) as f64 * (1.0 + skew);
                    let below = (place as usize).min(signal.len() - 2);
                    let share = place - below as f64;
                    signal[below] * (1.0 - share) + signal[below + 1] * share
                })
                .collect()
        };
        let mut recorded = sampled(&output, skew);
        for law in laws.iter().filter(|law| law.name == "outliers") {
            let share = between(law.draw[0], 0.004, 0.03);
            self.tell("outliers", "share", share);
            for (sample, value) in recorded.iter_mut().enumerate() {
                if 0.5 + 0.5 * noise_of(law.draw[1], recording * samples + sample) < share {
                    // A reading from anywhere in the range of the sensor, which is wider than the stroke.
                    *value = 1.2 * noise_of(law.draw[2], recording * samples + sample) + 0.6;
                }
            }
        }
        self.laws = laws;
        let time_s = (0..samples).map(|sample| sample as f64 * STEPS_PER_SAMPLE as f64 * STEP_S).collect();
        (time_s, sampled(&command, 0.0), recorded)
    }

    /// What an effect does to the pressure.
    fn before(&mut self, law: &Law, path: &mut [f64]) {
        let [a, b, c, ..] = law.draw;
        match law.name.as_str() {
            "dead-time" => {
                let delay = between(a, 20.0, 250.0) as usize;
                self.tell("dead-time", "delay_s", delay as f64 * STEP_S);
                path.copy_within(..path.len() - delay, delay);
                path[..delay].fill(0.0);
            }
            "pneumatic-lag" => {
                let time_s = between(a, 0.03, 0.5);
                self.tell("pneumatic-lag", "time_constant_s", time_s);
                lag(path, time_s, time_s);
            }
            "fill-vent-asymmetry" => {
                let (fill_s, ratio) = (between(a, 0.03, 0.2), between(b, 1.6, 5.0));
                if c > 0.4 { lag(path, fill_s, fill_s * ratio) } else { lag(path, fill_s * ratio, fill_s) }
            }
            "slew-limit" => {
                let most = STEP_S * between(a, 0.8, 4.0);
                self.tell("slew-limit", "limit_bar_per_s", most / STEP_S);
                let mut state = path[0];
                for value in path {
                    state += (*value - state).clamp(-most, most);
                    *value = state;
                }
            }
            "valve-dead-band" => {
                let band = SPAN_BAR * between(a, 0.02, 0.12);
                let mut state = path[0];
                let mut moving = false;
                for value in path {
                    let error: f64 = *value - state;
                    if c < 0.4 {
                        // It jumps all the way.
                        if error.abs() > band {
                            state = *value;
                        }
                    } else {
                        moving = error.abs() > if moving { band * (0.05 + 0.3 * b) } else { band };
                        if moving {
                            state += error * STEP_S / 0.03;
                        }
                    }
                    *value = state;
                }
            }
            "supply-saturation" => {
                let limit = SPAN_BAR * (0.6 + 0.33 * a);
                self.tell("supply-saturation", "limit_bar", limit);
                for value in path {
                    *value = value.min(limit);
                }
            }
            "activation-threshold" => {
                let threshold = SPAN_BAR * (0.04 + 0.22 * a);
                self.tell("activation-threshold", "threshold_bar", threshold);
                for value in path {
                    *value = (*value - threshold).max(0.0);
                }
            }
            "static-nonlinearity" if c < 0.5 => {
                let power = if b < 0.5 { 1.2 + 0.5 * a } else { 0.7 + 0.15 * a };
                for value in path {
                    *value = SPAN_BAR * (*value / SPAN_BAR).max(0.0).powf(power);
                }
            }
            "leakage" => {
                let time_s = between(a, 3.0, 30.0);
                let refill_s = if b < 0.5 { f64::MAX } else { time_s * (2.0 + 4.0 * c) };
                let mut state = path[0];
                let mut last = path[0];
                for value in path {
                    state += *value - last - STEP_S * state / time_s + STEP_S * (*value - state) / refill_s;
                    last = *value;
                    state = state.max(0.0);
                    *value = state;
                }
            }
            "sample-and-hold" => {
                let (period, first) = (between(a, 80.0, 500.0) as usize, b);
                self.tell("sample-and-hold", "period_s", period as f64 * STEP_S);
                let begin = (first * period as f64) as usize;
                for step in (begin..path.len()).step_by(period) {
                    let held = path[step];
                    path[step..].iter_mut().take(period).for_each(|value| *value = held);
                }
            }
            "hold-after-reversal" => {
                let hold = between(a, 100.0, 400.0) as usize;
                self.tell("hold-after-reversal", "hold_s", hold as f64 * STEP_S);
                let wanted = path.to_vec();
                let (mut from, mut way) = (0, 0.0);
                for step in 1..path.len() {
                    let moved = wanted[step] - wanted[step - 1];
                    if moved * way < 0.0 && (from == 0 || step > from + hold) {
                        from = step;
                    }
                    way = if moved == 0.0 { way } else { moved };
                    // It jumps when it opens.
                    path[step] = if from > 0 && step <= from + hold { path[step - 1] } else { wanted[step] };
                }
            }
            _ => {}
        }
    }

    /// The play operators, with what an effect does to them. The next recording finds them as they are at step `last`, which is the last
    /// sample: what follows in `path` is there for clocks that run ahead, and no recording tells that the muscle has been through it.
    fn operators(&mut self, laws: &[Law], path: &[f64], last: usize) -> Vec<f64> {
        if !self.carries {
            self.states.fill(0.0);
        }
        let law = |name: &str| laws.iter().find(|law| law.name == name).map(|law| law.draw);
        let (asymmetry, rate, forgetting) = (law("asymmetric-hysteresis"), law("rate-dependent-hysteresis"), law("alien-forgetting"));
        let mut smooth_rate = 0.0;
        let mut output = Vec::with_capacity(path.len());
        let mut at_the_end = Vec::new();
        for (step, &value) in path.iter().enumerate() {
            let speed = (value - path[step.saturating_sub(1)]).abs() / STEP_S;
            smooth_rate += STEP_S / 0.02 * (speed - smooth_rate);
            let (mut up, mut down) = (value, value);
            if let Some([a, b, c, ..]) = asymmetry {
                let size = (0.08 + 0.17 * a) * if b < 0.5 { 1.0 } else { -1.0 };
                let bend = size * value * (1.0 - value / SPAN_BAR);
                // Only the loading branch bends, or both, apart.
                if c < 0.5 { up += bend } else { (up, down) = (up - 0.5 * bend.abs(), down + 0.5 * bend.abs()) }
            }
            let mut sum = 0.0;
            for ((&threshold, &weight), state) in self.thresholds.iter().zip(&self.weights).zip(&mut self.states) {
                let mut gap = threshold;
                if let Some([a, b, ..]) = rate {
                    gap = if b < 0.5 {
                        gap * (1.0 + between(a, 0.04, 0.3) * smooth_rate)
                    } else {
                        gap + between(a, 0.01, 0.06) * smooth_rate
                    };
                }
                *state = (up - gap).max((down + gap).min(*state));
                if let Some([a, ..]) = forgetting
                    && noise_of(a, step / 700) > 0.85
                {
                    // Now and then the muscle shakes itself free.
                    *state += STEP_S / 0.05 * (value - *state);
                }
                sum += weight * *state;
            }
            output.push(sum);
            if step == last {
                at_the_end.clone_from(&self.states);
            }
        }
        self.states = at_the_end;
        output
    }

    /// What an effect does to the displacement.
    fn behind(&mut self, law: &Law, recording: usize, session_s: &[f64], output: &mut [f64]) {
        let [a, b, c, d, e, f] = law.draw;
        let sign = if f < 0.5 { 1.0 } else { -1.0 };
        let whole_s = self.recordings as f64 * self.length_s;
        // A stroke of this rig, roughly.
        let range = SPAN_BAR * self.weights.iter().sum::<f64>() * 0.7;
        match law.name.as_str() {
            "static-nonlinearity" if c >= 0.5 => {
                for value in output {
                    *value = range * (*value / range * (0.5 + 0.7 * a)).tanh();
                }
            }
            "creep" => {
                let sizes = [0.03 + 0.07 * a, 0.03 + 0.1 * b];
                let times_s = [between(c, 0.5, 2.5), between(d, 5.0, 25.0)];
                let mut states = [output[0] * sizes[0], output[0] * sizes[1]];
                for value in output {
                    for element in 0..2 {
                        states[element] += STEP_S * (sizes[element] * *value - states[element]) / times_s[element];
                    }
                    *value += states[0] + states[1];
                }
            }
            "first-cycle-softening" => {
                let (size, travel) = (0.05 + 0.15 * a, range * between(b, 0.8, 5.0));
                let mut travelled = 0.0;
                let mut last = output[0];
                for value in output {
                    travelled += (*value - last).abs();
                    last = *value;
                    *value *= 1.0 - size * (-travelled / travel).exp();
                }
            }
            "stick-slip" => {
                let band = range * (0.025 + 0.06 * a);
                let stop = band * 0.6 * b;
                let mut held = output[0];
                for value in output {
                    let stretch: f64 = *value - held;
                    if stretch.abs() > band {
                        held = *value - stop * stretch.signum();
                    }
                    *value = held;
                }
            }
            "smooth-hysteresis" => {
                // Bouc and Wen's friction with the exponent two; where it turns back it follows the travel.
                let (size, onset) = (range * (0.06 + 0.1 * a) * sign, range * between(b, 0.05, 0.2));
                let (mut friction, mut last) = (0.0_f64, output[0]);
                for value in output {
                    let travel = (*value - last) / onset;
                    last = *value;
                    // A command that steps moves by many onsets at once.
                    let parts = 1 + (travel.abs() / 0.05) as usize;
                    for _ in 0..parts {
                        friction += travel / parts as f64 * (1.0 - if travel * friction > 0.0 { friction * friction } else { 0.0 });
                    }
                    *value += size * friction;
                }
            }
            "resonance" => {
                let (frequency_hz, damping) = (between(a, 1.5, 5.0), between(b, 0.05, 0.4));
                self.tell("resonance", "frequency_hz", frequency_hz);
                let omega = 2.0 * PI * frequency_hz;
                let (mut place, mut speed) = (output[0], 0.0);
                for value in output {
                    speed += STEP_S * (omega * omega * (*value - place) - 2.0 * damping * omega * speed);
                    place += STEP_S * speed;
                    *value = place;
                }
            }
            "periodic-disturbance" => {
                let (frequency_hz, size) = (between(a, 0.8, 4.0), range * (0.012 + 0.04 * b));
                // Some rhythms run on, some are triggered by the recorder.
                let phase = 2.0 * PI * if c < 0.5 { d } else { noise_of(d, recording) };
                for (value, &now_s) in output.iter_mut().zip(session_s) {
                    *value += size * (2.0 * PI * frequency_hz * now_s + phase).sin();
                }
            }
            "offset-drift" => {
                let size = range * (0.03 + 0.12 * a) * sign;
                for (value, &now_s) in output.iter_mut().zip(session_s) {
                    *value += size * if b < 0.6 { now_s / whole_s } else { 0.5 - 0.5 * (PI * (1.5 * now_s / whole_s)).cos() };
                }
            }
            "gain-drift" => {
                let size = (0.06 + 0.16 * a) * sign;
                for (value, &now_s) in output.iter_mut().zip(session_s) {
                    *value *= 1.0 + size * if b < 0.6 { now_s / whole_s } else { 1.0 - (-3.0 * now_s / whole_s).exp() };
                }
            }
            "setup-change" => {
                let first = 3 + (a * (self.recordings as f64 - 8.0)) as usize;
                let second = first + 4;
                let mut times = 0;
                if recording >= first {
                    times += 1;
                }
                if f < 0.3 && recording >= second {
                    times += 1;
                }
                for value in output {
                    for _ in 0..times {
                        *value = *value * (1.0 + (0.03 + 0.12 * b) * if c < 0.5 { 1.0 } else { -1.0 })
                            + if e < 0.3 { 0.0 } else { range * (d - 0.5) * 0.12 };
                    }
                }
            }
            "alien-unseen-force" => {
                for (value, &now_s) in output.iter_mut().zip(session_s) {
                    let knot = now_s / (0.4 + 1.6 * a);
                    let share = 0.5 - 0.5 * (PI * knot.fract()).cos();
                    let at = knot as usize;
                    *value += range * (0.03 + 0.06 * b) * ((1.0 - share) * noise_of(c, at) + share * noise_of(c, at + 1));
                }
            }
            "alien-wall" => {
                let wall = range * (0.45 + 0.3 * a);
                for (value, &now_s) in output.iter_mut().zip(session_s) {
                    if noise_of(b, (now_s / 3.0) as usize) > 0.1 {
                        *value = wall + (*value - wall).min(0.0) + 0.2 * (*value - wall).max(0.0);
                    }
                }
            }
            "alien-alternating-cycles" => {
                let mut high = false;
                let mut cycle = 0_u32;
                let mut gain = 1.0;
                for value in output {
                    let wanted = if cycle % 3 == 1 { 1.0 - 0.06 - 0.1 * a } else { 1.0 };
                    if high && *value < 0.35 * range {
                        high = false;
                        cycle += 1;
                    } else if !high && *value > 0.5 * range {
                        high = true;
                    }
                    gain += STEP_S / 0.05 * (wanted - gain);
                    *value *= gain;
                }
            }
            "alien-two-tone-gain" => {
                let (one_hz, other_hz) = (0.03 + 0.1 * a, 0.2 + 0.5 * b);
                for (value, &now_s) in output.iter_mut().zip(session_s) {
                    *value *= 1.0 + (0.03 + 0.05 * c) * ((2.0 * PI * one_hz * now_s).sin() + (2.0 * PI * other_hz * now_s + d).sin());
                }
            }
            _ => {}
        }
    }
}
