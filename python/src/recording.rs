//! Recordings: from arrays, and from files as the command reads them.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use host_tool::recording::{self, Channel, ExtraColumn, ReadOptions};
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays;
use crate::run::{briefly, refusal, refused};

/// The optional columns of our own files.
const EXTRA: [&str; 4] = ["pressure_measured_bar", "sequence", "temperature_c", "session_time_s"];

/// One run of the rig: inputs and an output at common times.
///
/// Parameters
/// ----------
/// time_s : array_like, shape (n,)
///     Times in s, increasing; at least two. The clock may be uneven, and a pause becomes a gap.
/// inputs : array_like, shape (n,) or (n, k)
///     One column for each input.
/// output : array_like, shape (n,)
/// name : str
///     Its name in reports.
/// group : str
///     Recordings of one group (a day, a load) are left out together in cross-validation; none by default.
/// input_columns : str or sequence of str, optional
///     Quantity and unit of each input as `quantity_unit`; "pressure_bar", "pressure2_bar" and so on by default.
/// output_column : str
///     Quantity and unit of the output; "displacement_mm" by default.
/// extra : dict of str to array_like, optional
///     More columns: "pressure_measured_bar", "sequence", "temperature_c", "session_time_s", each of shape (n,).
///
/// Raises
/// ------
/// CatheterError
///     When shapes do not go together, a value is not finite, or a time does not increase.
#[pyclass(frozen, module = "catheter")]
pub struct Recording {
    pub inner: Arc<recording::Recording>,
}

#[pymethods]
impl Recording {
    #[new]
    #[pyo3(signature = (time_s, inputs, output, *, name="recording", group="", input_columns=None, output_column="displacement_mm", extra=None))]
    #[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
    fn new(
        time_s: &Bound<'_, PyAny>,
        inputs: &Bound<'_, PyAny>,
        output: &Bound<'_, PyAny>,
        name: &str,
        group: &str,
        input_columns: Option<&Bound<'_, PyAny>>,
        output_column: &str,
        extra: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let refuse = |problem: String| refusal(format!("{name}: {problem}"));
        let (time_s, inputs, output) =
            (arrays::column("time_s", time_s)?, arrays::columns("inputs", inputs)?, arrays::column("output", output)?);
        let length = time_s.len();
        let same = |what: &str, found: usize| {
            if found == length {
                Ok(())
            } else {
                Err(refuse(format!("{length} times but {found} samples of `{what}`; shapes (n,) or (n, k) with one n are wanted")))
            }
        };
        same("inputs", inputs[0].len())?;
        same("output", output.len())?;
        if let Some(index) = (1..length).find(|&index| time_s[index] <= time_s[index - 1]) {
            let (before, after) = (time_s[index - 1], time_s[index]);
            return Err(refuse(format!(
                "the time {after} s of sample {index} does not come after the {before} s before it; make two recordings of two"
            )));
        }
        let names = match input_columns {
            None => (0..inputs.len())
                .map(|index| if index == 0 { "pressure_bar".to_owned() } else { format!("pressure{}_bar", index + 1) })
                .collect(),
            Some(names) => strings(names)?,
        };
        if names.len() != inputs.len() {
            return Err(refuse(format!("{} inputs but {} names in `input_columns`", inputs.len(), names.len())));
        }
        let signal = |role: &str, column: &str| recording::signal(role, column).map_err(&refuse);
        let mut channels = Vec::new();
        for (column, values) in names.iter().zip(inputs) {
            channels.push(Channel { signal: signal("input", column)?, values });
        }
        let first = channels.remove(0);
        let output_signal = signal("output", output_column)?;
        let mut inner = recording::Recording::new(Path::new(name), first.signal, output_signal, time_s, first.values, output)
            .map_err(refused)?
            .with_more_inputs(channels);
        inner.group = group.to_owned();
        for (key, values) in extra.into_iter().flatten() {
            let key: String = key.extract()?;
            if !EXTRA.contains(&key.as_str()) {
                return Err(refuse(format!("`{key}` in `extra` is none of {}", EXTRA.join(", "))));
            }
            let values = arrays::column(&key, &values)?;
            same(&key, values.len())?;
            inner.extra.push(ExtraColumn { name: key, values });
        }
        inner.mark_lost_samples();
        Ok(Self { inner: Arc::new(inner) })
    }

    /// Its name; the file it was read from, if it was.
    #[getter]
    fn name(&self) -> String {
        self.inner.path.display().to_string()
    }

    /// Its group in cross-validation; empty for none.
    #[getter]
    fn group(&self) -> &str {
        &self.inner.group
    }

