//! The virtual rig: a stand-in for the laboratory that hides a physical effect in its recordings.
//!
//! [`hide`] draws a muscle, an effect (or two, or none, or one that no catalogue has) and a command session, integrates the physics at
//! 10 kHz and samples it at 50 Hz with noise. The truth goes into a file of its own. Nothing here is used by discovery or by
//! the effects that it fits; they meet only in the recordings.
//!
//! # Example
//! ```
//! use virtual_rig::{CaseConfig, EFFECTS, hide};
//!
//! // A session in which a dead time is hidden, and what nobody but a test may look at.
//! assert!(EFFECTS.contains(&"dead-time"));
//! let case = hide(&CaseConfig { effects: vec!["dead-time".to_owned()], seed: 3, ..CaseConfig::default() })?;
//! assert_eq!(case.truth.effects, ["dead-time"]);
//! assert!(case.recordings.iter().all(|run| run.output_signal.unit == "mm"));
//! # Ok::<(), virtual_rig::RigError>(())
//! ```

mod aliens;
mod case;
mod command;
mod composed;
mod draw;
pub mod live;
mod muscle;
mod noise;
mod rival;
mod stages;

use std::path::{Path, PathBuf};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

pub use case::{Case, CaseConfig, Generator, RigError, Truth};
pub use command::Excitation;
use composed::Set;
pub use draw::{ALIENS, EFFECTS};

use draw::{Chain, Sampler};
use noise::add_noise;
use recording::{ExtraColumn, Recording, Signal};
use stages::{Moment, STEP_S};

/// Noise of a pressure sensor, relative to the command's range: 0.2 % is an ordinary industrial one.
const PRESSURE_NOISE: f64 = 0.002;
/// Integration steps per sample: 50 Hz.
const STEPS_PER_SAMPLE: usize = 200;

impl Generator {
    /// Effects that this rig hides and no catalogue has.
    #[must_use]
    pub fn aliens(self) -> &'static [&'static str] {
        match self {
            Self::Physics => &ALIENS,
            Self::Rival => &rival::ALIENS,
            Self::ComposedTuning | Self::ComposedReporting => &composed::ALIENS,
        }
    }
}

