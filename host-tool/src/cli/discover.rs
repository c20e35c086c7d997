//! `catheter discover`.

use std::path::{Path, PathBuf};

use anyhow::Result;

use super::{Common, Data, Outcome};
use crate::discover::catalogue;
use crate::discover::effects::of_a_file::Definition;
use crate::discover::file::DiscoveredModel;
use crate::discover::folder::{self, Written};
use crate::discover::{self, DiscoverConfig, Discovery, Progress, Start};
use crate::output::text::plain_number;
use crate::recording::{self, Recording};
use crate::{model, output, report, say};

/// Find the physical effect that the simulation lacks, name it, add it to the model and show the gap shrink.
///
/// Example: `catheter discover --data session --holdout other --out result --json result.json`. Without `--holdout` some recordings are
/// kept out of everything and named. `result/model.toml` is the model with the effect; `catheter evaluate --model` takes it.
#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    data: Data,
    /// The simulation model to start from; without it, play operators are fitted to the recordings. The figures before are then this
    /// model's; effects that `discover` once wrote into it are kept and what is found comes on top.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Recordings that take no part in any choice: CSV files or folders; may be repeated.
    #[arg(long, num_args = 1.., value_name = "PATH")]
    holdout: Vec<PathBuf>,
    /// Effects of your own that take part, TOML files; may be repeated.
    #[arg(long, num_args = 1.., value_name = "FILE")]
    effects: Vec<PathBuf>,
    /// Folder for the model and the result; where it holds something already, a number is added to its name.
    #[arg(long, value_name = "DIR", value_parser = output::folder_argument())]
    out: PathBuf,
    #[command(flatten)]
    common: Common,
}

/// Runs the command.
///
/// # Errors
/// On bad input or when the result cannot be written.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    // Typed twice, the second leaves the first as it is.
    let out = output::free_folder(&arguments.out);
    let outputs = folder::FILES.map(|name| out.join(name));
    let outputs: Vec<&Path> = outputs.iter().map(PathBuf::as_path).chain(arguments.common.results.files()).collect();
    let recordings = arguments.data.load()?;
    let kept =
        if arguments.holdout.is_empty() { Vec::new() } else { recording::load_with(&arguments.holdout, &arguments.data.options()?)? };
    let mut read: Vec<PathBuf> = recordings.iter().chain(&kept).map(Recording::file).collect();
    read.extend(arguments.model.clone());
    read.extend(arguments.effects.clone());
    output::refuse_overwriting(&read, &outputs)?;
    for path in &arguments.effects {
        catalogue::add(Definition::read(path)?);
    }
    let start = arguments.model.as_deref().map(|path| start_from(path, &recordings, &kept)).transpose()?;
    let mut config = DiscoverConfig { seed: arguments.common.seed, ..DiscoverConfig::default() };
    if let Some(threads) = arguments.common.threads {
        config.threads = threads;
    }
    let stages = output::stages("discover");
    let finding = discover::discover_from(&recordings, &kept, start.as_ref(), &config, &|progress| match progress {
        Progress::Stage(name) => stages.stage(name),
        Progress::Part { done, all } => stages.part(done as u64, all as u64),
    })?;
    drop(stages);
    let discovery = &finding.discovery;
    let page = crate::report::discovery::page(&finding, &recordings[0].input_signal, &recordings[0].output_signal);
    let Written { model, for_the_board } = folder::write(&finding, &recordings, &page, &out)?;
    if let Some(path) = &arguments.common.results.json {
        output::write_result(path, discovery)?;
    }
    arguments.common.results.copy_page(&out.join("report.html"))?;
    tell(discovery, &model, &out);
    match for_the_board {
        Ok(_) => say!("For the microcontroller: catheter export {} ...", out.join("microcontroller.toml").display()),
        Err(why) => say!("No form for the microcontroller: {why}. This model runs on the desktop only."),
    }
    Ok(Outcome::Success)
}

/// Lets a given model predict every recording.
fn start_from(path: &Path, recordings: &[Recording], kept: &[Recording]) -> Result<Start> {
    let predictor = model::load(path)?;
    discover::start_from(predictor.as_ref(), DiscoveredModel::read(path).ok(), recordings, kept)
}

/// Says what was found.
fn tell(discovery: &Discovery, model: &DiscoveredModel, out: &Path) {
    let unit = &model.output.unit;
    say!("{}", discovery.summary);
    say!("{}", report::discovery::headline(discovery));
    for effect in &discovery.effects {
        say!("  {} ({}), confidence {:.2}", effect.name, effect.form, effect.confidence);
        for (name, value) in &effect.parameters {
            match effect.intervals.get(name) {
                Some([low, high]) => {
                    say!("    {name} = {} ({} to {})", plain_number(*value, 5), plain_number(*low, 5), plain_number(*high, 5))
                }
                None => say!("    {name} = {}", plain_number(*value, 5)),
            }
        }
    }
    if let Some(second) = &discovery.runner_up {
        let words = if second.separable { "told apart by these recordings" } else { "not told apart by these recordings" };
        say!("Second best: {}, {words}.", second.name);
        if !second.separable {
            let (first, second) = (out.join("model.toml"), out.join("runner_up.toml"));
            say!("The experiment that would: catheter plan-experiment --models {} {} --out next.toml", first.display(), second.display());
        }
    }
    if discovery.excluded_samples > 0 {
        say!("{} samples were left out as outliers.", discovery.excluded_samples);
    }
    let behind = discovery.calibrate_s.map_or(String::new(), |seconds| format!(" behind a start-up of {seconds:.2} s that sets the zero"));
    say!(
        "Kept-out recordings, free running{behind}: rmse {} {unit} before, {} {unit} after, noise {} {unit}; {:.1} % of the gap closed ({}).",
        plain_number(discovery.rmse_before, 4),
        plain_number(discovery.rmse_after, 4),
        plain_number(discovery.noise_floor, 4),
        100.0 * discovery.gap_closed,
        discovery.kept_out.join(", ")
    );
    if let Some(warning) = report::discovery::warning(discovery) {
        say!("{warning}");
    }
    if let Some([before, after, closed]) = discovery.one_step() {
        say!(
            "One step ahead: rmse {} {unit} by a smooth observer, {} {unit} by one that knows the jumps; {:.1} % of the gap closed.",
            plain_number(before, 4),
            plain_number(after, 4),
            100.0 * closed
        );
    }
    if !discovery.side_unknown.is_empty() {
        let names = discovery.side_unknown.join(", ");
        say!("These figures leave out {names}: made about when the set-up changed, and the other recordings do not tell on which side.");
    }
    say!("Model in {}, report in {}", out.join("model.toml").display(), out.join("report.html").display());
}
