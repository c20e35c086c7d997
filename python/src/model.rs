//! Models of every kind: loaded, simulated, saved.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, bail};
use host_tool::export;
use host_tool::model::FittedPredictor;
use host_tool::model::{self, BlobModel, Description, DiscoveredPredictor, Fit, Format, Gaps, NetworkModel, PhysicsPredictor, Predictor};
use host_tool::network::{self, TrainedModel};
use host_tool::{fit, output};
use numpy::PyArray1;
use pyo3::prelude::*;

use crate::arrays;
use crate::recording::Recording;
use crate::run::{briefly, refusal, refused};

/// A model, by what it is.
pub enum Kind {
    Physics(Box<PhysicsPredictor>),
    Fitted(Box<FittedPredictor>),
    Discovered(Box<DiscoveredPredictor>),
    Network(Box<NetworkModel>),
    Blob(Box<BlobModel>),
}

impl Kind {
    fn load(path: &Path) -> anyhow::Result<Self> {
        Ok(match model::format(path)? {
            Format::Physics => Self::Physics(Box::new(PhysicsPredictor::load(path)?)),
            Format::Fitted => Self::Fitted(Box::new(FittedPredictor::load(path)?)),
            Format::Discovered => Self::Discovered(Box::new(DiscoveredPredictor::load(path)?)),
            Format::Network => Self::Network(Box::new(NetworkModel::load(path)?)),
            Format::Blob => Self::Blob(Box::new(BlobModel::load(path)?)),
        })
    }

    /// A rung of a finished ladder.
    pub fn of_rung(outcome: &fit::Outcome, index: usize) -> anyhow::Result<Self> {
        let rung = &outcome.ladder[index];
        let name = Path::new(&rung.name);
        Ok(match &rung.model {
            fit::RungModel::Physics(model) => Self::Physics(Box::new(PhysicsPredictor::new((**model).clone(), name))),
            fit::RungModel::Network(model) => Self::Network(Box::new(NetworkModel::new((**model).clone(), name)?)),
            fit::RungModel::Linear(_) | fit::RungModel::Average(_) => {
                let fitted = outcome.fitted(index).with_context(|| format!("`{}` has no file", rung.name))?;
                Self::Fitted(Box::new(FittedPredictor::new(fitted, name)))
            }
        })
    }

    pub fn predictor(&self) -> &dyn Predictor {
        match self {
            Self::Physics(model) => model.as_ref(),
            Self::Fitted(model) => model.as_ref(),
            Self::Discovered(model) => model.as_ref(),
            Self::Network(model) => model.as_ref(),
            Self::Blob(model) => model.as_ref(),
        }
    }

    /// The model as the exporter takes it.
    pub fn trained(&self) -> anyhow::Result<TrainedModel> {
        Ok(match self {
            Self::Physics(model) => export::from_physics(model.model())?,
            Self::Fitted(model) => export::from_fitted(model.model())?,
            Self::Network(model) => model.model().clone(),
            Self::Discovered(_) => bail!("a discovered model has no form on the microcontroller yet; `catheter.fit` finds one that has"),
            Self::Blob(_) => bail!("already a blob; `Model.save` writes it as it is, `catheter.export_c` as C"),
        })
    }

    fn save(&self, path: &Path) -> anyhow::Result<()> {
        match self {
            Self::Physics(model) => Ok(model.model().write(path)?),
            Self::Fitted(model) => model.model().write(path),
            Self::Network(model) => Ok(network::save(path, model.model())?),
            Self::Discovered(model) => output::write_atomic(path, model.model().encode()?.as_bytes()),
            Self::Blob(model) => output::write_atomic(path, model.bytes()),
        }
    }
}

/// A model of any kind: from `catheter.load`, or from a fit.
#[pyclass(frozen, module = "catheter")]
pub struct Model {
    pub inner: Arc<Kind>,
}

impl Model {
    pub fn new(kind: Kind) -> Self {
        Self { inner: Arc::new(kind) }
    }

    fn description(&self) -> &Description {
        self.inner.predictor().description()
    }
}

#[pymethods]
impl Model {
    /// What it is, in words.
    #[getter]
    fn kind(&self) -> &str {
        &self.description().kind
    }

