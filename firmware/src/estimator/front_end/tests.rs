use super::*;
use heapless::Vec;
use model_export::schema::{Curve, Feature, Filter, Flow, Growth, Stages};

fn channel() -> Channel<'static> {
    Channel { quantity: "pressure", unit: "bar", offset: 1.0, scale: 2.0, minimum: 0.0, maximum: 3.0 }
}

fn feature(source: FeatureSource) -> Feature {
    Feature { source, offset: 0.0, gain: 1.0 }
}

fn config() -> schema::FrontEnd {
    schema::FrontEnd {
        lag_coefficient: 1.0,
        play_thresholds: Vec::from_slice(&[0.0, 0.25]).unwrap(),
        play_weights: Vec::from_slice(&[0.5, 0.25]).unwrap(),
        ..schema::FrontEnd::default()
    }
}

#[test]
fn follows_the_play_equation_by_hand() {
    let front_end = FrontEnd::new(&config(), &channel(), &[]).unwrap();
    let mut state = FrontEndState::default();
    // u = -0.5, 0.5, 0.25, -0.5: the second operator goes -0.25, 0.25, 0.25, -0.25. All values are exact in binary.
    let expected = [(0.0, -0.3125), (2.0, 0.3125), (1.5, 0.1875), (0.0, -0.3125)];
    for (raw, readout) in expected {
        assert_eq!(front_end.step(&mut state, &[raw], &mut [0.0; 0]).readout, readout);
    }
}

#[test]
fn delays_by_fractions_of_a_sample_and_lags() {
    let config = schema::FrontEnd { dead_time_samples: 1.25, lag_coefficient: 0.5, input_weight: 1.0, ..schema::FrontEnd::default() };
    let front_end = FrontEnd::new(&config, &channel(), &[]).unwrap();
    let mut state = FrontEndState::default();
    front_end.step(&mut state, &[1.0], &mut [0.0; 0]);
    // A unit step in u, delayed: 0, 0.75, 1, 1; lagged by halves: 0, 0.375, 0.6875, 0.84375.
    let paths = [0.0, 0.375, 0.6875, 0.84375].map(|expected| (front_end.step(&mut state, &[3.0], &mut [0.0; 0]).path, expected));
    for (path, expected) in paths {
        assert_eq!(path, expected);
    }
}

#[test]
fn the_longest_dead_time_is_exact() {
    let config = schema::FrontEnd { dead_time_samples: 32.0, lag_coefficient: 1.0, input_weight: 1.0, ..schema::FrontEnd::default() };
    let front_end = FrontEnd::new(&config, &channel(), &[]).unwrap();
    let mut state = FrontEndState::default();
    for sample in 0..100u8 {
        let path = front_end.step(&mut state, &[f32::from(sample)], &mut [0.0; 0]).path;
        assert_eq!(path, (f32::from(sample.saturating_sub(32)) - 1.0) / 2.0);
    }
}

#[test]
fn creep_starts_at_equilibrium_and_follows_the_sum() {
    let mut config = config();
    config.creep_coefficients.push(0.25).unwrap();
    config.creep_weights.push(2.0).unwrap();
    let front_end = FrontEnd::new(&config, &channel(), &[]).unwrap();
    let mut state = FrontEndState::default();
    assert_eq!(front_end.step(&mut state, &[0.0], &mut [0.0; 0]).readout, -0.3125 * 3.0);
    assert_eq!(front_end.step(&mut state, &[2.0], &mut [0.0; 0]).readout, 0.3125 + 2.0 * (-0.3125 + 0.25 * 0.625));
}

#[test]
fn the_curve_bends_the_sum_by_hand() {
    let curve = Curve {
        offset: 0.25,
        slope: 0.0,
        bend_points: Vec::from_slice(&[-0.5, 0.0, 0.5]).unwrap(),
        bends: Vec::from_slice(&[1.0, 1.0, -2.0]).unwrap(),
    };
    let config = schema::FrontEnd { lag_coefficient: 1.0, input_weight: 1.0, curve: Some(curve), ..schema::FrontEnd::default() };
    let front_end = FrontEnd::new(&config, &channel(), &[]).unwrap();
    let mut state = FrontEndState::default();
    // u = -1, -0.5, -0.25, 0, 0.25, 0.5, 1: flat, then slope 1, then slope 2, then flat again.
    let expected = [(-1.0, 0.25), (0.0, 0.25), (0.5, 0.5), (1.0, 0.75), (1.5, 1.25), (2.0, 1.75), (3.0, 1.75)];
    for (raw, readout) in expected {
        assert_eq!(front_end.step(&mut state, &[raw], &mut [0.0; 0]).readout, readout);
    }
}

