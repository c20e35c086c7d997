//! A third virtual rig, composed at random: a bank of play operators of any density, laws from [`laws`], a random order, sampling and noise.
//!
//! Every effect has several laws, split into two sets. Choices about discovery look at [`Set::Tuning`] alone; [`Set::Reporting`] judges, so no
//! form is chosen on a law that it is judged by. The other rigs share no law with this one.

mod laws;

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::path::PathBuf;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::command::{Excitation, Shape};
use super::{Case, CaseConfig, RigError, Truth, add_noise, normal};
use recording::{ExtraColumn, Recording, Signal};

/// Integration step, s.
const STEP_S: f64 = 1e-3;
/// Length of a recording, s.
const LENGTH_S: f64 = 20.0;
/// Rest at the start of a recording, s.
const REST_S: f64 = 1.5;
/// Recordings to work with.
const RECORDINGS: usize = 20;

/// Effects that the catalogue does not have, of this rig.
pub const ALIENS: [&str; 3] = ["alien-two-way-gain", "alien-temperature-steps", "alien-input-noise"];

/// Which laws a case is drawn from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Set {
    /// Laws that choices may look at.
    Tuning,
    /// Laws that only judge.
    Reporting,
}

/// Where and when a step happens.
#[derive(Clone, Copy, Debug)]
struct Moment {
    /// Time since the session began, s.
    session_s: f64,
    /// Number of the recording.
    recording: usize,
    /// Whether this is the first step of a recording: what a pause resets begins anew.
    begins: bool,
}

/// What a signal passes: its value one integration step later.
type Stage = Box<dyn FnMut(f64, &Moment) -> f64>;

/// What a law may draw from and must tell.
struct Draw<'a> {
    generator: &'a mut ChaCha8Rng,
    /// Largest command, bar.
    span_bar: f64,
    /// Displacement at that, mm, roughly.
    range_mm: f64,
    /// Length of the session, s.
    session_s: f64,
    excitation: Excitation,
    /// Values drawn, by the catalogue's names.
    values: BTreeMap<String, f64>,
}

impl Draw<'_> {
    /// A value between `low` and `high`.
    fn even(&mut self, low: f64, high: f64) -> f64 {
        self.generator.random_range(low..high)
    }

    /// A value between `low` and `high`, even in its logarithm.
    fn log(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.generator.random::<f64>())
    }

    fn sign(&mut self) -> f64 {
        if self.generator.random_bool(0.5) { 1.0 } else { -1.0 }
    }

    fn tell(&mut self, key: &str, value: f64) -> f64 {
        self.values.insert(key.to_owned(), value);
        value
    }
}

/// How the muscle deviates from a bank of plain play operators.
#[derive(Clone, Copy, Debug, Default)]
struct Habit {
    /// Loading and unloading envelopes: powers of the input over its span, one for plain.
    powers: Option<[f64; 2]>,
    /// Thresholds grow towards one end of the range by this share.
    taper: f64,
    /// Thresholds grow by this times the logarithm of the rate over a bar per second.
    logarithmic_rate: f64,
    /// Time constant of the operators' own motion at high load, s.
    sliding_s: f64,
}

/// The bank of play operators.
struct Muscle {
    thresholds_bar: Vec<f64>,
    weights_mm_per_bar: Vec<f64>,
    states: Vec<f64>,
    habit: Habit,
    carries: bool,
    last: f64,
    rate: f64,
    span_bar: f64,
}

impl Muscle {
    fn draw(generator: &mut ChaCha8Rng, span_bar: f64) -> Self {
        let count = generator.random_range(8..80);
        let widest = span_bar * generator.random_range(0.25..0.5);
        // Exponential, even or heaped around one threshold.
        let shape = generator.random_range(0..3);
        let heap = generator.random_range(0.2..0.8);
        let thresholds_bar: Vec<f64> = (0..count).map(|index| widest * f64::from(index) / f64::from(count)).collect();
        let mut weights: Vec<f64> = thresholds_bar
            .iter()
            .map(|threshold| {
                let share = threshold / widest;
                match shape {
                    0 => (-2.0 * share).exp(),
                    1 => generator.random_range(0.5..1.5),
                    _ => (-((share - heap) / 0.15).powi(2)).exp() + 0.05,
                }
            })
            .collect();
        let elastic = generator.random_range(0.3..0.6);
        let sum: f64 = weights[1..].iter().sum();
        let gain = generator.random_range(1.0..6.0);
        weights[1..].iter_mut().for_each(|weight| *weight *= gain * (1.0 - elastic) / sum);
        weights[0] = gain * elastic;
        let states = vec![0.0; weights.len()];
        let carries = generator.random_bool(0.4);
        Self { thresholds_bar, weights_mm_per_bar: weights, states, habit: Habit::default(), carries, last: 0.0, rate: 0.0, span_bar }
    }

