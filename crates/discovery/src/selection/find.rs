//! The search: a first effect; where it leaves something a simulated valve, what jumps, if it shows at first sight, and two together; and a third.
//! Which of them stay is decided where all explanations are compared.

use crate::data::noise;
use crate::data::session::Session;
use crate::data::statistics::tail;
use crate::effects::catalogue;
use crate::effects::offset_drift::{LEFT_BY_CREEP, gives_zeros};
use crate::model::structure::{Model, Scope};
use crate::result::{Candidate, DiscoverConfig};
use crate::search::forms;
use crate::search::parallel::{Progress, Watch};
use crate::search::simplex::PENALTY;
use crate::selection::found::{Found, Outcome};
use crate::selection::rounds::{Bench, Judged, POLISH, Tried, leaders};
use crate::selection::settings::{LIKELY, MATERIAL_SHARE, STANDS_OUT};
use crate::selection::{pairs, switching_selection};

/// Effects that only valve, supply and tube can have: what the measured pressure does not show is none of them.
pub const PNEUMATIC: [&str; 5] = ["slew-limit", "valve-dead-band", "supply-saturation", "fill-vent-asymmetry", "leakage"];

/// What goes on by itself while the input rests.
const RHYTHM: &str = "periodic-disturbance";

/// What goes on between recordings.
const CREEP: &str = "creep";

/// Searches the whole catalogue, without the effects that a measured pressure has ruled out.
pub fn effects(session: &Session, model: Model, pressure_path: Option<&[String]>, config: &DiscoverConfig, watch: Watch<'_>) -> Outcome {
    let mut forms = catalogue::forms();
    if let Some(named) = pressure_path {
        forms.retain(|form| !PNEUMATIC.contains(&form.name()) || named.iter().any(|name| name == form.name()));
    }
    // A sensor that reads in steps wider than its noise holds and jumps by itself: a tip that sticks could not be told from it.
    if session.output_step > 2.0 * noise::floor(session, &model.residuals(session)) {
        forms.retain(|form| form.name() != "stick-slip");
    }
    let bench = Bench { session, forms, threads: config.threads, watch };
    let first = First::new(&bench, model.clone(), config.most_effects > 0);
    if first.wants_more(session) {
        let mut alone = first.outcome();
        // A simulated valve that suffices needs no observer, and beside it only what suffices as well is an explanation.
        if switching_selection::is_simulated(session, &model, &alone) {
            alone.met.retain(|met| switching_selection::suffices(session, &model, met));
            alone.tried.clear();
            return alone;
        }
        if switching_selection::may_jump(&bench, &model, &alone) {
            watch(Progress::Stage("what jumps"));
            let outcome = switching_selection::rename(&bench, &model, alone);
            if switching_selection::explains_all(session, &model, &outcome) {
                return outcome;
            }
        }
    }
    let outcome = first.and_further(&bench, config.most_effects);
    watch(Progress::Stage("what jumps"));
    switching_selection::rename(&bench, &model, outcome)
}

/// Adds effects to `model` as long as they pay; those that it has already stay.
pub fn find(bench: &Bench<'_>, model: Model, most_effects: usize) -> Outcome {
    First::new(bench, model, most_effects > 0).and_further(bench, most_effects)
}

/// What the search knows when every effect has been tried alone.
struct First {
    /// The model before the search.
    base: Model,
    /// The same as it is judged.
    bare: Judged,
    /// Every form, best first.
    tried: Vec<Tried>,
    /// The best of them, polished, best first.
    firsts: Vec<Judged>,
    /// Whether the best one pays.
    pays: bool,
    /// Every effect in its best form.
    candidates: Vec<Candidate>,
}

