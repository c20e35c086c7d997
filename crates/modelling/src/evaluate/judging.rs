//! A model run freely over recordings, and how far off it is.

use anyhow::{Result, bail};

use super::metrics::{Errors, FileErrors};
use crate::model::{self, Predictor};
use crate::parallel::for_each;
use recording::Recording;
use recording::simulation::{first_behind, set_zero};

/// How recordings are judged.
#[derive(Clone, Copy, Debug, Default)]
pub struct Judging {
    /// How a model meets a recording.
    pub fit: model::Fit,
    /// Seconds at the start of each recording that the model sees and that do not count.
    pub skip_s: f64,
    /// Whether a constant is added to the prediction so that it meets the first sample that counts: for sensors without a fixed zero.
    pub tare: bool,
    /// Seconds at the start of each recording over which the prediction's mean is set to the measurement's, as a start-up calibration
    /// would; they do not count.
    pub calibrate_s: f64,
}

/// A recording, what a model made of it, and how far that is off.
#[derive(Clone, Debug)]
pub struct Judged {
    /// Errors.
    pub errors: FileErrors,
    /// First sample that counts.
    pub first: usize,
    /// The prediction, one value a sample of the recording.
    pub predicted: Vec<f64>,
}

/// Runs a model freely over recordings, on several threads; the results do not depend on their number.
///
/// # Errors
/// When a recording does not go with the model, is shorter than what is skipped, or the prediction is not finite.
pub fn judge(model: &dyn Predictor, recordings: &[Recording], judging: Judging, threads: usize) -> Result<Vec<Judged>> {
    for recording in recordings {
        model::check(model.description(), recording, judging.fit.resample)?;
    }
    for_each(recordings, threads, |recording| judge_one(model, recording, judging))
}

fn judge_one(model: &dyn Predictor, recording: &Recording, judging: Judging) -> Result<Judged> {
    let mut predicted = model::predict(model, recording, model::Fit { start_up_s: judging.calibrate_s, ..judging.fit })?;
    let first = first_behind(recording, judging.skip_s.max(judging.calibrate_s));
    if first >= recording.len() {
        let length_s = recording.time_s[recording.len() - 1] - recording.time_s[0];
        bail!(
            "{}: lasts {length_s:.2} s, nothing is left after skipping {} s; give a smaller --skip-s or --calibrate-s",
            recording.path.display(),
            judging.skip_s.max(judging.calibrate_s)
        );
    }
    if judging.calibrate_s > 0.0 {
        set_zero(&mut predicted, recording, judging.calibrate_s);
    }
    if judging.tare {
        let shift = recording.output[first] - predicted[first];
        predicted.iter_mut().for_each(|value| *value += shift);
    }
    let errors = Errors::between(&predicted[first..], &recording.output[first..]);
    let errors = FileErrors { path: recording.path.clone(), family: recording.family.clone(), errors };
    Ok(Judged { errors, first, predicted })
}
