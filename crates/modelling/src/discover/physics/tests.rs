use std::collections::BTreeMap;
use std::path::Path;

use super::*;
use crate::export;
use discovery::file::{EffectEntry, KIND, Origin, VERSION};
use firmware::estimator::{Estimator, EstimatorState};

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

/// What the blob of a physics model gives, as the firmware runs it.
fn of_the_blob(physics: &PhysicsModel, run: &Recording) -> Vec<f64> {
    let trained = export::from_physics(physics).expect("a front end");
    let exported = export::export(&trained, std::slice::from_ref(run)).expect("a blob");
    let blob = model_export::blob::decode(&exported.bytes).expect("a blob");
    let estimator = Estimator::new(&blob.model).expect("an estimator");
    let mut state = EstimatorState::default();
    run.input.iter().map(|value| f64::from(estimator.step_all(&mut state, &[*value as f32]).value)).collect()
}

fn farthest(one: &[f64], other: &[f64]) -> f64 {
    one.iter().zip(other).map(|(one, other)| (one - other).abs()).fold(0.0, f64::max)
}

#[test]
fn what_the_microcontroller_can_run_predicts_the_same() {
    let run = recording();
    let one = |name, form, parameters: &[f64], weights: &[f64]| vec![entry(name, form, parameters, weights)];
    let rate = "rate-dependent-hysteresis";
    let asymmetry = "asymmetric-hysteresis";
    let curve = "static-nonlinearity";
    // Tolerances in mm of 12. What has the same equations on both sides has 1e-9. On a path that was smoothed the discovered model's operators
    // see turns between two samples: some micrometres, and more where a limit makes corners there.
    let cases = [
        (vec![], false, 1e-9),
        (vec![], true, 1e-9),
        (one("creep", "of-the-displacement", &[], &[0.0, 0.05, 0.0, 0.04, 0.02]), false, 2e-2),
        // Nothing of these moves on in a run of 20 s that ends a session of 100 s, but the drift by 20 s in 600 s.
        (one("setup-change", "one-step", &[2.5], &[0.03, 0.08]), false, 1e-9),
        (one("offset-drift", "smooth-curve", &[600.0], &[0.02, 0.0, 0.0, 0.0]), false, 1e-2),
        (one("gain-drift", "smooth-curve", &[600.0], &[0.1, 0.0, 0.0, 0.0]), true, 5e-2),
        // A straight line instead of a cubic between samples: hundredths of 12 mm.
        (one("dead-time", "constant", &[0.137], &[]), false, 4e-2),
        (one("pneumatic-lag", "before", &[0.15], &[]), false, 2e-3),
        (one("pneumatic-lag", "before-held", &[0.15], &[]), false, 2e-3),
        (one("pneumatic-lag", "two-before", &[0.158, 0.05], &[]), false, 2e-3),
        (one("pneumatic-lag", "two-before", &[0.2, 0.25], &[]), true, 2e-3),
        (one("pneumatic-lag", "behind", &[0.1], &[]), false, 1e-9),
        (one("pneumatic-lag", "two-behind", &[0.13, 0.23], &[]), false, 1e-9),
        (one("resonance", "pressure", &[3.0, 0.2], &[]), false, 2e-3),
        (one("resonance", "tip", &[2.0, 0.05], &[]), false, 1e-9),
        (one("resonance", "shaken-tip", &[4.0, 0.1], &[]), false, 1e-9),
        (one("resonance", "part-of-tip", &[3.0, 0.1, 0.4], &[]), false, 1e-9),
        (one("supply-saturation", "rounded", &[0.7, 0.001, 0.0], &[]), false, 3e-2),
        (one("supply-saturation", "rounded", &[0.6, 0.1, 0.1], &[]), true, 3e-2),
        (one("supply-saturation", "drooping", &[0.7, 20.0], &[]), false, 3e-2),
        (one("slew-limit", "one", &[0.5], &[]), false, 8e-2),
        (one("slew-limit", "two-sided-held", &[0.6, 0.4], &[]), false, 8e-2),
        (one("slew-limit", "lagging", &[0.5, 0.03, 1.0], &[]), false, 8e-2),
        (one("slew-limit", "lagging", &[0.6, 0.02, 0.8], &[]), true, 8e-2),
        (one("pneumatic-lag", "orifice", &[0.1, 0.6], &[]), false, 6e-2),
        (one("fill-vent-asymmetry", "orifices", &[0.05, 0.15, 0.7], &[]), false, 6e-2),
        (one("fill-vent-asymmetry", "by-error", &[0.05, 0.2], &[]), false, 1e-2),
        (one("fill-vent-asymmetry", "by-error-held", &[0.2, 0.05], &[]), false, 2e-3),
        (one("activation-threshold", "rounded", &[0.15, 0.04], &[]), false, 3e-2),
        (one("activation-threshold", "opens", &[0.15, 0.05], &[]), false, 6e-2),
        (one("activation-threshold", "of-the-displacement", &[0.2], &[0.8]), false, 3e-2),
        (one(curve, "input-cubic", &[0.4, -0.2, 0.1], &[]), false, 5e-2),
        (one(curve, "input-rational", &[1.7, 4.0], &[]), false, 1e-1),
        (one(curve, "output-cubic", &[], &[0.3, -0.2]), false, 5e-2),
        (one(curve, "output-logistic", &[8.0, 0.5], &[0.7]), false, 8e-2),
        (one(curve, "output-pieces", &[], &[0.2, -0.1, 0.3, 0.0, -0.5, 0.1, 0.2]), true, 3e-2),
        (one(asymmetry, "thresholds-grow", &[1.5], &[]), false, 1e-9),
        (one(asymmetry, "unloading-thresholds-grow", &[1.5], &[]), false, 1e-9),
        (one(asymmetry, "loading-thresholds-grow", &[-0.7], &[]), false, 1e-9),
        (one(asymmetry, "bend-apart", &[0.3], &[]), false, 1e-9),
        (one(asymmetry, "each-curves", &[0.3, -0.2, 0.1, 0.05, 0.1], &[]), false, 5e-2),
        (one(rate, "viscous", &[0.05, 0.0], &[]), false, 1e-9),
        (one(rate, "viscous-stiffening", &[0.5, 0.03], &[]), false, 1e-1),
        (one(rate, "overstress-fading", &[0.05, 0.04], &[]), false, 1e-9),
        // Where a stroke turns on a sample the discovered model takes the mean rate of both sides, which is none.
        (one(rate, "overstress-asinh", &[0.01, 0.2], &[]), false, 3e-1),
        (one(rate, "share-asinh", &[0.1, 0.2, 0.04], &[]), false, 3e-2),
        (
            vec![
                entry("slew-limit", "one", &[0.6], &[]),
                entry("pneumatic-lag", "before", &[0.05], &[]),
                entry("dead-time", "constant", &[0.04], &[]),
                entry(curve, "input-rational", &[1.3, 1.0], &[]),
                entry(asymmetry, "thresholds-grow", &[0.8], &[]),
                entry("creep", "of-the-displacement", &[], &[0.0, 0.05, 0.0, 0.04, 0.02]),
                entry(curve, "output-cubic", &[], &[0.2, -0.1]),
                entry("resonance", "tip", &[3.0, 0.1], &[]),
                entry("setup-change", "one-step", &[2.5], &[0.03, 0.08]),
            ],
            false,
            1.2e-1,
        ),
    ];
    let mut failures = Vec::new();
    for (effects, stops, tolerance_mm) in cases {
        let model = model(effects, stops);
        let told = model.effects.iter().map(|effect| format!("{} {}", effect.name, effect.form)).collect::<Vec<_>>().join(", ");
        let physics = physics_model(&model, std::slice::from_ref(&run)).unwrap_or_else(|why| panic!("{told}: {why}"));
        let simulated = physics.simulate(&run.input);
        let apart = farthest(&simulated, &model.simulate(&run.input).expect("a prediction"));
        let of_the_blob = farthest(&of_the_blob(&physics, &run), &simulated);
        eprintln!("{told}: {apart:.1e} mm apart, the blob {of_the_blob:.1e}");
        if !(apart < tolerance_mm && of_the_blob < 2e-4) {
            failures.push(format!("{told}: {apart} mm apart, the blob {of_the_blob} mm off its physics"));
        }
    }
    assert_eq!(failures, Vec::<String>::new());
}

