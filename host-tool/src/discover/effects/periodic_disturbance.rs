//! `periodic-disturbance`: heart or pump, at a rhythm of its own, running on between recordings.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use crate::discover::catalogue::{Columns, Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Beat, &Triggered, &Loose];

/// Harmonics of the rhythm.
const HARMONICS: usize = 3;

struct Beat;
struct Triggered;
struct Loose;

const FREQUENCY: &[Parameter] =
    &[Parameter { name: "frequency", quantity: Quantity::Frequency, low: 0.05, high: 25.0, logarithmic: false }];

/// Whether a frequency is a multiple of the input's own in a recording: what goes with the input is no rhythm from outside.
fn belongs_to_input(run: &Run, frequency_hz: f64) -> bool {
    let length_s = run.input.len() as f64 * run.period_s;
    let mean = run.input.iter().sum::<f64>() / run.input.len() as f64;
    let crossings = run.input.windows(2).filter(|pair| (pair[0] > mean) != (pair[1] > mean)).count();
    let own_hz = crossings as f64 / 2.0 / length_s;
    let multiple = (frequency_hz / own_hz).round();
    (1.0..=12.0).contains(&multiple) && (frequency_hz - multiple * own_hz).abs() < (0.6 / length_s).max(0.04 * own_hz)
}

/// Power of the residual at one frequency, recordings added without regard to phase.
fn power(session: &Session, residual: &[Vec<f64>], frequency_hz: f64, coherent: bool) -> f64 {
    let mut total = 0.0;
    let (mut all_re, mut all_im) = (0.0, 0.0);
    for (run, values) in session.runs.iter().zip(residual) {
        if values.is_empty() || belongs_to_input(run, frequency_hz) {
            continue;
        }
        let turn = 2.0 * PI * frequency_hz * run.period_s;
        let (sine, cosine) = turn.sin_cos();
        let (mut im, mut re) = (2.0 * PI * frequency_hz * run.session_s[0]).sin_cos();
        let (mut sum_re, mut sum_im) = (0.0, 0.0);
        for value in values {
            sum_re += value * re;
            sum_im += value * im;
            (re, im) = (re * cosine - im * sine, re * sine + im * cosine);
        }
        total += sum_re * sum_re + sum_im * sum_im;
        all_re += sum_re;
        all_im += sum_im;
    }
    if coherent { all_re * all_re + all_im * all_im } else { total }
}

/// Distance of the lines that a recording can resolve, with some overlap, Hz.
fn spacing_hz(session: &Session) -> f64 {
    0.4 / session.runs.iter().map(|run| run.time_s.last().copied().unwrap_or(0.0)).fold(1.0, f64::max)
}

/// Frequencies at which the residual has most power over its surroundings, Hz, at most three.
fn peaks(session: &Session, residual: &[Vec<f64>]) -> Vec<f64> {
    let spacing = spacing_hz(session);
    let period_s = session.runs[0].period_s;
    let mut spectrum: Vec<(f64, f64)> = Vec::new();
    let mut frequency = 0.3_f64.max(5.0 * spacing);
    while frequency < 0.45 / period_s {
        spectrum.push((power(session, residual, frequency, false), frequency));
        frequency += spacing;
    }
    // Over their surroundings: the residual of a poor model is all low frequencies.
    let mut peaks: Vec<(f64, f64)> = (0..spectrum.len())
        .map(|index| {
            let mut around: Vec<f64> =
                spectrum[index.saturating_sub(30)..(index + 31).min(spectrum.len())].iter().map(|entry| entry.0).collect();
            around.sort_by(f64::total_cmp);
            (spectrum[index].0 / around[around.len() / 2].max(1e-30), spectrum[index].1)
        })
        .collect();
    peaks.sort_by(|x, y| y.0.total_cmp(&x.0));
    peaks.into_iter().take(3).filter(|entry| entry.0 > 1.5).map(|entry| entry.1).collect()
}

/// Sizes of the harmonics from their sines and cosines.
fn tell_harmonics(weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
    let unit = &session.output_unit;
    (0..weights.len() / 2)
        .map(|harmonic| {
            let name = if harmonic == 0 { format!("amplitude_{unit}") } else { format!("amplitude_of_harmonic_{}_{unit}", harmonic + 1) };
            (name, weights[2 * harmonic].hypot(weights[2 * harmonic + 1]) * session.output_scale.abs())
        })
        .collect()
}

