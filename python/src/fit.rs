//! `catheter.fit`.

use std::path::PathBuf;
use std::sync::Arc;

use host_tool::fit::{self, Outcome, Progress, Settings, folder};
use host_tool::output;
use pyo3::exceptions::PyKeyError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays;
use crate::model::{Kind, Model, threads};
use crate::recording;
use crate::run::{Teller, briefly, compute, refusal, refused};

/// A finished fit: the ladder of models with the error to expect of each on the next recording, and the one that was chosen.
#[pyclass(frozen, module = "catheter")]
pub struct Fit {
    outcome: Arc<Outcome>,
}

#[pymethods]
impl Fit {
    /// Name of the chosen rung: the simplest that is as good as the best.
    #[getter]
    fn chosen(&self) -> &str {
        &self.outcome.ladder[self.outcome.chosen].name
    }

    /// The rungs, simplest first: a list of dictionaries.
    ///
    /// Each has "name", "what", "cv_rmse" (mean error on recordings that took no part, in `unit`), "cv_interval" (where the error on the
    /// next recording lies with 95 %), "parameters", "step_instructions", "on_chip", "eligible" (whether these data may choose it),
    /// "seconds", and "errors" (one for each recording or block left out).
    #[getter]
    fn ladder<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        arrays::object(py, &self.outcome.ladder)
    }

    /// Difference in `unit` between repetitions of one input; None when the recordings hold no repetitions.
    #[getter]
    fn repeatability(&self) -> Option<f64> {
        self.outcome.repeatability.repeatability
    }

    /// Noise of the sensor in `unit`.
    #[getter]
    fn noise(&self) -> f64 {
        self.outcome.repeatability.noise
    }

    /// How recordings were left out, a dictionary.
    #[getter]
    fn splits<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        arrays::object(py, &self.outcome.splits)
    }

    /// What a person should know, a list of sentences.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.outcome.notes.clone()
    }

    /// Unit of the output and of all errors.
    #[getter]
    fn unit(&self) -> &str {
        &self.outcome.prepared.output.unit
    }

    /// Largest less smallest output, in `unit`.
    #[getter]
    fn output_range(&self) -> f64 {
        self.outcome.prepared.output.maximum - self.outcome.prepared.output.minimum
    }

    /// The chosen model, fitted to all recordings.
    #[getter]
    fn model(&self) -> PyResult<Model> {
        Kind::of_rung(&self.outcome, self.outcome.chosen).map(Model::new).map_err(refused)
    }

    /// The model of a rung by its name in `ladder`, fitted to all recordings.
    ///
    /// Raises
    /// ------
    /// KeyError
    ///     When there is no such rung.
    fn rung(&self, name: &str) -> PyResult<Model> {
        let index = self.outcome.ladder.iter().position(|rung| rung.name == name);
        let Some(index) = index else {
            let names: Vec<&str> = self.outcome.ladder.iter().map(|rung| rung.name.as_str()).collect();
            return Err(PyKeyError::new_err(format!("there is no rung `{name}`, but {}", names.join(", "))));
        };
        Kind::of_rung(&self.outcome, index).map(Model::new).map_err(refused)
    }

    /// Writes what `catheter fit --out` leaves in a folder: `model`, `model.blob` where the microcontroller can hold one, `report.html`
    /// and `rungs/`. Files of an earlier fit are replaced.
    ///
    /// Returns
    /// -------
    /// dict
    ///     "model" (path) and "blob": None, or a dictionary with "file", "rung", "bytes" and "step_instructions".
    ///
    /// Raises
    /// ------
    /// CatheterError
    ///     When a file cannot be written.
    fn save<'py>(&self, py: Python<'py>, folder: PathBuf) -> PyResult<Bound<'py, PyDict>> {
        output::check_folder(&folder).map_err(|problem| refusal(format!("{}: {problem}", folder.display())))?;
        let blob = briefly(py, || folder::write(&self.outcome, &host_tool::report::fit::page(&self.outcome), &folder))?;
        let result = PyDict::new(py);
        result.set_item("model", folder.join("model").display().to_string())?;
        result.set_item("blob", arrays::object(py, &blob)?)?;
        Ok(result)
    }

    fn __repr__(&self) -> String {
        let rung = &self.outcome.ladder[self.outcome.chosen];
        let ([low, high], unit) = (rung.cv_interval, self.unit());
        format!("<catheter.Fit: {}; expect {:.4} {unit} on the next recording, {low:.4} to {high:.4} with 95 %>", rung.name, rung.cv_rmse)
    }
}

/// Finds the model that will be best on the next recording; the same as the command `catheter fit`.
///
/// Each rung of a ladder from a curve to a network is judged on recordings that took no part in fitting or choosing it. The simplest rung
/// that is as good as the best is chosen.
///
/// Parameters
/// ----------
/// recordings : Recording or sequence of Recording
///     With the same inputs and output, 60 samples at least.
/// networks : bool
///     Whether to train the network rungs too; takes minutes.
/// network_budget_cpu_s : float
///     CPU time in s for the training of a network that may be chosen; its cross-validation takes one and a half times as much.
/// seed : int
///     Seed of every random choice; equal seeds give equal results.
/// threads : int, optional
///     Worker threads; all cores by default.
/// progress : callable, optional
///     Called with one line of text as the fit proceeds.
///
/// Returns
/// -------
/// Fit
///
/// Raises
/// ------
/// CatheterError
///     When the recordings do not go together or carry nothing to fit.
#[pyfunction]
#[pyo3(name = "fit", signature = (recordings, *, networks=false, network_budget_cpu_s=60.0, seed=1, threads=None, progress=None))]
pub fn fit_recordings(
    py: Python<'_>,
    recordings: &Bound<'_, PyAny>,
    networks: bool,
    network_budget_cpu_s: f64,
    seed: u64,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<Fit> {
    let recordings = recording::list(recordings)?;
    if recordings.is_empty() {
        return Err(refusal("there are no recordings to fit"));
    }
    if !(network_budget_cpu_s > 0.0 && network_budget_cpu_s.is_finite()) {
        return Err(refusal("network_budget_cpu_s: a positive number of seconds is wanted"));
    }
    let settings = Settings {
        seed,
        threads: self::threads(threads)?,
        network_budget_cpu_s: networks.then_some(network_budget_cpu_s),
        calibrate_s: None,
    };
    let outcome = compute(py, progress, move |teller| fit::fit(&recordings, &settings, &|progress| tell(teller, progress)))?;
    Ok(Fit { outcome: Arc::new(outcome) })
}

fn tell(teller: &Teller, progress: Progress) {
    teller.tell(match progress {
        Progress::First(model) => format!("a first model; error about {:.4} {}", model.expected.rmse, model.output.unit),
        Progress::Physics { done, of } => format!("physics rungs: {done} of {of}"),
        Progress::Network { number, of, name } => format!("training {number} of {of}: {name}"),
        Progress::Trained(_) => return,
        Progress::Note(note) => note,
    });
}
