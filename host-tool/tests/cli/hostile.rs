//! Inputs of somebody who means no good, or who is in a hurry: each ends in a result or a clear refusal, at once and in little memory.

use crate::support::{Bench, recording_csv};

/// Every place where a command reads a file that is no recording.
#[cfg(unix)]
const READERS: [&str; 18] = [
    "evaluate --model FILE --data data",
    "inspect FILE",
    "export FILE --calibration data --out x.blob",
    "export model.safetensors --calibration data --compensation FILE --out x.blob",
    "replay FILE",
    "pil --blob FILE",
    "import-network FILE --out x.safetensors",
    "simulate FILE --out x",
    "simulate paper --plant FILE --out x",
    "plan-experiment --models FILE FILE --out x.toml",
    "discover --model FILE --data data --out x",
    "track --reference a --reach-mm 3,8 --controllers pid --settings FILE --model model.blob",
    "track --reference a --controllers learned-inverse --inverse-model FILE",
    "rig --flash FILE hello",
    "rig --hardware FILE hello",
    "rig settings import FILE",
    "rig model upload FILE",
    "rig --backend serial:nowhere firmware update FILE",
];

#[test]
#[cfg(unix)]
fn no_command_waits_for_a_pipe_or_reads_a_device_without_end() {
    let bench = Bench::with_models();
    assert!(std::process::Command::new("mkfifo").arg(bench.path("pipe")).status().expect("mkfifo").success());
    for line in READERS {
        for file in ["pipe", "/dev/zero"] {
            let said = bench.run_within(&line.replace("FILE", file), 20);
            assert_eq!(said.code, 2, "`{line}`, {file}: {}\n{}", said.stderr, said.stdout);
            assert!(said.stderr.contains("a pipe or a device"), "`{line}`, {file}: {}", said.stderr);
            assert!(said.stderr.matches("a pipe or a device").count() == 1, "`{line}`, {file}, says it twice: {}", said.stderr);
        }
    }
}

#[test]
fn microseconds_taken_for_seconds_are_told_and_tuning_does_not_ask_for_all_memory() {
    let bench = Bench::new();
    let scaled: String = recording_csv(0.5)
        .lines()
        .enumerate()
        .map(|(line, row)| match row.split_once(',') {
            Some((time, rest)) if line > 0 => format!("{}e6,{rest}\n", time),
            _ => format!("{row}\n"),
        })
        .collect();
    bench.write("run.csv", scaled);
    let said = bench.works("check --data run.csv");
    assert!(said.stdout.contains("Is the time in ms or us?"), "{}", said.stdout);
    bench.refuses("tune --data run.csv --out tuned", &["run.csv", "20000 s", "1000 at most"]);
}

#[test]
fn hardware_that_cannot_be_is_refused_by_the_name_of_the_number() {
    let bench = Bench::new();
    bench.write("fine.toml", "supply_bar = 2.5\nregulator_ms = 20.0\n[laser]\nzero = 0.4\n");
    bench.works("rig --hardware fine.toml status");
    for (text, name) in [
        ("supply_bar = nan", "supply_bar"),
        ("regulator_ms = 0.0", "regulator_ms"),
        ("tip_ms = -5.0", "tip_ms"),
        ("rest_mm = inf", "rest_mm"),
        ("[laser]\ngain = nan", "laser.gain"),
    ] {
        bench.write("hardware.toml", text);
        bench.refuses("rig --hardware hardware.toml status", &["hardware.toml", name, "is wanted"]);
    }
}
