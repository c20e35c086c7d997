//! `catheter evaluate`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use serde::Serialize;

use super::{Common, Data, Outcome};
use crate::discover::file::DiscoveredModel;
use crate::evaluate::beyond::{self, Beyond};
use crate::evaluate::ladder::{self, Entry, Ladder};
use crate::evaluate::suite::{self, SuiteReport};
use crate::evaluate::{FamilyErrors, FileErrors, Judged, Judging, by_family, first_behind, judge, mean_nrmse, mean_rmse, pooled_rmse};
use crate::identify::{ChannelRange, PhysicsModel};
use crate::model::{self, Description, Gaps, Predictor};
use crate::recording::{self, Recording};
use crate::{network, output, report, say};
use modelling::physics::nuisance::Nuisance;
use modelling::physics::{Expected, FittedModel};

/// Judge a model on recordings, free running.
#[derive(clap::Args)]
pub struct Arguments {
    /// The model: physics (.toml), trained network (.safetensors) or blob (.blob).
    #[arg(long, value_name = "FILE")]
    model: PathBuf,
    #[command(flatten)]
    data: Data,
    /// Judge twice, side by side: as it is, and with the zero set over so many seconds at the start of each recording, which do not count
    /// in either. Without it a model of `fit` is judged with the seconds that its file states, which count in the first.
    #[arg(long, value_name = "S", value_parser = super::reading::seconds, conflicts_with = "tare")]
    calibrate_s: Option<f64>,
    /// Behind a gap in a recording: start afresh, or carry the memory on.
    #[arg(long, default_value = "reset", value_name = "HOW")]
    gaps: Gaps,
    /// Run the acceptance suite too: holds, half amplitude, noise-free, 100,000 steps, starting histories; a failed limit is exit code 1.
    #[arg(long)]
    suite: bool,
    /// The plant that gives the suite's truth; by default the one that made the recordings, if it can be found.
    #[arg(long, value_name = "FILE|pi|all-effects", requires = "suite")]
    plant: Option<String>,
    /// The f32 model that a blob was made from: the suite compares both, over 100,000 steps.
    #[arg(long, value_name = "FILE", requires = "suite")]
    reference: Option<PathBuf>,
    /// Put the model beside a static curve, Prandtl-Ishlinskii and modified Prandtl-Ishlinskii, and say which is the simplest that
    /// suffices.
    #[arg(long, requires = "ladder_train")]
    ladder: bool,
    /// Recordings that the simple models of the ladder are fitted to: those that the model was trained on.
    #[arg(long, num_args = 1.., value_name = "PATH", requires = "ladder")]
    ladder_train: Vec<PathBuf>,
    /// Further models for the ladder.
    #[arg(long, num_args = 1.., value_name = "FILE", requires = "ladder")]
    compare: Vec<PathBuf>,
    #[command(flatten)]
    common: Common,
}

/// What `--json` gets.
#[derive(Serialize)]
struct Written<'a> {
    model: String,
    files: Vec<&'a FileErrors>,
    mean_rmse: f64,
    mean_nrmse: Option<f64>,
    /// Over all samples, each counting the same: what `discover` reports.
    pooled_rmse: f64,
    unit: &'a str,
    families: &'a [FamilyErrors],
    description: &'a Description,
    skip_s: f64,
    tare: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    calibrated: Option<Calibrated>,
    /// What the model's own file promises for the next recording.
    #[serde(skip_serializing_if = "Option::is_none")]
    expected: Option<&'a Expected>,
    /// Inputs that leave the range that the model was made from.
    beyond_range: &'a [Beyond],
    /// What moved the recordings that the model was made from, and is no part of it.
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    nuisances: &'a [Nuisance],
    #[serde(skip_serializing_if = "Option::is_none")]
    ladder: Option<&'a Ladder>,
    #[serde(skip_serializing_if = "Option::is_none")]
    suite: Option<&'a SuiteReport>,
}

/// Errors after a start-up calibration of the zero.
#[derive(Clone, Debug, Serialize)]
struct Calibrated {
    /// Seconds that set the zero and do not count.
    calibrate_s: f64,
    files: Vec<FileErrors>,
    mean_rmse: f64,
    mean_nrmse: Option<f64>,
    pooled_rmse: f64,
}