    /// Times in s, shape (n,).
    #[getter]
    fn time_s<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        arrays::vector(py, self.inner.time_s.clone())
    }

    /// Inputs, shape (n,) for one, else (n, k).
    #[getter]
    fn inputs<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        arrays::matrix(py, &self.inner.inputs())
    }

    /// Output, shape (n,).
    #[getter]
    fn output<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        arrays::vector(py, self.inner.output.clone())
    }

    /// Quantity and unit of each input.
    #[getter]
    fn input_columns(&self) -> Vec<String> {
        std::iter::once(&self.inner.input_signal)
            .chain(self.inner.more_inputs.iter().map(|input| &input.signal))
            .map(recording::Signal::column)
            .collect()
    }

    /// Quantity and unit of the output.
    #[getter]
    fn output_column(&self) -> String {
        self.inner.output_signal.column()
    }

    /// More columns by name, each of shape (n,).
    #[getter]
    fn extra<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let extra = PyDict::new(py);
        for column in &self.inner.extra {
            extra.set_item(&column.name, arrays::vector(py, column.values.clone()))?;
        }
        Ok(extra)
    }

    /// Time between samples in s: the mean step of an even clock, else the median step.
    #[getter]
    fn sample_period_s(&self) -> f64 {
        self.inner.sample_period_s
    }

    /// Indices of the first sample after each gap, shape (g,), integers.
    #[getter]
    fn gaps<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        PyArray1::from_iter(py, self.inner.gaps.iter().map(|&gap| i64::try_from(gap).unwrap_or(i64::MAX)))
    }

    /// What reading the file found and did, in words.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.inner.notes.iter().map(|note| note.text.clone()).collect()
    }

    /// Writes it as a CSV file with the columns that `catheter` reads.
    ///
    /// Raises
    /// ------
    /// CatheterError
    ///     When the file cannot be written.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        briefly(py, || Ok(recording::write(&path, &self.inner)?))
    }

    fn __len__(&self) -> usize {
        self.inner.len()
    }

    fn __repr__(&self) -> String {
        let inner = &self.inner;
        format!(
            "<catheter.Recording {}: {} -> {}, {} samples every {} s>",
            self.name(),
            self.input_columns().join(", "),
            self.output_column(),
            inner.len(),
            inner.sample_period_s
        )
    }
}

/// Reads recordings from CSV files, as the command `catheter` does.
///
/// Parameters
/// ----------
/// paths : path or sequence of paths
///     Files, or folders that are searched for them.
/// columns : str, optional
///     What the columns of foreign files mean, for example "time=t_s,input=voltage_V,output=displacement_um".
/// rate_hz : float, optional
///     Sampling rate of files without a time column.
///
/// Returns
/// -------
/// list of Recording
///     Grouped by day, load or amplitude where names or columns show it.
///
/// Raises
/// ------
/// CatheterError
///     The first problem of the first bad file, with its line.
#[pyfunction]
#[pyo3(signature = (paths, *, columns=None, rate_hz=None))]
pub fn read_recordings(
    py: Python<'_>,
    paths: &Bound<'_, PyAny>,
    columns: Option<String>,
    rate_hz: Option<f64>,
) -> PyResult<Vec<Recording>> {
    let paths: Vec<PathBuf> = match paths.extract::<PathBuf>() {
        Ok(path) => vec![path],
        Err(_) => paths.extract()?,
    };
    let options = ReadOptions { columns, rate_hz, ..ReadOptions::default() };
    let read = briefly(py, || Ok(recording::load_with(&paths, &options)?))?;
    Ok(read.into_iter().map(|inner| Recording { inner: Arc::new(inner) }).collect())
}

/// One recording, or any iterable of them.
pub fn list(given: &Bound<'_, PyAny>) -> PyResult<Vec<recording::Recording>> {
    if let Ok(one) = given.cast::<Recording>() {
        return Ok(vec![(*one.get().inner).clone()]);
    }
    let wanted =
        || pyo3::exceptions::PyTypeError::new_err("a catheter.Recording or a sequence of them is wanted; see catheter.read_recordings");
    let mut recordings = Vec::new();
    for item in given.try_iter().map_err(|_| wanted())? {
        recordings.push((*item?.cast::<Recording>().map_err(|_| wanted())?.get().inner).clone());
    }
    Ok(recordings)
}

/// A string or a sequence of them.
fn strings(given: &Bound<'_, PyAny>) -> PyResult<Vec<String>> {
    match given.extract::<String>() {
        Ok(one) => Ok(vec![one]),
        Err(_) => given.extract(),
    }
}

/// The files that recordings came from; recordings from arrays came from none.
pub fn files(recordings: &[recording::Recording]) -> Vec<PathBuf> {
    recordings.iter().filter(|recording| !recording.sha256.is_empty()).map(recording::Recording::file).collect()
}