#[test]
fn features_are_the_signals_the_schema_names() {
    let mut config = config();
    config.dead_time_samples = 1.0;
    let sources = [
        FeatureSource::Input,
        FeatureSource::InputDifference,
        FeatureSource::Path,
        FeatureSource::PathDifference,
        FeatureSource::Play(1),
        FeatureSource::Stop(1),
        FeatureSource::Readout,
    ];
    config.features.extend(sources.map(feature));
    config.features.push(Feature { source: FeatureSource::Input, offset: 0.5, gain: 2.0 }).unwrap();
    let front_end = FrontEnd::new(&config, &channel(), &[]).unwrap();
    let mut state = FrontEndState::default();
    let mut features = [f32::NAN; 8];
    front_end.step(&mut state, &[0.0], &mut features);
    assert_eq!(features, [-0.5, 0.0, -0.5, 0.0, -0.25, -1.0, -0.3125, -2.0]);
    front_end.step(&mut state, &[2.0], &mut features);
    assert_eq!(features, [0.5, 1.0, -0.5, 0.0, -0.25, -1.0, -0.3125, 0.0]);
    front_end.step(&mut state, &[2.0], &mut features);
    assert_eq!(features, [0.5, 0.0, 0.5, 1.0, 0.25, 1.0, 0.3125, 0.0]);
}

#[test]
fn a_sample_that_is_no_measurement_is_held_and_counted() {
    let front_end = FrontEnd::new(&config(), &channel(), &[]).unwrap();
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, 1.0e5] {
        let (mut state, mut reference) = (FrontEndState::default(), FrontEndState::default());
        front_end.step(&mut state, &[2.0], &mut [0.0; 0]);
        front_end.step(&mut reference, &[2.0], &mut [0.0; 0]);
        let output = front_end.step(&mut state, &[bad], &mut [0.0; 0]);
        assert!(output.held);
        assert_eq!(output.readout, front_end.step(&mut reference, &[2.0], &mut [0.0; 0]).readout);
        assert_eq!(state.held_samples(), 1);
    }
}

#[test]
fn a_bad_first_sample_leaves_the_start_to_the_first_good_one() {
    let front_end = FrontEnd::new(&config(), &channel(), &[]).unwrap();
    let (mut state, mut fresh) = (FrontEndState::default(), FrontEndState::default());
    // At rest: u = -0.5, as in the hand calculation.
    assert_eq!(front_end.step(&mut state, &[f32::NAN], &mut [0.0; 0]).readout, -0.3125);
    for raw in [2.5, 1.0, 1.7] {
        assert_eq!(front_end.step(&mut state, &[raw], &mut [0.0; 0]), front_end.step(&mut fresh, &[raw], &mut [0.0; 0]));
    }
}

