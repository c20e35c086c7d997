//! `valve-dead-band`: the pressure holds until the error passes the band, then the valve opens and follows until little error is left; or a
//! spool with overlap passes nothing inside the band and in proportion to what goes beyond it.

use crate::chain::columns::Filter;
use crate::chain::filters::{ladder, lag_coefficients};
use crate::chain::form::{Drive, Form, Parameter, Place, Quantity, Spec, Told};
use crate::chain::side_by_side::leads_input;
use crate::chain::steps::{Steps, agreement, best_place};
use crate::chain::valve::Valve;
use crate::data::session::{Run, Session};
use crate::effects::pneumatic_lag;
use crate::effects::sticking::Sticking;
use crate::observers::law::{LEAST_FLOW, NEVER};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Follow { limited: false }, &Follow { limited: true }, &Overlap, &SEEN];

struct Follow {
    /// Whether so much passes through it and no more.
    limited: bool,
}

struct Overlap;

/// Jumps that no simulation meets, because errors of one add up to the next; where the pressure stands is read from the output seen so far.
static SEEN: Sticking = Sticking {
    name: "valve-dead-band",
    form: ("seen", "holds and opens, its pressure seen in the output"),
    drive: Drive::Command,
    feels: false,
};

/// Length of the stretches whose steps a valve is matched with, s: within one an error of the law hardly adds up.
const STRETCH_S: f64 = 1.2;

/// Best laws of a grid that a search begins at, each with another travel.
const TRAVELS: usize = 8;

const BAND: Parameter = Parameter { name: "band", quantity: Quantity::Input, low: 2e-3, high: 0.5, logarithmic: true };

const TRAVEL: Parameter = Parameter { name: "travel", quantity: Quantity::Input, low: 1e-3, high: 0.5, logarithmic: true };

const FLOW: Parameter = Parameter { name: "flow_time_constant", quantity: Quantity::Time, low: 1e-3, high: 0.3, logarithmic: true };

const MOST: Parameter = Parameter { name: "most_flow", quantity: Quantity::InputRate, low: LEAST_FLOW, high: 100.0, logarithmic: true };

const FOLLOWING: Told = ("follows", "opens at the band, follows, closes");

const AT_A_RATE: Told = ("at-a-rate", "opens at the band, lets through so much, closes");

impl Form for Follow {
    fn spec(&self) -> Spec {
        Spec {
            // The travel decides when the next jump comes, and the one after it: an error in it adds up along the limit-cycle staircases, one in the band
            // does not. As parameters of their own the two are searched along the axes of the valley.
            parameters: if self.limited { &[BAND, TRAVEL, MOST] } else { &[BAND, TRAVEL, FLOW] },
            steps: &[0.02, 0.02, 0.05],
            is_narrow: true,
            reads_output: true,
            ..Spec::new("valve-dead-band", if self.limited { AT_A_RATE } else { FOLLOWING }, Place::Supply)
        }
    }
    fn start_up_s(&self, _: &[f64]) -> f64 {
        START_UP_S
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let samples = (STRETCH_S / session.runs[0].period_s) as usize;
        let steps = Steps::in_stretches(session, residual, |run| run.input.clone(), samples);
        let stretches: Vec<(usize, &Run, f64)> = steps.runs().map(|(at, run, _)| (at, run, steps.missed(at))).collect();
        // How likely what is missed is when as much of a valve's steps as goes with it best is taken away, stretch by stretch: in each the pressure begins
        // somewhere in the band.
        let score = |parameters: &[f64]| -> f64 {
            let valve = self.law(parameters);
            let of = |&(at, run, missed): &(usize, &Run, f64)| {
                let taken = PLACES.map(|place| {
                    let begun = |_: &Run, path: &mut [f64]| valve.lead(path, path[0] + place * valve.band, run.period_s);
                    let (cross, energy) = steps.matched(at, begun)[1];
                    cross.max(0.0).powi(2) / energy / missed.max(1e-30)
                });
                -(1.0 - taken.into_iter().fold(0.0, f64::max).min(0.999)).ln()
            };
            stretches.iter().map(of).sum()
        };
        let kinds = if self.limited { &[2.5, 4.0, 6.0, 9.0][..] } else { &[0.004, 0.01, 0.016, 0.024, 0.034, 0.048] };
        let of = |travel: f64, wider: f64| kinds.iter().map(move |kind| vec![wider * travel, travel, *kind]);
        let of = |travel: f64| [1.05, 1.15, 1.3, 1.55].into_iter().flat_map(move |wider| of(travel, wider));
        let mut grid: Vec<(f64, Vec<f64>)> = ladder(0.008, 0.2, 48).into_iter().flat_map(of).map(|point| (score(&point), point)).collect();
        grid.sort_by(|x, y| y.0.total_cmp(&x.0));
        let mut best: Vec<Vec<f64>> = Vec::new();
        for (_, one) in grid {
            if best.len() < TRAVELS && best.iter().all(|other| (other[1] / one[1]).ln().abs() > 0.15) {
                best.push(one);
            }
        }
        best
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let valve = self.law(parameters);
        let place = shown_place(&valve, run, path);
        valve.lead(path, path[0] + place * valve.band, run.period_s);
    }
}

