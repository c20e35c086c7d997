//! The tick's task: from the hardware's traits through [`Rig::tick`] and back, once a millisecond.
//!
//! The board runs it in the interrupt of the end of the injected conversions. The proof that it cannot panic links it with the board's own types;
//! in the emulator the flashable image runs it.

use embedded_hal::digital::{InputPin, OutputPin};
use heapless::spsc::{Consumer, Producer};
use model_export::link::message::Telemetry;
use model_export::link::state::State;
use model_export::link::trace::{MAX_RECORD_BYTES, TraceRecord};

use super::periods::PeriodClock;
use super::read_back::{PutOut, ReadBackMonitor};
use super::rest_noise::RestNoise;
use super::shared_atomics::{self, SharedAtomics, TRACE_QUEUE_BYTES};
use super::supply::SupplyCorrection;
use super::watchdog::{Watchdog, WatchdogTimer};
use crate::crash_record::{CrashRecord, SEALED_BYTES};
use crate::drivers::{DumpValve, PulseFrequency, SampleSource, ValveDrive};
use crate::history::{History, HistoryMemory};
use crate::tick::{Answer, BootReport, Command, ModelStep, Rig, TakenIn, Tick, TickInputs, ValveOutput};

/// Counts processor cycles.
pub trait CycleCounter {
    /// Cycles so far; wraps. Always zero where there is no counter.
    fn cycles(&self) -> u32;
}

/// Keeps the sealed record, and the history, where a reset does not reach.
pub trait CrashMemory: HistoryMemory {
    /// Overwrites the record.
    fn keep(&mut self, sealed: &[u8; SEALED_BYTES]);
}

/// What the tick reads and writes.
#[derive(Debug)]
pub struct TickIo<Source, Analogue, Pulse, Dump, Stop, Timer, Counter, Memory> {
    /// Both measured channels.
    pub source: Source,
    /// The valve's drive by voltage.
    pub analogue: Analogue,
    /// The valve's drive by pulse width.
    pub pulse: Pulse,
    /// The dump valve.
    pub dump_valve: DumpValve<Dump>,
    /// The emergency stop: low is released, everything else pressed.
    pub emergency_stop: Stop,
    /// The watchdog.
    pub watchdog: Watchdog<Timer>,
    /// Measures the tick.
    pub counter: Counter,
    /// Keeps the fault record.
    pub crash_memory: Memory,
}

/// The tick's ends of the queues.
pub struct TickQueues<'q> {
    /// Commands from the background.
    pub commands: Consumer<'q, Command>,
    /// Answers to it.
    pub answers: Producer<'q, Answer>,
    /// Telemetry to it.
    pub telemetry: Producer<'q, Telemetry>,
    /// The trace to it.
    pub trace: Producer<'q, u8>,
}

/// The rig in its task.
pub struct TickTask<'q, H> {
    rig: Rig,
    io: H,
    queues: TickQueues<'q>,
    shared: &'q SharedAtomics,
    clock: PeriodClock,
    cycles_per_tick: u32,
    overran: bool,
    tests_itself: bool,
    trace_put: u32,
    pulse_hz: u32,
    put_out: PutOut,
    monitor: ReadBackMonitor,
    correction: SupplyCorrection,
    history: History,
    rest_noise: RestNoise,
}

impl<'q, H> TickTask<'q, H> {
    /// A task that has not run yet. `cycles_per_tick` is the deadline, `reference_calibration` the factory's code of the reference voltage.
    ///
    /// The rig is made here and not by the caller: handed over, each of its 3 KiB was on the stack twice on its way into place.
    #[inline(always)]
    pub fn new(
        tick: Tick,
        boot: BootReport,
        io: H,
        queues: TickQueues<'q>,
        shared: &'q SharedAtomics,
        cycles_per_tick: u32,
        reference_calibration: Option<u16>,
    ) -> Self {
        let monitor = ReadBackMonitor::new(reference_calibration);
        Self {
            rig: Rig::new(tick, boot),
            io,
            queues,
            shared,
            clock: PeriodClock::default(),
            cycles_per_tick,
            overran: false,
            tests_itself: false,
            trace_put: 0,
            pulse_hz: 0,
            put_out: PutOut::default(),
            monitor,
            correction: SupplyCorrection::new(monitor.calibration()),
            history: History::new(),
            rest_noise: RestNoise::default(),
        }
    }

    /// The rig.
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// Puts a record on its way; ends the trace where it does not fit.
    #[inline(never)]
    fn trace(&mut self, record: &TraceRecord) {
        let under_way = self.trace_put.wrapping_sub(self.shared.trace_taken());
        let room = (TRACE_QUEUE_BYTES - 1).saturating_sub(usize::try_from(under_way).unwrap_or(usize::MAX));
        let mut place = [0; MAX_RECORD_BYTES];
        let encoded = record.encode(room, &mut place);
        for byte in place.iter().take(encoded.length) {
            // There is room for all of it.
            let _ = shared_atomics::put(&mut self.queues.trace, *byte);
            self.trace_put = self.trace_put.wrapping_add(1);
        }
        if encoded.overflowed {
            self.rig.end_trace();
        }
    }

