//! What holds for every command alike: how much it says, and whether it may replace results.

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};

/// How much a command says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Loudness {
    /// Errors, warnings and failed checks.
    Quiet = 0,
    /// Results and progress, too.
    Normal = 1,
    /// What is read and written, and when, too.
    Verbose = 2,
}

static LOUDNESS: AtomicU8 = AtomicU8::new(Loudness::Normal as u8);
static MAY_REPLACE: AtomicBool = AtomicBool::new(false);

/// Sets how much the command says.
pub fn set_loudness(loudness: Loudness) {
    LOUDNESS.store(loudness as u8, Ordering::Relaxed);
}

/// How much the command says.
#[must_use]
pub fn loudness() -> Loudness {
    match LOUDNESS.load(Ordering::Relaxed) {
        0 => Loudness::Quiet,
        1 => Loudness::Normal,
        _ => Loudness::Verbose,
    }
}

/// Lets results replace earlier ones, as `--force` asks for.
pub fn allow_replacing() {
    MAY_REPLACE.store(true, Ordering::Relaxed);
}

/// Whether results may replace earlier ones.
#[must_use]
pub fn may_replace() -> bool {
    MAY_REPLACE.load(Ordering::Relaxed)
}

/// As [`refuse_replacing`], with the path in the message.
///
/// # Errors
/// As there.
pub fn refuse_any(path: &Path) -> anyhow::Result<()> {
    refuse_replacing(path).map_err(|problem| anyhow::anyhow!("{}: {problem}", path.display()))
}

/// Refuses a file that holds something already, unless results may be replaced.
///
/// # Errors
/// What to do; the message does not repeat the path.
pub fn refuse_replacing(path: &Path) -> Result<(), String> {
    let holds_something = std::fs::metadata(path).is_ok_and(|metadata| metadata.is_file() && metadata.len() > 0);
    if may_replace() || crate::place::is_stream(path) || !holds_something {
        return Ok(());
    }
    Err("exists already; choose another name, or say --force to replace it".to_owned())
}