#[test]
fn refuses_what_it_could_not_run() {
    let refused = |change: fn(&mut schema::FrontEnd)| {
        let mut config = config();
        change(&mut config);
        FrontEnd::new(&config, &channel(), &[]).unwrap_err().field
    };
    assert_eq!(refused(|config| config.dead_time_samples = 32.5), "front_end.dead_time_samples");
    assert_eq!(refused(|config| config.dead_time_samples = f32::NAN), "front_end.dead_time_samples");
    assert_eq!(refused(|config| config.lag_coefficient = 0.0), "front_end.lag_coefficient");
    assert_eq!(refused(|config| config.play_thresholds[0] = 0.5), "front_end.play_thresholds");
    assert_eq!(refused(|config| config.play_weights.truncate(1)), "front_end.play_weights");
    let curve = |points: &[f32], bends: &[f32]| {
        Some(Curve {
            slope: 1.0,
            bend_points: Vec::from_slice(points).unwrap(),
            bends: Vec::from_slice(bends).unwrap(),
            ..Curve::default()
        })
    };
    let refused_curve = |curve: Option<Curve>| FrontEnd::new(&schema::FrontEnd { curve, ..config() }, &channel(), &[]).unwrap_err().field;
    assert_eq!(refused_curve(curve(&[0.5, 0.5], &[1.0, 1.0])), "front_end.curve.bend_points");
    assert_eq!(refused_curve(curve(&[0.5], &[])), "front_end.curve.bends");
    assert_eq!(refused_curve(curve(&[0.5], &[f32::NAN])), "front_end.curve.bends");
    assert_eq!(refused(|config| config.features.push(feature(FeatureSource::Play(2))).unwrap()), "front_end.features");
    // The first operator has threshold zero: there is no stop to divide by.
    assert_eq!(refused(|config| config.features.push(feature(FeatureSource::Stop(0))).unwrap()), "front_end.features");
}

/// Numbers that are exact in binary, through one stage after the other.
#[test]
fn stages_follow_their_equations_by_hand() {
    let channel = Channel { offset: 0.0, scale: 1.0, ..channel() };
    let run = |stages: Stages, plain: schema::FrontEnd, inputs: &[f32]| -> Vec<f32, 64> {
        let config = schema::FrontEnd { lag_coefficient: 1.0, stages: Some(stages), ..plain };
        let front_end = FrontEnd::new(&config, &channel, &[]).unwrap();
        let mut state = FrontEndState::default();
        inputs.iter().map(|input| front_end.step(&mut state, &[*input], &mut [0.0; 0]).readout).collect()
    };
    let straight = || schema::FrontEnd { input_weight: 1.0, ..schema::FrontEnd::default() };
    let none = Stages::default();
    let bend = |point: f32, bend: f32| Curve {
        slope: 1.0,
        bend_points: Vec::from_slice(&[point]).unwrap(),
        bends: Vec::from_slice(&[bend]).unwrap(),
        ..Curve::default()
    };
    // No more than one half; then twice what is above one quarter.
    let curves = Stages { supply: Some(bend(0.5, -1.0)), muscle: Some(bend(0.25, 1.0)), ..none.clone() };
    assert_eq!(run(curves, straight(), &[0.0, 0.25, 0.375, 1.0]), [0.0, 0.25, 0.5, 0.75]);
    // All of what is missing, and no more than one quarter upwards; a half of it downwards.
    let half = Curve { slope: 0.5, ..Curve::default() };
    let slew = Stages { flow: Some(Flow { fill: bend(0.25, -1.0), vent: half.clone() }), ..none.clone() };
    assert_eq!(run(slew, straight(), &[0.0, 1.0, 1.0, 0.125, -1.0, 0.0]), [0.0, 0.25, 0.5, 0.3125, -0.34375, -0.09375]);
    let quarter = Curve { slope: 0.25, ..Curve::default() };
    let flow = Stages { flow: Some(Flow { fill: half, vent: quarter }), ..none.clone() };
    assert_eq!(run(flow, straight(), &[0.0, 1.0, 1.0, 0.0, 0.0]), [0.0, 0.5, 0.75, 0.5625, 0.421_875]);
    // Nobody goes beyond what is missing, nor away from it.
    let twice = Curve { slope: 2.0, ..Curve::default() };
    let away = Curve { slope: -1.0, ..Curve::default() };
    let bounded = Stages { flow: Some(Flow { fill: twice, vent: away }), ..none.clone() };
    assert_eq!(run(bounded, straight(), &[0.0, 1.0, 0.5, 2.0]), [0.0, 1.0, 1.0, 2.0]);
    // y0 = y1 + (y1 - y2) / 2 + (x0 - y1) / 4: 0, 1/4, then 1/4 + 1/8 + 3/16, then 9/16 + 5/32 + 7/64.
    let swing = Filter { momentum: 0.5, gains: [0.25, 0.0, 0.0] };
    let expected = [0.0, 0.25, 0.5625, 0.828_125];
    assert_eq!(run(Stages { line: Some(swing), ..none.clone() }, straight(), &[0.0, 1.0, 1.0, 1.0]), expected);
    assert_eq!(run(Stages { tip: Some(swing), ..none.clone() }, straight(), &[0.0, 1.0, 1.0, 1.0]), expected);
    // At rest nothing moves, to the last bit, wherever that is.
    assert_eq!(run(Stages { line: Some(swing), tip: Some(swing), ..none }, straight(), &[0.3; 50]), [0.3; 50]);
}

