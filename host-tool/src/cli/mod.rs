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
mod man;
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
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Result;
use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand};
use serde::Serialize;

pub use reading::{Data, Reading};

use crate::output::{self, Loudness};
use crate::report::{self, Page};

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
    #[command(flatten)]
    manners: Manners,
    #[command(subcommand)]
    command: Command,
}

/// What every command understands.
#[derive(Args)]
struct Manners {
    /// Say nothing but errors, warnings and failed checks: the results are in the files and in the exit code.
    #[arg(long, short, global = true, conflicts_with = "verbose", help_heading = EVERYWHERE)]
    quiet: bool,
    /// Say on standard error what is read and written, and when.
    #[arg(long, short, global = true, help_heading = EVERYWHERE)]
    verbose: bool,
    /// Replace results that exist already. Without it they are kept: files are refused, report folders get a number. `CATHETER_FORCE=1` in the
    /// environment says the same.
    #[arg(long, global = true, help_heading = EVERYWHERE)]
    force: bool,
}

/// Heading of these options in the help.
const EVERYWHERE: &str = "Everywhere";

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
    #[command(after_long_help = help::MAN)]
    Man(man::Arguments),
}

/// Options that every computing command takes.
#[derive(Args, Clone, Debug)]
pub struct Common {
    /// Write the result as JSON to this file; folders on the way are created.
    #[arg(long, value_name = "FILE", value_parser = output::file_argument(""))]
    pub json: Option<PathBuf>,
    /// Write the result as a page with figures and plots to this file.
    #[arg(long, alias = "report", value_name = "FILE.html", value_parser = output::file_argument("html"))]
    pub html: Option<PathBuf>,
    /// Seed of every random choice; equal seeds give equal results.
    #[arg(long, default_value_t = 1, value_name = "N")]
    pub seed: u64,
    /// Worker threads; all cores when absent. Results are bit-identical for an equal count.
    #[arg(long, value_name = "N", value_parser = thread_count)]
    pub threads: Option<usize>,
}

impl Common {
    /// The files that it names.
    fn files(&self) -> impl Iterator<Item = &Path> {
        self.json.as_deref().into_iter().chain(self.html.as_deref())
    }

    /// Writes a result to where it was asked for: as JSON, and as a page with the same figures below what `draw` puts there.
    ///
    /// # Errors
    /// When a file cannot be written.
    fn write(&self, title: &str, lead: &str, result: &impl Serialize, draw: impl FnOnce(&mut Page)) -> Result<()> {
        if let Some(path) = &self.json {
            output::write_result(path, result)?;
        }
        if let Some(path) = &self.html {
            let figures = serde_json::to_value(result)?;
            output::write_atomic(path, report::result::page(title, lead, &figures, draw).as_bytes())?;
            crate::say!("report: {}", path.display());
        }
        Ok(())
    }

    /// Copies the page that a command left in its folder to where `--html` wants one.
    ///
    /// # Errors
    /// When a file cannot be read or written.
    fn copy_page(&self, page: &Path) -> Result<()> {
        self.html.as_ref().map_or(Ok(()), |path| output::write_atomic(path, &output::read(page)?))
    }
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
    // Before the parser, whose checks of the files to write need it. Benchmarks go on with the files they have.
    let mut words = std::env::args_os().skip(1);
    let is_bench = words.next().is_some_and(|word| word == "bench");
    let forced = std::env::args_os().any(|word| word == "--force") || std::env::var_os("CATHETER_FORCE").is_some_and(|value| value == "1");
    if forced || is_bench {
        output::allow_replacing();
    }
    let matches = Cli::command().get_matches();
    let seed = matches.subcommand().and_then(|(_, words)| words.try_get_one::<u64>("seed").ok().flatten().copied());
    output::provenance::begin(env!("CARGO_PKG_VERSION"), seed);
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    if cli.manners.quiet {
        output::set_loudness(Loudness::Quiet);
    } else if cli.manners.verbose {
        output::set_loudness(Loudness::Verbose);
    }
    output::detail!("catheter {}, seed {}", env!("CARGO_PKG_VERSION"), seed.map_or_else(|| "none".to_owned(), |seed| seed.to_string()));
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
        Command::Man(arguments) => man::run(&arguments),
    };
    // What the command said belongs to its result: a full disk behind `> table.txt` must not look like success.
    let result = result.and_then(|outcome| output::finish().map(|()| outcome));
    match result {
        Ok(Outcome::Success) => ExitCode::SUCCESS,
        Ok(Outcome::CheckFailed) => ExitCode::from(1),
        Err(error) => {
            // Not eprintln: it panics when nobody reads standard error any more.
            let _ = writeln!(std::io::stderr(), "{}", output::plain(&output::brief(&format!("error: {error:#}"))));
            ExitCode::from(2)
        }
    }
}
