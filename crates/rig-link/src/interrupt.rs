//! Ctrl-C, and the other signals that ask a process to end: whoever holds a rig vents it first.

use std::sync::Once;
use std::sync::atomic::{AtomicU32, Ordering};

static ASKED: AtomicU32 = AtomicU32::new(0);
static ONCE: Once = Once::new();

/// Exit code of a process that a second Ctrl-C ends at once; the device then vents by itself.
const ENDED_AT_ONCE: i32 = 130;

/// From now on the first Ctrl-C, hang-up or termination is told by [`is_requested`] instead of ending the process; the second one ends it.
pub fn watch() {
    ONCE.call_once(|| {
        // Without a handler Ctrl-C ends the process as ever, and the device vents after `limits.host_timeout_ms`.
        let _ = ctrlc::set_handler(|| {
            if ASKED.fetch_add(1, Ordering::Relaxed) > 0 {
                std::process::exit(ENDED_AT_ONCE);
            }
        });
    });
}

/// Whether somebody asked this process to end since [`watch`].
#[must_use]
pub fn is_requested() -> bool {
    ASKED.load(Ordering::Relaxed) > 0
}
