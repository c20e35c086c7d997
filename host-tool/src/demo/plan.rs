//! How the demonstration runs, and on which rigs.

use std::path::PathBuf;

use crate::plant::dataset::SetKind;

/// How the demonstration runs.
#[derive(Clone, Debug)]
pub struct DemoConfig {
    /// Folder of everything it leaves.
    pub folder: PathBuf,
    /// Seed of every random choice.
    pub seed: u64,
    /// Threads; equal counts give equal results.
    pub threads: usize,
    /// A fraction of the data and of the training: shows that everything works, not how well.
    pub quick: bool,
}

/// A rig before anything was measured on it.
pub(super) struct Plan {
    pub(super) name: &'static str,
    pub(super) title: &'static str,
    pub(super) plant: &'static str,
    pub(super) kind: SetKind,
    pub(super) what: &'static str,
}
