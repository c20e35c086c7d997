//! A model on a recording: whether they go together, and what comes out.

use super::error::ModelError;
use super::predictor::{Description, Predictor};
use recording::Recording;
use recording::simulation::{Context, differs, is_even, on_even_clock};

/// What a model does behind a gap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Gaps {
    /// Starts afresh, from the equilibrium of the first sample behind the gap.
    #[default]
    Reset,
    /// Goes on as if nothing were missing.
    Carry,
}

/// How a model meets a recording.
#[derive(Clone, Copy, Debug, Default)]
pub struct Fit {
    /// Interpolate a recording of another sample period instead of refusing it.
    pub resample: bool,
    /// What happens at gaps.
    pub gaps: Gaps,
    /// Seconds at the start of each stretch in which a model may read the measured output, s; it then runs freely.
    pub start_up_s: f64,
}

/// Checks that a model was made for the quantities, units and sample period of a recording; with `resample` the period may differ.
///
/// # Errors
/// Naming both sides of the first difference.
pub fn check(model: &Description, recording: &Recording, resample: bool) -> Result<(), ModelError> {
    let sides = [("input", &model.input, &recording.input_signal), ("output", &model.output, &recording.output_signal)];
    for (side, wanted, found) in sides {
        if wanted != found {
            return Err(ModelError::Signal {
                recording: recording.path.clone(),
                model: model.path.clone(),
                side,
                wanted: wanted.clone(),
                found: found.clone(),
            });
        }
    }
    for (index, wanted) in model.more_inputs.iter().enumerate() {
        let found = recording.more_inputs.get(index).map(|channel| channel.signal.clone());
        if found.as_ref() != Some(wanted) {
            return Err(ModelError::Inputs {
                recording: recording.path.clone(),
                model: model.path.clone(),
                wanted: model.more_inputs.len() + 1,
                found: recording.more_inputs.len() + 1,
                missing: wanted.column(),
                role: format!("input{}", index + 2),
            });
        }
    }
    match model.sample_period_s {
        Some(period_s) if !resample && differs(period_s, recording.sample_period_s) => Err(ModelError::Period {
            recording: recording.path.clone(),
            model: model.path.clone(),
            model_s: period_s,
            recording_s: recording.sample_period_s,
        }),
        _ => Ok(()),
    }
}

/// The output of a model for every sample of a recording, free running; see [`Fit`].
///
/// # Errors
/// As [`check`] and [`Predictor::predict`].
pub fn predict(model: &dyn Predictor, recording: &Recording, fit: Fit) -> Result<Vec<f64>, ModelError> {
    check(model.description(), recording, fit.resample)?;
    let gaps = if fit.gaps == Gaps::Reset { &recording.gaps[..] } else { &[] };
    let predicted = match model.description().sample_period_s {
        Some(period_s) if differs(period_s, recording.sample_period_s) || !is_even(recording) => {
            recording::resample::check(recording, period_s)
                .map_err(|error| ModelError::Invalid { path: model.description().path.clone(), problem: error.to_string() })?;
            on_even_clock(recording, gaps, period_s, fit.start_up_s, |context, inputs, gaps| model.simulate_in(context, inputs, gaps))
        }
        _ => model.simulate_in(&Context::of(recording, fit.start_up_s), &recording.inputs(), gaps),
    }?;
    // Numbers that are finite one by one need not have a sum that is.
    match predicted.iter().position(|value| value.is_nan() || value.abs() > recording::LARGEST) {
        Some(sample) => {
            let problem = format!(
                "its output on {} is {} from {:.3} s on, which no sensor gives; make it again",
                recording.path.display(),
                predicted[sample],
                recording.time_s[sample]
            );
            Err(ModelError::Invalid { path: model.description().path.clone(), problem })
        }
        None => Ok(predicted),
    }
}
