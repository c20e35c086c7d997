//! The estimator: pressure in, displacement out, one sample at a time; or several inputs, one value of each at a time.
//!
//! [`FrontEnd`] is the physics in `f32`, [`Network`] the fixed-point LSTM that corrects it, [`Estimator`] both together as a blob
//! describes them. Parameters are immutable and borrow the blob; [`EstimatorState`] is all that changes, so a copy of it is a snapshot.

mod arithmetic;
mod cost;
mod curve;
mod front_end;
mod kernel;
mod layer;
mod network;
mod packed;
mod shape;
#[cfg(target_os = "none")]
#[allow(unsafe_code, reason = "the assembly of the fast kernel; every block says why it is sound")]
mod smlad;

use hysteresis::stick_band;
use model_export::blob::crc32;
use model_export::schema::{self, MAX_INPUTS, MAX_WIDTH, MAX_WINDOW_VALUES, Mode, Model};
use model_export::validate::Invalid;

pub use arithmetic::{quantise_feature, sigmoid, tanh};
pub use cost::step_instructions;
pub use curve::MAX_NORMALISED;
pub use front_end::{FrontEnd, FrontEndOutput, FrontEndState, MAX_READOUT};
pub use kernel::{Kernel, Portable};
pub use layer::{Layer, LayerState, NoTrace, Trace, UnitTrace};
pub use network::{KernelSource, Network, NetworkState};
pub use packed::{MAX_PACKED_WORDS, Packed};

/// A model, ready to run; immutable.
#[derive(Clone, Debug)]
pub struct Estimator<'a, K: Kernel = Portable> {
    front_end: FrontEnd,
    network: Option<(Network<'a>, K)>,
    mode: Mode,
    output_offset: f32,
    output_scale: f32,
}

/// Gives nothing but zero.
impl<K: Kernel> Default for Estimator<'_, K> {
    fn default() -> Self {
        let (front_end, mode) = (FrontEnd::default(), Mode::default());
        Self { front_end, network: None, mode, output_offset: 0.0, output_scale: 0.0 }
    }
}

/// All that changes from sample to sample. A clone is a snapshot; assigning it back restores.
#[derive(Clone, Debug, PartialEq)]
pub struct EstimatorState {
    front_end: FrontEndState,
    network: NetworkState,
    window: Window,
    /// Where the stick band rests, in normalised output; nothing before the first sample.
    stuck: Option<f32>,
}

/// The last feature vectors, oldest overwritten first.
#[derive(Clone, Debug, PartialEq)]
struct Window {
    values: [i16; MAX_WINDOW_VALUES],
    oldest: usize,
    filled: bool,
}

impl Default for EstimatorState {
    fn default() -> Self {
        Self::new()
    }
}

impl EstimatorState {
    /// At the start; nothing but zeros, so that a static of it costs no flash.
    #[must_use]
    pub const fn new() -> Self {
        let window = Window { values: [0; MAX_WINDOW_VALUES], oldest: 0, filled: false };
        Self { front_end: FrontEndState::new(), network: NetworkState::new(), window, stuck: None }
    }

    /// Forgets everything: the next sample starts from its equilibrium.
    pub fn reset(&mut self) {
        // In place: a fresh one would be built on the stack of the tick first.
        let Self { front_end, network, window, stuck } = self;
        front_end.reset();
        network.reset();
        window.values.fill(0);
        (window.oldest, window.filled, *stuck) = (0, false, None);
    }

    /// The front end's memory.
    #[must_use]
    pub fn front_end(&self) -> &FrontEndState {
        &self.front_end
    }

    /// The network's memory; in window mode, that of the last run.
    #[must_use]
    pub fn network(&self) -> &NetworkState {
        &self.network
    }
}

/// What one step gives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The estimate in the output channel's unit.
    pub value: f32,
    /// The network's part, in normalised output.
    pub correction: f32,
    /// The sample was no measurement and the last good one was used.
    pub held: bool,
}

/// How a replay of the golden vectors went.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GoldenReplay {
    /// Samples replayed.
    pub samples: usize,
    /// Largest difference from the reference, in output units.
    pub worst: f32,
    /// Every sample lies within the tolerance.
    pub within_tolerance: bool,
    /// The output bits are those that the exporter saw.
    pub same_bits: bool,
    /// The steps took longer than they may, and the replay ended there.
    pub too_slow: bool,
}

