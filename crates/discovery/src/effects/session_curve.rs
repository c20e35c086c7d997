//! A smooth curve of the session's time, or one towards a limit: the forms that a drifting zero and a drifting gain share.

use std::collections::BTreeMap;

use crate::chain::columns::Columns;
use crate::chain::filters::grid;
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec, Told};
use crate::data::noise;
use crate::data::session::{Run, Session};

/// What drifts along the curve.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Drifts {
    /// The zero.
    Offset,
    /// The gain.
    Gain,
}

/// A drift along a natural spline.
pub struct SessionCurve {
    /// The effect.
    pub name: &'static str,
    /// What drifts.
    pub drifts: Drifts,
}

/// A drift towards a limit.
pub struct TowardsALimit {
    /// The effect.
    pub name: &'static str,
    /// The form's description.
    pub form: Told,
    /// What drifts.
    pub drifts: Drifts,
    /// Whether it is the drift inside the only recording of a session.
    pub inside: bool,
}

impl TowardsALimit {
    /// The drift between recordings.
    pub const fn between(name: &'static str, drifts: Drifts) -> Self {
        Self { name, form: ("towards-a-limit", "towards a limit"), drifts, inside: false }
    }

    /// The same inside the only recording, which needs no other one to be seen.
    pub const fn inside(self) -> Self {
        Self { form: ("inside-a-recording", "towards a limit, inside the only recording"), inside: true, ..self }
    }
}

/// Least share of what a model leaves above the noise that must be in values that recordings have of their own.
const LEAST_OF_OWN: f64 = 0.6;

/// Whether what a value of its own explains in each recording is most of what the model leaves: whatever a model lacks leaves a little of that, beside much
/// else.
pub fn is_most(session: &Session, residual: &[Vec<f64>], explained: impl Fn(&Run, &[f64]) -> f64) -> bool {
    let (mut of_own, mut whole, mut count) = (0.0, 0.0, 1e-30);
    for run in session.worked() {
        let residual = &residual[run.index];
        of_own += explained(run, residual);
        whole += residual.iter().zip(&run.keep).filter(|(_, keep)| **keep).map(|(value, _)| value * value).sum::<f64>();
        count += run.keep.iter().filter(|keep| **keep).count() as f64;
    }
    of_own > LEAST_OF_OWN * (whole - count * noise::floor(session, residual).powi(2))
}

impl Drifts {
    /// What the curve is multiplied by.
    fn of(self, sum: &[f64], sample: usize) -> f64 {
        if self == Self::Gain { sum[sample] } else { 1.0 }
    }

    /// How far it drifted in the session.
    fn tell(self, reached: f64, session: &Session) -> BTreeMap<String, f64> {
        BTreeMap::from([match self {
            Self::Offset => (format!("drift_in_the_session_{}", session.output_unit), reached * session.output_scale),
            Self::Gain => ("drift_in_the_session".to_owned(), reached),
        }])
    }
}

impl Form for TowardsALimit {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[Parameter { name: "time_constant", quantity: Quantity::Time, low: 10.0, high: 1e5, logarithmic: true }],
            // A drift that goes on and on.
            simpler_at: &[(0, 1e5)],
            weights: 1,
            is_between_recordings: !self.inside,
            needs_sum: self.drifts == Drifts::Gain,
            ..Spec::new(self.name, self.form, Place::Sensor)
        }
    }
    fn starts(&self, session: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let is_only_one = session.worked().all(|run| run.source.0 == 0);
        if self.inside == is_only_one { grid(&[&[0.1, 0.3, 1.0, 5.0].map(|share| share * session.length_s)]) } else { Vec::new() }
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        columns.push(true, |sample| -self.drifts.of(sum, sample) * (-run.session_s[sample] / parameters[0]).exp_m1());
    }
    fn tell(&self, parameters: &[f64], weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        // The limit of a drift that has hardly begun to bend is anybody's guess; what it did in the session is not.
        self.drifts.tell(-(-session.length_s / parameters[0]).exp_m1() * weights[0], session)
    }
}

impl Form for SessionCurve {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[UNTIL],
            weights: KNOTS - 1,
            // When the session ended is known.
            cost: Some(KNOTS - 1),
            discrete: true,
            is_between_recordings: true,
            needs_sum: self.drifts == Drifts::Gain,
            ..Spec::new(self.name, ("smooth-curve", "a smooth curve of the session's time"), Place::Sensor)
        }
    }
    fn starts(&self, session: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        // When the last recording ended that is not kept out.
        vec![vec![session.worked().filter_map(|run| run.session_s.last().copied()).fold(1.0, f64::max)]]
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        for part in 0..KNOTS - 1 {
            columns.push(true, |sample| self.drifts.of(sum, sample) * spline(run.session_s[sample] / parameters[0])[part]);
        }
    }
    fn tell(&self, _: &[f64], weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        let reached = spline(1.0).iter().zip(weights).map(|(value, weight)| value * weight).sum::<f64>();
        self.drifts.tell(reached, session)
    }
}

/// The time of the session that is one for [`spline`].
const UNTIL: Parameter = Parameter { name: "until", quantity: Quantity::Time, low: 1.0, high: 1e7, logarithmic: true };

/// Knots of [`spline`], at equal distances.
const KNOTS: usize = 5;

/// A natural cubic spline of a time whose first knot is 0 and last 1, without its constant: the time and the curved parts.
///
/// Beyond the last knot it goes on straight for the distance of two knots and then stays: a polynomial that fits a session runs away
/// behind it. Source: Hastie, Tibshirani and Friedman, The Elements of Statistical Learning (2009), equations 5.4 and 5.5.
fn spline(time: f64) -> [f64; KNOTS - 1] {
    let spacing = 1.0 / (KNOTS - 1) as f64;
    let time = time.min(1.0 + spacing);
    let beyond = |knot: f64| (time - knot).max(0.0).powi(3);
    let part = |index: usize| {
        let knot = index as f64 * spacing;
        (beyond(knot) - beyond(1.0)) / (1.0 - knot)
    };
    std::array::from_fn(|index| if index == 0 { time } else { part(index - 1) - part(KNOTS - 2) })
}

#[cfg(test)]
mod tests {
    use crate::effects::session_curve::spline;

    #[test]
    fn the_spline_goes_on_straight_behind_its_last_knot_and_then_stays() {
        let weights = [0.3, -2.0, 1.1, 0.7];
        let at = |time: f64| -> f64 { spline(time).iter().zip(weights).map(|(value, weight)| value * weight).sum() };
        assert_eq!(at(0.0), 0.0);
        // Curved inside, without a kink at the last knot, straight behind it.
        assert!((at(0.6) - 0.5 * (at(0.4) + at(0.8))).abs() > 1e-2, "the spline bends nowhere");
        let slope = (at(1.2) - at(1.0)) / 0.2;
        assert!(((at(1.0) - at(0.9999)) / 1e-4 - slope).abs() < 1e-3, "a kink at the last knot");
        assert!((at(1.1) - at(1.0) - 0.1 * slope).abs() < 1e-12 && slope.abs() > 0.1);
        assert_eq!(at(1.25), at(7.0));
    }
}
