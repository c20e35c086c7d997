//! The parts put together.

use firmware::estimator::{Estimator, EstimatorState};
use model_export::blob::Blob;
use model_export::schema::Model;
use model_export::validate::Invalid;

use super::name::Name;
use super::template::{Context, fill};
use super::{front_end, header, literal, network};

/// Why a blob has no C form.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Nothing that a blob's reader lets through.
    #[error("the model cannot be run: {0}")]
    Invalid(#[from] Invalid),
    /// The estimator does not give what the exporter of the blob saw.
    #[error("the model does not meet its golden vectors, so it is not what was exported; export it again")]
    Golden,
}

/// A model in C.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CSource {
    /// The header: state, functions, units, ranges, provenance.
    pub header: String,
    /// The source file.
    pub source: String,
}

/// Writes a blob's model as C.
///
/// # Errors
/// When the model does not meet its own golden vectors.
pub fn generate(blob: &Blob<'_>, name: &Name) -> Result<CSource, Error> {
    let (input, output) = golden(&blob.model)?;
    let is_single = blob.model.more_inputs.is_empty();
    let context = Context { name, blob };
    let sha256 = header::sha256(blob);
    let opening = fill(
        include_str!("template/opening.c"),
        &[
            ("summary", &header::summary(&context)),
            ("version", env!("CARGO_PKG_VERSION")),
            ("sha256", &sha256),
            ("name", name.identifier()),
            ("header", &name.header()),
        ],
    );
    let self_test = fill(
        include_str!("template/self_test.c"),
        &[
            ("samples", &output.len().to_string()),
            ("input_of_sample", if is_single { "SELF_TEST_INPUT[sample]" } else { "&SELF_TEST_INPUT[sample * INPUTS]" }),
            ("input", &literal::dense_floats(&input)),
            ("output", &literal::dense_floats(&output)),
            ("name", name.identifier()),
            ("NAME", &name.upper()),
        ],
    );
    let source = [opening, front_end::source(&context), network::source(&context), step(&context), self_test].concat();
    Ok(CSource { header: header::header(&context), source })
}

/// The public functions.
fn step(context: &Context<'_>) -> String {
    let model = context.model();
    fill(
        include_str!("template/step.c"),
        &[
            ("offset", &literal::constant(model.output.offset)),
            ("scale", &literal::constant(model.output.scale)),
            ("band", &literal::constant(model.front_end.stick_band)),
            ("features", if model.network.is_some() { "    int16_t features[FEATURES];\n" } else { "" }),
            ("features_argument", if model.network.is_some() { ", features" } else { "" }),
            ("correction", network::correction(model)),
            ("reset_network", network::reset(model)),
            ("input_argument", &header::input_argument(model)),
            ("input_address", if model.more_inputs.is_empty() { "&input" } else { "inputs" }),
            ("name", context.name.identifier()),
        ],
    )
}

/// The golden inputs and what the estimator makes of them, once it has shown that it meets them.
fn golden(model: &Model<'_>) -> Result<(Vec<f32>, Vec<f32>), Error> {
    let estimator = Estimator::new(model)?;
    let replay = estimator.replay(&model.golden);
    if replay.samples == 0 || !replay.passed() {
        return Err(Error::Golden);
    }
    let mut state = EstimatorState::default();
    let input: Vec<f32> = model.golden.input.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    let output = input.chunks(estimator.inputs()).map(|sample| estimator.step_all(&mut state, sample).value).collect();
    Ok((input, output))
}
