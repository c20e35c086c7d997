//! `catheter discover`.

use std::path::PathBuf;

use anyhow::{Context, Result};

use super::{Common, Data, Outcome};
use crate::discover::file::{DiscoveredModel, EffectEntry, Origin};
use crate::discover::{self, DiscoverConfig, Finding, Verdict};
use crate::recording::{self, Recording};
use crate::{output, say};

/// Find the physical effect that the simulation lacks, name it, add it to the model and show the gap shrink.
///
/// Example: `catheter discover --data session --holdout other --out result --json result.json`. Without `--holdout` some recordings are
/// kept out of everything and named. `result/model.toml` is the model with the effect; `catheter evaluate --model` takes it.
#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    data: Data,
    /// Recordings that take no part in any choice: CSV files or folders; may be repeated.
    #[arg(long, num_args = 1.., value_name = "PATH")]
    holdout: Vec<PathBuf>,
    /// Folder for the model and the result.
    #[arg(long, value_name = "DIR", value_parser = output::folder_argument())]
    out: PathBuf,
    #[command(flatten)]
    common: Common,
}

/// Runs the command.
///
/// # Errors
/// On bad input or when the result cannot be written.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let columns = arguments.data.columns.as_deref();
    let recordings = recording::load(&arguments.data.data, columns)?;
    let kept = if arguments.holdout.is_empty() { Vec::new() } else { recording::load(&arguments.holdout, columns)? };
    let mut config = DiscoverConfig { seed: arguments.common.seed, ..DiscoverConfig::default() };
    if let Some(threads) = arguments.common.threads {
        config.threads = threads;
    }
    let finding = discover::discover(&recordings, &kept, &config)?;
    let model = model_of(&finding, &recordings);
    let text = model.encode().context("cannot encode the model as TOML")?;
    output::write_atomic(&arguments.out.join("model.toml"), text.as_bytes())?;
    output::write_json(&arguments.out.join("discovery.json"), &finding.discovery)?;
    if let Some(path) = &arguments.common.json {
        output::write_json(path, &finding.discovery)?;
    }
    tell(&finding, &model, arguments);
    Ok(Outcome::Success)
}

/// The file of what was found.
fn model_of(finding: &Finding, recordings: &[Recording]) -> DiscoveredModel {
    let discovery = &finding.discovery;
    let effects = finding
        .after
        .slots
        .iter()
        .map(|slot| {
            let named = discovery.effects.iter().find(|effect| effect.name == slot.form.name());
            EffectEntry {
                name: slot.form.name().to_owned(),
                form: slot.form.form().to_owned(),
                normalised: slot.parameters.clone(),
                weights: slot.weights.clone(),
                parameters: named.map(|effect| effect.parameters.clone()).unwrap_or_default(),
                intervals: named.map(|effect| effect.intervals.clone()).unwrap_or_default(),
            }
        })
        .collect();
    let origin = Origin {
        program: format!("catheter {}", env!("CARGO_PKG_VERSION")),
        recordings: recordings
            .iter()
            .map(|recording| {
                let name = recording.path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
                format!("{name} {}", recording.sha256)
            })
            .collect(),
        rmse: discovery.rmse_after,
        rmse_before: discovery.rmse_before,
    };
    let signals = (recordings[0].input_signal.clone(), recordings[0].output_signal.clone());
    DiscoveredModel::new(&finding.after, &finding.session, signals, origin, effects)
}

/// Says what was found.
fn tell(finding: &Finding, model: &DiscoveredModel, arguments: &Arguments) {
    let discovery = &finding.discovery;
    let unit = &model.output.unit;
    say!("{}", discovery.summary);
    match discovery.verdict {
        Verdict::None => say!("Nothing is missing: the model leaves no more than the noise."),
        Verdict::Unknown => {
            say!("Something is missing, and it is none of the effects in the catalogue (or more than them).");
        }
        Verdict::Ambiguous => {
            let second = discovery.runner_up.as_ref().map_or("another", |second| second.name.as_str());
            say!("Missing is {} or {second}: these recordings cannot tell them apart.", discovery.effects[0].name);
        }
        Verdict::Named => {
            let names: Vec<&str> = discovery.effects.iter().map(|effect| effect.name.as_str()).collect();
            say!("Missing is {}.", names.join(" and "));
        }
    }
    for effect in &discovery.effects {
        say!("  {} ({}), confidence {:.2}", effect.name, effect.form, effect.confidence);
        for (name, value) in &effect.parameters {
            match effect.intervals.get(name) {
                Some([low, high]) => say!("    {name} = {value:.5} ({low:.5} to {high:.5})"),
                None => say!("    {name} = {value:.5}"),
            }
        }
    }
    if let Some(second) = &discovery.runner_up {
        let words = if second.separable { "told apart by these recordings" } else { "not told apart by these recordings" };
        say!("Second best: {}, {words}.", second.name);
    }
    if discovery.excluded_samples > 0 {
        say!("{} samples were left out as outliers.", discovery.excluded_samples);
    }
    say!(
        "Kept-out recordings: rmse {:.5} {unit} before, {:.5} {unit} after, noise {:.5} {unit}; {:.1} % of the gap closed ({}).",
        discovery.rmse_before,
        discovery.rmse_after,
        discovery.noise_floor,
        100.0 * discovery.gap_closed,
        discovery.kept_out.join(", ")
    );
    say!("Model in {}", arguments.out.join("model.toml").display());
}
