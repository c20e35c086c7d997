//! What the recordings before one left in the material.

use crate::data::session::{Earlier, Run};
use crate::effects::{creep, first_cycle_softening, smooth_hysteresis};

/// What the recordings before this one left in the material, and a `pressure` behind a valve, for a file.
pub(crate) fn earlier(run: &Run, pressure: Option<f64>) -> Earlier {
    Earlier {
        travelled: first_cycle_softening::travelled_before(run),
        highest: first_cycle_softening::highest_before(run),
        creeping: creep::TIMES_S.map(|time_s| creep::left_of_earlier(run, time_s)).to_vec(),
        turns: smooth_hysteresis::turns_before(run),
        pressure,
    }
}
