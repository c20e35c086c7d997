//! The figures of the controllers, all in one run on the realistic rig: what each buys against the simpler one, side by side.
//!
//! Every seed is a rig of its own, tuned on recordings from its session 0 with references that occur nowhere else; the figures come from
//! session 1 with the references of [`crate::control::reference::named`].

use model_export::link::settings::SettingValue;
use serde::Serialize;

use super::compare::{self, CompareError, Run, run_one};
use super::rig::{self, Mover};
use super::{learn, run};
use crate::control::reference::{NAMES, PERIOD_S, Reference, named, tuning};
use crate::control::{Controller, controller, setting};
use crate::link::Breakage;
use crate::recording::Recording;
use crate::rig::live::STROKE_MM;
use crate::tune::Tuned;

/// Seed of the references that gains are found on, far from those of reports.
const TUNING_SEED: u64 = 41;
/// The paper's families, 0.2 to 0.8 Hz.
const FAMILIES: [&str; 4] = ["a", "b", "c", "d"];
/// Factors on the proposed gains of the PID alone, tried on the rig itself, so that it is judged at its best.
const FACTORS: [f64; 5] = [0.5, 1.0, 1.6, 2.5, 4.0];
/// The code that the laser gives when it sees nothing: 3.75 mA.
const LASER_FAULT_CODE: u16 = 1396;

/// One reference followed by one controller.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Seed of rig and reference.
    pub seed: u64,
    /// The reference.
    pub reference: String,
    /// The controller.
    pub controller: String,
    /// Tracking error, mm.
    pub rmse_mm: f64,
    /// Largest tracking error, mm.
    pub max_mm: f64,
}

/// The table.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    /// Every run.
    pub rows: Vec<Row>,
    /// Share by which the tracking error of the physics inverse lies below the open loop's, moving references, no laser.
    pub feed_forward_gain: f64,
    /// The same for random point-to-point, sensorless.
    pub point_to_point_gain: f64,
    /// Share by which physics inverse with laser lies below the best PID alone, 0.2 to 0.8 Hz.
    pub feedback_gain: f64,
    /// Root mean square error of the sensorless estimate over the long run, share of the stroke.
    pub estimate_rmse_share: f64,
    /// Mean error in the last tenth of the long run less that in the first, share of the stroke.
    pub estimate_drift_share: f64,
    /// Length of the long run, s.
    pub long_run_s: f64,
    /// Largest difference that losing the laser in mid-motion makes to the tip within a second, share of the stroke.
    pub laser_lost_share: f64,
    /// Ticks of that second in which the output was at zero, the ceiling, or the slew limit, over all rigs.
    pub laser_lost_limited_ticks: usize,
    /// The same in the runs in which the laser was not lost.
    pub laser_kept_limited_ticks: usize,
    /// Fastest output in that second, share of the slew limit.
    pub laser_lost_slew_share: f64,
    /// What networks do; absent when none was trained.
    pub learned: Option<LearnedFigures>,
}

/// What networks do in the place of the physics.
#[derive(Clone, Debug, Serialize)]
pub struct LearnedFigures {
    /// Nominal CPU time of each training, s.
    pub cpu_s: f64,
    /// Share by which the tracking error of the learned inverse lies below the open loop's, moving references, no laser.
    pub feed_forward_gain: f64,
    /// Share by which `sensorless` with a network's estimate lies below the open loop, random point-to-point.
    pub point_to_point_gain: f64,
    /// Largest root mean square error of that estimate on a moving reference, share of the stroke.
    pub estimate_rmse_share: f64,
}

/// What to run.
#[derive(Clone, Copy, Debug)]
pub struct BenchConfig<'a> {
    /// Seeds of the rigs.
    pub seeds: &'a [u64],
    /// Length of the run without the laser, s.
    pub long_run_s: f64,
    /// Nominal CPU time for each of the two networks of a rig, s; 0 trains none.
    pub learned_cpu_s: f64,
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value * value, count + 1.0));
    (sum / f64::max(count, 1.0)).sqrt()
}

