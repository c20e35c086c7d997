//! A third virtual rig, composed at random: a bank of play operators of any density, laws from [`laws`], a random order, sampling and noise.
//!
//! Every effect has several laws, split into two sets; in that to tune on, some have a second law, for odd
//! seeds, and a third, for every third seed from [`FIRST_OF_THREE`]. Choices about discovery look at [`Set::Tuning`] alone; [`Set::Reporting`] judges, so no
//! form is chosen on a law that it is judged by. The other rigs share no law with this one.

mod draw;
mod eighth_laws;
mod eighth_laws_of_time;
mod fifth_laws;
mod fifth_laws_of_time;
mod fourth_laws;
mod fourth_laws_of_time;
mod ladders_of_time;
mod laws;
mod motion;
mod muscle;
mod ninth_laws;
mod reporting;
mod second_laws;
mod second_reporting;
mod session;
mod seventh_laws;
mod seventh_laws_of_time;
mod sixth_laws;
mod smooth_laws;
mod third_laws;

use std::collections::BTreeMap;
use std::path::PathBuf;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

pub use draw::Set;

use crate::case::{Case, CaseConfig, RigError, Truth};
use crate::noise::{add_noise, normal};
use draw::{Draw, Moment, STEP_S, Stage};
use muscle::Muscle;
use recording::{ExtraColumn, Recording, Signal};
use session::{LENGTH_S, RECORDINGS, REST_S, commands};

/// Effects that the catalogue does not have, of this rig.
pub const ALIENS: [&str; 3] = ["alien-two-way-gain", "alien-temperature-steps", "alien-input-noise"];

/// First seed of which every third draws a third law: earlier ones stay what they were.
pub const FIRST_OF_THREE: u64 = 4000;

/// First seed to tune on that draws laws written without knowledge of the catalogue, two for every effect: one for even seeds, one for odd.
pub const FIRST_OF_STRANGERS: u64 = 5000;

/// First seed to report on that draws such laws.
pub const FIRST_OF_STRANGERS_REPORTING: u64 = 9500;

/// First seed to tune on that draws textbook laws, again one for even seeds and one for odd.
pub const FIRST_OF_TEXTBOOKS: u64 = 6000;

/// First seed to tune on that draws one law of a ladder of them, where an effect has one.
pub const FIRST_OF_LADDERS: u64 = 8000;

/// First seed to tune on that draws one law of many, written by an outsider, for eleven effects.
pub const FIRST_OF_SEVENTH: u64 = 8300;

/// First of a hundred seeds to tune on that draw one of as many others.
pub const FIRST_OF_EIGHTH: u64 = 8400;

/// First of a hundred seeds to tune on that draw one supply of five.
pub const FIRST_OF_NINTH: u64 = 8500;

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
        let drawn = match set {
            _ if name == "smooth-hysteresis" => smooth_laws::smooth_hysteresis(set, &mut draw),
            Set::Tuning if name == "supply-saturation" && (FIRST_OF_NINTH..FIRST_OF_NINTH + 100).contains(&config.seed) => {
                ninth_laws::supply_saturation(config.seed, &mut draw)
            }
            Set::Tuning if (FIRST_OF_EIGHTH..FIRST_OF_EIGHTH + 100).contains(&config.seed) => {
                seventh_laws::tuning(&eighth_laws::LAWS, name, config.seed, &mut draw)
            }
            Set::Tuning if (FIRST_OF_SEVENTH..FIRST_OF_EIGHTH).contains(&config.seed) => {
                seventh_laws::tuning(&seventh_laws::LAWS, name, config.seed, &mut draw)
            }
            Set::Tuning if config.seed >= FIRST_OF_LADDERS => sixth_laws::tuning(name, config.seed, &mut draw),
            Set::Tuning if config.seed >= FIRST_OF_TEXTBOOKS => fifth_laws::tuning(name, config.seed % 2, &mut draw),
            Set::Tuning if config.seed >= FIRST_OF_STRANGERS => fourth_laws::tuning(name, config.seed % 2, &mut draw),
            Set::Tuning if config.seed >= FIRST_OF_THREE && config.seed % 3 == 2 => third_laws::tuning(name, &mut draw),
            Set::Tuning if config.seed % 2 == 1 => second_laws::tuning(name, &mut draw),
            Set::Tuning => laws::tuning(name, &mut draw),
            Set::Reporting if config.seed >= FIRST_OF_STRANGERS_REPORTING => second_reporting::reporting(name, &mut draw),
            Set::Reporting => reporting::reporting(name, &mut draw),
        };
        match drawn {
            laws::Drawn::Before(stage) => before.push(stage),
            laws::Drawn::Muscle(law) => muscle.law = law,
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
        let start_s = recording as f64 * (LENGTH_S + pause_s);
        let mut fine = Vec::new();
        // What the rig does at rest before each recording is nobody's to see. A muscle that forgets does so when the line has let go: else it would go
        // through a stroke that no recording shows.
        for step in -5000..(LENGTH_S / STEP_S) as i64 + 500 {
            if step == -2000 {
                muscle.begin();
            }
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

#[cfg(test)]
mod tests {
    //! Every one of many laws stays finite and shows.

    use super::{FIRST_OF_EIGHTH, FIRST_OF_NINTH, FIRST_OF_SEVENTH, ninth_laws::SUPPLIES, seventh_laws::COUNTS};
    use crate::{Case, CaseConfig, Excitation, Generator, hide};

    fn make(effects: Vec<String>, seed: u64) -> Case {
        let (excitation, generator) = (Excitation::Rich, Generator::ComposedTuning);
        hide(&CaseConfig { effects, seed, noise: 0.0, excitation, generator, ..CaseConfig::default() }).expect("a case")
    }

    #[test]
    fn every_law_of_an_outsider_stays_finite_and_shows_on_some_recordings() {
        for seed in [FIRST_OF_SEVENTH, FIRST_OF_EIGHTH, FIRST_OF_NINTH].into_iter().flat_map(|first| first..first + 6) {
            let plain = make(Vec::new(), seed);
            let range = plain.recordings.iter().flat_map(|run| &run.output).fold(0.0_f64, |top, value| top.max(*value));
            // As many seeds in a row as there are laws draw each of them.
            let counts = if seed < FIRST_OF_NINTH { &COUNTS[..] } else { &[("supply-saturation", SUPPLIES)] };
            for (name, _) in counts.iter().filter(|(_, count)| seed % 100 < *count) {
                let hidden = make(vec![(*name).to_owned()], seed);
                let pairs = plain.recordings.iter().zip(&hidden.recordings);
                let shares = pairs.map(|(before, after)| {
                    assert!(after.output.iter().all(|value| value.is_finite() && value.abs() < 3.0 * range), "{seed}: {name}");
                    let sum = before.output.iter().zip(&after.output).map(|(x, y)| (x - y).powi(2)).sum::<f64>();
                    (sum / before.output.len() as f64).sqrt() / range
                });
                let shares: Vec<f64> = shares.collect();
                assert!(
                    shares.iter().any(|share| (0.01..0.25).contains(share)),
                    "{seed}: {name} changes the recordings by {shares:.3?} of range"
                );
            }
        }
    }
}
