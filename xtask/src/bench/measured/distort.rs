//! Recordings of a map as a mistake would leave them, and where everything of a map lies.

use std::path::Path;

use anyhow::{Context, Result};

use crate::bench::arguments::Arguments;
use crate::process::{answer, command, root, shown};

pub const FITTED: &str = "measured";
/// Folders below the one of the benchmarks: the prepared recordings, and what is fitted to them.
pub const PREPARED: &str = "measured-prepared";
pub const SCRIPT: &str = "tests/baselines/measured.py";

/// Writes the recordings of a map, distorted, to the folders `train` and `test` in `own`; gives the range of the map's test outputs.
pub fn distort(bench: &Path, map: &str, how: &str, own: &str, arguments: &Arguments) -> Result<f64> {
    let mut distort = command(&arguments.python);
    distort.arg(root().join(SCRIPT)).arg("distort").arg("--prepared").arg(bench.join(PREPARED));
    let said = answer(distort.args(["--map", map, "--how", how]).arg("--out").arg(bench.join(own)));
    let said = said.with_context(|| format!("`{}` failed", shown(&distort)))?;
    said.trim().parse().with_context(|| format!("`{}` said {said}", shown(&distort)))
}
