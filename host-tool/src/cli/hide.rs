//! `catheter hide`.

use std::path::PathBuf;

use anyhow::Result;

use super::{Common, Outcome};
use crate::rig::{self, CaseConfig, Excitation, Generator};

/// Hide an effect in the recordings of a virtual rig, the truth in a file of its own.
///
/// Example: `catheter hide --effect creep --seed 7 --out case`, then `catheter discover --data case/recordings --holdout case/holdout
/// --out result`, and only then `cat case/truth.sealed.json`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Effect to hide; may be repeated; none hides nothing.
    #[arg(long = "effect", value_name = "NAME")]
    effects: Vec<String>,
    /// Standard deviation of the measurement noise, relative to the output's range.
    #[arg(long, default_value_t = 0.005, value_name = "SHARE")]
    noise: f64,
    /// Correlate half of the noise over a tenth of a second.
    #[arg(long)]
    coloured: bool,
    /// What the rig is told to do.
    #[arg(long, value_enum, default_value = "paper")]
    excitation: Excitation,
    /// The virtual rig.
    #[arg(long, value_enum, default_value = "physics")]
    rig: Generator,
    /// Record the pressure in the muscle too (the physics rig).
    #[arg(long)]
    measured_pressure: bool,
    /// Folder to write to.
    #[arg(long, value_name = "DIR", value_parser = crate::output::folder_argument())]
    out: PathBuf,
    #[command(flatten)]
    common: Common,
}

/// Runs the command.
///
/// # Errors
/// On an unknown effect or when a file cannot be written.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    anyhow::ensure!(
        arguments.noise.is_finite() && (0.0..=0.2).contains(&arguments.noise),
        "--noise is a share of the range between 0 and 0.2, not {}",
        arguments.noise
    );
    anyhow::ensure!(
        !arguments.measured_pressure || arguments.rig == Generator::Physics,
        "only the physics rig has a pressure to measure; leave out --rig rival or --measured-pressure"
    );
    let config = CaseConfig {
        effects: arguments.effects.clone(),
        seed: arguments.common.seed,
        noise: arguments.noise,
        coloured_noise: arguments.coloured,
        excitation: arguments.excitation,
        generator: arguments.rig,
        measured_pressure: arguments.measured_pressure,
    };
    let case = rig::hide(&config)?;
    let out = crate::output::free_folder(&arguments.out);
    rig::write(&out, &case)?;
    crate::say!(
        "{} recordings in {}, {} kept-out recordings in {}, the truth in {}",
        case.recordings.len(),
        out.join("recordings").display(),
        case.kept_out.len(),
        out.join("holdout").display(),
        out.join("truth.sealed.json").display()
    );
    let result = serde_json::json!({"recordings": case.recordings.len(), "holdout": case.kept_out.len(), "noise_mm": case.truth.noise_mm});
    arguments.common.results.write(
        "Recordings with a hidden effect",
        "What was made; the truth is in a file of its own.",
        &result,
        |_| {},
    )?;
    Ok(Outcome::Success)
}
