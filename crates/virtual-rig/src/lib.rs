//! The virtual rig: a stand-in for the laboratory that hides a physical effect in its recordings.
//!
//! [`hide`] draws a muscle, an effect (or two, or none, or one that no catalogue has) and a command session, integrates the physics at
//! 10 kHz and samples it at 50 Hz with noise. The truth goes into a file of its own. Nothing here is used by discovery or by
//! the effects that it fits; they meet only in the recordings.

mod command;
mod composed;
mod draw;
pub mod live;
mod muscle;
mod rival;
mod stages;

use std::path::{Path, PathBuf};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

pub use command::Excitation;
use composed::Set;
pub use draw::{ALIENS, EFFECTS};

use draw::{Chain, Sampler};
use recording::{ExtraColumn, Recording, RecordingError, Signal};
use stages::{Moment, STEP_S};

/// Noise of a pressure sensor, relative to the command's range: 0.2 % is an ordinary industrial one.
const PRESSURE_NOISE: f64 = 0.002;
/// Integration steps per sample: 50 Hz.
const STEPS_PER_SAMPLE: usize = 200;

/// Which of the virtual rigs makes the recordings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Generator {
    /// Physics at 10 kHz.
    #[default]
    Physics,
    /// Discrete laws at 1 kHz, other forms and strengths.
    Rival,
    /// Laws drawn for every effect, of the set that choices may look at.
    ComposedTuning,
    /// Laws drawn for every effect, of the set that only judges.
    ComposedReporting,
}

/// What to hide and how.
#[derive(Clone, Debug)]
pub struct CaseConfig {
    /// Names of the effects or aliens; none for a rig without a secret.
    pub effects: Vec<String>,
    /// Seed of everything that is drawn.
    pub seed: u64,
    /// Standard deviation of the noise relative to the output's range.
    pub noise: f64,
    /// Whether half of the noise is correlated in time.
    pub coloured_noise: bool,
    /// Kind of session.
    pub excitation: Excitation,
    /// The rig.
    pub generator: Generator,
    /// Whether the pressure in the muscle is recorded too (the physics rig only), with noise of 0.2 % of its range.
    pub measured_pressure: bool,
}

impl Default for CaseConfig {
    /// Nothing hidden in the paper's session with half a percent of white noise.
    fn default() -> Self {
        Self {
            effects: Vec::new(),
            seed: 1,
            noise: 0.005,
            coloured_noise: false,
            excitation: Excitation::Paper,
            generator: Generator::Physics,
            measured_pressure: false,
        }
    }
}

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

/// What was hidden.
#[derive(Clone, Debug, Serialize)]
pub struct Truth {
    /// Names.
    pub effects: Vec<String>,
    /// Whether any of them is outside the catalogue.
    pub alien: bool,
    /// Values drawn, `effect.parameter_unit`.
    pub parameters: std::collections::BTreeMap<String, f64>,
    /// Stages behind the muscle (the others lie before it).
    pub sensor_side: Vec<String>,
    /// Seed.
    pub seed: u64,
    /// Standard deviation of the noise, mm.
    pub noise_mm: f64,
    /// Whether the noise is coloured.
    pub coloured_noise: bool,
    /// Half dead travel of the sliders, bar.
    pub slack_bar: Vec<f64>,
    /// Their displacement, mm/bar.
    pub pull_mm_per_bar: Vec<f64>,
    /// Whether the muscle remembers one recording in the next.
    pub continuous: bool,
}

/// A hidden case: recordings to work with, recordings of other kinds to judge by, and the truth.
#[derive(Clone, Debug)]
pub struct Case {
    /// The session.
    pub recordings: Vec<Recording>,
    /// Kept-out recordings, the same rig later in the session.
    pub kept_out: Vec<Recording>,
    /// What was hidden.
    pub truth: Truth,
}

/// What can go wrong.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// No such effect.
    #[error("the rig cannot hide {name:?}; it knows {known}")]
    UnknownEffect {
        /// Name asked for.
        name: String,
        /// Names there are.
        known: String,
    },
    /// A recording could not be made.
    #[error(transparent)]
    Recording(#[from] RecordingError),
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

/// A normal deviate by the polar method.
fn normal(generator: &mut ChaCha8Rng) -> f64 {
    loop {
        let (x, y): (f64, f64) = (generator.random_range(-1.0..1.0), generator.random_range(-1.0..1.0));
        let square = x * x + y * y;
        if square > 0.0 && square < 1.0 {
            return x * (-2.0 * square.ln() / square).sqrt();
        }
    }
}

fn add_noise(output: &mut [f64], deviation: f64, coloured: bool, generator: &mut ChaCha8Rng) {
    // Correlated over a tenth of a second: five samples at 50 Hz.
    let keep = (-0.02_f64 / 0.1).exp();
    let kick = (1.0 - keep * keep).sqrt();
    let mut slow = normal(generator);
    for value in output {
        slow = keep * slow + kick * normal(generator);
        let white = normal(generator);
        *value += deviation * if coloured { std::f64::consts::FRAC_1_SQRT_2 * (white + slow) } else { white };
    }
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
