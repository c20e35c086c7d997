//! What an export tells a program: the JSON of `catheter export`.

use std::path::PathBuf;

use model_export::blob::Blob;
use model_export::headroom::headroom;
use serde::Serialize;
use sha2::{Digest, Sha256};

use super::blob::Export;
use super::report::Comparison;
use crate::network::TrainedModel;

/// The result as JSON; the first five keys are a contract.
#[derive(Serialize)]
pub struct Summary<'a> {
    bytes: usize,
    sha256: String,
    rmse_f32_vs_fixed: f64,
    max_abs_f32_vs_fixed: f64,
    /// Absent without a network: there is no accumulator.
    accumulator_headroom: Option<f64>,
    rmse_f32_vs_fixed_normalised: f64,
    output_unit: &'a str,
    /// Absent for a blob, which was exported before; so are the next two.
    rounding: Option<&'a str>,
    recordings: Option<usize>,
    report: Option<&'a Comparison>,
    /// C source and header, if they were asked for.
    c: Vec<PathBuf>,
}

impl<'a> Summary<'a> {
    /// Of a finished export; `c` are the C files written.
    #[must_use]
    pub fn of(model: &'a TrainedModel, export: &'a Export, c: Vec<PathBuf>) -> Self {
        Self {
            bytes: export.bytes.len(),
            sha256: hexadecimal(&Sha256::digest(&export.bytes)),
            rmse_f32_vs_fixed: export.comparison.rmse,
            max_abs_f32_vs_fixed: export.comparison.max_abs,
            accumulator_headroom: export.headroom.is_finite().then_some(export.headroom),
            rmse_f32_vs_fixed_normalised: export.comparison.rmse_normalised,
            output_unit: &model.output.unit,
            rounding: Some(export.rounding),
            recordings: Some(export.recordings),
            report: Some(&export.comparison),
            c,
        }
    }

    /// Of a blob that was exported before, with the figures it carries; `c` are the C files written.
    #[must_use]
    pub fn of_blob(bytes: &[u8], blob: &'a Blob<'_>, c: Vec<PathBuf>) -> Self {
        let metrics = &blob.model.metrics;
        let (rmse, scale) = (f64::from(metrics.rmse_f32_vs_fixed), f64::from(blob.model.output.scale));
        Self {
            bytes: bytes.len(),
            sha256: hexadecimal(&Sha256::digest(bytes)),
            rmse_f32_vs_fixed: rmse,
            max_abs_f32_vs_fixed: f64::from(metrics.max_abs_f32_vs_fixed),
            accumulator_headroom: blob.model.network.as_ref().map(|network| headroom(network).least()),
            rmse_f32_vs_fixed_normalised: rmse / scale,
            output_unit: blob.model.output.unit,
            rounding: None,
            recordings: None,
            report: None,
            c,
        }
    }
}

/// Lower-case hexadecimal.
#[must_use]
pub fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