#[test]
fn its_error_is_that_of_the_form_that_runs() {
    let run = recording();
    let physics = physics_model(&model(vec![entry("resonance", "tip", &[2.0, 0.05], &[])], false), std::slice::from_ref(&run));
    let physics = physics.expect("a physics model");
    let squares: f64 = physics.simulate(&run.input).iter().zip(&run.output).map(|(found, output)| (found - output).powi(2)).sum();
    assert!((physics.provenance.rmse - (squares / run.len() as f64).sqrt()).abs() < 1e-12);
}

#[test]
fn a_form_that_departs_by_more_than_the_model_errs_is_refused() {
    let run = [recording()];
    let errs = |rmse, overstress: f64| {
        let viscous = model(vec![entry("rate-dependent-hysteresis", "overstress-asinh", &[overstress, 0.2], &[])], false);
        physics_model(&DiscoveredModel { origin: Origin { rmse, ..viscous.origin.clone() }, ..viscous }, &run)
    };
    // Where strokes turn on samples, means of the rate on both sides are no rates.
    let why = errs(1e-4, 0.1).expect_err("not the same");
    assert!(why.contains("departs"), "{why}");
    assert!(errs(10.0, 0.1).is_ok(), "the model errs by more");
    assert!(errs(1e-4, 0.003).is_ok(), "less than a hundredth of the range makes no difference");
}

