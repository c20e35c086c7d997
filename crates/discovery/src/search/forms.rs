//! Fitting parameters: one form's by a coarse grid and [`descend`]'s steps; those of all forms together.

use std::borrow::Cow;
use std::sync::Arc;

use crate::chain::form::Form;
use crate::data::session::Session;
use crate::model::line::{axes, inward, outward, place};
use crate::model::paths::Paths;
use crate::model::structure::{Model, Order, Scope};
use crate::model::workspace::Workspace;
use crate::search::descent::descend;
use crate::search::simplex::{Effort, Fitted, indices_of, objective};

/// One more effect at the best point of its grid.
pub struct Started {
    /// The model with it.
    pub model: Model,
    /// Its form.
    pub form: &'static dyn Form,
    /// Mean square that it leaves: of the screening samples, or of all where it is discrete, for a step between two recordings need not be in some.
    pub square: f64,
    /// Share of the mean square of the same samples that it takes away.
    pub gain: f64,
}

/// `model` with further columns that let its effects' parameters give way to first order: what its output changes by with a tenth of a
/// first step of each. Beside them an effect is judged by what it takes away when those that are there already are fitted again.
pub fn with_sensitivities(model: &Model, session: &Session) -> Model {
    const STEP: f64 = 0.1;
    let axes = axes(model);
    let line: Vec<f64> = model.slots.iter().flat_map(|slot| slot.parameters.iter().copied()).collect();
    let indices = (0..model.slots.len()).filter(|&slot| !model.slots[slot].form.spec().discrete).flat_map(|slot| indices_of(model, slot));
    let mut columns: Vec<Vec<Vec<f64>>> = vec![Vec::new(); session.runs.len()];
    let centre = inward(&axes, &line);
    let mut workspace = Workspace::new(session);
    for index in indices {
        let at = |step: f64| {
            let mut point = centre.clone();
            point[index] += step;
            let mut moved = model.clone();
            place(&mut moved, &outward(&axes, &point));
            moved
        };
        let (less, more) = (at(-STEP), at(STEP));
        let [more, less] = [more, less].map(|model| workspace.outputs(&model, |_| true));
        for ((more, less), columns) in more.iter().zip(less).zip(&mut columns) {
            columns.push(more.iter().zip(less).map(|(more, less)| more - less).collect());
        }
    }
    Model { sensitivities: Arc::new(columns), ..model.clone() }
}

/// The session as an effect sees it whose place is behind others that change the input.
fn as_seen<'a>(base: &Model, form: &'static dyn Form, order: Order, session: &'a Session) -> Cow<'a, Session> {
    let before = Model { slots: base.slots[..base.place_in(order, form)].to_vec(), ..base.clone() };
    if before.before_operators().next().is_none() {
        return Cow::Borrowed(session);
    }
    let (mut seen, mut paths) = (session.clone(), Paths::default());
    paths.lead(&before, &session.runs, (0..session.runs.len()).collect());
    seen.runs.iter_mut().zip(&session.runs).for_each(|(run, own)| run.input = paths.path(own).to_vec());
    Cow::Owned(seen)
}

/// Tries one more effect in one form at every point of its grid, on a few recordings, the others' parameters held.
pub fn start_form(base: &Model, form: &'static dyn Form, order: Order, session: &Session, residual: &[Vec<f64>]) -> Option<Started> {
    let mut workspace = Workspace::new(session);
    let square_of = |model: &Model, workspace: &mut Workspace<'_>| {
        if !form.spec().discrete {
            return objective(model, workspace, Scope::Screen);
        }
        let sums = workspace.sums(model, Scope::Both);
        let weights = sums.fit.solve(&sums.free, &model.weights());
        0.5 * (sums.fit.mean_square(&weights) + sums.select.mean_square(&weights))
    };
    let was = square_of(base, &mut workspace);
    let look = |start: Vec<f64>| {
        let mut model = base.with_in(order, form, start);
        // The baseline has taken some of the effect for hysteresis of its own: an effect that acts on the model's output is judged by
        // what remains once the weights have given that back.
        let gives_back = form.spec().needs_sum && !form.spec().discrete;
        let square = if gives_back { model.fit_in(&mut workspace, Scope::Screen).0 } else { square_of(&model, &mut workspace) };
        Started { model, form, square, gain: 1.0 - square / was }
    };
    let mut best =
        form.starts(&as_seen(base, form, order, session), residual).into_iter().map(look).min_by(|x, y| x.square.total_cmp(&y.square))?;
    best.model.sensitivities = Arc::default();
    Some(best)
}

/// Improves the form's parameters on the screening samples from where it was started, the others' held.
pub fn refine_form(started: &Model, form: &'static dyn Form, session: &Session) -> Fitted {
    let mut model = started.clone();
    let slot = model.slots.iter().position(|slot| slot.form.name() == form.name() && slot.form.form() == form.form()).unwrap_or(0);
    let mut workspace = Workspace::new(session);
    if !form.spec().discrete {
        let effort = Effort { scope: Scope::Screen, size: 1.0, evaluations: 14, spread: 1e-5 };
        let indices = indices_of(&model, slot);
        improve(&mut model, &mut workspace, &indices, effort);
    }
    let (_, select) = model.fit_in(&mut workspace, Scope::Both);
    Fitted { model, select }
}

/// Improves all parameters of all effects together, by the samples of `scope`.
pub fn polish(model: &Model, session: &Session, scope: Scope, evaluations: usize) -> Fitted {
    let mut workspace = Workspace::new(session);
    let mut model = polished(model, &mut workspace, scope, evaluations);
    let (_, select) = model.fit_in(&mut workspace, Scope::Both);
    Fitted { model, select }
}

