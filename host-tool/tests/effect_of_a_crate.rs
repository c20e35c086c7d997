//! An effect written in Rust outside of the crate: it takes part in discovery like the built-in ones, and its models can be read again.

use std::f64::consts::PI;
use std::path::Path;

use host_tool::discover::catalogue::{self, Form, Parameter, Place, Quantity, Spec};
use host_tool::discover::file::DiscoveredModel;
use host_tool::discover::{DiscoverConfig, Run, Verdict, discover, folder};
use host_tool::recording::{Recording, Signal};

/// A gear with three teeth over the span: `v = u + a sin(3 pi u)`.
struct Gear;

impl Form for Gear {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[Parameter { name: "depth", quantity: Quantity::Ratio, low: 0.005, high: 0.3, logarithmic: true }],
            starts: || vec![vec![0.02], vec![0.05], vec![0.15]],
            is_static: true,
            ..Spec::new("gear", ("three-teeth", "three teeth"), Place::Muscle)
        }
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        path.iter_mut().for_each(|value| *value += parameters[0] * (3.0 * PI * *value).sin());
    }
}

fn recording(index: u32) -> Recording {
    let time_s: Vec<f64> = (0..500).map(|sample| f64::from(sample) * 0.02).collect();
    let rate = 0.25 + 0.13 * f64::from(index % 5);
    // The first strokes take the whole span, 2 bar.
    let wave = |time: &f64| (-0.05 * (time - 5.0).max(0.0)).exp() * (1.0 - (2.0 * PI * rate * (time - 1.0).max(0.0)).cos());
    let input: Vec<f64> = time_s.iter().map(wave).collect();
    let mut states = [0.0_f64; 12];
    let output = input.iter().zip(0_u32..).map(|(u, sample)| {
        let v = 0.5 * u + 0.06 * (1.5 * PI * u).sin();
        for (operator, state) in (0_u32..).zip(&mut states) {
            let threshold = 0.03 * f64::from(operator);
            *state = (v - threshold).max((v + threshold).min(*state));
        }
        // Noise of the sensor: a hash of the sample as a deviate.
        let hash = (index * 1000 + sample).wrapping_mul(2_654_435_769).rotate_left(13).wrapping_mul(668_265_263);
        states.iter().sum::<f64>() + 0.02 * (f64::from(hash) / f64::from(u32::MAX) - 0.5)
    });
    let output = output.collect();
    let path = format!("run{index:02}.csv");
    Recording::new(Path::new(&path), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output).expect("a recording")
}

#[test]
fn an_effect_of_another_crate_is_named_and_its_model_runs() {
    static GEAR: Gear = Gear;
    catalogue::add([&GEAR as &'static dyn Form]);
    let recordings: Vec<Recording> = (0..9).map(recording).collect();
    let kept: Vec<Recording> = (9..11).map(recording).collect();
    let finding = discover(&recordings, &kept, &DiscoverConfig::default()).expect("a finding");
    let discovery = &finding.discovery;
    assert_eq!((discovery.verdict, discovery.effects[0].name.as_str()), (Verdict::Named, "gear"), "{discovery:?}");
    let depth = discovery.effects[0].parameters["depth"];
    assert!((depth / 0.06 - 1.0).abs() < 0.1, "{depth}");
    let folder_of_it = tempfile::tempdir().expect("a folder");
    folder::write(&finding, &recordings, "", folder_of_it.path()).expect("written");
    let model = DiscoveredModel::read(&folder_of_it.path().join("model.toml")).expect("a model that can be read");
    assert!(model.simulate(&[0.0, 0.5, 1.0]).expect("it runs").iter().all(|value| value.is_finite()));
}
