//! Single faults of the flashable image on the model of its chip: what strikes, what should notice it, what was measured.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use host_tool::backend::BOARD_MODEL;
use host_tool::experiment;
use host_tool::link::{BoardModel, BoardModelConfig, Breakage, FlashMemory, Hardware, HardwareConfig, Lockstep, Transport};
use host_tool::plant::{Plant, PlantConfig};
use model_export::link::fault::Fault;
use model_export::link::message::{Quantity, Reply, Request, Status};
use model_export::link::profiles::Profile;
use model_export::link::settings::Settings;
use model_export::link::state::State;

use crate::board_model::{ModelRig, Watch, config};

mod more;

/// Pressure before the fault, bar.
const SET_POINT_BAR: f64 = 1.5;
/// The ceiling, bar: a fault may not lead above it by more than a tick of slew.
const CEILING_BAR: f64 = 3.0;
const SLEW_STEP_BAR: f64 = 0.02;
/// Outputs are safe within this time after a fault, ms.
const SAFE_WITHIN_MS: u32 = 50;
/// Pressure is gone this long after the outputs are safe, ms.
const GONE_WITHIN_MS: usize = 1000;
const GONE_BAR: f64 = 0.1;
/// What is corrected is right this long after it struck, ms, and how exact.
const CORRECTED_WITHIN_MS: usize = 100;
const EXACT: f64 = 0.01;
/// How long a fault is watched, ms.
const WATCHED_MS: u32 = 1800;