impl Follow {
    /// The valve with these parameters.
    fn law(&self, parameters: &[f64]) -> Valve {
        let &[band, travel, kind] = parameters else { unreachable!("the forms have three parameters") };
        let (flow_s, most_flow) = if self.limited { (FLOW.low, kind) } else { (kind, NEVER) };
        Valve { band, closing: (band - travel).max(0.005 * band), flow_s, most_flow }
    }
}

/// What comes nearest to a valve in the simulated forms.
pub fn nearest(valve: &Valve) -> [(&'static dyn Form, Vec<f64>); 2] {
    [(FORMS[0], valve.flow_s), (FORMS[1], valve.most_flow.min(1.0 / valve.flow_s))].map(|(form, flow)| {
        let parameters = form.parameters().iter().zip([valve.band, valve.band - valve.closing, flow]);
        (form, parameters.map(|(parameter, value)| value.clamp(parameter.low, parameter.high)).collect())
    })
}

/// Where in the band, -1 to 1, the pressure is when a recording begins: on the side from which the command came, where that is known, and there after which
/// a few operators of what the valve makes of the command leave least of the output that its start-up measured. Where there is no measured output (a
/// simulation) it is the command.
fn shown_place(valve: &Valve, run: &Run, path: &[f64]) -> f64 {
    let shown = &path[..path.len().min((START_UP_S / run.period_s) as usize)];
    if run.output.iter().all(|value| *value == 0.0) {
        return 0.0;
    }
    let mut led = shown.to_vec();
    let agreement = |place: f64| {
        led.copy_from_slice(shown);
        valve.lead(&mut led, shown[0] + place * valve.band, run.period_s);
        agreement(&led, run)
    };
    let turns = run.earlier.as_ref().map_or(&run.history, |earlier| &earlier.turns);
    let side = turns.iter().rev().map(|turn| turn - shown[0]).find(|way| way.abs() > 0.5 * valve.band).map(f64::signum);
    let on_side = |place: f64| side.map_or(place, |side| 0.5 * (place + side));
    let spacing = on_side(PLACES[1]) - on_side(PLACES[0]);
    best_place(PLACES.map(on_side).into_iter(), spacing, REFINEMENTS, agreement).clamp(-1.0, 1.0)
}

/// Places in the band at which the pressure of a stretch may begin, and how often the best is made three times as fine.
const PLACES: [f64; 5] = [-0.8, -0.4, 0.0, 0.4, 0.8];
const REFINEMENTS: usize = 3;

/// Seconds of a recording that show where in the band its pressure begins.
const START_UP_S: f64 = 4.0;

impl Form for Overlap {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "band", quantity: Quantity::Input, low: 2e-3, high: 0.3, logarithmic: true },
                Parameter { name: "flow_time_constant", quantity: Quantity::Time, low: 5e-3, high: 1.0, logarithmic: true },
            ],
            starts: || [0.01, 0.03, 0.08].into_iter().flat_map(|band| [vec![band, 0.03], vec![band, 0.1], vec![band, 0.3]]).collect(),
            nested_limits: |of| if of[0] < HARDLY_OVERLAPS { vec![(pneumatic_lag::FORMS[0], vec![of[1]])] } else { Vec::new() },
            ..Spec::new("valve-dead-band", ("overlap", "flow in proportion to the error beyond the band"), Place::Supply)
        }
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
    use crate::model::initial_state::InitialState;
    use crate::model::structure::{Model, Scope};
    use crate::search::cross_entropy;
    use crate::tests::deviates;
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
        // One that follows, and one that lets through so much and no more.
        for (form, law) in [(FORMS[0], [0.05, 0.045, 0.02]), (FORMS[1], [0.05, 0.045, 5.0])] {
            let (mut held, mut late) = (run.input.clone(), run.input.clone());
            form.input(&law, run, &mut held);
            crate::chain::filters::lag(&mut late, 0.1, run.period_s);
            for share in [0.0, 2.0] {
                let of = |((held, late), command): ((&f64, &f64), &f64)| held - command + share * (late - command);
                let residual = vec![held.iter().zip(&late).zip(&run.input).map(of).collect()];
                let starts = form.starts(&session, &residual);
                let off = |start: &Vec<f64>, at: usize| (start[at] / law[at]).ln().abs();
                let near = |start: &Vec<f64>| off(start, 0) < 0.15 && off(start, 1) < 0.1 && off(start, 2) < 0.6;
                assert!(starts.iter().any(near), "{share}: {starts:?}");
            }
        }
    }

    /// Decaying sines of a muscle that remembers, behind a valve whose pressure begins so far above the command.
    fn behind_a_valve([band, closing, flow_s]: [f64; 3], above: &[f64], count: usize) -> Vec<Recording> {
        const STEPS: u32 = 100;
        let mut noise = deviates(0x51_7CC1);
        let mut plays = [(0.03, 0.4, 0.0), (0.1, 0.3, 0.0), (0.28, 0.3, 0.0), (0.42, 0.2, 0.0)];
        let mut record = |index: usize| {
            let (frequency_hz, top) = ([0.15, 0.3, 0.45, 0.6][index % 4], [1.0, 0.8, 0.9, 0.7, 0.6][index % 5]);
            let command = |time_s: f64| 0.5 * top * (1.0 - (std::f64::consts::TAU * frequency_hz * time_s).cos()) * (-0.1 * time_s).exp();
            let (mut pressure, mut open) = (above[index % above.len()], false);
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

    /// A session of these with nothing kept out, and the law of the valve in its units.
    fn session_behind(law: [f64; 3], above: &[f64]) -> (Session, Valve) {
        let recordings = behind_a_valve(law, above, 12);
        let (fitted, kept) = recordings.split_at(10);
        let session = Session::new(fitted, kept).expect("a session");
        let of = |pressure: f64| pressure / session.input_scale;
        let valve = Valve { band: of(law[0]), closing: of(law[1]), flow_s: law[2], most_flow: NEVER };
        (session, valve)
    }

    #[test]
    fn the_pressure_that_a_recording_begins_at_is_read_from_its_start_up_and_from_nothing_behind() {
        let above = [0.03, 0.06, 0.09, 0.12, 0.14];
        let (session, valve) = session_behind([0.15, 0.015, 0.03], &above);
        let mut off = Vec::new();
        for run in session.runs.iter().filter(|run| run.index > 0 && run.is_worked_with()) {
            let place = shown_place(&valve, run, &run.input);
            off.push((place - above[run.index % above.len()] / 0.15).abs());
            let mut other = run.clone();
            let behind = (START_UP_S / run.period_s) as usize;
            other.output[behind..].iter_mut().for_each(|value| *value = 1.0 - *value);
            assert_eq!(shown_place(&valve, &other, &other.input).to_bits(), place.to_bits());
            // Nothing is measured: it begins at the command.
            other.output.fill(0.0);
            assert!(shown_place(&valve, &other, &other.input).abs() < 1e-12);
        }
        // Where a stroke is fast, the moment of its first opening says little.
        off.sort_by(f64::total_cmp);
        assert!(off[off.len() / 2] < 0.08 && off[off.len() - 1] < 0.4, "{off:?}");
    }

    #[test]
    fn the_law_of_a_valve_is_found_from_afar_though_its_valley_is_narrow() {
        let (session, valve) = session_behind([0.15, 0.015, 0.03], &[0.05, 0.1]);
        let base = Model::baseline(InitialState::SESSION, false);
        let law = [valve.band, valve.band - valve.closing, valve.flow_s];
        let off = [[0.93, 0.9, 1.4], [1.08, 1.06, 0.7], [0.9, 1.0, 1.0]];
        let begun = off.map(|off| base.with(FORMS[0], (0..3).map(|at| law[at] * off[at]).collect()));
        let found = cross_entropy::search(&begun, f64::INFINITY, &session, 2).expect("a law");
        // The time constant makes up for the closing, the travel and the band are what counts.
        for (found, law) in found.slots[0].parameters.iter().zip(law.into_iter().zip([0.01, 0.01, 0.1])) {
            assert!((found / law.0).ln().abs() < law.1, "{found} for {}", law.0);
        }
        let left = |model: &Model| model.clone().fit(&session, Scope::Fit).0.sqrt();
        assert!(left(&found) < 1.15 * 0.005 / session.output_scale.abs(), "{}", left(&found));
        assert!(begun.iter().all(|model| left(model) > 2.0 * left(&found)));
    }

    #[test]
    fn a_plain_valve_with_a_wide_band_is_simulated_on_decaying_sines() {
        let recordings = behind_a_valve([0.15, 0.015, 0.03], &[0.0], 16);
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
