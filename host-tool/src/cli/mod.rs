//! The command line: what the user typed becomes validated objects here, once; the work is done elsewhere.

mod bench;
mod check;
mod completions;
mod convert;
mod dashboard;
mod demo;
mod discover;
mod evaluate;
mod explain;
mod export;
mod fit;
mod help;
mod hide;
mod identify;
mod import_network;
mod init;
mod inspect;
mod lab;
mod pil;
mod plan_experiment;
mod reading;
mod replay;
mod rig;
mod simulate;
mod track;
mod train;
mod tune;

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand};

pub use reading::{Data, Reading};

use crate::output;

/// How a command ended; the exit code is a contract.
pub enum Outcome {
    /// Everything worked: 0.
    Success,
    /// The command ran and a check it makes failed: 1.
    CheckFailed,
}

/// Hysteresis of a pneumatic catheter: simulate, identify, train, evaluate, export.
#[derive(Parser)]
#[command(name = "catheter", version, about, long_about = None, after_long_help = help::OVERVIEW)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Simulate(simulate::Arguments),
    Fit(fit::Arguments),
    #[command(after_long_help = help::INIT)]
    Init(init::Arguments),
    Check(check::Arguments),
    #[command(after_long_help = help::CONVERT)]
    Convert(convert::Arguments),
    Identify(identify::Arguments),
    #[command(after_long_help = help::TRAIN)]
    Train(train::Arguments),
    #[command(after_long_help = help::EVALUATE)]
    Evaluate(evaluate::Arguments),
    Export(export::Arguments),
    #[command(after_long_help = help::IMPORT_NETWORK)]
    ImportNetwork(import_network::Arguments),
    Inspect(inspect::Arguments),
    #[command(after_long_help = help::RIG)]
    Rig(rig::Arguments),
    #[command(after_long_help = help::DASHBOARD)]
    Dashboard(dashboard::Arguments),
    #[command(after_long_help = help::REPLAY)]
    Replay(replay::Arguments),
    #[command(after_long_help = help::PIL)]
    Pil(pil::Arguments),
    #[command(after_long_help = help::EXPLAIN)]
    Explain(explain::Arguments),
    #[command(after_long_help = help::DEMO)]
    Demo(demo::Arguments),
    Tune(tune::Arguments),
    Track(track::Arguments),
    #[command(after_long_help = help::DISCOVER)]
    Discover(discover::Arguments),
    #[command(after_long_help = help::PLAN_EXPERIMENT)]
    PlanExperiment(plan_experiment::Arguments),
    #[command(after_long_help = help::HIDE)]
    Hide(hide::Arguments),
    #[command(hide = true)]
    Bench(bench::Arguments),
    #[command(after_long_help = help::COMPLETIONS)]
    Completions(completions::Arguments),
}

/// Options that every computing command takes.
#[derive(Args, Clone, Debug)]
pub struct Common {
    /// Write the result as JSON to this file; folders on the way are created.
    #[arg(long, value_name = "FILE", value_parser = output::file_argument(""))]
    pub json: Option<PathBuf>,
    /// Seed of every random choice; equal seeds give equal results.
    #[arg(long, default_value_t = 1, value_name = "N")]
    pub seed: u64,
    /// Worker threads; all cores when absent. Results are bit-identical for an equal count.
    #[arg(long, value_name = "N", value_parser = thread_count)]
    pub threads: Option<usize>,
}

/// More threads than this is a slip of the finger.
const MOST_THREADS: usize = 1024;

fn thread_count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count) if (1..=MOST_THREADS).contains(&count) => Ok(count),
        _ => Err(format!("a whole number from 1 to {MOST_THREADS} is wanted")),
    }
}

/// Runs the command line and turns the outcome into the exit code: 0 done, 1 a check failed, 2 usage or input.
#[must_use]
pub fn main() -> ExitCode {
    let matches = Cli::command().get_matches();
    let seed = matches.subcommand().and_then(|(_, words)| words.try_get_one::<u64>("seed").ok().flatten().copied());
    output::provenance::begin(env!("CARGO_PKG_VERSION"), seed);
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    let result = match cli.command {
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Fit(arguments) => fit::run(&arguments),
        Command::Init(arguments) => init::run(&arguments),
        Command::Check(arguments) => check::run(&arguments),
        Command::Convert(arguments) => convert::run(&arguments),
        Command::Identify(arguments) => identify::run(&arguments),
        Command::Train(arguments) => train::run(&arguments),
        Command::Evaluate(arguments) => evaluate::run(&arguments),
        Command::Export(arguments) => export::run(&arguments),
        Command::ImportNetwork(arguments) => import_network::run(&arguments),
        Command::Inspect(arguments) => inspect::run(&arguments),
        Command::Rig(arguments) => rig::run(&arguments),
        Command::Dashboard(arguments) => dashboard::run(&arguments),
        Command::Replay(arguments) => replay::run(&arguments),
        Command::Pil(arguments) => pil::run(&arguments),
        Command::Explain(arguments) => explain::run(&arguments),
        Command::Demo(arguments) => demo::run(&arguments),
        Command::Tune(arguments) => tune::run(&arguments),
        Command::Track(arguments) => track::run(&arguments),
        Command::Discover(arguments) => discover::run(&arguments),
        Command::PlanExperiment(arguments) => plan_experiment::run(&arguments),
        Command::Hide(arguments) => hide::run(&arguments),
        Command::Bench(arguments) => bench::run(&arguments),
        Command::Completions(arguments) => completions::run(&arguments),
    };
    // What the command said belongs to its result: a full disk behind `> table.txt` must not look like success.
    let result = result.and_then(|outcome| output::finish().map(|()| outcome));
    match result {
        Ok(Outcome::Success) => ExitCode::SUCCESS,
        Ok(Outcome::CheckFailed) => ExitCode::from(1),
        Err(error) => {
            // Not eprintln: it panics when nobody reads standard error any more.
            let _ = writeln!(std::io::stderr(), "{}", output::plain(&format!("error: {error:#}")));
            ExitCode::from(2)
        }
    }
}
