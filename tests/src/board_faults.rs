//! Single faults of the flashable image on the model of its chip: what strikes, what should notice it, what was measured.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use host_tool::backend::BOARD_MODEL;
use host_tool::experiment;
use host_tool::link::{BoardModel, BoardModelConfig, Breakage, FlashMemory, Hardware, HardwareConfig, Lockstep, Transport};
use host_tool::plant::{Plant, PlantConfig};
use model_export::link::message::{Quantity, Reply, Request, Status};
use model_export::link::profiles::Profile;
use model_export::link::settings::Settings;
use model_export::link::state::State;

use crate::board_model::{ModelRig, Watch, config};

mod matrix;
mod more;

pub use matrix::{Expected, Injection, ROWS, Row, slice};

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
/// How long a fault is watched, ms.
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
    /// Ten times what the outputs may take, and so long that a drive that comes back would be seen.
    const WATCHED_MS: u32 = 500;
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
