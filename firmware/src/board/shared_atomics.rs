//! What the tick and the background share: a few words, each written by one side.

use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU16, AtomicU32, Ordering};

use heapless::spsc::{Consumer, Producer, Queue};
use model_export::link::fault::{Fault, FaultSet};
use model_export::link::message::Telemetry;
use model_export::link::state::State;

use super::pulse_drive::PulseExpectation;
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

/// No mean square: one of that size is none that twelve bits can have.
const NOT_MEASURED: u32 = u32::MAX;

/// The shared words. Every one is independent of the others, so no order between them matters.
#[derive(Debug, Default)]
pub struct SharedAtomics {
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
    supply_mv: AtomicU16,
    chip_code: AtomicU16,
    rest_noise: [AtomicU32; 2],
    pulse_differs: AtomicBool,
    /// What the tick expects of the pulse width's pin.
    pub pulse: PulseExpectation,
}

impl SharedAtomics {
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
            supply_mv: AtomicU16::new(0),
            chip_code: AtomicU16::new(0),
            rest_noise: [AtomicU32::new(NOT_MEASURED), AtomicU32::new(NOT_MEASURED)],
            pulse_differs: AtomicBool::new(false),
            pulse: PulseExpectation::new(),
        }
    }

    /// The tick tells what was measured of the chip itself.
    pub fn publish_self(&self, supply_mv: u16, chip_code: Option<u16>) {
        self.supply_mv.store(supply_mv, Ordering::Relaxed);
        if let Some(code) = chip_code {
            self.chip_code.store(code, Ordering::Relaxed);
        }
    }

    /// Analogue supply in mV and code of the chip's temperature sensor; zeros before they were measured.
    pub fn measured_self(&self) -> (u16, u16) {
        (self.supply_mv.load(Ordering::Relaxed), self.chip_code.load(Ordering::Relaxed))
    }

    /// The tick tells the mean squares of laser and pressure at rest ([`super::rest_noise`]).
    pub fn publish_rest_noise(&self, mean_squares: [u32; 2]) {
        for (place, square) in self.rest_noise.iter().zip(mean_squares) {
            place.store(square.min(NOT_MEASURED - 1), Ordering::Relaxed);
        }
    }

    /// The same; none before the first second at rest.
    pub fn rest_noise(&self) -> Option<[u32; 2]> {
        let [laser, pressure] = &self.rest_noise;
        let squares = [laser, pressure].map(|place| place.load(Ordering::Relaxed));
        (!squares.contains(&NOT_MEASURED)).then_some(squares)
    }

    /// The background tells whether the pulse width's pin does what it should ([`super::pulse_drive`]).
    pub fn report_pulse(&self, differs: bool) {
        self.pulse_differs.store(differs, Ordering::Relaxed);
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
        let differs = self.outputs_differ.load(Ordering::Relaxed) || self.pulse_differs.load(Ordering::Relaxed);
        faults.insert_if(differs, Fault::OutputMismatch);
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