/// What strikes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Injection {
    /// While there is pressure, in the chip; the text is the board model's.
    Chip(&'static str),
    /// The same on a chip that has something unusual from the start.
    ChipWith(&'static str, &'static str),
    /// While there is pressure, in the chip, for so many ms.
    ChipFor(&'static str, u32, &'static str),
    /// While there is pressure by the drive of the other kind: the pulse width.
    Pulse(&'static str),
    /// Before the first instruction, in the chip; with the rate of the core's own timer if it is not the usual one.
    Start(&'static str, Option<u64>),
    /// While there is pressure, in the hardware around it.
    Around(Breakage),
    /// The same while the set-point moves.
    AroundMoving(Breakage),
    /// The host says nothing more.
    HostSilent,
    /// The host sends bytes that are no frames, as many as the line carries.
    HostBabbles,
    /// Power goes in the middle of this operation on flash while other settings are saved.
    CutWhileSaving(u32),
    /// The reset pin in this state.
    ResetIn(State),
    /// As [`Injection::Around`], while the set-point moves over nearly the whole range.
    AroundWide(Breakage),
    /// While there is pressure, on a chip that started a second time: its option bytes are in force.
    SecondStart(&'static str),
    /// While there is pressure, these 16-bit words in place of the tick's first instructions, for 20 ms.
    Tick(&'static [u16]),
    /// While there is pressure, the supply falls from 3.3 V to 1.5 V by so many mV a ms.
    SupplyRamp(u32),
    /// Both analogue inputs are exchanged from the start.
    InputsSwapped,
    /// Power goes in the middle of this operation on flash while a model arrives.
    CutWhileUploading(u32),
    /// Settings are saved with flash at its slowest.
    SlowErase,
    /// Frames of another session ask for more pressure.
    OtherSession,
    /// A frame of this session again.
    OldFrame,
    /// Every bit of every stored word of the settings slot, with its header and its activations, one start for each.
    SettingsBits,
    /// Power goes in the middle of every operation on flash while other settings are saved, one device for each.
    CutAtEveryOperation,
    /// Bytes that are no frames beside a host that goes on, as many as the line carries.
    BabbleBesideTheHost,
    /// The same of the model's slot.
    ModelBits,
    /// Bits of static memory while there is pressure.
    MemoryBits,
}

/// What should happen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Expected {
    /// It vents within the time, in ms, and names this fault.
    Vents(Fault, u32),
    /// It vents within the time and starts anew without a fault: a reset or no supply.
    Restarts(u32),
    /// It cannot be armed, and names this fault.
    StaysVented(Fault),
    /// It goes on, or vents; at no time does it leave its limits.
    Bounded,
    /// It goes on, and the true pressure is what was asked for within 1 %, from `CORRECTED_WITHIN_MS` on.
    Holds,
    /// What was saved is as before or as wanted.
    OldOrNew,
    /// It names this fault, and the drive stays at zero.
    NoDrive(Fault),
}

/// A row of the matrix.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Name, for commands and tests.
    pub name: &'static str,
    /// What it could do to somebody.
    pub hazard: &'static str,
    /// What strikes.
    pub injection: Injection,
    /// What should happen.
    pub expected: Expected,
    /// What remains, where hardware that the image commands fails itself.
    pub residual: &'static str,
}

const fn row(name: &'static str, hazard: &'static str, injection: Injection, expected: Expected) -> Row {
    Row { name, hazard, injection, expected, residual: "" }
}

/// A row after which the outputs are safe in time, with this fault named.
const fn vents(name: &'static str, hazard: &'static str, injection: Injection, fault: Fault) -> Row {
    row(name, hazard, injection, Expected::Vents(fault, SAFE_WITHIN_MS))
}

/// A laser's fault code of 3.75 mA in 150 ohm, two conversions.
const FAULT_CODE: u16 = 1396;

/// An instruction that is none (UDF, Armv7-M manual section A7.7.194).
const UNDEFINED: &[u16] = &[0xde00];
/// `push {r0-r7, lr}` for ever.
const PUSH_FOR_EVER: &[u16] = &[0xb5ff, 0xe7fd];
/// `mov r1, pc`, `str r0, [r1]`.
const STORE_INTO_PROGRAM: &[u16] = &[0x4679, 0x6008];
/// `movs r0, #0x20`, `lsls r0, r0, #24`, `adds r0, #1`, `bx r0`: the first word of SRAM as code.
const EXECUTE_MEMORY: &[u16] = &[0x2020, 0x0600, 0x3001, 0x4700];

/// The matrix.
pub const ROWS: &[Row] = &[
    row(
        "crystal-absent",
        "wrong time base, wrong slew",
        Injection::Start("crystal stops", None),
        Expected::StaysVented(Fault::ClockFailed),
    ),
    row(
        "crystal-12-mhz",
        "wrong time base, overclocked",
        Injection::Start("crystal 12000000", None),
        Expected::StaysVented(Fault::ClockInaccurate),
    ),
    row("crystal-9-percent-fast", "wrong slew", Injection::Start("crystal 8720000", None), Expected::StaysVented(Fault::ClockInaccurate)),
    row("crystal-4-mhz", "wrong slew", Injection::Start("crystal 4000000", None), Expected::StaysVented(Fault::ClockInaccurate)),
    row("loop-does-not-lock", "slow ticks", Injection::Start("loop open", Some(16_000_000)), Expected::StaysVented(Fault::ClockFailed)),
    vents("crystal-stops", "wrong time base", Injection::Chip("crystal stops"), Fault::ClockFailed),
    vents("core-hangs", "outputs frozen", Injection::Chip("hang"), Fault::WatchdogReset),
    vents("core-hangs-slow-watchdog", "outputs frozen", Injection::ChipWith("watchdog-oscillator 17000", "hang"), Fault::WatchdogReset),
    vents("core-hangs-fast-watchdog", "outputs frozen", Injection::ChipWith("watchdog-oscillator 47000", "hang"), Fault::WatchdogReset),
    row("supply-low-at-start", "undefined logic", Injection::Start("supply 2800", None), Expected::StaysVented(Fault::BrownOut)),
    row("program-bit-flipped", "any", Injection::Start("flip 08010000 5", None), Expected::StaysVented(Fault::FlashCorrupt)),
    vents("supply-dips-2.8-v", "wrong codes, undefined logic", Injection::Chip("supply 2800"), Fault::BrownOut),
    vents("supply-dips-for-5-ms", "wrong codes, undefined logic", Injection::ChipFor("supply 2800", 5, "supply 3300"), Fault::BrownOut),
    row("supply-gone", "undefined outputs", Injection::Chip("supply 0"), Expected::Restarts(SAFE_WITHIN_MS)),
    row("reset-while-running", "outputs floating", Injection::ResetIn(State::Running), Expected::Restarts(SAFE_WITHIN_MS)),
    row("reset-while-armed", "outputs floating", Injection::ResetIn(State::Armed), Expected::Restarts(SAFE_WITHIN_MS)),
    row("reset-while-idle", "outputs floating", Injection::ResetIn(State::Idle), Expected::Restarts(SAFE_WITHIN_MS)),
    row("reset-in-self-test", "outputs floating", Injection::ResetIn(State::SelfTest), Expected::Restarts(SAFE_WITHIN_MS)),
    row("reset-in-fault", "outputs floating", Injection::ResetIn(State::Fault), Expected::Restarts(SAFE_WITHIN_MS)),
    vents("emergency-stop", "operator is not heard", Injection::Around(Breakage::EmergencyStop), Fault::EmergencyStop),
    vents("laser-wire-broken", "blind control", Injection::Around(Breakage::LaserCode(0)), Fault::LaserRange),
    vents("laser-at-full-scale", "blind control", Injection::Around(Breakage::LaserCode(8190)), Fault::LaserRange),
    vents("laser-fault-code-in-band", "blind control", Injection::Around(Breakage::LaserCode(FAULT_CODE)), Fault::LaserRange),
    row("laser-frozen", "blind control", Injection::AroundMoving(Breakage::LaserFrozen), Expected::Vents(Fault::LaserStuck, 1000)),
    Row {
        name: "laser-frozen-on-hold",
        hazard: "blind control",
        injection: Injection::Around(Breakage::LaserFrozen),
        expected: Expected::Bounded,
        residual: "not noticed while nothing moves; the held pressure is what it was",
    },
    vents("laser-jumps-5-mm", "control follows a lie", Injection::Around(Breakage::LaserOffsetMm(5.0)), Fault::LaserRate),
    vents("pressure-wire-broken", "blind limits", Injection::Around(Breakage::PressureCode(0)), Fault::PressureRange),
    vents("pressure-at-full-scale", "blind limits", Injection::Around(Breakage::PressureCode(8190)), Fault::PressureRange),
    row("pressure-frozen", "blind limits", Injection::AroundMoving(Breakage::PressureFrozen), Expected::Vents(Fault::PressureStuck, 1000)),
    Row {
        name: "pressure-frozen-on-hold",
        hazard: "blind limits",
        injection: Injection::Around(Breakage::PressureFrozen),
        expected: Expected::Bounded,
        residual: "as of the laser",
    },
    vents(
        "pressure-jumps-1-bar",
        "limits at the wrong place",
        Injection::Around(Breakage::PressureOffsetBar(1.0)),
        Fault::PressureMismatch,
    ),
    row("host-silent", "nobody in charge", Injection::HostSilent, Expected::Vents(Fault::HostLost, 300)),
    row("host-babbles", "nobody in charge, a busy device", Injection::HostBabbles, Expected::Vents(Fault::HostLost, 300)),
    row("line-noise-2-percent", "damaged requests", Injection::Chip("noise 20000"), Expected::Bounded),
    Row {
        name: "valve-fully-open",
        hazard: "full supply pressure",
        injection: Injection::Around(Breakage::ValveFullyOpen),
        expected: Expected::Vents(Fault::PressureMismatch, 1000),
        residual: "pressure rises towards the supply until the dump valve opens; the supply regulator is set to the ceiling",
    },
    Row {
        name: "dump-valve-stuck-closed",
        hazard: "venting has no effect",
        injection: Injection::Around(Breakage::DumpValveStuckClosed),
        expected: Expected::Bounded,
        residual: "found when it is needed: the drive is at zero then, and the pressure stays until somebody bleeds the line",
    },
    row("supply-pressure-fails", "no pressure", Injection::Around(Breakage::SupplyFails), Expected::Vents(Fault::PressureMismatch, 1000)),
    row("muscle-bursts", "air in the body", Injection::Around(Breakage::MuscleBursts), Expected::Vents(Fault::PressureMismatch, 1000)),
    row("cut-while-erasing", "other limits after the next start", Injection::CutWhileSaving(1), Expected::OldOrNew),
    row("cut-at-first-word", "other limits after the next start", Injection::CutWhileSaving(2), Expected::OldOrNew),
    row("cut-at-tenth-word", "other limits after the next start", Injection::CutWhileSaving(11), Expected::OldOrNew),
    row("cut-at-fortieth-word", "other limits after the next start", Injection::CutWhileSaving(41), Expected::OldOrNew),
    row("analogue-supply-3.0-v", "every pressure off by a tenth", Injection::Chip("analogue 3000"), Expected::Holds),
    row("analogue-supply-3.6-v", "every pressure off by a tenth", Injection::Chip("analogue 3600"), Expected::Holds),
    vents("analogue-supply-2.9-v", "every pressure off by an eighth", Injection::Chip("analogue 2900"), Fault::ReferenceVoltage),
    vents("analogue-supply-3.8-v", "every pressure off by a sixth", Injection::Chip("analogue 3800"), Fault::ReferenceVoltage),
    vents("drive-pin-stuck-high", "full supply pressure", Injection::Chip("drive-pin 4095"), Fault::OutputMismatch),
    vents("drive-pin-stuck-low", "no pressure", Injection::Chip("drive-pin 0"), Fault::OutputMismatch),
    Row {
        name: "pulse-pin-stuck-high",
        hazard: "full supply pressure",
        injection: Injection::Pulse("pulse-pin 1"),
        expected: Expected::Vents(Fault::OutputMismatch, SAFE_WITHIN_MS),
        residual: "a driver behind the pin: seen by the pressure alone",
    },
    vents("pulse-pin-stuck-low", "no pressure", Injection::Pulse("pulse-pin 0"), Fault::OutputMismatch),
    vents("pulse-pin-stuck-high-unused", "a valve that is wired to both drives", Injection::Chip("pulse-pin 1"), Fault::OutputMismatch),
    row(
        "pulse-pin-stuck-high-at-start",
        "a valve that is wired to both drives",
        Injection::Start("pulse-pin 1", None),
        Expected::StaysVented(Fault::OutputMismatch),
    ),
    vents("dump-pin-stuck-low", "no pressure", Injection::Chip("dump-pin 0"), Fault::OutputMismatch),
    Row {
        name: "dump-pin-stuck-high",
        hazard: "venting has no effect",
        injection: Injection::Start("dump-pin 1", None),
        expected: Expected::NoDrive(Fault::OutputMismatch),
        residual: "the dump valve stays closed; the drive stays at zero, and the rig cannot be armed",
    },
    row("inputs-swapped", "limits on the wrong quantity", Injection::InputsSwapped, Expected::Bounded),
    vents("inputs-swap-under-pressure", "limits on the wrong quantity", Injection::Chip("inputs swapped"), Fault::LaserRate),
    row(
        "laser-frozen-with-noise",
        "blind control",
        Injection::AroundWide(Breakage::LaserFrozenWithNoise),
        Expected::Vents(Fault::LaserStuck, 1250),
    ),
    row(
        "pressure-frozen-with-noise",
        "blind limits",
        Injection::AroundWide(Breakage::PressureFrozenWithNoise),
        Expected::Vents(Fault::PressureMismatch, 1250),
    ),
    vents("supply-dips-at-the-second-start", "wrong codes, undefined logic", Injection::SecondStart("supply 2800"), Fault::BrownOut),
    row("supply-falls-10-v-per-s", "undefined logic", Injection::SupplyRamp(10), Expected::Restarts(SAFE_WITHIN_MS)),
    row("supply-falls-100-v-per-s", "undefined logic", Injection::SupplyRamp(100), Expected::Restarts(SAFE_WITHIN_MS)),
    vents("undefined-instruction", "any", Injection::Tick(UNDEFINED), Fault::HardFault),
    vents("stack-overflow", "damaged state", Injection::Tick(PUSH_FOR_EVER), Fault::HardFault),
    vents("program-writes-into-program", "any", Injection::Tick(STORE_INTO_PROGRAM), Fault::HardFault),
    vents("memory-as-code", "any", Injection::Tick(EXECUTE_MEMORY), Fault::HardFault),
    row("cut-while-erasing-for-a-model", "another model after the next start", Injection::CutWhileUploading(1), Expected::OldOrNew),
    row("cut-in-a-model", "another model after the next start", Injection::CutWhileUploading(40), Expected::OldOrNew),
    row("cut-in-a-models-last-words", "another model after the next start", Injection::CutWhileUploading(0), Expected::OldOrNew),
    row("erase-takes-two-seconds", "watchdog bites", Injection::SlowErase, Expected::OldOrNew),
    row("frames-of-another-session", "pressure that nobody asked for", Injection::OtherSession, Expected::Bounded),
    row("an-old-frame-again", "pressure that nobody asked for", Injection::OldFrame, Expected::Bounded),
    row("babble-beside-the-host", "ticks that come late", Injection::BabbleBesideTheHost, Expected::Bounded),
    row("cut-at-every-operation", "other limits after the next start", Injection::CutAtEveryOperation, Expected::OldOrNew),
    row("settings-bits", "laxer limits", Injection::SettingsBits, Expected::Bounded),
    row("model-bits", "another model", Injection::ModelBits, Expected::Bounded),
    row("memory-bits", "any", Injection::MemoryBits, Expected::Bounded),
];

/// A slice of the matrix that meets every fault and every expectation: the first row of each, and what sweeps over flash.
#[must_use]
pub fn slice() -> Vec<&'static Row> {
    let mut met = Vec::new();
    let is_in = |row: &&Row| {
        let is_new = !met.contains(&row.expected);
        if is_new {
            met.push(row.expected);
        }
        is_new || matches!(row.injection, Injection::SettingsBits | Injection::CutAtEveryOperation)
    };
    ROWS.iter().filter(is_in).collect()
}

/// What was measured.
#[derive(Clone, Debug)]
pub struct Measured {
    /// Time until the outputs were safe, ms; `None` if they never were or need not be.
    pub detected_ms: Option<u32>,
    /// Highest true pressure from the fault on, bar.
    pub peak_bar: f64,
    /// The fault that the device names, 0 for none.
    pub fault: u8,
    /// Whether all of it is as expected.
    pub ok: bool,
    /// What is not.
    pub remark: String,
}

struct Bench {
    rig: ModelRig<Watch>,
    watch: Watch,
}

impl Bench {
    fn start(flash: &FlashMemory, first: Option<(&str, Option<u64>)>) -> Self {
        Self::start_on(config(), flash, first)
    }

    fn start_on(config: BoardModelConfig, flash: &FlashMemory, first: Option<(&str, Option<u64>)>) -> Self {
        Self::start_with(config, flash, first, HardwareConfig::default())
    }

    fn start_with(mut config: BoardModelConfig, flash: &FlashMemory, first: Option<(&str, Option<u64>)>, hardware: HardwareConfig) -> Self {
        config.core_hz = first.and_then(|(_, core_hz)| core_hz);
        let mut processor = BoardModel::start(config, flash).unwrap_or_else(|error| panic!("{error}"));
        if let Some((what, _)) = first {
            processor.break_something(what).expect("a fault the board knows");
        }
        let plant = Plant::new(PlantConfig::default()).expect("a plant");
        let hardware = Hardware::new(hardware, Box::new(plant.start(0.0)));
        let watch = Watch::default();
        let lockstep = Lockstep::new(processor, hardware, watch.clone(), "the board's model", BOARD_MODEL).expect("a start");
        Self { rig: ModelRig::connect(lockstep).expect("a connection"), watch }
    }

    fn pass(&mut self, milliseconds: u32) {
        self.rig.transport().advance_for(milliseconds).expect("a running board");
    }

    fn break_something(&mut self, what: &str) {
        self.rig.transport().processor().break_something(what).expect("a fault the board knows");
    }

    fn arm(&mut self) {
        experiment::settle(&mut self.rig).expect("a self-test that ends");
        self.rig.command(&Request::Arm).expect("an armed rig");
    }

    fn run_up(&mut self) {
        self.arm();
        self.rig.command(&Request::Start).expect("a started rig");
        self.hold(800);
        let pressure_bar = self.rig.transport().hardware().pressure_bar();
        assert!((pressure_bar - SET_POINT_BAR).abs() < 0.1, "{pressure_bar} bar before the fault");
    }

    /// Asks for the set-point as a host does, every 10 ms.
    fn hold(&mut self, milliseconds: u32) {
        self.ask_for(milliseconds, |_| SET_POINT_BAR);
    }

    /// The same with a set-point that goes up and down by half a bar, once a second.
    fn swing(&mut self, milliseconds: u32) {
        self.ask_for(milliseconds, |ms| SET_POINT_BAR - 0.25 + 0.25 * (std::f64::consts::TAU * f64::from(ms) / 1000.0).cos());
    }

    /// The same between 0.4 and 2.4 bar, 0.8 times a second.
    fn swing_wide(&mut self, milliseconds: u32) {
        self.ask_for(milliseconds, |ms| 1.4 + (std::f64::consts::TAU * 0.8 * f64::from(ms) / 1000.0).sin());
    }

    fn ask_for(&mut self, milliseconds: u32, bar_at: impl Fn(u32) -> f64) {
        for ms in (0..milliseconds).step_by(10) {
            self.rig.send(&Request::SetPoint { quantity: Quantity::Pressure, value: bar_at(ms) as f32 }).expect("a line");
            self.pass(10);
        }
    }

    fn status(&mut self) -> Option<Status> {
        // A device that has just started again hears the first request late.
        (0..4).find_map(|_| match self.rig.ask(&Request::Status) {
            Ok(Reply::Status(status)) => Some(status),
            _ => {
                self.pass(100);
                None
            }
        })
    }

    /// The first fault: the latched one, or the one on record.
    fn fault(&mut self) -> (u8, Option<Status>) {
        let status = self.status();
        (status.as_ref().map_or(0, |status| status.first_fault), status)
    }

    fn measure(&mut self, from: usize, expected: Expected) -> Measured {
        let moments = self.watch.since(from);
        let safe = moments.iter().position(|moment| !moment.energised);
        let peak_bar = moments.iter().map(|moment| moment.pressure_bar).fold(0.0, f64::max);
        let (fault, status) = self.fault();
        let mut remarks = Vec::new();
        let gone = safe.is_none_or(|safe| moments.get(safe + GONE_WITHIN_MS).is_none_or(|moment| moment.pressure_bar < GONE_BAR));
        let detected_ms = safe.and_then(|ticks| u32::try_from(ticks).ok());
        let mut want = |holds: bool, what: &str| {
            if !holds {
                remarks.push(what.to_owned());
            }
        };
        want(peak_bar <= CEILING_BAR + SLEW_STEP_BAR, "pressure above the ceiling");
        match expected {
            Expected::Vents(wanted, within_ms) => {
                want(detected_ms.is_some_and(|ms| ms <= within_ms), "outputs not safe in time");
                want(gone, "pressure not gone a second later");
                let all = status.map(|status| status.faults);
                want(fault == wanted.number() || all.is_some_and(|faults| faults.contains(wanted)), "another fault, or none");
            }
            Expected::Restarts(within_ms) => {
                want(detected_ms.is_some_and(|ms| ms <= within_ms), "outputs not safe in time");
                want(gone, "pressure not gone a second later");
                want(status.is_none_or(|status| !matches!(status.state, State::Armed | State::Running)), "energised after the restart");
            }
            Expected::StaysVented(wanted) => {
                want(moments.iter().all(|moment| !moment.energised), "energised");
                want(status.as_ref().is_some_and(|status| status.faults.contains(wanted)), "another fault, or none");
            }
            Expected::NoDrive(wanted) => {
                want(moments.iter().all(|moment| moment.valve_share == 0), "drive above zero");
                want(status.as_ref().is_some_and(|status| status.faults.contains(wanted)), "another fault, or none");
            }
            Expected::Holds => {
                want(safe.is_none(), "vented");
                let off = moments.iter().skip(CORRECTED_WITHIN_MS).map(|moment| (moment.pressure_bar / SET_POINT_BAR - 1.0).abs());
                let worst = off.fold(0.0, f64::max);
                want(worst <= EXACT, &format!("off by {:.2} %", 100.0 * worst));
            }
            Expected::Bounded | Expected::OldOrNew => {}
        }
        Measured { detected_ms, peak_bar, fault, ok: remarks.is_empty(), remark: remarks.join("; ") }
    }
}

/// Brings the image to a held pressure with one of its two drives; gives the pressure and the largest share of the drive.
///
/// # Panics
/// When it does not get there.
#[must_use]
pub fn held_with_drive(valve_drive: u32) -> (f64, u16) {
    let settings = Settings { control_law: 1, valve_drive, ..Settings::default() };
    let flash = FlashMemory::default().with_settings(&settings).expect("settings that fit");
    let mut bench = Bench::start(&flash, None);
    bench.run_up();
    let share = bench.watch.since(0).iter().map(|moment| moment.valve_share).max().unwrap_or_default();
    (bench.rig.transport().hardware().pressure_bar(), share)
}

/// How a profile of a valve or a sensor ends on the image: the safe state before anything is armed, under pressure, and after each fault.
#[derive(Clone, Debug, PartialEq)]
pub struct ProfileEnd {
    /// Its name, and what struck.
    pub name: String,
    /// Whether the drive was at zero and the dump valve without current before it was armed.
    pub rests: bool,
    /// Pressure that was held, bar.
    pub held_bar: f64,
    /// Time until the outputs were safe, ms.
    pub safe_ms: Option<u32>,
    /// Whether they stayed so, and the drive at zero.
    pub stays: bool,
    /// The fault that the device names.
    pub fault: u8,
}

/// Puts a profile's settings into the image's flash, holds 1 bar with it, and breaks something.
///
/// # Panics
/// When its settings are not taken, or the pressure is not reached.
#[must_use]
pub fn profile_ends(profile: &Profile, breakage: Breakage) -> ProfileEnd {
    const HELD_BAR: f64 = 1.0;
    let mut settings = Settings { control_law: 1, ..Settings::default() };
    profile.apply(&mut settings).expect("settings of a profile");
    // A valve that gives the held pressure at the profile's drive for it.
    let span = settings.valve_highest_share - settings.valve_lowest_share;
    let share = f64::from(settings.valve_lowest_share) + f64::from(span) * HELD_BAR / f64::from(settings.valve_full_scale_bar);
    let hardware = HardwareConfig { valve_full_scale_bar: HELD_BAR / share, ..HardwareConfig::default() };
    let flash = FlashMemory::default().with_settings(&settings).expect("settings that fit");
    let mut bench = Bench::start_with(config(), &flash, None, hardware);
    experiment::settle(&mut bench.rig).expect("a self-test that ends");
    let rests = bench.watch.since(0).iter().all(|moment| !moment.energised && moment.valve_share == 0);
    bench.rig.command(&Request::Arm).expect("an armed rig");
    bench.rig.command(&Request::Start).expect("a started rig");
    bench.ask_for(800, |_| HELD_BAR);
    let held_bar = bench.rig.transport().hardware().pressure_bar();
    let from = bench.watch.len();
    bench.rig.transport().hardware().set_breakage(Some(breakage));
    bench.ask_for(WATCHED_MS, |_| HELD_BAR);
    let moments = bench.watch.since(from);
    let safe = moments.iter().position(|moment| !moment.energised);
    let stays = safe.is_some_and(|safe| moments[safe..].iter().all(|moment| !moment.energised && moment.valve_share == 0));
    let safe_ms = safe.and_then(|ticks| u32::try_from(ticks).ok());
    ProfileEnd { name: format!("{}, {breakage:?}", profile.name), rests, held_bar, safe_ms, stays, fault: bench.fault().0 }
}

fn set_point_flash(ceiling_bar: f32) -> FlashMemory {
    let settings = Settings { control_law: 1, ceiling_bar, ..Settings::default() };
    FlashMemory::default().with_settings(&settings).expect("settings that fit")
}

fn pulse_flash() -> FlashMemory {
    let settings = Settings { control_law: 1, valve_drive: 1, ..Settings::default() };
    FlashMemory::default().with_settings(&settings).expect("settings that fit")
}

/// [`measure`] of some rows, on as many threads as there are cores; `each` hears of every one when it is done. In the order of the rows.
///
/// # Panics
/// As [`measure`].
pub fn measure_all(rows: &[&Row], each: impl Fn(&Row, &Measured) + Sync) -> Vec<Measured> {
    measure_all_on(&config(), rows, each)
}

/// The same on this board's image.
///
/// # Panics
/// As [`measure`].
pub fn measure_all_on(board: &BoardModelConfig, rows: &[&Row], each: impl Fn(&Row, &Measured) + Sync) -> Vec<Measured> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let next = AtomicUsize::new(0);
    let done: Mutex<Vec<Option<Measured>>> = Mutex::new(vec![None; rows.len()]);
    std::thread::scope(|scope| {
        for _ in 0..threads.min(rows.len()) {
            scope.spawn(|| {
                while let Some((index, row)) = Some(next.fetch_add(1, Ordering::Relaxed)).and_then(|index| Some((index, rows.get(index)?)))
                {
                    let measured = measure_on(board, row);
                    each(row, &measured);
                    done.lock().expect("no thread panics while it holds the lock")[index] = Some(measured);
                }
            });
        }
    });
    done.into_inner().expect("no thread panics while it holds the lock").into_iter().flatten().collect()
}

