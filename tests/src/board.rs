//! The board's own tasks on the desktop: tick and background with the queues between them, run in an order that chance decides.
//!
//! On the chip the background runs whenever no interrupt does, so how many of its rounds lie between two ticks is anybody's guess, and a
//! long one (a self-test, an erase of flash) lies between many. Here a seed decides. Around them are the host tool's simulated hardware and
//! a line of the board's speed. What stays out: registers, and an interrupt in the middle of a round.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::convert::Infallible;
use std::rc::Rc;
use std::time::Duration;

use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use firmware::board::SELECTED;
use firmware::board::background_task::{BackgroundQueues, BackgroundTask, Facts, TRANSMIT_QUEUE};
use firmware::board::shared_atomics::{AnswerQueue, CommandQueue, SharedAtomics, TelemetryQueue, TraceQueue};
use firmware::board::stm32f405::facts::CORE_HZ;
use firmware::board::tick_task::{CrashMemory, CycleCounter, TickIo, TickQueues, TickTask};
use firmware::board::watchdog::{Watchdog, WatchdogTimer};
use firmware::crash_record::SEALED_BYTES;
use firmware::device::exchange::DeviceOutputs;
use firmware::drivers::{DumpValve, PulseFrequency, RawSample, SampleSource, ValveDrive};
use firmware::history::{HistoryMemory, HistoryWords, RamHistory};
use firmware::link::{Link, LinkConfig};
use firmware::parity::Noise;
use firmware::tick::{BootReport, TickConfig};
use host_tool::link::{FACTS, FlashMemory, Hardware, Heap, LinkError, SlotPair, Transport};
use model_export::link::fault::FaultSet;
use model_export::link::frame::MAX_WIRE;
use model_export::link::state::ResetCause;

/// What the tick reads and writes.
#[derive(Default)]
struct Wires {
    sample: Cell<RawSample>,
    pressed: Cell<bool>,
    energised: Cell<bool>,
    valve_share: Cell<u16>,
    slow: Cell<bool>,
    cycles: Cell<u32>,
    history: RefCell<RamHistory>,
}

/// One end of the wires.
#[derive(Clone, Default)]
pub struct Wire(Rc<Wires>);

impl SampleSource for Wire {
    fn sample(&mut self) -> RawSample {
        self.0.sample.get()
    }
}

impl ValveDrive for Wire {
    fn drive(&mut self, share: u16) {
        self.0.valve_share.set(share);
    }
}

/// The drive that the settings do not choose.
pub struct Unconnected;

impl ValveDrive for Unconnected {
    fn drive(&mut self, _share: u16) {}
}

impl PulseFrequency for Unconnected {
    fn set_pulse_hz(&mut self, _pulse_hz: u32) {}
}

impl ErrorType for Wire {
    type Error = Infallible;
}

impl OutputPin for Wire {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.0.energised.set(false);
        Ok(())
    }
    fn set_high(&mut self) -> Result<(), Infallible> {
        self.0.energised.set(true);
        Ok(())
    }
}

impl InputPin for Wire {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.pressed.get())
    }
    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(!self.0.pressed.get())
    }
}

impl CycleCounter for Wire {
    fn cycles(&self) -> u32 {
        // Read at the beginning and at the end of a tick: a slow one takes longer than its millisecond.
        let step = if self.0.slow.get() { CORE_HZ / 500 } else { 1000 };
        self.0.cycles.set(self.0.cycles.get().wrapping_add(step));
        self.0.cycles.get()
    }
}

impl WatchdogTimer for Wire {
    fn is_busy(&self) -> bool {
        false
    }
    fn set(&mut self, _prescaler: u8, _reload: u16) {}
    fn feed(&mut self) {}
}

impl HistoryWords for Wire {
    fn read(&self, word: usize) -> u32 {
        self.0.history.borrow().read(word)
    }
}

impl HistoryMemory for Wire {
    fn write(&mut self, word: usize, value: u32) {
        self.0.history.borrow_mut().write(word, value);
    }
}

impl CrashMemory for Wire {
    fn keep(&mut self, _sealed: &[u8; SEALED_BYTES]) {}
}

type BoardIo = TickIo<Wire, Wire, Unconnected, Wire, Wire, Wire, Wire, Wire>;

/// The serial line, both ways.
#[derive(Default)]
struct Cable {
    to_device: VecDeque<u8>,
    from_device: VecDeque<u8>,
    /// Sends it has taken so far; where one of them is to be lost on the way.
    sends: u32,
    lost: Option<u32>,
}

impl embedded_io::ErrorType for Cable {
    type Error = core::convert::Infallible;
}

impl embedded_io::ReadReady for Cable {
    fn read_ready(&mut self) -> Result<bool, Self::Error> {
        Ok(!self.to_device.is_empty())
    }
}

impl embedded_io::Read for Cable {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Self::Error> {
        let queue = &mut self.to_device;
        Ok(bytes.iter_mut().zip(core::iter::from_fn(|| queue.pop_front())).map(|(byte, new)| *byte = new).count())
    }
}

impl embedded_io::WriteReady for Cable {
    fn write_ready(&mut self) -> Result<bool, Self::Error> {
        // Whole frames, since one of them may have to be lost.
        Ok(TRANSMIT_QUEUE - self.from_device.len() > MAX_WIRE)
    }
}

