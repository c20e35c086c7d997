//! The background: link, storage and self-test, in whatever time the tick leaves.

use heapless::spsc::{Consumer, Producer};
use model_export::link::fault::{Fault, FaultSet};
use model_export::link::frame::MAX_WIRE;
use model_export::link::message::Telemetry;

use super::exchange::Exchange;
use crate::estimator::Portable;
use crate::link::{CommandSink, Event, Link, Measured};
use crate::model::ModelFacts;
use crate::self_test::{ClockCheck, Report, SelfTest};
use crate::storage::{Flash, Slot};
use crate::supervisor;
use crate::tick::{Action, Answer, Command};

/// The line to the host.
pub trait Line {
    /// The next byte that came.
    fn receive(&mut self) -> Option<u8>;
    /// Bytes that can be sent now.
    fn room(&self) -> usize;
    /// Sends bytes for which there is room.
    fn send(&mut self, bytes: &[u8]);
}

/// Where models run.
pub trait ModelRoom {
    /// Whether a blob is a model that this device can run and that passes its golden vectors. The running model may be set aside for it.
    fn examine(&mut self, blob: &[u8]) -> Result<ModelFacts, Fault>;
    /// Takes the running model away from the tick; its flash may change afterwards.
    fn retire(&mut self);
    /// Checks a blob as [`Self::examine`] does and gives its model to the tick. Its flash is held until it is retired.
    fn install(&mut self, blob: &[u8]) -> Result<ModelFacts, Fault>;
}

/// Flash that can be told which slot is in use.
pub trait Hold {
    /// From now on, what lies in `slot` cannot be changed.
    fn hold(&self, slot: Option<Slot>);
}

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
}

impl Facts<'_> {
    /// What is wrong with the program and the board.
    pub fn examine(&self) -> FaultSet {
        let Self { program, program_crc32, clock, faults } = *self;
        SelfTest { program, program_crc32, clock, model: None }.run(Portable).faults.union(faults)
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
}

struct Sink<'a, 'q> {
    commands: &'a mut Producer<'q, Command>,
    exchange: &'q Exchange,
}

impl CommandSink for Sink<'_, '_> {
    fn send(&mut self, command: Command) -> bool {
        self.commands.enqueue(command).is_ok()
    }

    fn vent(&mut self) {
        self.exchange.ask_for_vent();
    }
}

/// Everything that runs outside of interrupts.
pub struct Background<'q, S, M> {
    link: Link<S, M>,
    facts: Facts<'q>,
    queues: BackgroundQueues<'q>,
    exchange: &'q Exchange,
    tests_done: u32,
    report: Option<Report>,
    retest: bool,
    dropped: u32,
}

impl<'q, S: Flash, M: Flash + Hold> Background<'q, S, M> {
    /// A background that has not run yet.
    pub fn new(link: Link<S, M>, facts: Facts<'q>, queues: BackgroundQueues<'q>, exchange: &'q Exchange) -> Self {
        Self { link, facts, queues, exchange, tests_done: 0, report: None, retest: false, dropped: 0 }
    }

    /// The link.
    pub fn link(&self) -> &Link<S, M> {
        &self.link
    }

    /// One round: takes what came, does what is wanted, sends what fits. Called over and over.
    pub fn step(&mut self, line: &mut impl Line, room: &mut impl ModelRoom, stack_unused_bytes: u32) {
        self.exchange.show_life();
        let measured = Measured { longest_tick_cycles: self.exchange.longest_tick_cycles(), stack_unused_bytes };
        self.link.observe(self.exchange.state(), measured);
        let dropped = self.exchange.telemetry_dropped();
        self.link.drop_telemetry(dropped.wrapping_sub(self.dropped));
        self.dropped = dropped;
        self.take_from_tick();
        self.self_test(room);
        if let Some(byte) = line.receive() {
            self.receive(byte, room);
        }
        self.send(line);
    }

    // What follows stays out of its callers: answers, frames and requests are long, and none of them needs to be on the stack with another.

    #[inline(never)]
    fn take_from_tick(&mut self) {
        while let Some(answer) = self.queues.answers.dequeue() {
            self.link.answer(answer);
        }
        while let Some(sample) = self.queues.telemetry.dequeue() {
            self.link.telemetry(sample);
        }
    }

    #[inline(never)]
    fn send(&mut self, line: &mut impl Line) {
        if line.room() >= MAX_WIRE
            && let Some(frame) = self.link.transmit()
        {
            line.send(&frame);
        }
    }

    #[inline(never)]
    fn receive(&mut self, byte: u8, room: &mut impl ModelRoom) {
        let Self { link, queues, exchange, .. } = self;
        let mut sink = Sink { commands: &mut queues.commands, exchange };
        let mut examined = false;
        let event = link.receive(byte, &mut sink, |blob| {
            examined = true;
            room.examine(blob).is_ok()
        });
        if examined || event == Some(Event::ModelChanged) {
            // At once, before an upload can want the slot of the model before. The self-test puts the active model back.
            self.retire(room);
            self.retest = true;
        }
    }

    fn retire(&mut self, room: &mut impl ModelRoom) {
        room.retire();
        self.link.flash().1.hold(None);
        self.link.set_model(None);
    }

    /// Tests when the tick wants it and reports as soon as there is a place in the queue.
    fn self_test(&mut self, room: &mut impl ModelRoom) {
        if self.retest {
            let retest = Action::Request(supervisor::Event::Retest);
            self.retest = self.queues.commands.enqueue(Command { token: None, action: retest }).is_err();
        }
        let wanted = self.exchange.self_tests();
        if wanted != self.tests_done {
            self.tests_done = wanted;
            self.report = Some(self.examine(room));
        }
        if let Some(report) = self.report
            && self.queues.commands.enqueue(Command { token: None, action: report.action() }).is_ok()
        {
            self.report = None;
        }
    }

    #[inline(never)]
    fn examine(&mut self, room: &mut impl ModelRoom) -> Report {
        self.retire(room);
        let mut report = Report { faults: self.facts.examine(), model: None };
        // A model runs only where everything else is in order: its memory may be missing on what is not the real board.
        let slot = self.link.model_slot();
        if report.faults.is_empty()
            && let Some(blob) = self.link.model_blob()
        {
            self.link.flash().1.hold(slot);
            match room.install(blob) {
                Ok(facts) => report.model = Some(facts),
                Err(fault) => {
                    self.link.flash().1.hold(None);
                    report.faults.insert(fault);
                }
            }
        }
        self.link.set_model(report.model);
        report
    }
}
