//! `catheter bench`.

use std::io::Write;

use std::path::Path;

use anyhow::{Context, Result};

use super::{Common, Outcome};
use crate::discover::corpus::{self, CaseResult, CorpusConfig};
use crate::rig::{Excitation, Generator};
use crate::track::bench::{self, BenchConfig};

/// Measure how well the tool does; for developers.
#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand)]
enum What {
    /// Hidden cases of the virtual rig: which effects are named right.
    Discover(Discover),
    /// Controllers on the realistic rig, side by side.
    Control(Control),
}

#[derive(clap::Args)]
struct Control {
    /// Number of rigs, counted from the first seed, `--seed`.
    #[arg(long, default_value_t = 1, value_name = "N")]
    seeds: u64,
    /// Length of the run without the laser, s of simulated time.
    #[arg(long, default_value_t = 3600.0, value_name = "S")]
    long_run_s: f64,
    /// Nominal CPU time for training each of the two networks of a rig, s; 0 leaves networks out.
    #[arg(long, default_value_t = 20.0, value_name = "S")]
    learned_cpu_s: f64,
    #[command(flatten)]
    common: Common,
}

#[derive(clap::Args)]
struct Discover {
    /// What to hide: names of effects, `a+b` for two, `effects`, `aliens`, `pairs` or `none`.
    #[arg(long = "hide", num_args = 1.., default_values = ["effects"], value_name = "NAME")]
    names: Vec<String>,
    /// Number of seeds.
    #[arg(long, default_value_t = 3, value_name = "N")]
    seeds: u64,
    /// Noise relative to the output's range.
    #[arg(long, default_value_t = 0.005, value_name = "SHARE")]
    noise: f64,
    /// Correlate half of the noise over a tenth of a second.
    #[arg(long)]
    coloured: bool,
    /// What the rig is told to do.
    #[arg(long, value_enum, default_value = "paper")]
    excitation: Excitation,
    /// The virtual rig.
    #[arg(long, value_enum, default_value = "physics")]
    rig: Generator,
    /// Go on with an interrupted run: cases that are in the file of --json already are not run again.
    #[arg(long, requires = "json")]
    resume: bool,
    /// Counted from the first seed, `--seed`.
    #[command(flatten)]
    common: Common,
}

/// Runs the command.
///
/// # Errors
/// On bad input.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    match &arguments.what {
        What::Discover(discover) => run_discover(discover),
        What::Control(control) => run_control(control),
    }
}

fn run_control(control: &Control) -> Result<Outcome> {
    let seeds: Vec<u64> = (control.common.seed..control.common.seed + control.seeds).collect();
    let config = BenchConfig { seeds: &seeds, long_run_s: control.long_run_s, learned_cpu_s: control.learned_cpu_s };
    let table = bench::table(&config, &mut |step| {
        let _ = writeln!(std::io::stderr(), "{step}");
    })?;
    for row in &table.rows {
        crate::say!(
            "{:>6}  {:<16}{:<22}{:>9.4} mm rms {:>9.4} mm largest",
            row.seed,
            row.reference,
            row.controller,
            row.rmse_mm,
            row.max_mm
        );
    }
    control.common.results.write("Control, measured", "Controllers on virtual rigs.", &table, |_| {})?;
    Ok(Outcome::Success)
}

fn run_discover(discover: &Discover) -> Result<Outcome> {
    let config = CorpusConfig {
        names: discover.names.clone(),
        seeds: discover.common.seed..discover.common.seed + discover.seeds,
        noise: discover.noise,
        coloured_noise: discover.coloured,
        excitation: discover.excitation,
        generator: discover.rig,
        threads: discover.common.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from)),
    };
    let settings = serde_json::json!({
        "noise": config.noise,
        "coloured_noise": config.coloured_noise,
        "excitation": format!("{:?}", config.excitation),
        "rig": format!("{:?}", config.generator),
    });
    let done = match &discover.common.results.json {
        Some(path) if discover.resume && path.exists() => finished(path, &settings)?,
        _ => Vec::new(),
    };
    let results = corpus::run(&config, done, |cases| {
        let Some(case) = cases.last() else { return Ok(()) };
        if crate::output::loudness() == crate::output::Loudness::Verbose {
            crate::say!(
                "{:<4}{:<32}{:>5} {:<10}{:<40} gap {:.3} rmse {:.5} {:.5} floor {:.5} left {:.3} {:.2} s  [{}] 2nd {}",
                if corpus::right(case) { "" } else { "***" },
                case.hidden.join("+"),
                case.seed,
                format!("{:?}", case.verdict).to_lowercase(),
                case.found.join("+"),
                case.gap_closed,
                case.rmse[0],
                case.rmse[1],
                case.rmse[2],
                case.unexplained,
                case.seconds,
                case.form,
                case.runner_up,
            );
        }
        if let Some(path) = &discover.common.results.json {
            crate::output::write_json(path, &serde_json::json!({ "settings": settings, "rows": corpus::rows(cases), "cases": cases }))?;
        }
        anyhow::Ok(())
    })?;
    crate::output::print_bytes(corpus::summary(&results).as_bytes());
    Ok(Outcome::Success)
}

/// The cases of an interrupted run.
fn finished(path: &Path, settings: &serde_json::Value) -> Result<Vec<CaseResult>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let mut file: serde_json::Value = serde_json::from_str(&text).with_context(|| format!("{}: no JSON", path.display()))?;
    anyhow::ensure!(
        file["settings"] == *settings,
        "{} holds cases of other settings ({}); give --json another file, or leave out --resume",
        path.display(),
        file["settings"]
    );
    serde_json::from_value(file["cases"].take()).with_context(|| format!("{}: no cases", path.display()))
}
