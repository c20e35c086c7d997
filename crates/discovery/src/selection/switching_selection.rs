//! Naming what jumps: a sticking tip or a valve with a dead band, alone or beside something smooth.
//!
//! All are judged by the same measure, the likelihood of each sample after those before it ([`crate::observers::jumps`]), on recordings that took no
//! part in fitting: every smooth explanation that the search has met, alone and as the quasi-static response of jumps of either kind. A smooth observer may
//! read slow errors from the output just as a jump observer may read stick positions, so jumps win by holding still and leaping alone. What is smooth
//! must then pay beside the jumps, for jumps alone may look like an effect of the muscle.

use crate::chain::form::{Drive, Form};
use crate::data::noise;
use crate::data::session::Session;
use crate::data::statistics::tail;
use crate::model::structure::{Model, Scope};
use crate::model::workspace::Workspace;
use crate::observers::law::SlipLaw;
use crate::result::Candidate;
use crate::search::simplex::objective;
use crate::search::{cross_entropy, parallel};
use crate::selection::found::Outcome;
use crate::selection::leaves::Left;
use crate::selection::rounds;
use crate::selection::rounds::{Bench, FAR_BEHIND};
use crate::selection::settings::{BESIDE_JUMPS, FEW, JUMPS, LIKELY, MOST_COMPARED, MOST_SCATTER};
use crate::selection::switching_likelihood::{LogLikelihood, QuasiStatic, lags};
use crate::selection::switching_refits::{self, FIRST_REFITS, LAST_REFITS, lagged, refitted, with_lag};

/// Jumps on a quasi-static response, with the log-likelihood for them.
struct Judged {
    log_likelihood: LogLikelihood,
    form: &'static dyn Form,
    law: SlipLaw,
    /// Which smooth explanation the quasi-static response is.
    quasi_static: usize,
    /// The same with its weights fitted beside the jumps, behind the lag of what moves.
    model: Model,
}

/// Deviations by which `more` lies above `less`, block by block.
fn above(more: &LogLikelihood, less: &LogLikelihood) -> f64 {
    rounds::deviations(&more.blocks, &less.blocks)
}

/// Whether `more` explains the recordings better than `less` by more than chance does.
fn is_no_chance(more: &LogLikelihood, less: &LogLikelihood) -> bool {
    above(more, less) >= LIKELY
}

/// What a parameter must bring, in the logarithm of the likelihood per sample: 13 over the 13,000 samples that select in a session of 24
/// recordings, nearly three times what the Bayesian information criterion asks.
const PENALTY: f64 = 0.001;

/// Every smooth explanation that the search has met, its weights fitted on the fine grid, the first without any effect of the search.
fn explanations(bench: &Bench<'_>, base: &Model, outcome: &Outcome) -> Vec<Model> {
    let simulated = |model: &Model| model.names().any(|name| name == VALVE);
    let found = &outcome.model;
    let parts = (0..found.slots.len()).map(|slot| found.without(slot));
    let keeps_base = |model: &Model| base.names().all(|name| model.names().any(|other| other == name));
    let mut wanted: Vec<(bool, Model)> = vec![(false, base.clone())];
    // One effect beside the jumps is likelier than two.
    let met = |single: bool| outcome.met.iter().filter(move |model| (model.slots.len() <= base.slots.len() + 1) == single).cloned();
    let singles = std::iter::once(found.clone()).chain(parts).chain(met(true)).map(|model| (true, model));
    let tried = outcome.tried.iter().map(|model| (false, model.clone()));
    for (is_fine, model) in singles.chain(tried).chain(met(false).map(|model| (true, model))) {
        let again = wanted.iter().any(|(_, other)| other.forms() == model.forms());
        if !again && !simulated(&model) && keeps_base(&model) && wanted.len() < MOST_COMPARED {
            wanted.push((is_fine, model));
        }
    }
    parallel::in_parallel(&wanted, bench.threads, |(is_fine, model)| {
        let mut model = if *is_fine { model.clone() } else { model.refined() };
        model.fit(bench.session, Scope::Both);
        model.pruned()
    })
}

/// The simulated form of this effect is no smooth explanation.
const VALVE: &str = "valve-dead-band";