/// Does what a row says.
///
/// # Panics
/// When the rig cannot be brought to where the fault is to strike.
#[must_use]
pub fn measure(row: &Row) -> Measured {
    measure_on(&config(), row)
}

/// The same on this board's image; its model may not know every fault.
///
/// # Panics
/// As [`measure`].
#[must_use]
pub fn measure_on(board: &BoardModelConfig, row: &Row) -> Measured {
    let flash = set_point_flash(CEILING_BAR as f32);
    match row.injection {
        Injection::Start(what, core_hz) => {
            let mut bench = Bench::start_on(board.clone(), &flash, Some((what, core_hz)));
            bench.pass(500);
            let _ = bench.rig.ask(&Request::Arm);
            let _ = bench.rig.ask(&Request::Start);
            bench.hold(300);
            bench.measure(0, row.expected)
        }
        Injection::ResetIn(state) => {
            let mut bench = Bench::start_on(board.clone(), &flash, None);
            match state {
                State::Running => bench.run_up(),
                State::Armed => bench.arm(),
                // It begins 200 ms after the start and takes a while.
                State::SelfTest => bench.pass(202),
                State::Fault => {
                    bench.run_up();
                    bench.rig.transport().hardware().set_breakage(Some(Breakage::EmergencyStop));
                    bench.hold(100);
                    bench.rig.transport().hardware().set_breakage(None);
                }
                _ => {
                    experiment::settle(&mut bench.rig).expect("a self-test that ends");
                }
            }
            let from = bench.watch.len();
            bench.break_something("reset");
            bench.pass(WATCHED_MS);
            bench.measure(from, row.expected)
        }
        Injection::CutWhileSaving(operation) => cut_while_saving(operation),
        Injection::CutWhileUploading(operation) => more::cut_while_uploading(operation),
        Injection::SlowErase => more::slow_erase(),
        Injection::OtherSession | Injection::OldFrame => more::strange_frames(board, row),
        Injection::SettingsBits => more::settings_bits(),
        Injection::CutAtEveryOperation => more::cut_at_every_operation(),
        Injection::BabbleBesideTheHost => more::babble_beside_the_host(),
        Injection::ModelBits => more::model_bits(),
        Injection::MemoryBits => more::memory_bits(),
        Injection::InputsSwapped => more::inputs_swapped(board, row),
        Injection::SupplyRamp(step_mv) => more::supply_ramp(row, step_mv),
        Injection::Tick(instructions) => more::in_the_tick(board, row, instructions),
        Injection::SecondStart(what) => {
            let mut bench = Bench::start_on(board.clone(), &flash, None);
            bench.pass(400);
            bench.break_something("reset");
            bench.pass(400);
            let _ = bench.rig.greet_again();
            bench.run_up();
            let from = bench.watch.len();
            bench.break_something(what);
            bench.hold(WATCHED_MS);
            bench.break_something("supply 3300");
            bench.pass(300);
            bench.measure(from, row.expected)
        }
        Injection::Chip(what) | Injection::ChipWith(_, what) | Injection::ChipFor(what, ..) | Injection::Pulse(what) => {
            let first = if let Injection::ChipWith(first, _) = row.injection { Some((first, None)) } else { None };
            let flash = if matches!(row.injection, Injection::Pulse(_)) { pulse_flash() } else { flash };
            let mut bench = Bench::start_on(board.clone(), &flash, first);
            bench.run_up();
            let from = bench.watch.len();
            bench.break_something(what);
            if let Injection::ChipFor(_, milliseconds, repaired) = row.injection {
                bench.pass(milliseconds);
                bench.break_something(repaired);
            }
            bench.hold(WATCHED_MS);
            if what.starts_with("supply") {
                // A dead board has nothing to tell until its supply is back.
                bench.break_something("supply 3300");
                bench.pass(300);
            }
            bench.measure(from, row.expected)
        }
        Injection::Around(breakage) | Injection::AroundMoving(breakage) | Injection::AroundWide(breakage) => {
            let mut bench = Bench::start_on(board.clone(), &flash, None);
            bench.run_up();
            let from = bench.watch.len();
            bench.rig.transport().hardware().set_breakage(Some(breakage));
            match row.injection {
                Injection::AroundMoving(_) => bench.swing(WATCHED_MS),
                Injection::AroundWide(_) => bench.swing_wide(WATCHED_MS),
                _ => bench.hold(WATCHED_MS),
            }
            bench.measure(from, row.expected)
        }
        Injection::HostSilent | Injection::HostBabbles => {
            let mut bench = Bench::start_on(board.clone(), &flash, None);
            bench.run_up();
            let from = bench.watch.len();
            if row.injection == Injection::HostBabbles {
                // Ends of frames among them, so that the device has something to check all the time.
                let nonsense: Vec<u8> = (0..92u8).map(|index| if index % 23 == 0 { 0 } else { index.wrapping_mul(89) }).collect();
                for _ in 0..WATCHED_MS {
                    bench.rig.transport().send(&nonsense).expect("a line");
                    bench.pass(1);
                }
            } else {
                bench.pass(WATCHED_MS);
            }
            bench.measure(from, row.expected)
        }
    }
}

