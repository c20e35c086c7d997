//! From recordings to a finding: preparation, search, verdict, figures.

use recording::{ExtraColumn, Recording};

use crate::chain::form::Place;
use crate::data::session::{Run, Session, SessionError};
use crate::data::{mask, noise};
use crate::effects::catalogue;
use crate::explanation::{diagnosis, horizon, residual_map};
use crate::files::figures;
use crate::files::file::DiscoveredModel;
use crate::model::initial_state::InitialState;
use crate::model::structure::{Model, Scope};
use crate::result::{DiscoverConfig, Discovery, Verdict};
use crate::search::parallel::{Progress, Watch, both};
use crate::selection::found::Outcome;
use crate::selection::rounds::Bench;
use crate::selection::settings::STANDS_OUT;
use crate::selection::verdict::Jumping;
use crate::selection::{decision, find, leaves, verdict};

/// A finished discovery: the result and what it was made of.
pub struct Finding {
    /// The result.
    pub discovery: Discovery,
    /// The recordings, normalised.
    pub session: Session,
    /// The model without effects.
    pub before: Model,
    /// The model with them.
    pub after: Model,
    /// The model with the second best effect instead, where there is one.
    pub second: Option<Model>,
    /// What the simulation without effects predicts for every run, normalised: the given model's word, or `before`'s.
    pub simulated: Vec<Vec<f64>>,
    /// What the simulation with them predicts for runs of recordings that the figures count, normalised.
    pub with_effects: Vec<Option<Vec<f64>>>,
}

/// Where to start from: a simulation model that somebody already has.
pub struct Start {
    /// Its predictions, one for each recording and then each kept one, in output units.
    pub predictions: Vec<Vec<f64>>,
    /// The file, when discovery wrote it: its effects are kept, and what is found comes on top.
    pub discovered: Option<DiscoveredModel>,
}

/// Finds what the model lacks in `recordings`; `kept` take no part in any choice (some of `recordings` are set apart when empty).
///
/// # Errors
/// When there is too little to learn from.
pub fn discover(recordings: &[Recording], kept: &[Recording], config: &DiscoverConfig) -> Result<Finding, SessionError> {
    discover_from(recordings, kept, None, config, &|_| {})
}

/// As [`discover`], from a given simulation model; `watch` hears of every stage and its parts.
///
/// # Errors
/// When there is too little to learn from.
pub fn discover_from(
    recordings: &[Recording],
    kept: &[Recording],
    start: Option<&Start>,
    config: &DiscoverConfig,
    watch: Watch<'_>,
) -> Result<Finding, SessionError> {
    watch(Progress::Stage("baseline"));
    let pressure_path = match measured_pressure(recordings) {
        Some(path) => Some(effects_of_the_pressure(&path, config)?),
        None => None,
    };
    let (mut session, test) = Session::split(recordings, kept)?;
    let mut before = prepare(&mut session);
    let given = start.map(|start| session.normalised(&start.predictions));
    let mut model = before.clone();
    if let Some(file) = start.and_then(|start| start.discovered.as_ref()) {
        model.slots = file.slots_in(&session).map_err(|problem| SessionError::Model { problem })?;
        model = model.with_others(&session);
    }
    let base = model.clone();
    let suffices = given.as_ref().is_some_and(|given| leaves_noise(&session, given));
    let search =
        if suffices { Outcome::of(&session, &model) } else { find::effects(&session, model, pressure_path.as_deref(), config, watch) };
    watch(Progress::Stage("figures"));
    let mut found = search.model.clone();
    // Fast motion that the first model lacked may have looked wrong: only what the last model finds wrong too is an outlier.
    session.unmask();
    let residual = found.residuals(&session);
    let kind = if search.found.jump_scatter.is_some() { mask::Residual::OfJumps } else { mask::Residual::OfModel };
    mask::outliers(&mut session, &residual, kind);
    both(
        config.threads,
        || before.fit_all(&session),
        || {
            found.fit_all(&session);
            found.anchor(&session);
        },
    );
    let mut decision = decision::decide(&session, &base, &search, &found, config.seed, config.threads);
    let loop_area = diagnosis::loop_area(&session, &before, config.threads);
    before = before.refined();
    before.fit_all(&session);
    before = before.pruned();
    // Where nothing was found the model is the same before and after, to the last digit.
    if decision.model.slots.is_empty() {
        decision.model = before.clone();
    }
    let after = decision.model.clone();
    let simulate = |session: &Session| given.clone().unwrap_or_else(|| before.outputs(session, |_| true));
    let residual_before = residuals(&session, &simulate(&session));
    let mut discovery = verdict::judge(&session, &residual_before, &decision, &search.found);
    if suffices && discovery.effects.is_empty() {
        discovery.verdict = Verdict::None;
    }
    // All is decided: from here on it is the report.
    test.reveal(&mut session);
    let simulated = simulate(&session);
    let residual_before = residuals(&session, &simulated);
    let written = |model: &Model| DiscoveredModel::bare(model, &session, &recordings[0]);
    let with_effects = written(&after);
    discovery.calibrate_s = with_effects.calibrate_s;
    let calibrate_s = discovery.calibrate_s.unwrap_or(0.0);
    let counted = figures::Counted::new(&session, &after, recordings, kept, config.threads);
    let was = match start {
        Some(start) => counted.given(&start.predictions, calibrate_s),
        None => counted.simulate(&written(&before), calibrate_s)?,
    };
    let is = counted.simulate(&with_effects, calibrate_s)?;
    let jumping = Jumping::of(&session, &after, &search.found.jump_gains, config.threads);
    verdict::confirm(&mut discovery, was.rmse, is.rmse, session.output_scale.abs(), jumping);
    discovery.beyond_range = verdict::beyond_range(&session);
    let with_effects = session.normalised_where(&is.outputs);
    (discovery.disagreements, (discovery.memory_horizon, discovery.residual_before, discovery.residual_after)) = both(
        config.threads,
        || residual_map::disagreements(&session, &residual_before, config.seed),
        || {
            // Its predictors see the first input only.
            let horizon = if session.others.is_empty() { horizon::horizon(&session) } else { Vec::new() };
            (horizon, diagnosis::examine(&session, &residual_before), diagnosis::examine(&session, &after.residuals(&session)))
        },
    );
    discovery.summary =
        residual_map::sentence(&discovery.disagreements, discovery.rmse_before, discovery.noise_floor, &session.output_unit);
    discovery.loop_area = loop_area;
    discovery.pressure_path = pressure_path;
    let runner_up = |second: &Model| discovery.runner_up.as_ref().is_some_and(|one| second.names().any(|name| name == one.name));
    let second = decision.second.filter(runner_up);
    Ok(Finding { discovery, session, before, after, second, simulated, with_effects })
}

