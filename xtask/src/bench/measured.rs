//! The measured sets: identified on one excitation, judged on another, free running, as a share of the output range.

use std::path::Path;

use anyhow::{Context, Result};
use serde_json::{Value, json};

use super::table::{Spread, markdown};
use super::{Arguments, FIRST_REPORTING_SEED, catheter_json, fresh_folder, number};

/// A measured set. Options are set from what the data set's authors and the training recordings say, never from the test recordings.
struct Set {
    name: &'static str,
    folder: &'static str,
    columns: &'static str,
    /// What the names of the files to fit on and to judge on contain.
    train: &'static str,
    test: &'static str,
    identify: &'static str,
}

const SETS: [Set; 2] = [
    Set {
        name: "piezo stack",
        folder: "piezo-picma",
        columns: "time=t_s,input=voltage_V,output=displacement_um",
        train: "model_1hz_sine",
        test: "test_modulated_sine",
        // The first second of the training file is a start-up transient; the recording channel has a delay.
        identify: "--skip-s 1 --dead-time-s auto",
    },
    Set {
        name: "friction damper",
        folder: "friction-damper-backlash",
        columns: "time=t_s,input=displacement_in,output=force_kip",
        train: "Hz_",
        test: "_earthquake_",
        identify: "",
    },
];

/// Measures both sets and prints one table.
pub fn measure(recordings: &Path, arguments: &Arguments) -> Result<Value> {
    let mut rows = Vec::new();
    let mut values = Vec::new();
    for set in &SETS {
        let folder = fresh_folder(&format!("measured-{}", set.name.replace(' ', "-")))?;
        copy(&recordings.join(set.folder), set.train, &folder.join("train"))?;
        copy(&recordings.join(set.folder), set.test, &folder.join("test"))?;
        let columns = set.columns;
        let judge = |model: &str| -> Result<f64> {
            let line = format!("evaluate --model {model} --data test --columns {columns}");
            let result = catheter_json(&folder, "evaluation", &line)?;
            let files = result["files"].as_array().context("evaluate names no files")?;
            let errors: Vec<f64> = files.iter().map(|file| number(file, "nrmse")).collect::<Result<_>>()?;
            Ok(errors.iter().sum::<f64>() / errors.len() as f64)
        };
        eprintln!("{}: identify", set.name);
        catheter_json(&folder, "physics", &format!("identify --data train --columns {columns} {} --out physics.toml", set.identify))?;
        let physics = judge("physics.toml")?;
        let (mut trained, mut fixed) = (Spread::default(), Spread::default());
        for seed in (0..arguments.seeds).map(|index| FIRST_REPORTING_SEED + index) {
            eprintln!("{}: train with seed {seed}", set.name);
            let budget = arguments.budget_cpu_s;
            let line = format!("train --data train --columns {columns} --out model.safetensors --budget-cpu-s {budget} --seed {seed}");
            catheter_json(&folder, "train", &line)?;
            trained.push(judge("model.safetensors")?);
            catheter_json(
                &folder,
                "export",
                &format!("export model.safetensors --calibration train --columns {columns} --out model.blob"),
            )?;
            fixed.push(judge("model.blob")?);
        }
        rows.push(vec![set.name.to_owned(), format!("{physics:.4}"), trained.cell(), fixed.cell()]);
        values.push(json!({ "set": set.name, "physics": physics, "hybrid": trained.json(), "hybrid_fixed_point": fixed.json() }));
    }
    println!(
        "RMSE over output range on the test recordings, free running, mean of the files; hybrid: mean (least to most) of {} seeds\n",
        arguments.seeds
    );
    println!("{}", markdown(&["recordings", "identified physics", "hybrid, f32", "hybrid, fixed point"], &rows));
    Ok(Value::Array(values))
}

/// Copies the CSV files in `from` whose name contains `part` into the new folder `to`.
fn copy(from: &Path, part: &str, to: &Path) -> Result<()> {
    std::fs::create_dir_all(to)?;
    let mut count = 0;
    for entry in std::fs::read_dir(from).with_context(|| format!("{}: cannot be read; is --recordings right?", from.display()))? {
        let path = entry?.path();
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        if name.contains(part) && name.ends_with(".csv") {
            std::fs::copy(&path, to.join(name)).with_context(|| format!("{}: cannot be copied", path.display()))?;
            count += 1;
        }
    }
    if count == 0 {
        anyhow::bail!("{}: no CSV file's name contains {part}; is --recordings right?", from.display());
    }
    Ok(())
}