impl embedded_io::Write for Cable {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
        self.sends += 1;
        if self.lost != Some(self.sends) {
            self.from_device.extend(bytes);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Self::Error> {
        Ok(())
    }
}

/// The board, its hardware and its line.
pub struct Board {
    task: TickTask<'static, BoardIo>,
    background: BackgroundTask<'static, SlotPair, SlotPair>,
    place: Heap,
    shared: &'static SharedAtomics,
    wires: Wire,
    hardware: Hardware,
    cable: Cable,
    to_host: Vec<u8>,
    line_bytes_per_tick: usize,
    chance: Noise,
    ticks: u64,
}

impl Board {
    /// A board that has just started with this flash.
    ///
    /// # Panics
    /// When not even the default settings go together.
    #[must_use]
    pub fn new(flash: FlashMemory, hardware: Hardware, seed: u32) -> Self {
        // The tasks want what the chip gives them: queues that live for ever.
        let shared: &'static SharedAtomics = Box::leak(Box::default());
        let (commands_in, commands_out) = Box::leak(Box::new(CommandQueue::new())).split();
        let (answers_in, answers_out) = Box::leak(Box::new(AnswerQueue::new())).split();
        let (telemetry_in, telemetry_out) = Box::leak(Box::new(TelemetryQueue::new())).split();
        let (trace_in, trace_out) = Box::leak(Box::new(TraceQueue::new())).split();
        let config = LinkConfig {
            firmware: firmware::VERSION,
            board: heapless::String::try_from(SELECTED.name).unwrap_or_default(),
            reset_cause: ResetCause::PowerOn,
            previous_record: None,
            facts: FACTS,
        };
        let link = Link::new(config, flash.settings, flash.models);
        let tick = TickConfig { settings: link.settings(), facts: FACTS }.build().expect("settings that go together");
        let boot = BootReport { reset_cause: ResetCause::PowerOn, faults: link.boot_faults() };
        let wires = Wire::default();
        let io = TickIo {
            source: wires.clone(),
            analogue: wires.clone(),
            pulse: Unconnected,
            dump_valve: DumpValve::new(wires.clone()),
            emergency_stop: wires.clone(),
            watchdog: Watchdog::new(wires.clone()),
            counter: wires.clone(),
            crash_memory: wires.clone(),
        };
        let queues = TickQueues { commands: commands_out, answers: answers_in, telemetry: telemetry_in, trace: trace_in };
        let facts = Facts { program: &[], program_crc32: 0, clock: None, faults: FaultSet::EMPTY, chip: None };
        let background_queues =
            BackgroundQueues { commands: commands_in, answers: answers_out, telemetry: telemetry_out, trace: trace_out };
        Self {
            task: TickTask::new(tick, boot, io, queues, shared, CORE_HZ / 1000, None),
            background: BackgroundTask::new(link, facts, background_queues, shared),
            place: Heap::default(),
            shared,
            wires,
            hardware,
            cable: Cable::default(),
            to_host: Vec::new(),
            line_bytes_per_tick: 92,
            chance: Noise::new(seed),
            ticks: 0,
        }
    }

    /// The hardware, to look at and to break.
    pub fn hardware(&mut self) -> &mut Hardware {
        &mut self.hardware
    }

    /// Presses or releases the emergency stop.
    pub fn press(&mut self, pressed: bool) {
        self.wires.0.pressed.set(pressed);
    }

    /// Makes the line slower or faster, in bytes a millisecond.
    pub fn set_line(&mut self, bytes_per_tick: usize) {
        self.line_bytes_per_tick = bytes_per_tick;
    }

    /// Loses a whole frame on the line, so many frames from now.
    pub fn lose_frame(&mut self, frames_from_now: u32) {
        self.cable.lost = Some(self.cable.sends + frames_from_now);
    }

    fn below(&mut self, limit: u32) -> u32 {
        // A share of the range, far from the noise's own resolution.
        ((0.5 + 0.5 * self.chance.symmetric()) * limit as f32) as u32 % limit
    }

    /// One millisecond, now and then two.
    fn advance(&mut self) {
        let lost = u32::from(self.below(400) == 0);
        self.shared.add_periods(1 + lost);
        let slow = self.below(300) == 0;
        self.wires.0.slow.set(slow);
        self.wires.0.sample.set(self.hardware.sample());
        self.task.run(&mut self.place);
        for _ in 0..=lost {
            let outputs = DeviceOutputs {
                energised: self.wires.0.energised.get(),
                valve_share: self.wires.0.valve_share.get(),
                ..DeviceOutputs::default()
            };
            self.hardware.apply(&outputs);
            self.hardware.advance();
            self.ticks += 1;
        }
        let carried = self.line_bytes_per_tick.min(self.cable.from_device.len());
        self.to_host.extend(self.cable.from_device.drain(..carried));
        // None at all now and then, as while it is busy.
        let rounds = if self.below(8) == 0 { 0 } else { 1 + self.below(150) };
        for _ in 0..rounds {
            self.background.step(&mut self.cable, &mut self.place, 0, 0);
        }
    }
}

impl Transport for Board {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.cable.to_device.extend(bytes);
        Ok(())
    }

    fn receive(&mut self, limit: Duration, into: &mut Vec<u8>) -> Result<(), LinkError> {
        let until = self.elapsed() + limit;
        while self.to_host.is_empty() && self.elapsed() < until {
            self.advance();
        }
        into.append(&mut self.to_host);
        Ok(())
    }

    fn elapsed(&self) -> Duration {
        Duration::from_millis(self.ticks)
    }

    fn place(&self) -> &'static str {
        "the board's tasks"
    }
}
