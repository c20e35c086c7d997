//! Down to the nearest minimum: Gauss and Newton's steps with the weights solved inside, and the simplex where these come to nothing.
//!
//! What a model's output changes by with each of its parameters goes beside its columns; the weights of these further columns are how
//! far each parameter has to go (variable projection by Kaufman 1975: what the other weights do on the way is of second order). Where the
//! output follows its parameters smoothly that takes a handful of steps, next to twenty evaluations for each parameter with the simplex of
//! Nelder and Mead. A step counts only if less is left, so what jumps (a valve's limit-cycle staircases) costs a few evaluations and ends in the simplex.

use std::sync::Arc;

use crate::data::session::{Role, Run};
use crate::model::line::Line;
use crate::model::structure::{Model, Scope};
use crate::model::workspace::Workspace;
use crate::search::simplex;
use crate::search::simplex::Effort;

/// Parameters are moved by this to see what changes, in first steps.
const NUDGE: f64 = 0.02;

/// Farthest that a step goes at first, in first steps.
const FARTHEST: f64 = 1.5;

/// Steps at most.
const STEPS: usize = 12;

/// How often a step that comes to nothing is tried again, a third as long.
const TRIES: usize = 3;

/// Share of what is left that is not worth a step: a parameter is a deviation off when a few times as much is missing.
const NEGLIGIBLE: f64 = 3e-5;

/// Length of a step, in first steps, that is no step any more.
const NO_STEP: f64 = 1e-3;

/// Improves the parameters at `indices` (on the line of all parameters) from where they are; the mean square that remains.
pub fn descend(model: &mut Model, workspace: &mut Workspace<'_>, indices: &[usize], effort: Effort) -> f64 {
    let led = if indices.is_empty() { None } else { steps(model, workspace, indices, effort) };
    led.unwrap_or_else(|| simplex::simplex(model, workspace, indices, effort))
}

/// Steps until hardly anything changes; nothing when they end before. The model is where they have led in either case.
fn steps(model: &mut Model, workspace: &mut Workspace<'_>, indices: &[usize], effort: Effort) -> Option<f64> {
    let Effort { scope, spread, .. } = effort;
    let line = Line::of(model, indices);
    let mut point = line.begin();
    let mut square = solve(model, workspace, scope);
    let mut reach = FARTHEST;
    for _ in 0..STEPS {
        let (step, expected) = aim(model, workspace, &line, &point, (scope, square));
        let longest = step.iter().fold(0.0, |most: f64, part| most.max(part.abs()));
        if longest < NO_STEP || expected > square * (1.0 - NEGLIGIBLE) {
            return Some(square);
        }
        let mut share = (reach / longest).min(1.0);
        let mut better = None;
        for _ in 0..TRIES {
            let there: Vec<f64> = point.iter().zip(&step).map(|(at, step)| at + share * step).collect();
            let mut trial = model.clone();
            line.put(&mut trial, &there);
            let left = solve(&mut trial, workspace, scope);
            if left < square {
                better = Some((left, there, trial));
                break;
            }
            share /= 3.0;
        }
        let (left, there, trial) = better?;
        reach = (2.0 * share * longest).max(reach / 3.0);
        let gain = 1.0 - left / square;
        (square, point, *model) = (left, there, trial);
        if gain < spread {
            return (share == 1.0).then_some(square);
        }
    }
    None
}

/// Solves for the weights; what is left of the samples in `scope`. Where effects act on the model's own output the model keeps those that it
/// has, as long as a search goes on: with others there would be another output.
fn solve(model: &mut Model, workspace: &mut Workspace<'_>, scope: Scope) -> f64 {
    let sums = workspace.sums(model, scope);
    let weights = sums.fit.solve(&sums.free, &model.weights());
    if !model.needs_sum() {
        model.take(&weights);
    }
    sums.fit.mean_square(&weights)
}

