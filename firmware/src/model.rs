//! The model in use: from the bytes in flash to one step each model period.

use core::num::NonZeroU16;

use model_export::blob::{self, BlobError};
use model_export::link::fault::Fault;
use model_export::schema::Golden;

use crate::estimator::{Estimator, EstimatorState, Kernel, KernelSource};
use crate::number::round_to_i32;
use crate::tick::{ModelStep, TICKS_PER_S};

/// Kind of a model slot.
pub const STORE_KIND: u16 = 0x4d4f;
/// Version of the slot's contents; the blob has its own schema version inside.
pub const STORE_VERSION: u16 = 1;

/// What the rig needs to know of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModelFacts {
    /// Ticks from one step to the next.
    pub period: NonZeroU16,
    /// First bytes of the blob's content hash.
    pub id: [u8; 8],
}

/// An estimator with its memory.
#[derive(Debug)]
pub struct RunningModel<'a, K: Kernel> {
    estimator: Estimator<'a, K>,
    state: EstimatorState,
}

impl<'a, K: Kernel> RunningModel<'a, K> {
    /// Builds the model of a blob; `kernel` makes its kernel.
    ///
    /// # Errors
    /// The fault to raise: [`Fault::ModelCorrupt`] or [`Fault::ModelUnsupported`].
    pub fn load(bytes: &'a [u8], kernel: impl KernelSource<Kernel = K>) -> Result<Self, Fault> {
        let blob = blob::decode(bytes).map_err(fault_of)?;
        let estimator = Estimator::with_kernel(&blob.model, kernel).map_err(|_| Fault::ModelUnsupported)?;
        Ok(Self { estimator, state: EstimatorState::default() })
    }
}

impl<K: Kernel> ModelStep for RunningModel<'_, K> {
    fn step(&mut self, pressure_bar: f32) -> f32 {
        self.estimator.step(&mut self.state, pressure_bar).value
    }

    fn reset(&mut self) {
        self.state.reset();
    }
}

/// Checks a blob as the self-test does: frame, checksum, schema, sample period, golden vectors, and that the golden vectors can fail.
///
/// `kernel` makes the kernel to check it with: the one it will run on, so that the kernel is checked too.
///
/// # Errors
/// The fault to raise.
///
/// # Deadline
/// Not for the tick: up to some 1000 model steps.
pub fn examine(bytes: &[u8], kernel: impl KernelSource) -> Result<ModelFacts, Fault> {
    let blob = blob::decode(bytes).map_err(fault_of)?;
    let model = &blob.model;
    let period = period_ticks(model.sample_period_s).ok_or(Fault::ModelUnsupported)?;
    let units_fit = model.input.unit == "bar" && model.output.unit == "mm";
    if !units_fit {
        return Err(Fault::ModelUnsupported);
    }
    let estimator = Estimator::with_kernel(model, kernel).map_err(|_| Fault::ModelUnsupported)?;
    if !estimator.replay(&model.golden).passed() {
        return Err(Fault::GoldenMismatch);
    }
    if !corrupted_vectors_fail(&estimator, &model.golden) {
        return Err(Fault::SelfTestBlind);
    }
    let id = blob.content_hash.first_chunk::<8>().copied().unwrap_or_default();
    Ok(ModelFacts { period, id })
}

/// Whether both halves of the golden check notice a fault that was put in on purpose.
fn corrupted_vectors_fail<K: Kernel>(estimator: &Estimator<'_, K>, golden: &Golden<'_>) -> bool {
    const SAMPLES_BYTES: usize = 64;
    let length = golden.output.len().min(golden.input.len()).min(SAMPLES_BYTES);
    let mut output = [0; SAMPLES_BYTES];
    output.iter_mut().zip(golden.output).for_each(|(copy, byte)| *copy = *byte);
    let (Some(output), Some(input)) = (output.get_mut(..length), golden.input.get(..length)) else { return false };
    let Some(last) = output.last_chunk_mut::<4>() else { return false };
    // Away from zero, so that the change cannot drown in rounding.
    let right = f32::from_le_bytes(*last);
    let change = (1.0 + 4.0 * golden.tolerance).copysign(right);
    *last = (right + change).to_le_bytes();
    let wrong_value = Golden { input, output, ..*golden };
    let wrong_digest = Golden { digest: golden.digest ^ 1, ..*golden };
    !estimator.replay(&wrong_value).within_tolerance && !estimator.replay(&wrong_digest).same_bits
}

/// A sample period as whole ticks, if it is that to within a millionth.
fn period_ticks(sample_period_s: f32) -> Option<NonZeroU16> {
    let ticks = sample_period_s * TICKS_PER_S;
    let whole = round_to_i32(ticks)?;
    let off = (ticks - crate::number::to_f32(whole)).abs();
    if off <= 1e-4 { NonZeroU16::new(u16::try_from(whole).ok()?) } else { None }
}

fn fault_of(error: BlobError) -> Fault {
    match error {
        BlobError::SchemaVersion { .. } | BlobError::Activation { .. } => Fault::ModelUnsupported,
        _ => Fault::ModelCorrupt,
    }
}
