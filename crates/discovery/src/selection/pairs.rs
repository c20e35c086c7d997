//! Two effects at once: the best single effect may be a compromise between two, and then neither is found by adding to it.
//!
//! A second effect is looked for beside each of the best few first ones. The parameters of the first give way while the second's grid is
//! looked at ([`search::with_sensitivities`]): the first was fitted when the second was missing, and holds some of it. The best pairs are polished
//! together; then either member of the best pair is replaced by whatever goes better with the other, until nothing does. Method: a beam
//! in place of a greedy addition (sequential floating selection; Pudil, Novovicova and Kittler 1994).
//!
//! The catalogue knows a usual order of the signal, and a rig may have another: a supply that gives way behind a leak bends what the leak
//! has left. So where the usual order leaves something, the other way round is tried as well, if both members change the input or both the
//! output.

use crate::chain::form::Form;
use crate::data::noise;
use crate::model::structure::{Model, Order, Scope};
use crate::search::forms;
use crate::search::forms::Started;
use crate::search::parallel::{is_narrow, labour, labour_of_all};
use crate::search::simplex::Fitted;
use crate::selection::rounds::{Bench, FAR_BEHIND, Judged, POLISH, Tried};
use crate::selection::settings::{BREADTH, FEW};

/// What a first effect may leave above the noise to be one of those further ones, or to take the place of the larger of a pair, over what
/// the best one leaves: a compromise between two effects leaves less than either of them alone, but not by orders of magnitude.
const REACH: f64 = 30.0;

/// Share of the noise that counts as left at least.
const LITTLE: f64 = 0.05;

/// Forms of one effect among them: an effect with many forms must not crowd out the others.
const FORMS_OF_ONE: usize = 2;

/// What the best point of a form's grid may leave over what the best pair leaves when its parameters have been searched.
const FAR_FROM_GRID: f64 = 10.0;

/// What a pair found on the screening samples may leave over what the best one leaves, to be polished on all of them.
const FAR_FROM_BEST: f64 = 2.0;

/// Rounds of replacement.
const REPLACEMENTS: usize = 2;

/// The best pairs on top of `base`, best first. `tried` are the first effects as the round left them, `firsts` the best of them, polished.
/// The search ends as soon as a pair leaves nothing by `leaves_something`.
pub fn search(
    bench: &Bench<'_>,
    base: &Model,
    tried: &[Tried],
    firsts: &[Judged],
    leaves_something: &dyn Fn(&Judged) -> bool,
) -> Vec<Judged> {
    let Some(best) = firsts.first() else { return Vec::new() };
    let floor = noise::floor(bench.session, &best.fine.residuals(bench.session)).powi(2);
    let reach = floor + REACH * (best.select - floor).max(LITTLE * floor);
    let hopeful: Vec<&Tried> = tried.iter().filter(|one| one.fitted.select < reach).collect();
    let is_hopeful = |model: &Model| hopeful.iter().any(|one| one.fitted.model.names().eq(model.names()));
    let mut begun: Vec<Model> = Vec::new();
    for model in firsts.iter().map(|first| &first.model).chain(tried.iter().map(|one| &one.fitted.model)) {
        let has_place = begun.len() < FEW || (begun.len() < BREADTH && is_hopeful(model));
        if has_place && !begun.iter().any(|other| other.names().eq(model.names())) {
            begun.push(model.clone());
        }
    }
    let mut further = begun.split_off(FEW.min(begun.len()));
    let mut second = begun.split_off(1);
    let mut pairs = Vec::new();
    let unfinished = |pairs: &[Judged]| pairs.first().is_none_or(leaves_something);
    more_pairs(bench, &bench.forms, &begun, Order::Usual, &mut pairs);
    for some in [&mut second, &mut further] {
        if unfinished(&pairs) {
            more_pairs(bench, &bench.forms, some, Order::Usual, &mut pairs);
            begun.append(some);
        }
    }
    // The first effect came in when the second was missing: whatever goes better with the second may take its place, in whatever form.
    let large: Vec<&'static dyn Form> = hopeful.iter().map(|one| one.form).collect();
    for replacement in 0..REPLACEMENTS {
        let Some(best) = pairs.first().filter(|best| replacement == 0 || leaves_something(best)) else { break };
        let alone = (0..best.model.slots.len()).map(|slot| best.model.without(slot));
        let keeps_base = |model: &Model| base.names().all(|name| model.names().any(|other| other == name));
        // A member that was begun with in another form is begun with in this one as long as something is left.
        let left = leaves_something(best);
        let again = |one: &Model, other: &Model| one.names().eq(other.names()) && !(left && one.forms() != other.forms());
        let fresh = |model: &Model| !begun.iter().any(|other| again(model, other));
        let held: Vec<Model> = alone.filter(|model| keeps_base(model) && fresh(model)).collect();
        more_pairs(bench, &large, &held, Order::Usual, &mut pairs);
        begun.extend(held);
    }
    if unfinished(&pairs) {
        more_pairs(bench, &bench.forms, &begun, Order::Turned, &mut pairs);
    }
    pairs
}

