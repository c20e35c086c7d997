//! RMSE on the simulated sets: each figure over several seeds, each seed with data, training and test of its own.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, Result, anyhow, ensure};
use serde_json::{Value, json};

use super::arguments::{Arguments, FIRST_REPORTING_SEED};
use super::files::{catheter_json, fresh_folder, number};
use super::table::{Spread, markdown};

/// A simulated data set and the models that are trained on it.
struct Set {
    name: &'static str,
    simulate: &'static str,
    models: &'static [Model],
}

/// A preset, and the processor seconds its training may use.
struct Model {
    preset: &'static str,
    budget_cpu_s: u64,
    /// Whether the acceptance suite and fixed point are judged, too: minutes for a model that computes a whole window each sample.
    everything: bool,
}

impl Model {
    const fn preset(preset: &'static str, budget_cpu_s: u64) -> Self {
        Self { preset, budget_cpu_s, everything: true }
    }
}

const SETS: [Set; 3] = [
    Set {
        name: "paper",
        simulate: "simulate paper",
        models: &[
            Model::preset("hybrid", 60),
            Model::preset("stream-2x64", 45),
            Model { everything: false, ..Model::preset("paper-window", 30) },
        ],
    },
    Set { name: "rich", simulate: "simulate rich", models: &[Model::preset("stream-2x64", 240), Model::preset("stream-1x32", 240)] },
    Set { name: "all-effects", simulate: "simulate rich --plant all-effects", models: &[Model::preset("hybrid", 60)] },
];

const FAMILIES: [&str; 4] = ["a", "b", "c", "d"];

/// Figures of one model by column name: the families, and what the export says.
type Figures = BTreeMap<String, Spread>;

/// One job: a seed on a set. The jobs share nothing but the folder they were given a part of.
struct Job {
    set: &'static Set,
    seed: u64,
}

/// Measures every set and prints one table.
pub fn measure(arguments: &Arguments) -> Result<Value> {
    let sets: Vec<&Set> = SETS.iter().filter(|set| arguments.only.as_ref().is_none_or(|name| name == set.name)).collect();
    ensure!(!sets.is_empty(), "there is no such data; give --only paper, rich or all-effects");
    let seeds = (0..arguments.seeds).map(|index| FIRST_REPORTING_SEED + index);
    let jobs: Vec<Job> = seeds.flat_map(|seed| sets.iter().map(move |&set| Job { set, seed })).collect();
    let results: Mutex<BTreeMap<(usize, String), Figures>> = Mutex::new(BTreeMap::new());
    let failures: Mutex<Vec<anyhow::Error>> = Mutex::new(Vec::new());
    let next = AtomicUsize::new(0);
    // One thread a training and as many trainings as cores: the budget counts processor seconds, and no core waits for another.
    let workers = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                while let Some(job) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
                    eprintln!("{} with seed {} ({} jobs)", job.set.name, job.seed, jobs.len());
                    match one_job(job, arguments.budget_cpu_s) {
                        Ok(figures) => add(&results, job, figures),
                        Err(error) => failures.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push(error),
                    }
                }
            });
        }
    });
    let failures = failures.into_inner().map_err(|_| anyhow!("a measurement panicked"))?;
    let results = results.into_inner().map_err(|_| anyhow!("a measurement panicked"))?;
    let mut rows = Vec::new();
    let mut values = Vec::new();
    for ((set, model), figures) in &results {
        let set = SETS[*set].name;
        let mut row = vec![set.to_owned(), model.clone()];
        row.extend(FAMILIES.iter().map(|family| figures.get(*family).map_or("-".to_owned(), Spread::cell)));
        rows.push(row);
        let figures: serde_json::Map<String, Value> = figures.iter().map(|(key, spread)| (key.clone(), spread.json())).collect();
        values.push(json!({ "set": set, "model": model, "figures": figures }));
    }
    println!(
        "RMSE in mm on the four test families, free running, mean (least to most) of {} seeds, each with data, training and test of its own\n",
        arguments.seeds
    );
    println!("{}", markdown(&["data", "model", "a", "b", "c", "d"], &rows));
    println!("Other figures: the acceptance suite's criteria, processor time, fixed point against f32\n");
    let others = results.iter().flat_map(|((set, model), figures)| {
        let others = figures.iter().filter(|(name, _)| !FAMILIES.contains(&name.as_str()));
        others.map(move |(name, spread)| vec![SETS[*set].name.to_owned(), model.clone(), name.clone(), spread.cell()])
    });
    println!("{}", markdown(&["data", "model", "figure", "value"], &others.collect::<Vec<_>>()));
    // Hours of the other jobs are in the tables above; that one failed must still be seen.
    match failures.into_iter().next() {
        Some(error) => Err(error.context("a job failed; the tables are without it")),
        None => Ok(Value::Array(values)),
    }
}

