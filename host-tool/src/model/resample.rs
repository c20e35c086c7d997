//! A recording of another sample period: the input is interpolated to the model's clock, the prediction back to the recording's.

use super::{ModelError, Predictor};
use crate::recording::Recording;

/// The model's output at the recording's times. Each stretch between `gaps` is resampled on its own; a stretch before a gap that is
/// not in `gaps` is bridged by a straight line.
pub(super) fn predict(model: &dyn Predictor, recording: &Recording, gaps: &[usize], period_s: f64) -> Result<Vec<f64>, ModelError> {
    let mut output = Vec::with_capacity(recording.len());
    let bounds: Vec<usize> = std::iter::once(0).chain(gaps.iter().copied()).chain(std::iter::once(recording.len())).collect();
    for bound in bounds.windows(2).filter(|bound| bound[0] < bound[1]) {
        let times = &recording.time_s[bound[0]..bound[1]];
        let (first_s, last_s) = (times[0], times[times.len() - 1]);
        let steps = ((last_s - first_s) / period_s).ceil();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count of samples, not negative")]
        let clock: Vec<f64> = (0..=steps as usize).map(|index| first_s + index as f64 * period_s).collect();
        let input = interpolate(times, &recording.input[bound[0]..bound[1]], &clock);
        let predicted = model.predict(&input, &[])?;
        output.extend(interpolate(&clock, &predicted, times));
    }
    Ok(output)
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