/// Runs everything.
///
/// # Errors
/// When a run fails.
pub fn table(config: &BenchConfig<'_>, progress: &mut dyn FnMut(&str)) -> Result<Table, CompareError> {
    let BenchConfig { seeds, long_run_s, learned_cpu_s } = *config;
    let mut rows = Vec::new();
    let (mut long, mut drift, mut lost) = (Vec::new(), Vec::new(), LaserLost::default());
    let mut estimate_rmse_mm = 0.0_f64;
    for &seed in seeds {
        progress(&format!("seed {seed}: tuning"));
        let (mut tuned, recordings) = compare::tune_virtual_rig(seed, TUNING_SEED)?;
        best_pid(&mut tuned, seed)?;
        for name in NAMES {
            progress(&format!("seed {seed}: {name}"));
            let Some(reference) = named(name, tuned.reach, seed) else { continue };
            let all = ["open-loop", "pi-inverse", "physics-inverse", "pid", "physics-inverse+pid", "sensorless"];
            let controllers: Vec<Controller> = all.iter().filter_map(|name| controller(name)).collect();
            rows.extend(compare::on_the_virtual_rig(&tuned, seed, &reference, &controllers)?.iter().map(|run| row(seed, name, run)));
        }
        if learned_cpu_s > 0.0 {
            progress(&format!("seed {seed}: training networks"));
            let runs = with_networks(&tuned, &recordings, seed, learned_cpu_s)?;
            let estimates = runs.iter().filter(|(name, run)| *name != "steps" && run.figures.name == NETWORK_SENSORLESS);
            let errors_mm = estimates.filter_map(|(_, run)| run.figures.estimate_rmse_mm);
            estimate_rmse_mm = errors_mm.fold(estimate_rmse_mm, f64::max);
            rows.extend(runs.iter().map(|(name, run)| row(seed, name, run)));
        }
        progress(&format!("seed {seed}: the laser is lost in mid-motion"));
        lost = lost.worse(laser_lost(&tuned, seed)?);
        progress(&format!("seed {seed}: {long_run_s} s without the laser"));
        let run = long_run(&tuned, seed, long_run_s)?;
        let errors: Vec<f64> = run.samples.iter().filter_map(|sample| sample.estimate_error_mm).collect();
        let tenth = errors.len() / 10;
        let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len().max(1) as f64;
        drift.push(mean(&errors[errors.len() - tenth..]) - mean(&errors[..tenth]));
        long.push(rms(errors.into_iter()));
    }
    let of = |controller: &str, references: &[&str]| {
        let chosen = rows.iter().filter(|row| row.controller == controller && references.contains(&row.reference.as_str()));
        rms(chosen.map(|row| row.rmse_mm))
    };
    let moving = ["a", "b", "c", "d", "point-to-point", "hand"];
    Ok(Table {
        feed_forward_gain: 1.0 - of("physics-inverse", &moving) / of("open-loop", &moving),
        point_to_point_gain: 1.0 - of("sensorless", &["point-to-point"]) / of("open-loop", &["point-to-point"]),
        feedback_gain: 1.0 - of("physics-inverse+pid", &FAMILIES) / of("pid", &FAMILIES),
        estimate_rmse_share: long.iter().copied().fold(0.0, f64::max) / STROKE_MM,
        estimate_drift_share: drift.iter().copied().map(f64::abs).fold(0.0, f64::max) / STROKE_MM,
        long_run_s,
        laser_lost_share: lost.moved_mm / STROKE_MM,
        laser_lost_limited_ticks: lost.limited_ticks,
        laser_kept_limited_ticks: lost.kept_limited_ticks,
        laser_lost_slew_share: lost.slew_share,
        learned: (learned_cpu_s > 0.0).then(|| LearnedFigures {
            cpu_s: learned_cpu_s,
            feed_forward_gain: 1.0 - of("learned-inverse", &moving) / of("open-loop", &moving),
            point_to_point_gain: 1.0 - of(NETWORK_SENSORLESS, &["point-to-point"]) / of("open-loop", &["point-to-point"]),
            estimate_rmse_share: estimate_rmse_mm / STROKE_MM,
        }),
        rows,
    })
}

/// `sensorless` on the estimate of a network.
const NETWORK_SENSORLESS: &str = "sensorless, network";

fn row(seed: u64, reference: &str, run: &Run) -> Row {
    let figures = &run.figures;
    Row { seed, reference: reference.to_owned(), controller: figures.name.clone(), rmse_mm: figures.rmse_mm, max_mm: figures.max_mm }
}

/// Every reference followed by a learned inverse, and by `sensorless` on a network's estimate.
fn with_networks(tuned: &Tuned, recordings: &[Recording], seed: u64, cpu_s: f64) -> Result<Vec<(&'static str, Run)>, CompareError> {
    let (Some(inverse), Some(sensorless)) = (controller("learned-inverse"), controller("sensorless")) else {
        return Err(CompareError::NoController);
    };
    let networks = [
        (inverse, learn::inverse(tuned, recordings, cpu_s, TUNING_SEED)?),
        (Controller { name: NETWORK_SENSORLESS, ..sensorless }, learn::estimator(tuned, recordings, cpu_s, TUNING_SEED)?),
    ];
    let mut runs = Vec::new();
    for name in NAMES {
        let Some(reference) = named(name, tuned.reach, seed) else { continue };
        for (controller, network) in &networks {
            runs.push((name, compare::with_model(tuned, seed, &reference, *controller, &network.blob, &network.settings)?));
        }
    }
    Ok(runs)
}

