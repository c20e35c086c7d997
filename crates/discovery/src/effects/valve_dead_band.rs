//! `valve-dead-band`: the pressure holds until the error passes the band, then the valve opens and follows until little error is left; or a
//! spool with overlap passes nothing inside the band and in proportion to what goes beyond it.

use crate::chain::columns::Filter;
use crate::chain::filters::{ladder, lag_coefficients};
use crate::chain::form::{Drive, Form, Parameter, Place, Quantity, Spec};
use crate::chain::side_by_side::leads_input;
use crate::chain::steps::{Steps, agreement, best_place};
use crate::data::session::{Run, Session};
use crate::effects::pneumatic_lag;
use crate::effects::sticking::Sticking;

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Follow, &Overlap, &SEEN];

struct Follow;

struct Overlap;

/// Jumps that no simulation meets, because errors of one add up to the next; where the pressure stands is read from the output seen so far.
static SEEN: Sticking = Sticking {
    name: "valve-dead-band",
    form: ("seen", "holds and opens, its pressure seen in the output"),
    drive: Drive::Command,
    feels: false,
};

/// Moments inside a sample at which the valve looks. Between them it is exact for a command on a straight line.
const LOOKS: usize = 2;

/// A valve that opens at `band` and closes again at `closing`; the pressure stands `begin` above the command at first.
fn follow(path: &mut [f64], begin: f64, [band, closing, flow_s]: [f64; 3], period_s: f64) {
    let step_s = period_s / LOOKS as f64;
    let keep = (-step_s / flow_s).exp();
    let mut state = path[0] + begin;
    let mut last = path[0];
    let mut open = false;
    for value in path {
        // A shut valve stays shut on a straight line whose two ends are within the band.
        if !open && (last - state).abs() <= band && (*value - state).abs() <= band {
            last = *value;
            *value = state;
            continue;
        }
        let begin = last;
        for look in 1..=LOOKS {
            let wanted = begin + (*value - begin) * look as f64 / LOOKS as f64;
            let rate = (wanted - last) / step_s;
            let mut error = last - state;
            let (mut left_s, mut decay) = (step_s, keep);
            if !open && (wanted - state).abs() > band {
                // The moment of opening, on the straight line between looks.
                let share = ((band - error.abs()) / ((wanted - state).abs() - error.abs()).max(1e-12)).clamp(0.0, 1.0);
                error += (wanted - state - error) * share;
                left_s = step_s * (1.0 - share);
                decay = (-left_s / flow_s).exp();
                open = true;
            }
            if open {
                // Exact for a command on a straight line.
                let after = rate * flow_s + (error - rate * flow_s) * decay;
                if after.abs() < closing {
                    // The moment of closing, on the exponential.
                    let (drag, aim) = (rate * flow_s, closing.copysign(error));
                    let spent_s = if error.abs() <= closing { 0.0 } else { flow_s * ((error - drag) / (aim - drag)).ln() };
                    let error = if error.abs() <= closing { error } else { aim };
                    state = wanted - rate * (left_s - spent_s.clamp(0.0, left_s)) - error;
                    open = false;
                } else {
                    state = wanted - after;
                }
            }
            last = wanted;
        }
        *value = state;
    }
}

impl Form for Follow {
    fn spec(&self) -> Spec {
        Spec {
            // The travel decides when the next jump comes, and the one after it: an error in it adds up along the limit-cycle staircases, one in the band
            // does not. As parameters of their own the two are searched along the axes of the valley.
            parameters: &[
                Parameter { name: "band", quantity: Quantity::Input, low: 2e-3, high: 0.5, logarithmic: true },
                Parameter { name: "travel", quantity: Quantity::Input, low: 1e-3, high: 0.5, logarithmic: true },
                Parameter { name: "flow_time_constant", quantity: Quantity::Time, low: 1e-3, high: 0.3, logarithmic: true },
            ],
            steps: &[0.02, 0.01, 0.1],
            across: Some(1),
            ..Spec::new("valve-dead-band", ("follows", "opens at the band, follows, closes"), Place::Supply)
        }
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let steps = Steps::new(session, residual, |run| run.input.clone());
        let from = |parameters: &[f64], share: f64, run: &Run, path: &mut [f64]| {
            follow(path, share * parameters[0], law(parameters), run.period_s);
        };
        let ways = [0.0, 0.999, -0.999];
        let best = |grid: Vec<Vec<f64>>| steps.best(grid.into_iter(), &ways, from);
        // A valve that closes with no error left is a fast one.
        let kinds = [(1.005, 0.004), (1.05, 0.02), (1.11, 0.02), (1.18, 0.02), (1.26, 0.02), (1.36, 0.02), (1.5, 0.02), (1.7, 0.02)];
        let of = |travel: f64| kinds.map(|(wider, flow_s)| vec![travel * wider, travel, flow_s]);
        let travels = best(ladder(0.008, 0.2, 150).into_iter().flat_map(of).collect());
        // Band and travel decide when it jumps, the flow how.
        let of = |start: Vec<f64>| [0.004, 0.02, 0.06].map(|flow_s| vec![start[0], start[1], flow_s]);
        let near = best(travels.into_iter().flat_map(of).collect());
        // What a wide band holds back the operators have taken for hysteresis of their own: it shows in what they leave with it, not without.
        let flows = |band: f64, travel: f64| ladder(0.006, 0.08, 7).into_iter().map(move |flow_s| vec![band, travel, flow_s]);
        let of = |travel: f64| [1.03, 1.15, 1.35, 1.7].into_iter().flat_map(move |wider| flows(travel * wider, travel));
        [near, steps.explaining(ladder(0.03, 0.3, 16).into_iter().flat_map(of), &ways, from)].concat()
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let law = law(parameters);
        follow(path, begin(law, run, path), law, run.period_s);
    }
}

