//! The board's tick and background tasks over pins of memory: what goes out, by which drive, and what comes of outputs that do not obey.

mod common;

use std::cell::{Cell, RefCell};
use std::convert::Infallible;
use std::rc::Rc;

use common::FACTS;
use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use firmware::background::ModelPlace;
use firmware::board::background_task::{BackgroundQueues, BackgroundTask, Facts};
use firmware::board::read_back::ChipThermometer;
use firmware::board::shared_atomics::{AnswerQueue, CommandQueue, SharedAtomics, TelemetryQueue, TraceQueue};
use firmware::board::tick_task::{CrashMemory, CycleCounter, TickIo, TickQueues, TickTask};
use firmware::board::watchdog::{Watchdog, WatchdogTimer};
use firmware::drivers::{DumpValve, PulseFrequency, RawSample, ReadBack, SampleSource, ValveDrive};
use firmware::history::{HistoryMemory, HistoryWords, RamHistory};
use firmware::link::{Identity, Link, LinkConfig};
use firmware::model::ModelFacts;
use firmware::storage::{Flash, Slot, Store};
use firmware::tick::{BootReport, NoModel, TickConfig};
use model_export::link::Kind;
use model_export::link::fault::{Fault, FaultSet};
use model_export::link::hello::{Build, Hello};
use model_export::link::history::{HistoryRow, ROW_BYTES};
use model_export::link::message::{Message, Quantity, Refusal, Reply, ReplyFrame, Request, RequestFrame, Telemetry};
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
    history: RefCell<RamHistory>,
    laser_is_dead: Cell<bool>,
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
        Some(ReadBack {
            reference_code: turn.then_some(reference),
            drive_code: (!turn).then_some(drive),
            chip_code: Some(1000),
            dump_is_high: dump,
        })
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
    fn keep(&mut self, _sealed: &[u8; firmware::crash_record::SEALED_BYTES]) {}
}

/// The line: what the host sends, and what it hears.
#[derive(Default)]
struct Cable {
    to_device: RefCell<std::collections::VecDeque<u8>>,
    from_device: Vec<u8>,
}
impl embedded_io::ErrorType for Cable {
    type Error = core::convert::Infallible;
}

impl embedded_io::ReadReady for Cable {
    fn read_ready(&mut self) -> Result<bool, Self::Error> {
        Ok(!self.to_device.borrow().is_empty())
    }
}

impl embedded_io::Read for Cable {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Self::Error> {
        let mut queue = self.to_device.borrow_mut();
        Ok(bytes.iter_mut().zip(core::iter::from_fn(|| queue.pop_front())).map(|(byte, new)| *byte = new).count())
    }
}

impl embedded_io::WriteReady for Cable {
    fn write_ready(&mut self) -> Result<bool, Self::Error> {
        Ok(true)
    }
}

impl embedded_io::Write for Cable {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
        // As a queue that was almost full: frames go in pieces.
        let taken = bytes.len().min(7);
        self.from_device.extend(&bytes[..taken]);
        Ok(taken)
    }

    fn flush(&mut self) -> Result<(), Self::Error> {
        Ok(())
    }
}

struct NoPlace;
impl ModelPlace for NoPlace {
    fn load(&mut self, _blob: &[u8]) -> Result<ModelFacts, Fault> {
        Err(Fault::ModelCorrupt)
    }
    fn forget(&mut self) {}
}

type Task = TickTask<'static, TickIo<Wire, Wire, Pulse, Wire, Wire, Wire, Wire, Wire>>;

struct Board {
    task: Task,
    background: BackgroundTask<'static, Ram, Ram>,
    cable: Cable,
    wires: Wire,
    shared: &'static SharedAtomics,
    settings: Settings,
    session: u32,
    token: u32,
    noise: u16,
    /// Whether nobody counts milliseconds any more.
    time_stands: bool,
}

