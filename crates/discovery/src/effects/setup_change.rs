//! `setup-change`: load, pose or sensor were changed: zero and gain step between two recordings, or inside one.

use std::collections::BTreeMap;

use crate::chain::columns::Columns;
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec, Told};
use crate::data::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&ONCE, &TWICE, &Inside];

/// Steps between recordings.
struct Between {
    form: Told,
    parameters: &'static [Parameter],
}

/// A step inside a recording.
struct Inside;

const FROM: Parameter = Parameter { name: "from_recording", quantity: Quantity::Ratio, low: 0.5, high: 1e4, logarithmic: false };

static ONCE: Between = Between { form: ("one-step", "zero and gain step between two recordings"), parameters: &[FROM] };

static TWICE: Between = Between {
    form: ("two-steps", "zero and gain step between recordings twice"),
    parameters: &[FROM, Parameter { name: "again_from_recording", ..FROM }],
};

/// Adds a zero and a gain from where `after` holds.
fn push_step(columns: &mut Columns, sum: &[f64], after: impl Fn(usize) -> bool) {
    let share = |sample| if after(sample) { 1.0 } else { 0.0 };
    columns.push(true, share);
    columns.push(true, |sample| share(sample) * sum[sample]);
}

/// Shift and gain of every step.
fn tell(weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
    let of = |(step, of): (&[f64], &str)| {
        [(format!("{of}shift_{}", session.output_unit), step[0] * session.output_scale), (format!("{of}gain"), 1.0 + step[1])]
    };
    weights.chunks_exact(2).zip(["", "second_"]).flat_map(of).collect()
}

impl Form for Between {
    fn spec(&self) -> Spec {
        Spec {
            parameters: self.parameters,
            weights: 2 * self.parameters.len(),
            discrete: true,
            is_between_recordings: true,
            needs_sum: true,
            ..Spec::new("setup-change", self.form, Place::Sensor)
        }
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let mut sums = vec![[0.0; 6]; session.runs.len()];
        for (run, sums) in session.runs.iter().zip(&mut sums) {
            (0..run.input.len()).for_each(|sample| add(sums, run, &residual[run.index], sample));
        }
        let all = |part: &[Sums]| part.iter().fold([0.0; 6], |all, one| std::array::from_fn(|at| all[at] + one[at]));
        // Test recordings have no say, so a change among them is put in front of the first: on which side of it they are is not known.
        let firsts: Vec<usize> = (1..session.runs.len()).filter(|&first| session.runs[first - 1].is_worked_with()).collect();
        let second = |&first: &usize| match self.parameters.len() {
            1 => vec![vec![first]],
            _ => firsts.iter().filter(|second| **second > first).map(|&second| vec![first, second]).collect(),
        };
        let place = |places: Vec<usize>| {
            let ends = places.iter().copied().chain([sums.len()]);
            let energy =
                std::iter::once(0).chain(places.iter().copied()).zip(ends).map(|(first, end)| line_residual(&all(&sums[first..end])));
            (energy.sum(), places.iter().map(|&first| first as f64 - 0.5).collect())
        };
        // Weights that have taken some of a step for gain or hysteresis make other pairs look better than the true one.
        best(firsts.iter().flat_map(second).map(place).collect(), if self.parameters.len() == 1 { 4 } else { 12 })
    }
    fn changes_at<'a>(&self, parameters: &'a [f64]) -> &'a [f64] {
        parameters
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        parameters.iter().for_each(|from| push_step(columns, sum, |_| run.index as f64 > *from));
    }
    fn tell(&self, _: &[f64], weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        tell(weights, session)
    }
}

/// How far from either end of a recording a step is inside it, s.
const INSIDE_S: f64 = 1.0;

/// Samples of which the best place of a step is tried.
const STRETCH: usize = 100;

impl Form for Inside {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[Parameter { name: "at", quantity: Quantity::Time, low: 0.0, high: 1e7, logarithmic: false }],
            weights: 2,
            discrete: true,
            needs_sum: true,
            ..Spec::new("setup-change", ("inside-a-recording", "zero and gain step inside a recording"), Place::Sensor)
        }
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let mut before = [0.0; 6];
        let mut places: Vec<(Sums, f64)> = Vec::new();
        for run in session.worked() {
            let end_s = run.time_s[run.time_s.len() - 1] - INSIDE_S;
            for sample in 0..run.input.len() {
                add(&mut before, run, &residual[run.index], sample);
                if run.role[sample].is_worked_with() && (INSIDE_S..end_s).contains(&run.time_s[sample]) {
                    places.push((before, run.session_s[sample]));
                }
            }
        }
        let energy = |(first, _): &(Sums, f64)| line_residual(first) + line_residual(&std::array::from_fn(|at| before[at] - first[at]));
        let of = |stretch: &[(Sums, f64)]| stretch.iter().map(|place| (energy(place), vec![place.1])).min_by(|x, y| x.0.total_cmp(&y.0));
        best(places.chunks(STRETCH).filter_map(of).collect(), 4)
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        push_step(columns, sum, |sample| run.session_s[sample] > parameters[0]);
    }
    fn tell(&self, _: &[f64], weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        tell(weights, session)
    }
}