/// The best jumps of one form on every smooth explanation, those on the leading ones and on the first fitted in full.
fn jumps(session: &Session, explanations: &[Model], smoothest: usize, form: &'static dyn Form, noise: f64) -> Vec<Judged> {
    let drive = form.jumps().unwrap_or(Drive::QuasiStatic);
    let feels = form.spec().feels_sensor;
    // Whether a stick position feels the sensor makes a difference where the sensor moves within the time that a stick position holds.
    let differs = |model: &Model| !feels || model.names().any(|name| name == PERIODIC);
    let on = |model: &Model, lag_s: f64| QuasiStatic::new(session, &with_lag(model, drive, lag_s), noise, feels);
    let of = |index: usize| {
        let (model, lag_s) = lagged(session, &explanations[index], drive, lags(drive));
        on(&model, lag_s).law(drive, lag_s)
    };
    let wanted: Vec<usize> = (0..explanations.len()).filter(|&index| differs(&explanations[index])).collect();
    let Some(&first) = wanted.first() else { return Vec::new() };
    let mut laws = vec![of(first)];
    if wanted.contains(&smoothest) && smoothest != first {
        laws.push(of(smoothest));
    }
    let lag_s = laws[0].lag_s;
    let mut begun: Vec<(f64, usize, SlipLaw, Model)> = Vec::new();
    for &index in &wanted {
        // A quasi-static response that lags already needs no more of it.
        let wanted = if drive == Drive::Command && lag_s > 0.0 { vec![0.0, lag_s] } else { vec![lag_s] };
        let (model, lag_s) = lagged(session, &explanations[index], drive, &wanted);
        let quasi_static = on(&model, lag_s);
        let laws: Vec<SlipLaw> = quasi_static.with_own_model_error(&laws).into_iter().map(|law| SlipLaw { lag_s, ..law }).collect();
        if let Some((log_likelihood, law)) = quasi_static.best(laws, true) {
            begun.push((log_likelihood, index, law, model));
        }
    }
    begun.sort_by(|x, y| y.0.total_cmp(&x.0));
    let mut judged = Vec::new();
    for (place, (_, quasi_static, mut law, mut model)) in begun.into_iter().enumerate() {
        if place < FEW || quasi_static == first {
            law = on(&model, law.lag_s).tuned(law, &[0.15, 0.05], false);
            (model, law) = refitted(session, form, noise, model, law, &FIRST_REFITS, 1);
        }
        judged.push(Judged { log_likelihood: on(&model, law.lag_s).jumping(&law), form, law, quasi_static, model });
    }
    judged
}

/// The effect that moves a sensor within the time that a stick position holds.
const PERIODIC: &str = "periodic-disturbance";

/// Effects that change from recording to recording, or have a clock of their own: nothing that jumps looks like them.
const OF_THE_SESSION: [&str; 5] = ["offset-drift", "gain-drift", "setup-change", "clock-skew", PERIODIC];

/// Whether all effects of this model are such.
fn of_the_session(model: &Model) -> bool {
    model.names().all(|name| OF_THE_SESSION.contains(&name))
}

/// Whether the effects in the quasi-static response of the jumps bring enough beside them, over jumps on a quasi-static response with fewer.
fn pays_beside(more: &Judged, fewer: &Judged, of_the_session: bool) -> bool {
    let price = if of_the_session { BESIDE_JUMPS } else { JUMPS };
    more.log_likelihood.mean() - fewer.log_likelihood.mean() > price && is_no_chance(&more.log_likelihood, &fewer.log_likelihood)
}

/// The best of jumps of one form whose smooth effects pay beside them.
fn best_of<'a>(judged: &'a [Judged], explanations: &[Model]) -> Option<&'a Judged> {
    let worth = |one: &Judged| one.log_likelihood.mean() - PENALTY * explanations[one.quasi_static].cost() as f64;
    let with = |effects: usize| {
        let of = judged.iter().filter(move |one| explanations[one.quasi_static].slots.len() == effects);
        of.max_by(|x, y| worth(x).total_cmp(&worth(y)))
    };
    let fewest = explanations[0].slots.len();
    let mut best = with(fewest)?;
    for effects in fewest + 1..=fewest + 2 {
        if let Some(more) = with(effects)
            && worth(more) > worth(best)
            && pays_beside(more, best, of_the_session(&explanations[more.quasi_static]))
        {
            best = more;
        }
    }
    Some(best)
}

