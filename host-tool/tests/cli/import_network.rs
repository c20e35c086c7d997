//! `catheter import-network`: a foreign network becomes a model that the other commands take, or is refused and nothing is left behind.

use std::path::{Path, PathBuf};

use crate::support::Bench;

fn vectors(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/vectors/import").join(name)
}

/// A working folder with these files of `tests/vectors/import`, and their check vectors as a recording.
fn bench(name: &str, ending: &str) -> Bench {
    let bench = Bench::new();
    bench.write(&format!("network.{ending}"), std::fs::read(vectors(&format!("{name}.{ending}"))).expect("a network"));
    let check = std::fs::read_to_string(vectors(&format!("{name}.csv"))).expect("check vectors");
    bench.write("check.csv", &check);
    let rows = check.lines().skip(1).enumerate().map(|(index, row)| format!("{:.2},{row}\n", index as f64 * 0.02));
    bench.write("run.csv", "time_s,pressure_bar,displacement_mm\n".to_owned() + &rows.collect::<String>());
    bench
}

const CHANNELS: &str = "--input pressure:bar --output displacement:mm --sample-period-s 0.02";

#[test]
fn an_imported_network_is_checked_evaluated_and_exported() {
    for (name, ending, options) in [
        ("torch_single", "safetensors", String::new()),
        ("torch_double", "safetensors", format!("{CHANNELS} --streaming --features input,difference")),
        ("keras_double", "safetensors", String::new()),
        ("onnx_torch_double", "onnx", format!("{CHANNELS} --features input,difference")),
    ] {
        let bench = bench(name, ending);
        let said =
            bench.works(&format!("import-network network.{ending} {options} --check check.csv --out model.safetensors --json import.json"));
        assert!(said.stdout.contains("check passed: 160 samples"), "{}", said.stdout);
        let import = bench.json("import.json");
        assert!(import["check"]["largest_of_range"].as_f64().expect("a number") <= 1e-6, "{name}: {import}");
        assert_eq!(import["written"], true);

        bench.works("evaluate --model model.safetensors --data run.csv --json evaluated.json");
        bench.works("export model.safetensors --calibration run.csv --out model.blob --json export.json");
        let outputs = bench.read("check.csv");
        let outputs = String::from_utf8_lossy(&outputs);
        let outputs: Vec<f64> = outputs.lines().skip(1).filter_map(|row| row.split(',').nth(1)?.parse().ok()).collect();
        let range = outputs.iter().copied().fold(f64::MIN, f64::max) - outputs.iter().copied().fold(f64::MAX, f64::min);
        let worst = bench.json("export.json")["max_abs_f32_vs_fixed"].as_f64().expect("a number");
        assert!(worst <= 1e-3 * range, "{name}: the blob is {:.2e} of the range away", worst / range);
        bench.works("evaluate --model model.blob --data run.csv");
        let inspected = bench.works("inspect model.blob").stdout;
        assert!(inspected.contains("imported: ") && inspected.contains("trained elsewhere"), "{inspected}");
    }
}

#[test]
fn a_failed_check_writes_no_model_and_ends_with_1() {
    let bench = bench("torch_single", "safetensors");
    let said =
        bench.run("import-network network.safetensors --input-offset 1.4 --check check.csv --out model.safetensors --json import.json");
    assert_eq!(said.code, 1, "{}{}", said.stdout, said.stderr);
    assert!(said.stdout.contains("check failed, nothing written") && said.stdout.contains("--difference-scale"), "{}", said.stdout);
    assert!(said.stdout.contains("`catheter.input_offset` of the file is replaced"), "{}", said.stdout);
    assert!(!bench.path("model.safetensors").exists());
    assert_eq!(bench.json("import.json")["written"], false);
}

#[test]
fn a_network_without_check_vectors_is_imported_and_said_to_be_unchecked() {
    let bench = bench("keras_relu", "safetensors");
    let said = bench.works("import-network network.safetensors --out model.safetensors");
    assert!(said.stdout.contains("not checked"), "{}", said.stdout);
}

#[test]
fn minimum_and_maximum_stand_for_offset_and_scale() {
    let bench = bench("torch_single", "safetensors");
    bench.works("import-network network.safetensors --input-min-max -1,3 --output-min-max 1,9 --out one.safetensors");
    bench.works(
        "import-network network.safetensors --input-offset -1 --input-scale 4 --output-offset 1 --output-scale 8 --out other.safetensors",
    );
    assert_eq!(bench.read("one.safetensors"), bench.read("other.safetensors"));
}

#[test]
fn what_cannot_be_imported_is_refused_with_the_file_and_a_remedy() {
    let bench = bench("torch_double", "safetensors");
    bench.write("cut.safetensors", &bench.read("network.safetensors")[..300]);
    bench.write("notes.onnx", "no network");
    bench.write("words.csv", "input,output\n0.1,high\n");
    bench.write("flat.csv", "input,output\n0.1,2\n0.2,2\n");
    bench.write("other.csv", "pressure,output\n0.1,2\n0.2,3\n");
    bench.write("more.csv", "input,output,force_N\n0.1,2,1\n0.2,3,1\n");
    let line =
        |file: &str, rest: &str| format!("import-network {file} {CHANNELS} {rest} --out out/model.safetensors --json out/result.json");
    for (line, words) in [
        (line("missing.safetensors", ""), &["missing.safetensors", "check the path"][..]),
        (line("cut.safetensors", ""), &["cut.safetensors", "cut off"]),
        (line("notes.onnx", ""), &["notes.onnx", "neither a safetensors nor an ONNX"]),
        (line("network.safetensors", "--streaming"), &["network.safetensors", "--features"]),
        (
            line("network.safetensors", "--features input,difference --input-range 0,3 --output-range 0,12"),
            &["network.safetensors", "--streaming", "--window"],
        ),
        (line("network.safetensors", "--features input,temperature"), &["input,temperature", "no place in the model"]),
        (line("network.safetensors", "--features input,difference --streaming"), &["--input-range", "not known"]),
        (line("network.safetensors", "--check words.csv"), &["words.csv:2", "high"]),
        (line("network.safetensors", "--check flat.csv"), &["flat.csv", "two different"]),
        (line("network.safetensors", "--check other.csv"), &["other.csv:1", "`input` or `pressure_bar`"]),
        (line("network.safetensors", "--check more.csv"), &["more.csv:1", "force_N"]),
        (line("network.safetensors", "--check missing.csv"), &["missing.csv"]),
        (line("network.safetensors", "--activation swish"), &["swish", "fixed-point"]),
        (line("network.safetensors", "--input-range 3,0"), &["3,0", "ascending"]),
        (line("network.safetensors", "--window 0"), &["--window"]),
    ] {
        bench.refuses(&line, words);
    }
    bench.refuses(&format!("import-network network.safetensors {CHANNELS} --out network.safetensors"), &["network.safetensors"]);
}