/// So many places that divide the session best.
fn best(mut places: Vec<(f64, Vec<f64>)>, count: usize) -> Vec<Vec<f64>> {
    places.sort_by(|x, y| x.0.total_cmp(&y.0));
    places.into_iter().take(count).map(|place| place.1).collect()
}

/// Sums for a line of the residual over the model's output: 1, x, x^2, r, x r, r^2.
type Sums = [f64; 6];

/// Adds a sample; test recordings have no say.
fn add(sums: &mut Sums, run: &Run, residual: &[f64], sample: usize) {
    if run.keep[sample] && run.role[sample].is_worked_with() {
        let r = residual[sample];
        let x = run.output[sample] - r;
        sums.iter_mut().zip([1.0, x, x * x, r, x * r, r * r]).for_each(|(sum, value)| *sum += value);
    }
}

/// What the best line leaves of the residual's energy.
fn line_residual(&[count, x, xx, r, xr, rr]: &Sums) -> f64 {
    if count < 1.0 {
        return 0.0;
    }
    let (spread, common) = (xx - x * x / count, xr - x * r / count);
    let slope_part = if spread > 1e-12 { common * common / spread } else { 0.0 };
    rr - r * r / count - slope_part
}

#[cfg(test)]
mod tests {
    use super::*;
    use recording::{Recording, Signal};
    use std::path::Path;
    use virtual_rig::{self as rig, CaseConfig, Generator};

    use crate::model::initial_state::InitialState;
    use crate::model::structure::{Model, Scope};

    #[test]
    fn a_step_inside_a_recording_is_found_to_the_sample() {
        let of = |number: u32| {
            let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
            let input: Vec<f64> = time_s.iter().map(|time| 0.5 - 0.5 * ((1.0 + 0.3 * f64::from(number)) * time).cos()).collect();
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input)
        };
        for (count, at_s) in [(1, 13.37), (4, 47.11)] {
            let recordings: Vec<Recording> = (0..count).map(|number| of(number).expect("a recording")).collect();
            // Too few recordings to keep any out, so all but every sixth block of them is worked with.
            let session = Session::new(&recordings, &recordings[..1]).expect("a session");
            let step = |run: &Run| -> Vec<f64> {
                let after = |at: usize| if run.session_s[at] > at_s { 0.05 + 0.1 * run.output[at] } else { 0.0 };
                (0..run.input.len()).map(after).collect()
            };
            let residual: Vec<Vec<f64>> = session.runs.iter().map(step).collect();
            let starts = Inside.starts(&session, &residual);
            assert!((starts[0][0] - at_s).abs() <= 0.02, "{at_s} s: {starts:?}");
            let run = session.runs.iter().find(|run| run.session_s.contains(&starts[0][0])).expect("its recording");
            let mut columns = Columns::of(run.input.len());
            Inside.output(&starts[0], run, &run.output, &mut columns);
            let [zero, gain] = [0, 1].map(|weight| columns.column(weight));
            for (at, time_s) in run.session_s.iter().enumerate() {
                let after = if *time_s > starts[0][0] { 1.0 } else { 0.0 };
                assert_eq!((zero[at], gain[at]), (after, after * run.output[at]), "at {time_s} s");
            }
        }
    }

    #[test]
    fn two_changes_are_among_what_is_tried_though_the_operators_have_taken_some_of_them() {
        for excitation in [rig::Excitation::Paper, rig::Excitation::Rich] {
            let effects = vec!["setup-change".to_owned()];
            let config =
                CaseConfig { effects, seed: 6001, generator: Generator::ComposedTuning, excitation, noise: 0.005, ..CaseConfig::default() };
            let case = rig::hide(&config).expect("a case");
            let session = Session::new(&case.recordings, &case.kept_out).expect("a session");
            let mut bare = Model::baseline(InitialState::carrying(case.truth.continuous), false);
            bare.fit(&session, Scope::Fit);
            let left = |start: Vec<f64>| bare.with(&TWICE, start).fit(&session, Scope::Both).0;
            let least = TWICE.starts(&session, &bare.residuals(&session)).into_iter().map(left).fold(f64::INFINITY, f64::min);
            // The noise is half a percent of the span; the coarse grid of operators leaves a little beside it.
            assert!(least < 2.0 * 0.005 * 0.005, "{excitation:?}: {least}");
        }
    }
}
