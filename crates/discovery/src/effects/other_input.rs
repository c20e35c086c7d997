//! Further inputs, which bend the same segment: play operators of their own beside those of the first input. They are no effect but a part of the
//! baseline. Effects are looked for behind the first input.

use crate::chain::columns::Columns;
use crate::chain::form::{Form, Place, Spec};
use crate::data::session::{MOST_OTHERS, Run};

/// What files call it.
pub const NAME: &str = "other-input";

/// One form for each further input that a recording can have.
pub const FORMS: [&dyn Form; MOST_OTHERS] = [&Other(0, "second"), &Other(1, "third"), &Other(2, "fourth")];

/// Which one it is, and its key.
struct Other(usize, &'static str);

/// Thresholds of the operators, over the span of that input; its weights may be negative.
const THRESHOLDS: [f64; 7] = [0.0, 0.02, 0.05, 0.1, 0.18, 0.3, 0.45];

impl Form for Other {
    fn spec(&self) -> Spec {
        Spec {
            weights: THRESHOLDS.len(),
            cost: Some(0),
            ..Spec::new(NAME, (self.1, "play operators of a further input"), Place::Operators)
        }
    }
    fn output(&self, _: &[f64], run: &Run, _: &[f64], columns: &mut Columns) {
        let input = run.others.get(self.0).map_or(&[][..], Vec::as_slice);
        for threshold in THRESHOLDS {
            let mut state = input.first().copied().unwrap_or(0.0);
            columns.push(true, |sample| {
                let value = input.get(sample).copied().unwrap_or(0.0);
                state = state.max(value - threshold).min(value + threshold);
                state
            });
        }
    }
}