#[test]
fn what_the_session_left_in_the_muscle_is_no_matter_of_the_form() {
    let experienced = DiscoveredModel { memory: vec![0.0, 0.9, 0.4], ..model(Vec::new(), false) };
    let exact = DiscoveredModel { origin: Origin { rmse: 0.0, ..experienced.origin.clone() }, ..experienced };
    assert!(physics_model(&exact, &[recording()]).is_ok());
}

#[test]
fn a_model_from_a_file_keeps_its_memory_behind_a_lag() {
    let lagging = || model(vec![entry("pneumatic-lag", "before", &[0.15], &[])], false);
    let experienced = DiscoveredModel { memory: vec![0.0, 0.9, 0.4], ..lagging() };
    let first = |model: &DiscoveredModel| model.simulate(&[1.2; 50]).expect("a prediction")[0];
    // Of three operators the widest (0.3 of the span, weight 0.2) still stands where 0.9 of the span left it, half the span further
    // up, and the next (0.1, 0.3) at 0.5 instead of 0.3: 0.2 * 0.5 + 0.3 * 0.2 of 12 mm.
    let further_mm = first(&experienced) - first(&lagging());
    assert!((further_mm - 0.16 * 12.0).abs() < 1e-9, "{further_mm}");
}

#[test]
fn what_keeps_a_model_off_the_microcontroller_is_named() {
    let run = [recording()];
    let refused = |effects: Vec<EffectEntry>, stops| physics_model(&model(effects, stops), &run).expect_err("no form");
    let changing = entry("resonance", "changing-tip", &[3.0, 0.1, 1.0, 0.5, 0.5, 20.0], &[]);
    assert_eq!(refused(vec![changing], false), "resonance (changing-tip)");
    let activated = entry("creep", "of-the-displacement-activated", &[2.0, 0.2], &[0.1]);
    assert_eq!(refused(vec![activated], false), "creep (of-the-displacement-activated)");
    let swings = || entry("resonance", "tip", &[3.0, 0.1], &[]);
    assert_eq!(refused(vec![swings(), swings()], false), "resonance (tip): its stage is taken by another effect");
    let lag = entry("pneumatic-lag", "before", &[0.1], &[]);
    let supply = entry("supply-saturation", "rounded", &[0.7, 0.01, 0.0], &[]);
    assert_eq!(refused(vec![lag, supply], false), "supply-saturation (rounded): it acts in another order there");
    let grows = entry("asymmetric-hysteresis", "thresholds-grow", &[1.5], &[]);
    assert_eq!(refused(vec![grows], true), "asymmetric-hysteresis (thresholds-grow) of stop operators");
    let slower = entry("rate-dependent-hysteresis", "viscous", &[0.05, 0.5], &[]);
    assert!(refused(vec![slower], false).contains("its operators have one time constant there"));
    let long = entry("dead-time", "constant", &[0.7], &[]);
    assert!(refused(vec![long], false).contains("dead time of 35"));
}
