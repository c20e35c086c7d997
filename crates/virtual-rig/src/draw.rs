//! What the rig draws at random: the muscle, the effects' strengths and on which side of the muscle they sit.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::aliens::Alien;
use super::command::{AMPLITUDE_BAR, Excitation};
use super::muscle::{Muscle, ThresholdLaw};
use super::stages::{
    Bladder, Braid, ChokedFlow, Converter, Geometry, Heart, Hole, KelvinVoigt, LuGreTip, OnOffValve, Orifices, Pendulum, Remount, Rubber,
    ShutAtTurns, Stage, Supply, Tube, Volume, WarmUp,
};

/// Effects that the rig can hide, by the catalogue's names.
pub const EFFECTS: [&str; 24] = [
    "dead-time",
    "pneumatic-lag",
    "fill-vent-asymmetry",
    "slew-limit",
    "valve-dead-band",
    "supply-saturation",
    "activation-threshold",
    "static-nonlinearity",
    "asymmetric-hysteresis",
    "rate-dependent-hysteresis",
    "creep",
    "first-cycle-softening",
    "stick-slip",
    "resonance",
    "periodic-disturbance",
    "offset-drift",
    "gain-drift",
    "setup-change",
    "clock-skew",
    "outliers",
    "leakage",
    "sample-and-hold",
    "hold-after-reversal",
    "smooth-hysteresis",
];

/// Effects that no catalogue entry describes.
pub const ALIENS: [&str; 7] = [
    "alien-breathing-gain",
    "alien-loose-joint",
    "alien-snap-through",
    "alien-hunting",
    "alien-heat",
    "alien-wandering-gain",
    "alien-every-other-stroke",
];

/// What happens while sampling.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sampler {
    /// Relative error of the displacement's clock.
    pub skew: f64,
    /// Share of samples that are wrong.
    pub wrong: f64,
}

impl Sampler {
    /// Puts wrong samples into `output`: spikes, and short drops to a fixed reading.
    pub fn spoil(&self, output: &mut [f64], range: f64, generator: &mut ChaCha8Rng) {
        if self.wrong <= 0.0 {
            return;
        }
        let mut index = 0;
        while index < output.len() {
            if generator.random_bool(self.wrong / 1.5) {
                let length = if generator.random_bool(0.75) { 1 } else { generator.random_range(2..5) };
                let size = range * generator.random_range(0.1..0.6) * if generator.random_bool(0.5) { 1.0 } else { -1.0 };
                for value in output.iter_mut().skip(index).take(length) {
                    *value += size;
                }
                index += length;
            }
            index += 1;
        }
    }
}

/// The whole rig, ready to run.
pub struct Chain {
    /// Stages before the muscle.
    pub before: Vec<Box<dyn Stage>>,
    /// The muscle.
    pub muscle: Muscle,
    /// Stages behind it.
    pub behind: Vec<Box<dyn Stage>>,
    /// The sampling.
    pub sampler: Sampler,
    /// Values drawn.
    pub values: BTreeMap<String, f64>,
    /// Effects behind the muscle.
    pub sensor_names: Vec<String>,
    /// Whether the muscle remembers one recording in the next.
    pub continuous: bool,
}

/// Draws a rig with these effects.
pub fn chain(effects: &[String], excitation: Excitation, recordings: usize, plant: &mut ChaCha8Rng, generator: &mut ChaCha8Rng) -> Chain {
    let count = 20;
    let widest = plant.random_range(0.35..0.9);
    let mut slack_bar: Vec<f64> = (0..count).map(|_| widest * plant.random::<f64>().powf(1.4)).collect();
    slack_bar[0] = 0.0;
    slack_bar.sort_by(f64::total_cmp);
    let mut weights: Vec<f64> = slack_bar.iter().map(|slack| -plant.random::<f64>().ln() * (-1.2 * slack / widest).exp()).collect();
    let elastic = plant.random_range(0.3..0.55);
    let rest: f64 = weights[1..].iter().sum();
    let gain_mm_per_bar = plant.random_range(3.0..5.0);
    for value in &mut weights[1..] {
        *value *= gain_mm_per_bar * (1.0 - elastic) / rest;
    }
    weights[0] = gain_mm_per_bar * elastic;
    let continuous = plant.random_bool(0.3);
    let range_mm = gain_mm_per_bar * 2.0 * AMPLITUDE_BAR * 0.9;
    let mut chain = Chain {
        before: Vec::new(),
        muscle: Muscle::new(slack_bar, weights, ThresholdLaw::default()),
        behind: Vec::new(),
        sampler: Sampler::default(),
        values: BTreeMap::new(),
        sensor_names: Vec::new(),
        continuous,
    };
    let session_s = recordings as f64 * 30.0;
    // Effects take their place in the chain in a random order.
    let mut names: Vec<&String> = effects.iter().collect();
    if names.len() == 2 && generator.random_bool(0.5) {
        names.swap(0, 1);
    }
    for name in names {
        add(&mut chain, name, excitation, recordings, session_s, range_mm, generator);
    }
    chain
}

