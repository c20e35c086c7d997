//! The board's tick and background tasks over pins of memory: what goes out, by which drive, and what comes of outputs that do not obey.

mod common;

use std::cell::{Cell, RefCell};
use std::convert::Infallible;
use std::rc::Rc;

use common::FACTS;
use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use firmware::background::ModelPlace;
use firmware::board::background_task::{BackgroundQueues, BackgroundTask, Facts, Line};
use firmware::board::exchange::{AnswerQueue, CommandQueue, Exchange, TelemetryQueue, TraceQueue};
use firmware::board::read_back::ReadBack;
use firmware::board::tick_task::{CycleCounter, Hands, RecordKeeper, TickQueues, TickTask};
use firmware::board::watchdog::{Watchdog, WatchdogTimer};
use firmware::link::{Link, LinkConfig};
use firmware::model::ModelFacts;
use firmware::seam::{DumpValve, PulseFrequency, RawSample, SampleSource, ValveDrive};
use firmware::storage::{Flash, Slot, Store};
use firmware::tick::{BootReport, NoModel, Rig, TickConfig};
use model_export::link::Kind;
use model_export::link::fault::{Fault, FaultSet};
use model_export::link::hello::Hello;
use model_export::link::message::{Message, Quantity, Request, RequestFrame};
use model_export::link::settings::Settings;
use model_export::link::state::{ResetCause, State};

struct Ram([Vec<u8>; 2]);

impl Flash for Ram {
    type Error = ();
    fn contents(&self, slot: Slot) -> &[u8] {
        &self.0[usize::from(slot == Slot::B)]
    }
    fn erase(&mut self, slot: Slot) -> Result<(), ()> {
        self.0[usize::from(slot == Slot::B)].fill(0xff);
        Ok(())
    }
    fn program(&mut self, slot: Slot, offset: u32, word: u32) -> Result<(), ()> {
        let bytes = &mut self.0[usize::from(slot == Slot::B)][offset as usize..][..4];
        bytes.iter_mut().zip(word.to_le_bytes()).for_each(|(byte, new)| *byte &= new);
        Ok(())
    }
}

fn ram() -> Ram {
    Ram([vec![0xff; 8192], vec![0xff; 8192]])
}

/// What is wrong with the outputs.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Broken {
    DriveStuck(u16),
    DumpPinStuck(bool),
    Supply(f64),
}

#[derive(Default)]
struct Pins {
    sample: Cell<RawSample>,
    analogue: Cell<u16>,
    pulse: Cell<u16>,
    pulse_hz: Cell<u32>,
    energised: Cell<bool>,
    broken: Cell<Option<Broken>>,
    turn: Cell<bool>,
}

#[derive(Clone, Default)]
struct Wire(Rc<Pins>);
struct Pulse(Wire);

impl SampleSource for Wire {
    fn sample(&mut self) -> RawSample {
        self.0.sample.get()
    }
    fn read_back(&mut self) -> Option<ReadBack> {
        self.0.turn.set(!self.0.turn.get());
        let (mut supply_v, mut drive, mut dump) = (3.3, self.0.analogue.get() >> 4, self.0.energised.get());
        match self.0.broken.get() {
            Some(Broken::DriveStuck(code)) => drive = code,
            Some(Broken::DumpPinStuck(high)) => dump = high,
            Some(Broken::Supply(volts)) => supply_v = volts,
            None => {}
        }
        let reference = (1500.0 * 3.3 / supply_v).round() as u16;
        let turn = self.0.turn.get();
        Some(ReadBack { reference_code: turn.then_some(reference), drive_code: (!turn).then_some(drive), dump_is_high: dump })
    }
}
impl ValveDrive for Wire {
    fn drive(&mut self, share: u16) {
        self.0.analogue.set(share);
    }
}
impl ValveDrive for Pulse {
    fn drive(&mut self, share: u16) {
        self.0.0.pulse.set(share);
    }
}
impl PulseFrequency for Pulse {
    fn set_pulse_hz(&mut self, pulse_hz: u32) {
        assert_eq!(self.0.0.pulse.get(), 0, "the frequency changes at zero only");
        self.0.0.pulse_hz.set(pulse_hz);
    }
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
        Ok(false)
    }
    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(true)
    }
}
impl CycleCounter for Wire {
    fn cycles(&self) -> u32 {
        0
    }
}
impl WatchdogTimer for Wire {
    fn is_busy(&self) -> bool {
        false
    }
    fn set(&mut self, _prescaler: u8, _reload: u16) {}
    fn feed(&mut self) {}
}
impl RecordKeeper for Wire {
    fn keep(&mut self, _sealed: &[u8; firmware::retain::SEALED_BYTES]) {}
}