/// Whether jumps explain the recordings far better than what was found, at first sight: then they are asked for before anything smooth is
/// added to it. `base` is the model before the search.
pub fn may_jump(bench: &Bench<'_>, base: &Model, outcome: &Outcome) -> bool {
    let session = bench.session;
    let noise = noise::floor(session, &outcome.model.residuals(session));
    let mut base = base.refined();
    base.fit(session, Scope::Both);
    let mut quasi_statics = vec![base];
    if !outcome.found.order.is_empty() && !outcome.found.order.contains(&VALVE) {
        quasi_statics.push(outcome.model.clone());
    }
    let takes_part = |drive: &Drive| bench.forms.iter().any(|form| form.jumps() == Some(*drive));
    let drives = || [Drive::QuasiStatic, Drive::Command].into_iter().filter(takes_part);
    let sights: Vec<(&Model, Drive)> = quasi_statics.iter().flat_map(|one| drives().map(move |drive| (one, drive))).collect();
    let seen = parallel::in_parallel(&sights, bench.threads, |(quasi_static, drive)| {
        QuasiStatic::new(session, quasi_static, noise, false).at_first_sight(*drive)
    });
    let best = |of: fn(&(f64, f64)) -> f64| seen.iter().map(of).fold(f64::MIN, f64::max);
    best(|sight| sight.1) - best(|sight| sight.0) > JUMPS
}

/// The best simulated valve from afar, on the coarse grid, unless valves are soon seen to be far behind the model of `standing`.
pub fn simulated_valve(bench: &Bench<'_>, base: &Model, standing: &Model) -> Option<Model> {
    let mut workspace = Workspace::new(bench.session);
    let [was, is] = [base, standing].map(|model| objective(model, &mut workspace, Scope::Fit));
    let residual = base.residuals(bench.session);
    let valves: Vec<&'static dyn Form> = bench.forms.iter().copied().filter(|form| form.spec().is_narrow).collect();
    let starts = |form: &&'static dyn Form| form.starts(bench.session, &residual);
    let starts = valves.iter().zip(parallel::in_parallel(&valves, bench.threads, starts));
    let begun: Vec<Model> = starts.flat_map(|(form, starts)| starts.into_iter().map(|at| base.with(*form, at))).collect();
    cross_entropy::search(&begun, was - FAR_BEHIND * (was - is), bench.session, bench.threads)
}

/// Whether a model leaves no more than may stay unexplained.
pub fn suffices(session: &Session, base: &Model, model: &Model) -> bool {
    !Left::between(session, base, model, 0.0).is_too_much()
}

/// Whether what was found is a simulated valve and leaves too little for anything else to be looked for.
pub fn is_simulated(session: &Session, base: &Model, outcome: &Outcome) -> bool {
    outcome.found.order == [VALVE] && suffices(session, base, &outcome.model)
}

/// Whether what was found jumps, and leaves nothing that stands out of the noise and of what the times of jumps scatter by. What needs something
/// smooth beside it does not count: a search for two effects may find what needs no jumps, or a valve's simulation that needs nothing else.
pub fn explains_all(session: &Session, base: &Model, outcome: &Outcome) -> bool {
    outcome.found.order.len() == 1
        && outcome.found.jump_scatter.is_some_and(|scatter| !Left::between(session, base, &outcome.model, scatter).is_too_much())
}

