//! The figures of the controllers, all in one run on the all-effects rig: what each buys against the simpler one, side by side.
//!
//! Every seed is a rig of its own, tuned on recordings from its session 0 with references that occur nowhere else; the figures come from
//! session 1 with the references of [`super::reference::named`].

use model_export::link::settings::SettingValue;
use serde::Serialize;

use super::compare::{self, CompareError, Run, run_one};
use super::reference::{NAMES, Reference, named, tuning};
use super::{Controller, controller, rig, rig_settings, run, setting};
use crate::link::Breakage;
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
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value * value, count + 1.0));
    (sum / f64::max(count, 1.0)).sqrt()
}

/// Runs everything.
///
/// # Errors
/// When a run fails.
pub fn table(seeds: &[u64], long_run_s: f64, progress: &mut dyn FnMut(&str)) -> Result<Table, CompareError> {
    let mut rows = Vec::new();
    let (mut long, mut drift, mut lost) = (Vec::new(), Vec::new(), 0.0_f64);
    for &seed in seeds {
        progress(&format!("seed {seed}: tuning"));
        let (mut tuned, _) = compare::tune_virtual_rig(seed, TUNING_SEED)?;
        best_pid(&mut tuned, seed)?;
        for name in NAMES {
            progress(&format!("seed {seed}: {name}"));
            let Some(reference) = named(name, tuned.reach, seed) else { continue };
            let all = ["open-loop", "pi-inverse", "physics-inverse", "pid", "physics-inverse+pid", "sensorless"];
            let controllers: Vec<Controller> = all.iter().filter_map(|name| controller(name)).collect();
            for run in compare::on_the_virtual_rig(&tuned, seed, &reference, &controllers)? {
                let figures = run.figures;
                rows.push(Row {
                    seed,
                    reference: name.to_owned(),
                    controller: figures.name,
                    rmse_mm: figures.rmse_mm,
                    max_mm: figures.max_mm,
                });
            }
        }
        progress(&format!("seed {seed}: the laser is lost in mid-motion"));
        lost = lost.max(laser_lost(&tuned, seed)?);
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
        laser_lost_share: lost / STROKE_MM,
        rows,
    })
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
    while points_mm.len() as f64 * super::reference::PERIOD_S < seconds {
        let name = ["point-to-point", "a", "hand"][part % 3];
        let moves = named(name, tuned.reach, seed + 1000 + part as u64).map_or_else(Vec::new, |reference| reference.points_mm);
        let last_mm = moves.last().copied().unwrap_or(tuned.reach.low_mm);
        points_mm.extend(moves);
        let hold_s = if part % 4 == 3 { 600.0 } else { 60.0 };
        points_mm.extend(std::iter::repeat_n(last_mm, (hold_s / super::reference::PERIOD_S) as usize));
        part += 1;
    }
    points_mm.truncate((seconds / super::reference::PERIOD_S) as usize);
    let reference = Reference { name: "long".to_owned(), points_mm };
    let Some(sensorless) = controller("sensorless") else { return Err(CompareError::NoController) };
    let (mut client, truth) = rig::in_process(seed, 1)?;
    let mut settings = rig_settings();
    settings.extend(tuned.settings(sensorless));
    settings.push(setting("telemetry.period_ms", SettingValue::Integer(100)));
    run_one(&mut client, &truth, &settings, Some(&tuned.blob), sensorless, &reference)
}

/// Largest difference of the tip, mm, between a run in which the laser fails in mid-motion and the same run in which it does not.
fn laser_lost(tuned: &Tuned, seed: u64) -> Result<f64, CompareError> {
    let Some(both) = controller("physics-inverse+pid") else { return Err(CompareError::NoController) };
    let Some(reference) = named("a", tuned.reach, seed) else { return Err(CompareError::NoController) };
    let tips = |fails: bool| -> Result<Vec<(u64, f64)>, CompareError> {
        let (mut client, truth) = rig::in_process(seed, 1)?;
        let mut settings = rig_settings();
        settings.extend(tuned.settings(both));
        settings.push(setting("laser.required", SettingValue::Flag(false)));
        run::prepare(&mut client, &settings, Some(&tuned.blob))?;
        let mut begin_ms = None;
        let telemetry = run::run(&mut client, &reference.points_mm, &mut |rig, sample| {
            if sample.playback_index == 0 {
                return;
            }
            let begin_ms = *begin_ms.get_or_insert(sample.time_ms);
            let hardware = rig.hardware();
            if fails && sample.time_ms >= begin_ms + LOST_MS && hardware.breakage().is_none() {
                hardware.set_breakage(Some(Breakage::LaserCode(LASER_FAULT_CODE)));
            }
        })?;
        Ok(telemetry.iter().filter_map(|sample| Some((sample.time_ms, truth.tip_mm(sample.time_ms)?))).collect())
    };
    let (with, without) = (tips(false)?, tips(true)?);
    let begin_ms = with.first().map_or(0, |sample| sample.0);
    let within = with.iter().zip(&without).filter(|(sample, _)| (LOST_MS..LOST_MS + 1100).contains(&(sample.0 - begin_ms)));
    Ok(within.map(|(a, b)| (a.1 - b.1).abs()).fold(0.0, f64::max))
}

/// When the laser fails, ms after the first point: in the middle of a stroke.
const LOST_MS: u64 = 6300;

#[cfg(test)]
mod tests {
    use super::*;

    /// A seed of rigs that neither tuning nor reports use.
    const SEED: u64 = 601;

    #[test]
    fn on_a_rig_with_all_effects_each_step_up_buys_what_it_should_and_a_lost_laser_moves_nothing() {
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
        let lost_mm = laser_lost(&tuned, SEED).unwrap();
        assert!(lost_mm > 0.0 && lost_mm < 0.01 * STROKE_MM, "{lost_mm} mm");
    }
}
