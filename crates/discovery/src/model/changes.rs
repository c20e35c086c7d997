//! Recordings made about when the set-up changed: nobody knows on which side.

use crate::data::session::Session;
use crate::model::structure::Model;

/// Whether each recording lies in the gap of a change of set-up: behind the last recording before it that was worked with, and ahead of the
/// first one after it. On which side of the change it was made nobody knows, so it can neither confirm nor contradict the change.
pub(crate) fn in_a_gap(session: &Session, model: &Model) -> Vec<bool> {
    let mut in_a_gap = vec![false; session.runs.len()];
    for place in model.slots.iter().flat_map(|slot| slot.form.changes_at(&slot.parameters)) {
        let first = session.runs.iter().take_while(|run| (run.index as f64) < *place).count();
        let before = session.runs[..first].iter().rev().take_while(|run| !run.is_worked_with()).count();
        let after = session.runs[first..].iter().take_while(|run| !run.is_worked_with()).count();
        in_a_gap[first - before..first + after].fill(true);
    }
    in_a_gap
}
