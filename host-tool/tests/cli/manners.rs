//! The manners that all commands share: what they say, what they replace, which pages they leave.

use crate::support::Bench;

/// A command that computes something, and the ending of what it writes with `--out`, if anything.
const COMPUTING: [(&str, &str); 8] = [
    ("identify --data data --out FILE", "toml"),
    ("train --preset stream-1x32 --epochs 1 --data data --out FILE", "safetensors"),
    ("export model.safetensors --calibration data --out FILE", "blob"),
    ("evaluate --model physics.toml --data data", ""),
    ("check --data data", ""),
    ("inspect model.blob", ""),
    ("inspect physics.toml", ""),
    ("explain E001", ""),
];

#[test]
fn every_computing_command_leaves_a_page_and_replaces_nothing_without_force() {
    let bench = Bench::careful_with_models();
    for (number, (line, ending)) in COMPUTING.into_iter().enumerate() {
        let line = line.replace("FILE", &format!("result-{number}.{ending}"));
        bench.works(&format!("{line} --html page-{number}.html"));
        let page = String::from_utf8(bench.read(&format!("page-{number}.html"))).expect("text");
        assert!(page.starts_with("<!DOCTYPE html>") && page.ends_with("</html>\n"), "{line}");
        let command = line.split(' ').next().expect("a command");
        assert!(page.contains(&format!("made by catheter {}: catheter {command}", env!("CARGO_PKG_VERSION"))), "{line}");
        // The result is not replaced, nor the page, nor a JSON result; and before any work.
        if !ending.is_empty() {
            bench.refuses(&line, &[&format!("result-{number}.{ending}"), "exists already", "--force"]);
        }
        let other = line.replace("result-", "other-");
        bench.refuses(&format!("{other} --html page-{number}.html"), &["exists already", "--force"]);
        bench.write("kept.json", "{}");
        bench.refuses(&format!("{other} --json kept.json"), &["kept.json", "exists already"]);
        // The name that the option had before means the same.
        bench.works(&format!("{line} --report page-{number}.html --force"));
    }
}

#[test]
fn report_folders_number_themselves_and_force_takes_the_folder_itself() {
    let bench = Bench::careful_with_models();
    bench.works("fit --no-networks --data exact --out result --html fit.html");
    assert!(bench.read("fit.html") == bench.read("result/report.html"));
    let first = bench.read("result/model");
    let said = bench.works("fit --no-networks --data exact --out result --seed 2");
    assert!(said.stdout.contains("result-2/report.html"), "{}", said.stdout);
    assert!(bench.read("result/model") == first, "the first is as it was");
    assert!(!bench.read("result-2/model").is_empty());
    let said = bench.works("fit --no-networks --data exact --out result --force");
    assert!(said.stdout.contains("result/report.html") && !bench.path("result-3").exists(), "{}", said.stdout);
    bench.works("hide --effect creep --seed 7 --out case");
    bench.works("hide --effect creep --seed 8 --out case");
    assert!(bench.path("case-2/truth.sealed.json").is_file());
    bench.works("simulate paper --out set --tests 1");
    bench.refuses("simulate paper --out set --tests 1 --seed 2", &["set/train", "exists already", "--force"]);
}

#[test]
fn quiet_says_nothing_but_what_failed_and_verbose_what_is_read_and_written() {
    let bench = Bench::with_models();
    for line in [
        "evaluate --model model.blob --data data --json e.json",
        "identify --data data --out q.toml",
        "inspect model.blob",
        "check --data data",
    ] {
        for quiet in ["--quiet", "-q"] {
            let said = bench.works(&format!("{line} {quiet}"));
            assert_eq!((said.stdout.as_str(), said.stderr.as_str()), ("", ""), "{line}");
        }
        let said = bench.works(&format!("{line} -v"));
        assert!(said.stderr.contains("read data/a1.csv") || line.starts_with("inspect"), "{line}: {}", said.stderr);
        assert!(said.stdout.lines().count() > 1, "{line}");
    }
    assert_eq!(bench.json("e.json")["files"].as_array().map(Vec::len), Some(4));
    // Errors are said all the same, and both at once make no sense.
    let refused = bench.refuses("evaluate --model nowhere.toml --data data -q", &["nowhere.toml"]);
    assert_eq!(refused.stdout, "");
    bench.refuses("check --data data -q -v", &["--quiet", "--verbose"]);
}

#[test]
fn every_command_has_a_page_in_the_manual() {
    let bench = Bench::new();
    bench.works("man manual");
    for (page, words) in [
        ("catheter", &["identify", "quiet"][..]),
        ("catheter-identify", &["thresholds", "html"]),
        ("catheter-rig", &["backend"]),
        ("catheter-rig-record", &["excitation"]),
        ("catheter-rig-settings-set", &["NAME"]),
    ] {
        let text = String::from_utf8(bench.read(&format!("manual/{page}.1"))).expect("text");
        assert!(text.contains(".TH ") && text.contains(".SH NAME"), "{page}");
        assert!(words.iter().all(|word| text.contains(word)), "{page} lacks one of {words:?}");
    }
    let pages = std::fs::read_dir(bench.path("manual")).expect("a folder").count();
    let help = bench.works("--help").stdout;
    assert!(pages > 30, "{pages} pages");
    assert!(help.contains("  man ") && help.contains("--quiet") && help.contains("--verbose") && help.contains("--force"), "{help}");
}

