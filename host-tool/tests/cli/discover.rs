//! `hide`, `discover` and `plan-experiment`: the contract of the command, on sessions with a secret.

use std::fmt::Write;

use serde_json::Value;

use crate::support::Bench;

/// Seeds of these tests; tuning used those below 500, figures are reported on 1000 and above.
const SEED: u64 = 520;

/// Every third recording of the session: enough for one effect, and a third of the time. Only for seeds whose muscle begins every
/// recording fresh; one that remembers would remember recordings that are not there.
fn thinned(bench: &Bench, folder: &str) -> String {
    let mut names: Vec<_> = std::fs::read_dir(bench.path(folder))
        .expect("a folder can be listed")
        .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names.iter().step_by(3).map(|name| format!(" {folder}/{name}")).collect()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

#[test]
fn a_hidden_delay_is_named_with_every_key_of_the_contract_and_the_model_runs() {
    let bench = Bench::new();
    bench.works(&format!("hide --effect dead-time --seed {SEED} --out case"));
    let data = thinned(&bench, "case/recordings");
    bench.works(&format!("discover --data{data} --holdout case/holdout --out found --json result.json --seed 3"));
    let result = bench.json("result.json");
    for key in [
        "verdict",
        "effects",
        "runner_up",
        "rmse_before",
        "rmse_after",
        "noise_floor",
        "gap_closed",
        "candidates",
        "where",
        "excluded_samples",
    ] {
        assert!(result.get(key).is_some(), "the key `{key}` is missing from {result}");
    }
    assert_eq!(result["verdict"], "named", "{result}");
    let effect = &result["effects"][0];
    assert_eq!(effect["name"], "dead-time");
    assert!((0.0..=1.0).contains(&number(&effect["confidence"])));
    let delay_s = number(&effect["parameters"]["delay_s"]);
    let truth_s = number(&bench.json("case/truth.sealed.json")["parameters"]["dead-time.delay_s"]);
    assert!((delay_s / truth_s - 1.0).abs() < 0.05, "{delay_s} s instead of {truth_s} s");
    assert!(result["runner_up"]["name"].is_string() && result["runner_up"]["separable"].is_boolean(), "{result}");
    for candidate in result["candidates"].as_array().expect("an array") {
        assert!(candidate["name"].is_string() && number(&candidate["score"]) <= 1.0);
        assert!((0.0..=1.0).contains(&number(&candidate["p_value"])));
    }
    let places = result["where"].as_array().expect("an array");
    assert!(!places.is_empty(), "a delay is largest where the input is fast");
    for place in places {
        assert!(place["axis"].is_string() && place["region"].is_string());
        assert!((0.0..=1.0).contains(&number(&place["share"])) && (0.0..=0.05).contains(&number(&place["p_value"])));
    }
    // A delay makes mistakes where the input moves fast: the sentence has to say so.
    assert!(places.iter().any(|place| place["axis"] == "rate"), "{places:?}");
    // The figures after are those of the model in the folder on the recordings that were kept out, whoever computes them.
    bench.works("evaluate --model found/model.toml --data case/holdout --json errors.json");
    let rmse = number(&bench.json("errors.json")["pooled_rmse"]);
    assert!((rmse / number(&result["rmse_after"]) - 1.0).abs() < 1e-9, "{rmse} instead of {}", result["rmse_after"]);
    assert!(result.get("calibrate_s").is_none(), "a delay reads nothing from a recording: {result}");
    assert!(number(&result["gap_closed"]) > 0.9, "{result}");
    assert!(number(&result["rmse_before"]) > number(&result["rmse_after"]));
    let report = String::from_utf8(bench.read("found/report.html")).expect("text");
    assert!(report.contains("dead-time") && report.contains("</html>"));

    // The microcontroller knows a dead time: the same model as a blob.
    bench.works("export found/microcontroller.toml --calibration case/holdout --out model.blob");

    // The two explanations, and the experiment that tells them apart, as a file that can be played.
    bench.works(
        "plan-experiment --models found/model.toml found/runner_up.toml --maximum-slew-bar-per-s 12 --out next.toml --json plan.json",
    );
    let plans = bench.json("plan.json");
    let plans = plans["plans"].as_array().expect("an array");
    assert!(plans.len() >= 6, "{plans:?}");
    let differences: Vec<f64> = plans.iter().map(|plan| number(&plan["difference"])).collect();
    assert!(differences.windows(2).all(|pair| pair[0] >= pair[1]), "{differences:?}");
    assert!(differences[0] > 0.0);
    bench.works("simulate next.toml --maximum-slew-bar-per-s 12 --out played");

    // Starting from the model that was found, nothing of it is found again.
    bench.works(&format!("discover --model found/model.toml --data{data} --holdout case/holdout --out again --json again.json"));
    let again = bench.json("again.json");
    assert_eq!(again["verdict"], "none", "{again}");
    assert!((number(&again["rmse_before"]) / rmse - 1.0).abs() < 0.02, "{again}");
}

#[test]
fn a_discovered_resonance_runs_in_the_blob_and_two_of_them_are_refused() {
    let bench = Bench::new();
    bench.works(&format!("hide --effect resonance --seed {SEED} --out case"));
    let data = thinned(&bench, "case/recordings");
    bench.works(&format!("discover --data{data} --holdout case/holdout --out found --json result.json --seed 3"));
    let result = bench.json("result.json");
    assert_eq!(result["effects"][0]["name"], "resonance", "{result}");
    for (model, out) in [("model", "one"), ("microcontroller", "two")] {
        bench.works(&format!("export found/{model}.toml --calibration case/holdout --out {out}.blob --c {out}.c"));
        bench.works(&format!("evaluate --model {out}.blob --data case/holdout --json {out}.json"));
        let rmse = number(&bench.json(&format!("{out}.json"))["pooled_rmse"]);
        let (before, after) = (number(&result["rmse_before"]), number(&result["rmse_after"]));
        assert!(rmse < after + 0.05 * (before - after), "{model}: {rmse} where the model has {after}, and {before} without it");
    }
    // What the file for the microcontroller claims is what it does on the recordings that it names.
    bench.works(&format!("evaluate --model found/microcontroller.toml --data{data} --json claimed.json"));
    let text = String::from_utf8(bench.read("found/microcontroller.toml")).expect("text");
    let claimed = text.lines().find_map(|line| line.strip_prefix("rmse = ")).expect("an error").parse::<f64>().expect("a number");
    assert!((number(&bench.json("claimed.json")["pooled_rmse"]) / claimed - 1.0).abs() < 1e-6, "{claimed} is claimed");

    let text = String::from_utf8(bench.read("found/model.toml")).expect("text");
    let from = text.find("[[effects]]").expect("an effect");
    let length = text[from + 1..].find("\n[[").map_or(text.len() - from, |end| end + 2);
    bench.write("twice.toml", format!("{text}\n{}", &text[from..from + length]));
    bench.refuses("export twice.toml --calibration case/holdout --out twice.blob", &["twice.toml", "resonance", "another effect"]);
}

#[test]
fn without_a_holdout_some_recordings_are_kept_out_and_named_and_equal_seeds_agree() {
    let bench = Bench::new();
    bench.works(&format!("hide --seed {SEED} --out case"));
    let data = thinned(&bench, "case/recordings");
    for name in ["one", "two"] {
        bench.works(&format!("discover --data{data} --out {name} --seed 4 --threads 2"));
    }
    assert!(bench.read("one/discovery.json") == bench.read("two/discovery.json"));
    assert!(bench.read("one/model.toml") == bench.read("two/model.toml"));
    let result = bench.json("one/discovery.json");
    assert_eq!(result["verdict"], "none", "{result}");
    assert_eq!(result["effects"].as_array().map(Vec::len), Some(0));
    let kept = result["kept_out"].as_array().expect("an array");
    assert!(!kept.is_empty());
    for name in kept {
        let name = name.as_str().expect("a name");
        assert!(bench.path("case/recordings").join(name).exists(), "{name} is no recording of the session");
    }
}

#[test]
fn of_one_file_blocks_are_kept_out_and_the_report_says_so_instead_of_naming_the_file() {
    let bench = Bench::new();
    bench.works(&format!("hide --seed {SEED} --out case"));
    let one = std::fs::read_dir(bench.path("case/recordings")).expect("a folder").flatten().next().expect("a recording").file_name();
    let one = one.to_string_lossy().into_owned();
    bench.works(&format!("discover --data case/recordings/{one} --out found --threads 2"));
    let page = String::from_utf8(bench.read("found/report.html")).expect("text");
    assert!(page.contains("blocks of them were left out instead"), "{one}");
    let kept = &bench.json("found/discovery.json")["kept_out"];
    let names: Vec<&str> = kept.as_array().expect("an array").iter().filter_map(|name| name.as_str()).collect();
    assert!(!names.is_empty() && names.iter().all(|name| *name != one), "{names:?} are no recordings that were left out whole");
}

#[test]
fn foreign_columns_other_units_and_a_session_clock_are_understood() {
    let bench = Bench::new();
    bench.works(&format!("hide --effect offset-drift --seed {} --out case", SEED + 3));
    let mut data = String::new();
    for (index, path) in thinned(&bench, "case/recordings").split_whitespace().enumerate() {
        let text = String::from_utf8(bench.read(path)).expect("text");
        let header: Vec<&str> = text.lines().next().expect("a header").split(',').collect();
        let column = |name: &str| header.iter().position(|found| *found == name).unwrap_or_else(|| panic!("no {name} in {header:?}"));
        let (time, input, output, session) =
            (column("time_s"), column("pressure_bar"), column("displacement_mm"), column("session_time_s"));
        let mut foreign = "t_s,voltage_V,displacement_um,session_time_s\n".to_owned();
        for line in text.lines().skip(1) {
            let cells: Vec<&str> = line.split(',').collect();
            let micrometres = cells[output].parse::<f64>().expect("a number") * 1000.0;
            writeln!(foreign, "{},{},{micrometres},{}", cells[time], cells[input], cells[session]).expect("a string");
        }
        // Names in the reverse of the order in time: only the session's clock tells.
        let name = format!("foreign/run{:02}.csv", 50 - index);
        bench.write(&name, foreign);
        write!(data, " {name}").expect("a string");
    }
    bench.works(&format!("discover --data{data} --columns time=t_s,input=voltage_V,output=displacement_um --out found --json result.json"));
    let result = bench.json("result.json");
    assert_eq!(result["effects"][0]["name"], "offset-drift", "{result}");
    let told = result["effects"][0]["parameters"].as_object().expect("an object");
    assert!(told.keys().any(|key| key.ends_with("_um")), "{told:?}");
}

#[test]
fn bad_input_ends_with_2_and_leaves_nothing() {
    let bench = Bench::new();
    bench.refuses("discover --data nowhere --out found", &["nowhere"]);
    bench.refuses("hide --effect magnetism --out case", &["magnetism", "creep"]);
    bench.refuses("hide --noise 3 --out case", &["--noise"]);
    let rows: String = (0..300).map(|row| format!("{},{},{}\n", f64::from(row) * 0.02, row % 7, row % 5)).collect();
    bench.write("short.csv", format!("time_s,pressure_bar,displacement_mm\n{rows}"));
    bench.refuses("discover --data short.csv --out found", &["400"]);
    let still: String = (0..900).map(|row| format!("{},1.0,{}\n", f64::from(row) * 0.02, row % 5)).collect();
    bench.write("still.csv", format!("time_s,pressure_bar,displacement_mm\n{still}"));
    bench.refuses("discover --data still.csv --out found", &["input is the same everywhere"]);
    bench.write("model.toml", "kind = \"discovered\"\n");
    bench.refuses("plan-experiment --models model.toml model.toml --out next.toml", &["model.toml"]);
}
