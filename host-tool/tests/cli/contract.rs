//! The invocations, files and JSON keys that other programs rely on.

use std::collections::BTreeSet;

use serde_json::Value;
use sha2::Digest;

use crate::support::{Bench, TRUTH};

fn keys(value: &Value) -> BTreeSet<&str> {
    value.as_object().expect("a JSON object").keys().map(String::as_str).collect()
}

fn has_keys(value: &Value, wanted: &[&str]) {
    let found = keys(value);
    for key in wanted {
        assert!(found.contains(key), "the key `{key}` is missing from {found:?}");
    }
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().expect("a JSON array").iter().map(number).collect()
}

/// Names of the CSV files in a folder, sorted.
fn csv_names(bench: &Bench, folder: &str) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(bench.path(folder))
        .expect("a folder can be listed")
        .map(|entry| entry.expect("an entry of a folder").file_name().to_string_lossy().into_owned())
        .filter(|name| name.ends_with(".csv"))
        .collect();
    names.sort();
    names
}

/// The columns of a CSV file in our format.
fn columns(bench: &Bench, name: &str) -> [Vec<f64>; 3] {
    let text = String::from_utf8(bench.read(name)).expect("a CSV is text");
    let mut columns = [Vec::new(), Vec::new(), Vec::new()];
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("time_s,pressure_bar,displacement_mm"), "{name}");
    for line in lines {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().expect("a number")).collect();
        assert_eq!(cells.len(), 3, "{name}: {line}");
        columns.iter_mut().zip(cells).for_each(|(column, cell)| column.push(cell));
    }
    columns
}

#[test]
fn simulate_paper_writes_24_training_files_of_1000_points_in_20_s_and_four_test_families() {
    let bench = Bench::new();
    bench.works("simulate paper --out set --seed 11");
    let train = csv_names(&bench, "set/train");
    assert_eq!(train.len(), 24);
    for name in &train {
        let [time_s, pressure_bar, _] = columns(&bench, &format!("set/train/{name}"));
        assert_eq!(time_s.len(), 1000, "{name}");
        // 1000 points evenly over 20 s: 20 ms apart, or 20/999 s if both ends count.
        assert!((time_s[999] - time_s[0] - 20.0).abs() < 0.021, "{name} lasts {}", time_s[999] - time_s[0]);
        // Eq. (1) with A = 1 stays within 0 and 2, the noise adds up to 0.1.
        assert!(pressure_bar.iter().all(|pressure| (0.0..=2.1).contains(pressure)), "{name}");
    }
    let test = csv_names(&bench, "set/test");
    for family in ["a", "b", "c", "d"] {
        assert!(test.iter().any(|name| name.starts_with(family)), "family {family} is missing from {test:?}");
    }
}

#[test]
fn simulate_gives_the_same_files_for_the_same_seed_and_others_for_another() {
    let bench = Bench::new();
    for kind in ["paper", "rich"] {
        bench.works(&format!("simulate {kind} --out {kind}1 --seed 11"));
        bench.works(&format!("simulate {kind} --out {kind}2 --seed 11"));
        bench.works(&format!("simulate {kind} --out {kind}3 --seed 12"));
        for part in ["train", "test"] {
            let names = csv_names(&bench, &format!("{kind}1/{part}"));
            assert!(!names.is_empty());
            assert_eq!(names, csv_names(&bench, &format!("{kind}2/{part}")));
            let mut same = 0;
            for name in &names {
                let first = bench.read(&format!("{kind}1/{part}/{name}"));
                assert!(first == bench.read(&format!("{kind}2/{part}/{name}")), "{kind} {part}/{name} differs between runs");
                same += usize::from(std::fs::read(bench.path(&format!("{kind}3/{part}/{name}"))).is_ok_and(|third| third == first));
            }
            assert_eq!(same, 0, "another seed leaves files of {kind}/{part} as they were");
        }
    }
}

#[test]
fn identify_finds_the_rig_behind_noise_free_data() {
    let bench = Bench::with_models();
    bench.works("identify --data exact --out found.toml --json new/folder/fit.json");
    let fit = bench.json("new/folder/fit.json");
    has_keys(&fit, &["thresholds", "weights", "rmse", "nrmse"]);
    let (thresholds, weights) = (numbers(&fit["thresholds"]), numbers(&fit["weights"]));
    assert_eq!(thresholds.len(), weights.len());
    // The data are printed to full precision, so only rounding is left of a least-squares fit.
    assert!(number(&fit["rmse"]) < 1e-9, "rmse {}", fit["rmse"]);
    assert!(number(&fit["nrmse"]) < 1e-9, "nrmse {}", fit["nrmse"]);
    for (threshold, weight) in TRUTH {
        let found: f64 =
            thresholds.iter().zip(&weights).filter(|(found, _)| (*found - threshold).abs() < 1e-3).map(|(_, weight)| weight).sum();
        assert!((found - weight).abs() < 1e-3, "threshold {threshold}: weight {found} instead of {weight}; {fit}");
    }
}

