//! Single faults of the flashable image on the model of its chip: what strikes, what should notice it, what was measured.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use host_tool::backend::BOARD_MODEL;
use host_tool::experiment;
use host_tool::link::{BoardModel, BoardModelConfig, Breakage, FlashMemory, Hardware, HardwareConfig, Lockstep, Transport};
use host_tool::plant::{Plant, PlantConfig};
use model_export::link::message::{Quantity, Reply, Request, Status};
use model_export::link::settings::Settings;
use model_export::link::state::State;

use crate::board_model::{ModelRig, Moment, Watch, config, meet};

mod matrix;
mod more;
mod profiles;
mod storage;

pub use matrix::{Expected, Injection, ROWS, Row, slice, slice_in_the_chip};
pub use profiles::{ProfileEnd, profile_ends};

/// Pressure before the fault, bar.
const SET_POINT_BAR: f64 = 1.5;
/// The ceiling, bar: a fault may not lead above it by more than a tick of slew.
const CEILING_BAR: f64 = 3.0;
const SLEW_STEP_BAR: f64 = 0.02;
/// Pressure is gone this long after the outputs are safe, ms.
const GONE_WITHIN_MS: usize = 1000;
const GONE_BAR: f64 = 0.1;
/// What is corrected is right this long after it struck, ms, and how exact.
const CORRECTED_WITHIN_MS: usize = 100;
const EXACT: f64 = 0.01;
/// Outputs that were safe so long, with the pressure gone, stay so: ten times what they may take.
const STAYS_SAFE_MS: usize = 500;
/// How long a fault is watched at most, ms.
const WATCHED_MS: u32 = 1800;

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

/// Power comes to a board with something broken already or nothing; time has not passed.
fn power(
    mut config: BoardModelConfig,
    flash: &FlashMemory,
    first: Option<(&str, Option<u64>)>,
    hardware: HardwareConfig,
) -> (Lockstep<BoardModel, Watch>, Watch) {
    config.core_hz = first.and_then(|(_, core_hz)| core_hz);
    let mut processor = BoardModel::start(config, flash).unwrap_or_else(|error| panic!("{error}"));
    if let Some((what, _)) = first {
        processor.break_something(what).expect("a fault the board knows");
    }
    let plant = Plant::new(PlantConfig::default()).expect("a plant");
    let hardware = Hardware::new(hardware, Box::new(plant.start(0.0)));
    let watch = Watch::default();
    (Lockstep::new(processor, hardware, watch.clone(), "the board's model", BOARD_MODEL).expect("a start"), watch)
}

impl Bench {
    fn start(flash: &FlashMemory, first: Option<(&str, Option<u64>)>) -> Self {
        Self::start_on(config(), flash, first)
    }

    fn start_on(config: BoardModelConfig, flash: &FlashMemory, first: Option<(&str, Option<u64>)>) -> Self {
        Self::start_with(config, flash, first, HardwareConfig::default())
    }

    fn start_with(config: BoardModelConfig, flash: &FlashMemory, first: Option<(&str, Option<u64>)>, hardware: HardwareConfig) -> Self {
        let (lockstep, watch) = power(config, flash, first, hardware);
        Self { rig: meet(lockstep).unwrap_or_else(|error| panic!("{error}")), watch }
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
        self.hold(400);
        let pressure_bar = self.rig.transport().hardware().pressure_bar();
        assert!((pressure_bar - SET_POINT_BAR).abs() < 0.1, "{pressure_bar} bar before the fault");
    }

    /// Asks for the set-point as a host does, every 10 ms.
    fn hold(&mut self, milliseconds: u32) {
        self.ask_for(milliseconds, |_| SET_POINT_BAR);
    }

    fn ask_for(&mut self, milliseconds: u32, bar_at: impl Fn(u32) -> f64) {
        self.ask_while(milliseconds, bar_at, |_| true);
    }