    /// How it computes: "physics" (f64), "float" (f32) or "fixed-point" (the microcontroller's code).
    #[getter]
    fn arithmetic<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        arrays::object(py, &self.description().arithmetic)
    }

    /// Time between samples in s; None when the model does not depend on it.
    #[getter]
    fn sample_period_s(&self) -> Option<f64> {
        self.description().sample_period_s
    }

    /// Quantity and unit of each input, for example ["pressure_bar"].
    #[getter]
    fn input_columns(&self) -> Vec<String> {
        let description = self.description();
        std::iter::once(&description.input).chain(&description.more_inputs).map(host_tool::recording::Signal::column).collect()
    }

    /// Quantity and unit of the output, for example "displacement_mm".
    #[getter]
    fn output_column(&self) -> String {
        self.description().output.column()
    }

    /// Smallest and largest first input of the training data; None when it is not known.
    #[getter]
    fn input_range(&self) -> Option<(f64, f64)> {
        self.description().input_range
    }

    /// Numbers that were fitted.
    #[getter]
    fn parameters(&self) -> usize {
        self.description().parameters
    }

    /// The output for inputs alone, free running from the equilibrium of the first sample.
    ///
    /// Parameters
    /// ----------
    /// inputs : array_like, shape (n,) or (n, k)
    ///     In the units of `input_columns`, a sample every `sample_period_s`; k is the number of inputs.
    /// gaps : sequence of int, optional
    ///     Indices, increasing, of samples where the model starts afresh.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray, shape (n,)
    ///     In the unit of `output_column`.
    ///
    /// Raises
    /// ------
    /// CatheterError
    ///     For other shapes, values that are not finite, or gaps outside the samples.
    #[pyo3(signature = (inputs, gaps=None))]
    fn simulate<'py>(&self, py: Python<'py>, inputs: &Bound<'py, PyAny>, gaps: Option<Vec<usize>>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let inputs = arrays::columns("inputs", inputs)?;
        let wanted = self.input_columns();
        if inputs.len() != wanted.len() {
            let shape = if wanted.len() == 1 { "(n,)".to_owned() } else { format!("(n, {})", wanted.len()) };
            return Err(refusal(format!(
                "`inputs` has {} column(s), the model has {}: {}; an array of shape {shape} is wanted",
                inputs.len(),
                wanted.len(),
                wanted.join(", ")
            )));
        }
        let length = inputs[0].len();
        let gaps = gaps.unwrap_or_default();
        if gaps.iter().any(|&gap| gap == 0 || gap >= length) || gaps.windows(2).any(|pair| pair[1] <= pair[0]) {
            return Err(refusal(format!("`gaps` must be increasing indices from 1 to {}", length.saturating_sub(1))));
        }
        if length == 0 {
            return Err(refusal("`inputs` holds no sample"));
        }
        let inputs: Vec<&[f64]> = inputs.iter().map(Vec::as_slice).collect();
        let predictor = self.inner.predictor();
        Ok(arrays::vector(py, briefly(py, || Ok(predictor.simulate(&inputs, &gaps)?))?))
    }

    /// The output for the inputs of a recording, free running, after a check of quantities, units and sample period.
    ///
    /// Parameters
    /// ----------
    /// recording : Recording
    /// resample : bool
    ///     Interpolate a recording of another sample period instead of refusing it.
    /// carry_gaps : bool
    ///     Go on at gaps as if nothing were missing, instead of starting afresh.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray, shape (n,)
    ///
    /// Raises
    /// ------
    /// CatheterError
    ///     When the model was not made for such a recording.
    #[pyo3(signature = (recording, *, resample=false, carry_gaps=false))]
    fn predict<'py>(
        &self,
        py: Python<'py>,
        recording: &Bound<'py, Recording>,
        resample: bool,
        carry_gaps: bool,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let recording = &*recording.get().inner;
        let fit = Fit { resample, gaps: if carry_gaps { Gaps::Carry } else { Gaps::Reset }, ..Fit::default() };
        let predictor = self.inner.predictor();
        Ok(arrays::vector(py, briefly(py, || Ok(model::predict(predictor, recording, fit)?))?))
    }

    /// Writes the model in the format of its kind; `catheter.load` and the command read it, whatever the file is called.
    ///
    /// Raises
    /// ------
    /// CatheterError
    ///     When the file cannot be written.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        briefly(py, || self.inner.save(&path))
    }

    fn __repr__(&self) -> String {
        format!("<catheter.Model: {}; {} -> {}>", self.kind(), self.input_columns().join(", "), self.output_column())
    }
}

/// Reads a model file of any kind: of `fit`, `identify`, `discover`, `train`, `import-network` or `export`.
///
/// Parameters
/// ----------
/// path : path
///
/// Returns
/// -------
/// Model
///
/// Raises
/// ------
/// CatheterError
///     When the file is no model, or is damaged, or is of another version.
#[pyfunction]
pub fn load(py: Python<'_>, path: PathBuf) -> PyResult<Model> {
    Ok(Model::new(briefly(py, || Kind::load(&path))?))
}

/// As `Model.simulate`, for a model or the path of its file.
///
/// Parameters
/// ----------
/// model : Model or path
/// inputs : array_like, shape (n,) or (n, k)
/// gaps : sequence of int, optional
///
/// Returns
/// -------
/// numpy.ndarray, shape (n,)
///
/// Raises
/// ------
/// CatheterError
///     As `load` and `Model.simulate`.
#[pyfunction]
#[pyo3(signature = (model, inputs, gaps=None))]
pub fn simulate<'py>(
    py: Python<'py>,
    model: &Bound<'py, PyAny>,
    inputs: &Bound<'py, PyAny>,
    gaps: Option<Vec<usize>>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    Model { inner: given(py, model)? }.simulate(py, inputs, gaps)
}

/// A model, or the one at a path.
pub fn given(py: Python<'_>, model: &Bound<'_, PyAny>) -> PyResult<Arc<Kind>> {
    if let Ok(model) = model.cast::<Model>() {
        return Ok(model.get().inner.clone());
    }
    let path: PathBuf =
        model.extract().map_err(|_| pyo3::exceptions::PyTypeError::new_err("a catheter.Model or the path of a model file is wanted"))?;
    briefly(py, || Kind::load(&path)).map(Arc::new)
}

/// Threads to work with.
pub fn threads(given: Option<usize>) -> PyResult<usize> {
    match given {
        None => Ok(std::thread::available_parallelism().map_or(1, usize::from)),
        Some(count @ 1..=1024) => Ok(count),
        Some(count) => Err(refused(anyhow::anyhow!("threads={count}: a whole number from 1 to 1024 is wanted"))),
    }
}