/// What a step's execution time is measured with: on the board the processor's cycle counter.
pub trait StepTimer {
    /// Free-running cycles; the difference across a step is what it took.
    fn cycles(&self) -> u32;
}

/// Where there is nothing to measure with: the emulator's counter stands still, and the desktop's time says nothing about the board.
#[derive(Clone, Copy, Debug)]
pub struct Untimed;

impl StepTimer for Untimed {
    fn cycles(&self) -> u32 {
        0
    }
}

/// How long a step of a model may take.
#[derive(Clone, Copy, Debug)]
pub struct StepBudget<T> {
    /// What it is measured with.
    pub timer: T,
    /// Cycles that are allowed.
    pub cycles: u32,
}

impl StepBudget<Untimed> {
    /// Without a limit.
    pub const UNLIMITED: Self = Self { timer: Untimed, cycles: u32::MAX };
}

/// Steps in a row beyond the budget that make a model too slow. The tick interrupts the replay once a millisecond, and so lengthens at most two of three
/// steps that last more than half a millisecond; one of four is undisturbed.
pub const OVER_BUDGET_STEPS: u32 = 4;

impl GoldenReplay {
    /// Whether the estimator may be trusted.
    #[must_use]
    pub fn passed(&self) -> bool {
        self.within_tolerance && self.same_bits
    }
}

impl<'a> Estimator<'a, Portable> {
    /// Builds a model's estimator with the portable kernel.
    ///
    /// # Errors
    /// When a field of the model is out of its domain; never for a model that [`model_export::blob::decode`] gave.
    pub fn new(model: &Model<'a>) -> Result<Self, Invalid> {
        Self::with_kernel(model, Portable)
    }
}

impl<'a, K: Kernel> Estimator<'a, K> {
    /// Builds a model's estimator with a kernel made for it: by [`Portable`], or packed into memory of the caller's, a `&mut [u32]`.
    ///
    /// # Errors
    /// As [`Self::new`], and when the network does not fit into that memory.
    pub fn with_kernel(model: &Model<'a>, source: impl KernelSource<Kernel = K>) -> Result<Self, Invalid> {
        let mut estimator = Self::default();
        estimator.rebuild(model, source)?;
        Ok(estimator)
    }

    /// As [`Self::with_kernel`], over an estimator that is there already: it is too long for a small stack. After an error it means nothing.
    ///
    /// # Errors
    /// As [`Self::with_kernel`].
    pub fn rebuild(&mut self, model: &Model<'a>, source: impl KernelSource<Kernel = K>) -> Result<(), Invalid> {
        self.network = None;
        model.validate()?;
        self.front_end.rebuild(&model.front_end, &model.input, &model.more_inputs)?;
        if let Some(wire) = &model.network {
            self.rebuild_network(wire, source)?;
        }
        (self.mode, self.output_offset, self.output_scale) = (model.mode, model.output.offset, model.output.scale);
        Ok(())
    }

    // Not on the stack together with the checks of the model.
    #[inline(never)]
    fn rebuild_network(&mut self, wire: &schema::Network<'a>, source: impl KernelSource<Kernel = K>) -> Result<(), Invalid> {
        let network = Network::new(wire, self.front_end.features())?;
        let kernel = source.kernel(&network)?;
        self.network = Some((network, kernel));
        Ok(())
    }

    /// Number of inputs.
    #[must_use]
    pub fn inputs(&self) -> usize {
        self.front_end.inputs().max(1)
    }

