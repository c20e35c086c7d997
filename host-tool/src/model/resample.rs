//! A recording of another sample period: the input is interpolated to the model's clock, the prediction back to the recording's.

use super::{Context, ModelError, Predictor};
use crate::recording::{Recording, resample};

/// Steps may be off by this share of a period: printed times are rounded.
const EVEN: f64 = 0.25;

/// Whether the steps between gaps are so even that samples may stand for times.
pub(super) fn is_even(recording: &Recording) -> bool {
    let period_s = recording.sample_period_s;
    recording.segments().iter().all(|segment| {
        let times = &recording.time_s[segment.clone()];
        times.iter().enumerate().all(|(index, time)| (time - times[0] - index as f64 * period_s).abs() <= EVEN * period_s)
    })
}

/// The model's output at the recording's times, by way of an even clock of the model's period. Each stretch between the recording's
/// gaps is put onto a clock of its own; memory starts anew at those in `gaps`.
pub(super) fn predict(
    model: &dyn Predictor,
    recording: &Recording,
    gaps: &[usize],
    period_s: f64,
    start_up_s: f64,
) -> Result<Vec<f64>, ModelError> {
    resample::check(recording, period_s)
        .map_err(|error| ModelError::Invalid { path: model.description().path.clone(), problem: error.to_string() })?;
    let even = resample::uniform(recording, period_s);
    let reset = if gaps.is_empty() { &[][..] } else { &even.gaps };
    let predicted = model.simulate_in(&Context::of(&even, start_up_s), &even.inputs(), reset)?;
    if even.len() == recording.len() && even.time_s == recording.time_s {
        return Ok(predicted);
    }
    let pairs = recording.segments().into_iter().zip(even.segments());
    Ok(pairs.flat_map(|(own, grid)| interpolate(&even.time_s[grid.clone()], &predicted[grid], &recording.time_s[own])).collect())
}

/// The values at `wanted` times by straight lines between samples; both times ascend, outside the ends the end value holds.
pub(crate) fn interpolate(times: &[f64], values: &[f64], wanted: &[f64]) -> Vec<f64> {
    let mut right = 0;
    wanted
        .iter()
        .map(|&time| {
            while right < times.len() && times[right] < time {
                right += 1;
            }
            if right == 0 {
                return values[0];
            }
            if right == times.len() {
                return values[values.len() - 1];
            }
            let share = (time - times[right - 1]) / (times[right] - times[right - 1]);
            values[right - 1] + share * (values[right] - values[right - 1])
        })
        .collect()
}
