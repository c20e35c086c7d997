//! Where a result came from: command, version, seed, and the hashes of what was read, in one line or one JSON object.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Mutex, OnceLock};
use std::time::Instant;

/// What a process knows about its run.
struct Run {
    version: String,
    seed: Option<u64>,
    /// SHA-256 of each file that was read, by path.
    inputs: BTreeMap<String, String>,
}

static RUN: Mutex<Run> = Mutex::new(Run { version: String::new(), seed: None, inputs: BTreeMap::new() });

static BEGAN: OnceLock<Instant> = OnceLock::new();

/// Time since the command began, s.
pub(super) fn elapsed_s() -> f64 {
    BEGAN.get_or_init(Instant::now).elapsed().as_secs_f64()
}

/// Says what a command line was; without it, as in another program's tests, results carry no provenance.
pub fn begin(version: &str, seed: Option<u64>) {
    BEGAN.get_or_init(Instant::now);
    if let Ok(mut run) = RUN.lock() {
        (run.version, run.seed) = (version.to_owned(), seed);
    }
}

/// Remembers a file that was read.
pub fn read(path: &Path, sha256: &str) {
    if let Ok(mut run) = RUN.lock()
        && !run.version.is_empty()
    {
        run.inputs.insert(path.display().to_string(), sha256.to_owned());
    }
}

/// The words of this process's command line.
fn command() -> String {
    let mut words = std::env::args_os().map(|word| word.to_string_lossy().into_owned());
    let program = words.next().unwrap_or_default();
    let name = Path::new(&program).file_stem().map_or(program.clone(), |name| name.to_string_lossy().into_owned());
    std::iter::once(name).chain(words).collect::<Vec<_>>().join(" ")
}

/// One line; of many inputs the first ones.
#[must_use]
pub fn line() -> String {
    const MOST: usize = 4;
    let Ok(run) = RUN.lock() else { return String::new() };
    if run.version.is_empty() {
        return String::new();
    }
    let mut text = format!("made by catheter {}: {}", run.version, command());
    if let Some(seed) = run.seed {
        text.push_str(&format!("; seed {seed}"));
    }
    for (path, sha256) in run.inputs.iter().take(MOST) {
        text.push_str(&format!("; {path} sha256 {sha256}"));
    }
    if run.inputs.len() > MOST {
        text.push_str(&format!("; and {} more", run.inputs.len() - MOST));
    }
    crate::plain::plain(&text.replace(['\n', '\t'], " ")).into_owned()
}

/// The same for JSON; nothing without a command line.
pub(super) fn json() -> Option<serde_json::Value> {
    let run = RUN.lock().ok()?;
    (!run.version.is_empty())
        .then(|| serde_json::json!({ "command": command(), "version": run.version, "seed": run.seed, "inputs_sha256": run.inputs }))
}
