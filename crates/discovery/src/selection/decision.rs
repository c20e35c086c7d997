//! The decision: of all explanations that the search has met, the one that predicts recordings it was not fitted to best.

use crate::data::noise;
use crate::data::session::{Role, Session};
use crate::model::structure::{Model, Scope, Slot};
use crate::result::RunnerUp;
use crate::search::forms;
use crate::selection::criterion::Comparison;
use crate::selection::found::Outcome;
use crate::selection::leaves::{Left, one_step_ahead, rmse, worked};
use crate::selection::rounds::POLISH;
use crate::selection::settings::{GRID_ERROR, HALF, MOST_COMPARED, UNEXPLAINED};

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
    // All are compared behind the longest start-up: a model that reads half of a recording before it says anything is no simulation of it.
    let shortest_s = session.worked().map(|run| run.input.len() as f64 * run.period_s).fold(f64::MAX, f64::min);
    let keeps_base = |model: &Model| base.names().all(|name| model.names().any(|other| other == name));
    let mut known: Vec<Vec<(&str, &str)>> = vec![base.forms()];
    let mut is_wanted = |model: &Model| {
        let is_new = model.start_up_s() < 0.5 * shortest_s && keeps_base(model) && !known.contains(&model.forms());
        if is_new {
            known.push(model.forms());
        }
        is_new
    };
    let mut models = vec![base.clone()];
    models.extend(Some(found.clone()).filter(&mut is_wanted));
    models.extend(simpler(found).into_iter().filter(&mut is_wanted).map(|model| alone(session, model)));
    let others = outcome.met.iter().chain(&outcome.tried);
    let places = MOST_COMPARED.saturating_sub(models.len());
    models.extend(others.filter(|model| is_wanted(model)).take(places).cloned());
    let mut models = rivals_of(session, models, threads);
    let mut compared = Comparison::new(session, &models, seed, threads);
    // A rival may be simpler than the search has it, too. What it does without was for the comparison to say.
    let of_rivals = compared.set.iter().flat_map(|member| limits(&models[member.index])).filter(is_wanted);
    let of_rivals: Vec<Model> = of_rivals.map(|model| alone(session, model)).collect();
    if !of_rivals.is_empty() {
        models = rivals_of(session, [models, of_rivals].concat(), threads);
        compared = Comparison::new(session, &models, seed, threads);
    }
    let observed = compared.best();
    // What a simulation explains needs no observer.
    let observes = |name: &str| models[observed].names().any(|own| own == name);
    let is_same = |model: &Model| model.slots.len() == models[observed].slots.len() && model.names().all(observes);
    let simulated = (0..models.len()).filter(|&at| jumps(&models[observed]) && !jumps(&models[at]) && is_same(&models[at]));
    let suffices =
        |at: usize| Some(Left::between(session, base, &models[at], 0.0)).filter(|left| !left.is_too_much()).map(|left| (left.share, at));
    let best = simulated.filter_map(suffices).min_by(|x, y| x.0.total_cmp(&y.0)).map_or(observed, |best| best.1);
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

/// What is simpler than a model: its parts, and the laws that it or they have come near.
fn simpler(model: &Model) -> Vec<Model> {
    let slots = model.slots.len();
    let without =
        |left_out: u32| (0..slots).rev().filter(|slot| left_out >> slot & 1 == 1).fold(model.clone(), |model, slot| model.without(slot));
    let wholes: Vec<Model> = (0..(1 << slots) - 1).map(without).collect();
    wholes.iter().skip(1).cloned().chain(wholes.iter().flat_map(limits)).collect()
}

/// The model with a law that one of its own has come near in the place of that.
fn limits(model: &Model) -> Vec<Model> {
    let of = |(at, slot): (usize, &Slot)| {
        let limits = slot.form.nested_limits(&slot.parameters).into_iter();
        limits.map(move |(form, parameters)| model.with_in_place_of(at, form, parameters)).collect::<Vec<_>>()
    };
    model.slots.iter().enumerate().flat_map(of).collect()
}

/// What some of the effects leave when their own parameters are all that is fitted.
fn alone(session: &Session, part: Model) -> Model {
    if part.slots.is_empty() || jumps(&part) { part } else { refitted(session, &part) }
}

