//! Whether a run followed its reference at all. A figure of an error says little when nothing moved.

use crate::control::Sample;

/// An output slower than this on average did not move, bar/s: a thousandth of what the slowest reference of the suite asks for.
const STILL_BAR_PER_S: f64 = 1e-3;
/// A limiter that held the output back for so much of the time had the last word.
const HELD_SHARE: f64 = 0.5;

/// Why a run did not follow, in a sentence; nothing if it did. The reference counts from the second sample on, where it begins to move.
#[must_use]
pub fn missed(controller: &str, samples: &[Sample]) -> Option<String> {
    let n = samples.len() as f64;
    let mean = |value: &dyn Fn(&Sample) -> f64| samples.iter().map(value).sum::<f64>() / n.max(1.0);
    let middle_mm = mean(&|sample| sample.reference_mm);
    let moves_mm = mean(&|sample| (sample.reference_mm - middle_mm).powi(2)).sqrt();
    let rmse_mm = mean(&|sample| (sample.tip_mm - sample.reference_mm).powi(2)).sqrt();
    let (Some(first), Some(last)) = (samples.first(), samples.last()) else { return Some(format!("{controller}: not one sample arrived")) };
    let travel_bar: f64 = samples.windows(2).map(|pair| (pair[1].output_bar - pair[0].output_bar).abs()).sum();
    let limited = samples.iter().filter(|sample| sample.limited).count() as f64 / n;
    let moves = moves_mm > 1e-6;
    if moves && travel_bar < STILL_BAR_PER_S * (last.time_s - first.time_s) {
        return Some(format!(
            "{controller}: the reference moves and the output did not ({:.3} bar throughout). These settings have no effect on this rig: \
             check control.feed_forward, control.sensor and the model, or tune again",
            last.output_bar
        ));
    }
    // A tip that stood still in the middle of the reference would err by no more.
    if moves && rmse_mm >= moves_mm {
        let why = if limited > HELD_SHARE {
            format!("the limiter held the output back for {:.0} % of the time: the reference is out of the rig's reach", 100.0 * limited)
        } else {
            "the reference is out of the rig's reach, or the model is of another rig".to_owned()
        };
        return Some(format!(
            "{controller}: off by {rmse_mm:.2} mm (RMSE), while a tip standing still in the middle would be off by {moves_mm:.2} mm; {why}"
        ));
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(tip: impl Fn(f64) -> f64, output: impl Fn(f64) -> f64, limited: bool) -> Vec<Sample> {
        (0..500)
            .map(|index| {
                let time_s = f64::from(index) * 0.02;
                let reference_mm = 5.0 + time_s.sin();
                Sample { time_s, reference_mm, tip_mm: tip(reference_mm), output_bar: output(time_s), limited, ..Sample::default() }
            })
            .collect()
    }

    #[test]
    fn a_run_that_follows_is_not_missed_and_one_that_stands_still_is() {
        assert_eq!(missed("pid", &samples(|reference| reference + 0.1, f64::sin, false)), None);
        let still = missed("pid", &samples(|_| 5.0, |_| 0.0, false)).expect("the output stands still");
        assert!(still.contains("did not") && still.contains("pid"), "{still}");
        let off = missed("pid", &samples(|reference| reference - 3.0, f64::sin, true)).expect("3 mm are out of reach");
        assert!(off.contains("3.00 mm") && off.contains("limiter"), "{off}");
        // A reference that does not move needs no output that moves.
        let resting: Vec<Sample> = (0..100).map(|index| Sample { time_s: f64::from(index), ..Sample::default() }).collect();
        assert_eq!(missed("pid", &resting), None);
    }
}