/// Errors at which the valve opens and closes, and the time constant of its flow, s.
fn law(parameters: &[f64]) -> [f64; 3] {
    [parameters[0], (parameters[0] - parameters[1]).max(0.005 * parameters[0]), parameters[2]]
}

/// Places on either side of the command at which the pressure is tried first, and then twice finer ones about the best.
const PLACES: i32 = 6;

/// How far from the command the pressure stood when the recording began: anywhere within the band, by what was done before, and the whole
/// limit-cycle staircase hangs on it. Nothing but the recording itself knows: it is the place at which a few operators behind the valve leave least. Where
/// there is no measured output (a simulation) the pressure begins at the command.
fn begin(law: [f64; 3], run: &Run, path: &[f64]) -> f64 {
    if run.output.iter().all(|value| *value == 0.0) {
        return 0.0;
    }
    let mut scratch = path.to_vec();
    let agreement = |begin_at: f64| {
        scratch.copy_from_slice(path);
        follow(&mut scratch, begin_at, law, run.period_s);
        agreement(&scratch, run)
    };
    let spacing = law[0] / f64::from(PLACES);
    let away = (-PLACES..=PLACES).filter(|place| *place != 0).map(|place| spacing * f64::from(place) * 0.999);
    best_place(std::iter::once(0.0).chain(away), spacing, 2, agreement)
}

impl Form for Overlap {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "band", quantity: Quantity::Input, low: 2e-3, high: 0.3, logarithmic: true },
                Parameter { name: "flow_time_constant", quantity: Quantity::Time, low: 5e-3, high: 1.0, logarithmic: true },
            ],
            starts: || [0.01, 0.03, 0.08].into_iter().flat_map(|band| [vec![band, 0.03], vec![band, 0.1], vec![band, 0.3]]).collect(),
            ..Spec::new("valve-dead-band", ("overlap", "flow in proportion to the error beyond the band"), Place::Supply)
        }
    }
    fn nested_limits(&self, parameters: &[f64]) -> Vec<(&'static dyn Form, Vec<f64>)> {
        if parameters[0] < HARDLY_OVERLAPS { vec![(pneumatic_lag::FORMS[0], vec![parameters[1]])] } else { Vec::new() }
    }
    leads_input!(|self, parameters, run| Edge { band: parameters[0], lag: lag_coefficients(parameters[1], run.period_s) });
}

/// Band up to which a lag is tried in the place of the overlap.
const HARDLY_OVERLAPS: f64 = 0.01;

/// What [`Overlap`] does to the input: a lag behind the nearer edge of the band, which is where the pressure stands while it is inside.
#[derive(PartialEq)]
struct Edge {
    band: f64,
    /// Coefficients of the lag.
    lag: (f64, f64, f64),
}