/// Whether anything in a model jumps.
fn jumps(model: &Model) -> bool {
    model.slots.iter().any(|slot| slot.form.jumps().is_some())
}

/// The models that can be the answer: without those that close too little beside the best, and without those that have an effect more than another one
/// needs. What that one leaves is no more than a form's error may be then, and the further effect explains too little of it, or it is the grid's. What mends
/// a form is no effect by itself: a true one explains what is left without it, as a first one must what there is. What jumps beside it has to explain
/// more of what a smooth observer misses than may stay unexplained.
fn rivals_of(session: &Session, models: Vec<Model>, threads: usize) -> Vec<Model> {
    let missed = |model: &Model| {
        let mut fine = model.regrown();
        fine.fit_all(session);
        fine.residuals(session)
    };
    let missed: Vec<Option<Vec<Vec<f64>>>> = models.iter().map(|model| (!jumps(model)).then(|| missed(model))).collect();
    let squares: Vec<Option<f64>> = missed.iter().map(|missed| Some(worked(session, missed.as_ref()?, false))).collect();
    // The noise is no more than what the best of them leaves.
    let noises = missed.iter().flatten().map(|missed| noise::floor(session, missed).powi(2));
    let floor = noises.chain(squares.iter().copied().flatten()).fold(f64::MAX, f64::min);
    // What one leaves of what another missed, where neither jumps.
    let left = |is: usize, was: usize| Some(Left::new(squares[was]?, squares[is]?, floor));
    let is_part = |part: usize, whole: usize| {
        let has = |name: &str| models[whole].names().any(|own| own == name);
        part > 0 && models[part].slots.len() < models[whole].slots.len() && models[part].names().all(has)
    };
    // One step ahead, where something jumps. All errors count: a smooth observer errs where it jumps, in few samples.
    let observers_leave = |model: usize| {
        let square = |missed: Vec<Vec<f64>>| rmse(session, &missed, Role::Select, &vec![false; session.runs.len()], false).powi(2);
        let [smooth, jumps] = one_step_ahead(session, &models[model], threads)?.1.map(square);
        Some(Left::new(smooth, jumps, floor).share)
    };
    let suffices = |part: usize, whole: usize| {
        let excess = |model: usize| squares[model].map(|square| (square - floor).max(0.0));
        let (Some(of_part), Some(of_whole)) = (excess(part), excess(whole)) else { return false };
        of_part <= GRID_ERROR * GRID_ERROR || of_whole > UNEXPLAINED[1] * of_part
    };
    // What closes less than half of what another one closes is no rival of it, however much the criterion lets pass for slow error.
    let closes = |model: usize| left(model, 0).map(|left| 1.0 - left.share);
    let most = (1..models.len()).filter_map(closes).fold(0.0, f64::max);
    let is_rival = |model: usize| model == 0 || closes(model).is_none_or(|share| share >= HALF * most);
    let stays = |whole: &usize| {
        let is_enough = |part: &usize| is_part(*part, *whole) && left(*part, 0).is_some_and(|left| !left.is_too_much());
        let mut parts = (0..models.len()).filter(is_enough);
        is_rival(*whole)
            && if jumps(&models[*whole]) {
                parts.next().is_none() || observers_leave(*whole).is_none_or(|share| share <= 1.0 - UNEXPLAINED[0])
            } else {
                !parts.any(|part| suffices(part, *whole))
            }
    };
    (0..models.len()).filter(stays).map(|at| models[at].clone()).collect()
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

#[cfg(test)]
mod tests {
    use virtual_rig::{self as rig, CaseConfig, Excitation, Generator};

    use super::*;
    use crate::chain::form::Parameter;
    use crate::effects::{catalogue, dead_time, pneumatic_lag, supply_saturation};
    use crate::model::initial_state::InitialState;

    #[test]
    fn a_further_effect_stays_where_it_explains_what_is_left_and_goes_where_it_only_mends() {
        // Which stay of: nothing, a dead time, a saturation, both, a lag beside the dead time.
        let staying = |hidden: &[&str]| {
            let effects = hidden.iter().map(|name| (*name).to_owned()).collect();
            let config = CaseConfig { effects, seed: 3424, generator: Generator::ComposedTuning, ..CaseConfig::default() };
            let case = rig::hide(&config).expect("a case");
            let session = Session::new(&case.recordings[..12], &[]).expect("a session");
            let bare = Model::baseline(InitialState::carrying(case.truth.continuous), false);
            let (late, limit, lag) = (dead_time::FORMS[0], supply_saturation::FORMS[0], pneumatic_lag::FORMS[0]);
            let limited = |model: &Model| model.with(limit, vec![0.8, 0.01, 0.0]);
            let delayed = bare.with(late, vec![0.07]);
            let models = [delayed.clone(), limited(&bare), limited(&delayed), delayed.with(lag, vec![0.01])];
            let fitted = models.iter().map(|model| refitted(&session, model));
            let stay = rivals_of(&session, std::iter::once(bare.clone()).chain(fitted).collect(), 1);
            stay.iter().map(|model| model.names().collect::<Vec<_>>().join("+")).collect::<Vec<_>>()
        };
        let alone = staying(&["dead-time"]);
        assert!(alone.contains(&"dead-time".into()) && alone.iter().all(|names| !names.contains('+')), "{alone:?}");
        let both = staying(&["dead-time", "supply-saturation"]);
        assert!(both.contains(&"supply-saturation+dead-time".into()), "{both:?}");
    }

    #[test]
    fn an_effect_is_added_with_parameters_that_a_model_file_may_have() {
        for form in catalogue::forms() {
            for beyond in [-1e9, 1e9] {
                let model = Model::baseline(InitialState::Fresh, false).with(form, vec![beyond; form.parameters().len()]);
                let ranges = form.parameters().iter();
                let outside = model.slots[0].parameters.iter().zip(ranges).find(|(value, range)| !(range.low..=range.high).contains(value));
                assert!(outside.is_none(), "{}: {outside:?}", form.form());
            }
        }
    }

    #[test]
    fn what_is_simpler_lies_where_a_model_file_may_have_it() {
        let mut simplified = 0;
        for form in catalogue::forms() {
            // All parameters at a limit, near it, and halfway.
            for share in [0.0, 0.01, 0.5, 1.0] {
                let of = |parameter: &Parameter| parameter.low + share * (parameter.high - parameter.low);
                let model = Model::baseline(InitialState::Fresh, false).with(form, form.parameters().iter().map(of).collect());
                for slot in simpler(&model).iter().flat_map(|simple| &simple.slots) {
                    simplified += 1;
                    for (value, range) in slot.parameters.iter().zip(slot.form.parameters()) {
                        let (low, high) = (range.low, range.high);
                        assert!((low..=high).contains(value), "{:?} from {:?}: {} is {value}", slot.form.key(), form.key(), range.name);
                    }
                }
            }
        }
        assert!(simplified > 10, "{simplified}");
    }

    #[test]
    fn an_effect_that_hides_in_what_passes_for_noise_is_named_beside_another() {
        // The edges of what a held command does pass for noise, more of it than the hysteresis that follows the rate leaves.
        let config = CaseConfig {
            effects: ["rate-dependent-hysteresis", "sample-and-hold"].map(str::to_owned).into(),
            seed: 3453,
            generator: Generator::ComposedTuning,
            excitation: Excitation::Rich,
            ..CaseConfig::default()
        };
        let case = rig::hide(&config).expect("a case");
        let discovery = crate::discover(&case.recordings, &case.kept_out, &crate::DiscoverConfig::default()).expect("a finding").discovery;
        let mut names: Vec<&str> = discovery.effects.iter().map(|effect| effect.name.as_str()).collect();
        names.sort_unstable();
        assert_eq!(names, ["rate-dependent-hysteresis", "sample-and-hold"], "{discovery:?}");
    }

    #[test]
    fn what_goes_slowly_is_not_lost_to_what_is_quick_and_closes_less() {
        // A quick element, and one slower than a recording is long.
        let config =
            CaseConfig { effects: vec!["creep".to_owned()], seed: 8201, generator: Generator::ComposedTuning, ..CaseConfig::default() };
        let case = rig::hide(&config).expect("a case");
        let discovery = crate::discover(&case.recordings, &case.kept_out, &crate::DiscoverConfig::default()).expect("a finding").discovery;
        let names: Vec<&str> = discovery.effects.iter().map(|effect| effect.name.as_str()).collect();
        assert!(names == ["creep"] && discovery.gap_closed > 0.85, "{discovery:?}");
    }
}