    /// What the tick reads and writes.
    pub fn io_mut(&mut self) -> &mut H {
        &mut self.io
    }
}

impl<Source, Analogue, Pulse, Dump, Stop, Timer, Counter, Memory>
    TickTask<'_, TickIo<Source, Analogue, Pulse, Dump, Stop, Timer, Counter, Memory>>
where
    Source: SampleSource,
    Analogue: ValveDrive,
    Pulse: ValveDrive + PulseFrequency,
    Dump: OutputPin,
    Stop: InputPin,
    Timer: WatchdogTimer,
    Counter: CycleCounter,
    Memory: CrashMemory,
{
    /// One millisecond.
    ///
    /// # Deadline
    /// The tick itself: 1 ms from interrupt to interrupt.
    pub fn run(&mut self, model: &mut impl ModelStep) {
        let began = self.io.counter.cycles();
        self.shared.begin_tick();
        let lost_ticks = self.clock.lost(self.shared.periods());
        let inputs = TickInputs {
            sample: self.correction.sample(self.io.source.sample()),
            emergency_stop: !matches!(self.io.emergency_stop.is_low(), Ok(true)),
            // A tick that cannot be told from a late one counts as late.
            overran: self.overran || self.clock.stands(),
            lost_ticks,
            background_beat: self.shared.beat(),
            vent: self.shared.take_vent(),
            // No answer may be lost, so a command waits for its answer's place.
            command: if shared_atomics::has_room(&self.queues.answers) { shared_atomics::take(&mut self.queues.commands) } else { None },
            telemetry_dropped: self.shared.telemetry_dropped(),
        };
        let taken = TakenIn::from(&inputs);
        let sample = inputs.sample;
        // What was read is what the last tick put out.
        if let Some(read) = self.io.source.read_back() {
            if let Some(code) = read.reference_code {
                self.correction.step(code);
            }
            self.shared.report_outputs(self.monitor.step(&read, self.put_out));
            self.shared.publish_self(self.monitor.supply_mv(), read.chip_code);
        }
        let outputs = self.rig.tick(model, inputs);

        // New settings come only while vented, with the drive at zero.
        let pulse_hz = self.rig.built().pulse_hz();
        if pulse_hz != self.pulse_hz && !outputs.energised {
            self.io.pulse.set_pulse_hz(pulse_hz);
            self.pulse_hz = pulse_hz;
        }
        let (analogue, pulse) = match self.rig.built().valve_output() {
            ValveOutput::Analogue => (outputs.valve_share, 0),
            ValveOutput::PulseWidth => (0, outputs.valve_share),
        };
        // On the chip setting a pin cannot fail. The watchdog and the pressure watch are there for one that does.
        let order = self.rig.supervisor().dump_order();
        let _ = self.io.dump_valve.obey(&order);
        let analogue = self.correction.drive(analogue);
        self.put_out = PutOut { share: analogue, closes: order.closes() };
        self.io.analogue.drive(analogue);
        self.io.pulse.drive(pulse);
        self.io.watchdog.serve(outputs.energised, outputs.feed_watchdog);
        if let Some(mean_squares) = self.rest_noise.step(sample, outputs.vent_verified && !outputs.energised) {
            self.shared.publish_rest_noise(mean_squares);
        }
        let row = self.rig.history_row(taken, &outputs);
        self.history.step(&mut self.io.crash_memory, row, outputs.energised, outputs.state == State::Fault);
        if outputs.record_changed {
            let crash_record = CrashRecord { record: *self.rig.supervisor().record(), crash: None };
            self.io.crash_memory.keep(&crash_record.encode());
        }
        if outputs.self_test_wanted && !self.tests_itself {
            self.shared.ask_for_self_test();
        }
        self.tests_itself = outputs.self_test_wanted;
        // Before the answer that ends a trace: the background then finds all of it.
        if let Some(record) = &outputs.trace {
            self.trace(record);
        }
        if let Some(answer) = outputs.answer {
            // The place was seen to be free above.
            let _ = shared_atomics::put(&mut self.queues.answers, answer);
        }
        if let Some(sample) = outputs.telemetry
            && shared_atomics::put(&mut self.queues.telemetry, sample).is_err()
        {
            self.shared.drop_telemetry();
        }
        let cycles = self.io.counter.cycles().wrapping_sub(began);
        self.overran = cycles > self.cycles_per_tick;
        self.shared.publish(outputs.state, outputs.vent_verified, cycles);
    }
}
