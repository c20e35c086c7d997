//! `catheter fit`.

use std::path::{Path, PathBuf};
use std::sync::Mutex;

use anyhow::Result;
use serde::Serialize;

use super::{Common, Data, Outcome};
use crate::fit::folder::{self, BlobFile};
use crate::fit::{self, LadderRung, Outcome as Fitted, Progress, Settings, Splits};
use crate::recording::repeatability::Repeatability;
use crate::{output, say};
use modelling::physics::nuisance::Nuisance;

/// Find the model that will be best on the next recording.
///
/// Climbs a ladder from a curve to a network. Each rung is judged by recordings that took no part in fitting or choosing it, and the simplest
/// one that is as good as the best is shipped, with the error to expect on the next recording.
#[derive(clap::Args)]
#[command(after_long_help = "\
Leaves in the folder: `model` (which evaluate and export take whatever its kind), `model.blob` where the microcontroller can
hold it, `report.html`, and `rungs/` with every model of the ladder.

Examples:
  catheter fit --data recordings --out result
  catheter fit --data recordings --out result --no-networks --json fit.json
  catheter fit --data arm.csv --columns time=t_s,input=p1_bar,input2=p2_bar,output=angle_deg --out result
  catheter evaluate --model result/model --data others")]
pub struct Arguments {
    #[command(flatten)]
    data: Data,
    /// Folder for the results; where it holds something already, a number is added to its name. With `--force` an earlier fit is replaced.
    #[arg(long, value_name = "DIR", value_parser = output::folder_argument())]
    out: PathBuf,
    /// Leave the network rungs out.
    #[arg(long)]
    no_networks: bool,
    /// CPU time for the training of a network that may be shipped, in s; two networks and their cross-validation take five times as much.
    #[arg(long, default_value_t = 60.0, value_name = "S", conflicts_with = "no_networks")]
    network_budget_cpu_s: f64,
    /// Seconds at the start of each recording that set its zero, for the error with calibration; by default about a tenth of the shortest
    /// recording.
    #[arg(long, value_name = "S")]
    calibrate_s: Option<f64>,
    #[command(flatten)]
    common: Common,
}

/// Steps of the progress of trainings.
const PERMILLE: u64 = 1000;

/// What `--json` gets.
#[derive(Serialize)]
struct Summary<'a> {
    chosen: &'a str,
    ladder: &'a [LadderRung],
    repeatability: Option<f64>,
    noise: f64,
    splits: &'a Splits,
    nuisances: &'a [Nuisance],
    calibrate_s: f64,
    unit: &'a str,
    output_range: f64,
    model: String,
    blob: Option<BlobFile>,
    repeatability_details: &'a Repeatability,
    notes: &'a [String],
    seconds: f64,
}

/// Runs the command.
///
/// # Errors
/// On bad input.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let clock = std::time::Instant::now();
    anyhow::ensure!(
        arguments.network_budget_cpu_s > 0.0 && arguments.network_budget_cpu_s.is_finite(),
        "--network-budget-cpu-s: a positive number of seconds is wanted"
    );
    anyhow::ensure!(
        arguments.calibrate_s.is_none_or(|calibrate_s| calibrate_s > 0.0 && calibrate_s.is_finite()),
        "--calibrate-s: a positive number of seconds is wanted"
    );
    let recordings = arguments.data.load()?;
    let inputs: Vec<PathBuf> = recordings.iter().map(|recording| recording.file()).collect();
    // Typed twice, the second leaves the first as it is.
    let out = output::free_folder(&arguments.out);
    let model_path = out.join("model");
    let written = folder::files(&out);
    if let Some(json) = arguments.common.results.files().find(|file| written.iter().any(|one| one == file)) {
        anyhow::bail!("{} (--json, --html): the fit writes a file of that name itself; choose another", json.display());
    }
    let outputs: Vec<&Path> = written.iter().map(PathBuf::as_path).chain(arguments.common.results.files()).collect();
    output::refuse_overwriting(&inputs, &outputs)?;
    let threads = arguments.common.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));
    let settings = Settings {
        seed: arguments.common.seed,
        threads,
        network_budget_cpu_s: (!arguments.no_networks).then_some(arguments.network_budget_cpu_s),
        calibrate_s: arguments.calibrate_s,
    };
    let bar = output::progress(0, "fit");
    bar.set_message("physics rungs");
    let failed: Mutex<Option<anyhow::Error>> = Mutex::new(None);
    let tell = |progress: Progress| match progress {
        Progress::First(model) => {
            if let (Err(error), Ok(mut slot)) = (model.write(&model_path), failed.lock()) {
                slot.get_or_insert(error);
            }
            let rmse = model.expected.rmse;
            bar.suspend(|| {
                say!(
                    "after {:.1} s: a first model, {}; error about {rmse:.4} {}",
                    clock.elapsed().as_secs_f64(),
                    model_path.display(),
                    model.output.unit
                )
            });
        }
        Progress::Physics { done, of } => {
            bar.set_length(of as u64);
            bar.set_position(done as u64);
            bar.set_message("physics rungs");
            if done == of {
                bar.suspend(|| say!("after {:.1} s: the physics rungs are judged", clock.elapsed().as_secs_f64()));
            }
        }
        Progress::Network { number, of, name } => {
            if number == 1 {
                // The time left is that of the trainings, which the physics rungs say nothing about.
                bar.set_length(PERMILLE);
                bar.set_position(0);
                bar.reset_elapsed();
            }
            bar.set_message(format!("training {number} of {of}: {name}"));
            bar.suspend(|| say!("after {:.1} s: training {number} of {of}: {name}", clock.elapsed().as_secs_f64()));
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share")]
        Progress::Trained(share) => bar.set_position((share * PERMILLE as f64) as u64),
        Progress::Note(note) => bar.suspend(|| say!("{note}")),
    };
    let fitted = fit::fit(&recordings, &settings, &tell)?;
    bar.finish_and_clear();
    if let Some(error) = failed.into_inner().ok().flatten() {
        return Err(error);
    }
    let blob = folder::write(&fitted, &crate::report::fit::page(&fitted), &out)?;
    print(&fitted, &model_path, blob.as_ref());
    arguments.common.results.copy_page(&out.join(folder::REPORT))?;
    say!("report: {}", out.join(folder::REPORT).display());
    if let Some(path) = &arguments.common.results.json {
        let range = &fitted.prepared.output;
        let summary = Summary {
            chosen: &fitted.ladder[fitted.chosen].name,
            ladder: &fitted.ladder,
            repeatability: fitted.repeatability.repeatability,
            noise: fitted.repeatability.noise,
            splits: &fitted.splits,
            nuisances: &fitted.ladder[fitted.chosen].nuisances,
            calibrate_s: fitted.calibrate_s,
            unit: &range.unit,
            output_range: range.maximum - range.minimum,
            model: model_path.display().to_string(),
            blob,
            repeatability_details: &fitted.repeatability,
            notes: &fitted.notes,
            seconds: clock.elapsed().as_secs_f64(),
        };
        output::write_result(path, &summary)?;
    }
    Ok(Outcome::Success)
}

