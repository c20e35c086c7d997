//! The folder of a fit: `model`, `model.blob` where the microcontroller can hold one, and `rungs/` with every model of the ladder, and the
//! report.

use std::path::Path;

use anyhow::{Context, Result};
use serde::Serialize;

use super::{Outcome, RungModel, chip};
use crate::evaluate::{Errors, FileErrors, Judged};
use crate::{export, network, output, report};

/// The report.
pub const REPORT: &str = "report.html";

/// The blob beside the model.
#[derive(Clone, Debug, Serialize)]
pub struct BlobFile {
    /// Where it is.
    pub file: String,
    /// The rung that it holds: the chosen one, or else the best that the microcontroller can.
    pub rung: String,
    /// Its size.
    pub bytes: usize,
    /// Instructions of one step on the Cortex-M4F.
    pub step_instructions: usize,
}

/// Writes every rung, the chosen one as `model`, the report, and a blob where one can be made.
///
/// # Errors
/// When a file cannot be written.
pub fn write(fitted: &Outcome, folder: &Path) -> Result<Option<BlobFile>> {
    for (index, rung) in fitted.ladder.iter().enumerate() {
        let stem = rung.name.replace(" + ", "-").replace([' ', ','], "-").replace("--", "-").to_lowercase();
        let place = folder.join("rungs").join(stem);
        write_rung(fitted, index, &place)?;
        if index == fitted.chosen {
            write_rung(fitted, index, &folder.join("model"))?;
        }
    }
    let examples = report::examples("left out", &fitted.prepared.recordings, &left_out(fitted));
    output::write_atomic(&folder.join(REPORT), report::fit::page(fitted, &examples).as_bytes())?;
    let blob_path = folder.join("model.blob");
    // The chosen rung, or else the best that the microcontroller can hold.
    let able = (0..fitted.ladder.len()).filter(|&index| fitted.ladder[index].on_chip && fitted.ladder[index].eligible);
    let best = able.min_by(|&a, &b| fitted.ladder[a].cv_rmse.total_cmp(&fitted.ladder[b].cv_rmse));
    let index = if fitted.ladder[fitted.chosen].on_chip { Some(fitted.chosen) } else { best };
    let Some(index) = index else {
        // One of an earlier fit would be taken for this one's.
        if blob_path.exists() {
            std::fs::remove_file(&blob_path).with_context(|| format!("{}: cannot be removed", blob_path.display()))?;
        }
        return Ok(None);
    };
    let trained = match &fitted.ladder[index].model {
        RungModel::Network(model) => (**model).clone(),
        RungModel::Physics(model) => export::from_physics(model)?,
        RungModel::Linear(model) => {
            let physics = chip::physics(model, &fitted.prepared).context("the rung has no form on the chip")?;
            export::from_physics(&physics)?
        }
        RungModel::Average(_) => anyhow::bail!("an average has no form on the chip"),
    };
    let exported = export::export(&trained, &fitted.prepared.recordings).context("the blob cannot be made")?;
    output::write_atomic(&blob_path, &exported.bytes)?;
    let decoded = model_export::blob::decode(&exported.bytes).context("the blob cannot be read back")?;
    Ok(Some(BlobFile {
        file: blob_path.display().to_string(),
        rung: fitted.ladder[index].name.clone(),
        bytes: exported.bytes.len(),
        step_instructions: firmware::estimator::step_instructions(&decoded.model),
    }))
}

/// Writes one rung in the format of its kind.
///
/// # Errors
/// When the file cannot be written.
pub fn write_rung(fitted: &Outcome, index: usize, path: &Path) -> Result<()> {
    match &fitted.ladder[index].model {
        RungModel::Network(model) => Ok(network::save(path, model)?),
        RungModel::Physics(model) => Ok(model.write(path)?),
        RungModel::Linear(_) | RungModel::Average(_) => match fitted.fitted(index) {
            Some(model) => model.write(path),
            None => Ok(()),
        },
    }
}

/// Predictions of each recording by models that it took no part in.
fn left_out(fitted: &Outcome) -> Vec<Judged> {
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
