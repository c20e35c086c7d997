//! `catheter simulate`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::Serialize;

use super::{Common, Outcome};
use crate::excitation::sets::SetConfig;
use crate::excitation::{self, Limits};
use crate::plant::Plant;
use crate::plant::dataset::{self, Dataset, SetKind};
use crate::recording::{self, Recording};
use crate::{output, report, say};

/// Make data sets with the simulated rig.
///
/// Excitations are checked against the rig's limits before any is played; the plant is the paper's Prandtl-Ishlinskii model, to which
/// real effects can be added. A set is DIR/train/*.csv and DIR/test/{a,b,c,d}*.csv, with the files that made it in DIR/excitation and
/// DIR/plant.toml: any of them can be played again.
#[derive(clap::Args)]
#[command(after_long_help = "\
Examples:
  catheter simulate paper --out data/paper            the paper's 24 training recordings and four test families
  catheter simulate rich --out data/rich --seed 7     192 recordings with holds, reversals and random histories
  catheter simulate rich --out data/all --plant all-effects
  catheter simulate paper --out data/a15 --amplitude-bar 1.5 --noise-bar 0     the paper's experiment
  catheter simulate lab --out data/lab                one of each: staircase, triangle, chirp, multisine, reversals, steps, hold
  catheter simulate staircase.toml --out run.csv      one excitation file

An excitation file:
  sample_period_s = 0.02
  noise_bar = 0.1
  seed = 7
  [[segments]]
  duration_s = 20.0
  signal = { kind = \"descending-sine\", amplitude_bar = 1.0, frequency_hz = 0.3, decay_per_s = 0.12 }")]
pub struct Arguments {
    /// `paper`, `rich`, `lab`, or an excitation file.
    #[arg(value_name = "paper|rich|lab|FILE.toml")]
    what: String,
    /// Folder for the recordings; for one excitation file also the name of a CSV file.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// `pi` (the paper's model), `all-effects` (the same with every effect), or a plant file.
    #[arg(long, default_value = "pi", value_name = "FILE|pi|all-effects")]
    plant: String,
    /// A of eq. (1) in bar; the pressure reaches twice as much. For sets.
    #[arg(long, default_value_t = 1.0, value_name = "BAR", value_parser = positive)]
    amplitude_bar: f64,
    /// Upper end of the uniform noise on the input. For sets.
    #[arg(long, default_value_t = 0.1, value_name = "BAR", value_parser = not_negative)]
    noise_bar: f64,
    /// Test recordings of each family. For sets.
    #[arg(long, default_value_t = 3, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1000))]
    tests: u16,
    /// The rig's highest pressure.
    #[arg(long, default_value_t = Limits::default().maximum_bar, value_name = "BAR", value_parser = positive)]
    maximum_pressure_bar: f64,
    /// The rig's fastest change of pressure.
    #[arg(long, default_value_t = Limits::default().maximum_slew_bar_per_s, value_name = "BAR/S", value_parser = positive)]
    maximum_slew_bar_per_s: f64,
    #[command(flatten)]
    common: Common,
}

/// What `--json` gets.
#[derive(Serialize)]
struct Summary {
    what: String,
    plant: String,
    seed: u64,
    files: Vec<FileSummary>,
}

#[derive(Serialize)]
struct FileSummary {
    path: PathBuf,
    family: String,
    n: usize,
    peak_pressure_bar: f64,
    peak_displacement_mm: f64,
}

