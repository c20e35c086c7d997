//! Inputs of several recordings led through the same filter side by side: none waits for its own last step.

use pulp::{Arch, Simd, WithSimd};

use crate::chain::columns::Filter;
use crate::data::session::Run;

/// Samples that are brought side by side at a time: they stay in the processor's first cache.
const BLOCK: usize = 32;

/// Sends the path of each recording through the filter that `of` makes for it. Recordings with the same filter go side by side; the result is the
/// same as one by one.
pub fn filter<const STATES: usize, F: Filter<STATES> + PartialEq>(runs: &[&Run], paths: &mut [Vec<f64>], of: impl Fn(&Run) -> F) {
    let filters: Vec<F> = runs.iter().map(|run| of(run)).collect();
    let Some(first) = filters.first() else { return };
    if paths.len() < 3 || filters.iter().any(|other| other != first) {
        for (path, filter) in paths.iter_mut().zip(&filters) {
            filter.run(path);
        }
        return;
    }
    let mut rest = paths;
    while !rest.is_empty() {
        let (group, others) = rest.split_at_mut(rest.len().min(24));
        rest = others;
        let (filter, arch) = (first, Arch::new());
        // With eight the compiler writes all lanes out, one after the other.
        match group.len() {
            ..=16 => arch.dispatch(Leading::<16, STATES, F> { filter, group }),
            _ => arch.dispatch(Leading::<24, STATES, F> { filter, group }),
        }
    }
}

/// Lets a form change its input by the filter that an expression makes of parameters and a recording.
macro_rules! leads_input {
    (|$form:ident, $parameters:ident, $run:ident| $filter:expr) => {
        fn input(&$form, $parameters: &[f64], $run: &Run, path: &mut [f64]) {
            $filter.run(path);
        }
        fn inputs(&$form, $parameters: &[f64], runs: &[&Run], paths: &mut [Vec<f64>]) {
            $crate::chain::side_by_side::filter(runs, paths, |$run| $filter);
        }
    };
}
pub(crate) use leads_input;

/// As many paths as there are `LANES`, or fewer, and what they go through.
struct Leading<'a, const LANES: usize, const STATES: usize, F> {
    filter: &'a F,
    group: &'a mut [Vec<f64>],
}

impl<const LANES: usize, const STATES: usize, F: Filter<STATES>> WithSimd for Leading<'_, LANES, STATES, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { filter, group } = self;
        // Lanes without a path repeat the first one's beginning.
        let mut rows = [[group[0][0]; LANES]; BLOCK];
        let begun: [[f64; STATES]; LANES] = std::array::from_fn(|lane| filter.begin(group.get(lane).unwrap_or(&group[0])[0]));
        let mut states: [[f64; LANES]; STATES] = std::array::from_fn(|state| begun.map(|lane| lane[state]));
        let longest = group.iter().map(Vec::len).fold(0, usize::max);
        for start in (0..longest).step_by(BLOCK) {
            for (lane, path) in group.iter().enumerate() {
                let part = path.get(start..).unwrap_or(&[]);
                rows.iter_mut().zip(part).for_each(|(row, value)| row[lane] = *value);
            }
            for row in &mut rows {
                for lane in 0..LANES {
                    let mut own: [f64; STATES] = std::array::from_fn(|state| states[state][lane]);
                    row[lane] = filter.step(&mut own, row[lane]);
                    (0..STATES).for_each(|state| states[state][lane] = own[state]);
                }
            }
            for (lane, path) in group.iter_mut().enumerate() {
                let part = path.get_mut(start..).unwrap_or(&mut []);
                part.iter_mut().zip(&rows).for_each(|(value, row)| *value = row[lane]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::data::session::{Run, Session};
    use crate::effects;
    use recording::{Recording, Signal};
    use std::path::Path;

    #[test]
    fn recordings_side_by_side_come_to_the_same_as_one_by_one() {
        let recordings: Vec<Recording> = (0..27_u32)
            .map(|number| {
                let time_s: Vec<f64> = (0..300 + 7 * number).map(|sample| f64::from(sample) * 0.02).collect();
                let wave = |time: &f64| (0.02 * f64::from(number) + 0.4 * time).sin().abs() + 0.02 * (9.0 * time).sin().abs();
                let input: Vec<f64> = time_s.iter().map(wave).collect();
                Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input)
                    .expect("a recording")
            })
            .collect();
        let session = Session::new(&recordings, &[]).expect("a session");
        let forms = [
            effects::leakage::FORMS,
            effects::fill_vent_asymmetry::FORMS,
            effects::pneumatic_lag::FORMS,
            effects::slew_limit::FORMS,
            effects::valve_dead_band::FORMS,
            effects::creep::FORMS,
            effects::resonance::FORMS,
        ];
        let mut changed = 0;
        for form in forms.concat().into_iter().filter(|form| form.leads_operators() && form.jumps().is_none()) {
            let residual: Vec<Vec<f64>> = session.runs.iter().map(|run| run.output.clone()).collect();
            let Some(parameters) = form.starts(&session, &residual).pop() else { continue };
            for count in [1, 3, 8, 13, 27] {
                let runs: Vec<&Run> = session.runs.iter().take(count).collect();
                let mut together: Vec<Vec<f64>> = runs.iter().map(|run| run.input.clone()).collect();
                form.inputs(&parameters, &runs, &mut together);
                for (run, together) in runs.iter().zip(&together) {
                    let mut alone = run.input.clone();
                    form.input(&parameters, run, &mut alone);
                    assert_eq!(&alone, together, "{}, {}: {count} recordings", form.name(), form.form());
                    changed += usize::from(alone != run.input);
                }
            }
        }
        assert!(changed > 500, "{changed} paths were changed");
    }
}
