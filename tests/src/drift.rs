//! The realistic rig with a drift: the tip's zero and gain move away from what the model was identified on, and the laser sees it.
//!
//! The laser of this rig warms up and was remounted, by up to 0.7 % of the stroke together. Nothing that learns from it can know that, so the
//! **reference** that estimates are held against is what the laser shows or would show, without its wrong samples and without noise. The
//! error against the true tip is reported beside it.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::{Arc, Mutex};

use host_tool::link::{Breakage, Client, FlashMemory, Hardware, HardwareConfig, InProcess, Lockstep, Muscle, Observer, TickRecord};
use host_tool::rig::live::{REST_MM, RealisticRig, STROKE_MM};
use host_tool::track::reference::{PERIOD_S, Reach, named};
use host_tool::track::{SettingValues, compare, controller, rig_settings, run, setting};
use host_tool::tune::Tuned;
use model_export::link::adaptation::AdaptationReport;
use model_export::link::message::{Reply, Request, Telemetry};
use model_export::link::settings::SettingValue;

/// The code that the laser gives when it sees nothing: 3.75 mA.
const LASER_FAULT_CODE: u16 = 1396;
/// Ticks of a window.
const WINDOW_TICKS: usize = 20;
/// Seed of the references that gains are found on.
const TUNING_SEED: u64 = 41;

/// What drifts, in an hour.
#[derive(Clone, Copy, Debug, Default)]
pub struct Drift {
    /// Zero, share of the stroke.
    pub zero_per_h: f64,
    /// Gain about the rest.
    pub gain_per_h: f64,
    /// When it stops, s; from the first tick on.
    pub until_s: f64,
}

/// The drifting rig.
struct Drifting {
    rig: RealisticRig,
    drift: Drift,
    ticks: f64,
    /// The last difference of laser and tip that was no wrong sample.
    laser_mm: f64,
    positions: Arc<Mutex<Positions>>,
}

/// Positions of the tip in every tick, mm.
#[derive(Default)]
struct Positions {
    /// Where it is.
    true_mm: Vec<f32>,
    /// Where the laser has it.
    seen_mm: Vec<f32>,
}

impl Muscle for Drifting {
    fn step(&mut self, pressure_bar: f64) -> f64 {
        let seen_mm = self.rig.advance_ms(pressure_bar);
        let tip_mm = self.rig.probe().tip_mm();
        self.ticks += 1.0;
        let hours = (self.ticks * 1e-3).min(self.drift.until_s) / 3600.0;
        let moved_mm = hours * (self.drift.zero_per_h * STROKE_MM + self.drift.gain_per_h * (tip_mm - REST_MM));
        let mut positions = self.positions.lock().expect("one thread");
        // A wrong sample is off by a tenth of the stroke and more; the laser's own zero and gain by much less.
        if (seen_mm - tip_mm).abs() < 0.05 * STROKE_MM {
            self.laser_mm = seen_mm - tip_mm;
        }
        positions.true_mm.push((tip_mm + moved_mm) as f32);
        positions.seen_mm.push((tip_mm + self.laser_mm + moved_mm) as f32);
        seen_mm + moved_mm
    }
}

/// The highest pressure in the muscle and the highest output, for whoever looks at limits.
#[derive(Clone, Copy, Debug, Default)]
pub struct Peaks {
    /// In the muscle, bar.
    pub pressure_bar: f64,
    /// To the valve, microbar.
    pub output_ubar: i32,
}

struct Watch(Rc<RefCell<Peaks>>);

impl Observer for Watch {
    fn see(&mut self, record: &TickRecord<'_>, hardware: &Hardware) {
        let mut peaks = self.0.borrow_mut();
        peaks.pressure_bar = hardware.peak_bar();
        if let TickRecord::Tick { outputs, .. } = record {
            peaks.output_ubar = peaks.output_ubar.max(outputs.output_ubar);
        }
    }
}

/// A session on the drifting rig.
pub struct Session<'a> {
    /// Seed of rig and references.
    pub seed: u64,
    /// What the controllers were tuned to.
    pub tuned: &'a Tuned,
    /// The controller's name.
    pub controller: &'a str,
    /// Settings on top of the tuned ones.
    pub settings: &'a [(u16, SettingValue)],
    /// The drift.
    pub drift: Drift,
    /// Where the tip shall go.
    pub points_mm: &'a [f64],
    /// What breaks, between two times of the run, s.
    pub breakages: &'a [(f64, f64, Breakage)],
}

/// What a session gave.
pub struct Outcome {
    /// Every sample from the first point on, with its time since then, s.
    pub samples: Vec<(f64, Telemetry)>,
    /// Time, s, and estimate less reference and less true tip over the estimate's window, mm.
    pub errors_mm: Vec<(f64, [f64; 2])>,
    /// What adaptation learned.
    pub report: AdaptationReport,
    /// What pressure there was.
    pub peaks: Peaks,
}

/// Tunes to a rig as it was before its drift.
///
/// # Panics
/// When tuning fails.
#[must_use]
pub fn tuned(seed: u64) -> Tuned {
    compare::tune_virtual_rig(seed, TUNING_SEED).expect("the rig can be tuned").0
}

/// The laser sees nothing.
#[must_use]
pub fn laser_lost() -> Breakage {
    Breakage::LaserCode(LASER_FAULT_CODE)
}

/// Adaptation switched on, and going on without the laser allowed.
#[must_use]
pub fn adapting() -> SettingValues {
    vec![setting("laser.required", SettingValue::Flag(false)), setting("adaptation.enabled", SettingValue::Flag(true))]
}

