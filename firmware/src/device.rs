//! The whole device as one thing driven tick by tick: rig, link, self-test and model in lock step.
//!
//! A board runs the tick in an interrupt and the link in the background, and which comes first is a matter of chance. Where that chance is
//! not wanted both run here, one after the other, the background exactly once after each tick: in the emulator's image, in the simulated rig of
//! the host tool, and in the replay of a recording. Equal inputs give equal outputs, to the bit, on every processor.
//!
//! Order within a [`Device::tick`]: tick, self-test if it is wanted, trace, answers and telemetry to the link, frames to the line. Bytes that came
//! from the host before the tick ([`Device::receive`]) have queued their commands by then, one of which the tick takes.

pub mod exchange;

pub use exchange::DeviceInputs;

use heapless::{Deque, Vec};
use model_export::link::fault::FaultSet;
use model_export::link::frame::MAX_WIRE;
use model_export::link::hello::MAX_BOARD_NAME;
use model_export::link::message::FaultRecord;
use model_export::link::state::{ResetCause, State};

use crate::background::{Background, ModelPlace};
use crate::crash_record::CrashRecord;
use crate::history::{History, HistoryMemory};
use crate::link::{CommandSink, Identity, Link, LinkConfig, Measured};
use crate::storage::Flash;
use crate::tick::{BootReport, Command, Inconsistent, ModelStep, Rig, RigFacts, TakenIn, TickConfig, TickInputs, TickOutputs};

/// Commands waiting for the tick.
pub const COMMAND_QUEUE: usize = 4;
/// Most bytes the line takes in one tick: 9.2 Mbaud, more than any serial adapter does.
pub const MAX_LINE_BYTES: usize = 920;

/// What a device is told when it starts.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceConfig {
    /// Firmware version: major, minor, patch.
    pub firmware: [u16; 3],
    /// Name of the board.
    pub board: heapless::String<MAX_BOARD_NAME>,
    /// Why it started.
    pub reset_cause: ResetCause,
    /// What survived the reset.
    pub crash_record: Option<CrashRecord>,
    /// The board's converter.
    pub facts: RigFacts,
    /// Bytes that the line to the host takes in a tick, at most [`MAX_LINE_BYTES`]: 92 at 921,600 baud.
    pub line_bytes_per_tick: u16,
}

/// Rig, link and everything between them.
#[derive(Debug)]
pub struct Device<S, M, P> {
    rig: Rig,
    background: Background<S, M>,
    place: P,
    queue: Queue,
    beat: u32,
    tests_itself: bool,
    line_bytes_per_tick: u16,
    history: History,
    line: Deque<u8, { MAX_LINE_BYTES + MAX_WIRE }>,
}

/// The places between link and tick.
#[derive(Debug, Default)]
struct Queue {
    commands: Deque<Command, COMMAND_QUEUE>,
    vent: bool,
}

impl CommandSink for Queue {
    fn send(&mut self, command: Command) -> bool {
        self.commands.push_back(command).is_ok()
    }

    fn vent(&mut self) {
        self.vent = true;
    }
}

impl<S: Flash, M: Flash, P: ModelPlace + ModelStep> Device<S, M, P> {
    /// A device that has just started, over its two pairs of flash slots.
    ///
    /// # Errors
    /// When not even the default settings go together with the converter, which is a mistake in the program.
    pub fn new(config: DeviceConfig, settings_flash: S, model_flash: M, place: P) -> Result<Self, Inconsistent> {
        let DeviceConfig { firmware, board, reset_cause, crash_record, facts, line_bytes_per_tick } = config;
        let previous_record = crash_record.map(|crash_record| crash_record.record).filter(|record| record.first != 0);
        let link = Link::new(LinkConfig { firmware, board, reset_cause, previous_record, facts }, settings_flash, model_flash);
        let crash = crash_record.map(|crash_record| crash_record.faults()).unwrap_or_default();
        let boot = BootReport { reset_cause, faults: link.boot_faults().union(crash) };
        let tick = TickConfig { settings: link.settings(), facts }.build()?;
        Ok(Self {
            rig: Rig::new(tick, boot),
            background: Background::new(link),
            place,
            queue: Queue::default(),
            beat: 0,
            tests_itself: false,
            line_bytes_per_tick,
            history: History::new(),
            line: Deque::new(),
        })
    }

