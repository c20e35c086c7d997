//! What the recordings before one left in the material.

use crate::data::session::{Earlier, Run};
use crate::effects::{creep, first_cycle_softening, smooth_hysteresis};

/// What the recordings before this one left in the material, for a file.
pub(crate) fn earlier(run: &Run) -> Earlier {
    Earlier {
        travelled: first_cycle_softening::travelled_before(run),
        highest: first_cycle_softening::highest_before(run),
        creeping: [false, true].map(|held| creep::TIMES_S.map(|time_s| creep::left_of_earlier(run, time_s, held))).concat(),
        turns: smooth_hysteresis::turns_before(run),
    }
}