    fn begin(&mut self) {
        if !self.carries {
            self.states.fill(0.0);
        }
        (self.last, self.rate) = (0.0, 0.0);
    }

    fn step(&mut self, input: f64) -> f64 {
        let habit = self.habit;
        self.rate += 0.05 * ((input - self.last).abs() / STEP_S - self.rate);
        self.last = input;
        let share = (input / self.span_bar).clamp(0.0, 1.2);
        let [up, down] = habit.powers.map_or([input; 2], |powers| powers.map(|power| self.span_bar * share.powf(power)));
        let wider = 1.0 + habit.taper * share + habit.logarithmic_rate * self.rate.ln_1p();
        let mut sum = 0.0;
        for ((threshold, weight), state) in self.thresholds_bar.iter().zip(&self.weights_mm_per_bar).zip(&mut self.states) {
            let gap = threshold * wider;
            let aim = (up - gap).max((down + gap).min(*state));
            *state += (aim - *state) * if habit.sliding_s > 0.0 && *threshold > 0.0 { STEP_S / (STEP_S + habit.sliding_s) } else { 1.0 };
            sum += weight * *state;
        }
        sum
    }
}

/// The commands of a session, with a short name each.
fn commands(kind: Excitation, span_bar: f64, generator: &mut ChaCha8Rng) -> Vec<(String, Shape)> {
    let one = |index: usize, generator: &mut ChaCha8Rng| {
        let frequency_hz = 0.12 * (9.0_f64).powf(generator.random::<f64>());
        let decay_per_s = generator.random_range(0.0..0.2);
        let sine = Shape::Sine { amplitude_bar: 0.5 * span_bar, decay_per_s, frequency_hz, sweep_hz_per_s: 0.0 };
        let levels = |generator: &mut ChaCha8Rng, dwell_s: f64, ramp_s: f64| Shape::Levels {
            levels_bar: (0..(LENGTH_S / dwell_s) as usize).map(|_| generator.random_range(0.0..span_bar)).collect(),
            dwell_s,
            ramp_s,
        };
        match (kind, index % 5) {
            (Excitation::Rich, 1) => ("steps", levels(generator, 1.6, 0.01)),
            (Excitation::Rich, 2) => ("ramps", levels(generator, 1.1, 1.1)),
            (Excitation::Rich, 3) => {
                let lines = (1..=10_u32)
                    .map(|line| {
                        let frequency = f64::from(line) * 0.37;
                        (0.28 * span_bar / f64::from(line).sqrt() / 2.0, frequency, generator.random_range(0.0..2.0 * PI))
                    })
                    .collect();
                ("multisine", Shape::Multisine { middle_bar: 0.45 * span_bar, lines })
            }
            (Excitation::Rich, 4) => (
                "triangle",
                Shape::Triangle {
                    peak_bar: span_bar * generator.random_range(0.5..1.0),
                    decay_per_s: 0.03,
                    frequency_hz: 1.5 * frequency_hz,
                },
            ),
            _ => ("sine", sine),
        }
    };
    (0..RECORDINGS + 4)
        .map(|index| {
            let (name, shape) = one(index, generator);
            (format!("{name}_{index:02}.csv"), shape)
        })
        .collect()
}

