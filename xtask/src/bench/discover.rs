//! Discovery on hidden cases: the confusion matrix, false alarms, unknown effects, gap closed, parameters recovered, time.

use anyhow::Result;
use serde_json::{Map, Value};

use super::table::markdown;
use super::{Arguments, catheter_json, fresh_folder};

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

/// Runs every block, `--seeds` seeds each, and prints its confusion matrix.
pub fn measure(arguments: &Arguments) -> Result<Value> {
    let folder = fresh_folder("discover")?;
    let mut results = Map::new();
    for (index, (name, hidden, factor, words)) in BLOCKS.iter().enumerate() {
        let line = format!("bench discover --hide {hidden} --seeds {} --seed {FIRST_SEED} {words}", factor * arguments.seeds);
        let result = catheter_json(&folder, &format!("block{index}"), &line)?;
        let empty = Map::new();
        let rows = result["rows"].as_object().unwrap_or(&empty);
        let count = |key: &str| rows.values().filter_map(|row| row[key].as_u64()).sum::<u64>();
        println!("{name}: {} of {} right\n", count("right"), count("cases"));
        println!("{}", markdown(&["hidden", "right", "gap closed", "s", "answers"], &rows.iter().map(row).collect::<Vec<_>>()));
        results.insert((*name).to_owned(), result["rows"].clone());
    }
    Ok(Value::Object(results))
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
