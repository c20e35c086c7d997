//! What the demonstration found: `demo.json`, and all that the report is drawn from.

use serde::Serialize;

use crate::evaluate::ladder::Ladder;
use crate::evaluate::suite::{Criterion, SuiteReport};
use crate::evaluate::{FamilyErrors, FileErrors};
use crate::export::Comparison;
use crate::plant::PlantConfig;
use crate::report::Example;
use crate::train::TrainReport;

/// Everything.
#[derive(Debug, Serialize)]
pub struct Demo {
    /// Version of the tool.
    pub version: String,
    /// Seed of every random choice.
    pub seed: u64,
    /// Threads it ran on.
    pub threads: usize,
    /// Whether it ran with a fraction of data and training.
    pub quick: bool,
    /// Wall time in s, without writing the report.
    pub seconds: f64,
    /// The stages in order.
    pub stages: Vec<Stage>,
    /// The rigs.
    pub rigs: Vec<Rig>,
    /// What was verified.
    pub checks: Vec<Criterion>,
    /// Whether all checks hold.
    pub passed: bool,
}

impl Demo {
    /// How many checks hold of how many: what decides whether the demonstration passed, and every other criterion of the suite on the blob.
    /// And the names of those criteria that do not hold, which decide nothing.
    #[must_use]
    pub fn count_of_checks(&self) -> (usize, usize, Vec<String>) {
        let of_blob = |rig: &Rig| rig.suites.last().map(|suite| suite.report.criteria.clone()).unwrap_or_default();
        counted(&self.checks, &self.rigs.iter().map(|rig| (rig.name.clone(), of_blob(rig))).collect::<Vec<_>>())
    }
}

/// As [`Demo::count_of_checks`], of the checks and of each rig's criteria.
fn counted(checks: &[Criterion], suites: &[(String, Vec<Criterion>)]) -> (usize, usize, Vec<String>) {
    let mut all: Vec<(String, bool)> = checks.iter().map(|check| (check.name.clone(), check.passed)).collect();
    for (rig, criteria) in suites {
        for criterion in criteria {
            let name = format!("{rig}: {}", criterion.name);
            if !all.iter().any(|(known, _)| *known == name) {
                all.push((name, criterion.passed));
            }
        }
    }
    let held = all.iter().filter(|(_, passed)| *passed).count();
    let missed = all[checks.len()..].iter().filter(|(_, passed)| !passed).map(|(name, _)| name.clone()).collect();
    (held, all.len(), missed)
}

/// One stage.
#[derive(Clone, Debug, Serialize)]
pub struct Stage {
    /// Its name, that of the command.
    pub name: String,
    /// What it did.
    pub what: String,
    /// Wall time in s.
    pub seconds: f64,
}

/// One rig and all that was made for it.
#[derive(Debug, Serialize)]
pub struct Rig {
    /// Short name, also of its folder.
    pub name: String,
    /// Name in the report.
    pub title: String,
    /// What it is and what it was trained on.
    pub what: String,
    /// The plant.
    pub plant: PlantConfig,
    /// Training recordings.
    pub training_recordings: usize,
    /// Samples in them.
    pub training_samples: usize,
    /// The pure network.
    pub lstm: Model,
    /// The hybrid, in `f32`.
    pub hybrid: Model,
    /// The hybrid's blob.
    pub export: Exported,
    /// The blob's errors by family.
    pub families: Vec<FamilyErrors>,
    /// The blob's errors by file.
    pub files: Vec<FileErrors>,
    /// All models side by side.
    pub ladder: Ladder,
    /// The acceptance suite on three of them.
    pub suites: Vec<NamedSuite>,
    /// The blob on the worst recording of each family.
    pub examples: Vec<Example>,
}

/// A model of the ladder and how it came to be.
#[derive(Clone, Debug, Serialize)]
pub struct Model {
    /// What it is.
    pub kind: String,
    /// Fitted numbers.
    pub parameters: usize,
    /// Multiplications of one step.
    pub macs_per_step: usize,
    /// Its training.
    pub training: Trained,
}

/// A training run.
#[derive(Clone, Debug, Serialize)]
pub struct Trained {
    /// File of the model, in the folder of the demonstration.
    pub file: String,
    /// Preset it started from.
    pub preset: String,
    /// Whether the model has a network; physics that is exact is left alone.
    pub has_network: bool,
    /// What the run cost and reached.
    pub report: TrainReport,
}

/// The quantised model.
#[derive(Clone, Debug, Serialize)]
pub struct Exported {
    /// File of the blob, in the folder of the demonstration.
    pub file: String,
    /// Its size.
    pub bytes: usize,
    /// SHA-256 of the file.
    pub sha256: String,
    /// Room left in the tightest accumulator, as a factor; absent without a network.
    pub accumulator_headroom: Option<f64>,
    /// How weights were rounded.
    pub rounding: String,
    /// Fixed point against `f32` over the calibration recordings.
    pub comparison: Comparison,
}

/// The suite's result for one model.
#[derive(Debug, Serialize)]
pub struct NamedSuite {
    /// The model.
    pub name: String,
    /// The result.
    #[serde(flatten)]
    pub report: SuiteReport,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_headline_counts_every_check_of_the_suite_once_and_names_those_that_failed() {
        let criterion =
            |name: &str, passed| Criterion { name: name.into(), what: String::new(), value: 0.0, limit: 1.0, unit: String::new(), passed };
        let checks = [criterion("effects: recordings", true), criterion("golden vectors", false)];
        let suite = vec![criterion("recordings", true), criterion("long-run", false), criterion("holds", true)];
        let (held, all, missed) = counted(&checks, &[("effects".to_owned(), suite)]);
        assert_eq!((held, all, missed), (2, 4, vec!["effects: long-run".to_owned()]));
    }
}
