//! What of a recording is worked with.

use crate::data::session::Run;

/// Values of the samples that are fitted to or chosen by.
pub fn worked_with(run: &Run, values: &[f64]) -> Vec<f64> {
    values.iter().zip(&run.role).filter(|(_, role)| role.is_worked_with()).map(|(value, _)| *value).collect()
}
