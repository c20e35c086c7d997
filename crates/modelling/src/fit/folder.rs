//! The folder of a fit: `model`, `model.blob` where the microcontroller can hold one, and `rungs/` with every model of the ladder, and the
//! report.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::Serialize;

use identification::physics_rungs;

use super::ladder::{LadderRung, Outcome, RungModel};
use super::{networks, operators};
use crate::evaluate::{Errors, FileErrors, Judged};
use crate::physics::PhysicsModel;
use crate::{export, network};

/// The report.
pub const REPORT: &str = "report.html";
/// The blob.
const BLOB: &str = "model.blob";

/// The blob beside the model.
#[derive(Clone, Debug, Serialize)]
pub struct BlobFile {
    /// Where it is.
    pub file: String,
    /// The rung that it holds: the chosen one, or else the best that the microcontroller can.
    pub rung: String,
    /// That rung's mean error on recordings that took no part, in the output's unit.
    pub cv_rmse: f64,
    /// Inputs that it takes; the firmware admits one.
    pub inputs: usize,
    /// Its size.
    pub bytes: usize,
    /// Instructions of one step on the Cortex-M4F.
    pub step_instructions: usize,
}

/// Writes every rung, the chosen one as `model`, the report's `page`, and a blob where one can be made.
///
/// # Errors
/// When a file cannot be written.
pub fn write(fitted: &Outcome, page: &str, folder: &Path) -> Result<Option<BlobFile>> {
    // What an earlier fit left would be taken for this one's.
    for path in files(folder).iter().filter(|path| path.file_name() != Some("model".as_ref()) && path.is_file()) {
        std::fs::remove_file(path).with_context(|| format!("{}: cannot be replaced", path.display()))?;
    }
    for (index, rung) in fitted.ladder.iter().enumerate() {
        write_rung(fitted, index, &folder.join("rungs").join(stem(&rung.name)))?;
    }
    write_rung(fitted, fitted.chosen, &folder.join("model"))?;
    output::write_atomic(&folder.join(REPORT), page.as_bytes())?;
    // The chosen rung, or else the best that the microcontroller can hold: one whose numbers fit its formats too.
    // A blob of several inputs is for computers and for C: the firmware measures one pressure.
    let inputs = fitted.prepared.inputs.len();
    let has_form = |rung: &LadderRung| rung.on_chip || inputs > 1;
    let mut able: Vec<usize> =
        (0..fitted.ladder.len()).filter(|&index| has_form(&fitted.ladder[index]) && fitted.ladder[index].eligible).collect();
    able.sort_by(|&a, &b| fitted.ladder[a].shape_rmse.total_cmp(&fitted.ladder[b].shape_rmse));
    able.sort_by_key(|&index| index != fitted.chosen);
    let Some((index, bytes)) = able.into_iter().find_map(|index| blob(fitted, index).ok().map(|bytes| (index, bytes))) else {
        return Ok(None);
    };
    let decoded = model_export::blob::decode(&bytes).context("the blob cannot be read back")?;
    let path = folder.join(BLOB);
    output::write_atomic(&path, &bytes)?;
    Ok(Some(BlobFile {
        file: path.display().to_string(),
        rung: fitted.ladder[index].name.clone(),
        cv_rmse: fitted.ladder[index].cv_rmse,
        inputs,
        bytes: bytes.len(),
        step_instructions: firmware::estimator::step_instructions(&decoded.model),
    }))
}

/// The blob of a rung.
fn blob(fitted: &Outcome, index: usize) -> Result<Vec<u8>> {
    let judged = |physics: PhysicsModel| export::from_physics(&PhysicsModel { expected: Some(fitted.expected(index)), ..physics });
    let trained = match &fitted.ladder[index].model {
        RungModel::Network(model) => (**model).clone(),
        RungModel::Physics(model) => judged((**model).clone())?,
        RungModel::Linear(model) => judged(fitted.prepared.on_chip(model).context("the rung has no form on the chip")?)?,
        RungModel::Average(_) => anyhow::bail!("an average has no form on the chip"),
    };
    Ok(export::export(&trained, &fitted.prepared.recordings)?.bytes)
}

/// The name of a rung's file.
fn stem(name: &str) -> String {
    name.replace(" + ", "-").replace(", ", "-").replace(' ', "-").to_lowercase()
}

/// Every file that a fit may write into its folder.
#[must_use]
pub fn files(folder: &Path) -> Vec<PathBuf> {
    let rungs = rung_names().into_iter().map(|name| folder.join("rungs").join(stem(name)));
    ["model", BLOB, REPORT].iter().map(|name| folder.join(name)).chain(rungs).collect()
}

/// Writes one rung in the format of its kind.
///
/// # Errors
/// When the file cannot be written.
pub fn write_rung(fitted: &Outcome, index: usize, path: &Path) -> Result<()> {
    match &fitted.ladder[index].model {
        RungModel::Network(model) => Ok(network::save(path, model)?),
        RungModel::Physics(model) => {
            let nuisances = fitted.ladder[index].nuisances.clone();
            Ok(PhysicsModel { expected: Some(fitted.expected(index)), nuisances, ..(**model).clone() }.write(path)?)
        }
        RungModel::Linear(_) | RungModel::Average(_) => match fitted.fitted(index) {
            Some(model) => model.write(path),
            None => Ok(()),
        },
    }
}

/// Predictions of each recording by models that it took no part in.
#[must_use]
pub fn left_out(fitted: &Outcome) -> Vec<Judged> {
    let chosen = &fitted.ladder[fitted.chosen];
    let pairs = fitted.prepared.recordings.iter().zip(&chosen.predictions);
    pairs
        .map(|(recording, predicted)| {
            let errors = Errors::between(predicted, &recording.output);
            let errors = FileErrors { path: recording.path.clone(), family: recording.family.clone(), errors };
            Judged { errors, first: 0, predicted: predicted.clone() }
        })
        .collect()
}

/// The names of all rungs that a ladder may have.
fn rung_names() -> Vec<&'static str> {
    let sums = physics_rungs().into_iter().map(|rung| rung.name);
    sums.chain(operators::NAMES).chain(networks::RUNGS.map(|(name, ..)| name)).chain(["average"]).collect()
}