/// Runs the command.
///
/// # Errors
/// On bad input.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let mut inputs = arguments.data.data.clone();
    inputs.push(arguments.model.clone());
    inputs.extend(arguments.reference.iter().chain(&arguments.ladder_train).chain(&arguments.compare).cloned());
    let outputs: Vec<&Path> = arguments.common.results.files().collect();
    output::refuse_overwriting(&inputs, &outputs)?;
    let model = model::load(&arguments.model)?;
    let reference = arguments.reference.as_deref().map(model::load).transpose()?;
    let reading = arguments.data.reading.or_lab()?;
    let (skip_s, tare) = (reading.skip_s.unwrap_or(0.0), reading.tare.is_some());
    anyhow::ensure!(
        reading.tare.is_none_or(|tare_s| tare_s == 0.0),
        "--tare: the prediction is shifted by one sample here; for a mean over some seconds say --calibrate-s"
    );
    let recordings = arguments.data.reading.load_whole(&arguments.data.data)?;
    // A recording that is read is not overwritten either when a folder was named.
    let paths: Vec<PathBuf> = recordings.iter().map(Recording::file).collect();
    output::refuse_overwriting(&paths, &outputs)?;
    let fit = model::Fit { resample: reading.resample.is_some(), gaps: arguments.gaps, start_up_s: 0.0 };
    // Both ways are judged on the same samples where the start-up was asked for.
    let judging = Judging { fit, skip_s: skip_s.max(arguments.calibrate_s.unwrap_or(0.0)), tare, calibrate_s: 0.0 };
    let threads = arguments.common.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));

    let judged = judge_all(&*model, &recordings, judging, threads)?;
    let working = output::working("evaluate", "the model on the recordings, with the zero of their start");
    let files: Vec<FileErrors> = judged.iter().map(|judged| judged.errors.clone()).collect();
    let families = by_family(&files);
    let promise = Promise::read(&arguments.model, model.description())?;
    let expected = promise.expected.as_ref();
    let beyond = beyond::beyond(&promise.ranges, &recordings);
    // The start-up that the model's own promise is for, where recordings are long enough for it.
    let stated = promise.calibrate_s;
    let long_enough = |&calibrate_s: &f64| recordings.iter().all(|one| first_behind(one, calibrate_s) < one.len());
    let calibrate_s = arguments.calibrate_s.or_else(|| stated.filter(|_| !tare).filter(long_enough));
    let calibrated = match calibrate_s {
        Some(calibrate_s) if calibrate_s > 0.0 => {
            let judged = judge(&*model, &recordings, Judging { calibrate_s, ..judging }, threads)?;
            let files: Vec<FileErrors> = judged.into_iter().map(|judged| judged.errors).collect();
            let (mean_rmse, mean_nrmse) = (mean_rmse(&files), mean_nrmse(&files));
            let pooled_rmse = pooled_rmse(&files);
            Some(Calibrated { calibrate_s, files, mean_rmse, mean_nrmse, pooled_rmse })
        }
        _ => None,
    };
    drop(working);
    print_errors(&*model, &files, &families, calibrated.as_ref());
    if let Some(calibrated) = &calibrated {
        let unit = &model.description().output.unit;
        let counted = if arguments.calibrate_s.is_some() { "which do not count as is either" } else { "which count as is" };
        say!(
            "calibrated: with the zero set over the first {} s, {counted}: mean RMSE {:.6} {unit}",
            calibrated.calibrate_s,
            calibrated.mean_rmse
        );
    }
    if let Some(expected) = expected {
        let ([low, high], unit) = (expected.interval, &model.description().output.unit);
        say!("the fit promised {:.6} {unit}, {low:.6} to {high:.6} with 95 % for one recording", expected.rmse);
        if let Some(promise) = &expected.calibrated {
            let ([low, high], seconds) = (promise.interval, promise.calibrate_s);
            say!("and calibrated over {seconds} s {:.6} {unit}, {low:.6} to {high:.6}", promise.rmse);
        }
    }
    promise.nuisances.iter().for_each(|one| say!("when it was fitted, {}; that is no part of the model", one.sentence()));
    beyond.iter().for_each(|one| say!("warning: {}", one.sentence()));
    let working = output::working("evaluate", "the ladder");
    let ladder = if arguments.ladder { Some(climb(arguments, &*model, &recordings, judging, threads)?) } else { None };
    drop(working);
    if let Some(ladder) = &ladder {
        print_ladder(ladder, &model.description().output.unit);
    }
    let suite = if arguments.suite {
        let plant = suite::find(arguments.plant.as_deref(), &recordings)?;
        if plant.is_some() {
            let (input, output) = (recording::Signal::pressure_bar(), recording::Signal::displacement_mm());
            ensure!(
                model.description().input == input && model.description().output == output,
                "--plant: the simulated plants take pressure in bar and give displacement in mm, this model does not; leave --plant out"
            );
        }
        let request = suite::Request {
            model: &*model,
            reference: reference.as_deref(),
            recordings: &recordings,
            errors: &files,
            judging,
            plant: plant.as_ref(),
            limits: suite::Limits::default(),
            seed: arguments.common.seed,
            threads,
        };
        let _working = output::working("evaluate", "the acceptance suite");
        Some(suite::run(&request)?)
    } else {
        None
    };
    if let Some(suite) = &suite {
        print_suite(suite);
    }
    if let Some(path) = &arguments.common.results.json {
        let written = Written {
            model: arguments.model.display().to_string(),
            files: files.iter().collect(),
            mean_rmse: mean_rmse(&files),
            mean_nrmse: mean_nrmse(&files),
            pooled_rmse: pooled_rmse(&files),
            unit: &model.description().output.unit,
            families: &families,
            description: model.description(),
            skip_s,
            tare,
            calibrated,
            expected,
            beyond_range: &beyond,
            nuisances: &promise.nuisances,
            ladder: ladder.as_ref(),
            suite: suite.as_ref(),
        };
        output::write_result(path, &written)?;
    }
    if let Some(path) = &arguments.common.results.html {
        let examples = report::examples("model", &recordings, &judged);
        let page = report::evaluation_page(model.description(), &examples, &families, ladder.as_ref(), suite.as_ref());
        output::write_atomic(path, page.as_bytes())?;
        say!("report: {}", path.display());
    }
    let passed = suite.is_none_or(|suite| suite.passed);
    Ok(if passed { Outcome::Success } else { Outcome::CheckFailed })
}