/// Adds the best pairs with one of `firsts` and one of `forms` in them to `pairs`, best first.
fn more_pairs(bench: &Bench<'_>, forms: &[&'static dyn Form], firsts: &[Model], order: Order, pairs: &mut Vec<Judged>) {
    pairs.extend(bench.polished(&distinct(seconds(bench, forms, firsts, order), pairs), POLISH));
    pairs.sort_by(|x, y| x.penalised().total_cmp(&y.penalised()));
}

/// The best few of `forms` on top of each model, all parameters fitted together to the screening samples.
fn seconds(bench: &Bench<'_>, forms: &[&'static dyn Form], models: &[Model], order: Order) -> Vec<Fitted> {
    let session = bench.session;
    let residuals: Vec<Vec<Vec<f64>>> = models.iter().map(|model| model.residuals(session)).collect();
    let with_sensitivities: Vec<Model> = models.iter().map(|model| forms::with_sensitivities(model, session)).collect();
    // A narrow valley in several parameters takes as long as all other forms together: beside the best first effect only.
    let laborious = |form: &'static dyn Form| is_narrow(form) && form.parameters().len() > 1;
    let wanted = |first: usize, form: &&'static dyn Form| {
        let is_other = !form.spec().is_narrow && models[first].names().all(|name| name != form.name());
        let in_reach = first == 0 && order == Order::Usual || !laborious(*form);
        is_other && in_reach && (order == Order::Usual || models[first].turns_with(*form))
    };
    let of = |first: usize| forms.iter().copied().filter(move |form| wanted(first, form)).map(move |form| (first, form));
    let jobs: Vec<(usize, &'static dyn Form)> = (0..models.len()).flat_map(of).collect();
    let started = bench.in_parallel(
        &jobs,
        |(_, form)| labour(*form),
        |&(first, form)| forms::start_form(&with_sensitivities[first], form, order, session, &residuals[first]),
    );
    let mut leading: Vec<&Started> = Vec::new();
    let mut others: Vec<&Started> = Vec::new();
    for first in 0..models.len() {
        let of_this = jobs.iter().zip(&started).filter(|((of, _), _)| *of == first);
        let mut grid: Vec<&Started> = of_this.filter_map(|(_, started)| started.as_ref()).collect();
        grid.sort_by(|x, y| y.gain.total_cmp(&x.gain));
        let most = grid.iter().filter(|started| !started.form.spec().discrete).map(|started| started.gain).fold(0.0, f64::max);
        grid.retain(|started| started.gain > FAR_BEHIND * most);
        // The grid says little about a narrow valley, but it must show something.
        let (narrow, broad): (Vec<&Started>, Vec<&Started>) = grid.into_iter().partition(|started| is_narrow(started.form));
        let mut names: Vec<&str> = Vec::new();
        let not_yet_twice = |started: &&Started| {
            let name = started.form.name();
            names.push(name);
            names.iter().filter(|other| **other == name).count() <= FORMS_OF_ONE
        };
        let mut chosen = broad.into_iter().filter(not_yet_twice).take(BREADTH);
        leading.extend(chosen.next());
        others.extend(chosen.chain(narrow));
    }
    let polish = |started: &&Started| forms::polish(&started.model, session, Scope::Screen, POLISH / 2);
    let length = |started: &&Started| labour_of_all(&started.model);
    let mut polished = bench.in_parallel(&leading, length, polish);
    let best = polished.iter().map(|fitted| fitted.select).fold(f64::MAX, f64::min);
    others.retain(|started| started.square < FAR_FROM_GRID * best);
    polished.extend(bench.in_parallel(&others, length, polish));
    polished
}

