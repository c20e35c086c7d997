//! Fitting a smooth model beside what sticks and slips, the law of that again on the model, and a valve as a simulation.

use crate::chain::form::{Drive, Form};
use crate::data::session::Session;
use crate::effects::sticking::inferred_quasi_static;
use crate::effects::{pneumatic_lag, sticking, valve_dead_band};
use crate::model::structure::{Model, Scope};
use crate::observers::law::SlipLaw;
use crate::search::{cross_entropy, forms};
use crate::selection::rounds::POLISH;
use crate::selection::switching_likelihood::QuasiStatic;

/// What moves follows with a lag of one pole: the form that leads the operators by it.
pub fn lag_of(drive: Drive) -> &'static dyn Form {
    match drive {
        Drive::QuasiStatic => pneumatic_lag::FORMS[0],
        Drive::Command => sticking::LAG_WITHOUT_DEAD_BAND,
    }
}

/// The model behind a lag of what moves; a form of jumps has that lag of its own.
pub fn with_lag(model: &Model, drive: Drive, lag_s: f64) -> Model {
    if lag_s > 0.0 { model.with(lag_of(drive), vec![lag_s]) } else { model.clone() }
}

/// The model with the weights that it has behind this lag, and the mean square of the fitted samples.
pub fn fitted_behind(session: &Session, model: &Model, drive: Drive, lag_s: f64) -> (Model, f64) {
    let mut lagging = with_lag(model, drive, lag_s);
    let (fit, _) = lagging.fit(session, Scope::Both);
    if lag_s > 0.0 {
        lagging.slots.remove(model.slots.partition_point(|slot| slot.form.place() <= lag_of(drive).place()));
    }
    (lagging, fit)
}

/// The lag of what moves, of these, by the mean, whatever its stick positions, and the model behind it.
pub fn lagged(session: &Session, model: &Model, drive: Drive, lags: &[f64]) -> (Model, f64) {
    let of = |&lag_s: &f64| (fitted_behind(session, model, drive, lag_s), lag_s);
    let best = lags.iter().map(of).min_by(|x, y| x.0.1.total_cmp(&y.0.1));
    best.map_or_else(|| (model.clone(), 0.0), |((model, _), lag_s)| (model, lag_s))
}

/// The model with its weights fitted beside the jumps, and the law of these found again on it, as often as `refits` says at most, and only as
/// long as it helps. The weights were fitted as if what jumps were noise; what it is expected to depart by is known now.
pub fn refitted(
    session: &Session,
    form: &'static dyn Form,
    noise: f64,
    model: Model,
    law: SlipLaw,
    refits: &Refits,
    threads: usize,
) -> (Model, SlipLaw) {
    let (drive, lag_s) = (law.drive, law.lag_s);
    let on = |model: &Model| QuasiStatic::new(session, &with_lag(model, drive, lag_s), noise, form.spec().feels_sensor).by(threads);
    let value = on(&model).fitting(&law);
    if drive == Drive::Command && !law.leads_the_muscle() && on(&model).is_of_a_bank() {
        let led = SlipLaw { overshoot: 0.0, ..law };
        let begun = without_mean_error(&model.regrown(), law.overshoot * law.break_away);
        let led = refits_of(&on, form, noise, (begun, led, f64::MIN), refits);
        if led.2 > value {
            return (led.0.pruned(), led.1);
        }
    }
    let is_told = drive == Drive::QuasiStatic && refits.whole;
    let begun = if is_told { pseudo_measurements(&on, form, noise, &model, law) } else { None };
    let (model, law, _) = refits_of(&on, form, noise, begun.unwrap_or((model, law, value)), refits);
    let law = if is_told { on(&model).tuned_to_miss_least(law, &LAST_STEPS, true) } else { law };
    (model, law)
}

/// Steps of the last look for a tip's law, by what it misses: recordings that are kept out are judged by that.
pub const LAST_STEPS: [f64; 4] = [0.1, 0.03, 0.01, 0.003];

/// How far short of the quasi-static response a tip may land, in break-away distances: with its mean error taken for hysteresis any of these looks the same.
pub const SHORT: [f64; 3] = [0.0, 0.15, 0.35];