fn add(results: &Mutex<BTreeMap<(usize, String), Figures>>, job: &Job, figures: Vec<(String, String, f64)>) {
    let index = SETS.iter().position(|set| set.name == job.set.name).unwrap_or(SETS.len());
    let mut results = results.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    for (model, column, value) in figures {
        results.entry((index, model)).or_default().entry(column).or_default().push(value);
    }
}

/// Simulates, fits and judges; gives (model, column, value).
fn one_job(job: &Job, budget_cpu_s: Option<u64>) -> Result<Vec<(String, String, f64)>> {
    let seed = job.seed;
    let folder = fresh_folder(&format!("{}-{seed}", job.set.name))?;
    let mut figures = Vec::new();
    catheter_json(&folder, "simulate", &format!("{} --out data --seed {seed}", job.set.simulate))?;
    catheter_json(&folder, "physics", "identify --data data/train --out physics.toml")?;
    judge(&folder, "identified physics", "physics.toml", "--suite", &mut figures)?;
    for model in job.set.models {
        let name = model.preset;
        let budget = budget_cpu_s.unwrap_or(model.budget_cpu_s);
        let training = catheter_json(
            &folder,
            name,
            &format!("train --preset {name} --data data/train --out {name}.safetensors --budget-cpu-s {budget} --seed {seed} --threads 1"),
        )?;
        figures.push((name.to_owned(), "cpu_seconds".to_owned(), number(&training, "cpu_seconds")?));
        let trained = format!("{name}.safetensors");
        judge(&folder, name, &trained, if model.everything { "--suite" } else { "" }, &mut figures)?;
        if !model.everything {
            continue;
        }
        let blob = format!("{name}.blob");
        let exported =
            catheter_json(&folder, &format!("{name}-export"), &format!("export {name}.safetensors --calibration data/train --out {blob}"))?;
        let fixed = format!("{name}, fixed point");
        figures.push((fixed.clone(), "rmse_f32_vs_fixed".to_owned(), number(&exported, "rmse_f32_vs_fixed")?));
        judge(&folder, &fixed, &blob, &format!("--suite --reference {trained}"), &mut figures)?;
    }
    Ok(figures)
}

/// Errors per family, and every criterion of the acceptance suite by its name.
fn judge(folder: &std::path::Path, model: &str, file: &str, options: &str, figures: &mut Vec<(String, String, f64)>) -> Result<()> {
    let line = format!("evaluate --model {file} --data data/test {options}");
    let result = catheter_json(folder, &format!("{file}-evaluation"), &line)?;
    let files = result["files"].as_array().context("evaluate names no files")?;
    for family in FAMILIES {
        let errors: Vec<f64> =
            files.iter().filter(|file| file["family"] == family).map(|file| number(file, "rmse")).collect::<Result<_>>()?;
        if errors.is_empty() {
            anyhow::bail!("the test set in {} has no family {family}", folder.display());
        }
        figures.push((model.to_owned(), family.to_owned(), errors.iter().sum::<f64>() / errors.len() as f64));
    }
    for criterion in result["suite"]["criteria"].as_array().into_iter().flatten() {
        let name = criterion["name"].as_str().context("a criterion has no name")?;
        // A criterion that is no number fails by definition; it must not vanish from the mean.
        figures.push((model.to_owned(), name.to_owned(), criterion["value"].as_f64().unwrap_or(f64::INFINITY)));
    }
    Ok(())
}