/// As [`polish`], its weights still to be fitted.
pub fn polished(model: &Model, workspace: &mut Workspace<'_>, scope: Scope, evaluations: usize) -> Model {
    let mut model = model.clone();
    let indices: Vec<usize> =
        (0..model.slots.len()).filter(|&slot| !model.slots[slot].form.spec().discrete).flat_map(|slot| indices_of(&model, slot)).collect();
    let spread = if scope == Scope::Screen { 1e-4 } else { 1e-6 };
    improve(&mut model, workspace, &indices, Effort { scope, size: 0.4, evaluations, spread });
    model
}

/// Improves the parameters at `indices`, by so many evaluations of each (`effort.evaluations`). Where effects act on the model's own output a search
/// keeps its weights.
fn improve(model: &mut Model, workspace: &mut Workspace<'_>, indices: &[usize], effort: Effort) {
    let (count, needs_sum) = (indices.len(), model.needs_sum());
    if needs_sum || count == 0 {
        model.fit_in(workspace, effort.scope);
    }
    descend(model, workspace, indices, Effort { evaluations: effort.evaluations * count, ..effort });
    if needs_sum && count > 0 {
        model.fit_in(workspace, effort.scope);
        descend(model, workspace, indices, Effort { evaluations: effort.evaluations * count / 2, size: 0.5 * effort.size, ..effort });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{hold_after_reversal, pneumatic_lag, setup_change};
    use crate::model::initial_state::InitialState;
    use virtual_rig as rig;
    use virtual_rig::{CaseConfig, Generator};

    #[test]
    fn a_step_between_recordings_gains_even_where_the_screening_samples_lie_on_one_side_of_it() {
        let mut case = rig::hide(&CaseConfig { seed: 563, ..CaseConfig::default() }).expect("a case");
        let plain = Session::new(&case.recordings, &[]).expect("a session");
        let screened: Vec<usize> = plain.runs.iter().filter(|run| run.screens).map(|run| run.index).collect();
        // The step stands in front of all recordings that are screened, or behind them.
        let (first, last) = (screened[0], screened[screened.len() - 1]);
        let after = if first > plain.runs.len() - 1 - last { first } else { last + 1 };
        assert!((2..plain.runs.len()).contains(&after), "{screened:?} of {}", plain.runs.len());
        for recording in &mut case.recordings[after..] {
            recording.output.iter_mut().for_each(|value| *value += 0.2 * plain.output_scale);
        }
        let session = Session::new(&case.recordings, &[]).expect("a session");
        let mut base = Model::baseline(InitialState::carrying(case.truth.continuous), false);
        base.fit(&session, Scope::Both);
        let of_all = start_form(&base, setup_change::FORMS[0], Order::Usual, &session, &base.residuals(&session)).expect("a step");
        let before = of_all.square / (1.0 - of_all.gain);
        assert!(objective(&base, &mut Workspace::new(&session), Scope::Screen) < 0.1 * before, "the screening samples show the step");
        assert!(of_all.gain > 0.9, "{}", of_all.gain);
    }

    #[test]
    fn what_comes_behind_another_effect_is_looked_for_in_what_that_makes_of_the_input() {
        let case = rig::hide(&CaseConfig { seed: 563, ..CaseConfig::default() }).expect("a case");
        let session = Session::new(&case.recordings[..4], &[]).expect("a session");
        let (lag, hold) = (pneumatic_lag::FORMS[0], hold_after_reversal::FORMS[0]);
        let lagging = Model::baseline(InitialState::Fresh, false).with(lag, vec![0.2]);
        let behind = as_seen(&lagging, hold, Order::Turned, &session);
        for (seen, run) in behind.runs.iter().zip(&session.runs) {
            let mut path = run.input.clone();
            lag.input(&[0.2], run, &mut path);
            assert_eq!(seen.input, path);
        }
        let before = as_seen(&lagging, hold, Order::Usual, &session);
        assert!(before.runs.iter().zip(&session.runs).all(|(seen, run)| seen.input == run.input));
    }

    #[test]
    fn columns_that_ease_a_model_take_away_what_a_wrong_parameter_leaves() {
        let effects = vec!["pneumatic-lag".to_owned()];
        let case = rig::hide(&CaseConfig { effects, seed: 562, noise: 0.0, generator: Generator::Rival, ..CaseConfig::default() });
        let case = case.expect("a case");
        let session = Session::new(&case.recordings[..6], &[]).expect("a session");
        let lagging = |time_s: f64| {
            let mut model =
                Model::baseline(InitialState::carrying(case.truth.continuous), false).with(pneumatic_lag::FORMS[0], vec![time_s]);
            model.fit(&session, Scope::Screen);
            model
        };
        let right = polish(&lagging(case.truth.parameters["pneumatic-lag.time_constant_s"]), &session, Scope::Screen, 40).model;
        let wrong = lagging(1.1 * right.slots[0].parameters[0]);
        let with_sensitivities = with_sensitivities(&wrong, &session);
        let [of_right, of_wrong, of_sensitivities] =
            [&right, &wrong, &with_sensitivities].map(|model| objective(model, &mut Workspace::new(&session), Scope::Screen));
        assert!(of_wrong > 2.0 * of_right, "{of_wrong} is no more than {of_right}");
        // Not all: weights that may not be negative give way to one side only.
        assert!(
            of_wrong - of_sensitivities > 0.5 * (of_wrong - of_right),
            "{of_wrong} to {of_sensitivities}, and {of_right} with the right one"
        );
        // They have no say in what it predicts.
        let run = &session.runs[0];
        assert_eq!(with_sensitivities.predict(run), wrong.predict(run));
    }
}
