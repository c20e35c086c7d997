//! Measures the flashable image on the model of its chip: closed loop, registers, faults. `cargo xtask bench board-model` runs this.
//!
//! Arguments: `--json FILE` writes the figures there; `--seconds N` is how long the closed loop runs at least (600).

use std::process::ExitCode;

use host_tool::track::compare::tune_virtual_rig;
use host_tool::track::{CONTROLLERS, reference, rig_settings};
use rig_tests::board_faults::{ROWS, measure_all};
use rig_tests::board_model::{followed, image, image_sha256};
use serde_json::json;

const SEED: u64 = 1;

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let (mut json_path, mut seconds) = (None, 600.0);
    while let Some(argument) = arguments.next() {
        match (argument.as_str(), arguments.next()) {
            ("--json", Some(path)) => json_path = Some(path),
            ("--seconds", Some(text)) => seconds = text.parse().unwrap_or(seconds),
            _ => {
                eprintln!("error: {argument}: only `--json FILE` and `--seconds N` are understood");
                return ExitCode::FAILURE;
            }
        }
    }
    let (virtual_s, wall_s, unmodelled, bit_equal) = closed_loop(seconds);
    println!("\n| fault | outputs safe after, ms | peak, bar | device says | as expected |\n| --- | --- | --- | --- | --- |");
    let mut faults = Vec::new();
    let rows: Vec<_> = ROWS.iter().collect();
    for (row, measured) in rows.iter().zip(measure_all(&rows, |_, _| ())) {
        let after = measured.detected_ms.map_or_else(|| "-".to_owned(), |ms| ms.to_string());
        let verdict = if measured.ok { "yes".to_owned() } else { format!("no: {}", measured.remark) };
        println!("| {} | {after} | {:.2} | E{:03} | {verdict} |", row.name, measured.peak_bar, measured.fault);
        faults.push(json!({
            "name": row.name, "detected_ms": measured.detected_ms, "peak_bar": measured.peak_bar, "ok": measured.ok,
        }));
    }
    let figures = json!({
        "image_sha256": image_sha256(&image()),
        "virtual_s": virtual_s,
        "wall_s": wall_s,
        "unmodelled_registers": unmodelled.len(),
        "bit_equal": bit_equal,
        "faults": faults,
    });
    if let Some(path) = json_path {
        let text = serde_json::to_string_pretty(&figures).unwrap_or_default() + "\n";
        if let Err(error) = std::fs::write(&path, text) {
            eprintln!("error: {path}: {error}");
            return ExitCode::FAILURE;
        }
    }
    ExitCode::SUCCESS
}

/// Every controller in turn, each on a fresh realistic rig, until the time is over.
fn closed_loop(seconds: f64) -> (f64, f64, Vec<String>, bool) {
    let tuned = match tune_virtual_rig(SEED, SEED) {
        Ok((tuned, _)) => tuned,
        Err(error) => panic!("the controllers cannot be tuned: {error}"),
    };
    let (mut virtual_s, mut wall_s, mut unmodelled, mut bit_equal) = (0.0, 0.0, Vec::new(), true);
    // An inverse model of its own is what the learned inverse would need.
    let controllers: Vec<_> = CONTROLLERS.iter().filter(|controller| controller.name != "learned-inverse").collect();
    println!("| controller | virtual, s | on the wall, s | ticks | to the bit | RMSE, mm |\n| --- | --- | --- | --- | --- | --- |");
    let names = ["point-to-point", "steps", "a", "hand"];
    for round in 0.. {
        for controller in &controllers {
            if virtual_s >= seconds {
                return (virtual_s, wall_s, unmodelled, bit_equal);
            }
            let reference = reference::named(names[round % names.len()], tuned.reach, SEED).expect("a reference");
            let mut settings = rig_settings();
            settings.extend(tuned.settings(**controller));
            let (slice, run) = followed(&settings, &tuned.blob, **controller, &reference, SEED + round as u64);
            println!(
                "| {}, {} | {:.1} | {:.1} | {} | {} | {:.3} |",
                controller.name, reference.name, slice.virtual_s, slice.wall_s, slice.ticks, slice.bit_equal, run.figures.rmse_mm
            );
            virtual_s += slice.virtual_s;
            wall_s += slice.wall_s;
            unmodelled.extend(slice.unmodelled);
            bit_equal &= slice.bit_equal;
        }
    }
    unreachable!("the rounds have no end")
}
