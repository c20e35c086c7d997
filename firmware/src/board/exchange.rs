//! What the tick and the background share: a few words, each written by one side.

use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};

use heapless::spsc::{Consumer, Producer, Queue};
use model_export::link::fault::{Fault, FaultSet};
use model_export::link::message::Telemetry;
use model_export::link::state::State;

use crate::tick::{Answer, Command};

/// Commands on their way to the tick: four, and the queue keeps one place free.
pub type CommandQueue = Queue<Command, 5>;
/// Answers on their way back; the tick takes no command while there is no place for its answer.
pub type AnswerQueue = Queue<Answer, 5>;
/// Telemetry samples on their way to the link, which has a queue of its own.
pub type TelemetryQueue = Queue<Telemetry, 4>;
/// Bytes of a trace on their way to the link: a tenth of a second, for which a self-test may keep the background busy.
pub type TraceQueue = Queue<u8, TRACE_QUEUE_BYTES>;
/// Places of [`TraceQueue`], of which one stays free.
pub const TRACE_QUEUE_BYTES: usize = 1024;

/// Takes the oldest item.
///
/// A queue of no places would divide by zero. There is none, but its ends carry their length as a number that the compiler must believe
/// anything of, and the tick must be shown not to panic.
pub fn take<T>(queue: &mut Consumer<'_, T>) -> Option<T> {
    if queue.capacity().wrapping_add(1) == 0 { None } else { queue.dequeue() }
}

/// Puts an item behind the others; gives it back if there is no room. See [`take`].
///
/// # Errors
/// The item.
pub fn put<T>(queue: &mut Producer<'_, T>, item: T) -> Result<(), T> {
    if queue.capacity().wrapping_add(1) == 0 { Err(item) } else { queue.enqueue(item) }
}

/// Whether there is room for one more. See [`take`].
pub fn has_room<T>(queue: &Producer<'_, T>) -> bool {
    queue.capacity().wrapping_add(1) != 0 && queue.ready()
}

/// The shared words. Every one is independent of the others, so no order between them matters.
#[derive(Debug, Default)]
pub struct Exchange {
    vent: AtomicBool,
    beat: AtomicU32,
    telemetry_dropped: AtomicU32,
    state: AtomicU8,
    vent_verified: AtomicBool,
    reference_is_off: AtomicBool,
    outputs_differ: AtomicBool,
    self_tests: AtomicU32,
    longest_tick_cycles: AtomicU32,
    periods: AtomicU32,
    ticks: AtomicU32,
    trace_taken: AtomicU32,
}

impl Exchange {
    /// At the start.
    pub const fn new() -> Self {
        Self {
            vent: AtomicBool::new(false),
            beat: AtomicU32::new(0),
            telemetry_dropped: AtomicU32::new(0),
            state: AtomicU8::new(0),
            vent_verified: AtomicBool::new(false),
            reference_is_off: AtomicBool::new(false),
            outputs_differ: AtomicBool::new(false),
            self_tests: AtomicU32::new(0),
            longest_tick_cycles: AtomicU32::new(0),
            periods: AtomicU32::new(0),
            ticks: AtomicU32::new(0),
            trace_taken: AtomicU32::new(0),
        }
    }

    /// Counts bytes that the link has taken out of the trace's queue.
    pub fn take_trace(&self, bytes: u32) {
        self.trace_taken.fetch_add(bytes, Ordering::Relaxed);
    }

    /// Bytes taken out of the trace's queue so far; wraps.
    pub fn trace_taken(&self) -> u32 {
        self.trace_taken.load(Ordering::Relaxed)
    }

    /// Wants the next tick to vent.
    pub fn ask_for_vent(&self) {
        self.vent.store(true, Ordering::Relaxed);
    }

    /// Whether a vent was asked for since the last call.
    pub fn take_vent(&self) -> bool {
        // A load first: the swap is a loop of its own on this processor, and almost never needed.
        self.vent.load(Ordering::Relaxed) && self.vent.swap(false, Ordering::Relaxed)
    }

    /// The background lives.
    pub fn show_life(&self) {
        self.beat.fetch_add(1, Ordering::Relaxed);
    }

    /// Counter of [`Self::show_life`].
    pub fn beat(&self) -> u32 {
        self.beat.load(Ordering::Relaxed)
    }

    /// Counts a telemetry sample for which the queue had no place.
    pub fn drop_telemetry(&self) {
        self.telemetry_dropped.fetch_add(1, Ordering::Relaxed);
    }

    /// Samples dropped before the link saw them.
    pub fn telemetry_dropped(&self) -> u32 {
        self.telemetry_dropped.load(Ordering::Relaxed)
    }

    /// The tick tells its state, and whether the pressure was seen to be gone.
    pub fn publish(&self, state: State, vent_verified: bool, tick_cycles: u32) {
        self.vent_verified.store(vent_verified, Ordering::Relaxed);
        let number = State::ALL.iter().zip(0u8..).find(|(candidate, _)| **candidate == state).map_or(0, |(_, number)| number);
        self.state.store(number, Ordering::Relaxed);
        if tick_cycles > self.longest_tick_cycles.load(Ordering::Relaxed) {
            self.longest_tick_cycles.store(tick_cycles, Ordering::Relaxed);
        }
    }

    /// State after the last tick.
    pub fn state(&self) -> State {
        State::ALL.get(usize::from(self.state.load(Ordering::Relaxed))).copied().unwrap_or_default()
    }

    /// Whether the pressure was seen to be gone by the last tick.
    pub fn vent_verified(&self) -> bool {
        self.vent_verified.load(Ordering::Relaxed)
    }

    /// The tick tells what is wrong with supply and outputs.
    pub fn report_outputs(&self, faults: FaultSet) {
        self.reference_is_off.store(faults.contains(Fault::ReferenceVoltage), Ordering::Relaxed);
        self.outputs_differ.store(faults.contains(Fault::OutputMismatch), Ordering::Relaxed);
    }

    /// What is wrong with supply and outputs.
    pub fn output_faults(&self) -> FaultSet {
        let mut faults = FaultSet::EMPTY;
        faults.insert_if(self.reference_is_off.load(Ordering::Relaxed), Fault::ReferenceVoltage);
        faults.insert_if(self.outputs_differ.load(Ordering::Relaxed), Fault::OutputMismatch);
        faults
    }

    /// Longest tick so far, processor cycles; 0 if not measured.
    pub fn longest_tick_cycles(&self) -> u32 {
        self.longest_tick_cycles.load(Ordering::Relaxed)
    }

    /// Wants a self-test from the background.
    pub fn ask_for_self_test(&self) {
        self.self_tests.fetch_add(1, Ordering::Relaxed);
    }

    /// Self-tests wanted so far.
    pub fn self_tests(&self) -> u32 {
        self.self_tests.load(Ordering::Relaxed)
    }

    /// Counts periods of a millisecond, by a clock that does not depend on the sampling.
    pub fn add_periods(&self, periods: u32) {
        self.periods.fetch_add(periods, Ordering::Relaxed);
    }

    /// Periods so far; wraps.
    pub fn periods(&self) -> u32 {
        self.periods.load(Ordering::Relaxed)
    }

    /// A tick begins.
    pub fn begin_tick(&self) {
        self.ticks.fetch_add(1, Ordering::Relaxed);
    }

    /// Ticks begun so far; wraps.
    pub fn ticks(&self) -> u32 {
        self.ticks.load(Ordering::Relaxed)
    }
}