/// Makes one hidden case. Equal configurations give equal recordings.
///
/// # Errors
/// When an effect's name is not known.
pub fn hide(config: &CaseConfig) -> Result<Case, RigError> {
    for name in &config.effects {
        if !EFFECTS.contains(&name.as_str()) && !config.generator.aliens().contains(&name.as_str()) {
            let known: Vec<&str> = EFFECTS.iter().chain(config.generator.aliens()).copied().collect();
            return Err(RigError::UnknownEffect { name: name.clone(), known: known.join(", ") });
        }
    }
    let mut plant_draws = ChaCha8Rng::seed_from_u64(config.seed);
    let mut effect_draws = plant_draws.clone();
    effect_draws.set_stream(1);
    let mut command_draws = plant_draws.clone();
    command_draws.set_stream(2);
    let mut noise_draws = plant_draws.clone();
    noise_draws.set_stream(3);
    match config.generator {
        Generator::Physics => {}
        Generator::Rival => return hide_in_rival(config, plant_draws, effect_draws, command_draws, noise_draws),
        Generator::ComposedTuning => return composed::hide(config, Set::Tuning, [plant_draws, effect_draws, command_draws, noise_draws]),
        Generator::ComposedReporting => {
            return composed::hide(config, Set::Reporting, [plant_draws, effect_draws, command_draws, noise_draws]);
        }
    }

    let commands = command::session(config.excitation, &mut command_draws);
    let kept = command::kept_out(config.excitation, &mut command_draws);
    let mut chain = draw::chain(&config.effects, config.excitation, commands.len(), &mut plant_draws, &mut effect_draws);
    let all: Vec<_> = commands.iter().chain(&kept).enumerate().collect();
    // Recordings follow each other with a pause for saving the file.
    let pause_s = 8.0;
    let length_s = command::REST_S + command::COMMAND_S;
    let mut raw = Vec::new();
    for (recording, (name, shape)) in all {
        let start_s = recording as f64 * (length_s + pause_s);
        let (time_s, input, pressure, output) = record(&mut chain, recording, start_s, length_s, &|time| shape.at(time - command::REST_S));
        raw.push((name.clone(), start_s, time_s, input, pressure, output));
    }
    let highest = raw.iter().flat_map(|run| &run.5).copied().fold(f64::MIN, f64::max);
    let lowest = raw.iter().flat_map(|run| &run.5).copied().fold(f64::MAX, f64::min);
    let noise_mm = config.noise * (highest - lowest);
    let mut recordings = Vec::new();
    let mut kept_out = Vec::new();
    for (index, (name, start_s, time_s, input, mut pressure, mut output)) in raw.into_iter().enumerate() {
        add_noise(&mut output, noise_mm, config.coloured_noise, &mut noise_draws);
        chain.sampler.spoil(&mut output, highest - lowest, &mut noise_draws);
        let session: Vec<f64> = time_s.iter().map(|time| time + start_s).collect();
        let path = PathBuf::from(format!("{name}_{index:02}.csv"));
        let mut recording = Recording::new(&path, Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output)?;
        recording.extra.push(ExtraColumn { name: "session_time_s".into(), values: session });
        if config.measured_pressure {
            add_noise(&mut pressure, PRESSURE_NOISE * 2.0 * command::AMPLITUDE_BAR, false, &mut noise_draws);
            recording.extra.push(ExtraColumn { name: "pressure_measured_bar".into(), values: pressure });
        }
        if index < commands.len() { recordings.push(recording) } else { kept_out.push(recording) }
    }
    let truth = Truth {
        effects: config.effects.clone(),
        alien: config.effects.iter().any(|name| ALIENS.contains(&name.as_str())),
        parameters: chain.values,
        sensor_side: chain.sensor_names,
        seed: config.seed,
        noise_mm,
        coloured_noise: config.coloured_noise,
        slack_bar: chain.muscle.slack_bar.clone(),
        pull_mm_per_bar: chain.muscle.pull_mm_per_bar.clone(),
        continuous: chain.continuous,
    };
    Ok(Case { recordings, kept_out, truth })
}

/// A case of the second rig.
fn hide_in_rival(
    config: &CaseConfig,
    mut plant: ChaCha8Rng,
    mut effects: ChaCha8Rng,
    mut command: ChaCha8Rng,
    mut noise: ChaCha8Rng,
) -> Result<Case, RigError> {
    let commands = rival::commands(config.excitation, &mut command);
    let kept = rival::kept_out();
    let mut rig = rival::Rival::new(&config.effects, commands.len(), &mut plant, &mut effects);
    let raw: Vec<(PathBuf, rival::Raw)> = commands
        .iter()
        .chain(&kept)
        .enumerate()
        .map(|(index, (name, shape))| (PathBuf::from(format!("{name}.csv")), rig.record(index, shape)))
        .collect();
    // Wild readings are no part of the range.
    let mut all: Vec<f64> = raw.iter().flat_map(|(_, recording)| recording.2.iter().copied()).collect();
    all.sort_by(f64::total_cmp);
    let noise_mm = config.noise * (all[all.len() - 1 - all.len() / 50] - all[all.len() / 50]);
    let mut recordings = Vec::new();
    for (path, (time_s, input, mut output)) in raw {
        add_noise(&mut output, noise_mm, config.coloured_noise, &mut noise);
        recordings.push(Recording::new(&path, Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output)?);
    }
    let kept_out = recordings.split_off(commands.len());
    let truth = Truth {
        effects: config.effects.clone(),
        alien: config.effects.iter().any(|name| rival::ALIENS.contains(&name.as_str())),
        parameters: rig.values,
        sensor_side: Vec::new(),
        seed: config.seed,
        noise_mm,
        coloured_noise: config.coloured_noise,
        slack_bar: rig.thresholds,
        pull_mm_per_bar: rig.weights,
        continuous: rig.carries,
    };
    Ok(Case { recordings, kept_out, truth })
}

