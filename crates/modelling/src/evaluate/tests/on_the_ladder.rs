use super::*;
use crate::evaluate::ladder::{self, Entry, FLOOR};
use crate::evaluate::statics::Polynomial;
use simulation::excitation::Limits;
use simulation::excitation::sets::SetConfig;
use simulation::plant::dataset::{Dataset, SetKind};
use simulation::plant::{Lag, Plant, PlantConfig};

fn paper(plant: PlantConfig, seed: u64) -> Dataset {
    let config = SetConfig { seed, ..SetConfig::default() };
    Dataset::simulate(SetKind::Paper, &config, &Limits::default(), &Plant::new(plant).unwrap(), Path::new("set")).unwrap()
}

#[test]
fn the_static_rung_is_the_least_squares_polynomial() {
    let input: Vec<f64> = (0..200).map(|index| f64::from(index) * 0.01).collect();
    let cubic = |x: f64| 1.0 - 2.0 * x + 0.5 * x * x * x;
    let recording = recording("run.csv", input.clone(), input.iter().map(|&x| cubic(x)).collect());
    let fitted = Polynomial::fit(&[recording], 0.0).unwrap();
    for &x in &input {
        assert!((fitted.at(x) - cubic(x)).abs() < 1e-9, "{x}");
    }
    // Beyond the data it stays where the data ended.
    assert_eq!(fitted.at(50.0), fitted.at(1.99));
}

#[test]
fn a_static_curve_of_two_values_is_the_line_through_their_means() {
    let recording = recording("run.csv", vec![0.0, 1.0, 0.0, 1.0], vec![1.0, 5.0, 3.0, 7.0]);
    let fitted = Polynomial::fit(&[recording], 0.0).unwrap();
    assert!((fitted.at(0.0) - 2.0).abs() < 1e-9 && (fitted.at(1.0) - 6.0).abs() < 1e-9);
}

#[test]
fn on_the_papers_plant_play_operators_suffice_and_a_static_curve_does_not() {
    let data = paper(PlantConfig::default(), 71);
    let (train, test): (Vec<_>, Vec<_>) = (data.part("train").cloned().collect(), data.part("test").cloned().collect());
    let entries = ladder::simple_rungs(&train, 0.0).unwrap();
    let climbed = ladder::climb(&entries, &test, Judging::default(), 2).unwrap();
    assert_eq!(climbed.simplest_sufficient.as_deref(), Some("PI"));
    // A fit of the true structure to data without noise: only rounding is left. A static curve misses the loop, 0.1 mm and more.
    assert!(climbed.rungs[1].mean_rmse < 1e-9, "{}", climbed.rungs[1].mean_rmse);
    assert!(climbed.rungs[0].mean_rmse > 0.02, "{}", climbed.rungs[0].mean_rmse);
}

#[test]
fn on_a_plant_with_lag_the_rung_that_knows_lag_is_the_one_to_use() {
    let data = paper(PlantConfig { lag: Some(Lag { time_constant_s: 0.2 }), ..PlantConfig::default() }, 72);
    // Every fifth of the 24 has each frequency and other decays: enough to see a lag.
    let (train, test): (Vec<_>, Vec<_>) = (data.part("train").step_by(5).cloned().collect(), data.part("test").cloned().collect());
    let entries = ladder::simple_rungs(&train, 0.0).unwrap();
    let climbed = ladder::climb(&entries, &test, Judging::default(), 2).unwrap();
    assert_eq!(climbed.simplest_sufficient.as_deref(), Some("modified PI, delayed"));
    assert!(climbed.rungs[3].mean_rmse < 0.2 * climbed.rungs[1].mean_rmse);
}

#[test]
fn the_first_sufficient_rung_is_chosen_not_the_best() {
    let test = [recording("a1.csv", vec![0.0, 1.0, 2.0], vec![0.0, 1.0, 2.0])];
    let entry = |name: &str, offset: f64| Entry { name: name.into(), model: Box::new(made(move |_, input| input + offset)) };
    let choose = |offsets: [f64; 3]| {
        let entries: Vec<Entry> = ["low", "middle", "high"].iter().zip(offsets).map(|(name, offset)| entry(name, offset)).collect();
        ladder::climb(&entries, &test, Judging::default(), 1).unwrap().simplest_sufficient
    };
    assert_eq!(choose([0.5, 0.12, 0.1]).as_deref(), Some("middle"));
    assert_eq!(choose([0.5, 0.13, 0.1]).as_deref(), Some("high"));
    // The output range is 2: below FLOOR of it nothing better is asked for.
    assert_eq!(choose([1.9 * FLOOR, 1e-9, 0.0]).as_deref(), Some("low"));
}