/// The simple rungs, then the model and those to compare with it in order of their cost.
fn climb(arguments: &Arguments, model: &dyn Predictor, recordings: &[Recording], judging: Judging, threads: usize) -> Result<Ladder> {
    let training = arguments.data.reading.load_whole(&arguments.ladder_train)?;
    let mut entries = ladder::simple_rungs(&training, judging.skip_s)?;
    let mut others: Vec<Entry> = Vec::new();
    for path in std::iter::once(&arguments.model).chain(&arguments.compare) {
        let name = path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned());
        others.push(Entry { name, model: model::load(path)? });
    }
    others.sort_by_key(|entry| entry.model.description().macs_per_step);
    entries.extend(others);
    ladder::climb(&entries, recordings, judging, threads).with_context(|| format!("the ladder of {}", model.description().path.display()))
}

fn percent(share: Option<f64>) -> String {
    share.map_or_else(|| "-".to_owned(), |share| format!("{:.3} %", 100.0 * share))
}

/// What a model's file says beside the model.
struct Promise {
    /// The ranges that it was made from, one an input, as far as its file has them.
    ranges: Vec<ChannelRange>,
    expected: Option<Expected>,
    nuisances: Vec<Nuisance>,
    /// The start-up that it is for, s.
    calibrate_s: Option<f64>,
}

impl Promise {
    fn read(path: &Path, description: &Description) -> Result<Self> {
        let format = model::format(path)?;
        Ok(match format {
            model::Format::Fitted => {
                let model = FittedModel::read(path)?;
                let calibrate_s = model.expected.calibrated.as_ref().map(|one| one.calibrate_s);
                Self { ranges: model.inputs, expected: Some(model.expected), nuisances: model.nuisances, calibrate_s }
            }
            model::Format::Physics => {
                let model = PhysicsModel::read(path)?;
                let calibrate_s = model.expected.as_ref().and_then(|expected| expected.calibrated.as_ref()).map(|one| one.calibrate_s);
                Self { ranges: vec![model.input], expected: model.expected, nuisances: model.nuisances, calibrate_s }
            }
            model::Format::Network => {
                let range = |channel: &network::Channel| ChannelRange {
                    quantity: channel.quantity.clone(),
                    unit: channel.unit.clone(),
                    minimum: f64::from(channel.minimum),
                    maximum: f64::from(channel.maximum),
                };
                Self {
                    ranges: network::load(path)?.inputs().map(range).collect(),
                    expected: None,
                    nuisances: Vec::new(),
                    calibrate_s: None,
                }
            }
            _ => {
                let (quantity, unit) = (description.input.quantity.clone(), description.input.unit.clone());
                let range = description.input_range.map(|(minimum, maximum)| ChannelRange { quantity, unit, minimum, maximum });
                let calibrate_s = if format == model::Format::Discovered { DiscoveredModel::read(path)?.calibrate_s } else { None };
                Self { ranges: range.into_iter().collect(), expected: None, nuisances: Vec::new(), calibrate_s }
            }
        })
    }
}

