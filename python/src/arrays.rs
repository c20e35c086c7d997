//! NumPy arrays and whatever NumPy can make one of, in; arrays and dictionaries, out.

use numpy::{AllowTypeChange, PyArray1, PyArray2, PyArrayLikeDyn, PyArrayMethods};
use pyo3::prelude::*;

use crate::run::{refusal, refused};

/// The columns of an array of shape (n,) or (n, k), all finite.
pub fn columns(name: &str, values: &Bound<'_, PyAny>) -> PyResult<Vec<Vec<f64>>> {
    let array: PyArrayLikeDyn<'_, f64, AllowTypeChange> =
        values.extract().map_err(|error| refusal(format!("`{name}` is no array of real numbers ({error})")))?;
    let array = array.as_array();
    let columns: Vec<Vec<f64>> = match *array.shape() {
        [_] => vec![array.iter().copied().collect()],
        [_, 0] => return Err(refusal(format!("`{name}` has no columns: shape {:?}, (n,) or (n, k) is wanted", array.shape()))),
        [_, _] => array.columns().into_iter().map(|column| column.iter().copied().collect()).collect(),
        _ => return Err(refusal(format!("`{name}` has the shape {:?}; (n,) or (n, k) is wanted, one row a sample", array.shape()))),
    };
    for column in &columns {
        if let Some(index) = column.iter().position(|value| !value.is_finite()) {
            return Err(refusal(format!(
                "`{name}` holds {} at sample {index}; finite numbers are wanted, leave such samples out (a gap is better than an invented value)",
                column[index]
            )));
        }
    }
    Ok(columns)
}

/// An array of shape (n,), or (n, 1).
pub fn column(name: &str, values: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
    let mut columns = columns(name, values)?;
    match columns.len() {
        1 => Ok(columns.remove(0)),
        count => Err(refusal(format!("`{name}` has {count} columns; shape (n,) is wanted, one value a sample"))),
    }
}

/// An array of shape (n,).
pub fn vector(py: Python<'_>, values: Vec<f64>) -> Bound<'_, PyArray1<f64>> {
    PyArray1::from_vec(py, values)
}

/// An array of shape (n,) for one column, else (n, k).
pub fn matrix<'py>(py: Python<'py>, columns: &[&[f64]]) -> PyResult<Bound<'py, PyAny>> {
    if let [only] = columns {
        return Ok(vector(py, only.to_vec()).into_any());
    }
    let rows = columns.first().map_or(0, |column| column.len());
    let flat: Vec<f64> = (0..rows).flat_map(|row| columns.iter().map(move |column| column[row])).collect();
    let array: Bound<'py, PyArray2<f64>> = vector(py, flat).reshape([rows, columns.len()])?;
    Ok(array.into_any())
}

/// What the command writes as JSON, as Python's own objects.
pub fn object<'py>(py: Python<'py>, value: &impl serde::Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value).map_err(refused)?;
    py.import("json")?.call_method1("loads", (text,))
}
