//! Which plant made the recordings: named, found beside them, or recognised by its answers.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::evaluate::Errors;
use recording::{Recording, Signal};
use simulation::plant::Plant;

/// A plant file beside the recordings is theirs when it reproduces them this well; measurement noise may be switched on in it.
const FILE_TOLERANCE: f64 = 0.03;
/// A named plant is recognised when it reproduces the recordings as well as printed digits allow.
const NAMED_TOLERANCE: f64 = 1e-3;
/// How far above the recordings `catheter simulate` leaves `plant.toml`.
const LEVELS: usize = 3;

/// A plant and what to call it.
#[derive(Clone, Debug)]
pub struct KnownPlant {
    /// `pi`, `all-effects` or a file.
    pub name: String,
    /// The plant.
    pub plant: Plant,
}

/// The plant of a name or file when one is given; else the one that made the recordings, if it can be found: the `plant.toml` that
/// `catheter simulate` leaves beside its data, or one of the named plants. It must reproduce a recording; none does for a measured rig.
///
/// # Errors
/// When the plant that was asked for does not exist or makes no sense.
pub fn find(asked: Option<&str>, recordings: &[Recording]) -> Result<Option<KnownPlant>> {
    if let Some(name) = asked {
        let plant = Plant::named(name).context("--plant")?;
        return Ok(Some(KnownPlant { name: name.to_owned(), plant }));
    }
    let Some(recording) = recordings.first() else { return Ok(None) };
    if recording.input_signal != Signal::pressure_bar() || recording.output_signal != Signal::displacement_mm() {
        return Ok(None);
    }
    let file = plant_file(&recording.path);
    let candidates = file.iter().map(|path| (path.display().to_string(), FILE_TOLERANCE));
    let named = ["pi", "all-effects"].map(|name| (name.to_owned(), NAMED_TOLERANCE));
    for (name, tolerance) in candidates.chain(named) {
        // A file of that name that is no plant is none of ours: it is not what was asked for, so it is no error.
        let Ok(plant) = Plant::named(&name) else { continue };
        let answer = plant.simulate(&recording.input, recording.sample_period_s, 0);
        if Errors::between(&answer, &recording.output).nrmse.is_some_and(|nrmse| nrmse <= tolerance) {
            return Ok(Some(KnownPlant { name, plant }));
        }
    }
    Ok(None)
}

fn plant_file(recording: &Path) -> Option<PathBuf> {
    recording.ancestors().skip(1).take(LEVELS).map(|folder| folder.join("plant.toml")).find(|path| path.is_file())
}
