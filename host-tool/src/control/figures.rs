//! Figures of a tracked reference.

use serde::Serialize;

/// Band around a level in which the tip counts as settled, as a share of the reference's range.
const SETTLED_SHARE: f64 = 0.03;
/// A reference that has not moved for so many samples stands at a level.
const LEVEL_SAMPLES: usize = 25;

/// One sample of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Time since the start of the run, s.
    pub time_s: f64,
    /// Where the tip shall be, mm.
    pub reference_mm: f64,
    /// Where it is, mm.
    pub tip_mm: f64,
    /// Pressure put out, bar.
    pub output_bar: f64,
    /// Pressure measured, mean over the window that ended last, bar; while it is plausible.
    pub pressure_bar: Option<f64>,
    /// Where the model has the tip, mean over the window that ended last, mm; where there is one.
    pub estimate_mm: Option<f64>,
    /// Whether the limiter held the output back.
    pub limited: bool,
    /// Estimate less true tip, means over the same window, mm; where both are known.
    pub estimate_error_mm: Option<f64>,
}

/// How well a controller did; the first six keys are a contract.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Figures {
    /// The controller.
    pub name: String,
    /// Root mean square of the tracking error, mm.
    pub rmse_mm: f64,
    /// Largest tracking error, mm.
    pub max_mm: f64,
    /// Mean time from a level's beginning until the tip stays within 3 % of the range around it, s; absent without levels.
    pub settling_s: Option<f64>,
    /// Largest swing beyond a level, mm.
    pub overshoot_mm: f64,
    /// Share of the time in which the limiter held the output back.
    pub limited_share: f64,
    /// Mean speed of the output, bar/s: the effort.
    pub effort_bar_per_s: f64,
    /// Root mean square error of the estimate, mm; absent without one.
    pub estimate_rmse_mm: Option<f64>,
}

/// Figures of a run.
#[must_use]
pub fn of(name: &str, samples: &[Sample]) -> Figures {
    let n = samples.len().max(1) as f64;
    let error = |sample: &Sample| sample.tip_mm - sample.reference_mm;
    let (low, high) = samples.iter().fold((f64::MAX, f64::MIN), |(l, h), s| (l.min(s.reference_mm), h.max(s.reference_mm)));
    let band_mm = SETTLED_SHARE * (high - low);
    let (settling_s, overshoot_mm) = levels(samples, band_mm);
    let travel: f64 = samples.windows(2).map(|pair| (pair[1].output_bar - pair[0].output_bar).abs()).sum();
    let duration_s = match samples {
        [first, .., last] => last.time_s - first.time_s,
        _ => 1.0,
    };
    let estimates: Vec<f64> = samples.iter().filter_map(|sample| sample.estimate_error_mm).collect();
    let estimate_rmse = (estimates.iter().map(|e| e * e).sum::<f64>() / estimates.len().max(1) as f64).sqrt();
    Figures {
        name: name.to_owned(),
        rmse_mm: (samples.iter().map(|sample| error(sample).powi(2)).sum::<f64>() / n).sqrt(),
        max_mm: samples.iter().map(|sample| error(sample).abs()).fold(0.0, f64::max),
        settling_s,
        overshoot_mm,
        limited_share: samples.iter().filter(|sample| sample.limited).count() as f64 / n,
        effort_bar_per_s: travel / duration_s,
        estimate_rmse_mm: (!estimates.is_empty()).then_some(estimate_rmse),
    }
}

/// Mean settling time over the levels of the reference and the largest overshoot at them.
fn levels(samples: &[Sample], band_mm: f64) -> (Option<f64>, f64) {
    let (mut times, mut overshoot_mm) = (Vec::new(), 0.0_f64);
    let mut start = 0;
    for end in 1..=samples.len() {
        if end < samples.len() && samples[end].reference_mm == samples[start].reference_mm {
            continue;
        }
        // The first level is where the reference rests before it begins.
        if start > 0 && end - start >= LEVEL_SAMPLES {
            let level = &samples[start..end];
            let error = |sample: &Sample| sample.tip_mm - sample.reference_mm;
            let settled = level.iter().rposition(|sample| error(sample).abs() > band_mm).map_or(0, |last| last + 1);
            times.push(level.get(settled).map_or(level[level.len() - 1].time_s, |sample| sample.time_s) - level[0].time_s);
            let rising = samples[start].reference_mm > samples[start - 1].reference_mm;
            let beyond = level.iter().map(|sample| if rising { error(sample) } else { -error(sample) }).fold(0.0, f64::max);
            overshoot_mm = overshoot_mm.max(beyond);
        }
        start = end;
    }
    let mean = times.iter().sum::<f64>() / times.len().max(1) as f64;
    ((!times.is_empty()).then_some(mean), overshoot_mm)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(tip_mm: impl Fn(f64) -> f64) -> Vec<Sample> {
        (0..200)
            .map(|index| {
                let time_s = f64::from(index) * 0.02;
                let reference_mm = if time_s < 1.0 { 0.0 } else { 10.0 };
                Sample { time_s, reference_mm, tip_mm: tip_mm(time_s), ..Sample::default() }
            })
            .collect()
    }

    #[test]
    fn a_first_order_answer_settles_when_it_enters_the_band_for_good() {
        // 3 % of 10 mm: exp(-t / 0.2) = 0.03 at t = 0.701 s, so the first sample inside is that at 0.72 s.
        let figures = of("x", &run(|t| if t < 1.0 { 0.0 } else { 10.0 * (1.0 - (-(t - 1.0) / 0.2).exp()) }));
        assert!((figures.settling_s.unwrap() - 0.72).abs() < 1e-9, "{figures:?}");
        assert_eq!(figures.overshoot_mm, 0.0);
        assert!((figures.max_mm - 10.0).abs() < 1e-9);
    }

    #[test]
    fn what_goes_beyond_a_level_is_overshoot() {
        let figures = of("x", &run(|t| if t < 1.0 { 0.0 } else { 10.0 + 2.0 * (-(t - 1.0) / 0.2).exp() }));
        assert!((figures.overshoot_mm - 2.0).abs() < 1e-9);
    }
}
