//! Ladder, suite, resampling and report of `catheter evaluate`.

use serde_json::Value;

use crate::support::{Bench, recording_csv};

fn names<'a>(list: &'a Value, key: &str) -> Vec<&'a str> {
    list.as_array().expect("an array").iter().map(|entry| entry[key].as_str().expect("a name")).collect()
}

#[test]
fn the_ladder_puts_models_side_by_side_and_names_the_simplest_that_suffices() {
    let bench = Bench::with_models();
    let line = "evaluate --model model.safetensors --data exact --ladder --ladder-train exact --compare physics.toml model.blob";
    let said = bench.works(&format!("{line} --json ladder.json --html ladder.html"));
    let ladder = &bench.json("ladder.json")["ladder"];
    let rungs = names(&ladder["rungs"], "name");
    assert_eq!(rungs[..4], ["static", "PI", "modified PI", "modified PI, delayed"]);
    // Models by the cost of a step.
    assert_eq!(rungs[4..], ["physics.toml", "model.safetensors", "model.blob"]);
    // The recordings come from play operators: these suffice, exactly, and a curve without memory does not.
    assert_eq!(ladder["simplest_sufficient"], "PI");
    assert_eq!(ladder["rungs"][0]["sufficient"], false);
    assert!(said.stdout.contains("the simplest that suffices"), "{}", said.stdout);
    let page = String::from_utf8(bench.read("ladder.html")).expect("HTML is text");
    assert!(page.starts_with("<!DOCTYPE html>") && page.trim_end().ends_with("</html>"));
    for rung in rungs {
        assert!(page.contains(rung), "{rung} is not in the report");
    }
    bench.refuses("evaluate --model physics.toml --data exact --ladder", &["--ladder-train"]);
}

#[test]
fn the_suite_compares_a_blob_with_the_model_it_was_made_from() {
    let bench = Bench::with_models();
    let said = bench.run("evaluate --model model.blob --reference model.safetensors --data data --suite --json suite.json");
    assert!(matches!(said.code, 0 | 1), "{}", said.stderr);
    let result = bench.json("suite.json");
    let suite = &result["suite"];
    let criteria = names(&suite["criteria"], "name");
    assert_eq!(criteria, ["recordings", "holds", "histories", "long-run", "long-run-growth", "fixed-point", "fixed-point-growth"]);
    // Nobody knows the plant of these recordings.
    assert_eq!(suite["plant"], Value::Null);
    let passed = suite["criteria"].as_array().expect("an array").iter().all(|criterion| criterion["passed"] == true);
    assert_eq!(suite["passed"], passed);
    assert_eq!(said.code == 0, passed, "the exit code says what the suite found");
    assert_eq!(suite["fixed_point"]["n"], 100_000);
    // A network in 8 bits is not the same, and not far: between 1e-9 and the limit of the issue.
    let apart = suite["fixed_point"]["rmse"].as_f64().expect("a number");
    assert!((1e-9..=1e-3).contains(&apart), "{apart}");
}

#[test]
fn the_suite_finds_the_plant_that_simulate_left_beside_its_recordings() {
    let bench = Bench::new();
    bench.works("simulate paper --plant all-effects --out set --tests 1");
    bench.works("identify --data set/train --out physics.toml");
    let said = bench.run("evaluate --model physics.toml --data set/test --suite --json suite.json");
    let suite = &bench.json("suite.json")["suite"];
    assert!(suite["plant"].as_str().is_some_and(|plant| plant.ends_with("plant.toml")), "{}", suite["plant"]);
    // Play operators know nothing of lag and creep.
    assert_eq!(said.code, 1, "{}", said.stdout);
    assert!(said.stdout.contains("FAIL  holds") || said.stdout.contains("FAIL  families"), "{}", said.stdout);
}

#[test]
fn a_recording_at_another_rate_is_refused_unless_it_may_be_interpolated() {
    let bench = Bench::with_models();
    let slow = recording_csv(0.5);
    let mut lines = slow.lines();
    let header = lines.next().expect("a header");
    let fast: Vec<String> = lines
        .enumerate()
        .map(|(index, line)| format!("{:.3},{}", 0.005 * index as f64, line.split_once(',').expect("three cells").1))
        .collect();
    bench.write("fast.csv", format!("{header}\n{}\n", fast.join("\n")));
    for model in ["model.safetensors", "model.blob"] {
        bench.refuses(&format!("evaluate --model {model} --data fast.csv --json out.json"), &["fast.csv", "5 ms", "20 ms", "--resample"]);
        bench.works(&format!("evaluate --model {model} --data fast.csv --resample"));
    }
    // Play operators answer to the path of the input, not to its speed.
    bench.works("evaluate --model physics.toml --data fast.csv");
}

#[test]
fn skipping_and_taring_change_what_counts_and_refuse_what_makes_no_sense() {
    let bench = Bench::with_models();
    bench.works("evaluate --model physics.toml --data exact/a1.csv --skip-s 4 --json skipped.json");
    assert_eq!(bench.json("skipped.json")["files"][0]["n"], 400);
    let shifted: String = recording_csv(0.3)
        .lines()
        .enumerate()
        .map(|(index, line)| match line.rsplit_once(',') {
            Some((front, output)) if index > 0 => format!("{front},{}\n", 5.0 + output.parse::<f64>().expect("a number")),
            _ => format!("{line}\n"),
        })
        .collect();
    bench.write("shifted.csv", shifted);
    let rmse = |bench: &Bench| bench.json("result.json")["mean_rmse"].as_f64().expect("a number");
    bench.works("evaluate --model physics.toml --data shifted.csv --json result.json");
    assert!((rmse(&bench) - 5.0).abs() < 1e-6);
    bench.works("evaluate --model physics.toml --data shifted.csv --tare --json result.json");
    assert!(rmse(&bench) < 1e-6);
    bench.refuses("evaluate --model physics.toml --data exact --skip-s 1000", &["--skip-s", "a1.csv"]);
    bench.refuses("evaluate --model physics.toml --data exact --skip-s=-1", &["--skip-s"]);
    bench.refuses("evaluate --model physics.toml --data exact --suite --plant missing.toml", &["missing.toml"]);
}
