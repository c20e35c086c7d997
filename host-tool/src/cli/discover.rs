//! `catheter discover`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use super::{Common, Data, Outcome};
use crate::discover::file::{DiscoveredModel, EffectEntry, Origin};
use crate::discover::{self, DiscoverConfig, Discovery, Finding, Start};
use crate::recording::{self, Recording};
use crate::{model, output, report, say};

/// Find the physical effect that the simulation lacks, name it, add it to the model and show the gap shrink.
///
/// Example: `catheter discover --data session --holdout other --out result --json result.json`. Without `--holdout` some recordings are
/// kept out of everything and named. `result/model.toml` is the model with the effect; `catheter evaluate --model` takes it.
#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    data: Data,
    /// The simulation model to start from; without it, play operators are fitted to the recordings. The figures before are then this
    /// model's; effects that `discover` once wrote into it are kept and what is found comes on top.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
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
    let outputs: Vec<PathBuf> = ["model.toml", "runner_up.toml", "microcontroller.toml", "discovery.json", "report.html"]
        .map(|name| arguments.out.join(name))
        .into();
    let outputs: Vec<&Path> = outputs.iter().map(PathBuf::as_path).chain(arguments.common.json.as_deref()).collect();
    let recordings = arguments.data.load()?;
    let kept = if arguments.holdout.is_empty() { Vec::new() } else { recording::load_with(&arguments.holdout, &arguments.data.options())? };
    let mut read: Vec<PathBuf> = recordings.iter().chain(&kept).map(Recording::file).collect();
    read.extend(arguments.model.clone());
    output::refuse_overwriting(&read, &outputs)?;
    let start = arguments.model.as_deref().map(|path| start_from(path, &recordings, &kept)).transpose()?;
    let mut config = DiscoverConfig { seed: arguments.common.seed, ..DiscoverConfig::default() };
    if let Some(threads) = arguments.common.threads {
        config.threads = threads;
    }
    let bar = output::progress(5, "discover");
    let finding = discover::discover_from(&recordings, &kept, start.as_ref(), &config, &|stage| {
        bar.set_message(stage.to_owned());
        bar.inc(1);
    })?;
    bar.finish_and_clear();
    let discovery = &finding.discovery;
    let model = model_of(&finding, &finding.after, discovery, &recordings);
    write_model(&arguments.out.join("model.toml"), &model)?;
    // What an earlier discovery left must not pass for a part of this one.
    for name in ["runner_up.toml", "microcontroller.toml"] {
        match std::fs::remove_file(arguments.out.join(name)) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(error).with_context(|| format!("{}: an old file cannot be removed", arguments.out.join(name).display()));
            }
            _ => {}
        }
    }
    let for_the_board = discover::physics::physics_model(&model, &recordings);
    if let Ok(physics) = &for_the_board {
        physics.write(&arguments.out.join("microcontroller.toml"))?;
    }
    if let Some(second) = &finding.second {
        write_model(&arguments.out.join("runner_up.toml"), &model_of(&finding, second, discovery, &recordings))?;
    }
    output::write_json(&arguments.out.join("discovery.json"), discovery)?;
    let page = report::discovery::page(&finding, &recordings[0].input_signal, &recordings[0].output_signal);
    output::write_atomic(&arguments.out.join("report.html"), page.as_bytes())?;
    if let Some(path) = &arguments.common.json {
        output::write_json(path, discovery)?;
    }
    tell(discovery, &model, arguments);
    match for_the_board {
        Ok(_) => say!("For the microcontroller: catheter export {} ...", arguments.out.join("microcontroller.toml").display()),
        Err(effect) => say!("The microcontroller does not know {effect}: this model runs on the desktop only."),
    }
    Ok(Outcome::Success)
}

/// Lets a given model predict every recording.
fn start_from(path: &Path, recordings: &[Recording], kept: &[Recording]) -> Result<Start> {
    let predictor = model::load(path)?;
    let mut predictions = Vec::new();
    for recording in recordings.iter().chain(kept) {
        model::check(predictor.description(), recording, false)?;
        predictions.push(predictor.predict(&recording.input, &recording.gaps)?);
    }
    Ok(Start { predictions, discovered: DiscoveredModel::read(path).ok() })
}

fn write_model(path: &Path, model: &DiscoveredModel) -> Result<()> {
    let text = model.encode().context("cannot encode the model as TOML")?;
    output::write_atomic(path, text.as_bytes())
}

/// The file of a model that was found.
fn model_of(finding: &Finding, model: &discover::Model, discovery: &Discovery, recordings: &[Recording]) -> DiscoveredModel {
    let effects = model
        .slots
        .iter()
        .map(|slot| {
            let named = discovery.effects.iter().find(|effect| effect.name == slot.form.name() && effect.form == slot.form.form());
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
    DiscoveredModel::new(model, &finding.session, signals, origin, effects)
}

/// Says what was found.
fn tell(discovery: &Discovery, model: &DiscoveredModel, arguments: &Arguments) {
    let unit = &model.output.unit;
    say!("{}", discovery.summary);
    say!("{}", report::discovery::headline(discovery));
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
        if !second.separable {
            let (first, second) = (arguments.out.join("model.toml"), arguments.out.join("runner_up.toml"));
            say!("The experiment that would: catheter plan-experiment --models {} {} --out next.toml", first.display(), second.display());
        }
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
    if !discovery.side_unknown.is_empty() {
        let names = discovery.side_unknown.join(", ");
        say!("These figures leave out {names}: made about when the set-up changed, and the other recordings do not tell on which side.");
    }
    say!("Model in {}, report in {}", arguments.out.join("model.toml").display(), arguments.out.join("report.html").display());
}