#[test]
fn thresholds_grow_with_the_path_and_with_its_rate() {
    let channel = Channel { offset: 0.0, scale: 1.0, ..channel() };
    let run = |growth: Growth, inputs: &[f32]| -> Vec<f32, 64> {
        let config = schema::FrontEnd {
            play_thresholds: Vec::from_slice(&[0.25]).unwrap(),
            play_weights: Vec::from_slice(&[1.0]).unwrap(),
            lag_coefficient: 1.0,
            stages: Some(Stages { growth: Some(growth), ..Stages::default() }),
            ..schema::FrontEnd::default()
        };
        let front_end = FrontEnd::new(&config, &channel, &[]).unwrap();
        let mut state = FrontEndState::default();
        inputs.iter().map(|input| front_end.step(&mut state, &[*input], &mut [0.0; 0]).readout).collect()
    };
    let inputs = [0.0, 1.0, 2.0, 1.0, 0.0];
    let none = Growth::default();
    assert_eq!(run(none.clone(), &inputs), [0.0, 0.75, 1.75, 1.25, 0.25]);
    // Rising at 1 and 2 the gap is 1/4 (1 + v / 2): 3/8 and 1/2. Falling it stays.
    assert_eq!(run(Growth { per_path: [0.5, 0.0], ..none.clone() }, &inputs), [0.0, 0.625, 1.5, 1.25, 0.25]);
    assert_eq!(run(Growth { per_path: [0.0, 0.5], ..none.clone() }, &inputs), [0.0, 0.75, 1.75, 1.375, 0.25]);
    // Wider by v / 8, then by v^2 / 16.
    assert_eq!(run(Growth { apart: [0.125, 0.0, 0.0], ..none.clone() }, &inputs), [0.0, 0.625, 1.5, 1.375, 0.25]);
    assert_eq!(run(Growth { apart: [0.0, 0.0625, 0.0], ..none.clone() }, &inputs), [0.0, 0.6875, 1.5, 1.3125, 0.25]);
    // A step of 1 a sample: by 1/8 at once, or half of it in the first sample and three quarters in the second.
    let law = Curve { slope: 1.0, ..Curve::default() };
    let by_rate = Growth { law, extra: 0.125, ..none.clone() };
    assert_eq!(run(by_rate.clone(), &inputs), [0.0, 0.625, 1.625, 1.375, 0.375]);
    let fading = Growth { fading: 0.5, ..by_rate.clone() };
    assert_eq!(run(fading, &inputs[..3]), [0.0, 0.6875, 1.656_25]);
    assert_eq!(run(Growth { share: 0.5, extra: 0.0, ..by_rate }, &inputs), [0.0, 0.625, 1.625, 1.375, 0.375]);
    // Half of the distance to the bound in a sample.
    let half = Curve { slope: 0.5, ..Curve::default() };
    assert_eq!(run(Growth { follow: Some(half), ..none }, &inputs), [0.0, 0.375, 1.0625, 1.0625, 0.656_25]);
}

#[test]
fn a_front_end_with_stages_has_one_input_and_no_lag_beside_them() {
    let staged = || schema::FrontEnd { lag_coefficient: 1.0, stages: Some(Stages::default()), ..schema::FrontEnd::default() };
    assert!(FrontEnd::new(&staged(), &channel(), &[]).is_ok());
    assert!(FrontEnd::new(&schema::FrontEnd { lag_coefficient: 0.5, ..staged() }, &channel(), &[]).is_err());
    let two = schema::FrontEnd { more_input_weights: Vec::from_slice(&[1.0]).unwrap(), ..staged() };
    assert!(FrontEnd::new(&two, &channel(), &[channel()]).is_err());
}
