//! The command line: what the user typed becomes validated objects here, once; the work is done elsewhere.

mod completions;
mod demo;
mod evaluate;
mod export;
mod identify;
mod inspect;
mod simulate;
mod train;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};

/// How a command ended; the exit code is a contract.
pub enum Outcome {
    /// Everything worked: 0.
    Success,
    /// The command ran and a check it makes failed: 1.
    CheckFailed,
}

/// Hysteresis of a pneumatic catheter: simulate, identify, train, evaluate, export.
#[derive(Parser)]
#[command(name = "catheter", version, about, long_about = None)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Simulate(simulate::Arguments),
    Identify(identify::Arguments),
    Train(train::Arguments),
    Evaluate(evaluate::Arguments),
    Export(export::Arguments),
    Inspect(inspect::Arguments),
    Demo(demo::Arguments),
    Completions(completions::Arguments),
}

/// Options that every computing command takes.
#[derive(Args, Clone, Debug)]
pub struct Common {
    /// Write the result as JSON to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Seed of every random choice; equal seeds give equal results.
    #[arg(long, default_value_t = 1, value_name = "N")]
    pub seed: u64,
    /// Worker threads; all cores when absent. Results are bit-identical for an equal count.
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
}

/// Recordings on the command line: files or folders of CSVs, and what their columns mean.
#[derive(Args, Clone, Debug)]
pub struct Data {
    /// A CSV file or a folder of CSV files; may be repeated.
    #[arg(long = "data", required = true, num_args = 1.., value_name = "PATH")]
    pub data: Vec<PathBuf>,
    /// Column names of foreign files, for example `time=t_s,input=voltage_V,output=displacement_um`.
    #[arg(long, value_name = "MAP")]
    pub columns: Option<String>,
}

/// Runs the command line and turns the outcome into the exit code: 0 done, 1 a check failed, 2 usage or input.
#[must_use]
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let result = match cli.command {
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Identify(arguments) => identify::run(&arguments),
        Command::Train(arguments) => train::run(&arguments),
        Command::Evaluate(arguments) => evaluate::run(&arguments),
        Command::Export(arguments) => export::run(&arguments),
        Command::Inspect(arguments) => inspect::run(&arguments),
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Completions(arguments) => completions::run(&arguments),
    };
    match result {
        Ok(Outcome::Success) => ExitCode::SUCCESS,
        Ok(Outcome::CheckFailed) => ExitCode::from(1),
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::from(2)
        }
    }
}