    /// The rig.
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// The link.
    pub fn link(&self) -> &Link<S, M> {
        self.background.link()
    }

    /// The fault record of this run, for the memory that survives a reset.
    pub fn record(&self) -> &FaultRecord {
        self.rig.supervisor().record()
    }

    /// Takes a byte from the line.
    pub fn receive(&mut self, byte: u8) {
        self.background.receive(byte, &mut self.place, &mut self.queue);
    }

    /// One millisecond: the tick, then the background once.
    pub fn tick(&mut self, inputs: DeviceInputs) -> TickOutputs {
        let DeviceInputs { sample, emergency_stop, overran, lost_ticks } = inputs;
        let inputs = TickInputs {
            sample,
            emergency_stop,
            overran,
            lost_ticks,
            background_beat: self.beat,
            vent: core::mem::take(&mut self.queue.vent),
            command: self.queue.commands.pop_front(),
            telemetry_dropped: self.link().telemetry_dropped(),
        };
        let outputs = self.rig.tick(&mut self.place, inputs);
        self.follow(&outputs);
        outputs
    }

    /// As [`Self::tick`], with memory that survives a reset: the tick leaves its row there, and a request for the rows finds them.
    pub fn tick_remembering(&mut self, inputs: DeviceInputs, memory: &mut impl HistoryMemory) -> TickOutputs {
        self.background.link_mut().identify(Identity { has_history: true, ..Identity::default() });
        let DeviceInputs { sample, emergency_stop, overran, lost_ticks } = inputs;
        let outputs = self.tick(inputs);
        let taken = TakenIn { sample, emergency_stop, late: overran || lost_ticks > 0 };
        let row = self.rig.history_row(taken, &outputs);
        self.history.step(memory, row, outputs.energised, outputs.state == State::Fault);
        self.background.link_mut().serve_history(memory);
        outputs
    }

    /// What the line carries after a tick, as fast as it is.
    pub fn transmit(&mut self) -> Vec<u8, MAX_LINE_BYTES> {
        let room = usize::from(self.line_bytes_per_tick).min(MAX_LINE_BYTES);
        while self.line.len() < room {
            let Some(frame) = self.background.link_mut().transmit() else { break };
            // The line's buffer holds a tick and a frame.
            frame.iter().for_each(|byte| self.line.push_back(*byte).unwrap_or(()));
        }
        let mut bytes = Vec::new();
        while bytes.len() < room {
            let Some(byte) = self.line.pop_front() else { break };
            // Room is at most the capacity.
            let _ = bytes.push(byte);
        }
        bytes
    }

    fn follow(&mut self, outputs: &TickOutputs) {
        if let Some(record) = &outputs.trace
            && !self.background.link_mut().trace_record(record)
        {
            self.rig.end_trace();
        }
        self.beat = self.beat.wrapping_add(1);
        if outputs.self_test_wanted && !self.tests_itself {
            self.background.want_self_test();
        }
        self.tests_itself = outputs.self_test_wanted;
        // What runs this has no program in flash and no clock of its own to test.
        self.background.self_test(|| FaultSet::EMPTY, &mut self.place, &mut self.queue);
        let link = self.background.link_mut();
        link.observe(outputs.state, outputs.vent_verified, Measured::default());
        if let Some(answer) = &outputs.answer {
            link.answer(answer.clone());
        }
        if let Some(sample) = outputs.telemetry {
            link.telemetry(sample);
        }
    }
}