/// Puts jumps in the place of what was found, or beside what of it pays beside them, where jumps explain the recordings better than
/// anything smooth; `base` is the model before the search.
pub fn rename(bench: &Bench<'_>, base: &Model, mut outcome: Outcome) -> Outcome {
    let session = bench.session;
    let forms: Vec<&'static dyn Form> = bench.forms.iter().copied().filter(|form| form.jumps().is_some()).collect();
    let simulated = outcome.found.order.contains(&VALVE);
    // What a simulated valve misses of its jumps may pass for another effect beside it.
    let is_met =
        if simulated { is_simulated(session, base, &outcome) } else { !Left::between(session, base, &outcome.model, 0.0).stands_out };
    if forms.is_empty() || is_met {
        return outcome;
    }
    let noise = noise::floor(session, &outcome.model.residuals(session));
    let explanations = explanations(bench, base, &outcome);
    let base = &explanations[0];
    let smooth = parallel::in_parallel(&explanations, bench.threads, |model| QuasiStatic::new(session, model, noise, false).smooth());
    let smoothest = (0..smooth.len()).max_by(|&x, &y| smooth[x].mean().total_cmp(&smooth[y].mean())).unwrap_or(0);
    let of_forms = parallel::in_parallel(&forms, bench.threads, |form| jumps(session, &explanations, smoothest, *form, noise));
    let mut judged: Vec<Vec<Judged>> = Vec::new();
    for of_form in of_forms.into_iter().filter(|of_form| !of_form.is_empty()) {
        match judged.iter_mut().find(|others| others[0].form.name() == of_form[0].form.name()) {
            Some(others) => others.extend(of_form),
            None => judged.push(of_form),
        }
    }
    let mut best: Vec<&Judged> = judged.iter().filter_map(|of_form| best_of(of_form, &explanations)).collect();
    best.sort_by(|x, y| y.log_likelihood.mean().total_cmp(&x.log_likelihood.mean()));
    let Some(&one) = best.first() else { return outcome };
    let log_likelihood = &one.log_likelihood;
    let gain = log_likelihood.mean() - smooth[smoothest].mean();
    let deviations = above(log_likelihood, &smooth[smoothest]);
    // Where a tip breaks away and how far beyond it lands can make up for each other, and its travel is the same.
    let length = if one.law.drive == Drive::QuasiStatic { 1.0 + one.law.overshoot.max(0.0) } else { 1.0 };
    let is_law = one.law.scatter <= MOST_SCATTER * length;
    if !is_law || !is_no_chance(log_likelihood, &smooth[smoothest]) || gain < JUMPS {
        return outcome;
    }
    outcome.found.jump_gains = best.iter().map(|one| (one.form.name(), one.log_likelihood.mean() - smooth[smoothest].mean())).collect();
    let (model, law) = refitted(session, one.form, noise, one.model.clone(), one.law, &LAST_REFITS, bench.threads);
    let polished = QuasiStatic::new(session, &with_lag(&model, law.drive, law.lag_s), noise, one.form.spec().feels_sensor).jumping(&law);
    let polished = Judged { log_likelihood: polished, form: one.form, law, quasi_static: one.quasi_static, model };
    let is_polished = polished.log_likelihood.mean() > one.log_likelihood.mean();
    let one = if is_polished { &polished } else { one };
    let first_select = base.clone().fit(session, Scope::Both).1;
    let with_jumps = |one: &Judged, is_polished: bool| {
        let mut model = one.model.with(one.form, one.law.as_parameters(noise));
        // What the slips of the last refits told is not for a fit to the output to change.
        model.fixed_weights = is_polished && one.law.drive == Drive::QuasiStatic;
        let (_, select) = model.fit(session, Scope::Both);
        (model, select)
    };
    let (model, select) = with_jumps(one, is_polished);
    let name = one.form.name();
    let beside = &explanations[one.quasi_static];
    // The other kinds of jumps are compared with these.
    outcome.met.splice(0..0, best.iter().filter(|other| other.form.name() != name).map(|other| with_jumps(other, false).0));
    outcome.found.jump_scatter = Some(
        QuasiStatic::new(session, &with_lag(&one.model, one.law.drive, one.law.lag_s), noise, one.form.spec().feels_sensor)
            .scatter(&one.law),
    );
    outcome.found.candidates.retain(|candidate| candidate.name != name);
    outcome.found.candidates.insert(0, Candidate { name: name.to_owned(), score: 1.0 - select / first_select, p_value: tail(deviations) });
    let simulation = std::mem::replace(&mut outcome.model, model);
    if simulated {
        outcome.met.insert(0, simulation);
    }
    if name == VALVE && bench.forms.iter().any(|form| form.spec().is_narrow) {
        // Of several models of the same forms the first is compared: the one that leaves less.
        let simulation = switching_refits::simulated(session, beside, &one.law, bench.threads);
        let left = |model: &Model| model.clone().fit(session, Scope::Both).1;
        if outcome.met.iter().find(|met| met.forms() == simulation.forms()).is_none_or(|met| left(&simulation) < left(met)) {
            outcome.met.insert(0, simulation);
        }
    }
    let mut order: Vec<&'static str> = beside.names().filter(|name| base.names().all(|owned| owned != *name)).collect();
    order.push(name);
    outcome.found.order = order;
    outcome
}

#[cfg(test)]
mod tests;
