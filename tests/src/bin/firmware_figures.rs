//! Measures the firmware's figures in the emulator: a table for people, JSON for tools. `cargo xtask bench firmware` runs this.
//!
//! Arguments: `--json FILE` writes the figures there, `--bless` renews the record that the tests compare with, `--counts-only` counts and does no
//! more, `--image FILE --stack BYTES` names the flashable image, of whose stack it then measures how much is used.

use std::process::ExitCode;

use rig_tests::figures::{Cost, LIVELY, configurations, costs, mean_quantisation_error, tick_costs, worst_tick};
use rig_tests::flashable::stack_used_bytes;
use rig_tests::snapshot;
use serde_json::json;

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let (mut json_path, mut bless, mut counts_only, mut image, mut reserved_bytes) = (None, false, false, None, 0);
    while let Some(argument) = arguments.next() {
        match (argument.as_str(), arguments.len()) {
            ("--bless", _) => bless = true,
            ("--counts-only", _) => counts_only = true,
            ("--json", 1..) => json_path = arguments.next(),
            ("--image", 1..) => image = arguments.next(),
            ("--stack", 1..) => reserved_bytes = arguments.next().and_then(|bytes| bytes.parse().ok()).unwrap_or(0),
            _ => {
                eprintln!(
                    "error: {argument}: only `--json FILE`, `--image FILE`, `--stack BYTES`, `--counts-only` and `--bless` are understood"
                );
                return ExitCode::FAILURE;
            }
        }
    }
    let (costs, ticks) = (costs(&configurations()), tick_costs("hybrid"));
    let stack_bytes = ticks.iter().map(|cost| cost.stack_bytes).max();
    print_steps(&costs);
    println!(
        "whole 1 kHz tick with a step of the hybrid in it, worst case: {} instructions, {} of 168,000",
        worst_tick(&ticks),
        percent(worst_tick(&ticks))
    );
    println!("stack of a tick: {} bytes", stack_bytes.unwrap_or(0));
    if counts_only {
        return ExitCode::SUCCESS;
    }
    let used_bytes = image.map(|image| stack_used_bytes(image.as_ref(), reserved_bytes));
    if let Some(used_bytes) = used_bytes {
        println!("stack of the flashable image, watermark in the emulator: {used_bytes} of {reserved_bytes} bytes");
    }
    println!("\nMean squared error against f64, ten random 2x64 tanh networks, 200 steps:\n");
    println!("| weights | hidden states | output | variance of the states |\n| --- | --- | --- | --- |");
    for (name, gain) in [("as PyTorch draws them", 1.0), ("three times that", LIVELY)] {
        let error = mean_quantisation_error(gain);
        println!("| {name} | {:.1e} | {:.1e} | {:.1e} |", error.hidden, error.output, error.hidden_variance);
    }

    let most = |name: &str| costs.iter().find(|cost| cost.name == name).map(|cost| cost.packed[1]);
    let figures = json!({
        "instructions_per_step": {
            "2x64-tanh": most("2x64-tanh"),
            "2x64-relu": most("2x64-relu"),
            "1x32-relu": most("1x32-relu"),
            "hybrid": most("hybrid"),
        },
        "tick_worst_instructions": worst_tick(&ticks),
        "stack_bytes": used_bytes,
    });
    let record = snapshot::record(&costs, &ticks);
    let files = [(json_path.map(Into::into), figures), (bless.then(snapshot::path), record)];
    for (path, value) in files {
        let Some(path) = path else { continue };
        if let Err(error) = std::fs::write(&path, format!("{value:#}\n")) {
            eprintln!("error: cannot write {}: {error}", path.display());
            return ExitCode::FAILURE;
        }
    }
    ExitCode::SUCCESS
}

fn percent(instructions: u32) -> String {
    format!("{:.0} %", f64::from(instructions) / 1680.0)
}

fn print_steps(costs: &[Cost]) {
    println!("Instructions of a step, most of 400, counted by QEMU:\n");
    println!("| model | fast kernel | portable kernel |\n| --- | --- | --- |");
    for cost in costs {
        println!("| {} | {} | {} |", cost.name, cost.packed[1], cost.portable);
    }
    println!();
}