/// Gains of the PID alone that do best on the rig itself, around those proposed: the adversary shall not be a weak one.
fn best_pid(tuned: &mut Tuned, seed: u64) -> Result<(), CompareError> {
    let reference = tuning(tuned.reach, TUNING_SEED);
    let Some(pid) = controller("pid") else { return Ok(()) };
    let proposed = tuned.alone;
    let mut best = (f64::INFINITY, proposed);
    for proportional in FACTORS {
        for integral in FACTORS {
            let mut trial = tuned.clone();
            trial.alone.proportional = proposed.proportional * proportional;
            trial.alone.integral_per_s = proposed.integral_per_s * integral;
            // Gains beyond those proposed may bring the device to vent: no good then.
            let runs = compare::on_the_virtual_rig(&trial, seed, &reference, &[pid]).unwrap_or_default();
            let error_mm = runs.first().map_or(f64::INFINITY, |run| run.figures.rmse_mm);
            if error_mm < best.0 {
                best = (error_mm, trial.alone);
            }
        }
    }
    tuned.alone = best.1;
    Ok(())
}

/// A long time without the laser: moves, and holds of up to ten minutes.
fn long_run(tuned: &Tuned, seed: u64, seconds: f64) -> Result<Run, CompareError> {
    let mut points_mm: Vec<f64> = Vec::new();
    let mut part = 0;
    while points_mm.len() as f64 * PERIOD_S < seconds {
        let name = ["point-to-point", "a", "hand"][part % 3];
        let moves = named(name, tuned.reach, seed + 1000 + part as u64).map_or_else(Vec::new, |reference| reference.points_mm);
        let last_mm = moves.last().copied().unwrap_or(tuned.reach.low_mm);
        points_mm.extend(moves);
        let hold_s = if part % 4 == 3 { 600.0 } else { 60.0 };
        points_mm.extend(std::iter::repeat_n(last_mm, (hold_s / PERIOD_S) as usize));
        part += 1;
    }
    points_mm.truncate((seconds / PERIOD_S) as usize);
    let reference = Reference { name: "long".to_owned(), points_mm };
    let Some(sensorless) = controller("sensorless") else { return Err(CompareError::NoController) };
    let (mut client, truth) = rig::in_process(&Mover::Realistic, seed, 1)?;
    let mut settings = rig::rig_settings();
    settings.extend(tuned.settings(sensorless));
    settings.push(setting("telemetry.period_ms", SettingValue::Integer(100)));
    run_one(&mut client, &truth, &settings, Some(&tuned.blob), sensorless, &reference)
}

/// What losing the laser does within [`WATCHED_MS`].
#[derive(Clone, Copy, Debug, Default)]
struct LaserLost {
    /// Largest difference of the tip, mm.
    moved_mm: f64,
    /// Ticks with the output at zero, the ceiling or the slew limit.
    limited_ticks: usize,
    /// The same where the laser is not lost.
    kept_limited_ticks: usize,
    /// Fastest output, share of the slew limit.
    slew_share: f64,
}

impl LaserLost {
    fn worse(self, other: Self) -> Self {
        Self {
            moved_mm: self.moved_mm.max(other.moved_mm),
            limited_ticks: self.limited_ticks + other.limited_ticks,
            kept_limited_ticks: self.kept_limited_ticks + other.kept_limited_ticks,
            slew_share: self.slew_share.max(other.slew_share),
        }
    }
}

/// How long a lost laser is watched, ms: the fault is found within some milliseconds, and a second is long for a jump.
const WATCHED_MS: usize = 1100;
/// The laser is not lost before this, s.
const NOT_BEFORE_S: f64 = 5.0;

/// The tip, mm, and the output, microbar, of every tick from the laser's failure on.
struct Watched {
    tips_mm: Vec<f64>,
    outputs_ubar: Vec<i32>,
}

impl Watched {
    /// Steps of the output as shares of the slew limit, with what they lead to.
    fn steps(&self) -> impl Iterator<Item = (f64, i32)> {
        let limit_ubar = f64::from(compare::RIG_LIMITS.slew_bar_per_s) * 1e3;
        self.outputs_ubar.windows(2).map(move |pair| (f64::from(pair[1] - pair[0]).abs() / limit_ubar, pair[1]))
    }

    /// Ticks at a limit, as what went to the valve shows it: not what the limiter says of itself.
    fn limited_ticks(&self) -> usize {
        let ceiling_ubar = (f64::from(compare::RIG_LIMITS.ceiling_bar) * 1e6) as i32;
        // An output has a resolution of one microbar, of 40,000 in a step at the limit.
        self.steps().filter(|(share, output_ubar)| *share > 0.9999 || *output_ubar >= ceiling_ubar - 1 || *output_ubar <= 0).count()
    }
}

