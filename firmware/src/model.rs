//! The model in use: from the bytes in flash to one step each model period.

use core::num::NonZeroU16;

use model_export::blob::{self, BlobError};
use model_export::link::fault::Fault;
use model_export::schema::{Golden, Model};

use crate::control::Compensator;
use crate::domain::{DomainGuard, DomainGuardState};
use crate::estimator::{Estimator, EstimatorState, Kernel, KernelSource};
use crate::number::round_to_i32;
use crate::tick::{Direction, ModelStep, TICKS_PER_S};

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

/// A place for a model: an estimator, if there is one, and the memory of whatever estimator is there.
///
/// It stays where it is and models come and go in it, since a model with its memory is too long for a stack.
#[derive(Debug)]
pub struct RunningModel<'a, K: Kernel> {
    estimator: Option<Estimator<'a, K>>,
    state: EstimatorState,
    companion: Option<Companion>,
}

/// What came with an estimator: which way it runs, what the controllers need of the actuator, and what it was trained on.
#[derive(Debug)]
struct Companion {
    direction: Direction,
    compensator: Option<Compensator>,
    guard: DomainGuard,
    guard_state: DomainGuardState,
    is_outside: bool,
}

impl Companion {
    #[inline(never)]
    fn new(model: &Model<'_>) -> Result<Self, Fault> {
        let direction = match (model.input.unit, model.output.unit) {
            ("bar", "mm") => Direction::Estimator,
            ("mm", "bar") => Direction::Inverse,
            _ => return Err(Fault::ModelUnsupported),
        };
        let extension = model.extension().map_err(|_| Fault::ModelCorrupt)?;
        let compensator = match extension.compensation {
            Some(parameters) => Some(Compensator::new(parameters).map_err(|_| Fault::ModelUnsupported)?),
            None => None,
        };
        let guard = DomainGuard::new(&model.envelope, extension.domain, model.sample_period_s);
        Ok(Self { direction, compensator, guard, guard_state: DomainGuardState::default(), is_outside: false })
    }
}

impl<K: Kernel> Default for RunningModel<'_, K> {
    fn default() -> Self {
        Self { estimator: None, state: EstimatorState::default(), companion: None }
    }
}

impl<'a, K: Kernel> RunningModel<'a, K> {
    /// Builds the model of a blob; `kernel` makes its kernel.
    ///
    /// # Errors
    /// The fault to raise: [`Fault::ModelCorrupt`] or [`Fault::ModelUnsupported`].
    pub fn load(bytes: &'a [u8], kernel: impl KernelSource<Kernel = K>) -> Result<Self, Fault> {
        let blob = blob::decode(bytes).map_err(|error| fault_of(&error))?;
        let estimator = Estimator::with_kernel(&blob.model, kernel).map_err(|_| Fault::ModelUnsupported)?;
        let companion = Companion::new(&blob.model)?;
        Ok(Self { estimator: Some(estimator), state: EstimatorState::default(), companion: Some(companion) })
    }

    /// Checks a blob as the self-test does, and lets its model in if it passes: frame, checksum, schema, sample period, golden vectors, and
    /// that the golden vectors can fail. The model before is forgotten in any case.
    ///
    /// `kernel` makes the kernel to check it with: the one it will run on, so that the kernel is checked too.
    ///
    /// # Errors
    /// The fault to raise.
    ///
    /// # Deadline
    /// Not for the tick: up to some 1000 model steps.
    #[inline(never)]
    pub fn admit(&mut self, bytes: &'a [u8], kernel: impl KernelSource<Kernel = K>) -> Result<ModelFacts, Fault> {
        self.forget();
        let (facts, golden) = self.build(bytes, kernel)?;
        let checked = match &self.estimator {
            Some(estimator) => check(estimator, &mut self.state, &golden),
            None => Err(Fault::ModelUnsupported),
        };
        match checked {
            Ok(()) => {
                self.state.reset();
                Ok(facts)
            }
            Err(fault) => {
                self.forget();
                Err(fault)
            }
        }
    }

