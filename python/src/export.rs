//! `catheter.export` and `catheter.export_c`.

use std::path::PathBuf;

use anyhow::{Context, ensure};
use host_tool::export::c::CFiles;
use host_tool::export::{self, Export, Summary};
use host_tool::network::TrainedModel;
use host_tool::{output, recording::Recording};
use model_export::blob;
use pyo3::prelude::*;

use crate::arrays;
use crate::model::{self, Kind};
use crate::recording;
use crate::run::{compute, refused};

/// Writes a model as a blob for the microcontroller; the same as `catheter export --out`.
///
/// Parameters
/// ----------
/// model : Model or path
/// calibration : Recording or sequence of Recording
///     Like those the model will meet, for example its training data.
/// path : path
///     The blob; `catheter.load` reads it and runs it as the microcontroller does.
///
/// Returns
/// -------
/// dict
///     The JSON of the command: "bytes", "sha256", "rmse_f32_vs_fixed", "max_abs_f32_vs_fixed" (in the output's unit),
///     "accumulator_headroom" and more.
///
/// Raises
/// ------
/// CatheterError
///     When the microcontroller has no form for the model, or the recordings are not of its quantities and sample period.
#[pyfunction]
#[pyo3(name = "export")]
pub fn export_blob<'py>(
    py: Python<'py>,
    model: &Bound<'py, PyAny>,
    calibration: &Bound<'py, PyAny>,
    path: PathBuf,
) -> PyResult<Bound<'py, PyAny>> {
    let (kind, recordings) = (model::given(py, model)?, recording::list(calibration)?);
    output::refuse_overwriting(&recording::files(&recordings), &[&path]).map_err(refused)?;
    output::check_file(&path).map_err(|problem| refused(anyhow::anyhow!("{}: {problem}", path.display())))?;
    let (trained, exported) = compute(py, None, move |_| {
        let (trained, exported) = exported(&kind, recordings)?;
        output::write_atomic(&path, &exported.bytes)?;
        Ok((trained, exported))
    })?;
    arrays::object(py, &Summary::of(&trained, &exported, Vec::new()))
}

/// Writes a model as one C source file with its header; the same as `catheter export --c`.
///
/// Parameters
/// ----------
/// model : Model or path
/// path : path
///     The source file, ending in `.c`; the header goes beside it. What is public in them begins with its name.
/// calibration : Recording or sequence of Recording, optional
///     As in `export`; not for a blob, which is calibrated already.
///
/// Returns
/// -------
/// dict
///     As `export`, with both paths in "c".
///
/// Raises
/// ------
/// CatheterError
///     As `export`, and when calibration is missing or was given for a blob.
#[pyfunction]
#[pyo3(signature = (model, path, calibration=None))]
pub fn export_c<'py>(
    py: Python<'py>,
    model: &Bound<'py, PyAny>,
    path: PathBuf,
    calibration: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let kind = model::given(py, model)?;
    let recordings = calibration.map_or(Ok(Vec::new()), recording::list)?;
    let files = CFiles::new(&path).with_context(|| path.display().to_string()).map_err(refused)?;
    output::refuse_overwriting(&recording::files(&recordings), &[&files.source, &files.header]).map_err(refused)?;
    let summary = compute(py, None, move |_| {
        if let Kind::Blob(model) = &*kind {
            ensure!(recordings.is_empty(), "a blob is written as it is; leave `calibration` away");
            let blob = blob::decode(model.bytes())?;
            files.write(&blob)?;
            return Ok(serde_json::to_value(Summary::of_blob(model.bytes(), &blob, files.into_paths()))?);
        }
        let (trained, exported) = exported(&kind, recordings)?;
        files.write(&blob::decode(&exported.bytes)?)?;
        Ok(serde_json::to_value(Summary::of(&trained, &exported, files.into_paths()))?)
    })?;
    arrays::object(py, &summary)
}

fn exported(kind: &Kind, recordings: Vec<Recording>) -> anyhow::Result<(TrainedModel, Export)> {
    let trained = kind.trained()?;
    ensure!(!recordings.is_empty(), "`calibration` is missing: recordings like those that the model will meet");
    let recordings = export::as_the_model_sees(&trained, recordings)?;
    let exported = export::export(&trained, &recordings)?;
    Ok((trained, exported))
}
