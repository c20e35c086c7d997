//! `clock-skew`: input and output are stamped by clocks of different speed, the delay grows through each recording.

use crate::chain::filters::{ladder, shift};
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec};
use crate::data::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Recording, &RunningOn];

struct Recording;

struct RunningOn;

const SKEW: &[Parameter] = &[Parameter { name: "skew", quantity: Quantity::Ratio, low: -0.03, high: 0.03, logarithmic: false }];

impl Form for Recording {
    fn spec(&self) -> Spec {
        Spec {
            parameters: SKEW,
            keeps_turning_points: true,
            starts: &[&[-0.012], &[-0.005], &[-0.002], &[0.002], &[0.005], &[0.012]],
            ..Spec::new("clock-skew", ("of-each-recording", "from the start of each recording"), Place::Tube)
        }
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let before = path.to_vec();
        // A fast output clock (positive skew: its sample k was taken at k (1 + skew)) sees the input early.
        shift(path, &before, |sample| -parameters[0] * run.time_s[sample] / run.period_s);
    }
}

impl Form for RunningOn {
    fn spec(&self) -> Spec {
        Spec {
            parameters: SKEW,
            steps: &[0.005],
            keeps_turning_points: true,
            ..Spec::new("clock-skew", ("of-the-session", "running on through the session"), Place::Tube)
        }
    }
    fn starts(&self, session: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        // Half a second at the end of the session is the most that still looks like the same stroke.
        ladder(0.02, 0.5, 5).into_iter().flat_map(|end_s| [vec![end_s / session.length_s], vec![-end_s / session.length_s]]).collect()
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let before = path.to_vec();
        shift(path, &before, |sample| -parameters[0] * run.session_s[sample] / run.period_s);
    }
}