/// The model as the slips of a tip tell its quasi-static response, the law on it and the log-likelihood for them.
pub fn pseudo_measurements<'a>(
    on: &dyn Fn(&Model) -> QuasiStatic<'a>,
    form: &'static dyn Form,
    noise: f64,
    model: &Model,
    law: SlipLaw,
) -> Option<(Model, SlipLaw, f64)> {
    let session = on(model).session();
    let travel = (1.0 + law.overshoot) * law.break_away;
    let overshoot = SHORT.map(|short| {
        let farther = travel / (1.0 - short) - law.break_away;
        let mut pseudo_measurements = to_be_inferred(model, form, noise, law, farther);
        pseudo_measurements.fit_once(session, Scope::Both);
        let model = without_jumps(&pseudo_measurements).pruned();
        let quasi_static = on(&model);
        let law = quasi_static.tuned(quasi_static.with_own_begin(law.of_a_response_farther(farther)), &FIRST_STEPS_INFERRED, true);
        let value = quasi_static.fitting(&law);
        (model, law, value)
    });
    overshoot.into_iter().filter(|(_, _, value)| value.is_finite()).max_by(|x, y| x.2.total_cmp(&y.2))
}

/// The model on the whole grid, to be fitted to the quasi-static response that a tip tells, this much farther from the stick position.
pub fn to_be_inferred(model: &Model, form: &'static dyn Form, noise: f64, law: SlipLaw, farther: f64) -> Model {
    model.regrown().with(inferred_quasi_static(form.spec().feels_sensor), [law.as_parameters(noise), vec![farther]].concat())
}

/// The model without what jumps in it.
pub fn without_jumps(model: &Model) -> Model {
    model.without(model.slots.iter().position(|slot| slot.form.jumps().is_some()).unwrap_or(0))
}

/// As [`refitted`], from a model, a law and the log-likelihood for them on; with the last log-likelihood.
pub fn refits_of<'a>(
    on: &dyn Fn(&Model) -> QuasiStatic<'a>,
    form: &'static dyn Form,
    noise: f64,
    (mut model, mut law, mut value): (Model, SlipLaw, f64),
    refits: &Refits,
) -> (Model, SlipLaw, f64) {
    for _ in 0..refits.times {
        let is_told = law.drive == Drive::QuasiStatic && refits.whole;
        let mut with = if is_told { to_be_inferred(&model, form, noise, law, 0.0) } else { model.with(form, law.as_parameters(noise)) };
        with.fit(on(&model).session(), Scope::Both);
        let without = without_jumps(&with);
        let without = if is_told { without.pruned() } else { without };
        let quasi_static = on(&without);
        let begun = if is_told { quasi_static.with_own_begin(law) } else { law };
        let again = quasi_static.tuned(begun, refits.steps, refits.whole);
        let better = quasi_static.fitting(&again);
        if better <= value {
            break;
        }
        (model, law, value) = (without, again, better);
    }
    (model, law, value)
}

/// The model with its thresholds smaller by the mean error of a valve that they have taken for hysteresis, on the same grid.
pub fn without_mean_error(model: &Model, mean_error: f64) -> Model {
    let mut nearer = model.clone();
    nearer.base[1..].fill(0.0);
    for (&threshold, &weight) in model.thresholds.iter().zip(&model.base[1..]) {
        let wanted = (threshold - mean_error).max(0.0);
        let above = model.thresholds.partition_point(|other| *other <= wanted).min(model.thresholds.len() - 1).max(1);
        let (low, high) = (model.thresholds[above - 1], model.thresholds[above]);
        let share = ((wanted - low) / (high - low)).clamp(0.0, 1.0);
        nearer.base[above] += (1.0 - share) * weight;
        nearer.base[above + 1] += share * weight;
    }
    nearer
}

/// A valve as a simulation, beside the smooth effects of `beside`. The law of a staircase lies in a valley that a search from afar misses; the observer,
/// which sees every jump from where the pressure stands, says where, by its `law`.
pub fn simulated(session: &Session, beside: &Model, law: &SlipLaw, threads: usize) -> Model {
    let coarse = Model { slots: beside.slots.clone(), ..Model::baseline(beside.initial_state, beside.stops) };
    let begun = valve_dead_band::nearest(&law.valve()).map(|(form, start)| coarse.with(form, start));
    let best = cross_entropy::search(&begun, f64::INFINITY, session, threads).unwrap_or(coarse);
    let mut model = forms::polish(&best, session, Scope::Fit, 2 * POLISH).model.refined();
    model.fit(session, Scope::Both);
    model.pruned()
}

/// How often weights are fitted again beside the jumps, and how their law is found again.
pub struct Refits {
    pub times: usize,
    pub steps: &'static [f64],
    /// Whether a tip's law is found with all of its parameters.
    pub whole: bool,
}

/// Those by which jumps are compared.
pub const FIRST_REFITS: Refits = Refits { times: 2, steps: &[0.1], whole: false };

/// Those of the jumps that are named.
pub const LAST_REFITS: Refits = Refits { times: 5, steps: &[0.1, 0.03, 0.01, 0.003], whole: true };

/// Those by which quasi-static responses that a tip tells are compared.
pub const FIRST_STEPS_INFERRED: [f64; 2] = [0.1, 0.03];
