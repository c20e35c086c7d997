//! The Python package's native part, `catheter._native`: the library behind the `catheter` command with NumPy arrays in and out.
//!
//! Nothing is computed here. Arrays become recordings, results become dictionaries (the JSON of the command) and arrays, errors become
//! exceptions with the tool's message. `run` keeps Python alive meanwhile. Documentation comments of what Python sees are in NumPy's style.

mod arrays;
mod discover;
mod export;
mod fit;
mod model;
mod recording;
mod run;

use pyo3::prelude::*;

/// The native part of the package `catheter`.
#[pymodule]
mod _native {
    #[pymodule_export]
    use super::discover::discover_effects;
    #[pymodule_export]
    use super::export::{export_blob, export_c};
    #[pymodule_export]
    use super::fit::{Fit, fit_recordings};
    #[pymodule_export]
    use super::model::{Model, load, simulate};
    #[pymodule_export]
    use super::recording::{Recording, read_recordings};
    #[pymodule_export]
    use super::run::CatheterError;
    use super::*;

    #[pymodule_init]
    fn version(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
