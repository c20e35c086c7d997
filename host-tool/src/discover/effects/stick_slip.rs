//! `stick-slip`: the tip holds until the pull exceeds a band, then jumps and stops short of the pull by a share of the band, or beyond it
//! (a negative share: a light tip on a spring overshoots when its friction falls from static to sliding).

use std::collections::BTreeMap;

use crate::discover::catalogue::{Columns, Form, Parameter, Place, Quantity};
use crate::discover::session::{Run, Session};

use super::{best_starts, fit_of_steps, ladder};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&StickBand, &Breakaway];

struct StickBand;
struct Breakaway;

/// Sends every column through the tip. Where the tip sits is where the pull last made it go, so the columns stay linear in the weights;
/// a last column holds how far it lags behind the pull. Above `slide_per_s` the tip slides on instead of sticking again.
fn stick(sum: &[f64], band: f64, remaining: f64, slide_per_s: f64, period_s: f64, columns: &mut Columns) {
    let (from, behind) = tip(sum, band, remaining, slide_per_s, period_s);
    let mut scratch = vec![0.0; columns.samples];
    columns.filter(|column| {
        for (value, &index) in scratch.iter_mut().zip(&from) {
            *value = column[index];
        }
        column.copy_from_slice(&scratch);
    });
    columns.push(false, |sample| behind[sample]);
}

/// For every sample the one at which the tip last moved, and how far it has lagged behind the pull since.
fn tip(sum: &[f64], band: f64, remaining: f64, slide_per_s: f64, period_s: f64) -> (Vec<usize>, Vec<f64>) {
    let mut place = sum[0];
    let mut moved = 0;
    let mut lean = 0.0;
    let mut sliding = false;
    let mut from = Vec::with_capacity(sum.len());
    let mut behind = Vec::with_capacity(sum.len());
    let mut last = sum[0];
    for (sample, &pull) in sum.iter().enumerate() {
        let step = pull - last;
        last = pull;
        // It slides on while the pull goes on the same way fast enough.
        sliding = sliding && step * lean < 0.0 && step.abs() > slide_per_s * period_s;
        let stretch = pull - place;
        if stretch.abs() > band || sliding {
            if !sliding {
                lean = -stretch.signum();
            }
            sliding = true;
            place = pull + lean * remaining;
            moved = sample;
        }
        from.push(moved);
        behind.push(lean * remaining);
    }
    (from, behind)
}

/// Starts whose jumps look most like those of the residual.
fn likely(session: &Session, residual: &[Vec<f64>], speeds: &[f64], with_speed: bool) -> Vec<Vec<f64>> {
    let sums: Vec<Vec<f64>> = session
        .runs
        .iter()
        .zip(residual)
        .map(|(run, residual)| run.output.iter().zip(residual).map(|(output, residual)| output - residual).collect())
        .collect();
    let grid = ladder(0.004, 0.2, 90).into_iter().flat_map(|travel| {
        [0.6, 0.8, 1.05, 1.3, 1.7, 2.4, 4.0].into_iter().flat_map(move |wider| {
            speeds.iter().map(move |&speed| if with_speed { vec![travel * wider, travel, speed] } else { vec![travel * wider, travel] })
        })
    });
    let score = |parameters: &Vec<f64>| {
        fit_of_steps(session, residual, |run| {
            let sum = &sums[run.index];
            let speed = parameters.get(2).copied().unwrap_or(f64::MAX);
            let (from, behind) = tip(sum, parameters[0], parameters[0] - parameters[1], speed, run.period_s);
            (0..sum.len()).map(|sample| sum[from[sample]] + behind[sample] - sum[sample]).collect()
        })
    };
    best_starts(grid, score, 10)
}

/// Pull at which the tip breaks away.
const BAND: Parameter = Parameter { name: "band", quantity: Quantity::Output, low: 1e-3, high: 0.5, logarithmic: true };
/// How far it jumps then: short of the pull, or beyond it. As with the valve, an error in it adds up along the stairs.
const TRAVEL: Parameter = Parameter { name: "travel", quantity: Quantity::Output, low: 1e-3, high: 0.5, logarithmic: true };

impl Form for StickBand {
    fn name(&self) -> &'static str {
        "stick-slip"
    }
    fn form(&self) -> &'static str {
        "stick band with jumps"
    }
    fn place(&self) -> Place {
        Place::Tip
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[BAND, TRAVEL]
    }
    fn weights(&self) -> usize {
        1
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        likely(session, residual, &[f64::MAX], false)
    }
    fn step(&self) -> f64 {
        0.02
    }
    fn needs_sum(&self) -> bool {
        true
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        stick(sum, parameters[0], parameters[0] - parameters[1], f64::MAX, run.period_s, columns);
    }
    fn tell(&self, _: &[f64], weights: &[f64], _: &Session) -> BTreeMap<String, f64> {
        BTreeMap::from([("remaining_weight".to_owned(), weights[0])])
    }
}

impl Form for Breakaway {
    fn name(&self) -> &'static str {
        "stick-slip"
    }
    fn form(&self) -> &'static str {
        "breaks away and slides on while fast"
    }
    fn place(&self) -> Place {
        Place::Tip
    }
    fn parameters(&self) -> &'static [Parameter] {
        &[BAND, TRAVEL, Parameter { name: "sticking_speed", quantity: Quantity::OutputRate, low: 1e-3, high: 10.0, logarithmic: true }]
    }
    fn weights(&self) -> usize {
        1
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        likely(session, residual, &[0.02, 0.1, 0.4], true)
    }
    fn step(&self) -> f64 {
        0.02
    }
    fn needs_sum(&self) -> bool {
        true
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        stick(sum, parameters[0], parameters[0] - parameters[1], parameters[2], run.period_s, columns);
    }
    fn tell(&self, _: &[f64], weights: &[f64], _: &Session) -> BTreeMap<String, f64> {
        BTreeMap::from([("remaining_weight".to_owned(), weights[0])])
    }
}
