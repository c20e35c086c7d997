//! `stick-slip`: the tip holds until the pull exceeds a band, then jumps and stops short of the pull by a share of the band, or beyond it
//! (a negative share: a light tip on a spring overshoots when its friction falls from static to sliding).

use std::collections::BTreeMap;
use std::f64::consts::PI;

use crate::discover::catalogue::{Columns, Form, Parameter, Place, Quantity};
use crate::discover::session::{Role, Run, Session};

use super::ladder;

/// All forms.
pub const FORMS: &[&dyn Form] = &[&StickBand, &Breakaway];

struct StickBand;
struct Breakaway;

/// Where the tip sits: at which sample the pull last made it go there (a fraction lies between samples), and how far it has lagged behind
/// that pull since.
struct Seat {
    moved_at: f64,
    behind: f64,
}

/// Sends every column through the tip. Where the tip sits is where the pull last made it go, so the columns stay linear in the weights;
/// a last column holds how far it lags behind the pull. Above `slide_per_s` the tip slides on instead of sticking again.
fn stick(sum: &[f64], band: f64, travel: f64, slide_per_s: f64, period_s: f64, columns: &mut Columns) {
    let seats = tip(sum, band, travel, slide_per_s, period_s);
    let mut scratch = vec![0.0; columns.samples];
    columns.filter(|column| {
        for (value, seat) in scratch.iter_mut().zip(&seats) {
            let share = seat.moved_at.fract();
            let at = seat.moved_at as usize;
            *value = if share > 0.0 { (1.0 - share) * column[at] + share * column[at + 1] } else { column[at] };
        }
        column.copy_from_slice(&scratch);
    });
    columns.push(false, |sample| seats[sample].behind);
}

/// The tip at every sample, for a pull on straight lines between samples. Jumps happen when the pull passes the band, not at the next
/// sample: all of them are of the same travel, and the tip's places lie on a ladder of that spacing whatever the speed.
fn tip(sum: &[f64], band: f64, travel: f64, slide_per_s: f64, period_s: f64) -> Vec<Seat> {
    let remaining = band - travel;
    let mut place = sum[0];
    let mut seat = Seat { moved_at: 0.0, behind: 0.0 };
    let mut sliding = false;
    let mut seats = Vec::with_capacity(sum.len());
    let mut last = sum[0];
    for (sample, &pull) in sum.iter().enumerate() {
        let step = pull - last;
        let fast = step.abs() > slide_per_s * period_s;
        let stretch = pull - place;
        let direction = stretch.signum();
        // It slides on while the pull goes on the same way fast enough.
        sliding = fast && (stretch.abs() > band || (sliding && step * seat.behind * remaining <= 0.0));
        if sliding {
            place = pull - direction * remaining;
            seat = Seat { moved_at: sample as f64, behind: -direction * remaining };
        } else if stretch.abs() > band {
            place += direction * travel * ((stretch.abs() - remaining) / travel).floor();
            let share = if step == 0.0 { 1.0 } else { ((place + direction * remaining - last) / step).clamp(0.0, 1.0) };
            seat = Seat { moved_at: (sample as f64 - 1.0 + share).max(0.0), behind: -direction * remaining };
        }
        seats.push(Seat { ..seat });
        last = pull;
    }
    seats
}

/// Travels of which the residual is a stair over the model's output, the likeliest first: the output on a ladder of places misses the
/// smooth output by a saw tooth of that period. The baseline has taken the tip's mean lag for hysteresis of its own, so the teeth stand
/// where its output passes the middle between two rungs, up and down alike.
fn travels(session: &Session, residual: &[Vec<f64>]) -> Vec<f64> {
    let runs: Vec<(Vec<f64>, &[f64])> = session
        .runs
        .iter()
        .filter(|run| run.role.contains(&Role::Fit))
        .map(|run| {
            let residual = residual[run.index].as_slice();
            (run.output.iter().zip(residual).map(|(output, residual)| output - residual).collect(), residual)
        })
        .collect();
    let power = |travel: f64| -> f64 {
        let turn = 2.0 * PI / travel;
        let each = runs.iter().map(|(sum, residual)| {
            let (mut re, mut im) = (0.0, 0.0);
            for (place, value) in sum.iter().zip(*residual) {
                let (sine, cosine) = (turn * (place - sum[0])).sin_cos();
                re += value * cosine;
                im += value * sine;
            }
            re * re + im * im
        });
        each.sum()
    };
    let ladder = ladder(0.008, 0.2, 160);
    let powers: Vec<f64> = ladder.iter().map(|&travel| power(travel)).collect();
    let mut peaks: Vec<(f64, f64)> = (1..ladder.len() - 1)
        .filter(|&at| powers[at] >= powers[at - 1] && powers[at] >= powers[at + 1])
        .map(|at| (powers[at], ladder[at]))
        .collect();
    peaks.sort_by(|x, y| y.0.total_cmp(&x.0));
    // Between the rungs of the ladder: an error in the travel adds up along the stairs.
    let sharpened = |&(_, travel): &(f64, f64)| {
        let near = (-6..=6).map(|step| travel * (1.0 + 0.003 * f64::from(step)));
        near.map(|travel| (power(travel), travel)).max_by(|x, y| x.0.total_cmp(&y.0)).map_or(travel, |found| found.1)
    };
    peaks.iter().take(4).map(sharpened).collect()
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
        // Half a travel is where the baseline's own hysteresis stands in for the lag; wider bands need it back.
        let wider = [0.5, 0.75, 1.1, 1.6, 2.5];
        travels(session, residual).into_iter().flat_map(|travel| wider.map(|wider| vec![travel * wider, travel])).collect()
    }
    fn step(&self, _: usize) -> f64 {
        0.02
    }
    fn needs_sum(&self) -> bool {
        true
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        stick(sum, parameters[0], parameters[1], f64::MAX, run.period_s, columns);
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
        let speeds = |travel: f64, wider: f64| [0.05, 0.2, 0.6].map(|speed| vec![travel * wider, travel, speed]);
        let of = |travel: f64| [0.5, 1.1, 1.8].into_iter().flat_map(move |wider| speeds(travel, wider));
        travels(session, residual).into_iter().take(3).flat_map(of).collect()
    }
    fn step(&self, _: usize) -> f64 {
        0.02
    }
    fn needs_sum(&self) -> bool {
        true
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        stick(sum, parameters[0], parameters[1], parameters[2], run.period_s, columns);
    }
    fn tell(&self, _: &[f64], weights: &[f64], _: &Session) -> BTreeMap<String, f64> {
        BTreeMap::from([("remaining_weight".to_owned(), weights[0])])
    }
}
