//! Discovery on hidden cases: the confusion matrix, false alarms, unknown effects, gap closed, parameters recovered, time.

use std::path::PathBuf;
use std::time::UNIX_EPOCH;

use anyhow::Result;
use serde_json::{Map, Value};

use super::arguments::Arguments;
use super::files::catheter;
use super::table::markdown;
use crate::process::{run, target_folder};

/// First seed of the cases that figures are reported on; tuning used those below 500, the tests those from 500 on.
const FIRST_SEED: u64 = 1000;

/// One block of cases: its name, what is hidden, how often as many seeds as asked for, and further words for the command.
const BLOCKS: [(&str, &str, u64, &str); 9] = [
    ("single effects, paper's session, 0.5 % noise", "effects", 1, ""),
    ("single effects, rich session, 0.5 % noise", "effects", 1, "--excitation rich"),
    ("single effects, paper's session, 1 % noise", "effects", 1, "--noise 0.01"),
    ("single effects, coloured noise", "effects", 1, "--coloured"),
    ("nothing hidden", "none", 10, ""),
    ("two effects", "pairs", 5, ""),
    ("effects outside the catalogue", "aliens", 1, ""),
    ("second rig: single effects", "effects", 1, "--rig rival"),
    ("second rig: nothing, and effects outside the catalogue", "none aliens", 2, "--rig rival"),
];

/// Runs every block, `--seeds` seeds each, and prints its confusion matrix. Every case is printed and kept as it comes: an interrupted run
/// goes on where it was, as long as the built command is the same.
pub fn measure(arguments: &Arguments) -> Result<Value> {
    let folder = folder_of_this_build()?;
    let mut results = Map::new();
    for (index, (name, hidden, factor, words)) in BLOCKS.iter().enumerate() {
        println!("{name}");
        let seeds = factor * arguments.seeds;
        let file = folder.join(format!("block{index}.json"));
        let line = format!("bench discover --hide {hidden} --seeds {seeds} --seed {FIRST_SEED} --verbose --resume {words}");
        run("bench discover", catheter(&folder, &line).arg("--json").arg(&file))?;
        let result: Value = serde_json::from_str(&std::fs::read_to_string(&file)?)?;
        let empty = Map::new();
        let rows = result["rows"].as_object().unwrap_or(&empty);
        let count = |key: &str| rows.values().filter_map(|row| row[key].as_u64()).sum::<u64>();
        println!("{name}: {} of {} right\n", count("right"), count("cases"));
        println!("{}", markdown(&["hidden", "right", "gap closed", "s", "answers"], &rows.iter().map(row).collect::<Vec<_>>()));
        results.insert((*name).to_owned(), result["rows"].clone());
    }
    Ok(Value::Object(results))
}

/// A folder for this build of the command: cases of another build are another's figures.
fn folder_of_this_build() -> Result<PathBuf> {
    let built = std::fs::metadata(target_folder().join("release/catheter"))?.modified()?.duration_since(UNIX_EPOCH)?;
    let folder = target_folder().join("bench").join(format!("discover-{}", built.as_secs()));
    std::fs::create_dir_all(&folder)?;
    Ok(folder)
}

/// A line of the confusion matrix.
fn row((hidden, row): (&String, &Value)) -> Vec<String> {
    let empty = Map::new();
    let answers = row["answers"].as_object().unwrap_or(&empty);
    let answers: Vec<String> = answers.iter().map(|(answer, count)| format!("{count} x {answer}")).collect();
    vec![
        hidden.clone(),
        format!("{} of {}", row["right"], row["cases"]),
        format!("{:.3}", row["gap_closed"].as_f64().unwrap_or(f64::NAN)),
        format!("{:.1}", row["seconds"].as_f64().unwrap_or(f64::NAN)),
        answers.join(", "),
    ]
}
