//! `clock-skew`: input and output are stamped by clocks of different speed, the delay grows through each recording.

use crate::chain::filters::{grid, ladder, shift};
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec, Told};
use crate::data::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&RECORDING, &RUNNING_ON];

struct Skew {
    form: Told,
    /// Whether it runs on through the session, instead of beginning with each recording.
    runs_on: bool,
}

static RECORDING: Skew = Skew { form: ("of-each-recording", "from the start of each recording"), runs_on: false };

static RUNNING_ON: Skew = Skew { form: ("of-the-session", "running on through the session"), runs_on: true };

impl Form for Skew {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[Parameter { name: "skew", quantity: Quantity::Ratio, low: -0.03, high: 0.03, logarithmic: false }],
            steps: if self.runs_on { &[0.005] } else { &[0.15] },
            keeps_turning_points: true,
            ..Spec::new("clock-skew", self.form, Place::Tube)
        }
    }
    fn starts(&self, session: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        if !self.runs_on {
            return grid(&[&[-0.012, -0.005, -0.002, 0.002, 0.005, 0.012]]);
        }
        // Half a second at the end of the session is the most that still looks like the same stroke.
        ladder(0.02, 0.5, 5).into_iter().flat_map(|end_s| [vec![end_s / session.length_s], vec![-end_s / session.length_s]]).collect()
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let before = path.to_vec();
        let time_s = if self.runs_on { &run.session_s } else { &run.time_s };
        // A fast output clock (positive skew: its sample k was taken at k (1 + skew)) sees the input early.
        shift(path, &before, |sample| -parameters[0] * time_s[sample] / run.period_s);
    }
}
