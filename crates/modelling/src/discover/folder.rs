//! The folder of a discovery: the model with the effects, the second best, the form for the microcontroller, the result and the report.

use std::path::Path;

use anyhow::{Context, Result};

use super::physics;
use discovery::file::{DiscoveredModel, Origin};
use discovery::{Discovery, Finding, Model};
use recording::Recording;

/// The files that may be there afterwards.
pub const FILES: [&str; 5] = ["model.toml", "runner_up.toml", "microcontroller.toml", "discovery.json", "report.html"];

/// What was written.
pub struct Written {
    /// `model.toml`.
    pub model: DiscoveredModel,
    /// Whether there is a `microcontroller.toml`; else the effect that keeps the model off the microcontroller.
    pub for_the_board: Result<(), String>,
}

/// Writes the files of a finding, with the report's `page`; those of an earlier one are replaced or removed.
///
/// # Errors
/// When a file cannot be written.
pub fn write(finding: &Finding, recordings: &[Recording], page: &str, folder: &Path) -> Result<Written> {
    let discovery = &finding.discovery;
    let model = model_of(finding, &finding.after, discovery, recordings);
    write_model(&folder.join("model.toml"), &model)?;
    // What an earlier discovery left must not pass for a part of this one.
    for name in ["runner_up.toml", "microcontroller.toml"] {
        match std::fs::remove_file(folder.join(name)) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(error).with_context(|| format!("{}: an old file cannot be removed", folder.join(name).display()));
            }
            _ => {}
        }
    }
    let for_the_board = match physics::physics_model(&model, recordings) {
        Ok(physics) => {
            physics.write(&folder.join("microcontroller.toml"))?;
            Ok(())
        }
        Err(effect) => Err(effect),
    };
    if let Some(second) = &finding.second {
        write_model(&folder.join("runner_up.toml"), &model_of(finding, second, discovery, recordings))?;
    }
    output::write_json(&folder.join("discovery.json"), discovery)?;
    output::write_atomic(&folder.join("report.html"), page.as_bytes())?;
    Ok(Written { model, for_the_board })
}

fn write_model(path: &Path, model: &DiscoveredModel) -> Result<()> {
    let text = model.encode().context("cannot encode the model as TOML")?;
    output::write_atomic(path, text.as_bytes())
}

/// The file of a model that was found.
fn model_of(finding: &Finding, model: &Model, discovery: &Discovery, recordings: &[Recording]) -> DiscoveredModel {
    let mut written = DiscoveredModel::bare(model, &finding.session, &recordings[0]);
    for named in &discovery.effects {
        // The first of a name is the one that was told: what creep has left in each recording comes behind it.
        if let Some(entry) = written.effects.iter_mut().find(|entry| entry.name == named.name) {
            entry.parameters.clone_from(&named.parameters);
            entry.intervals.clone_from(&named.intervals);
        }
    }
    written.origin = Origin {
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
    written
}
