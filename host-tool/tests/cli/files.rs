//! Files in other formats, the lab's own file, provenance, and files that must not be lost or believed.

use crate::support::{Bench, recording_csv};

#[test]
fn a_recording_goes_through_every_format_and_comes_back_to_the_byte() {
    let bench = Bench::careful();
    bench.write("run.csv", recording_csv(0.5));
    let mut from = "run.csv".to_owned();
    for ending in ["npz", "mat", "mcap", "csv.gz"] {
        bench.works(&format!("convert {from} --out run.{ending}"));
        from = format!("run.{ending}");
    }
    bench.works(&format!("convert {from} --out back.csv"));
    let text = |name: &str| {
        let text = String::from_utf8(bench.read(name)).expect("text");
        text.lines().filter(|line| !line.starts_with('#')).map(str::to_owned).collect::<Vec<_>>()
    };
    bench.works("convert run.csv --out plain.csv");
    assert_eq!(text("back.csv"), text("plain.csv"));
    let first = String::from_utf8(bench.read("back.csv")).expect("text");
    assert!(
        first.starts_with("# made by catheter") && first.contains("convert run.csv.gz --out back.csv; run.csv.gz sha256 "),
        "{first:.200}"
    );
    bench.refuses("convert run.csv --out back.csv", &["exists already", "--force"]);
    bench.refuses("convert run.csv --out run.csv --force", &["is read by this command"]);
    bench.works("convert run.csv --out back.csv --force");
}

#[test]
fn the_labs_file_is_taken_and_the_command_line_comes_first() {
    let bench = Bench::careful();
    let lab = recording_csv(0.5).replacen("time_s,pressure_bar,displacement_mm", "t,P,x", 1);
    bench.write("runs/run.csv", &lab);
    bench.refuses("check --data runs", &["there is no column"]);
    bench.works("init --recordings runs --columns time=t:s,input=P:bar,output=x:mm --maximum-pressure-bar 0.001");
    let said = bench.works("check --json check.json");
    assert!(said.stdout.contains("above the lab's 0.001 bar"), "{}", said.stdout);
    let check = bench.json("check.json");
    assert_eq!(check["recordings"][0]["channels"][0]["quantity"], "P");
    assert_eq!(check["provenance"]["seed"], 1);
    let inputs = check["provenance"]["inputs_sha256"].as_object().expect("hashes");
    assert!(inputs.len() == 1 && inputs.values().all(|hash| hash.as_str().is_some_and(|hash| hash.len() == 64)), "{inputs:?}");
    bench.refuses("check --columns time=t:s,input=Q:bar,output=x:mm", &["there is no column `Q`"]);
    bench.refuses("init --rate-hz 10", &["exists already", "--force"]);
    bench.write("catheter.toml", "[recordings]\ncolour = 3\n");
    bench.refuses("check --data runs", &["catheter.toml", "colour"]);
}

#[test]
fn the_labs_rig_is_taken_where_nothing_else_is_said() {
    let bench = Bench::careful();
    bench.works("init --backend serial:nowhere");
    bench.refuses("rig status", &["nowhere"]);
    bench.refuses("track --reference a --controllers pid", &["a board needs --settings"]);
    bench.works("rig --backend virtual status");
    bench.refuses("init --backend serail:x --force", &["rig.backend"]);
    // A file that is wrong makes no simulated rig of a real one.
    bench.write("catheter.toml", "[rig]\nbackend = \"serail:x\"\n");
    bench.refuses("rig status", &["catheter.toml", "rig.backend"]);
    bench.works("explain E001");
}

#[test]
fn names_that_a_terminal_would_obey_are_shown() {
    let bench = Bench::new();
    bench.write("run.csv", recording_csv(0.5).replacen("pressure_bar", "\u{1b}]0;owned\u{7}_bar", 1));
    let said = bench.run("check --data run.csv");
    assert_eq!(said.code, 2);
    assert!(!said.stderr.contains('\u{1b}') && said.stderr.contains("\\u{1b}]0;owned"), "{}", said.stderr);
}

#[test]
fn outputs_that_no_sensor_gives_are_refused_before_a_model_of_nothing_is_written() {
    let bench = Bench::new();
    let huge: String = recording_csv(0.5)
        .lines()
        .enumerate()
        .map(|(line, row)| if line == 0 { format!("{row}\n") } else { format!("{row}e160\n") })
        .collect();
    bench.write("run.csv", huge);
    bench.refuses("identify --data run.csv --out pi.toml", &["run.csv:", "no sensor gives"]);
}

#[test]
fn a_model_does_not_replace_a_recording() {
    let bench = Bench::new();
    bench.write("run.csv", recording_csv(0.5));
    bench.write("other.csv", recording_csv(0.5));
    bench.refuses("check --data run.csv --json other.csv", &["is a recording"]);
}
