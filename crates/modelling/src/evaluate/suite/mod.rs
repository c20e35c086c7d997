//! The acceptance suite: what a model must do beyond a small error on recordings like those it was trained on.
//!
//! A network can have a tiny RMSE and still drift while the pressure rests, depend on where it started, or diverge after ten minutes;
//! each criterion here has caught a real model doing one of these. Where the *plant* that made the recordings is known (a simulated
//! rig), it makes new truth for every criterion (`with_plant`). Where it is not (a measured rig), the suite asks what can be
//! asked without truth (`without_plant`): an output that rests when the input rests, that repeats when the input repeats, and that
//! forgets its start when the input has wiped it out.
//!
//! Seeds: the suite's excitations come from `--seed` plus [`SEED_OFFSET`], so that a model trained on `simulate --seed N` is not judged
//! on the signals of seed N.

mod plants;
mod report;
mod with_plant;
mod without_plant;

use anyhow::Result;

pub use plants::{KnownPlant, find};
pub use report::{Criterion, HOLD_S, HOLD_TIMES_S, Hold, LONG_RUN, Limits, Request, SEED_OFFSET, SuiteReport};

use super::compare::compare;
use super::mean_nrmse;
use crate::model::Predictor;
use report::output_range;

/// Runs the suite.
///
/// # Errors
/// When a model cannot be run. A limit that does not hold is no error but a criterion that is not passed.
pub fn run(request: &Request<'_>) -> Result<SuiteReport> {
    let mut report = SuiteReport {
        plant: request.plant.map(|plant| plant.name.clone()),
        passed: false,
        criteria: Vec::new(),
        holds: Vec::new(),
        hold_times_s: HOLD_TIMES_S.to_vec(),
        long_run: Vec::new(),
        fixed_point: None,
        not_judged: Vec::new(),
    };
    on_recordings(request, &mut report);
    let long_input = match request.plant {
        Some(plant) => with_plant::run(request, plant, &mut report)?,
        None => without_plant::run(request, &mut report)?,
    };
    if let Some(reference) = request.reference {
        fixed_point(request, reference, &long_input, &mut report)?;
    }
    report.passed = report.criteria.iter().all(|criterion| criterion.passed);
    Ok(report)
}

fn on_recordings(request: &Request<'_>, report: &mut SuiteReport) {
    let limit = if request.plant.is_some() { request.limits.recordings } else { request.limits.recordings_measured };
    match mean_nrmse(request.errors) {
        Some(value) => {
            let what = format!("mean NRMSE on the {} recording(s) given, free running", request.errors.len());
            report.criteria.push(Criterion::at_most("recordings", what, value, limit, "of range"));
        }
        None => report.not_judged.push("recordings: the measured output never moves".to_owned()),
    }
}

fn fixed_point(request: &Request<'_>, reference: &dyn Predictor, long_input: &[f64], report: &mut SuiteReport) -> Result<()> {
    let comparison = compare(reference, request.model, long_input)?;
    let range = output_range(request);
    let unit = &request.model.description().output.unit;
    let n = comparison.n;
    let limit = request.limits.fixed_point * range;
    let what = format!("RMSE between fixed point and f32 over {n} samples with holds");
    report.criteria.push(Criterion::at_most("fixed-point", what, comparison.rmse, limit, unit));
    let what = format!("growth of that difference from the first to the last three tenths of {n} samples");
    report.criteria.push(Criterion::at_most("fixed-point-growth", what, comparison.growth, 0.25 * limit, unit));
    report.fixed_point = Some(comparison);
    Ok(())
}