impl Filter<2> for Edge {
    fn begin(&self, first: f64) -> [f64; 2] {
        [first; 2]
    }
    #[inline(always)]
    fn step(&self, [state, last]: &mut [f64; 2], value: f64) -> f64 {
        let (keep, now, before) = self.lag;
        let held = *state;
        let edge = |command: f64| held.max(command - self.band).min(command + self.band);
        *state = keep * held + now * edge(value) + before * edge(*last);
        *last = value;
        *state
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::closed_form::deviates;
    use recording::{Recording, Signal};
    use std::path::Path;

    #[test]
    fn the_search_for_a_valve_begins_near_its_law_even_where_something_slow_is_missing_too() {
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> =
            time_s.iter().map(|time| 0.5 - 0.3 * (1.7 * std::f64::consts::PI * time).cos() - 0.2 * (2.9 * time).cos()).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        let law = [0.05, 0.045, 0.02];
        let (mut held, mut late) = (run.input.clone(), run.input.clone());
        follow(&mut held, 0.0, super::law(&law), run.period_s);
        crate::chain::filters::lag(&mut late, 0.1, run.period_s);
        // By all that is missed, and by what of it is not merely slow: the former is lost where much is.
        for (share, by_all) in [(0.0, true), (2.0, false)] {
            let of = |((held, late), command): ((&f64, &f64), &f64)| held - command + share * (late - command);
            let residual = vec![held.iter().zip(&late).zip(&run.input).map(of).collect()];
            let starts = Follow.starts(&session, &residual);
            let near = |start: &Vec<f64>| (start[0] / law[0]).ln().abs() < 0.15 && (start[1] / law[1]).ln().abs() < 0.1;
            let [of_all, of_the_rest] = [&starts[..12], &starts[12..]].map(|half| half.iter().any(near));
            assert!(of_all == by_all && of_the_rest, "{share}: {starts:?}");
        }
    }

    /// Decaying sines of a muscle that remembers, behind a valve whose pressure begins at the command.
    fn behind_a_valve([band, closing, flow_s]: [f64; 3], count: usize) -> Vec<Recording> {
        const STEPS: u32 = 100;
        let mut noise = deviates(0x51_7CC1);
        let mut plays = [(0.03, 0.4, 0.0), (0.1, 0.3, 0.0), (0.28, 0.3, 0.0), (0.42, 0.2, 0.0)];
        let mut record = |index: usize| {
            let (frequency_hz, top) = ([0.15, 0.3, 0.45, 0.6][index % 4], [1.0, 0.8, 0.9, 0.7, 0.6][index % 5]);
            let command = |time_s: f64| 0.5 * top * (1.0 - (std::f64::consts::TAU * frequency_hz * time_s).cos()) * (-0.1 * time_s).exp();
            let (mut pressure, mut open) = (0.0, false);
            let (mut times, mut inputs, mut outputs) = (Vec::new(), Vec::new(), Vec::new());
            for step in 0..600 * STEPS {
                let time_s = 0.02 * f64::from(step) / f64::from(STEPS);
                let error = command(time_s) - pressure;
                open = if open { error.abs() > closing } else { error.abs() > band };
                pressure += if open { error * 0.02 / f64::from(STEPS) / flow_s } else { 0.0 };
                plays
                    .iter_mut()
                    .for_each(|(threshold, _, state)| *state = f64::clamp(*state, pressure - *threshold, pressure + *threshold));
                if step % STEPS == 0 {
                    let place: f64 = plays.iter().map(|(_, weight, state)| weight * *state).sum();
                    times.push(time_s);
                    inputs.push(command(time_s));
                    outputs.push(place + 0.005 * noise());
                }
            }
            let path = format!("run{index:02}.csv");
            Recording::new(Path::new(&path), Signal::pressure_bar(), Signal::displacement_mm(), times, inputs, outputs)
                .expect("a recording")
        };
        (0..count).map(&mut record).collect()
    }

    #[test]
    fn a_plain_valve_with_a_wide_band_is_simulated_on_decaying_sines() {
        let recordings = behind_a_valve([0.15, 0.015, 0.03], 16);
        let (fitted, kept) = recordings.split_at(12);
        let discovery = crate::discover(fitted, kept, &crate::DiscoverConfig::default()).expect("a finding").discovery;
        let names: Vec<&str> = discovery.effects.iter().map(|effect| effect.name.as_str()).collect();
        assert_eq!(names, ["valve-dead-band"], "{discovery:?}");
        assert!(discovery.effects[0].confidence > 0.9 && discovery.gap_closed > 0.9, "{discovery:?}");
        let band = discovery.effects[0].parameters["band_bar"];
        assert!((band / 0.15 - 1.0).abs() < 0.03, "{band}");
    }

    #[test]
    fn a_spool_with_overlap_holds_inside_the_band_and_follows_beyond_it() {
        let (band, flow_s) = (0.05, 0.1);
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = time_s.iter().map(|time| 0.5 - 0.5 * (2.0 * std::f64::consts::PI * 0.5 * time).cos()).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        let mut path = run.input.clone();
        Overlap.input(&[band, flow_s], run, &mut path);
        let mut state = run.input[0];
        for (sample, value) in path.iter().enumerate().skip(1) {
            for look in 0..2000 {
                let share = (f64::from(look) + 0.5) / 2000.0;
                let error = run.input[sample - 1] + share * (run.input[sample] - run.input[sample - 1]) - state;
                state += 1e-5 / flow_s * (error - error.clamp(-band, band));
            }
            assert!((value - state).abs() < 2e-3, "sample {sample}: {value} and {state}");
        }
    }
}
