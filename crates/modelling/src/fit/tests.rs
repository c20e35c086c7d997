mod networks;
mod nuisances;

use std::path::Path;

use super::judging::mean;
use super::*;
use crate::model::{self, FittedPredictor, PhysicsPredictor, Predictor};
use recording::{Channel, Recording, Signal};
use simulation::excitation::Limits;
use simulation::excitation::sets::SetConfig;
use simulation::plant::dataset::{Dataset, SetKind};
use simulation::plant::{MeasurementNoise, Plant, PlantConfig};

/// Recordings of the paper's plant; `tests` are of the same kinds, of another random stream.
fn paper(seed: u64, noise_mm: f64) -> (Vec<Recording>, Vec<Recording>) {
    let measurement_noise = (noise_mm > 0.0).then_some(MeasurementNoise { standard_deviation_mm: noise_mm });
    let plant = Plant::new(PlantConfig { measurement_noise, ..PlantConfig::default() }).expect("a plant");
    let config = SetConfig { seed, ..SetConfig::default() };
    let set = Dataset::simulate(SetKind::Paper, &config, &Limits::default(), &plant, Path::new("set")).expect("recordings");
    (set.part("train").take(6).cloned().collect(), set.part("test").cloned().collect())
}

fn physics_only(seed: u64) -> Settings {
    Settings { seed, threads: 2, network_budget_cpu_s: None, calibrate_s: None }
}

fn rmse(model: &dyn Predictor, recordings: &[Recording]) -> f64 {
    let one = |recording: &Recording| {
        let predicted = model::predict(model, recording, model::Fit::default()).expect("a prediction");
        crate::evaluate::Errors::between(&predicted, &recording.output).rmse
    };
    mean(&recordings.iter().map(one).collect::<Vec<_>>())
}

#[test]
fn on_the_papers_plant_physics_is_chosen_and_exact_and_the_promise_holds() {
    let (train, test) = paper(71, 0.0);
    let fitted = fit(&train, &physics_only(1), &|_| {}).expect("a ladder");
    let chosen = &fitted.ladder[fitted.chosen];
    let RungModel::Physics(physics) = &chosen.model else { panic!("{} was chosen", chosen.name) };
    assert!(chosen.cv_rmse < 1e-6, "{}: {}", chosen.name, chosen.cv_rmse);
    assert!(rmse(&PhysicsPredictor::new((**physics).clone(), Path::new("m")), &test) < 1e-6);
}

#[test]
fn what_the_ladder_promises_is_what_new_recordings_bring() {
    for seed in [72, 73] {
        let (train, test) = paper(seed, 0.004);
        let fitted = fit(&train, &physics_only(1), &|_| {}).expect("a ladder");
        let chosen = &fitted.ladder[fitted.chosen];
        let error = match &chosen.model {
            RungModel::Physics(model) => rmse(&PhysicsPredictor::new((**model).clone(), Path::new("m")), &test),
            _ => rmse(&FittedPredictor::new(fitted.fitted(fitted.chosen).expect("a file"), Path::new("m")), &test),
        };
        let [low, high] = chosen.cv_interval;
        assert!(low <= error && error <= high, "seed {seed}, {}: {error} outside {low} .. {high}", chosen.name);
        // The noise is 0.004 mm: nothing can be better, and physics need not be much worse.
        assert!((0.0038..0.0048).contains(&error), "seed {seed}: {error}");
    }
}

#[test]
fn noise_that_no_input_explains_is_not_explained() {
    // The output is noise, different in each recording: a model that took part in its own test would look better than the noise.
    let (mut train, _) = paper(74, 0.0);
    for (number, recording) in train.iter_mut().enumerate() {
        for (index, value) in recording.output.iter_mut().enumerate() {
            *value = (1e4 * ((index * 7 + number * 1013) as f64).sin()).fract();
        }
    }
    let fitted = fit(&train, &physics_only(1), &|_| {}).expect("a ladder");
    let spread = mean(
        &train
            .iter()
            .map(|one| {
                let centre = mean(&one.output);
                mean(&one.output.iter().map(|value| (value - centre).powi(2)).collect::<Vec<_>>()).sqrt()
            })
            .collect::<Vec<_>>(),
    );
    for rung in fitted.ladder.iter().filter(|rung| rung.eligible) {
        assert!(rung.cv_rmse > 0.99 * spread, "{}: {} of {spread}", rung.name, rung.cv_rmse);
    }
    assert_eq!(fitted.chosen, 0, "{}", fitted.ladder[fitted.chosen].name);
}

#[test]
fn a_model_file_is_read_back_to_the_same_simulation() {
    let (train, test) = paper(75, 0.01);
    let fitted = fit(&train, &physics_only(1), &|_| {}).expect("a ladder");
    let folder = tempfile::tempdir().expect("a folder");
    for index in 0..fitted.ladder.len() {
        let Some(model) = fitted.fitted(index) else { continue };
        let path = folder.path().join("model");
        model.write(&path).expect("written");
        assert_eq!(model::format(&path).expect("a format"), model::Format::Fitted);
        let read = model::load(&path).expect("read");
        let inputs = test[0].inputs();
        assert_eq!(read.simulate(&inputs, &[]).expect("a prediction"), model.simulate(&inputs, &[]), "{}", model.name);
    }
}

