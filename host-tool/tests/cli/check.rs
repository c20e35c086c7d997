//! `catheter check`: what it finds in recordings as loggers leave them.

use std::fmt::Write;

use serde_json::Value;

use crate::support::{Bench, recording_csv};

fn subjects(recording: &Value) -> Vec<&str> {
    recording["notes"].as_array().expect("notes").iter().map(|note| note["subject"].as_str().expect("a word")).collect()
}

#[test]
fn clean_recordings_are_said_to_be_clean_in_words_numbers_and_pictures() {
    let bench = Bench::new();
    for (name, frequency_hz) in [("a1", 0.3), ("a2", 0.5), ("a3", 0.3)] {
        bench.write(&format!("data/{name}.csv"), recording_csv(frequency_hz));
    }
    let said = bench.works("check --data data --json check.json --html check.html").stdout;
    for words in ["steps of 20 ms", "The clock is even", "repeatability", "each is left out in turn"] {
        assert!(said.contains(words), "no `{words}` in:\n{said}");
    }
    let check = bench.json("check.json");
    assert_eq!(check["recordings"].as_array().expect("a list").len(), 3);
    let first = &check["recordings"][0];
    assert_eq!((first["samples"].as_u64(), first["clock"]["gaps"].as_u64(), subjects(first).len()), (Some(600), Some(0), 0), "{first}");
    assert_eq!(check["common_period_s"], 0.02);
    // Two of them are the same recording.
    let repeated = check["repeatability"]["repeatability"].as_f64().expect("they repeat");
    assert!(repeated < 0.01, "{repeated}");
    let page = String::from_utf8(bench.read("check.html")).expect("HTML is text");
    assert!(page.starts_with("<!DOCTYPE html>") && page.matches("<svg").count() == 6 && !page.contains("NaN"));
}

#[test]
fn a_messy_file_is_read_and_every_repair_is_told() {
    let bench = Bench::new();
    let mut text = "# a rig\nlogged by hand\ntime(ms) cmd(V) laser(um)\n".to_owned();
    for row in 0..3000_u32 {
        let jitter = f64::from(row * 7 % 3) - 1.0;
        let glitch = if row == 700 { 1000.0 } else { 0.0 };
        // A command that is refreshed every 100 ms; the zero of the laser steps at 18 s.
        let held = f64::from(row / 10);
        let command = (held * 0.21).sin() + 0.3 * (held * 0.13).cos();
        let laser = 20.0 * command + if row < 1800 { 0.0 } else { 9.0 };
        writeln!(text, "{} {command:.6} {laser:.4}", f64::from(row) * 10.0 + jitter + glitch).expect("writing to a string");
    }
    bench.write("run.dat", text);
    let said = bench.works("check --data run.dat --columns time=time(ms),input=cmd(V),output=laser:um --json check.json").stdout;
    for words in [
        "separated by spaces",
        "1 title line(s)",
        "1 time stamp(s) that jumped away and back",
        "First at line 704",
        "every 0.1 s",
        "output steps by +",
    ] {
        assert!(said.contains(words), "no `{words}` in:\n{said}");
    }
    let recording = &bench.json("check.json")["recordings"][0];
    assert_eq!(
        subjects(recording),
        ["layout", "layout", "converted", "converted", "clock-repaired", "sample-and-hold", "step"],
        "{recording}"
    );
    assert_eq!(recording["clock"]["gaps"], 0);
    assert!(recording["channels"][0]["hold"]["period_s"].as_f64().is_some_and(|period_s| (period_s - 0.1).abs() < 0.002));
}

#[test]
fn the_measured_cylinders_jitter_is_no_gap_and_its_missing_quarter_second_is_one() {
    let bench = Bench::new();
    let fixture = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/fixtures/pneumatic-cylinder-friction/X-ring257_3bar.csv");
    bench.works(&format!("check --data {fixture} --columns time=t_s,input=position_mm,output=force_N --json check.json"));
    let recording = &bench.json("check.json")["recordings"][0];
    let gaps: Vec<&Value> = recording["notes"].as_array().expect("notes").iter().filter(|note| note["subject"] == "gap").collect();
    assert_eq!(gaps.len(), 1);
    assert_eq!((gaps[0]["count"].as_u64(), gaps[0]["line"].as_u64()), (Some(2), Some(14)), "{recording}");
}

#[test]
fn a_file_without_a_clock_needs_a_rate_and_a_column_sets_recordings_apart() {
    let bench = Bench::new();
    let mut text = "run,p,q\n".to_owned();
    for row in 0..400_u32 {
        writeln!(text, "{},{},{}", row / 100, row % 100, row % 50).expect("writing to a string");
    }
    bench.write("runs.csv", text);
    let columns = "--columns input=p:bar,output=q:rad,recording=run";
    bench.works(&format!("check --data runs.csv {columns} --rate-hz 100 --json check.json"));
    let check = bench.json("check.json");
    assert_eq!(check["recordings"].as_array().expect("a list").len(), 4);
    assert!(check["recordings"][1]["path"].as_str().is_some_and(|path| path.ends_with("runs.csv#1")));
    bench.refuses(&format!("check --data runs.csv {columns}"), &["--rate-hz"]);
    bench.refuses(&format!("check --data runs.csv {columns} --rate-hz 0"), &["--rate-hz", "above zero"]);
    bench.refuses(&format!("check --data runs.csv {columns} --rate-hz 100 --json runs.csv"), &["runs.csv", "overwritten"]);
}
