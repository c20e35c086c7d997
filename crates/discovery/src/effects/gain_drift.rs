//! `gain-drift`: the gain drifts with the session's time, towards a limit or along a spline; or every recording has a gain of its own.

use std::collections::BTreeMap;

use crate::chain::columns::Columns;
use crate::chain::form::{Form, Place, Spec};
use crate::data::session::{Run, Session};
use crate::effects::session_curve::{Drifts, SessionCurve, TowardsALimit, is_most};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&LIMIT, &CURVE, &Own, &INSIDE];

struct Own;

static CURVE: SessionCurve = SessionCurve { name: "gain-drift", drifts: Drifts::Gain };

static LIMIT: TowardsALimit = TowardsALimit::between("gain-drift", Drifts::Gain);

static INSIDE: TowardsALimit = TowardsALimit::between("gain-drift", Drifts::Gain).inside();

/// Least deviation of what a model says, as a share of the span, that shows a gain.
const LEAST_MOTION: f64 = 0.02;

/// How far the gain of the samples that count lies above one, from what a model says (`sum`) and what was measured; and the sum of squares
/// that this explains.
fn own_gain(sum: &[f64], output: &[f64], keep: &[bool]) -> (f64, f64) {
    let kept = || sum.iter().zip(output).zip(keep).filter(|(_, keep)| **keep).map(|(pair, _)| pair);
    let count = kept().count().max(1) as f64;
    let (mean, missed) = (kept().map(|(sum, _)| sum).sum::<f64>() / count, kept().map(|(sum, output)| output - sum).sum::<f64>() / count);
    let square = kept().map(|(sum, _)| (sum - mean).powi(2)).sum::<f64>();
    let product = kept().map(|(sum, output)| (sum - mean) * (output - sum - missed)).sum::<f64>();
    // A start-up without motion tells no gain.
    if square > LEAST_MOTION * LEAST_MOTION * count { (product / square, product * product / square) } else { (0.0, 0.0) }
}

/// A gain that walks at random, or recordings whose times nobody wrote down: no curve of the session's time follows it.
impl Form for Own {
    fn spec(&self) -> Spec {
        Spec {
            weights: 2,
            // It reads one value from each recording, those that it is judged by included.
            cost: Some(11),
            reads_output: true,
            is_between_recordings: true,
            needs_sum: true,
            ..Spec::new("gain-drift", ("of-each-recording", "a gain of its own in each recording"), Place::Sensor)
        }
    }
    fn start_up_s(&self, _: &[f64]) -> f64 {
        // A gain shows where the output moves.
        5.0
    }
    fn starts(&self, session: &Session, residual: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let of_gain = |run: &Run, residual: &[f64]| {
            let sum: Vec<f64> = run.output.iter().zip(residual).map(|(output, residual)| output - residual).collect();
            own_gain(&sum, &run.output, &run.keep).1
        };
        if is_most(session, residual, of_gain) { vec![vec![]] } else { Vec::new() }
    }
    fn output(&self, _: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        // Where there is no measured output (a simulation) the gain stays where it is.
        let measured = run.output.iter().any(|value| *value != 0.0);
        let above_one = if measured { own_gain(sum, &run.output, &run.keep).0 } else { 0.0 };
        columns.push(false, |sample| above_one * sum[sample]);
        // The zero of what the gain multiplies need not be the sensor's.
        columns.push(false, |_| above_one);
    }
    fn tell(&self, _: &[f64], weights: &[f64], _: &Session) -> BTreeMap<String, f64> {
        BTreeMap::from([("share_of_the_gains".to_owned(), weights[0])])
    }
}

#[cfg(test)]
mod tests {
    use crate::effects::gain_drift::own_gain;

    #[test]
    fn a_recording_tells_its_gain_whatever_its_zero() {
        let sum: Vec<f64> = (0..100).map(|sample| f64::from(sample) * 0.01).collect();
        let output: Vec<f64> = sum.iter().map(|value| 1.07 * value + 0.2).collect();
        let mut keep = vec![true; 100];
        keep[7] = false;
        let (above_one, square) = own_gain(&sum, &output, &keep);
        assert!((above_one - 0.07).abs() < 1e-12, "{above_one}");
        assert!(square > 0.0);
    }
}
