use std::path::{Path, PathBuf};

use anyhow::bail;

use super::*;
use crate::model::Predictor;
use crate::model::{Arithmetic, Description, ModelError};
use recording::Recording;
use recording::Signal;

/// A model made of a function of input and sample number.
struct Made<F> {
    description: Description,
    output: F,
}

impl<F: Fn(usize, f64) -> f64 + Send + Sync> Predictor for Made<F> {
    fn description(&self) -> &Description {
        &self.description
    }

    fn predict(&self, input: &[f64], gaps: &[usize]) -> Result<Vec<f64>, ModelError> {
        let since_start = |index: usize| index - gaps.iter().copied().filter(|gap| *gap <= index).max().unwrap_or(0);
        Ok(input.iter().enumerate().map(|(index, &value)| (self.output)(since_start(index), value)).collect())
    }
}

fn made<F: Fn(usize, f64) -> f64 + Send + Sync>(output: F) -> Made<F> {
    let description = Description {
        path: PathBuf::from("made"),
        kind: "made for a test".into(),
        arithmetic: Arithmetic::Physics,
        input: Signal::pressure_bar(),
        more_inputs: Vec::new(),
        output: Signal::displacement_mm(),
        input_range: None,
        sample_period_s: None,
        parameters: 0,
        macs_per_step: 0,
    };
    Made { description, output }
}

fn recording(name: &str, input: Vec<f64>, output: Vec<f64>) -> Recording {
    let time_s = (0..input.len()).map(|index| index as f64 * 0.5).collect();
    Recording::new(Path::new(name), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input, output).unwrap()
}

#[test]
fn errors_are_those_of_a_hand_calculation() {
    // Errors 1, -1, 3, 1: squares 1 + 1 + 9 + 1 = 12, mean 3; the measurement spans 4.
    let errors = Errors::between(&[1.0, 0.0, 5.0, 5.0], &[0.0, 1.0, 2.0, 4.0]);
    assert_eq!(errors.n, 4);
    assert_eq!(errors.rmse, 3.0_f64.sqrt());
    assert_eq!(errors.nrmse, Some(3.0_f64.sqrt() / 4.0));
    assert_eq!(errors.max_abs, 3.0);
    assert_eq!(errors.mean_error, 1.0);
    assert_eq!(Errors::between(&[1.0, 2.0], &[5.0, 5.0]).nrmse, None);
}

#[test]
fn every_file_counts_the_same_in_the_mean_whatever_its_length() {
    let recordings =
        [recording("a_1.csv", vec![0.0, 1.0], vec![1.0, 2.0]), recording("b1.csv", vec![0.0, 1.0, 2.0, 3.0], vec![3.0, 4.0, 5.0, 6.0])];
    let model = made(|_, input| input);
    let judged = judge(&model, &recordings, Judging::default(), 2).unwrap();
    let files: Vec<FileErrors> = judged.into_iter().map(|judged| judged.errors).collect();
    assert_eq!(mean_rmse(&files), 2.0);
    let families = by_family(&files);
    assert_eq!(families.iter().map(|family| (family.family.as_str(), family.rmse)).collect::<Vec<_>>(), [("a", 1.0), ("b", 3.0)]);
    assert_eq!(families[1].nrmse, Some(1.0));
}

#[test]
fn skipped_seconds_are_seen_by_the_model_and_do_not_count() {
    // Half a second a sample: from 1 s on it is the third sample. The model counts samples, so it must have seen the first two.
    let recording = recording("run.csv", vec![0.0; 4], vec![9.0, 9.0, 2.0, 4.0]);
    let judging = Judging { skip_s: 1.0, ..Judging::default() };
    let judged = judge(&made(|index, _| index as f64), std::slice::from_ref(&recording), judging, 1).unwrap();
    assert_eq!((judged[0].first, judged[0].errors.errors.n), (2, 2));
    assert_eq!(judged[0].errors.errors.max_abs, 1.0);
    let message = judge(&made(|_, _| 0.0), &[recording], Judging { skip_s: 60.0, ..judging }, 1).unwrap_err().to_string();
    assert!(message.contains("run.csv") && message.contains("--skip-s"), "{message}");
}

#[test]
fn tare_takes_a_constant_out_and_nothing_else() {
    let recording = recording("run.csv", vec![0.0, 1.0, 2.0], vec![10.0, 11.0, 14.0]);
    let plain = judge(&made(|_, input| input), std::slice::from_ref(&recording), Judging::default(), 1).unwrap();
    assert_eq!(plain[0].errors.errors.max_abs, 12.0);
    let tared = judge(&made(|_, input| input), &[recording], Judging { tare: true, ..Judging::default() }, 1).unwrap();
    assert_eq!(tared[0].errors.errors.max_abs, 2.0);
}

#[test]
fn a_prediction_that_is_not_finite_is_refused_with_model_file_and_time() {
    let recording = recording("run.csv", vec![0.0, 1.0, 2.0], vec![0.0; 3]);
    let message =
        judge(&made(|index, _| if index > 1 { f64::NAN } else { 0.0 }), &[recording], Judging::default(), 1).unwrap_err().to_string();
    assert!(["made", "run.csv", "1.000 s"].iter().all(|word| message.contains(word)), "{message}");
}

#[test]
fn results_and_errors_do_not_depend_on_the_number_of_threads() {
    let items: Vec<usize> = (0..50).collect();
    for threads in [1, 2, 7, 100] {
        assert_eq!(for_each(&items, threads, |item| Ok(item * 2)).unwrap(), items.iter().map(|item| item * 2).collect::<Vec<_>>());
        let error = for_each(&items, threads, |item| if item % 13 == 12 { bail!("item {item}") } else { Ok(()) });
        assert_eq!(error.unwrap_err().to_string(), "item 12");
    }
    assert!(for_each(&[] as &[usize], 4, |_| Ok(0)).unwrap().is_empty());
}

mod on_the_ladder;
mod under_the_suite;