/// A run in which the laser fails in mid-motion, on the way up through the middle of a stroke, beside the same run in which it does not.
fn laser_lost(tuned: &Tuned, seed: u64) -> Result<LaserLost, CompareError> {
    let Some(both) = controller("physics-inverse+pid") else { return Err(CompareError::NoController) };
    let Some(reference) = named("a", tuned.reach, seed) else { return Err(CompareError::NoController) };
    let points_mm = &reference.points_mm;
    let first = (NOT_BEFORE_S / PERIOD_S) as usize;
    let (low, high) = points_mm[first..].iter().fold((f64::MAX, f64::MIN), |(low, high), point| (low.min(*point), high.max(*point)));
    let middle_mm = 0.5 * (low + high);
    let upward = (first + 1..points_mm.len()).find(|at| points_mm[at - 1] < middle_mm && points_mm[*at] >= middle_mm);
    let lost_ms = (upward.unwrap_or(first) as f64 * PERIOD_S * 1e3) as u64;
    let watched = |fails: bool| -> Result<Watched, CompareError> {
        let (mut client, truth) = rig::in_process(&Mover::Realistic, seed, 1)?;
        let mut settings = rig::rig_settings();
        settings.extend(tuned.settings(both));
        settings.push(setting("laser.required", SettingValue::Flag(false)));
        run::prepare(&mut client, &settings, Some(&tuned.blob))?;
        let mut begin_ms = None;
        run::run(&mut client, points_mm, &mut |rig, sample| {
            if sample.playback_index == 0 {
                return;
            }
            let begin_ms = *begin_ms.get_or_insert(sample.time_ms);
            let hardware = rig.hardware();
            if fails && sample.time_ms >= begin_ms + lost_ms && hardware.breakage().is_none() {
                hardware.set_breakage(Some(Breakage::LaserCode(LASER_FAULT_CODE)));
            }
        })?;
        let from_ms = begin_ms.unwrap_or(0) + lost_ms;
        let tips_mm = (from_ms..from_ms + WATCHED_MS as u64).filter_map(|time_ms| truth.tip_mm(time_ms)).collect();
        Ok(Watched { tips_mm, outputs_ubar: truth.outputs_from(from_ms).into_iter().take(WATCHED_MS).collect() })
    };
    let (kept, lost) = (watched(false)?, watched(true)?);
    Ok(LaserLost {
        moved_mm: kept.tips_mm.iter().zip(&lost.tips_mm).map(|(kept, lost)| (kept - lost).abs()).fold(0.0, f64::max),
        limited_ticks: lost.limited_ticks(),
        kept_limited_ticks: kept.limited_ticks(),
        slew_share: lost.steps().map(|step| step.0).fold(0.0, f64::max),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A seed of rigs that neither tuning nor reports use.
    const SEED: u64 = 601;

    #[test]
    fn on_a_realistic_rig_each_step_up_buys_what_it_should_and_a_lost_laser_moves_nothing() {
        let tuned = compare::tune_virtual_rig(SEED, TUNING_SEED).unwrap().0;
        let errors = |name: &str, controllers: &[&str]| -> Vec<f64> {
            let reference = named(name, tuned.reach, SEED).unwrap();
            let controllers: Vec<Controller> = controllers.iter().filter_map(|name| controller(name)).collect();
            let runs = compare::on_the_virtual_rig(&tuned, SEED, &reference, &controllers).unwrap();
            runs.iter().map(|run| run.figures.rmse_mm).collect()
        };
        let sine = errors("a", &["open-loop", "physics-inverse", "pid", "physics-inverse+pid"]);
        assert!(sine[1] < 0.15 * sine[0], "feed-forward against open loop: {sine:?} mm");
        assert!(sine[3] < 0.4 * sine[2], "with the laser against the PID alone: {sine:?} mm");
        let moves = errors("point-to-point", &["open-loop", "sensorless"]);
        assert!(moves[1] < 0.25 * moves[0], "sensorless point-to-point: {moves:?} mm");
        let lost = laser_lost(&tuned, SEED).unwrap();
        assert!(lost.moved_mm > 0.0 && lost.moved_mm < 0.01 * STROKE_MM, "{lost:?}");
        // The way up through the middle of a stroke is within all limits, with the laser and without.
        assert!(lost.limited_ticks == 0 && lost.kept_limited_ticks == 0, "{lost:?}");
        assert!(lost.slew_share > 0.01 && lost.slew_share < 0.9, "{lost:?}");
    }
}
