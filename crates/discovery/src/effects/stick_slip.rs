//! `stick-slip`: the tip holds until the pull exceeds a band, then jumps, and holds again or slides on while the pull is fast.

use crate::chain::form::{Drive, Form};
use crate::effects::seated::Seated;

/// All forms.
pub const FORMS: &[&dyn Form] = &[&SEEN, &BEHIND];

static SEEN: Seated =
    Seated { name: "stick-slip", form: "holds and breaks away, its seat seen in the output", drive: Drive::Pull, feels: false };
static BEHIND: Seated =
    Seated { form: "holds and breaks away behind what beats against it, its seat seen in the output", feels: true, ..SEEN };
