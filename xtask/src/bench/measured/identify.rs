//! `identify` with options that the training recordings choose, and `train`: free running, as a share of the output range.

use std::path::Path;

use anyhow::{Context, Result};
use serde_json::{Value, json};

use crate::bench::arguments::{Arguments, FIRST_REPORTING_SEED};
use crate::bench::files::{catheter_json, fresh_folder, number};
use crate::bench::table::{Spread, markdown};

/// A measured set.
struct Set {
    name: &'static str,
    folder: &'static str,
    columns: &'static str,
    /// What the names of the files to fit on and to judge on contain.
    train: &'static str,
    test: &'static str,
}

/// Options of `identify` among which the training recordings choose.
const CANDIDATES: [&str; 8] = [
    "",
    "--skip-s 1",
    "--dead-time-s auto",
    "--skip-s 1 --dead-time-s auto",
    "--model modified-pi",
    "--model modified-pi --skip-s 1",
    "--model modified-pi --dead-time-s auto",
    "--model modified-pi --skip-s 1 --dead-time-s auto",
];
/// Share of a single training recording that is fitted while the whole judges.
const FITTED_PERCENT: usize = 70;

const SETS: [Set; 2] = [
    Set {
        name: "piezo stack",
        folder: "piezo-picma",
        columns: "time=t_s,input=voltage_V,output=displacement_um",
        train: "model_1hz_sine",
        test: "test_modulated_sine",
    },
    Set {
        name: "friction damper",
        folder: "friction-damper-backlash",
        columns: "time=t_s,input=displacement_in,output=force_kip",
        train: "Hz_",
        test: "_earthquake_",
    },
];

/// Processor seconds of each training.
const BUDGET_CPU_S: u64 = 10;

/// Measures both sets and prints one table.
pub fn measure(recordings: &Path, arguments: &Arguments) -> Result<Value> {
    let mut rows = Vec::new();
    let mut values = Vec::new();
    for set in &SETS {
        let folder = fresh_folder(&format!("measured-{}", set.name.replace(' ', "-")))?;
        copy(&recordings.join(set.folder), set.train, &folder.join("train"))?;
        copy(&recordings.join(set.folder), set.test, &folder.join("test"))?;
        let columns = set.columns;
        let judge = |model: &str| mean_nrmse(&folder, model, "test", columns);
        let options = choose(&folder, columns)?;
        eprintln!("{}: identify {options}", set.name);
        catheter_json(&folder, "physics", &format!("identify --data train --columns {columns} {options} --out physics.toml"))?;
        let physics = judge("physics.toml")?;
        let (mut trained, mut fixed) = (Spread::default(), Spread::default());
        for seed in (0..arguments.seeds).map(|index| FIRST_REPORTING_SEED + index) {
            eprintln!("{}: train with seed {seed}", set.name);
            let budget = arguments.budget_cpu_s.unwrap_or(BUDGET_CPU_S);
            let line =
                format!("train --data train --columns {columns} --out model.safetensors --budget-cpu-s {budget} --seed {seed} --threads 1");
            catheter_json(&folder, "train", &line)?;
            trained.push(judge("model.safetensors")?);
            catheter_json(
                &folder,
                "export",
                &format!("export model.safetensors --calibration train --columns {columns} --out model.blob"),
            )?;
            fixed.push(judge("model.blob")?);
        }
        let shown = if options.is_empty() { "none" } else { options };
        rows.push(vec![set.name.to_owned(), shown.to_owned(), format!("{physics:.4}"), trained.cell(), fixed.cell()]);
        values.push(json!({ "set": set.name, "identify": options, "physics": physics, "hybrid": trained.json(), "hybrid_fixed_point": fixed.json() }));
    }
    println!(
        "RMSE over output range on the test recordings, free running, mean of the files; hybrid: mean (least to most) of {} seeds\n",
        arguments.seeds
    );
    println!(
        "{}",
        markdown(
            &["recordings", "options of identify, by the training recordings", "identified physics", "hybrid, f32", "hybrid, fixed point"],
            &rows
        )
    );
    Ok(Value::Array(values))
}

/// Mean error over output range of a model on the recordings in a folder.
fn mean_nrmse(folder: &Path, model: &str, data: &str, columns: &str) -> Result<f64> {
    let result = catheter_json(folder, "evaluation", &format!("evaluate --model {model} --data {data} --columns {columns}"))?;
    let files = result["files"].as_array().context("evaluate names no files")?;
    let errors: Vec<f64> = files.iter().map(|file| number(file, "nrmse")).collect::<Result<_>>()?;
    Ok(errors.iter().sum::<f64>() / errors.len() as f64)
}

/// The options with which the training recordings explain each other best: each recording is judged by what the others give, a single
/// one, from its start, by what its beginning gives. (Its end alone would be judged from an unknown history.)
fn choose(folder: &Path, columns: &str) -> Result<&'static str> {
    let mut names: Vec<String> = std::fs::read_dir(folder.join("train"))?
        .map(|entry| Ok(format!("train/{}", entry?.file_name().to_string_lossy())))
        .collect::<Result<_>>()?;
    names.sort();
    // What is fitted, and what it is judged by.
    let folds: Vec<(Vec<String>, &String)> = match names.as_slice() {
        [only] => vec![(vec![beginning(folder, only)?], only)],
        several => several.iter().map(|name| (several.iter().filter(|other| *other != name).cloned().collect(), name)).collect(),
    };
    let mut best = (f64::INFINITY, CANDIDATES[0]);
    for options in CANDIDATES {
        let mut sum = 0.0;
        for (fitted, judged) in &folds {
            let fitted: String = fitted.iter().map(|name| format!("--data {name} ")).collect();
            catheter_json(folder, "candidate", &format!("identify {fitted} --columns {columns} {options} --out candidate.toml"))?;
            sum += mean_nrmse(folder, "candidate.toml", judged, columns)?;
        }
        eprintln!("  {:.5} with options `{options}`", sum / folds.len() as f64);
        if sum < best.0 {
            best = (sum, options);
        }
    }
    Ok(best.1)
}

/// The first part of a recording, as a file of its own.
fn beginning(folder: &Path, name: &str) -> Result<String> {
    let text = std::fs::read_to_string(folder.join(name))?;
    let (header, rows) = text.split_once('\n').with_context(|| format!("{name}: no rows"))?;
    let rows: Vec<&str> = rows.lines().collect();
    let fitted = &rows[..rows.len() * FITTED_PERCENT / 100];
    std::fs::write(folder.join("beginning.csv"), format!("{header}\n{}\n", fitted.join("\n")))?;
    Ok("beginning.csv".to_owned())
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