impl Form for Beat {
    fn name(&self) -> &'static str {
        "periodic-disturbance"
    }
    fn form(&self) -> &'static str {
        "running on through the session"
    }
    fn place(&self) -> Place {
        Place::Sensor
    }
    fn parameters(&self) -> &'static [Parameter] {
        FREQUENCY
    }
    fn weights(&self) -> usize {
        2 * HARMONICS
    }
    fn cost(&self) -> usize {
        3
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let spacing = spacing_hz(session);
        let mut starts = Vec::new();
        for peak in peaks(session, residual) {
            // The phase runs on through the session: a comb of narrow lines under each peak.
            let fine = 0.2 / session.length_s;
            let steps = (1.2 * spacing / fine).ceil() as i64;
            let best = (-steps..=steps)
                .map(|step| peak + step as f64 * fine)
                .map(|frequency| (power(session, residual, frequency, true), frequency))
                .max_by(|x, y| x.0.total_cmp(&y.0));
            if let Some((_, frequency)) = best {
                starts.push(vec![frequency]);
                starts.push(vec![frequency / 2.0]);
            }
        }
        starts
    }
    fn output(&self, parameters: &[f64], run: &Run, _: &[f64], columns: &mut Columns) {
        for harmonic in 1..=HARMONICS {
            let omega = 2.0 * PI * parameters[0] * harmonic as f64;
            columns.push(true, |sample| (omega * run.session_s[sample]).sin());
            columns.push(true, |sample| (omega * run.session_s[sample]).cos());
        }
    }
    fn tell(&self, _: &[f64], weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        tell_harmonics(weights, session)
    }
}

impl Form for Triggered {
    fn name(&self) -> &'static str {
        "periodic-disturbance"
    }
    fn form(&self) -> &'static str {
        "beginning with each recording"
    }
    fn place(&self) -> Place {
        Place::Sensor
    }
    fn parameters(&self) -> &'static [Parameter] {
        FREQUENCY
    }
    fn weights(&self) -> usize {
        2 * HARMONICS
    }
    fn cost(&self) -> usize {
        3
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        peaks(session, residual).into_iter().map(|frequency| vec![frequency]).collect()
    }
    fn step(&self) -> f64 {
        0.002
    }
    fn output(&self, parameters: &[f64], run: &Run, _: &[f64], columns: &mut Columns) {
        for harmonic in 1..=HARMONICS {
            let omega = 2.0 * PI * parameters[0] * harmonic as f64;
            columns.push(true, |sample| (omega * run.time_s[sample]).sin());
            columns.push(true, |sample| (omega * run.time_s[sample]).cos());
        }
    }
    fn tell(&self, _: &[f64], weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        tell_harmonics(weights, session)
    }
}

impl Form for Loose {
    fn name(&self) -> &'static str {
        "periodic-disturbance"
    }
    fn form(&self) -> &'static str {
        "with a phase of its own in each recording"
    }
    fn place(&self) -> Place {
        Place::Sensor
    }
    fn parameters(&self) -> &'static [Parameter] {
        FREQUENCY
    }
    fn weights(&self) -> usize {
        1
    }
    fn cost(&self) -> usize {
        5
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        peaks(session, residual).into_iter().map(|frequency| vec![frequency]).collect()
    }
    fn step(&self) -> f64 {
        0.002
    }
    fn needs_sum(&self) -> bool {
        true
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        // Nothing but the recording itself knows the phase: it is read from what the model leaves of the measured output. Where there is
        // no measured output (a simulation) there is no rhythm either.
        let omega = 2.0 * PI * parameters[0];
        let measured = run.output.iter().any(|value| *value != 0.0);
        let mut mean = 0.0;
        let (mut sine, mut cosine) = (0.0, 0.0);
        if measured {
            let count = run.output.len() as f64;
            mean += run.output.iter().zip(sum).map(|(output, sum)| output - sum).sum::<f64>() / count;
            for (sample, (output, sum)) in run.output.iter().zip(sum).enumerate() {
                let (im, re) = (omega * run.time_s[sample]).sin_cos();
                let left = if run.keep[sample] { output - sum - mean } else { 0.0 };
                sine += 2.0 * left * im / count;
                cosine += 2.0 * left * re / count;
            }
        }
        columns.push(false, |sample| {
            let (im, re) = (omega * run.time_s[sample]).sin_cos();
            sine * im + cosine * re
        });
    }
    fn tell(&self, _: &[f64], weights: &[f64], _: &Session) -> BTreeMap<String, f64> {
        BTreeMap::from([("share_of_the_line".to_owned(), weights[0])])
    }
}
