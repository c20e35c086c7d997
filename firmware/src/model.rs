//! The model in use: from the bytes in flash to one step each model period.

use core::borrow::BorrowMut;
use core::num::NonZeroU16;

use model_export::blob::{self, BlobError};
use model_export::compensation::Extension;
use model_export::link::fault::Fault;
use model_export::schema::{Golden, Model};

use crate::control::Compensator;
use crate::domain::{DomainGuard, DomainGuardState};
use crate::estimator::{Estimator, EstimatorState, Kernel, KernelSource, StepBudget, StepTimer, step_instructions};
use crate::number::round_to_i32;
use crate::tick::{Direction, ModelStep, TICKS_PER_S};

/// Kind of a model slot.
pub const STORE_KIND: u16 = 0x4d4f;
/// Version of the slot's contents; the blob has its own schema version inside.
pub const STORE_VERSION: u16 = 1;

/// Share of a tick that a step of the model may take, in percent: the rest is for the control law, which takes a tenth, and for interrupts.
pub const STEP_SHARE_PERCENT: u32 = 60;
/// The same in cycles of the board's processor.
const MAX_STEP_CYCLES: usize = 168_000 / 100 * STEP_SHARE_PERCENT as usize;

/// What the rig needs to know of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModelFacts {
    /// Ticks from one step to the next.
    pub period: NonZeroU16,
    /// First bytes of the blob's content hash.
    pub id: [u8; 8],
}

/// A place for a model: an estimator, if there is one, with its memory and the blob's contents.
///
/// It stays where it is and models come and go in it, since each of these is too long for a small stack. On a board memory and contents lie
/// elsewhere, so that the rest is short enough to be made on the stack.
#[derive(Debug)]
pub struct RunningModel<'a, K: Kernel, S = EstimatorState, M = Model<'a>> {
    model: M,
    estimator: Estimator<'a, K>,
    state: S,
    is_ready: bool,
    companion: Companion,
}

/// What came with an estimator: which way it runs, what the controllers need of the actuator, and what it was trained on.
#[derive(Debug, Default)]
struct Companion {
    direction: Direction,
    compensator: Compensator,
    compensates: bool,
    guard: DomainGuard,
    guard_state: DomainGuardState,
    is_outside: bool,
    identity: [u8; 8],
}

impl Companion {
    #[inline(never)]
    fn rebuild(&mut self, model: &Model<'_>) -> Result<(), Fault> {
        // The tick measures one pressure, and what the others are is not guessed.
        if !model.more_inputs.is_empty() {
            return Err(Fault::ModelInputs);
        }
        self.direction = match (model.input.unit, model.output.unit) {
            ("bar", "mm") => Direction::Estimator,
            ("mm", "bar") => Direction::Inverse,
            _ => return Err(Fault::ModelUnsupported),
        };
        let mut extension = Extension::default();
        extension.decode_into(model.extension).map_err(|_| Fault::ModelCorrupt)?;
        self.compensates = extension.compensation.is_some();
        if let Some(parameters) = &mut extension.compensation {
            self.compensator.rebuild(parameters).map_err(|_| Fault::ModelUnsupported)?;
        }
        self.guard = DomainGuard::new(&model.envelope, extension.domain, model.sample_period_s);
        Ok(())
    }

    fn reset(&mut self) {
        self.guard_state.reset();
        self.is_outside = false;
    }
}

impl<K: Kernel> Default for RunningModel<'_, K> {
    fn default() -> Self {
        Self::over(EstimatorState::new(), Model::default())
    }
}

