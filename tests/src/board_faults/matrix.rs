//! The matrix of single faults: hazard, cause, and how each should end.

use host_tool::link::Breakage;
use model_export::link::fault::Fault;
use model_export::link::state::State;

/// Outputs are safe within this time after a fault, ms.
pub(super) const SAFE_WITHIN_MS: u32 = 50;
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
    /// While there is pressure, these 16-bit words in place of the tick's first instructions, for so many ms.
    Tick(&'static [u16], u32),
    /// While there is pressure, the supply falls from 3.3 V to 1.5 V by so many mV a ms.
    SupplyRamp(u32),
    /// Both analogue inputs are exchanged from the start.
    InputsSwapped,
    /// The same at a pressure where both read alike; then the set-point moves.
    InputsSwapAlike,
    /// While there is pressure, the pressure sensor drifts by so many bar a second.
    PressureDrifts(f64),
    /// While there is pressure, in the hardware around it, for so many ms.
    AroundFor(Breakage, u32),
    /// The valve sticks fully open, with the supply regulator at this pressure, bar: two faults.
    ValveOpenAtSupply(f64),
    /// The drive's pin keeps the code it has while the set-point moves.
    DriveKeepsItsCode,
    /// The upper half of the active settings' slot is erased before a start.
    HalfSettings,
    /// Power goes in the middle of this operation on flash while a model arrives.
    CutWhileUploading(u32),
    /// Settings are saved with flash at its slowest.
    SlowErase,
    /// Frames of another session ask for more pressure.
    OtherSession,
    /// After a reset, all that moved the rig before it is said again.
    BootBefore,
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
    /// Bits all over the program, with one start for each.
    ProgramBits,
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
    /// As [`Expected::Vents`], but the air stays where it is: the drive is at zero, the dump valve without current, and the fault named.
    VentsInVain(Fault, u32),
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
/// `bx lr`: a tick that does nothing.
const RETURN: &[u16] = &[0x4770];
// A zero into a register, and back: r0 becomes its address 8 bits at a time, r1 zero (RM0090 table 1; Armv7-M manual section B3.2.2).
/// TIM2_CR1: the sampling timer.
const STOP_SAMPLING_TIMER: &[u16] = &[0x2040, 0x0600, 0x2100, 0x6001, 0x4770];
/// ADC1_CR2: the converter.
const STOP_CONVERTER: &[u16] = &[0x2040, 0x0200, 0x3001, 0x0200, 0x3020, 0x0200, 0x2100, 0x6081, 0x4770];
/// DAC_CR: the drive.
const STOP_DRIVE: &[u16] = &[0x2040, 0x0400, 0x3074, 0x0200, 0x2100, 0x6001, 0x4770];
/// GPIOB_MODER: the pins of dump valve and emergency stop.
const RELEASE_PINS: &[u16] = &[0x2040, 0x0200, 0x3002, 0x0200, 0x3004, 0x0200, 0x2100, 0x6001, 0x4770];
/// RCC_APB1ENR: the clocks of drive, pulse width and sampling timer.
const STOP_CLOCKS: &[u16] = &[0x2040, 0x0200, 0x3002, 0x0200, 0x3038, 0x0200, 0x2100, 0x6401, 0x4770];
/// SYST_CSR: the count of milliseconds, and the monitor of the tick.
const STOP_TIME: &[u16] = &[0x20e0, 0x0400, 0x30e0, 0x0200, 0x2100, 0x6101, 0x4770];
/// NVIC_ICER0, bit 18: the tick's interrupt.
const DISABLE_TICK: &[u16] = &[0x20e0, 0x0400, 0x30e1, 0x0200, 0x3080, 0x2104, 0x0409, 0x6001, 0x4770];

/// The matrix.
pub const ROWS: &[Row] = &[
    row("hse-absent", "wrong time base, wrong slew", Injection::Start("hse stops", None), Expected::StaysVented(Fault::ClockFailed)),
    row(
        "hse-12-mhz",
        "wrong time base, overclocked",
        Injection::Start("hse 12000000", None),
        Expected::StaysVented(Fault::ClockInaccurate),
    ),
    row("hse-9-percent-fast", "wrong slew", Injection::Start("hse 8720000", None), Expected::StaysVented(Fault::ClockInaccurate)),
    row("hse-4-mhz", "wrong slew", Injection::Start("hse 4000000", None), Expected::StaysVented(Fault::ClockInaccurate)),
    row("loop-does-not-lock", "slow ticks", Injection::Start("loop open", Some(16_000_000)), Expected::StaysVented(Fault::ClockFailed)),
    vents("hse-stops", "wrong time base", Injection::Chip("hse stops"), Fault::ClockFailed),
    vents("core-hangs", "outputs frozen", Injection::Chip("hang"), Fault::WatchdogReset),
    vents("core-hangs-slow-watchdog", "outputs frozen", Injection::ChipWith("watchdog-oscillator 17000", "hang"), Fault::WatchdogReset),
    vents("core-hangs-fast-watchdog", "outputs frozen", Injection::ChipWith("watchdog-oscillator 47000", "hang"), Fault::WatchdogReset),
    row("supply-low-at-start", "undefined logic", Injection::Start("supply 2800", None), Expected::StaysVented(Fault::BrownOut)),
    row("program-bit-flipped", "any", Injection::ProgramBits, Expected::StaysVented(Fault::FlashCorrupt)),
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
    Row {
        name: "valve-fully-open-at-6-bar",
        hazard: "twice the ceiling",
        injection: Injection::ValveOpenAtSupply(6.0),
        expected: Expected::Vents(Fault::PressureRate, SAFE_WITHIN_MS),
        residual: "two faults; a valve that opens slowly enough passes the ceiling before it is noticed",
    },
    row("supply-at-6-bar", "full supply pressure", Injection::Around(Breakage::SupplyBar(6.0)), Expected::Holds),
    row("supply-at-1-bar", "no pressure", Injection::Around(Breakage::SupplyBar(1.0)), Expected::Vents(Fault::PressureMismatch, 1000)),
    row("line-leaks-half", "air in the body", Injection::Around(Breakage::LineLeaks(0.5)), Expected::Vents(Fault::PressureMismatch, 1000)),
    Row {
        name: "line-leaks-a-tenth",
        hazard: "air in the body",
        injection: Injection::AroundMoving(Breakage::LineLeaks(0.1)),
        expected: Expected::Bounded,
        residual: "a loss below 0.3 bar is not noticed; the pressure is lower than asked for",
    },
    Row {
        name: "line-blocked",
        hazard: "venting has no effect",
        injection: Injection::AroundWide(Breakage::LineBlocked),
        expected: Expected::VentsInVain(Fault::PressureMismatch, 1000),
        residual: "the air beside the muscle stays until somebody opens the line",
    },
    vents(
        "pressure-reads-a-third-less",
        "limits at the wrong place",
        Injection::Around(Breakage::PressureGain(0.67)),
        Fault::PressureMismatch,
    ),
    Row {
        name: "pressure-reads-a-tenth-more",
        hazard: "limits at the wrong place",
        injection: Injection::AroundMoving(Breakage::PressureGain(1.1)),
        expected: Expected::Bounded,
        residual: "an error below 0.3 bar is not noticed; the limits of the command hold",
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
        "inputs-swap-where-both-read-alike",
        "limits on the wrong quantity",
        Injection::InputsSwapAlike,
        Expected::Vents(Fault::PressureMismatch, 1250),
    ),
    row(
        "pressure-drifts-0.4-bar-per-s",
        "limits at the wrong place",
        Injection::PressureDrifts(0.4),
        Expected::Vents(Fault::PressureMismatch, 1000),
    ),
    vents("emergency-stop-for-3-ms", "operator is not heard", Injection::AroundFor(Breakage::EmergencyStop, 3), Fault::EmergencyStop),
    row("drive-pin-keeps-its-code", "pressure does not follow", Injection::DriveKeepsItsCode, Expected::Vents(Fault::OutputMismatch, 250)),
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
    vents("undefined-instruction", "any", Injection::Tick(UNDEFINED, 20), Fault::HardFault),
    vents("stack-overflow", "damaged state", Injection::Tick(PUSH_FOR_EVER, 20), Fault::HardFault),
    vents("program-writes-into-program", "any", Injection::Tick(STORE_INTO_PROGRAM, 20), Fault::HardFault),
    vents("memory-as-code", "any", Injection::Tick(EXECUTE_MEMORY, 20), Fault::HardFault),
    vents("ticks-do-nothing-for-22-ms", "outputs frozen", Injection::Tick(RETURN, 22), Fault::DeadlineMissed),
    vents("ticks-do-nothing", "outputs frozen", Injection::Tick(RETURN, 100), Fault::WatchdogReset),
    vents("tick-interrupt-disabled", "outputs frozen", Injection::Tick(DISABLE_TICK, 1), Fault::WatchdogReset),
    vents("sampling-timer-stops", "control on old samples", Injection::Tick(STOP_SAMPLING_TIMER, 1), Fault::DeadlineMissed),
    vents("converter-switched-off", "control on old samples", Injection::Tick(STOP_CONVERTER, 1), Fault::DeadlineMissed),
    vents("drive-switched-off", "no pressure", Injection::Tick(STOP_DRIVE, 1), Fault::OutputMismatch),
    vents("pins-become-inputs", "no order reaches the dump valve", Injection::Tick(RELEASE_PINS, 1), Fault::OutputMismatch),
    vents("clocks-of-outputs-stop", "outputs frozen", Injection::Tick(STOP_CLOCKS, 1), Fault::OutputMismatch),
    vents("count-of-milliseconds-stops", "lost ticks unseen", Injection::Tick(STOP_TIME, 1), Fault::DeadlineMissed),
    row("cut-while-erasing-for-a-model", "another model after the next start", Injection::CutWhileUploading(1), Expected::OldOrNew),
    row("cut-in-a-model", "another model after the next start", Injection::CutWhileUploading(40), Expected::OldOrNew),
    row("cut-in-a-models-last-words", "another model after the next start", Injection::CutWhileUploading(0), Expected::OldOrNew),
    row("erase-takes-two-seconds", "watchdog bites", Injection::SlowErase, Expected::OldOrNew),
    row("frames-of-another-session", "pressure that nobody asked for", Injection::OtherSession, Expected::Bounded),
    row("frames-of-the-boot-before", "pressure that nobody asked for", Injection::BootBefore, Expected::Restarts(SAFE_WITHIN_MS)),
    row("an-old-frame-again", "pressure that nobody asked for", Injection::OldFrame, Expected::Bounded),
    row("babble-beside-the-host", "ticks that come late", Injection::BabbleBesideTheHost, Expected::Bounded),
    row("cut-at-every-operation", "other limits after the next start", Injection::CutAtEveryOperation, Expected::OldOrNew),
    row("settings-half-erased", "laxer limits", Injection::HalfSettings, Expected::StaysVented(Fault::SettingsInvalid)),
    row("settings-bits", "laxer limits", Injection::SettingsBits, Expected::Bounded),
    row("model-bits", "another model", Injection::ModelBits, Expected::Bounded),
    row("memory-bits", "any", Injection::MemoryBits, Expected::Bounded),
];

/// A slice of the matrix that meets every fault and every expectation: the first row of each, and what sweeps over flash.
#[must_use]
pub fn slice() -> Vec<&'static Row> {
    let sweeps = |row: &Row| matches!(row.injection, Injection::SettingsBits | Injection::CutAtEveryOperation);
    first_of_each_end(|_| true).into_iter().chain(ROWS.iter().filter(|row| sweeps(row))).collect()
}

/// The same for a second chip: only what strikes in the chip itself, since sensors, pressure and host meet the same program as on the first.
#[must_use]
pub fn slice_in_the_chip(known: &[&str]) -> Vec<&'static Row> {
    use Injection::{BabbleBesideTheHost, Chip, ChipWith, Pulse, ResetIn, Start, Tick};
    let rows = first_of_each_end(|row| {
        let in_the_chip = matches!(row.injection, Chip(_) | ChipWith(..) | Pulse(_) | ResetIn(_) | Start(..) | Tick(..));
        in_the_chip && known.contains(&row.name)
    });
    rows.into_iter().chain(ROWS.iter().filter(|row| row.injection == BabbleBesideTheHost)).collect()
}

/// Of those that are meant, the first row of each end.
fn first_of_each_end(is_meant: impl Fn(&Row) -> bool) -> Vec<&'static Row> {
    let mut met = Vec::new();
    ROWS.iter()
        .filter(|row| {
            let is_new = is_meant(row) && !met.contains(&row.expected);
            if is_new {
                met.push(row.expected);
            }
            is_new
        })
        .collect()
}