/// Puts one effect into the chain.
fn add(
    chain: &mut Chain,
    name: &str,
    excitation: Excitation,
    recordings: usize,
    session_s: f64,
    range_mm: f64,
    generator: &mut ChaCha8Rng,
) {
    let rich = excitation == Excitation::Rich;
    let mut values: Vec<(&str, f64)> = Vec::new();
    let mut sensor = false;
    match name {
        "dead-time" => {
            let transit_s = log_uniform(generator, 0.03, 0.25);
            sensor = generator.random_bool(0.5);
            values.push(("delay_s", transit_s));
            let stage = Box::new(Tube::new(transit_s));
            if sensor { chain.behind.push(stage) } else { chain.before.push(stage) }
        }
        "pneumatic-lag" => {
            let slow_s = log_uniform(generator, 0.05, 0.4);
            sensor = generator.random_bool(0.4);
            values.push(("time_constant_s", slow_s));
            let stage = Box::new(Volume { slow_s, fast_s: slow_s * 0.05, spool: 0.0, level: 0.0 });
            if sensor { chain.behind.push(stage) } else { chain.before.push(stage) }
        }
        "fill-vent-asymmetry" => {
            let fill_s = log_uniform(generator, 0.04, 0.2);
            let ratio = log_uniform(generator, 1.8, 4.0);
            values.push(("fill_time_constant_s", fill_s));
            values.push(("vent_time_constant_s", fill_s * ratio));
            chain.before.push(Box::new(Orifices {
                fill_s,
                vent_s: fill_s * ratio,
                choke_bar: log_uniform(generator, 2.0, 8.0),
                level: 0.0,
            }));
        }
        "slew-limit" => {
            // The fastest sine of the session asks for 7.5 bar/s; the limit bites from somewhere below.
            let fastest_bar_per_s = if rich { log_uniform(generator, 2.0, 8.0) } else { log_uniform(generator, 1.5, 5.0) };
            values.push(("limit_bar_per_s", fastest_bar_per_s));
            chain.before.push(Box::new(ChokedFlow { fastest_bar_per_s, fast_s: 0.01, level: 0.0 }));
        }
        "valve-dead-band" => {
            let open_bar = log_uniform(generator, 0.08, 0.4);
            let close_bar = open_bar * generator.random_range(0.05..0.3);
            values.push(("band_bar", open_bar));
            chain.before.push(Box::new(OnOffValve { open_bar, close_bar, flow_s: 0.02, open: false, level: 0.0 }));
        }
        "supply-saturation" => {
            let limit_bar = 2.0 * AMPLITUDE_BAR * generator.random_range(0.6..0.95);
            values.push(("limit_bar", limit_bar));
            chain.before.push(Box::new(Supply { limit_bar, sharpness: log_uniform(generator, 15.0, 60.0) }));
        }
        "activation-threshold" => {
            let touch_bar = log_uniform(generator, 0.15, 0.9);
            values.push(("threshold_bar", touch_bar));
            chain.before.push(Box::new(Bladder { touch_bar, width_bar: log_uniform(generator, 0.01, 0.05) }));
        }
        "static-nonlinearity" => {
            sensor = generator.random_bool(0.5);
            let top = if sensor { range_mm } else { 2.0 * AMPLITUDE_BAR };
            // The angle at full range: 0.5 rad bends a sine by 4 %, 1.1 rad by 19 %.
            let bend = if generator.random_bool(0.5) { 1.0 } else { -1.0 };
            let angle = if bend > 0.0 { log_uniform(generator, 0.6, 1.2) } else { log_uniform(generator, 0.5, 0.9) };
            values.push(("angle_rad", bend * angle));
            let stage = Box::new(Geometry { reach: top / angle, bend });
            if sensor { chain.behind.push(stage) } else { chain.before.push(stage) }
        }
        "asymmetric-hysteresis" => {
            if generator.random_bool(0.5) {
                chain.muscle.law.friction_per_bar = log_uniform(generator, 0.2, 1.0);
                values.push(("friction_per_bar", chain.muscle.law.friction_per_bar));
            } else {
                chain.muscle.law.branch_bend_per_bar = -log_uniform(generator, 0.03, 0.12);
                values.push(("branch_bend_per_bar", chain.muscle.law.branch_bend_per_bar));
            }
        }
        "rate-dependent-hysteresis" => {
            chain.muscle.law.creep_bar_per_s = log_uniform(generator, 0.1, 2.0);
            chain.muscle.law.overstress_bar = log_uniform(generator, 0.02, 0.08);
            values.push(("overstress_bar", chain.muscle.law.overstress_bar));
        }
        "creep" => {
            sensor = generator.random_bool(0.5);
            let total = log_uniform(generator, 0.05, 0.25);
            let first_s = log_uniform(generator, 0.4, 2.0);
            let shares = [generator.random_range(0.3..1.0), generator.random_range(0.3..1.0), generator.random_range(0.3..1.0)];
            let sum: f64 = shares.iter().sum();
            values.push(("total_compliance", total));
            let stage = Box::new(KelvinVoigt {
                compliance: shares.map(|share| share / sum * total),
                time_s: [first_s, first_s * 4.5, first_s * 20.0],
                strain: [0.0; 3],
            });
            if sensor { chain.behind.push(stage) } else { chain.before.push(stage) }
        }
        "first-cycle-softening" => {
            sensor = true;
            let missing = log_uniform(generator, 0.05, 0.25);
            let distance = range_mm * log_uniform(generator, 0.6, 4.0);
            values.push(("missing_gain", missing));
            values.push(("distance_mm", distance));
            chain.behind.push(Box::new(Rubber { missing, distance, bonds: 1.0, last: 0.0 }));
        }
        "stick-slip" => {
            sensor = true;
            let static_mm = range_mm * log_uniform(generator, 0.02, 0.08);
            let sliding_mm = static_mm * generator.random_range(0.2..0.6);
            values.push(("band_mm", static_mm));
            chain.behind.push(Box::new(LuGreTip::stiff(static_mm, sliding_mm)));
        }
        "resonance" => {
            sensor = true;
            let frequency_hz = if rich { log_uniform(generator, 1.5, 6.0) } else { log_uniform(generator, 1.5, 4.0) };
            let damping = log_uniform(generator, 0.05, 0.35);
            values.push(("frequency_hz", frequency_hz));
            values.push(("damping_ratio", damping));
            chain.behind.push(Box::new(Pendulum { frequency_hz, damping, position: 0.0, speed: 0.0 }));
        }
        "periodic-disturbance" => {
            sensor = true;
            let heart = generator.random_bool(0.7);
            let frequency_hz = if heart { log_uniform(generator, 0.9, 1.9) } else { log_uniform(generator, 3.0, 11.0) };
            let overtones = if heart { [generator.random_range(0.1..0.5), generator.random_range(0.0..0.25)] } else { [0.0, 0.0] };
            let size_mm = range_mm * log_uniform(generator, 0.01, 0.04);
            values.push(("frequency_hz", frequency_hz));
            values.push(("amplitude_mm", size_mm));
            chain.behind.push(Box::new(Heart { frequency_hz, size_mm, overtones, phase: generator.random_range(0.0..2.0 * PI) }));
        }
        "offset-drift" => {
            sensor = true;
            let size = range_mm * log_uniform(generator, 0.02, 0.1) * sign(generator);
            values.push(("drift_mm", size));
            let time_s = session_s * generator.random_range(0.3..1.5);
            chain.behind.push(Box::new(WarmUp { size, time_s, gain: false }));
        }
        "gain-drift" => {
            sensor = true;
            let size = generator.random_range(0.06..0.25) * sign(generator);
            values.push(("drift", size));
            let time_s = session_s * generator.random_range(0.3..1.5);
            chain.behind.push(Box::new(WarmUp { size, time_s, gain: true }));
        }
        "setup-change" => {
            sensor = true;
            let from = generator.random_range(4..recordings.max(9) - 4);
            let shift_mm = range_mm * generator.random_range(0.02..0.08) * sign(generator);
            let gain = 1.0 + generator.random_range(0.0..0.12) * sign(generator);
            values.push(("from_recording", from as f64));
            values.push(("shift_mm", shift_mm));
            values.push(("gain", gain));
            chain.behind.push(Box::new(Remount { from, shift_mm, gain }));
        }
        "clock-skew" => {
            sensor = true;
            chain.sampler.skew = generator.random_range(0.001..0.008) * sign(generator);
            values.push(("skew", chain.sampler.skew));
        }
        "outliers" => {
            sensor = true;
            chain.sampler.wrong = generator.random_range(0.003..0.02);
            values.push(("share", chain.sampler.wrong));
        }
        "leakage" => {
            let time_s = if generator.random_bool(0.5) { generator.random_range(4.0..12.0) } else { generator.random_range(12.0..40.0) };
            values.push(("time_constant_s", time_s));
            chain.before.push(Box::new(Hole { time_s, last_bar: 0.0, level: 0.0 }));
        }
        "sample-and-hold" => {
            let period_s = log_uniform(generator, 0.08, 0.5);
            values.push(("period_s", period_s));
            let left_s = period_s * generator.random::<f64>();
            chain.before.push(Box::new(Converter { period_s, first_s: left_s, left_s, recording: 0, held_bar: 0.0 }));
        }
        "hold-after-reversal" => {
            let hold_s = log_uniform(generator, 0.1, 0.4);
            values.push(("hold_s", hold_s));
            let flow_bar = log_uniform(generator, 8.0, 40.0);
            chain.before.push(Box::new(ShutAtTurns { hold_s, flow_bar, left_s: 0.0, top_bar: 0.0, sign: 1.0, level: 0.0 }));
        }
        "smooth-hysteresis" => {
            let bound_bar = log_uniform(generator, 0.15, 0.6);
            let share = generator.random_range(0.6..0.95);
            values.extend([("bound_bar", bound_bar), ("share", share)]);
            chain.before.push(Box::new(Braid { bound_bar, share, friction_bar: 0.0, last_bar: 0.0 }));
        }
        alien => {
            sensor = true;
            chain.behind.push(Box::new(draw_alien(alien, session_s, range_mm, generator)));
        }
    }
    for (key, value) in values {
        chain.values.insert(format!("{name}.{key}"), value);
    }
    if sensor {
        chain.sensor_names.push(name.to_owned());
    }
}