impl Board {
    fn new(settings: Settings) -> Self {
        let shared: &'static SharedAtomics = Box::leak(Box::default());
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
        let tick = TickConfig { settings: &settings, facts: FACTS }.build().unwrap();
        let wires = Wire::default();
        let io = TickIo {
            source: wires.clone(),
            analogue: wires.clone(),
            pulse: Pulse(wires.clone()),
            dump_valve: DumpValve::new(wires.clone()),
            emergency_stop: wires.clone(),
            watchdog: Watchdog::new(wires.clone()),
            counter: wires.clone(),
            crash_memory: wires.clone(),
        };
        let queues = TickQueues { commands: commands_out, answers: answers_in, telemetry: telemetry_in, trace: trace_in };
        let facts = Facts { program: &[], program_crc32: 0, clock: None, faults: FaultSet::EMPTY, chip: ChipThermometer::new(950, 1200) };
        let background = BackgroundQueues { commands: commands_in, answers: answers_out, telemetry: telemetry_out, trace: trace_out };
        let task = TickTask::new(tick, BootReport::default(), io, queues, shared, 168_000, Some(1500));
        let mut background = BackgroundTask::new(link, facts, background, shared);
        let build = Build { source: [1, 2, 3, 4, 5, 6, 7, 8], chip: 0x1007_6413, chip_number: [9; 12] };
        background.link_mut().identify(Identity { build, has_bootloader: true, has_history: true });
        Self { task, background, cable: Cable::default(), wires, shared, settings, session: 0, token: 0, noise: 0, time_stands: false }
    }

    /// A millisecond, with the background's rounds behind it.
    fn step(&mut self) {
        self.shared.add_periods(u32::from(!self.time_stands));
        self.noise = (self.noise + 3) % 5;
        let share = self.wires.0.analogue.get().max(self.wires.0.pulse.get());
        let bar = f32::from(share) / 65_535.0 * self.settings.valve_full_scale_bar;
        let tick = self.task.rig().built();
        let (laser, pressure) = (tick.laser().calibration().code(2.0 + 5.0 * bar), tick.pressure().calibration().code(bar));
        let laser = if self.wires.0.laser_is_dead.get() { 0 } else { laser + self.noise };
        self.wires.0.sample.set(RawSample { laser_code: laser, pressure_code: pressure + self.noise });
        self.task.run(&mut NoModel);
        for _ in 0..40 {
            self.background.link_mut().serve_history(&self.wires);
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
        assert_eq!(self.shared.state(), State::Running, "{:?}", self.task.rig().supervisor().record());
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
        (Broken::Supply(3.7), Fault::ReferenceVoltage),
        (Broken::Supply(2.9), Fault::ReferenceVoltage),
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
            assert_eq!((board.shared.state(), board.task.rig().supervisor().record().first), (State::Fault, fault.number()));
        }
    }
}

/// Without it a stopped sampling would go unseen, and so would lost ticks.
#[test]
fn a_count_of_milliseconds_that_stands_vents_within_50_ms() {
    let mut board = Board::new(settings(0)).into_running(2.0);
    board.time_stands = true;
    let safe_after = (1..200).find(|_| {
        board.step();
        !board.wires.0.energised.get()
    });
    assert!(safe_after.is_some_and(|ms| ms <= 50), "{safe_after:?} ms");
    assert_eq!(board.task.rig().supervisor().record().first, Fault::DeadlineMissed.number());
}

impl Board {
    /// What the device has said since the last call.
    fn heard(&mut self) -> (Vec<Reply>, Vec<Telemetry>) {
        let mut decoder = model_export::link::frame::Decoder::new();
        let (mut replies, mut samples) = (Vec::new(), Vec::new());
        for byte in std::mem::take(&mut self.cable.from_device) {
            let Some(Ok(payload)) = decoder.push(byte) else { continue };
            replies.extend(ReplyFrame::from_payload(payload).ok().map(|frame| frame.reply));
            samples.extend(Telemetry::from_payload(payload).ok());
        }
        (replies, samples)
    }

    fn ask(&mut self, request: Request) -> Reply {
        self.heard();
        self.send(request);
        for _ in 0..20 {
            self.step();
        }
        self.heard().0.pop().expect("an answer")
    }

    /// Every row of the history, fetched piece by piece.
    fn history(&mut self) -> Vec<HistoryRow> {
        let mut rows = Vec::new();
        loop {
            let Reply::History(piece) = self.ask(Request::History { from_row: rows.len() as u16 }) else { panic!("no history") };
            let (whole, rest) = piece.bytes.as_chunks::<ROW_BYTES>();
            assert!(rest.is_empty() && !whole.is_empty());
            rows.extend(whole.iter().map(|row| HistoryRow::decode(row).expect("a sound row")));
            if rows.len() == usize::from(piece.rows) {
                return rows;
            }
        }
    }
}