/// What a blob of several inputs is for.
fn print_inputs(blob: &BlobFile) {
    if blob.inputs > 1 {
        say!(
            "a blob of {} inputs runs on a computer and as C (`catheter export --c`); the firmware measures one pressure and refuses it",
            blob.inputs
        );
    }
}

fn print(fitted: &Fitted, model: &Path, blob: Option<&BlobFile>) {
    let output = &fitted.prepared.output;
    let (unit, range) = (&output.unit, output.maximum - output.minimum);
    let width = fitted.ladder.iter().map(|rung| rung.name.chars().count()).max().unwrap_or(0).max(5);
    say!();
    say!(
        "{:width$}  {:>11}  {:>8}  {:>23}  {:>11}  {:>23}  {:>7}  {:>12}",
        "rung",
        format!("error/{unit}"),
        "of range",
        "next recording, 95 %",
        "calibrated",
        "next recording, 95 %",
        "numbers",
        "instructions"
    );
    for (index, rung) in fitted.ladder.iter().enumerate() {
        let [low, high] = rung.cv_interval;
        let mark = if index == fitted.chosen {
            "  <- chosen"
        } else if !rung.eligible {
            "  (these data cannot judge it)"
        } else {
            ""
        };
        say!(
            "{:width$}  {:>11.5}  {:>6.2} %  {:>23}  {:>11}  {:>23}  {:>7}  {:>12}{mark}",
            rung.name,
            rung.cv_rmse,
            100.0 * rung.cv_rmse / range,
            format!("{low:.4} .. {high:.4}"),
            rung.calibrated.as_ref().map_or("-".to_owned(), |one| format!("{:.5}", one.rmse)),
            rung.calibrated.as_ref().map_or("-".to_owned(), |one| format!("{:.4} .. {:.4}", one.interval[0], one.interval[1])),
            rung.parameters,
            rung.step_instructions
        );
    }
    say!();
    say!("errors are free running, on what was left out: {}", fitted.splits.what);
    if fitted.ladder.iter().any(|rung| rung.calibrated.is_some()) {
        say!("`calibrated`: with the zero set over the first {} s of each recording, which do not count there", fitted.calibrate_s);
    }
    if !fitted.ladder[fitted.chosen].nuisances.is_empty() {
        say!("rungs are compared with the nuisances of each recording taken off; both errors above are with them");
    }
    let repeatability = &fitted.repeatability;
    match repeatability.repeatability {
        Some(repeats) => say!("the rig repeats to {repeats:.4} {unit}, the sensor's noise is {:.4} {unit}", repeatability.noise),
        None => {
            say!("how well the rig repeats is not known: {}; the sensor's noise is {:.4} {unit}", repeatability.method, repeatability.noise)
        }
    }
    let chosen = &fitted.ladder[fitted.chosen];
    let [low, high] = chosen.cv_interval;
    say!(
        "model: {} ({}): expect {:.4} {unit} on the next recording, {low:.4} to {high:.4} with 95 %",
        model.display(),
        chosen.name,
        chosen.cv_rmse
    );
    if let Some(calibrated) = &chosen.calibrated {
        let [low, high] = calibrated.interval;
        say!(
            "with its zero set over its first {} s: expect {:.4} {unit}, {low:.4} to {high:.4} with 95 %",
            calibrated.calibrate_s,
            calibrated.rmse
        );
    }
    blob.into_iter().for_each(print_inputs);
    match blob {
        Some(blob) if blob.rung == chosen.name => {
            say!("blob: {}, {} bytes, {} instructions a step", blob.file, blob.bytes, blob.step_instructions)
        }
        Some(blob) => {
            say!("blob: {} holds `{}`, the best that has this form; {} does not fit it", blob.file, blob.rung, chosen.name);
            say!(
                "expect {:.4} {unit} of the blob on the next recording, {:.2} times that of the model",
                blob.cv_rmse,
                blob.cv_rmse / chosen.cv_rmse
            )
        }
        None => say!("no blob: the microcontroller's format holds none of these rungs"),
    }
}