#[test]
fn train_reports_its_size_and_speed_for_every_preset() {
    const SECOND: &str = "budget-cpu-s 1";
    let bench = Bench::with_models();
    // The network of a hybrid has to gain something on its operators, else it is left out: steps for it, not time.
    for (preset, granted) in [("hybrid", "epochs 400"), ("stream-2x64", SECOND), ("stream-1x32", SECOND), ("paper-window", SECOND)] {
        bench.works(&format!("train --preset {preset} --data data --out {preset}.safetensors --{granted} --seed 5 --json {preset}.json"));
        let result = bench.json(&format!("{preset}.json"));
        for key in ["parameters", "macs_per_step", "epochs", "seconds", "cpu_seconds", "train_macs_per_second", "val_rmse"] {
            assert!(number(&result[key]) > 0.0, "{preset}: {key} is {}", result[key]);
        }
        // 1 s was granted; start, the last step and the final validation come on top, and the test machine may be busy.
        if granted == SECOND {
            assert!(number(&result["cpu_seconds"]) < 15.0, "{preset} took {} CPU seconds of 1", result["cpu_seconds"]);
        }
        bench.works(&format!("evaluate --model {preset}.safetensors --data data"));
    }
    // Table I of the paper: two layers of 64 units on one input, four gates of weights and biases each, and one linear output.
    let table_1 = 4 * 64 * (1 + 64 + 1) + 4 * 64 * (64 + 64 + 1) + 64 + 1;
    assert_eq!(number(&bench.json("paper-window.json")["parameters"]), f64::from(table_1));
}

#[test]
fn training_again_with_the_same_seed_and_threads_gives_the_same_bytes() {
    let bench = Bench::with_models();
    for (name, seed) in [("one", 5), ("two", 5), ("three", 6)] {
        bench.works(&format!("train --preset stream-1x32 --epochs 2 --data data --out {name}.safetensors --seed {seed} --threads 2"));
    }
    assert!(bench.read("one.safetensors") == bench.read("two.safetensors"));
    assert!(bench.read("one.safetensors") != bench.read("three.safetensors"));
}

#[test]
fn evaluate_judges_every_kind_of_model_by_the_same_keys() {
    let bench = Bench::with_models();
    for model in ["physics.toml", "model.safetensors", "model.blob"] {
        bench.works(&format!("evaluate --model {model} --data data --json result.json"));
        let result = bench.json("result.json");
        has_keys(&result, &["model", "files", "mean_rmse"]);
        let files = result["files"].as_array().expect("an array of files");
        assert_eq!(files.len(), 4, "{model}");
        for file in files {
            has_keys(file, &["path", "family", "n", "rmse", "nrmse", "max_abs"]);
            let path = file["path"].as_str().expect("a path");
            assert_eq!(file["family"], "a", "{path}");
            assert_eq!(file["n"], 600, "{path}");
            let [_, _, output] = columns(&bench, path);
            let range = output.iter().copied().fold(f64::MIN, f64::max) - output.iter().copied().fold(f64::MAX, f64::min);
            let (rmse, nrmse, max_abs) = (number(&file["rmse"]), number(&file["nrmse"]), number(&file["max_abs"]));
            assert!(
                (nrmse * range - rmse).abs() <= 1e-9 * rmse.max(1e-9),
                "{path}: nrmse {nrmse} is not rmse {rmse} over the range {range}"
            );
            assert!(rmse <= max_abs && max_abs <= rmse * (600.0_f64).sqrt() * (1.0 + 1e-9), "{path}: rmse {rmse}, largest {max_abs}");
        }
        let mean = files.iter().map(|file| number(&file["rmse"])).sum::<f64>() / 4.0;
        assert!((number(&result["mean_rmse"]) - mean).abs() <= 1e-12 * mean.max(1e-6), "{model}");
    }
}

#[test]
fn export_describes_the_blob_it_wrote() {
    let bench = Bench::with_models();
    bench.works("export model.safetensors --calibration data --out again.blob --json export.json");
    let result = bench.json("export.json");
    has_keys(&result, &["bytes", "sha256", "rmse_f32_vs_fixed", "max_abs_f32_vs_fixed", "accumulator_headroom"]);
    let blob = bench.read("again.blob");
    assert_eq!(number(&result["bytes"]), blob.len() as f64);
    let digest: String = sha2::Sha256::digest(&blob).iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(result["sha256"], digest.as_str());
    // The limit of the fixed-point arithmetic on the default model.
    assert!(number(&result["rmse_f32_vs_fixed"]) <= 0.001, "{result}");
    assert!(number(&result["max_abs_f32_vs_fixed"]) >= number(&result["rmse_f32_vs_fixed"]), "{result}");
    assert!(number(&result["accumulator_headroom"]) > 0.0, "{result}");
    assert!(bench.read("model.blob") == blob, "exporting twice gives two blobs");
}

#[test]
fn inspect_prints_memory_and_cost_and_writes_them_as_json() {
    let bench = Bench::with_models();
    let text = bench.works("inspect model.blob --json inspect.json").stdout;
    for word in ["flash", "RAM", "instructions", "golden", "content hash", "headroom"] {
        assert!(text.to_lowercase().contains(&word.to_lowercase()), "inspect does not print `{word}`:\n{text}");
    }
    assert!(bench.json("inspect.json").is_object());
}

#[test]
fn the_suite_decides_the_exit_code() {
    let bench = Bench::with_models();
    let good = bench.run("evaluate --model physics.toml --data exact --suite --json suite.json");
    assert_eq!(good.code, 0, "the exact model fails the suite: {}{}", good.stdout, good.stderr);
    has_keys(&bench.json("suite.json"), &["model", "files", "mean_rmse"]);
    // A model of another rig: the same file with its output doubled cannot hold any limit.
    let text = String::from_utf8(bench.read("exact/a1.csv")).expect("a CSV is text");
    let doubled: String = text
        .lines()
        .enumerate()
        .map(|(index, line)| match line.rsplit_once(',') {
            Some((front, output)) if index > 0 => format!("{front},{}\n", 2.0 * output.parse::<f64>().expect("a number")),
            _ => format!("{line}\n"),
        })
        .collect();
    bench.write("other.csv", doubled);
    let bad = bench.run("evaluate --model physics.toml --data other.csv --suite --json bad.json");
    assert_eq!(bad.code, 1, "{}{}", bad.stdout, bad.stderr);
    assert!(bench.json("bad.json")["mean_rmse"].is_number(), "a failed check still leaves its numbers");
}