#[test]
fn an_interrupted_training_is_kept_until_somebody_says_what_to_do_with_it() {
    let bench = Bench::careful_with_models();
    let line = "train --preset stream-1x32 --epochs 2 --data data --out new.safetensors --threads 1";
    let said = bench.works(&format!("{line} --stop-after-steps 2"));
    assert!(said.stdout.contains("--resume"), "{}", said.stdout);
    bench.refuses(line, &["new.checkpoint", "--resume", "--force"]);
    bench.works(&format!("{line} --resume"));
    let resumed = bench.read("new.safetensors");
    bench.works(&line.replace("new.", "whole."));
    assert!(bench.read("whole.safetensors") == resumed, "resumed, it comes out the same");
}

#[test]
fn inspect_takes_every_kind_of_model() {
    let bench = Bench::with_models();
    for (model, words) in [
        ("physics.toml", &["Prandtl-Ishlinskii", "pressure in bar", "parameters"][..]),
        ("model.safetensors", &["hybrid", "sample period 0.02", "multiplications"]),
        ("model.blob", &["golden vectors  passed", "RAM"]),
    ] {
        let said = bench.works(&format!("inspect {model} --json {model}.json"));
        assert!(words.iter().all(|word| said.stdout.contains(word)), "{model}: {}", said.stdout);
        assert!(bench.json(&format!("{model}.json")).is_object());
    }
    for (fixture, word) in [("discovered.toml", "creep"), ("fitted.toml", "first look")] {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/files").join(fixture);
        bench.write(fixture, std::fs::read(path).expect("a model"));
        let said = bench.works(&format!("inspect {fixture} --json {fixture}.json"));
        assert!(said.stdout.contains(word), "{fixture}: {}", said.stdout);
        assert_eq!(bench.json(&format!("{fixture}.json"))["output"]["unit"], "mm");
    }
}

#[test]
fn a_model_whose_numbers_are_not_finite_is_refused_and_no_nan_is_written() {
    let bench = Bench::with_models();
    let text = String::from_utf8(bench.read("physics.toml")).expect("text");
    let weights = text.lines().find(|line| line.starts_with("weights = [")).expect("weights");
    let count = weights.split(',').count();
    let huge = format!("weights = [{}]", vec!["1e308"; count].join(", "));
    bench.write("huge.toml", text.replace(weights, &huge));
    bench.refuses("evaluate --model huge.toml --data data --json out.json", &["huge.toml", "no sensor gives"]);
    bench.write("nan.toml", text.replace(weights, &huge.replace("1e308", "nan")));
    bench.refuses("evaluate --model nan.toml --data data --json out.json", &["nan.toml", "not finite"]);
}

const EXCITATION: &str = "sample_period_s = 0.02\nnoise_bar = 0.0\nseed = 1\n[[segments]]\nduration_s = 1.0\nsignal = { kind = \"descending-sine\", \
                          amplitude_bar = 0.2, frequency_hz = 1.0, decay_per_s = 0.1 }\n";

#[test]
fn a_run_on_a_rig_and_what_is_told_of_it_replace_nothing_without_force() {
    let bench = Bench::careful();
    bench.write("play.toml", EXCITATION);
    bench.works("rig record --excitation play.toml --out run.csv --json run.json");
    assert_eq!(bench.json("run.json")["provenance"]["version"], env!("CARGO_PKG_VERSION"));
    bench.refuses("rig record --excitation play.toml --out run.csv", &["run.csv", "exists already"]);
    // What would lie beside the recording belongs to another one.
    bench.write("other.journal", bench.read("run.journal"));
    bench.refuses("rig record --excitation play.toml --out other.csv", &["other.journal", "exists already"]);
    bench.works("replay run.csv --html replay.html --json replay.json");
    let page = String::from_utf8(bench.read("replay.html")).expect("text");
    assert!(page.contains("run again") && page.contains("identical"), "{page:.400}");
    bench.refuses("replay run.csv --html replay.html", &["replay.html", "exists already"]);
    // What an option names by its folder is looked at one by one, before any work.
    bench.write("runs/pid.csv", "kept");
    for option in ["--csv", "--journals"] {
        let file = if option == "--csv" { "runs/pid.csv" } else { "runs/pid.journal" };
        bench.write(file, "kept");
        bench.refuses(&format!("track --reference a --controllers open-loop,pid {option} runs"), &[file, "exists already", "--force"]);
    }
    bench.write("runs/control.blob", "kept");
    bench.refuses("track --reference a --controllers pid --keep runs", &["runs/control.blob", "exists already"]);
    let models = Bench::careful_with_models();
    models.write("model.h", "kept");
    models.refuses("export model.blob --c model.c", &["model.h", "exists already"]);
}
