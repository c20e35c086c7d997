//! The decision: of all explanations that the search has met, the one that predicts recordings it was not fitted to best.

use crate::data::noise;
use crate::data::session::Session;
use crate::model::structure::{Model, Scope};
use crate::result::RunnerUp;
use crate::search::forms;
use crate::selection::criterion::Comparison;
use crate::selection::found::Outcome;
use crate::selection::leaves::{Left, worked};
use crate::selection::rounds::POLISH;
use crate::selection::settings::MOST_COMPARED;

/// What was decided.
pub struct Decision {
    /// The explanation, fitted to all recordings that are worked with.
    pub model: Model,
    /// Names of its effects, the one that is missed most first.
    pub order: Vec<&'static str>,
    /// The second best one.
    pub second: Option<Model>,
    /// What the second has that the first has not.
    pub runner_up: Option<RunnerUp>,
    /// The comparison.
    pub compared: Comparison,
}

/// Decides between the model before the search (`base`), the one that was `found`, its parts, and what the search has met beside it.
pub fn decide(session: &Session, base: &Model, outcome: &Outcome, found: &Model, seed: u64, threads: usize) -> Decision {
    // What one of several effects leaves when its own parameters are all that is fitted.
    let alone = |part: Model| if part.slots.is_empty() || jumps(&part) { part } else { refitted(session, &part) };
    let parts = (0..found.slots.len()).map(|slot| alone(found.without(slot)));
    let others = outcome.second.iter().chain(&outcome.met).chain(&outcome.tried).cloned();
    let keeps_base = |model: &Model| base.names().all(|name| model.names().any(|other| other == name));
    let mut models = vec![base.clone()];
    // All are compared behind the longest start-up: a model that reads half of a recording before it says anything is no simulation of it.
    let shortest_s = session.worked().map(|run| run.input.len() as f64 * run.period_s).fold(f64::MAX, f64::min);
    for model in std::iter::once(found.clone()).chain(parts).chain(others).filter(|model| model.start_up_s() < 0.5 * shortest_s) {
        if models.len() < MOST_COMPARED && keeps_base(&model) && models.iter().all(|other| other.forms() != model.forms()) {
            models.push(model);
        }
    }
    let models = without_menders(session, models);
    let compared = Comparison::new(session, &models, seed, threads);
    let best = compared.best();
    let model = if models[best].forms() == found.forms() { found.clone() } else { refitted(session, &models[best]) };
    let owned: Vec<&str> = base.names().collect();
    let order = by_loss(session, &model, &owned);
    let second = compared.second().filter(|_| !order.is_empty());
    let runner_up = second.and_then(|(second, separable)| {
        let name = second.names.iter().find(|name| model.names().all(|own| own != **name))?;
        Some(RunnerUp { name: (*name).to_owned(), separable })
    });
    let second = second.map(|(second, _)| refitted(session, &models[second.index]));
    Decision { model, order, second, runner_up, compared }
}

/// Whether anything in a model jumps.
fn jumps(model: &Model) -> bool {
    model.slots.iter().any(|slot| slot.form.jumps().is_some())
}

/// The models without those that have an effect more than another one needs: what that one leaves is no more than a form's error may be, and the effect
/// explains too little of it. What mends a form is no effect by itself: a true one explains what is left without it, as a first one must what is there.
fn without_menders(session: &Session, models: Vec<Model>) -> Vec<Model> {
    let fitted = |model: &Model| {
        let mut fine = model.regrown();
        fine.fit_all(session);
        fine.residuals(session)
    };
    let residuals: Vec<Option<Vec<Vec<f64>>>> = models.iter().map(|model| (!jumps(model)).then(|| fitted(model))).collect();
    let floor = residuals.iter().flatten().map(|residual| noise::floor(session, residual).powi(2)).fold(f64::MAX, f64::min);
    let squares: Vec<Option<f64>> =
        residuals.iter().map(|residual| residual.as_ref().map(|residual| worked(session, residual, false))).collect();
    let explains =
        |after: usize, before: usize| squares[after].zip(squares[before]).map(|(is, was)| !Left::new(was, is, floor).is_too_much());
    let has_all_of = |one: &Model, other: &Model| other.names().all(|name| one.names().any(|own| own == name));
    let mends = |one: usize| {
        let mut fewer = (1..models.len())
            .filter(|&other| models[other].slots.len() < models[one].slots.len() && has_all_of(&models[one], &models[other]));
        let suffices = |other: usize| explains(other, 0) == Some(true) && explains(one, other) == Some(false);
        fewer.any(suffices)
    };
    let stays: Vec<bool> = (0..models.len()).map(|one| !mends(one)).collect();
    models.into_iter().zip(stays).filter(|(_, stays)| *stays).map(|(model, _)| model).collect()
}

/// The model with its parameters fitted together, its weights on the fine grid.
fn refitted(session: &Session, model: &Model) -> Model {
    let mut fitted = model.clone();
    if !jumps(model) {
        let coarse = Model { slots: model.slots.clone(), ..Model::baseline(model.initial_state, model.stops) };
        fitted = forms::polish(&coarse, session, Scope::Fit, POLISH).model.refined();
    }
    fitted.fit_all(session);
    fitted.anchor(session);
    fitted.pruned()
}

/// Names of a model's effects without those `owned`, the one first without which most is left.
fn by_loss(session: &Session, model: &Model, owned: &[&str]) -> Vec<&'static str> {
    let free = model.slots.iter().enumerate().filter(|(_, slot)| !owned.contains(&slot.form.name()));
    let mut order: Vec<(f64, &'static str)> =
        free.map(|(at, slot)| (model.without(at).fit(session, Scope::Both).1, slot.form.name())).collect();
    order.sort_by(|x, y| y.0.total_cmp(&x.0));
    let mut names: Vec<&'static str> = Vec::new();
    for (_, name) in order {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
}
