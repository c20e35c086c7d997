//! Standard output and error that go away, fill up, or are named as the result file.
#![cfg(unix)]

use std::process::{Command, Stdio};

use crate::support::Bench;

fn catheter(bench: &Bench, line: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_catheter"));
    command.args(line.split_whitespace()).current_dir(bench.path("")).stdin(Stdio::null()).stderr(Stdio::piped());
    command
}

/// A pipe nobody reads from.
fn closed_pipe() -> std::io::PipeWriter {
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    writer
}

#[test]
fn a_reader_that_leaves_early_is_no_error() {
    let bench = Bench::with_models();
    for line in ["completions bash", "--help", "inspect model.blob", "evaluate --model model.blob --data data --json result.json"] {
        let output = catheter(&bench, line).stdout(closed_pipe()).output().expect("the built command starts");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "`{line}`: {stderr}");
    }
    assert!(bench.json("result.json")["mean_rmse"].is_number(), "the result is written although nobody watches");
}

#[test]
fn an_error_nobody_reads_still_ends_with_2() {
    let bench = Bench::new();
    let status = catheter(&bench, "inspect missing.blob").stdout(Stdio::null()).stderr(closed_pipe()).status();
    assert_eq!(status.expect("the built command starts").code(), Some(2));
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_behind_standard_output_is_an_error() {
    let bench = Bench::with_models();
    for line in ["completions bash", "inspect model.blob"] {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").expect("the device that is always full");
        let output = catheter(&bench, line).stdout(full).output().expect("the built command starts");
        assert_eq!(output.status.code(), Some(2), "`{line}`");
        assert!(String::from_utf8_lossy(&output.stderr).contains("standard output"));
    }
}

#[test]
fn the_json_result_can_go_to_standard_error_by_its_device_name() {
    let bench = Bench::with_models();
    let output =
        catheter(&bench, "evaluate --model physics.toml --data data --json /dev/stderr").output().expect("the built command starts");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    assert!(stderr.contains("\"mean_rmse\""), "{stderr}");
}