    /// What follows a fault that struck at a tick, with a host that goes on.
    fn watch_from(&mut self, from: usize, bar_at: impl Fn(u32) -> f64) {
        self.ask_while(WATCHED_MS, bar_at, |bench| !bench.is_over(from));
    }

    /// Whether the outputs have been safe since a fault for long enough.
    fn is_over(&self, from: usize) -> bool {
        let moments = self.watch.since(from);
        let Some(safe) = moments.iter().position(|moment| !moment.energised) else { return false };
        let is_gone = moments.last().is_some_and(|moment| moment.pressure_bar < GONE_BAR);
        moments.len() > safe + if is_gone { STAYS_SAFE_MS } else { GONE_WITHIN_MS } + 20
    }

    fn ask_while(&mut self, milliseconds: u32, bar_at: impl Fn(u32) -> f64, goes_on: impl Fn(&Self) -> bool) {
        for ms in (0..milliseconds).step_by(10) {
            if !goes_on(self) {
                return;
            }
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
        let gone = safe.is_none_or(|safe| {
            let end = moments.get(safe + GONE_WITHIN_MS).or(moments.last());
            end.is_some_and(|moment| moment.pressure_bar < GONE_BAR)
        });
        let detected_ms = safe.and_then(|ticks| u32::try_from(ticks).ok());
        let mut want = |holds: bool, what: &str| {
            if !holds {
                remarks.push(what.to_owned());
            }
        };
        want(peak_bar <= CEILING_BAR + SLEW_STEP_BAR, "pressure above the ceiling");
        match expected {
            Expected::Vents(wanted, within_ms) | Expected::VentsInVain(wanted, within_ms) => {
                want(detected_ms.is_some_and(|ms| ms <= within_ms), "outputs not safe in time");
                let in_vain = matches!(expected, Expected::VentsInVain(..));
                want(gone != in_vain, "pressure not gone a second later, or gone where it cannot go");
                let after = safe.map_or(&[][..], |safe| &moments[safe..]);
                // A pin that is stuck shows what it is stuck at.
                let rests = |moment: &Moment| !moment.energised && (moment.valve_share == 0 || !in_vain);
                want(after.iter().all(rests), "outputs not safe for good");
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

/// Set-points over time after a fault: what was held.
fn at_rest(_: u32) -> f64 {
    SET_POINT_BAR
}

/// Up and down by half a bar, once a second.
fn swing(ms: u32) -> f64 {
    SET_POINT_BAR - 0.25 + 0.25 * (std::f64::consts::TAU * f64::from(ms) / 1000.0).cos()
}

/// Between 0.4 and 2.4 bar, 0.8 times a second.
fn wide_swing(ms: u32) -> f64 {
    1.4 + (std::f64::consts::TAU * 0.8 * f64::from(ms) / 1000.0).sin()
}

fn set_point_flash(ceiling_bar: f32) -> FlashMemory {
    let settings = Settings { control_law: 1, ceiling_bar, ..Settings::default() };
    FlashMemory::default().with_settings(&settings).expect("settings that fit")
}

fn pulse_flash() -> FlashMemory {
    let settings = Settings { control_law: 1, valve_drive: 1, ..Settings::default() };
    FlashMemory::default().with_settings(&settings).expect("settings that fit")
}

/// Whether sweeps are complete: when rows are asked for by name (`BOARD_FAULTS`). Beside all the others they take a sample.
fn is_thorough() -> bool {
    std::env::var_os("BOARD_FAULTS").is_some_and(|rows| rows != "all")
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
                // It begins 200 ms after the start of the ticks and lasts less than one of them: this is soon after it.
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
        Injection::CutWhileSaving(operation) => storage::cut_while_saving(operation),
        Injection::CutWhileUploading(operation) => storage::cut_while_uploading(operation),
        Injection::SlowErase => storage::slow_erase(),
        Injection::OtherSession | Injection::OldFrame => more::strange_frames(board, row),
        Injection::BootBefore => more::boot_before(board, row),
        Injection::HalfSettings => storage::half_settings(board, row),
        Injection::SettingsBits => storage::settings_bits(),
        Injection::CutAtEveryOperation => storage::cut_at_every_operation(),
        Injection::BabbleBesideTheHost => more::babble_beside_the_host(board),
        Injection::ModelBits => storage::model_bits(),
        Injection::MemoryBits => more::memory_bits(),
        Injection::ProgramBits => more::program_bits(board),
        Injection::InputsSwapped => more::inputs_swapped(board, row),
        Injection::InputsSwapAlike => more::inputs_swap_alike(board, row),
        Injection::SupplyRamp(step_mv) => more::supply_ramp(row, step_mv),
        Injection::Tick(instructions, milliseconds) => more::in_the_tick(board, row, instructions, milliseconds),
        Injection::SecondStart(what) => {
            let mut bench = Bench::start_on(board.clone(), &flash, None);
            bench.pass(400);
            bench.break_something("reset");
            bench.pass(400);
            let _ = bench.rig.greet_again();
            bench.run_up();
            let from = bench.watch.len();
            bench.break_something(what);
            bench.watch_from(from, at_rest);
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
            bench.watch_from(from, at_rest);
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
                Injection::AroundMoving(_) => bench.watch_from(from, swing),
                Injection::AroundWide(_) => bench.watch_from(from, wide_swing),
                _ => bench.watch_from(from, at_rest),
            }
            bench.measure(from, row.expected)
        }
        Injection::ValveOpenAtSupply(supply_bar) => {
            let mut bench = Bench::start_on(board.clone(), &flash, None);
            let supply = host_tool::link::Injection { breakage: Breakage::SupplyBar(supply_bar), from_ms: 0, until_ms: None };
            bench.rig.transport().hardware().inject(&[supply]);
            bench.run_up();
            let from = bench.watch.len();
            bench.rig.transport().hardware().set_breakage(Some(Breakage::ValveFullyOpen));
            bench.watch_from(from, at_rest);
            bench.measure(from, row.expected)
        }
        Injection::AroundFor(breakage, milliseconds) => {
            let mut bench = Bench::start_on(board.clone(), &flash, None);
            bench.run_up();
            let from = bench.watch.len();
            bench.rig.transport().hardware().set_breakage(Some(breakage));
            bench.pass(milliseconds);
            bench.rig.transport().hardware().set_breakage(None);
            bench.watch_from(from, at_rest);
            bench.measure(from, row.expected)
        }
        Injection::PressureDrifts(bar_per_s) => {
            let mut bench = Bench::start_on(board.clone(), &flash, None);
            bench.run_up();
            let from = bench.watch.len();
            for ms in (0..WATCHED_MS).step_by(10) {
                let offset_bar = bar_per_s * f64::from(ms) / 1000.0;
                bench.rig.transport().hardware().set_breakage(Some(Breakage::PressureOffsetBar(offset_bar)));
                bench.hold(10);
            }
            bench.measure(from, row.expected)
        }
        Injection::DriveKeepsItsCode => {
            let mut bench = Bench::start_on(board.clone(), &flash, None);
            bench.run_up();
            let from = bench.watch.len();
            // The share has 16 bits, the converter's code 12.
            let code = bench.rig.transport().processor().pins().valve_share >> 4;
            bench.break_something(&format!("drive-pin {code}"));
            bench.watch_from(from, swing);
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
                    if bench.is_over(from) {
                        break;
                    }
                    bench.rig.transport().send(&nonsense).expect("a line");
                    bench.pass(1);
                }
            } else {
                while bench.watch.len() < from + WATCHED_MS as usize && !bench.is_over(from) {
                    bench.pass(10);
                }
            }
            bench.measure(from, row.expected)
        }
    }
}