    /// The network, when there is one.
    #[must_use]
    pub fn network(&self) -> Option<&Network<'a>> {
        self.network.as_ref().map(|(network, _)| network)
    }

    /// One sample in the input channel's unit, at the model's sample period, gives the estimate in the output channel's unit.
    ///
    /// A sample that is not finite or absurd is replaced by the last good one and counted; the estimate is always finite.
    ///
    /// # Deadline
    /// Runs in the control tick. In window mode the network runs once per sample of the window.
    pub fn step(&self, state: &mut EstimatorState, raw: f32) -> Estimate {
        self.step_all(state, &[raw])
    }

    /// As [`Self::step`], with a value of each input; a missing one is no measurement.
    ///
    /// # Deadline
    /// As [`Self::step`].
    #[inline(always)]
    pub fn step_all(&self, state: &mut EstimatorState, raw: &[f32]) -> Estimate {
        let mut features = [0; MAX_WIDTH];
        // Without a network nobody sees the features.
        let wanted = if self.network.is_some() { &mut features[..] } else { &mut [] };
        let physics = self.front_end.step(&mut state.front_end, raw, wanted);
        let correction = self.network.as_ref().map_or(0.0, |(network, kernel)| match self.mode {
            Mode::Streaming => network.step(kernel, &mut state.network, &features),
            Mode::Window { length } => self.run_window((network, kernel), state, usize::from(length), &features),
        });
        let normalised = physics.readout + correction;
        let band = self.front_end.config().stick_band;
        let stuck = state.stuck.map_or(normalised, |last| stick_band::step(band, normalised, last));
        state.stuck = Some(stuck);
        let value = self.output_offset + self.output_scale * stuck;
        Estimate { value, correction, held: physics.held }
    }

    // Its vector of features is not on the stack of a network that streams.
    #[inline(never)]
    fn run_window(
        &self,
        (network, kernel): (&Network<'a>, &K),
        state: &mut EstimatorState,
        length: usize,
        newest: &[i16; MAX_WIDTH],
    ) -> f32 {
        let width = self.front_end.features();
        let EstimatorState { window, network: memory, .. } = state;
        let vector = newest.get(..width).unwrap_or(newest);
        let slots = window.values.get_mut(..length * width).unwrap_or(&mut []);
        if window.filled {
            slots.iter_mut().skip(window.oldest * width).zip(vector).for_each(|(slot, value)| *slot = *value);
            window.oldest = if window.oldest + 1 < length { window.oldest + 1 } else { 0 };
        } else {
            // Before the first sample the input is taken to have rested where it begins.
            for slot in slots.chunks_exact_mut(width.max(1)) {
                slot.iter_mut().zip(vector).for_each(|(slot, value)| *slot = *value);
            }
            window.filled = true;
        }
        memory.reset();
        let mut correction = 0.0;
        let (newer, older) = slots.split_at_checked(window.oldest * width).unwrap_or((&mut [], &mut []));
        for vector in older.chunks_exact(width.max(1)).chain(newer.chunks_exact(width.max(1))) {
            let mut input = [0; MAX_WIDTH];
            for (slot, value) in input.iter_mut().zip(vector) {
                *slot = *value;
            }
            correction = network.step(kernel, memory, &input);
        }
        correction
    }

    /// Replays golden vectors from the reset state.
    #[must_use]
    pub fn replay(&self, golden: &schema::Golden<'_>) -> GoldenReplay {
        self.replay_in(&mut EstimatorState::default(), golden)
    }

    /// Replays golden vectors from the reset state, in memory of the caller's.
    ///
    /// # Deadline
    /// Not for the control tick: up to 512 steps.
    pub fn replay_in(&self, state: &mut EstimatorState, golden: &schema::Golden<'_>) -> GoldenReplay {
        self.replay_timed(state, golden, &StepBudget::UNLIMITED)
    }

    /// As [`Self::replay_in`], and ends early where the steps take longer than they may.
    ///
    /// # Deadline
    /// Not for the control tick: up to 512 steps within the budget, or [`OVER_BUDGET_STEPS`] beyond it.
    pub fn replay_timed<T: StepTimer>(
        &self,
        state: &mut EstimatorState,
        golden: &schema::Golden<'_>,
        budget: &StepBudget<T>,
    ) -> GoldenReplay {
        state.reset();
        let (mut worst, mut digest, mut samples) = (0.0f32, 0, 0);
        let (mut over_budget, mut too_slow) = (0, false);
        let inputs = self.inputs();
        for (input, expected) in golden.input.as_chunks::<4>().0.chunks(inputs).zip(golden.output.as_chunks().0) {
            let mut raw = [0.0; MAX_INPUTS];
            raw.iter_mut().zip(input).for_each(|(value, bytes)| *value = f32::from_le_bytes(*bytes));
            let began = budget.timer.cycles();
            let value = self.step_all(state, raw.get(..inputs).unwrap_or(&raw)).value;
            let cycles = budget.timer.cycles().wrapping_sub(began);
            over_budget = if cycles > budget.cycles { over_budget + 1 } else { 0 };
            if over_budget >= OVER_BUDGET_STEPS {
                too_slow = true;
                break;
            }
            let difference = (value - f32::from_le_bytes(*expected)).abs();
            worst = if difference > worst { difference } else { worst };
            digest = crc32(digest, &value.to_le_bytes());
            samples += 1;
        }
        GoldenReplay { samples, worst, within_tolerance: worst <= golden.tolerance, same_bits: digest == golden.digest, too_slow }
    }
}