/// Runs one recording: sample times, command, pressure in the muscle and displacement. A skewed clock of the displacement reads at its own times.
fn record(
    chain: &mut Chain,
    recording: usize,
    start_s: f64,
    length_s: f64,
    command_bar: &dyn Fn(f64) -> f64,
) -> (Vec<f64>, Vec<f64>, Vec<f64>, Vec<f64>) {
    let Sampler { skew, .. } = chain.sampler;
    let samples = (length_s / STEP_S).round() as usize / STEPS_PER_SAMPLE;
    let mut output = Vec::with_capacity(samples);
    let mut pressures = Vec::with_capacity(samples);
    let step = |chain: &mut Chain, recording_s: f64, command: f64| {
        let moment = Moment { session_s: start_s + recording_s, recording };
        let mut pressure = command;
        for stage in &mut chain.before {
            pressure = stage.step(pressure, &moment);
        }
        let mut place = chain.muscle.step(pressure);
        for stage in &mut chain.behind {
            place = stage.step(place, &moment);
        }
        (pressure, place)
    };
    // The rig stood at zero for a while: ten seconds nobody recorded, the last one in full.
    let settling = (10.0 / STEP_S) as usize;
    for step_of_rest in 0..settling {
        // A muscle that forgets does so when the line has let go what it held at the end of the last recording, and what hangs on the
        // muscle has time to follow.
        if step_of_rest == settling / 2 && !chain.continuous {
            chain.muscle.relax();
        }
        let _ = step(chain, step_of_rest as f64 * STEP_S - 10.0, 0.0);
    }
    // What the line let go on the way to rest was no stroke after the pause.
    chain.behind.iter_mut().for_each(|stage| stage.pause());
    let mut previous = (0.0, 0.0);
    let mut index = 0_usize;
    let mut next_s = 0.0;
    let mut steps = 0_usize;
    while output.len() < samples {
        let now_s = steps as f64 * STEP_S;
        let value = step(chain, now_s, command_bar(now_s));
        while output.len() < samples && next_s <= now_s {
            let share = if steps == 0 { 1.0 } else { 1.0 - (now_s - next_s) / STEP_S };
            output.push(previous.1 + share * (value.1 - previous.1));
            pressures.push(previous.0 + share * (value.0 - previous.0));
            index += 1;
            next_s = index as f64 * STEPS_PER_SAMPLE as f64 * STEP_S * (1.0 + skew);
        }
        previous = value;
        steps += 1;
    }
    // Let the pressure out before the pause, as anybody does.
    if chain.continuous {
        let last = command_bar(length_s);
        for fall in 0..(1.0 / STEP_S) as usize {
            let now_s = length_s + fall as f64 * STEP_S;
            let _ = step(chain, now_s, last * (1.0 - fall as f64 * STEP_S));
        }
    }
    let time_s: Vec<f64> = (0..samples).map(|sample| sample as f64 * STEPS_PER_SAMPLE as f64 * STEP_S).collect();
    let input = time_s.iter().map(|&time| command_bar(time)).collect();
    (time_s, input, pressures, output)
}

/// Writes a case: `DIR/recordings/*.csv`, `DIR/holdout/*.csv` and, apart from both, `DIR/truth.sealed.json`.
///
/// # Errors
/// When a file cannot be written.
pub fn write(folder: &Path, case: &Case) -> anyhow::Result<()> {
    for (name, recordings) in [("recordings", &case.recordings), ("holdout", &case.kept_out)] {
        for recording in recordings {
            recording::write(&folder.join(name).join(&recording.path), recording)?;
        }
    }
    output::write_json(&folder.join("truth.sealed.json"), &case.truth)
}

#[cfg(test)]
mod tests;