impl First {
    fn new(bench: &Bench<'_>, mut base: Model, any: bool) -> Self {
        base.fit(bench.session, Scope::Both);
        let bare = bench.judge(&base);
        (bench.watch)(Progress::Stage("every effect"));
        let tried = bench.round(&base, PENALTY);
        let of = |one: &Tried| Candidate {
            name: one.form.name().to_owned(),
            score: 1.0 - one.fitted.select / bare.select,
            p_value: tail(one.deviations),
        };
        let candidates = best_of_each(tried.iter()).map(of).collect();
        let mut firsts = bench.polished(&leaders(&tried), POLISH);
        // What the best effect leaves may be for another of its own forms to take away, before it is for a second effect.
        if let Some(best) = firsts.first().filter(|best| leaves(bench.session, best)) {
            let is_new = |one: &&Tried| {
                best.model.names().any(|name| name == one.form.name())
                    && firsts.iter().all(|first| first.model.forms() != one.fitted.model.forms())
            };
            let others: Vec<Model> = tried.iter().filter(is_new).map(|one| one.fitted.model.clone()).collect();
            firsts.extend(bench.polished(&others, POLISH));
            firsts.sort_by(|x, y| x.penalised().total_cmp(&y.penalised()));
        }
        let pays = |firsts: &[Judged]| firsts.first().is_some_and(|first| any && first.pays(&bare, PENALTY));
        let standing = firsts.first().filter(|_| pays(&firsts)).unwrap_or(&bare);
        if !firsts.is_empty() && leaves(bench.session, standing) {
            (bench.watch)(Progress::Stage("a simulated valve"));
            let valve = switching_selection::simulated_valve(bench, &base, &standing.model);
            firsts.extend(bench.polished(valve.as_slice(), POLISH));
            firsts.sort_by(|x, y| x.penalised().total_cmp(&y.penalised()));
        }
        let pays = pays(&firsts);
        Self { base, bare, tried, firsts, pays, candidates }
    }

    /// What explains most so far.
    fn standing(&self) -> &Judged {
        if self.pays { &self.firsts[0] } else { &self.bare }
    }

    /// Whether so much is left that two effects are looked for.
    fn wants_more(&self, session: &Session) -> bool {
        // Two effects may each take away too little alone: where much is left without either, they are tried together as well.
        !self.firsts.is_empty() && leaves(session, self.standing())
    }

    /// The best effect alone as an outcome.
    fn outcome(&self) -> Outcome {
        let owned: Vec<&'static str> = self.base.names().collect();
        let found = Found { order: new_names(&self.standing().model, &owned), candidates: self.candidates.clone(), ..Found::default() };
        let met = self.firsts.iter().map(|one| one.fine.pruned()).collect();
        Outcome { model: self.standing().fine.pruned(), found, met, tried: not_by_chance(&self.tried) }
    }

