//! Two effects that recordings hardly tell apart: a short lag and thresholds that grow with the rate.
//!
//! To first order in its time constant a lag delays what moves, and so do thresholds that all grow in proportion to the rate. They differ
//! to second order only, by what the growth remembers, and that lies below the price that a parameter has elsewhere, which guards against
//! forms that are not quite the rig's. So where one of the two was found, the other is fitted in its place. Within that price the answer
//! is both: the recordings that took no part in the fit decide which of them comes first, and a parameter more or less has no say.

use crate::effects::rate_dependent_hysteresis;
use crate::search::simplex::PENALTY;
use crate::selection::rounds;
use crate::selection::rounds::{Bench, Judged, POLISH, leaders};
use crate::selection::settings::LIKELY;

/// The two.
const PAIR: [&str; 2] = ["pneumatic-lag", "rate-dependent-hysteresis"];

/// What came of fitting the other of the two.
pub struct Alike {
    /// The explanation that comes first.
    pub first: Judged,
    /// The other, where the recordings do not tell it from the first.
    pub second: Option<(Judged, &'static str)>,
}

/// Fits the other of the two in the place of the one that `standing` has, if it has just one and nobody gave it; `owned` are those given.
pub fn compare(bench: &Bench<'_>, standing: Judged, owned: &[&str]) -> Alike {
    let names: Vec<&str> = standing.model.names().collect();
    let has = |name: &str| names.contains(&name);
    let (here, other) = match PAIR.map(has) {
        [true, false] => (PAIR[0], PAIR[1]),
        [false, true] => (PAIR[1], PAIR[0]),
        _ => return Alike { first: standing, second: None },
    };
    let slot = names.iter().position(|name| *name == here).unwrap_or(0);
    let forms = bench.forms.iter().copied().filter(|form| form.name() == other).collect();
    let of_other = Bench { session: bench.session, forms, threads: bench.threads };
    let tried = if owned.contains(&here) { Vec::new() } else { of_other.round(&standing.model.without(slot), PENALTY) };
    let mut begins = leaders(&tried);
    if here == PAIR[0] && !tried.is_empty() {
        let (form, parameters) = rate_dependent_hysteresis::like_a_lag(standing.model.slots[slot].parameters[0]);
        begins.push(standing.model.without(slot).with(form, parameters));
    }
    let rival = bench.polished(&begins, POLISH).into_iter().min_by(|x, y| x.select.total_cmp(&y.select));
    let Some(rival) = rival else { return Alike { first: standing, second: None } };
    if rival.penalised() < standing.penalised() - PENALTY {
        return Alike { first: rival, second: None };
    }
    if (rival.select / standing.select).ln().abs() > PENALTY {
        return Alike { first: standing, second: None };
    }
    if rival.select < standing.select && rounds::deviations(&standing.blocks, &rival.blocks) > LIKELY {
        Alike { first: rival, second: Some((standing, here)) }
    } else {
        Alike { first: standing, second: Some((rival, other)) }
    }
}

#[cfg(test)]
mod tests {
    use crate::discover;
    use crate::result::{DiscoverConfig, Verdict};
    use virtual_rig as rig;
    use virtual_rig::{Case, CaseConfig, Generator};

    #[test]
    fn where_a_short_lag_and_growth_with_the_rate_are_alike_both_are_told() {
        let hidden = |effect: &str, seed| {
            let config = CaseConfig { effects: vec![effect.to_owned()], seed, generator: Generator::Rival, ..CaseConfig::default() };
            rig::hide(&config).expect("a case")
        };
        let answer = |case: &Case| {
            let config = DiscoverConfig { most_effects: 1, ..DiscoverConfig::default() };
            discover(&case.recordings, &case.kept_out, &config).expect("a finding").discovery
        };
        // 15 ms at one span per s: the truth comes first, or second.
        let short = answer(&hidden("rate-dependent-hysteresis", 540));
        let mut pseudo_measurements =
            vec![short.effects[0].name.as_str(), short.runner_up.as_ref().map_or("", |second| second.name.as_str())];
        pseudo_measurements.sort_unstable();
        assert_eq!(short.verdict, Verdict::Ambiguous, "{short:?}");
        assert_eq!(pseudo_measurements, crate::selection::alike::PAIR);
        // A lag of a quarter of a second is like nothing else.
        let is_long = |case: &Case| case.truth.parameters["pneumatic-lag.time_constant_s"] > 0.2;
        let long = (540..560).map(|seed| hidden("pneumatic-lag", seed)).find(is_long).expect("a long lag");
        let long = answer(&long);
        assert_eq!((long.verdict, long.effects[0].name.as_str()), (Verdict::Named, "pneumatic-lag"), "{long:?}");
    }
}