/// Makes one hidden case of this rig.
pub fn hide(config: &CaseConfig, set: Set, [mut plant, mut effects, mut command, mut noise]: [ChaCha8Rng; 4]) -> Result<Case, RigError> {
    let span_bar = plant.random_range(1.5..2.9);
    let all = commands(config.excitation, span_bar, &mut command);
    let mut muscle = Muscle::draw(&mut plant, span_bar);
    let pause_s = plant.random_range(3.0..20.0);
    let range_mm = 0.9 * span_bar * muscle.weights_mm_per_bar.iter().sum::<f64>();
    let mut draw = Draw {
        generator: &mut effects,
        span_bar,
        range_mm,
        session_s: RECORDINGS as f64 * (LENGTH_S + pause_s),
        excitation: config.excitation,
        values: BTreeMap::new(),
    };
    let mut names: Vec<&String> = config.effects.iter().collect();
    if names.len() == 2 && draw.generator.random_bool(0.5) {
        names.swap(0, 1);
    }
    let (mut before, mut behind): (Vec<Stage>, Vec<Stage>) = (Vec::new(), Vec::new());
    let (mut sensor_side, mut skew, mut wrong) = (Vec::new(), 0.0, 0.0);
    for name in names {
        match laws::draw(name, set, &mut draw) {
            laws::Drawn::Before(stage) => before.push(stage),
            laws::Drawn::Muscle(habit) => muscle.habit = habit,
            laws::Drawn::Behind(stage) => {
                behind.push(stage);
                sensor_side.push(name.clone());
            }
            laws::Drawn::Clock(rate) => skew = rate,
            laws::Drawn::Readings(share) => wrong = share,
        }
    }
    let values = std::mem::take(&mut draw.values);
    let rate_hz = [40.0, 50.0, 100.0][plant.random_range(0..3)];
    let samples = (LENGTH_S * rate_hz) as usize;
    let mut raw = Vec::new();
    for (recording, (name, shape)) in all.iter().enumerate() {
        muscle.begin();
        let start_s = recording as f64 * (LENGTH_S + pause_s);
        let mut fine = Vec::new();
        // What the rig does at rest before each recording is nobody's to see.
        for step in -2000..(LENGTH_S / STEP_S) as i64 + 500 {
            let time_s = step as f64 * STEP_S;
            let moment = Moment { session_s: start_s + time_s, recording, begins: step == 0 };
            // Behind the end the command holds, for clocks that run ahead: the muscle goes through nothing that no recording shows.
            let mut value = shape.at(time_s.min(LENGTH_S - 1.0 / rate_hz) - REST_S);
            before.iter_mut().for_each(|stage| value = stage(value, &moment));
            value = muscle.step(value);
            behind.iter_mut().for_each(|stage| value = stage(value, &moment));
            if step >= 0 {
                fine.push(value);
            }
        }
        let time_s: Vec<f64> = (0..samples).map(|sample| sample as f64 / rate_hz).collect();
        let output: Vec<f64> = time_s
            .iter()
            .map(|time| {
                let place = time * (1.0 + skew) / STEP_S;
                let below = (place as usize).min(fine.len() - 2);
                fine[below] + (place - below as f64) * (fine[below + 1] - fine[below])
            })
            .collect();
        let input = time_s.iter().map(|time| shape.at(time - REST_S)).collect();
        raw.push((name, start_s, time_s, input, output));
    }
    let mut sorted: Vec<f64> = raw.iter().flat_map(|run| run.4.iter().copied()).collect();
    sorted.sort_by(f64::total_cmp);
    let range = sorted[sorted.len() - 1 - sorted.len() / 200] - sorted[sorted.len() / 200];
    let noise_mm = config.noise * range;
    // A third of the rigs read the displacement in steps as fine as the noise.
    let step_mm = if plant.random_bool(0.33) { 0.5 * noise_mm } else { 0.0 };
    let mut recordings = Vec::new();
    for (name, start_s, time_s, input, mut output) in raw {
        add_noise(&mut output, noise_mm, config.coloured_noise, &mut noise);
        for value in &mut output {
            if wrong > 0.0 && noise.random_bool(wrong) {
                *value += range * (0.2 + 0.2 * normal(&mut noise).abs()) * if noise.random_bool(0.5) { 1.0 } else { -1.0 };
            }
            if step_mm > 0.0 {
                *value = (*value / step_mm).round() * step_mm;
            }
        }
        let session = time_s.iter().map(|time| time + start_s).collect();
        let path = PathBuf::from(name);
        let mut recording = Recording::new(&path, Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output)?;
        recording.extra.push(ExtraColumn { name: "session_time_s".into(), values: session });
        recordings.push(recording);
    }
    let kept_out = recordings.split_off(RECORDINGS);
    let truth = Truth {
        effects: config.effects.clone(),
        alien: config.effects.iter().any(|name| ALIENS.contains(&name.as_str())),
        parameters: values,
        sensor_side,
        seed: config.seed,
        noise_mm,
        coloured_noise: config.coloured_noise,
        slack_bar: muscle.thresholds_bar,
        pull_mm_per_bar: muscle.weights_mm_per_bar,
        continuous: muscle.carries,
    };
    Ok(Case { recordings, kept_out, truth })
}
