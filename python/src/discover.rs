//! `catheter.discover`.

use std::path::{Path, PathBuf};

use host_tool::discover::{self, DiscoverConfig, Progress, folder};
use host_tool::output;
use pyo3::prelude::*;

use crate::arrays;
use crate::model::{self, Kind};
use crate::recording;
use crate::run::{compute, refusal, refused};

/// Finds the physical effect that the simulation lacks; the same as the command `catheter discover`.
///
/// Parameters
/// ----------
/// recordings : Recording or sequence of Recording
/// holdout : Recording or sequence of Recording, optional
///     Recordings that take no part in any choice; some of `recordings` are set apart by default.
/// model : Model or path, optional
///     The simulation to start from; play operators are fitted by default.
/// out : path, optional
///     Folder for `model.toml` (the model with the effect, for `catheter.load`), `report.html` and what else the command writes.
/// seed : int
/// threads : int, optional
///     Worker threads; all cores by default.
/// progress : callable, optional
///     Called with one line of text as the search proceeds.
///
/// Returns
/// -------
/// dict
///     The JSON of the command: "verdict", "effects", "rmse_before", "rmse_after", "noise_floor", "gap_closed", "summary" and more.
///
/// Raises
/// ------
/// CatheterError
///     When there is too little to learn from, or the model was not made for the recordings.
#[pyfunction]
#[pyo3(name = "discover", signature = (recordings, *, holdout=None, model=None, out=None, seed=1, threads=None, progress=None))]
#[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
pub fn discover_effects<'py>(
    py: Python<'py>,
    recordings: &Bound<'py, PyAny>,
    holdout: Option<&Bound<'py, PyAny>>,
    model: Option<&Bound<'py, PyAny>>,
    out: Option<PathBuf>,
    seed: u64,
    threads: Option<usize>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let recordings = recording::list(recordings)?;
    let kept = holdout.map_or(Ok(Vec::new()), recording::list)?;
    if let Some(out) = &out {
        output::check_folder(out).map_err(|problem| refusal(format!("{}: {problem}", out.display())))?;
        let outputs = folder::FILES.map(|name| out.join(name));
        let read: Vec<PathBuf> = recording::files(&recordings).into_iter().chain(recording::files(&kept)).collect();
        output::refuse_overwriting(&read, &outputs.each_ref().map(PathBuf::as_path) as &[&Path]).map_err(refused)?;
    }
    let start = model.map(|model| model::given(py, model)).transpose()?;
    let config = DiscoverConfig { seed, threads: model::threads(threads)?, ..DiscoverConfig::default() };
    let discovery = compute(py, progress, move |teller| {
        let start = start.map(|model| {
            let discovered = match &*model {
                Kind::Discovered(model) => Some(model.model().clone()),
                _ => None,
            };
            discover::start_from(model.predictor(), discovered, &recordings, &kept)
        });
        let start = start.transpose()?;
        let finding = discover::discover_from(&recordings, &kept, start.as_ref(), &config, &|progress| match progress {
            Progress::Stage(name) => teller.tell(name.to_owned()),
            Progress::Part { .. } => teller.go_on(),
        })?;
        if let Some(out) = &out {
            let page = host_tool::report::discovery::page(&finding, &recordings[0].input_signal, &recordings[0].output_signal);
            folder::write(&finding, &recordings, &page, out)?;
        }
        Ok(finding.discovery)
    })?;
    arrays::object(py, &discovery)
}
