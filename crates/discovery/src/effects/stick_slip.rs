//! `stick-slip`: the tip holds until the quasi-static response exceeds a band, then jumps, and holds again or slides on while the quasi-static response is fast.

use crate::chain::form::{Drive, Form};
use crate::effects::sticking::Sticking;

/// All forms.
pub const FORMS: &[&dyn Form] = &[&SEEN, &BEHIND];

static SEEN: Sticking = Sticking {
    name: "stick-slip",
    form: ("seen", "holds and breaks away, its seat seen in the output"),
    drive: Drive::QuasiStatic,
    feels: false,
};
static BEHIND: Sticking = Sticking {
    form: ("seen-behind-beats", "holds and breaks away behind what beats against it, its seat seen in the output"),
    feels: true,
    ..SEEN
};