    /// Leaves the place empty.
    pub fn forget(&mut self) {
        self.estimator = None;
        self.companion = None;
    }

    /// The estimator of a blob. A function of its own, so that the decoded blob is off the stack before the vectors are replayed.
    #[inline(never)]
    fn build(&mut self, bytes: &'a [u8], kernel: impl KernelSource<Kernel = K>) -> Result<(ModelFacts, Golden<'a>), Fault> {
        // Matched by reference, because every move of what is in here is another kilobyte of stack.
        let decoded = blob::decode(bytes);
        let blob = match &decoded {
            Ok(blob) => blob,
            Err(error) => return Err(fault_of(error)),
        };
        let model = &blob.model;
        let period = period_ticks(model.sample_period_s).ok_or(Fault::ModelUnsupported)?;
        self.companion = Some(Companion::new(model)?);
        self.estimator = Estimator::with_kernel(model, kernel).ok();
        if self.estimator.is_none() {
            return Err(Fault::ModelUnsupported);
        }
        let id = blob.content_hash.first_chunk::<8>().copied().unwrap_or_default();
        Ok((ModelFacts { period, id }, model.golden.clone()))
    }
}

impl<K: Kernel> ModelStep for RunningModel<'_, K> {
    fn step(&mut self, input: f32) -> f32 {
        if let Some(companion) = &mut self.companion {
            companion.is_outside = companion.guard.is_outside(&mut companion.guard_state, input);
        }
        self.estimator.as_ref().map_or(f32::NAN, |estimator| estimator.step(&mut self.state, input).value)
    }

    fn reset(&mut self) {
        self.state.reset();
        if let Some(companion) = &mut self.companion {
            companion.guard_state = DomainGuardState::default();
            companion.is_outside = false;
        }
    }

    fn direction(&self) -> Direction {
        self.companion.as_ref().map_or(Direction::Estimator, |companion| companion.direction)
    }

    fn compensator(&self) -> Option<&Compensator> {
        self.companion.as_ref()?.compensator.as_ref()
    }

    fn is_outside_domain(&self) -> bool {
        self.companion.as_ref().is_some_and(|companion| companion.is_outside)
    }
}

/// Checks a blob in a place of its own: [`RunningModel::admit`].
///
/// # Errors
/// The fault to raise.
pub fn examine(bytes: &[u8], kernel: impl KernelSource) -> Result<ModelFacts, Fault> {
    RunningModel::default().admit(bytes, kernel)
}

#[inline(never)]
fn check<K: Kernel>(estimator: &Estimator<'_, K>, state: &mut EstimatorState, golden: &Golden<'_>) -> Result<(), Fault> {
    if !estimator.replay_in(state, golden).passed() {
        return Err(Fault::GoldenMismatch);
    }
    if corrupted_vectors_fail(estimator, state, golden) { Ok(()) } else { Err(Fault::SelfTestBlind) }
}

/// Whether both halves of the golden check notice a fault that was put in on purpose.
fn corrupted_vectors_fail<K: Kernel>(estimator: &Estimator<'_, K>, state: &mut EstimatorState, golden: &Golden<'_>) -> bool {
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
    !estimator.replay_in(state, &wrong_value).within_tolerance && !estimator.replay_in(state, &wrong_digest).same_bits
}

/// A sample period as whole ticks, if it is that to within a millionth.
fn period_ticks(sample_period_s: f32) -> Option<NonZeroU16> {
    let ticks = sample_period_s * TICKS_PER_S;
    let whole = round_to_i32(ticks)?;
    let off = (ticks - crate::number::to_f32(whole)).abs();
    if off <= 1e-4 { NonZeroU16::new(u16::try_from(whole).ok()?) } else { None }
}

fn fault_of(error: &BlobError) -> Fault {
    match error {
        BlobError::SchemaVersion { .. } | BlobError::Activation { .. } => Fault::ModelUnsupported,
        _ => Fault::ModelCorrupt,
    }
}