/// How far every parameter has to go by the slopes here, where a mean square is left, and what would be left there if it were straight on, with
/// what the steps cost. They are expected to be no longer than [`FARTHEST`] (Levenberg 1944): a parameter that changes next to nothing here stays
/// where it is. Without that it has to go as far as rounding has it, and makes the steps of all others too short to count.
fn aim(model: &Model, workspace: &mut Workspace<'_>, line: &Line, point: &[f64], (scope, square): (Scope, f64)) -> (Vec<f64>, f64) {
    let looked_at = |run: &Run| (scope != Scope::Screen || run.screens) && run.role.contains(&Role::Fit);
    let here = workspace.outputs(model, looked_at);
    let mut columns: Vec<Vec<Vec<f64>>> = vec![Vec::new(); workspace.session.runs.len()];
    let mut nudges = Vec::with_capacity(point.len());
    for axis in 0..point.len() {
        // Away from a limit.
        let nudge = if line.is_at_upper_limit(axis, point[axis] + NUDGE) { -NUDGE } else { NUDGE };
        nudges.push(nudge);
        let mut there = point.to_vec();
        there[axis] += nudge;
        let mut moved = model.clone();
        line.put(&mut moved, &there);
        for ((columns, there), here) in columns.iter_mut().zip(workspace.outputs(&moved, looked_at)).zip(&here) {
            columns.push(there.iter().zip(here).map(|(there, here)| there - here).collect());
        }
    }
    let with_sensitivities = Model { sensitivities: Arc::new(columns), ..model.clone() };
    let mut sums = workspace.sums(&with_sensitivities, scope);
    let columns = sums.fit.columns;
    (columns - point.len()..columns).for_each(|at| sums.fit.products[at * (columns + 1)] += square * (NUDGE / FARTHEST).powi(2));
    let weights = sums.fit.solve(&sums.free, &model.weights());
    let step = weights[weights.len() - point.len()..].iter().zip(nudges).map(|(weight, nudge)| weight * nudge).collect();
    (step, sums.fit.mean_square(&weights))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::session::Session;
    use crate::effects::{creep, hold_after_reversal, pneumatic_lag, valve_dead_band};
    use crate::model::initial_state::InitialState;
    use virtual_rig as rig;
    use virtual_rig::CaseConfig;

    #[test]
    fn whatever_way_it_goes_no_more_is_left_than_by_the_simplex() {
        let effects = vec!["pneumatic-lag".to_owned()];
        let case = rig::hide(&CaseConfig { effects, seed: 572, ..CaseConfig::default() }).expect("a case");
        let session = Session::new(&case.recordings[..12], &[]).expect("a session");
        let lag_s = case.truth.parameters["pneumatic-lag.time_constant_s"];
        let lagging =
            Model::baseline(InitialState::carrying(case.truth.continuous), false).with(pneumatic_lag::FORMS[0], vec![1.3 * lag_s]);
        for mut model in [lagging.clone(), lagging.with(creep::FORMS[0], vec![])] {
            let (before, _) = model.fit(&session, Scope::Fit);
            let effort = Effort { scope: Scope::Fit, size: 0.4, evaluations: 100, spread: 1e-8 };
            let by_simplex = simplex::simplex(&mut model.clone(), &mut Workspace::new(&session), &[0], effort);
            let after = descend(&mut model, &mut Workspace::new(&session), &[0], Effort { spread: 1e-6, ..effort });
            assert!(after < 1.001 * by_simplex && after < 0.9 * before, "{after} and {by_simplex} of {before}");
        }
    }

    #[test]
    fn a_parameter_that_changes_nothing_does_not_hold_up_the_others() {
        let case = rig::hide(&CaseConfig { seed: 574, ..CaseConfig::default() }).expect("a case");
        let mut session = Session::new(&case.recordings[..8], &[]).expect("a session");
        // No error ends the hold, and nothing limits the rate.
        let (hold, law) = (hold_after_reversal::FORMS[0], [0.3, 0.05, 200.0, 1.0, 5.0]);
        for run in &mut session.runs {
            let mut path = run.input.clone();
            hold.input(&law, run, &mut path);
            run.output = path;
        }
        let mut model = Model::baseline(InitialState::Fresh, false).with(hold, vec![0.33, 0.08, 200.0, 1.0, 5.0]);
        let effort = Effort { scope: Scope::Fit, size: 0.4, evaluations: 100, spread: 1e-6 };
        steps(&mut model, &mut Workspace::new(&session), &[0, 1, 2, 3, 4], effort);
        let found = &model.slots[0].parameters;
        assert!(found.iter().zip(law).take(2).all(|(found, law)| (found / law - 1.0).abs() < 0.02), "{found:?} instead of {law:?}");
    }

    #[test]
    fn what_jumps_ends_in_the_simplex_with_no_more_left_than_without_steps() {
        let case = rig::hide(&CaseConfig { effects: vec!["valve-dead-band".to_owned()], seed: 573, ..CaseConfig::default() });
        let case = case.expect("a case");
        let session = Session::new(&case.recordings[..8], &[]).expect("a session");
        let mut model =
            Model::baseline(InitialState::carrying(case.truth.continuous), false).with(valve_dead_band::FORMS[0], vec![0.06, 0.05, 0.02]);
        let (before, _) = model.fit(&session, Scope::Fit);
        let effort = Effort { scope: Scope::Fit, size: 0.4, evaluations: 60, spread: 1e-6 };
        let after = descend(&mut model, &mut Workspace::new(&session), &[0, 1, 2], effort);
        assert!(after < before, "{after} {before}");
        assert!((model.fit(&session, Scope::Fit).0 / after - 1.0).abs() < 1e-9, "the model is where it says");
    }
}
