//! The part of a discovered model that the microcontroller can run: play operators behind dead time and lag, with creep.
//!
//! The blob's front end knows these and no more (see `model_export::schema::FrontEnd`). What drifts with the session's time (drift of zero
//! and gain, a change of set-up) goes into weights and constant as it was when the session ended: that is the rig as it is now. A skew of
//! the clocks belongs to the recordings, not to the rig, and is left out. A model with any other effect stays on the desktop;
//! [`physics_model`] then says which effect it is.

use crate::physics::{ChannelRange, CreepFilters, InputPath, Kind, PhysicsModel, Provenance, Source};
use recording::{Recording, Signal};

use discovery::effects::creep::TIMES_S;
use discovery::file::DiscoveredModel;

/// Whether a lag is so fast that the samples cannot tell it from a delay of the same length.
fn is_a_delay(time_constant_s: f64, sample_period_s: f64) -> bool {
    time_constant_s < sample_period_s
}

/// The physics model for `catheter export`.
///
/// # Errors
/// With the name and the form of the first effect that the microcontroller does not know.
pub fn physics_model(model: &DiscoveredModel, recordings: &[Recording]) -> Result<PhysicsModel, String> {
    let mut input_path = InputPath::default();
    let mut creep = CreepFilters::default();
    let (mut scale, mut shift) = (1.0, 0.0);
    for effect in &model.effects {
        match (effect.name.as_str(), effect.form.as_str()) {
            ("dead-time", _) => input_path.dead_time_s += effect.normalised[0],
            ("pneumatic-lag", "before" | "before the hysteresis") => {
                input_path.lag_time_constant_s = effect.normalised[0];
                // Found with straight lines between samples, run with steps there: these arrive half a sample earlier.
                input_path.dead_time_s += 0.5 * model.sample_period_s;
            }
            ("pneumatic-lag", "two-before" | "two in a row before the hysteresis")
                if is_a_delay(effect.normalised[1], model.sample_period_s) =>
            {
                input_path.lag_time_constant_s = effect.normalised[0];
                input_path.dead_time_s += effect.normalised[1] + 0.5 * model.sample_period_s;
            }
            ("creep", form) if form.starts_with("of-the-displacement") || form.starts_with("of the displacement") => {
                let active = TIMES_S.iter().zip(&effect.weights).filter(|(_, weight)| **weight > 0.0);
                (creep.time_constants_s, creep.gains) = active.map(|(time_s, weight)| (*time_s, *weight)).unzip();
            }
            ("offset-drift" | "gain-drift" | "setup-change", _) => {
                let (gain, offset) = model.at_the_end(effect)?;
                (scale, shift) = (scale * gain, shift * gain + offset);
            }
            ("clock-skew", _) => {}
            (name, form) => return Err(format!("{name} ({form})")),
        }
    }
    let gain = scale * model.output_scale / model.input_scale;
    let active = || model.thresholds.iter().zip(&model.weights).filter(|(_, weight)| **weight != 0.0);
    let thresholds: Vec<f64> = active().map(|(threshold, _)| threshold * model.input_scale).collect();
    // A stop is what a play lacks to the input.
    let sign = if model.stops { -1.0 } else { 1.0 };
    let mut weights: Vec<f64> = active().map(|(_, weight)| sign * weight * gain).collect();
    let mut input_gain = 0.0;
    if model.stops {
        // The first operator is the input itself, the others are the input less their plays.
        input_gain = gain * model.weights.iter().sum::<f64>();
        for (weight, threshold) in weights.iter_mut().zip(&thresholds) {
            if *threshold == 0.0 {
                *weight = 0.0;
            }
        }
    }
    let extent = |signal: &Signal, values: &dyn Fn(&Recording) -> Vec<f64>| {
        let all = recordings.iter().flat_map(|recording| values(recording).into_iter());
        let (minimum, maximum) = all.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
        ChannelRange { quantity: signal.quantity.clone(), unit: signal.unit.clone(), minimum, maximum }
    };
    let output = extent(&model.output, &|recording| recording.output.clone());
    let source = |recording: &Recording| Source {
        file: recording.path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
        sha256: recording.sha256.clone(),
        samples: recording.len(),
    };
    Ok(PhysicsModel {
        format_version: crate::physics::FORMAT_VERSION,
        kind: Kind::PrandtlIshlinskii,
        sample_period_s: model.sample_period_s,
        rest_input: model.input_offset,
        thresholds,
        weights,
        input_gain,
        constant: (model.constant + shift) * model.output_scale,
        thresholds_95: Vec::new(),
        weights_95: Vec::new(),
        constant_95: None,
        input: extent(&model.input, &|recording| recording.input.clone()),
        input_path,
        curve: None,
        creep,
        provenance: Provenance {
            program: model.origin.program.clone(),
            method: "catheter discover".to_owned(),
            rmse: model.origin.rmse,
            nrmse: model.origin.rmse / (output.maximum - output.minimum),
            samples: recordings.iter().map(Recording::len).sum(),
            data: recordings.iter().map(source).collect(),
        },
        expected: None,
        nuisances: Vec::new(),
        output,
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::path::Path;

    use super::*;
    use discovery::file::{EffectEntry, KIND, Origin, VERSION};

    fn entry(name: &str, form: &str, normalised: &[f64], weights: &[f64]) -> EffectEntry {
        EffectEntry {
            name: name.into(),
            form: form.into(),
            definition: None,
            normalised: normalised.to_vec(),
            weights: weights.to_vec(),
            parameters: BTreeMap::new(),
            intervals: BTreeMap::new(),
        }
    }

    fn model(effects: Vec<EffectEntry>, stops: bool) -> DiscoveredModel {
        DiscoveredModel {
            kind: KIND.into(),
            version: VERSION,
            input: Signal::pressure_bar(),
            output: Signal::displacement_mm(),
            sample_period_s: 0.02,
            input_offset: 0.0,
            input_scale: 3.0,
            others: Vec::new(),
            output_scale: 12.0,
            session_s: 100.0,
            session_recordings: 4,
            session_origin_s: None,
            calibrate_s: None,
            stops,
            memory: Vec::new(),
            thresholds: vec![0.0, 0.1, 0.3],
            weights: vec![0.5, 0.3, 0.2],
            constant: 0.01,
            origin: Origin { program: String::new(), recordings: Vec::new(), rmse: 0.1, rmse_before: 0.2 },
            effects,
            session: Vec::new(),
        }
    }

    fn recording() -> Recording {
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        // Every stroke turns on a sample: the microcontroller samples a thousand times a second and looks for no turn between two.
        let stroke = |sample: i32| if (sample / 60) % 2 == 0 { sample % 60 } else { 60 - sample % 60 };
        let input: Vec<f64> = (0..1000).map(|sample| 3.0 * (-0.001 * f64::from(sample)).exp() * f64::from(stroke(sample)) / 60.0).collect();
        let output = input.iter().map(|value| 4.0 * value).collect();
        Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output).expect("a recording")
    }

    #[test]
    fn what_the_microcontroller_can_run_predicts_the_same() {
        let run = recording();
        let creep = entry("creep", "of the displacement", &[], &[0.05, 0.0, 0.04, 0.02]);
        let cases = [
            (vec![], false, 1e-9),
            (vec![], true, 1e-9),
            (vec![creep], false, 2e-2),
            // Nothing of these moves on in a run of 20 s that ends a session of 100 s, but the drift by 20 s in 600 s.
            (vec![entry("setup-change", "zero and gain step between two recordings", &[2.5], &[0.03, 0.08])], false, 1e-9),
            (vec![entry("offset-drift", "a smooth curve of the session's time", &[600.0], &[0.02, 0.0, 0.0, 0.0])], false, 1e-2),
            (vec![entry("gain-drift", "a smooth curve of the session's time", &[600.0], &[0.1, 0.0, 0.0, 0.0])], true, 5e-2),
            // Straight lines instead of a cubic between samples, steps instead of lines in the lag: hundredths of 12 mm.
            (vec![entry("dead-time", "constant", &[0.137], &[])], false, 4e-2),
            (vec![entry("pneumatic-lag", "before", &[0.15], &[])], false, 4e-2),
            // As files of earlier versions have it.
            (vec![entry("pneumatic-lag", "before the hysteresis", &[0.15], &[])], false, 4e-2),
            (vec![entry("pneumatic-lag", "two-before", &[0.15, 0.008], &[])], false, 4e-2),
        ];
        for (effects, stops, tolerance_mm) in cases {
            let model = model(effects, stops);
            let physics = physics_model(&model, std::slice::from_ref(&run)).expect("a physics model");
            physics.front_end().expect("a front end");
            let expected = model.simulate(&run.input).expect("a prediction");
            for (found, expected) in physics.simulate(&run.input).iter().zip(&expected) {
                assert!((found - expected).abs() < tolerance_mm, "{found} instead of {expected} with {:?}", model.effects);
            }
        }
    }

    #[test]
    fn a_model_from_a_file_keeps_its_memory_behind_a_lag() {
        let lagging = || model(vec![entry("pneumatic-lag", "before the hysteresis", &[0.15], &[])], false);
        let experienced = DiscoveredModel { memory: vec![0.0, 0.9, 0.4], ..lagging() };
        let first = |model: &DiscoveredModel| model.simulate(&[1.2; 50]).expect("a prediction")[0];
        // Of three operators the widest (0.3 of the span, weight 0.2) still stands where 0.9 of the span left it, half the span further
        // up, and the next (0.1, 0.3) at 0.5 instead of 0.3: 0.2 * 0.5 + 0.3 * 0.2 of 12 mm.
        let further_mm = first(&experienced) - first(&lagging());
        assert!((further_mm - 0.16 * 12.0).abs() < 1e-9, "{further_mm}");
    }

    #[test]
    fn an_effect_that_the_microcontroller_does_not_know_is_named() {
        let problem = physics_model(&model(vec![entry("resonance", "swinging tip", &[3.0, 0.1], &[])], false), &[recording()]);
        assert_eq!(problem.expect_err("no such stage"), "resonance (swinging tip)");
        let two = entry("pneumatic-lag", "two-before", &[0.15, 0.05], &[]);
        assert!(physics_model(&model(vec![two], false), &[recording()]).is_err(), "a second lag of 50 ms is no delay");
    }
}