/// The line: what the host sends, and what it hears.
#[derive(Default)]
struct Cable {
    to_device: RefCell<std::collections::VecDeque<u8>>,
    from_device: Vec<u8>,
}
impl Line for Cable {
    fn receive(&mut self) -> Option<u8> {
        self.to_device.borrow_mut().pop_front()
    }
    fn room(&self) -> usize {
        768
    }
    fn send(&mut self, bytes: &[u8]) {
        self.from_device.extend(bytes);
    }
}

struct NoPlace;
impl ModelPlace for NoPlace {
    fn admit(&mut self, _blob: &[u8]) -> Result<ModelFacts, Fault> {
        Err(Fault::ModelCorrupt)
    }
    fn forget(&mut self) {}
}

type Task = TickTask<'static, Hands<Wire, Wire, Pulse, Wire, Wire, Wire, Wire, Wire>>;

struct Board {
    task: Task,
    background: BackgroundTask<'static, Ram, Ram>,
    cable: Cable,
    wires: Wire,
    exchange: &'static Exchange,
    settings: Settings,
    session: u32,
    token: u32,
    noise: u16,
}

impl Board {
    fn new(settings: Settings) -> Self {
        let exchange: &'static Exchange = Box::leak(Box::default());
        let (commands_in, commands_out) = Box::leak(Box::new(CommandQueue::new())).split();
        let (answers_in, answers_out) = Box::leak(Box::new(AnswerQueue::new())).split();
        let (telemetry_in, telemetry_out) = Box::leak(Box::new(TelemetryQueue::new())).split();
        let (trace_in, trace_out) = Box::leak(Box::new(TraceQueue::new())).split();
        let mut store = Store::new(ram(), firmware::settings::STORE_KIND, firmware::settings::STORE_VERSION);
        store.save(&firmware::settings::encode(&settings).unwrap()).unwrap();
        let config = LinkConfig {
            firmware: [0, 1, 0],
            board: heapless::String::new(),
            reset_cause: ResetCause::PowerOn,
            previous_record: None,
            facts: FACTS,
        };
        let link = Link::new(config, store.release(), ram());
        let rig = Rig::new(TickConfig { settings: &settings, facts: FACTS }.build().unwrap(), BootReport::default());
        let wires = Wire::default();
        let hands = Hands {
            source: wires.clone(),
            analogue: wires.clone(),
            pulse: Pulse(wires.clone()),
            dump_valve: DumpValve::new(wires.clone()),
            emergency_stop: wires.clone(),
            watchdog: Watchdog::new(wires.clone()),
            counter: wires.clone(),
            keeper: wires.clone(),
        };
        let queues = TickQueues { commands: commands_out, answers: answers_in, telemetry: telemetry_in, trace: trace_in };
        let facts = Facts { program: &[], program_crc32: 0, clock: None, faults: FaultSet::EMPTY };
        let background = BackgroundQueues { commands: commands_in, answers: answers_out, telemetry: telemetry_out, trace: trace_out };
        let task = TickTask::new(rig, hands, queues, exchange, 168_000, Some(1500));
        let background = BackgroundTask::new(link, facts, background, exchange);
        Self { task, background, cable: Cable::default(), wires, exchange, settings, session: 0, token: 0, noise: 0 }
    }