/// Whether a simulation leaves no more than the noise.
fn leaves_noise(session: &Session, simulated: &[Vec<f64>]) -> bool {
    let missed = residuals(session, simulated);
    leaves::worked(session, &missed, false).sqrt() < STANDS_OUT * noise::floor(session, &missed)
}

/// Measured minus simulated.
fn residuals(session: &Session, simulated: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let of = |(run, simulated): (&Run, &Vec<f64>)| run.output.iter().zip(simulated).map(|(y, p)| y - p).collect();
    session.runs.iter().zip(simulated).map(of).collect()
}

/// Masks outliers and fits the baseline, twice: the first fit is pulled about by what it is to find.
pub(crate) fn prepare(session: &mut Session) -> Model {
    let zero: Vec<Vec<f64>> = session.runs.iter().map(|run| run.output.clone()).collect();
    mask::outliers(session, &zero, mask::Residual::Output);
    let mut before = baseline(session);
    for _ in 0..2 {
        let residual = before.residuals(session);
        mask::outliers(session, &residual, mask::Residual::OfModel);
        before.fit(session, Scope::Fit);
    }
    before.fit(session, Scope::Both);
    before
}

/// The recordings with the measured pressure as their output, when all have one.
fn measured_pressure(recordings: &[Recording]) -> Option<Vec<Recording>> {
    let column = |recording: &Recording| -> Option<ExtraColumn> {
        recording.extra.iter().find(|column| column.name == "pressure_measured_bar").cloned()
    };
    recordings.iter().map(|recording| column(recording).map(|column| Recording { output: column.values, ..recording.clone() })).collect()
}

/// Names of what happens between command and measured pressure: valve, supply and tube.
fn effects_of_the_pressure(recordings: &[Recording], config: &DiscoverConfig) -> Result<Vec<String>, SessionError> {
    let mut session = Session::new(recordings, &[])?;
    let before = prepare(&mut session);
    let mut forms = catalogue::forms();
    forms.retain(|form| form.place() <= Place::Tube);
    let bench = Bench { session: &session, forms, threads: config.threads, watch: &|_| {} };
    let found = find::find(&bench, before, 1);
    Ok(found.found.order.into_iter().map(str::to_owned).collect())
}

/// The baseline that fits best: operators that begin fresh in every recording, or ones that remember.
fn baseline(session: &Session) -> Model {
    let mut fresh = Model::baseline(InitialState::Fresh, false).with_others(session);
    let mut stops = Model::baseline(InitialState::Fresh, true).with_others(session);
    let (fresh_square, _) = fresh.fit(session, Scope::Fit);
    let (stops_square, _) = stops.fit(session, Scope::Fit);
    if stops_square < 0.5 * fresh_square {
        return stops;
    }
    fresh.with_best_initial_state(session).model
}