/// Moves of three kinds, 20 s each and as long a hold after each, for so many seconds.
#[must_use]
pub fn moves_and_holds(reach: Reach, seed: u64, seconds: f64) -> Vec<f64> {
    let mut points_mm: Vec<f64> = Vec::new();
    for part in 0.. {
        let name = ["point-to-point", "a", "hand"][part % 3];
        points_mm.extend(named(name, reach, seed + 1000 + part as u64).expect("its name").points_mm);
        let last_mm = points_mm.last().copied().unwrap_or(reach.low_mm);
        points_mm.extend(std::iter::repeat_n(last_mm, (20.0 / PERIOD_S) as usize));
        if points_mm.len() as f64 * PERIOD_S >= seconds {
            break;
        }
    }
    points_mm.truncate((seconds / PERIOD_S) as usize);
    points_mm
}

/// Runs a session.
///
/// # Panics
/// When the device refuses or vents.
#[must_use]
pub fn session(session: &Session<'_>) -> Outcome {
    let positions = Arc::new(Mutex::new(Positions::default()));
    let rig = RealisticRig::new(session.seed, 1);
    let rig = Drifting { rig, drift: session.drift, ticks: 0.0, laser_mm: 0.0, positions: Arc::clone(&positions) };
    // The rig has its own valve, tube and tip: what the hardware adds is the regulator's electronics.
    let config = HardwareConfig { regulator_ms: 5.0, tip_ms: 1.0, seed: session.seed as u32 ^ 0x5eed, ..HardwareConfig::default() };
    let hardware = Hardware::new(config, Box::new(rig));
    // The hardware's start is a step of the muscle.
    *positions.lock().expect("one thread") = Positions::default();
    let peaks = Rc::new(RefCell::new(Peaks::default()));
    let processor = InProcess::new(FlashMemory::default());
    let lockstep = Lockstep::new(processor, hardware, Watch(Rc::clone(&peaks)), "the drifting rig", "virtual").expect("it starts");
    let mut client = Client::connect(lockstep).expect("it answers");
    let controller = controller(session.controller).expect("its name");
    let mut settings = rig_settings();
    settings.extend(session.tuned.settings(controller));
    settings.push(setting("telemetry.period_ms", SettingValue::Integer(100)));
    settings.extend(session.settings);
    run::prepare(&mut client, &settings, Some(&session.tuned.blob)).expect("it takes them");
    let mut begin_ms = None;
    let breakages = session.breakages;
    let telemetry = run::run(&mut client, session.points_mm, &mut |rig, sample| {
        if sample.playback_index == 0 {
            return;
        }
        let time_s = (sample.time_ms - *begin_ms.get_or_insert(sample.time_ms)) as f64 * 1e-3;
        let now = breakages.iter().find(|(from_s, to_s, _)| (*from_s..*to_s).contains(&time_s)).map(|breakage| breakage.2);
        if rig.hardware().breakage() != now {
            rig.hardware().set_breakage(now);
        }
    });
    let telemetry = telemetry.unwrap_or_else(|error| panic!("seed {}: {error}", session.seed));
    let Reply::AdaptationReport(report) = client.request(&Request::AdaptationReport).expect("it answers") else { panic!("a report") };
    let begin_ms = telemetry[0].time_ms;
    let samples: Vec<(f64, Telemetry)> = telemetry.iter().map(|sample| ((sample.time_ms - begin_ms) as f64 * 1e-3, *sample)).collect();
    let positions = positions.lock().expect("one thread");
    let errors_mm = samples
        .iter()
        .filter_map(|(time_s, sample)| {
            // The estimate in force is that of the window before the one that ends with this sample.
            let end = sample.time_ms as usize - WINDOW_TICKS;
            let mean = |tips: &[f32]| {
                let window = tips.get(end - WINDOW_TICKS..end)?;
                Some(window.iter().map(|tip| f64::from(*tip)).sum::<f64>() / WINDOW_TICKS as f64)
            };
            let estimate_mm = f64::from(sample.estimate_mm?);
            Some((*time_s, [estimate_mm - mean(&positions.seen_mm)?, estimate_mm - mean(&positions.true_mm)?]))
        })
        .collect();
    let peaks = *peaks.borrow();
    Outcome { samples, errors_mm, report, peaks }
}

/// Errors of the estimate, share of the stroke.
#[derive(Clone, Copy, Debug)]
pub struct Errors {
    /// Root mean square against the reference.
    pub rms: f64,
    /// Mean against the reference.
    pub mean: f64,
    /// 95 % are not larger.
    pub most: f64,
    /// Root mean square against the true tip.
    pub true_rms: f64,
}

impl Outcome {
    /// Errors between two times, share of the stroke.
    #[must_use]
    pub fn error(&self, from_s: f64, to_s: f64) -> Errors {
        let chosen = self.errors_mm.iter().filter(|(time_s, _)| (from_s..to_s).contains(time_s));
        let errors: Vec<[f64; 2]> = chosen.map(|(_, errors)| errors.map(|error| error / STROKE_MM)).collect();
        let count = errors.len() as f64;
        let rms = |which: usize| (errors.iter().map(|error| error[which] * error[which]).sum::<f64>() / count).sqrt();
        let mut sizes: Vec<f64> = errors.iter().map(|error| error[0].abs()).collect();
        sizes.sort_by(f64::total_cmp);
        Errors {
            rms: rms(0),
            mean: errors.iter().map(|error| error[0]).sum::<f64>() / count,
            most: sizes[sizes.len() * 95 / 100],
            true_rms: rms(1),
        }
    }
}
