//! `catheter.toml`: what is the same in all of a lab's recordings, so that nobody types it again.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};

use crate::output;

/// Name of the file.
pub const FILE: &str = "catheter.toml";

/// The file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Lab {
    /// How recordings are read.
    pub recordings: Recordings,
    /// Where things lie; relative to the file's folder.
    pub paths: Paths,
    /// What the rig must not exceed; `check` tells recordings that do.
    pub limits: Limits,
    /// Which rig commands speak to.
    pub rig: Rig,
}

/// As the options of the same names.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Recordings {
    pub columns: Option<String>,
    pub rate_hz: Option<f64>,
    pub keep_units: bool,
    pub skip_s: Option<f64>,
    pub tare_s: Option<f64>,
    pub resample_s: Option<f64>,
}

/// Where things lie.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Paths {
    /// Recordings that commands read without `--data`.
    pub recordings: Option<PathBuf>,
}

/// What the rig must not exceed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    pub maximum_pressure_bar: Option<f64>,
}

/// Which rig commands speak to.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Rig {
    /// As `--backend`.
    pub backend: Option<String>,
}

/// The lab's file in this folder or one above; none is fine.
///
/// # Errors
/// When there is one and it makes no sense.
pub fn find() -> Result<Option<Lab>> {
    let here = std::env::current_dir().context("the folder that this runs in is gone")?;
    let Some(path) = here.ancestors().map(|folder| folder.join(FILE)).find(|path| path.is_file()) else { return Ok(None) };
    read(&path).map(Some)
}

/// Reads and checks a file.
fn read(path: &Path) -> Result<Lab> {
    let text = output::read_text(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let mut lab: Lab =
        toml::from_str(&text).with_context(|| format!("{}: correct it, or write it anew with `catheter init`", path.display()))?;
    if let Some(problem) = lab.problem() {
        anyhow::bail!("{}: {problem}", path.display());
    }
    if let (Some(recordings), Some(folder)) = (&mut lab.paths.recordings, path.parent()) {
        *recordings = folder.join(&*recordings);
    }
    Ok(lab)
}

impl Lab {
    /// A value out of its domain.
    pub fn problem(&self) -> Option<String> {
        let recordings = &self.recordings;
        let positive = |value: Option<f64>| value.is_none_or(|value| value.is_finite() && value > 0.0);
        let zero_or_more = |value: Option<f64>| value.is_none_or(|value| value.is_finite() && value >= 0.0);
        let checks = [
            ("recordings.rate_hz must be positive", positive(recordings.rate_hz)),
            ("recordings.resample_s must be positive", positive(recordings.resample_s)),
            ("recordings.skip_s must be zero or positive", zero_or_more(recordings.skip_s)),
            ("recordings.tare_s must be zero or positive", zero_or_more(recordings.tare_s)),
            ("limits.maximum_pressure_bar must be positive", positive(self.limits.maximum_pressure_bar)),
        ];
        if let Some((problem, _)) = checks.iter().find(|(_, good)| !good) {
            return Some((*problem).to_owned());
        }
        let no_backend = |name: &String| name.parse::<crate::backend::Backend>().err();
        if let Some(problem) = self.rig.backend.as_ref().and_then(no_backend) {
            return Some(format!("rig.backend: {problem}"));
        }
        recordings.columns.as_deref().and_then(|columns| crate::recording::ColumnMap::parse(columns).err()).map(|error| error.to_string())
    }
}