    /// Adds further effects as long as they pay.
    fn and_further(self, bench: &Bench<'_>, most_effects: usize) -> Outcome {
        let session = bench.session;
        let wants_more = self.wants_more(session);
        let mut standing = self.standing().clone();
        let Self { base: model, bare, tried, firsts, pays, candidates } = self;
        let owned: Vec<&'static str> = model.names().collect();
        let mut found = Found { candidates, ..Found::default() };
        let mut rivals: Vec<Judged> = if pays { firsts.clone() } else { Vec::new() };
        if most_effects > 1 && wants_more {
            (bench.watch)(Progress::Stage("a second effect"));
            // A little beside all that there was is what the form of an effect leaves.
            let leaves_much = |pair: &Judged| leaves(session, pair) && pair.select > MATERIAL_SHARE * bare.select;
            let pairs = pairs::search(bench, &model, &tried, &firsts, &leaves_much);
            if let Some(pair) = pairs.first().filter(|pair| pair.pays(&standing, least_further(session, &standing))) {
                standing = pair.clone();
                rivals = pairs;
            }
        }
        if !rivals.is_empty() {
            while (2..most_effects).contains(&(standing.model.slots.len() - owned.len())) && leaves(session, &standing) {
                (bench.watch)(Progress::Stage("a third effect"));
                let least = least_further(session, &standing);
                let further = bench.polished(&leaders(&bench.round(&standing.model, least)), POLISH);
                let Some(best) = further.into_iter().next().filter(|best| best.pays(&standing, least)) else { break };
                standing = best;
            }
        }
        // A slow rhythm is at rest too, and passes for noise until it is told.
        let count = standing.model.slots.len() - owned.len();
        if (1..most_effects).contains(&count)
            && standing.model.names().all(|name| name != RHYTHM)
            && noise::may_hold_a_rhythm(session, &standing.fine.residuals(session))
        {
            let forms = bench.forms.iter().copied().filter(|form| form.name() == RHYTHM).collect();
            let of_rhythms = Bench { forms, ..*bench };
            let least = least_further(session, &standing);
            let with_rhythm = bench.polished(&leaders(&of_rhythms.round(&standing.model, least)), POLISH).into_iter().next();
            if let Some(best) = with_rhythm.filter(|best| best.pays(&standing, least)) {
                standing = best;
            }
        }
        // Creep slower than the session, or through pauses that nobody recorded, leaves a zero in each recording, and no drift need be missing.
        if standing.model.names().any(|name| name == CREEP) {
            for slot in standing.model.slots.iter_mut().chain(&mut standing.fine.slots).filter(|slot| gives_zeros(slot.form)) {
                slot.form = LEFT_BY_CREEP;
            }
        }
        found.order = new_names(&standing.model, &owned);
        let mut model = standing.fine.pruned();
        if !model.slots.is_empty() {
            let last = forms::polish(&model, session, Scope::Fit, 2 * POLISH);
            if last.select <= standing.select {
                model = last.model;
            }
        }
        let met = rivals.iter().chain(&firsts).map(|one| one.fine.pruned()).collect();
        Outcome { model, found, met, tried: not_by_chance(&tried) }
    }
}

/// Every effect in its best form.
fn best_of_each<'a>(tried: impl Iterator<Item = &'a Tried>) -> impl Iterator<Item = &'a Tried> {
    let mut names: Vec<&str> = Vec::new();
    tried.filter(move |one| {
        let is_new = !names.contains(&one.form.name());
        names.push(one.form.name());
        is_new
    })
}

/// Every effect in its best form that chance does not explain.
fn not_by_chance(tried: &[Tried]) -> Vec<Model> {
    best_of_each(tried.iter().filter(|one| one.deviations > LIKELY)).map(|one| one.fitted.model.clone()).collect()
}

/// Whether something above the noise is left on the selecting samples.
fn leaves(session: &Session, standing: &Judged) -> bool {
    standing.select > STANDS_OUT * STANDS_OUT * noise::floor(session, &standing.fine.residuals(session)).powi(2)
}

/// Least share of the mean square that a further effect takes away: of what is left above the noise, and of all as much as two prices.
fn least_further(session: &Session, standing: &Judged) -> f64 {
    let floor_square = noise::floor(session, &standing.fine.residuals(session)).powi(2);
    let left = (standing.select - floor_square).max(0.0);
    (MATERIAL_SHARE * left / standing.select).max(2.0 * PENALTY)
}

/// Names of a model's effects without those `owned`.
fn new_names(model: &Model, owned: &[&str]) -> Vec<&'static str> {
    model.names().filter(|name| !owned.contains(name)).collect()
}

#[cfg(test)]
mod tests {
    use crate::discover;
    use crate::result::DiscoverConfig;
    use virtual_rig as rig;
    use virtual_rig::{CaseConfig, Generator};

    #[test]
    fn a_lag_beside_a_leak_is_a_lag_and_not_two_time_constants_that_are_nearly_one() {
        let effects = vec!["pneumatic-lag".to_owned(), "leakage".to_owned()];
        let config = CaseConfig { effects, seed: 3480, generator: Generator::ComposedTuning, ..CaseConfig::default() };
        let case = rig::hide(&config).expect("a case");
        let discovery = discover(&case.recordings, &case.kept_out, &DiscoverConfig::default()).expect("a finding").discovery;
        let mut names: Vec<&str> = discovery.effects.iter().map(|effect| effect.name.as_str()).collect();
        names.sort_unstable();
        assert_eq!(names, ["leakage", "pneumatic-lag"], "{discovery:?}");
    }
}