#[test]
fn the_last_two_seconds_before_a_fault_are_fetched_and_survive_a_reset() {
    let mut board = Board::new(settings(0)).into_running(2.0);
    // Nothing stands still while the rig runs.
    assert_eq!(board.ask(Request::History { from_row: 0 }), Reply::Refused(Refusal::NoRecord));
    for _ in 0..150 {
        board.send(Request::SetPoint { quantity: Quantity::Pressure, value: 1.5 });
        (0..15).for_each(|_| board.step());
    }
    // The last row before the laser breaks, and the first after.
    let before = board.wires.0.sample.get();
    board.wires.0.laser_is_dead.set(true);
    (0..20).for_each(|_| board.step());
    assert_eq!(board.shared.state(), State::Fault);
    let record = *board.task.rig().supervisor().record();
    let rows = board.history();
    assert_eq!(rows.len(), 2000);
    let last = rows.last().unwrap();
    assert_eq!(
        (last.state, last.energised, last.laser_code, last.pressure_code),
        (State::Fault, false, record.laser_code, record.pressure_code)
    );
    assert!(rows[..1999].iter().all(|row| row.state == State::Running && row.energised));
    // The set-point and the drive that it led to; the laser's last sound sample.
    assert_eq!((rows[1900].set_point_thousandths, rows[1900].estimate_thousandths), (1500, i16::MIN));
    assert_eq!(rows[1900].valve_share, (1.5 / board.settings.valve_full_scale_bar * 65_535.0) as u16);
    let sound = rows.iter().rposition(|row| row.laser_code != 0).unwrap();
    assert_eq!((rows[sound].laser_code, rows[sound].pressure_code), (before.laser_code, before.pressure_code));
    assert!(rows.iter().skip(sound + 1).all(|row| row.laser_code == 0));

    // A reset, and the rig is idle again: the rows are there until the valve closes for the next time.
    let mut after = Board::new(settings(0));
    *after.wires.0.history.borrow_mut() = board.wires.0.history.borrow().clone();
    after.cable.to_device.borrow_mut().extend(model_export::link::frame::encode(&[Kind::HelloRequest.byte()]).unwrap());
    (0..400).for_each(|_| after.step());
    let mut decoder = model_export::link::frame::Decoder::new();
    let hello = after.cable.from_device.iter().find_map(|byte| Hello::decode(decoder.push(*byte)?.ok()?).ok()).unwrap();
    assert_eq!((hello.build.source, hello.build.chip, hello.build.chip_number), ([1, 2, 3, 4, 5, 6, 7, 8], 0x1007_6413, [9; 12]));
    after.session = hello.session;
    assert_eq!(after.history(), rows);
    after.send(Request::Arm);
    assert_eq!(after.shared.state(), State::Armed);
    assert_eq!(after.ask(Request::History { from_row: 0 }), Reply::Refused(Refusal::NoRecord));
}

#[test]
fn the_bootloader_is_entered_only_when_vented_and_after_its_answer() {
    let mut board = Board::new(settings(0)).into_running(2.0);
    assert!(matches!(board.ask(Request::EnterBootloader), Reply::Refused(Refusal::State(State::Running))));
    assert!(!board.background.link_mut().wants_bootloader());
    board.send(Request::Disarm);
    (0..1500).for_each(|_| board.step());
    assert_eq!(board.ask(Request::EnterBootloader), Reply::Done);
    assert!(board.background.link_mut().wants_bootloader());
}

#[test]
fn telemetry_tells_supply_and_temperature_of_the_chip() {
    let mut board = Board::new(settings(0)).into_running(1.0);
    board.heard();
    (0..100).for_each(|_| board.step());
    let (_, samples) = board.heard();
    let sample = samples.last().unwrap();
    assert!((sample.supply_v.unwrap() - 3.3).abs() < 0.01, "{sample:?}");
    // 50 codes above the point at 30 degrees, of 250 to the one at 110.
    assert!((sample.chip_celsius.unwrap() - 46.0).abs() < 0.5, "{sample:?}");
}