#[test]
fn the_form_for_the_chip_is_the_same_model() {
    let (train, test) = paper(76, 0.002);
    let fitted = fit(&train, &physics_only(1), &|_| {}).expect("a ladder");
    let mut forms = 0;
    for rung in &fitted.ladder {
        let RungModel::Linear(model) = &rung.model else { continue };
        let Some(physics) = fitted.prepared.on_chip(model) else {
            assert!(!rung.on_chip);
            continue;
        };
        forms += 1;
        let file = fitted.fitted(fitted.ladder.iter().position(|one| one.name == rung.name).expect("a rung")).expect("a file");
        let exported = crate::export::from_fitted(&file).expect("a form");
        assert_eq!(exported.provenance.validation_rmse, rung.cv_rmse, "what recordings left out have shown");
        for recording in &test {
            let sum = model.simulate(&[&recording.input], &[]);
            for (one, other) in sum.iter().zip(physics.simulate(&recording.input)) {
                assert!((one - other).abs() < 1e-9, "{}: {one} {other}", rung.name);
            }
        }
    }
    assert!(forms >= 2, "{forms}");
}

#[test]
fn a_second_input_is_used_and_asked_for() {
    let (mut train, _) = paper(77, 0.001);
    for recording in &mut train {
        let values: Vec<f64> = (0..recording.len()).map(|k| (0.013 * k as f64).sin()).collect();
        for (output, second) in recording.output.iter_mut().zip(&values) {
            *output -= 0.4 * second;
        }
        recording.more_inputs = vec![Channel { signal: Signal { quantity: "other".into(), unit: "bar".into() }, values }];
    }
    let fitted = fit(&train, &physics_only(1), &|_| {}).expect("a ladder");
    let chosen = &fitted.ladder[fitted.chosen];
    assert!(chosen.cv_rmse < 0.01, "{}: {}", chosen.name, chosen.cv_rmse);
    let model = FittedPredictor::new(fitted.fitted(fitted.chosen).expect("a file"), Path::new("m"));
    assert!(rmse(&model, &train) < 0.01);
    train[0].more_inputs.clear();
    let refused = model::predict(&model, &train[0], model::Fit::default()).expect_err("an input is missing").to_string();
    assert!(refused.contains("input2=") && refused.contains("other_bar"), "{refused}");
}

#[test]
fn offsets_of_recordings_are_nuisances_and_not_part_of_the_model() {
    let (mut train, mut test) = paper(78, 0.001);
    // A sensor set to zero anew before each recording; the mean of the offsets is 2.
    let offsets = [0.5, -0.3, 0.1, -0.6, 0.4, -0.1];
    for (recording, offset) in train.iter_mut().zip(offsets) {
        let offset = 2.0 + offset;
        recording.output.iter_mut().for_each(|value| *value += offset);
    }
    test.iter_mut().for_each(|recording| recording.output.iter_mut().for_each(|value| *value += 2.0));
    let fitted = fit(&train, &physics_only(1), &|_| {}).expect("a ladder");
    let linear = (0..fitted.ladder.len()).filter(|&index| matches!(fitted.ladder[index].model, RungModel::Linear(_)));
    let best = linear.min_by(|&a, &b| fitted.ladder[a].shape_rmse.total_cmp(&fitted.ladder[b].shape_rmse)).expect("a rung");
    let file = fitted.fitted(best).expect("a file");
    let [zeros] = &file.nuisances[..] else { panic!("{:?}", file.nuisances) };
    assert_eq!((zeros.kind, zeros.values.len()), (crate::physics::nuisance::Kind::Zero, train.len()));
    for (zero, offset) in zeros.values.iter().zip(offsets) {
        assert!((zero.value - offset).abs() < 0.05, "{}: {} instead of {offset}", zero.recording, zero.value);
    }
    let error = rmse(&FittedPredictor::new(file, Path::new("m")), &test);
    assert!(error < 0.05, "the constant is the mean of the recordings': {error}");
}

#[test]
fn rungs_bound_in_sign_go_on_beyond_the_data() {
    let (train, _) = paper(79, 0.002);
    let fitted = fit(&train, &physics_only(1), &|_| {}).expect("a ladder");
    let plant = Plant::new(PlantConfig::default()).expect("a plant");
    // Half as far again as the data reach: the true output leaves the fitted range by a quarter and more.
    let input: Vec<f64> = train[0].input.iter().map(|value| 1.5 * value).collect();
    let truth = plant.simulate(&input, train[0].sample_period_s, 1);
    let largest = truth.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let range = fitted.prepared.output.maximum - fitted.prepared.output.minimum;
    assert!(largest > fitted.prepared.output.maximum + 0.2 * range, "the test reaches beyond the data: {largest}");
    let rung = fitted.ladder.iter().find(|rung| rung.name == "PI").expect("a rung");
    let RungModel::Linear(model) = &rung.model else { panic!("a sum") };
    let predicted = model.simulate(&[&input], &[]).into_iter().fold(f64::NEG_INFINITY, f64::max);
    assert!((predicted - largest).abs() < 0.05 * range, "{predicted} instead of {largest}");
}
