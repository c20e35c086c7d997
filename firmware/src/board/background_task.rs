//! The background's task: from the board's queues and line through [`Background`] and back, over and over.

use core::borrow::BorrowMut;

use embedded_io::{Read, ReadReady, Write, WriteReady};
use heapless::spsc::{Consumer, Producer};
use model_export::link::fault::FaultSet;
use model_export::link::message::Telemetry;

use super::read_back::ChipThermometer;
use super::rest_noise::root_mean_square;
use super::shared_atomics::SharedAtomics;
use crate::background::{Background, ModelPlace};
use crate::link::{CommandSink, Link, LinkBuffers, Measured};
use crate::self_test::{ClockCheck, SelfTest};
use crate::storage::Flash;
use crate::tick::{Action, Answer, Command};

/// Bytes the link receives in a tick at most, and a reserve of the background's longest pause while energised.
pub const RECEIVE_QUEUE: usize = 1024;
/// Bytes waiting for the line: two of the longest frames.
pub const TRANSMIT_QUEUE: usize = 768;

/// The line to the host: any of embedded-io's that tells what it can do without waiting.
pub trait Line: Read + ReadReady + Write + WriteReady {}

impl<L: Read + ReadReady + Write + WriteReady> Line for L {}

/// What the self-test needs to know of the board.
#[derive(Clone, Copy, Debug)]
pub struct Facts<'a> {
    /// See [`SelfTest::program`].
    pub program: &'a [&'a [u8]],
    /// See [`SelfTest::program_crc32`].
    pub program_crc32: u32,
    /// See [`SelfTest::clock`].
    pub clock: Option<ClockCheck>,
    /// What is wrong with the board until its next start.
    pub faults: FaultSet,
    /// The factory's calibration of the chip's temperature sensor, where there is one.
    pub chip: Option<ChipThermometer>,
}

impl Facts<'_> {
    /// What is wrong with the program and the board.
    pub fn examine(&self) -> FaultSet {
        let Self { program, program_crc32, clock, faults, chip: _ } = *self;
        SelfTest { program, program_crc32, clock }.run().union(faults)
    }
}

/// The background's ends of the queues.
pub struct BackgroundQueues<'q> {
    /// Commands to the tick.
    pub commands: Producer<'q, Command>,
    /// Its answers.
    pub answers: Consumer<'q, Answer>,
    /// Its telemetry.
    pub telemetry: Consumer<'q, Telemetry>,
    /// The trace of its ticks.
    pub trace: Consumer<'q, u8>,
}

struct Sink<'a, 'q> {
    commands: &'a mut Producer<'q, Command>,
    shared: &'q SharedAtomics,
}

impl CommandSink for Sink<'_, '_> {
    fn send(&mut self, command: Command) -> bool {
        self.commands.enqueue(command).is_ok()
    }

    fn vent(&mut self) {
        self.shared.ask_for_vent();
    }
}

/// The background in its task.
pub struct BackgroundTask<'q, S, M, B = LinkBuffers> {
    background: Background<S, M, B>,
    facts: Facts<'q>,
    queues: BackgroundQueues<'q>,
    shared: &'q SharedAtomics,
    tests_done: u32,
    dropped: u32,
    raised: FaultSet,
}

impl<'q, S: Flash, M: Flash, B: BorrowMut<LinkBuffers>> BackgroundTask<'q, S, M, B> {
    /// A background that has not run yet.
    pub fn new(link: Link<S, M, B>, facts: Facts<'q>, queues: BackgroundQueues<'q>, shared: &'q SharedAtomics) -> Self {
        Self { background: Background::new(link), facts, queues, shared, tests_done: 0, dropped: 0, raised: FaultSet::EMPTY }
    }

    /// The link.
    pub fn link(&self) -> &Link<S, M, B> {
        self.background.link()
    }

    /// The link.
    pub fn link_mut(&mut self) -> &mut Link<S, M, B> {
        self.background.link_mut()
    }

    /// One round: takes what came, does what is wanted, sends what fits. Called over and over.
    ///
    /// `noise` is a fast counter's value: see [`Measured::noise`].
    pub fn step(&mut self, line: &mut impl Line, place: &mut impl ModelPlace, stack_unused_bytes: u32, noise: u32) {
        self.shared.show_life();
        self.look(stack_unused_bytes, noise);
        self.take_from_tick();
        let Self { background, facts, queues, shared, raised, .. } = self;
        let mut sink = Sink { commands: &mut queues.commands, shared };
        let outputs = shared.output_faults();
        for fault in outputs.iter() {
            // What the queue does not take now, it takes in one of the next rounds.
            if !raised.contains(fault) && sink.send(Command { token: None, action: Action::Raise(fault) }) {
                raised.insert(fault);
            }
        }
        // What is over may come again.
        *raised = FaultSet(raised.0 & outputs.0);
        background.self_test(|| facts.examine().union(outputs), place, &mut sink);
        let mut byte = [0];
        if matches!(line.read_ready(), Ok(true)) && matches!(line.read(&mut byte), Ok(1)) {
            let [byte] = byte;
            background.receive(byte, place, &mut sink);
        }
        self.send(line);
    }

    // What follows stays out of its caller: answers and frames are long, and none of them needs to be on the stack with another.

    #[inline(never)]
    fn look(&mut self, stack_unused_bytes: u32, noise: u32) {
        let Self { background, shared, facts, tests_done, dropped, .. } = self;
        let link = background.link_mut();
        let (supply_mv, chip_code) = shared.measured_self();
        let chip = facts.chip;
        link.observe(
            shared.state(),
            shared.vent_verified(),
            Measured {
                longest_tick_cycles: shared.longest_tick_cycles(),
                stack_unused_bytes,
                supply_v: (supply_mv > 0).then(|| f32::from(supply_mv) / 1000.0),
                chip_celsius: chip.map(|calibration| calibration.celsius(chip_code, supply_mv)).filter(|_| supply_mv > 0 && chip_code > 0),
                rest_noise_codes: shared.rest_noise().map(|squares| squares.map(root_mean_square)),
                noise,
            },
        );
        let lost = shared.telemetry_dropped();
        link.drop_telemetry(lost.wrapping_sub(*dropped));
        *dropped = lost;
        let wanted = shared.self_tests();
        if wanted != *tests_done {
            *tests_done = wanted;
            background.want_self_test();
        }
    }

    #[inline(never)]
    fn take_from_tick(&mut self) {
        while let Some(answer) = self.queues.answers.dequeue() {
            self.background.link_mut().answer(answer);
        }
        while let Some(sample) = self.queues.telemetry.dequeue() {
            self.background.link_mut().telemetry(sample);
        }
        let link = self.background.link_mut();
        let mut taken = 0;
        for _ in 0..link.trace_room() {
            let Some(byte) = self.queues.trace.dequeue() else { break };
            link.trace(byte);
            taken += 1;
        }
        self.shared.take_trace(taken);
    }

    #[inline(never)]
    fn send(&mut self, line: &mut impl Line) {
        self.background.link_mut().transmit_to(line);
    }
}
