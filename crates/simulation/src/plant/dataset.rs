//! Whole data sets: excitations played to the plant and written as recordings, with the excitation and plant files that made them.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use super::simulate::Plant;
use crate::excitation::sets::{self, Named, SetConfig};
use crate::excitation::{self, ExcitationConfig, Limits};
use recording::{self, Recording, Signal};

/// Which data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetKind {
    /// The paper's 24 descending sines and its four test families.
    Paper,
    /// The rich training set and the same four test families.
    Rich,
    /// One recording of each kind a lab needs.
    Lab,
}

/// One recording of a set.
#[derive(Clone, Debug)]
pub struct Made {
    /// The folder within the set: `train`, `test` or `lab`.
    pub part: &'static str,
    /// Name and excitation.
    pub named: Named,
    /// What the plant answered; its path lies within the set's folder.
    pub recording: Recording,
}

/// A simulated data set in memory.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// All recordings in order.
    pub made: Vec<Made>,
}

impl Dataset {
    /// Plays a whole set to a plant. All excitations are checked against the limits before the first is played.
    ///
    /// # Errors
    /// When an excitation exceeds a limit, with its name.
    pub fn simulate(kind: SetKind, config: &SetConfig, limits: &Limits, plant: &Plant, folder: &Path) -> Result<Self> {
        Self::simulate_watched(kind, config, limits, plant, folder, &|_, _| {})
    }

    /// As [`Self::simulate`]; `watch` hears how many seconds are played, and of how many.
    ///
    /// # Errors
    /// When an excitation exceeds a limit, with its name.
    pub fn simulate_watched(
        kind: SetKind,
        config: &SetConfig,
        limits: &Limits,
        plant: &Plant,
        folder: &Path,
        watch: &dyn Fn(f64, f64),
    ) -> Result<Self> {
        let parts = match kind {
            SetKind::Paper => vec![("train", sets::paper_training(config)), ("test", sets::families(config))],
            SetKind::Rich => vec![("train", sets::rich_training(config)), ("test", sets::families(config))],
            SetKind::Lab => vec![("lab", sets::lab(config))],
        };
        for named in parts.iter().flat_map(|(_, set)| set) {
            named.excitation.sample_within(limits).with_context(|| named.name.clone())?;
        }
        let length_s = |named: &Named| named.excitation.segments.iter().map(|segment| segment.duration_s).sum::<f64>();
        let (mut played_s, all_s) = (0.0, parts.iter().flat_map(|(_, set)| set).map(length_s).sum());
        let mut made = Vec::new();
        for (part, set) in parts {
            for named in set {
                let path = folder.join(part).join(format!("{}.csv", named.name));
                let recording = play(&named.excitation, limits, plant, &path).with_context(|| named.name.clone())?;
                played_s += length_s(&named);
                watch(played_s, all_s);
                made.push(Made { part, named, recording });
            }
        }
        Ok(Self { made })
    }

    /// The recordings of one part, `train`, `test` or `lab`.
    pub fn part(&self, part: &str) -> impl Iterator<Item = &Recording> {
        self.made.iter().filter(move |made| made.part == part).map(|made| &made.recording)
    }

    /// Writes the recordings to `folder/train/*.csv` and `folder/test/*.csv` (or `folder/lab`), their excitations to
    /// `folder/excitation/`, and the plant to `folder/plant.toml`.
    ///
    /// # Errors
    /// When recordings of another set lie in the way (training on a mixture would go unnoticed), or a file cannot be written.
    pub fn write(&self, folder: &Path, plant: &Plant) -> Result<()> {
        for part in ["train", "test", "lab"] {
            self.refuse_mixture(&folder.join(part))?;
        }
        for made in &self.made {
            recording::write(&made.recording.path, &made.recording)?;
            let excitation = folder.join("excitation").join(made.part).join(format!("{}.toml", made.named.name));
            output::write_atomic(&excitation, excitation::to_toml(&made.named.excitation).as_bytes())?;
        }
        output::write_atomic(&folder.join("plant.toml"), plant.config().to_toml().as_bytes())
    }

    fn refuse_mixture(&self, folder: &Path) -> Result<()> {
        if !folder.is_dir() {
            return Ok(());
        }
        let ours: Vec<&PathBuf> = self.made.iter().map(|made| &made.recording.path).collect();
        let found = recording::files(&[folder.to_path_buf()]).unwrap_or_default();
        match found.iter().find(|path| !ours.contains(path)) {
            Some(other) => bail!("{}: is of another data set and would be mixed with this one; choose an empty folder", other.display()),
            None => Ok(()),
        }
    }
}

/// Plays one excitation to the plant; `path` names the recording. Nothing is played beyond the limits.
///
/// # Errors
/// When the excitation makes no sense or exceeds a limit.
pub fn play(excitation: &ExcitationConfig, limits: &Limits, plant: &Plant, path: &Path) -> Result<Recording> {
    let samples = excitation.sample_within(limits)?;
    let displacement_mm = plant.simulate(&samples.pressure_bar, excitation.sample_period_s, excitation.seed);
    let signals = (Signal::pressure_bar(), Signal::displacement_mm());
    Ok(Recording::new(path, signals.0, signals.1, samples.time_s, samples.pressure_bar, displacement_mm)?)
}
