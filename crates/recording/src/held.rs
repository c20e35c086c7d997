//! Sample-and-hold inputs: a staircase whose value stands still between refreshes.

use super::clock;

/// A channel that holds its value between changes.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Hold {
    /// Time between refreshes in s, where it is always the same or a multiple of it.
    pub period_s: Option<f64>,
    /// Number of changes.
    pub changes: usize,
}

/// Fewest changes that make a staircase.
const FEWEST_CHANGES: usize = 6;
/// At most this share of the steps changes the value of a staircase.
const MOST_CHANGING: f64 = 0.5;
/// A single step size below this share of the range is the resolution of a slow signal, not a staircase.
const COARSE: f64 = 0.03;

/// Whether a channel is a staircase. A slow signal of coarse resolution also stands still often, but all its changes are one step of the
/// resolution.
#[must_use]
pub fn hold(time_s: &[f64], values: &[f64]) -> Option<Hold> {
    hold_with(values.windows(2).filter(|pair| pair[0] != pair[1]).count(), time_s, values)
}

/// The same where the number of changes is known: most signals change with nearly every sample.
pub(super) fn hold_with(changes: usize, time_s: &[f64], values: &[f64]) -> Option<Hold> {
    if changes < FEWEST_CHANGES || changes as f64 > MOST_CHANGING * values.len() as f64 {
        return None;
    }
    let changed: Vec<usize> = (1..values.len()).filter(|&index| values[index] != values[index - 1]).collect();
    let sizes: Vec<f64> = changed.iter().map(|&index| (values[index] - values[index - 1]).abs()).collect();
    let smallest = clock::quantile(sizes.clone(), 0.1);
    let alike = sizes.iter().filter(|&&size| size < 1.5 * smallest).count();
    if alike as f64 > 0.7 * changes as f64 && smallest < COARSE * clock::range(values) {
        return None;
    }
    // A logger that repeats the newest value of a faster signal holds it for one or two samples; a staircase holds longer than it moves.
    let held = changed.windows(2).filter(|pair| pair[1] - pair[0] > 1).count();
    if (held as f64) < 0.8 * (changes - 1) as f64 {
        return None;
    }
    Some(Hold { period_s: refresh_s(time_s, &changed), changes })
}

/// The period of which nine of ten times between changes are multiples.
fn refresh_s(time_s: &[f64], changed: &[usize]) -> Option<f64> {
    let holds_s: Vec<f64> = changed.windows(2).map(|pair| time_s[pair[1]] - time_s[pair[0]]).collect();
    let sample_s = clock::quantile(clock::steps(time_s), 0.5);
    let shortest_s = clock::quantile(holds_s.clone(), 0.1);
    // A change shows up to one sample late, at either end.
    let slack_s = 1.2 * sample_s;
    let multiple = |hold_s: f64, period_s: f64| (hold_s / period_s).round();
    let fits = |hold_s: f64, period_s: f64| {
        let times = multiple(hold_s, period_s);
        times >= 1.0 && (hold_s - times * period_s).abs() <= slack_s.min(0.3 * period_s)
    };
    // The mean of the shortest holds undoes the rounding to whole samples.
    let short: Vec<f64> = holds_s.iter().copied().filter(|&hold_s| (hold_s - shortest_s).abs() <= slack_s).collect();
    let first_s = short.iter().sum::<f64>() / short.len().max(1) as f64;
    let fitting: Vec<f64> = holds_s.iter().copied().filter(|&hold_s| fits(hold_s, first_s)).collect();
    if first_s < 1.8 * sample_s || (fitting.len() as f64) < 0.9 * holds_s.len() as f64 || (short.len() as f64) < 0.2 * holds_s.len() as f64
    {
        return None;
    }
    let times: f64 = fitting.iter().map(|&hold_s| multiple(hold_s, first_s)).sum();
    Some(fitting.iter().sum::<f64>() / times)
}