impl<'a, K: Kernel, S: BorrowMut<EstimatorState>, M: BorrowMut<Model<'a>>> RunningModel<'a, K, S, M> {
    /// An empty place, with memory and contents that lie wherever the caller wants.
    pub fn over(state: S, model: M) -> Self {
        Self { model, estimator: Estimator::default(), state, is_ready: false, companion: Companion::default() }
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
    pub fn load(&mut self, bytes: &'a [u8], kernel: impl KernelSource<Kernel = K>) -> Result<ModelFacts, Fault> {
        self.load_within(bytes, kernel, &StepBudget::UNLIMITED)
    }

    /// As [`Self::load`], and measures the model's steps while it replays the golden vectors.
    ///
    /// # Errors
    /// The fault to raise; [`Fault::ModelTooSlow`] where the steps exceed the budget.
    ///
    /// # Deadline
    /// Not for the tick: up to some 1000 model steps within the budget.
    pub fn load_within(
        &mut self,
        bytes: &'a [u8],
        kernel: impl KernelSource<Kernel = K>,
        budget: &StepBudget<impl StepTimer>,
    ) -> Result<ModelFacts, Fault> {
        self.forget();
        let facts = self.build(bytes, kernel)?;
        check(&self.estimator, self.state.borrow_mut(), &self.model.borrow().golden, budget)?;
        self.reset();
        self.is_ready = true;
        Ok(facts)
    }

    /// Leaves the place empty.
    pub fn forget(&mut self) {
        self.is_ready = false;
    }

    /// The estimator of a blob. A function of its own, so that nothing of this is on the stack when the vectors are replayed.
    #[inline(never)]
    fn build(&mut self, bytes: &'a [u8], kernel: impl KernelSource<Kernel = K>) -> Result<ModelFacts, Fault> {
        let Self { model, estimator, companion, .. } = self;
        let model = model.borrow_mut();
        let header = blob::decode_into(bytes, model).map_err(|error| fault_of(&error))?;
        let period = period_ticks(model.sample_period_s).ok_or(Fault::ModelUnsupported)?;
        // No instruction takes less than a cycle. A model that cannot be fast enough is refused everywhere, not only where it can be measured.
        if step_instructions(model) > MAX_STEP_CYCLES {
            return Err(Fault::ModelTooSlow);
        }
        companion.rebuild(model)?;
        estimator.rebuild(model, kernel).map_err(|_| Fault::ModelUnsupported)?;
        let id = header.content_hash.first_chunk::<8>().copied().unwrap_or_default();
        companion.identity = id;
        Ok(ModelFacts { period, id })
    }
}

impl<'a, K: Kernel, S: BorrowMut<EstimatorState>, M: BorrowMut<Model<'a>>> ModelStep for RunningModel<'a, K, S, M> {
    fn step(&mut self, input: f32) -> f32 {
        let Companion { guard, guard_state, is_outside, .. } = &mut self.companion;
        *is_outside = self.is_ready && guard.is_outside(guard_state, input);
        if self.is_ready { self.estimator.step(self.state.borrow_mut(), input).value } else { f32::NAN }
    }

    fn reset(&mut self) {
        self.state.borrow_mut().reset();
        self.companion.reset();
    }

    fn is_present(&self) -> bool {
        self.is_ready
    }

    fn direction(&self) -> Direction {
        if self.is_ready { self.companion.direction } else { Direction::Estimator }
    }

    fn compensator(&self) -> Option<&Compensator> {
        let Companion { compensator, compensates, .. } = &self.companion;
        (self.is_ready && *compensates).then_some(compensator)
    }

    fn is_outside_domain(&self) -> bool {
        self.companion.is_outside
    }

    fn identity(&self) -> [u8; 8] {
        if self.is_ready { self.companion.identity } else { [0; 8] }
    }
}

/// Checks a blob in a place of its own: [`RunningModel::load`].
///
/// # Errors
/// The fault to raise.
pub fn examine(bytes: &[u8], kernel: impl KernelSource) -> Result<ModelFacts, Fault> {
    RunningModel::default().load(bytes, kernel)
}

#[inline(never)]
fn check<K: Kernel>(
    estimator: &Estimator<'_, K>,
    state: &mut EstimatorState,
    golden: &Golden<'_>,
    budget: &StepBudget<impl StepTimer>,
) -> Result<(), Fault> {
    let replay = estimator.replay_timed(state, golden, budget);
    if replay.too_slow {
        return Err(Fault::ModelTooSlow);
    }
    if !replay.passed() {
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