/// Runs the command.
///
/// # Errors
/// On bad input.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let limits = Limits {
        maximum_bar: arguments.maximum_pressure_bar,
        maximum_slew_bar_per_s: arguments.maximum_slew_bar_per_s,
        ..Limits::default()
    };
    let plant = Plant::named(&arguments.plant)?;
    let kind = match arguments.what.as_str() {
        "paper" => Some(SetKind::Paper),
        "rich" => Some(SetKind::Rich),
        "lab" => Some(SetKind::Lab),
        _ => None,
    };
    let recordings = match kind {
        Some(kind) => simulate_set(kind, arguments, &limits, &plant)?,
        None => vec![play_file(Path::new(&arguments.what), arguments, &limits, &plant)?],
    };
    let highest = |values: &[f64]| values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let summary = Summary {
        what: arguments.what.clone(),
        plant: arguments.plant.clone(),
        seed: arguments.common.seed,
        files: recordings
            .iter()
            .map(|recording| FileSummary {
                path: recording.path.clone(),
                family: recording.family.clone(),
                n: recording.len(),
                peak_pressure_bar: highest(&recording.input),
                peak_displacement_mm: highest(&recording.output),
            })
            .collect(),
    };
    arguments.common.results.write("Simulated recordings", &format!("What the plant {} did.", arguments.plant), &summary, |page| {
        let longest = recordings.iter().take(4).collect::<Vec<_>>();
        longest.into_iter().for_each(|recording| report::check::picture(page, recording));
    })?;
    let samples: usize = summary.files.iter().map(|file| file.n).sum();
    let peak = summary.files.iter().map(|file| file.peak_pressure_bar).fold(f64::NEG_INFINITY, f64::max);
    say!("{} recording(s), {samples} samples, peak {peak:.3} bar -> {}", summary.files.len(), arguments.out.display());
    Ok(Outcome::Success)
}

fn simulate_set(kind: SetKind, arguments: &Arguments, limits: &Limits, plant: &Plant) -> Result<Vec<Recording>> {
    output::check_folder(&arguments.out).map_err(|problem| anyhow::anyhow!("{}: {problem}", arguments.out.display()))?;
    let earlier = arguments.out.join("train");
    anyhow::ensure!(
        output::may_replace() || !earlier.exists(),
        "{}: exists already; choose another folder, or say --force to replace its recordings",
        earlier.display()
    );
    let bar = output::progress(0, "simulate");
    bar.set_message("playing excitations");
    let watch = |played_s: f64, of_s: f64| {
        bar.set_length(of_s as u64);
        bar.set_position(played_s as u64);
    };
    let config = SetConfig {
        seed: arguments.common.seed,
        amplitude_bar: arguments.amplitude_bar,
        noise_bar: arguments.noise_bar,
        tests_per_family: usize::from(arguments.tests),
        ..SetConfig::default()
    };
    let set = Dataset::simulate_watched(kind, &config, limits, plant, &arguments.out, &watch)?;
    bar.finish_and_clear();
    let _working = output::working("simulate", "writing recordings");
    set.write(&arguments.out, plant)?;
    Ok(set.made.into_iter().map(|made| made.recording).collect())
}

fn play_file(file: &Path, arguments: &Arguments, limits: &Limits, plant: &Plant) -> Result<Recording> {
    if file.extension().is_none() && !file.exists() {
        anyhow::bail!("`{}` is none of paper, rich and lab, nor an excitation file; see `catheter simulate --help`", file.display());
    }
    let excitation = excitation::read(file)?;
    let is_file = arguments.out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("csv")) && !arguments.out.is_dir();
    let stem = file.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let path = if is_file { arguments.out.clone() } else { arguments.out.join(format!("{stem}.csv")) };
    output::check_file(&path).map_err(|problem| anyhow::anyhow!("{}: {problem}", path.display()))?;
    output::refuse_overwriting(&[file.to_path_buf()], &[&path])?;
    output::refuse_any(&path)?;
    let recording = dataset::play(&excitation, limits, plant, &path).with_context(|| file.display().to_string())?;
    recording::write(&path, &recording)?;
    Ok(recording)
}

fn positive(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|value: &f64| value.is_finite() && *value > 0.0).ok_or_else(|| "a positive number is wanted".to_owned())
}

fn not_negative(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|value: &f64| value.is_finite() && *value >= 0.0)
        .ok_or_else(|| "zero or a positive number is wanted".to_owned())
}
