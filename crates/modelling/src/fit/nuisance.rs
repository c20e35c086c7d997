//! The nuisances that a search finds, and recordings with them taken off.

use identification::search::Search;
use identification::{Covariate, Nuisances, Partition};

use super::judging::mean;
use super::prepare::{Prepared, name_of};
use crate::physics::nuisance::{Kind, Nuisance, Slope, Value};
use recording::Recording;

/// Seconds in an hour.
const HOUR_S: f64 = 3600.0;

/// The slow signals that all recordings carry: a temperature, and session time, a common clock, or else the order of the recordings.
#[must_use]
pub fn covariates(recordings: &[Recording]) -> Vec<Covariate> {
    let column = |wanted: &dyn Fn(&str) -> bool| -> Option<(String, Vec<Vec<f64>>)> {
        let of = |recording: &Recording| recording.extra.iter().find(|column| wanted(&column.name)).cloned();
        let columns: Vec<_> = recordings.iter().map(of).collect::<Option<_>>()?;
        Some((columns.first()?.name.clone(), columns.into_iter().map(|column| column.values).collect()))
    };
    let mut made = Vec::new();
    let hours = |values: Vec<Vec<f64>>| values.into_iter().map(|one| one.into_iter().map(|value| value / HOUR_S).collect()).collect();
    let (unit, values) = match column(&|name| name == "session_time_s") {
        Some((_, values)) => ("h", hours(values)),
        None if common_clock(recordings) => ("h", hours(recordings.iter().map(|recording| recording.time_s.clone()).collect())),
        None => ("recording", recordings.iter().enumerate().map(|(order, one)| vec![order as f64; one.len()]).collect()),
    };
    made.push(Covariate { name: "drift".to_owned(), unit: unit.to_owned(), values });
    if let Some((name, values)) = column(&|name| name.starts_with("temperature_")) {
        let unit = name.trim_start_matches("temperature_").to_owned();
        made.push(Covariate { name: "temperature".to_owned(), unit, values });
    }
    // Recordings that were interpolated may lack a value at the ends of stretches.
    made.retain(|one| one.values.iter().flatten().all(|value| value.is_finite()));
    made
}

/// Whether the recordings' clocks are parts of one: none begins before the one before it has ended.
fn common_clock(recordings: &[Recording]) -> bool {
    recordings.len() > 1 && recordings.windows(2).all(|pair| pair[1].time_s[0] >= pair[0].time_s[pair[0].len() - 1])
}

/// The recordings of some units, with the nuisances that these units name taken off: for fits that know of none.
#[must_use]
pub fn cleaned(prepared: &Prepared, partition: &Partition, search: &Search, left_out: &[usize]) -> Vec<Recording> {
    let training = partition.without(left_out);
    let nuisances = search.nuisances(&training);
    let one = |&unit: &usize| {
        let series = partition.units()[unit].series;
        let mut recording = prepared.recordings[series].clone();
        if !nuisances.is_empty() {
            recording.output = search.cleaned(&nuisances, series);
        }
        recording
    };
    training.all.units().iter().map(one).collect()
}

/// The list for a model; `predicted` is what it makes of each recording, and `mean_zero` its constant.
#[must_use]
pub fn list(prepared: &Prepared, search: &Search, found: &Nuisances, predicted: &[Vec<f64>], mean_zero: f64) -> Vec<Nuisance> {
    let unit = &prepared.output.unit;
    let recordings = &prepared.recordings;
    let name = |series: usize| name_of(&recordings[series].path);
    let step = |series: usize| search.step(found, series);
    let moved: Vec<Vec<f64>> = (0..recordings.len()).map(|series| search.moved(found, series)).collect();
    let level = |series: usize, part: std::ops::Range<usize>| -> f64 {
        let left = |index: usize| recordings[series].output[index] - predicted[series][index] - moved[series][index];
        mean(&part.map(left).collect::<Vec<_>>())
    };
    let before = |series: usize| level(series, 0..step(series).unwrap_or(recordings[series].len()));
    let mut made = Vec::new();
    let mut add = |kind, mean, per, values: Vec<Value>| {
        let spread = deviation(&values.iter().map(|one| one.value).collect::<Vec<_>>());
        made.push(Nuisance { kind, unit: unit.clone(), mean, spread, per, values });
    };
    if found.zeros {
        let value = |series| Value { recording: name(series), value: before(series), at: None };
        add(Kind::Zero, mean_zero, None, (0..recordings.len()).map(value).collect());
    }
    for ((covariate, centre, half), coefficient) in search.covariates().zip(&found.covariates) {
        let Some(coefficient) = *coefficient else { continue };
        let kind = if covariate.name == "temperature" { Kind::Temperature } else { Kind::Drift };
        let value = |series: usize| {
            let at = mean(&covariate.values[series]);
            Value { recording: name(series), value: coefficient * at, at: Some(centre + half * at) }
        };
        let slope = Slope { slope: coefficient / half, unit: format!("{unit}/{}", covariate.unit), about: centre };
        add(kind, 0.0, Some(slope), (0..recordings.len()).map(value).collect());
    }
    let value = |series: usize| {
        let index = step(series)?;
        let behind = level(series, index..recordings[series].len());
        Some(Value { recording: name(series), value: behind - before(series), at: Some(recordings[series].time_s[index]) })
    };
    let steps: Vec<Value> = (0..recordings.len()).filter_map(value).collect();
    if !steps.is_empty() {
        let height = mean(&steps.iter().map(|step| step.value).collect::<Vec<_>>());
        add(Kind::Step, height, None, steps);
    }
    made
}

fn deviation(values: &[f64]) -> f64 {
    let centre = mean(values);
    let squares: f64 = values.iter().map(|value| (value - centre).powi(2)).sum();
    (squares / (values.len() as f64 - 1.0).max(1.0)).sqrt()
}
