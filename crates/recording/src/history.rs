//! The past of an input as a point: two samples with the same past stand at the same place.
//!
//! Coordinates: the input, its lead over play operators of four thresholds (what a hysteresis remembers), and its lead over lags of four time
//! constants around the duration of a stroke (what dynamics and creep remember). All are in standard deviations of the input, so that what
//! hardly differs counts little.

use super::{Recording, clock};

/// Thresholds of the play operators in standard deviations of the input.
const THRESHOLDS: [f64; 4] = [0.03, 0.1, 0.35, 0.9];
/// Time constants of the lags in strokes.
const LAGS: [f64; 4] = [0.1, 0.4, 1.5, 6.0];

/// The time in s in which the input goes from one side of its mean to the other: twice the first zero of its autocorrelation. None for an
/// input that does not move or does not come back.
pub(super) fn stroke_s(recording: &Recording, values: &[f64]) -> Option<f64> {
    let mut longest: Option<f64> = None;
    for segment in recording.segments().into_iter().filter(|segment| segment.len() > 8) {
        let part = &values[segment];
        // A coarse copy tells the same time.
        let stride = (part.len() / 2000).max(1);
        let coarse: Vec<f64> = part.iter().step_by(stride).copied().collect();
        let mean = coarse.iter().sum::<f64>() / coarse.len() as f64;
        let product = |lag: usize| -> f64 {
            let pairs = coarse.iter().zip(&coarse[lag..]);
            pairs.map(|(one, other)| (one - mean) * (other - mean)).sum::<f64>() / (coarse.len() - lag) as f64
        };
        if product(0) > 0.0
            && let Some(zero) = (1..coarse.len() / 2).find(|&lag| product(lag) <= 0.0)
        {
            let stroke_s = 2.0 * (zero * stride) as f64 * recording.sample_period_s;
            longest = Some(longest.map_or(stroke_s, |known_s: f64| known_s.max(stroke_s)));
        }
    }
    longest
}

/// The points of all samples of a recording, `scales` being the standard deviations of the inputs.
pub(super) fn points(recording: &Recording, scales: &[f64], stroke_s: f64) -> Vec<Vec<f64>> {
    let mut points = vec![Vec::new(); recording.len()];
    for (values, &scale) in recording.inputs().into_iter().zip(scales) {
        for segment in recording.segments() {
            let start = values[segment.start] / scale;
            let (mut plays, mut lags) = ([start; THRESHOLDS.len()], [start; LAGS.len()]);
            let mut before_s = recording.time_s[segment.start];
            for index in segment {
                let value = values[index] / scale;
                let step_s = recording.time_s[index] - before_s;
                before_s = recording.time_s[index];
                points[index].push(value);
                for (play, threshold) in plays.iter_mut().zip(THRESHOLDS) {
                    *play = play.clamp(value - threshold, value + threshold);
                    points[index].push(value - *play);
                }
                for (lag, strokes) in lags.iter_mut().zip(LAGS) {
                    *lag += (value - *lag) * (1.0 - (-step_s / (strokes * stroke_s)).exp());
                    points[index].push(value - *lag);
                }
            }
        }
    }
    points
}

/// The standard deviation of each input over all recordings; 1 for an input that stands still.
pub(super) fn scales(recordings: &[Recording]) -> Vec<f64> {
    let inputs = recordings.iter().map(|recording| recording.inputs().len()).min().unwrap_or(0);
    let scale = |input: usize| {
        let values: Vec<f64> = recordings.iter().flat_map(|recording| recording.inputs()[input].iter().copied()).collect();
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        let spread = (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len().max(1) as f64).sqrt();
        if spread > 1e-9 * clock::range(&values).max(mean.abs()) { spread } else { 1.0 }
    };
    (0..inputs).map(scale).collect()
}