/// The best of the models, of each set of effects the best only, and none that is in `known` in the same forms.
fn distinct(mut fitted: Vec<Fitted>, known: &[Judged]) -> Vec<Model> {
    fitted.sort_by(|x, y| x.penalised().total_cmp(&y.penalised()));
    let least = fitted.iter().map(|one| one.select).chain(known.iter().map(|judged| judged.select)).fold(f64::MAX, f64::min);
    fitted.retain(|one| one.select < FAR_FROM_BEST * least);
    let mut best: Vec<Model> = Vec::new();
    for one in fitted {
        let same = |other: &Model| other.names().eq(one.model.names());
        let again = known.iter().any(|judged| judged.model.forms() == one.model.forms());
        if best.len() < BREADTH && !best.iter().any(same) && !again {
            best.push(one.model);
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::session::Session;
    use crate::effects::{leakage, pneumatic_lag, resonance, supply_saturation};
    use crate::model::initial_state::InitialState;
    use virtual_rig as rig;
    use virtual_rig::{CaseConfig, Generator};

    #[test]
    fn a_supply_that_gives_way_behind_a_leak_is_found_in_that_order_only() {
        // The second rig has its effects in the order in which they are given: what leaks reaches the limit less often.
        let effects = ["leakage", "supply-saturation"].map(str::to_owned).into();
        let config = CaseConfig { effects, seed: 560, noise: 0.001, generator: Generator::Rival, ..CaseConfig::default() };
        let case = rig::hide(&config).expect("a case");
        let session = Session::new(&case.recordings[..12], &[]).expect("a session");
        let bench = Bench { session: &session, forms: vec![supply_saturation::FORMS[0]], threads: 1, watch: &|_| {} };
        let mut leak = Model::baseline(InitialState::carrying(case.truth.continuous), false).with(leakage::FORMS[1], vec![10.0, 0.2, 0.0]);
        leak = forms::polish(&leak, &session, Scope::Fit, POLISH).model;
        let left = |order| {
            let mut pairs = Vec::new();
            more_pairs(&bench, &bench.forms, std::slice::from_ref(&leak), order, &mut pairs);
            pairs.first().map_or(f64::NAN, |pair| pair.select)
        };
        let (usual, turned) = (left(Order::Usual), left(Order::Turned));
        assert!(turned < 0.7 * usual, "{turned} is not much less than {usual}");
    }

    #[test]
    fn effects_on_two_sides_of_the_hysteresis_have_one_order() {
        let (lag, supply, tip) = (pneumatic_lag::FORMS[0], supply_saturation::FORMS[0], resonance::FORMS[0]);
        let lagging = Model::baseline(InitialState::Fresh, false).with(lag, vec![0.1]);
        assert!(lagging.turns_with(supply) && !lagging.turns_with(tip));
        let names = |order, form| lagging.with_in(order, form, vec![0.5, 0.1]).names().collect::<Vec<_>>();
        assert_eq!(names(Order::Usual, supply), ["supply-saturation", "pneumatic-lag"]);
        assert_eq!(names(Order::Turned, supply), ["pneumatic-lag", "supply-saturation"]);
        assert_eq!(names(Order::Turned, tip), ["pneumatic-lag", "resonance"]);
    }
}