/// Saves a lower ceiling and cuts the supply meanwhile.
fn cut_while_saving(operation: u32) -> Measured {
    cut_at(operation).0
}

/// The same, and whether there was an operation to cut.
fn cut_at(operation: u32) -> (Measured, bool) {
    const OLD_BAR: f32 = 2.0;
    const NEW_BAR: f32 = 1.0;
    /// The longest that saving and the start behind a cut take, ms.
    const LONGEST_MS: u32 = 4000;
    let mut bench = Bench::start(&set_point_flash(OLD_BAR), None);
    experiment::settle(&mut bench.rig).expect("a self-test that ends");
    let number = model_export::link::settings::by_name("limits.ceiling_bar").expect("a setting").number;
    let value = model_export::link::settings::SettingValue::Float(NEW_BAR);
    bench.rig.command(&Request::SettingSet { number, value }).expect("a setting that is taken");
    bench.break_something(&format!("cut {operation}"));
    let from = bench.watch.len();
    let _ = bench.rig.send(&Request::SettingsSave);
    let mut passed_ms = 0;
    while passed_ms < LONGEST_MS && bench.rig.transport().processor().pins().resets == 0 {
        bench.pass(20);
        passed_ms += 20;
    }
    bench.pass(60);
    let _ = bench.rig.listen(Duration::from_millis(50));
    let is_cut = bench.rig.transport().processor().pins().resets > 0;
    let _ = bench.rig.greet_again();
    let after = host_tool::device_settings::setting(&mut bench.rig, "limits.ceiling_bar").ok();
    let mut measured = bench.measure(from, Expected::OldOrNew);
    let float = |bar: f32| Some(model_export::link::settings::SettingValue::Float(bar));
    if after != float(OLD_BAR) && after != float(NEW_BAR) {
        measured.ok = false;
        measured.remark = format!("the ceiling is {after:?} afterwards");
    } else if !is_cut {
        // So few operations: nothing was cut, and the new value has to be there.
        measured.ok = after == float(NEW_BAR);
        measured.remark = "the saving was over before".to_owned();
    }
    (measured, is_cut)
}