    /// A millisecond, with the background's rounds behind it.
    fn step(&mut self) {
        self.exchange.add_periods(1);
        self.noise = (self.noise + 3) % 5;
        let share = self.wires.0.analogue.get().max(self.wires.0.pulse.get());
        let bar = f32::from(share) / 65_535.0 * self.settings.valve_full_scale_bar;
        let tick = self.task.rig().built();
        let (laser, pressure) = (tick.laser().calibration().code(2.0 + 5.0 * bar), tick.pressure().calibration().code(bar));
        self.wires.0.sample.set(RawSample { laser_code: laser + self.noise, pressure_code: pressure + self.noise });
        self.task.run(&mut NoModel);
        for _ in 0..40 {
            self.background.step(&mut self.cable, &mut NoPlace, 0, 1);
        }
    }

    fn send(&mut self, request: Request) {
        self.token += 1;
        let frame = RequestFrame { token: self.token, session: self.session, request }.to_wire().unwrap();
        self.cable.to_device.borrow_mut().extend(frame);
        for _ in 0..5 {
            self.step();
        }
    }

    fn into_running(mut self, bar: f32) -> Self {
        self.cable.to_device.borrow_mut().extend(model_export::link::frame::encode(&[Kind::HelloRequest.byte()]).unwrap());
        for _ in 0..400 {
            self.step();
        }
        let mut decoder = model_export::link::frame::Decoder::new();
        let hello = self.cable.from_device.iter().find_map(|byte| Hello::decode(decoder.push(*byte)?.ok()?).ok());
        self.session = hello.expect("an answer").session;
        self.send(Request::Arm);
        self.send(Request::Start);
        for _ in 0..50 {
            self.send(Request::SetPoint { quantity: Quantity::Pressure, value: bar });
        }
        assert_eq!(self.exchange.state(), State::Running, "{:?}", self.task.rig().supervisor().record());
        self
    }
}

/// The pressure follows the output at once here.
fn settings(valve_drive: u32) -> Settings {
    Settings { control_law: 1, valve_drive, pulse_hz: 200, pressure_response_ms: 0.0, ..Settings::default() }
}

#[test]
fn the_chosen_drive_gets_the_output_and_the_other_one_nothing_and_both_are_zero_at_once_after_a_vent() {
    for valve_drive in [0, 1] {
        let mut board = Board::new(settings(valve_drive)).into_running(2.0);
        let share = (2.0 / board.settings.valve_full_scale_bar * 65_535.0) as u16;
        let pins = board.wires.clone();
        let seen = || (pins.0.analogue.get(), pins.0.pulse.get());
        let expected = if valve_drive == 0 { (share, 0) } else { (0, share) };
        assert!(seen().0.abs_diff(expected.0) <= 1 && seen().1.abs_diff(expected.1) <= 1, "drive {valve_drive}: {:?}", seen());
        assert_eq!(pins.0.pulse_hz.get(), 200);
        assert!(pins.0.energised.get());
        board.send(Request::Vent);
        assert_eq!((seen(), pins.0.energised.get()), ((0, 0), false));
    }
}

#[test]
fn an_output_that_does_not_obey_and_a_supply_that_is_off_vent_within_50_ms_and_stay_a_fault_while_they_last() {
    for (broken, fault) in [
        (Broken::DriveStuck(4095), Fault::OutputMismatch),
        (Broken::DriveStuck(0), Fault::OutputMismatch),
        (Broken::DumpPinStuck(false), Fault::OutputMismatch),
        (Broken::Supply(3.6), Fault::ReferenceVoltage),
        (Broken::Supply(3.0), Fault::ReferenceVoltage),
    ] {
        let mut board = Board::new(settings(0)).into_running(2.0);
        board.wires.0.broken.set(Some(broken));
        let safe_after = (1..200).find(|_| {
            board.step();
            !board.wires.0.energised.get()
        });
        assert!(safe_after.is_some_and(|ms| ms <= 50), "{broken:?}: {safe_after:?} ms");
        assert_eq!(board.task.rig().supervisor().record().first, fault.number(), "{broken:?}");
        println!("{broken:?}: vented after {safe_after:?} ms");
        // Acknowledged while it lasts it comes back, by the self-test.
        for _ in 0..1_500 {
            board.step();
        }
        if matches!(broken, Broken::Supply(_)) {
            board.send(Request::Acknowledge);
            for _ in 0..100 {
                board.step();
            }
            assert_eq!((board.exchange.state(), board.task.rig().supervisor().record().first), (State::Fault, fault.number()));
        }
    }
}