/// Judges a model, and says how far it is: a prediction takes a time for each sample.
fn judge_all(model: &dyn Predictor, recordings: &[Recording], judging: Judging, threads: usize) -> Result<Vec<Judged>> {
    let bar = output::progress(recordings.iter().map(|one| one.len() as u64).sum(), "evaluate");
    bar.set_message("the model on the recordings");
    let mut judged = Vec::with_capacity(recordings.len());
    for part in recordings.chunks(4 * threads) {
        judged.extend(judge(model, part, judging, threads)?);
        bar.inc(part.iter().map(|one| one.len() as u64).sum());
    }
    bar.finish_and_clear();
    Ok(judged)
}

fn print_errors(model: &dyn Predictor, files: &[FileErrors], families: &[FamilyErrors], calibrated: Option<&Calibrated>) {
    let description = model.description();
    let unit = &description.output.unit;
    say!(
        "{}: {}, {} fitted numbers, {} multiplications a step",
        description.path.display(),
        description.kind,
        description.parameters,
        description.macs_per_step
    );
    say!();
    let width = files.iter().map(|file| name_of(file).chars().count()).max().unwrap_or(0).max(9);
    let beside = calibrated.map_or(String::new(), |_| format!("  {:>13}", format!("calibrated/{unit}")));
    say!(
        "{:width$}  {:>6}  {:>8}  {:>11}  {:>10}  {:>11}{beside}",
        "recording",
        "family",
        "samples",
        format!("RMSE/{unit}"),
        "of range",
        format!("largest/{unit}")
    );
    for (index, file) in files.iter().enumerate() {
        let errors = &file.errors;
        let beside = calibrated.map_or(String::new(), |one| format!("  {:>13.6}", one.files[index].errors.rmse));
        say!(
            "{:width$}  {:>6}  {:>8}  {:>11.6}  {:>10}  {:>11.6}{beside}",
            name_of(file),
            file.family,
            errors.n,
            errors.rmse,
            percent(errors.nrmse),
            errors.max_abs
        );
    }
    if families.len() > 1 {
        say!();
        for family in families {
            say!(
                "{:width$}  {:>6}  {:>8}  {:>11.6}  {:>10}  {:>11.6}",
                format!("{} file(s)", family.files),
                family.family,
                family.n,
                family.rmse,
                percent(family.nrmse),
                family.max_abs
            );
        }
    }
    say!();
    say!(
        "mean RMSE {:.6} {unit} over {} file(s), {:.6} {unit} over all samples, free running; `of range` is RMSE over the range of the recording's output",
        mean_rmse(files),
        files.len(),
        pooled_rmse(files)
    );
}

/// The file's name alone.
fn name_of(file: &FileErrors) -> String {
    file.path.file_name().map_or_else(|| file.path.display().to_string(), |name| name.to_string_lossy().into_owned())
}

fn print_ladder(ladder: &Ladder, unit: &str) {
    say!();
    let width = ladder.rungs.iter().map(|rung| rung.name.chars().count()).max().unwrap_or(0).max(5);
    say!(
        "{:width$}  {:>11}  {:>10}  {:>11}  {:>8}  {:>10}",
        "model",
        format!("RMSE/{unit}"),
        "of range",
        format!("largest/{unit}"),
        "numbers",
        "MAC a step"
    );
    for rung in &ladder.rungs {
        let mark = if Some(&rung.name) == ladder.simplest_sufficient.as_ref() { "  <- the simplest that suffices" } else { "" };
        say!(
            "{:width$}  {:>11.6}  {:>10}  {:>11.6}  {:>8}  {:>10}{mark}",
            rung.name,
            rung.mean_rmse,
            percent(rung.mean_nrmse),
            rung.max_abs,
            rung.parameters,
            rung.macs_per_step
        );
    }
    say!("sufficient: {}", ladder.rule);
}

fn print_suite(suite: &SuiteReport) {
    say!();
    match &suite.plant {
        Some(plant) => say!("acceptance suite, truth by the plant `{plant}`:"),
        None => say!("acceptance suite without a plant: the model is held against itself"),
    }
    for criterion in &suite.criteria {
        let verdict = if criterion.passed { "pass" } else { "FAIL" };
        say!(
            "  {verdict}  {:18}  {:>9.6} of {:>9.6} {:8}  {}",
            criterion.name,
            criterion.value,
            criterion.limit,
            criterion.unit,
            criterion.what
        );
    }
    for missing in &suite.not_judged {
        say!("  not judged: {missing}");
    }
    say!("{}", if suite.passed { "passed" } else { "NOT passed" });
}