/// A value between `low` and `high`, even in its logarithm.
fn log_uniform(generator: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    low * (high / low).powf(generator.random::<f64>())
}

fn sign(generator: &mut ChaCha8Rng) -> f64 {
    if generator.random_bool(0.5) { 1.0 } else { -1.0 }
}

fn draw_alien(name: &str, session_s: f64, range_mm: f64, generator: &mut ChaCha8Rng) -> Alien {
    let longest_s = session_s + 400.0;
    match name {
        "alien-breathing-gain" => {
            Alien::BreathingGain { depth: generator.random_range(0.03..0.1), frequency_hz: generator.random_range(0.05..0.35) }
        }
        "alien-loose-joint" => {
            let mut jumps_s = Vec::new();
            let mut time = 0.0;
            while time < longest_s {
                time += generator.random_range(1.0..9.0);
                jumps_s.push(time);
            }
            Alien::LooseJoint { depth: generator.random_range(0.05..0.15), jumps_s }
        }
        "alien-snap-through" => {
            let forward_mm = range_mm * generator.random_range(0.45..0.7);
            Alien::SnapThrough {
                forward_mm,
                back_mm: forward_mm - range_mm * generator.random_range(0.15..0.35),
                size_mm: range_mm * generator.random_range(0.04..0.12) * if generator.random_bool(0.5) { 1.0 } else { -1.0 },
                over: false,
                place_mm: 0.0,
            }
        }
        "alien-hunting" => Alien::Hunting {
            above: range_mm * generator.random_range(0.3..0.6),
            size: generator.random_range(0.05..0.2),
            frequency_hz: generator.random_range(2.5..6.0),
            phase: 0.0,
        },
        "alien-heat" => Alien::Heat {
            size: generator.random_range(0.05..0.15),
            speed: range_mm * 0.6,
            time_s: generator.random_range(3.0..9.0),
            heat: 0.0,
            last: 0.0,
        },
        "alien-wandering-gain" => {
            let spacing_s = generator.random_range(2.0..6.0);
            let knots = (0..(longest_s / spacing_s) as usize + 3).map(|_| generator.random_range(-1.0..1.0)).collect();
            Alien::WanderingGain { depth: generator.random_range(0.06..0.2), knots, spacing_s }
        }
        _ => Alien::EveryOtherStroke {
            size: range_mm * generator.random_range(0.03..0.1),
            rising: false,
            turns: 0,
            extreme: 0.0,
            travel: range_mm * 0.05,
            state: 0.0,
        },
    }
}
