//! `catheter identify`.

use std::path::PathBuf;

use anyhow::Result;
use serde::Serialize;

use super::{Common, Data, Outcome};
use crate::evaluate::{FamilyErrors, Judging, by_family, judge};
use crate::identify::choose::Judged;
use crate::identify::{self, Choice, Family, Fit, FitConfig, Kind, MOST_EQUATIONS, Thresholds};
use crate::model::PhysicsPredictor;
use crate::recording::{self, Recording, Timing};
use crate::report::Example;
use crate::{output, report, say};

/// Fit a physics model to recordings.
///
/// Finds a Prandtl-Ishlinskii model (a weighted sum of play operators) by non-negative least squares; thresholds are free unless given.
/// The error reported is that of the model running freely on the recorded input. Every parameter comes with a 95 % confidence interval.
#[derive(clap::Args)]
#[command(after_long_help = "\
Examples:
  catheter identify --data data/paper/train --out pi.toml --json pi.json
  catheter identify --data data/paper/train --out pi.toml --operators 12
  catheter identify --data data/all/train --out m.toml --model modified-pi --dead-time-s auto --lag-s auto
  catheter identify --data p.csv --columns time=t_s,input=u_V,output=x_um --skip-s 1 --out p.toml")]
pub struct Arguments {
    #[command(flatten)]
    data: Data,
    /// The model file to write.
    #[arg(long, value_name = "M.toml", value_parser = output::file_argument("toml"))]
    out: PathBuf,
    /// Kind of model; the modified one bends the sum by a curve (asymmetry, saturation). `auto` tries both, with and without dead time and
    /// lag, and takes the simplest that is as good as the best on recordings left out.
    #[arg(long, value_enum, default_value_t = ModelKind::Auto)]
    model: ModelKind,
    /// So many operators with thresholds on an even grid up to half the input's span.
    #[arg(long, value_name = "N", conflicts_with_all = ["free_thresholds", "thresholds"])]
    operators: Option<usize>,
    /// At most so many operators with free thresholds; 12 when nothing else is said.
    #[arg(long, value_name = "N", conflicts_with = "thresholds")]
    free_thresholds: Option<usize>,
    /// These thresholds, in the input's unit.
    #[arg(long, value_name = "R,R,...", value_delimiter = ',')]
    thresholds: Option<Vec<f64>>,
    /// Play operators (displacement), stop operators (friction force), or whichever fits better.
    #[arg(long = "type", value_enum, default_value_t = OperatorType::Auto)]
    operator_type: OperatorType,
    /// Input at which the actuator rested before the recordings; 0 for pressure, else where the recordings start.
    #[arg(long, value_name = "VALUE", allow_negative_numbers = true)]
    rest_input: Option<f64>,
    /// Fit a constant for each recording (a sensor set to zero anew); the model gets their mean.
    #[arg(long)]
    offset_per_recording: bool,
    /// Dead time between input and operators: seconds or `auto`; 0 when nothing is said and a kind of model is.
    #[arg(long, value_name = "S|auto", value_parser = choice)]
    dead_time_s: Option<Choice>,
    /// Time constant of a first-order lag between input and operators: seconds or `auto`.
    #[arg(long, value_name = "S|auto", value_parser = choice)]
    lag_s: Option<Choice>,
    /// Segments of the modified model's curve.
    #[arg(long, default_value_t = 8, value_name = "N")]
    curve_segments: usize,
    /// Search thresholds on every sample. Of more than half a million the search takes every so many-th; weights and intervals are those of all
    /// in either case.
    #[arg(long)]
    every_sample: bool,
    #[command(flatten)]
    common: Common,
}

/// Kind of model on the command line.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum ModelKind {
    Auto,
    Pi,
    ModifiedPi,
}

/// Type of operator on the command line.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum OperatorType {
    Auto,
    Play,
    Stop,
}

/// What `--json` gets.
#[derive(Serialize)]
struct Summary<'a> {
    model: Kind,
    thresholds: &'a [f64],
    weights: &'a [f64],
    rmse: f64,
    nrmse: f64,
    max_abs: f64,
    n: usize,
    constant: f64,
    input_gain: f64,
    rest_input: f64,
    dead_time_s: f64,
    lag_time_constant_s: f64,
    thresholds_95: &'a [[f64; 2]],
    weights_95: &'a [[f64; 2]],
    constant_95: Option<[f64; 2]>,
    interval_widening: f64,
    curve_slopes: Option<[f64; 3]>,
    operator_type: Family,
    input_unit: &'a str,
    output_unit: &'a str,
    files: Vec<FileSummary<'a>>,
    /// Error on what took no part, and the 95 % prediction interval for the next recording; absent for very long data.
    cv_rmse: Option<f64>,
    cv_interval: Option<[f64; 2]>,
    /// All kinds that were tried.
    kinds: &'a [Judged],
}

#[derive(Serialize)]
struct FileSummary<'a> {
    path: &'a std::path::Path,
    family: &'a str,
    n: usize,
    rmse: f64,
    nrmse: f64,
    max_abs: f64,
    timing: Timing,
}

/// Runs the command.
///
/// # Errors
/// On bad input.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let skip_s = arguments.data.reading.skipped_s()?;
    let config = FitConfig {
        kind: match arguments.model {
            ModelKind::Auto | ModelKind::Pi => Kind::PrandtlIshlinskii,
            ModelKind::ModifiedPi => Kind::ModifiedPrandtlIshlinskii,
        },
        thresholds: match (arguments.operators, &arguments.thresholds) {
            (Some(count), _) => Thresholds::Grid(count),
            (None, Some(thresholds)) => Thresholds::Given(thresholds.clone()),
            (None, None) => Thresholds::Free(arguments.free_thresholds.unwrap_or(12)),
        },
        family: match arguments.operator_type {
            OperatorType::Auto => None,
            OperatorType::Play => Some(Family::Play),
            OperatorType::Stop => Some(Family::Stop),
        },
        rest_input: arguments.rest_input,
        skip_s,
        offsets: arguments.offset_per_recording,
        dead_time_s: arguments.dead_time_s.unwrap_or(Choice::Given(0.0)),
        lag_time_constant_s: arguments.lag_s.unwrap_or(Choice::Given(0.0)),
        curve_segments: arguments.curve_segments,
        most_equations: if arguments.every_sample { usize::MAX } else { MOST_EQUATIONS },
    };
    let mut recordings = arguments.data.reading.load_whole(&arguments.data.data)?;
    if let Some(tare_s) = arguments.data.reading.or_lab()?.tare {
        recordings.iter_mut().for_each(|recording| recording::prepare::tare(recording, skip_s, tare_s));
    }
    let inputs: Vec<PathBuf> = recordings.iter().map(Recording::file).collect();
    let mut outputs = vec![arguments.out.as_path()];
    outputs.extend(arguments.common.results.files());
    output::refuse_overwriting(&inputs, &outputs)?;
    let threads = arguments.common.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));
    // A setting that the user gave is kept in every kind.
    let path_given = arguments.dead_time_s.is_some() || arguments.lag_s.is_some();
    let candidates = match arguments.model {
        ModelKind::Auto => identify::choose::kinds(&config)
            .into_iter()
            .filter(|(_, kind)| !path_given || kind.dead_time_s == Choice::Auto)
            .map(|(name, kind)| {
                let dead_time_s = arguments.dead_time_s.unwrap_or(kind.dead_time_s);
                (name, FitConfig { dead_time_s, lag_time_constant_s: arguments.lag_s.unwrap_or(kind.lag_time_constant_s), ..kind })
            })
            .collect(),
        _ => vec![("this model".to_owned(), config.clone())],
    };
    let bar = output::progress(0, "identify");
    bar.set_message("kinds of model, on what is left out");
    let told = |done: usize, of: usize| {
        bar.set_length(of as u64);
        bar.set_position(done as u64);
    };
    let (kinds, chosen) = identify::choose::judge(&recordings, &candidates, threads, &told)?;
    bar.finish_and_clear();
    let working = output::working("identify", "the model of all recordings");
    let config = candidates.get(chosen).map_or(config, |(_, config)| config.clone());
    let fit = identify::fit(&recordings, &config)?;
    drop(working);
    fit.model.write(&arguments.out)?;
    if arguments.common.results.files().next().is_some() {
        let result = summary(&fit, &recordings, &kinds, chosen);
        let drawn = drawn(&fit, &recordings, arguments, skip_s, threads)?;
        let lead = format!(
            "{}: {} operators, RMSE {:.3e} {} on the recordings it was fitted to.",
            arguments.out.display(),
            fit.model.thresholds.len(),
            fit.rmse,
            fit.model.output.unit
        );
        arguments
            .common
            .results
            .write("A physics model", &lead, &result, |page| report::on_recordings(page, &drawn.0, &drawn.1, &fit.model.output.unit))?;
    }
    print(&fit, &recordings, arguments);
    print_kinds(&kinds, chosen, &fit.model.output.unit);
    Ok(Outcome::Success)
}

/// What the page shows of the model on the recordings: an example of each family, and the errors. Nothing without a page.
fn drawn(
    fit: &Fit,
    recordings: &[Recording],
    arguments: &Arguments,
    skip_s: f64,
    threads: usize,
) -> Result<(Vec<Example>, Vec<FamilyErrors>)> {
    if arguments.common.results.html.is_none() {
        return Ok((Vec::new(), Vec::new()));
    }
    let model = PhysicsPredictor::new(fit.model.clone(), &arguments.out);
    let judged = judge(&model, recordings, Judging { skip_s, ..Judging::default() }, threads)?;
    let examples = report::examples("model", recordings, &judged);
    Ok((examples, by_family(judged.iter().map(|judged| &judged.errors))))
}

fn summary<'a>(fit: &'a Fit, recordings: &'a [Recording], kinds: &'a [Judged], chosen: usize) -> Summary<'a> {
    let model = &fit.model;
    let files = recordings.iter().map(|recording| {
        let (rmse, nrmse, max_abs) = model.errors(recording);
        FileSummary {
            path: &recording.path,
            family: &recording.family,
            n: recording.len(),
            rmse,
            nrmse,
            max_abs,
            timing: recording.timing(),
        }
    });
    Summary {
        model: model.kind,
        thresholds: &model.thresholds,
        weights: &model.weights,
        rmse: fit.rmse,
        nrmse: fit.nrmse,
        max_abs: fit.max_abs,
        n: model.provenance.samples,
        constant: model.constant,
        input_gain: model.input_gain,
        rest_input: model.rest_input,
        dead_time_s: model.input_path.dead_time_s,
        lag_time_constant_s: model.input_path.lag_time_constant_s,
        thresholds_95: &model.thresholds_95,
        weights_95: &model.weights_95,
        constant_95: model.constant_95,
        interval_widening: fit.interval_widening,
        curve_slopes: fit.curve_slopes,
        operator_type: fit.family,
        input_unit: &model.input.unit,
        output_unit: &model.output.unit,
        files: files.collect(),
        cv_rmse: kinds.get(chosen).map(|kind| kind.cv_rmse),
        cv_interval: kinds.get(chosen).map(|kind| kind.cv_interval),
        kinds,
    }
}

fn print(fit: &Fit, recordings: &[Recording], arguments: &Arguments) {
    let model = &fit.model;
    let (input, output) = (&model.input.unit, &model.output.unit);
    say!("threshold [{input}]  weight [{output}/{input}]  95 % interval of the weight");
    for (index, (threshold, weight)) in model.thresholds.iter().zip(&model.weights).enumerate() {
        let [low, high] = model.weights_95[index];
        say!("{threshold:>15.6}  {weight:>15.6}  {low:.6} .. {high:.6}");
    }
    if model.input_gain != 0.0 {
        say!("input gain {:.6} {output}/{input} ({:?} operators)", model.input_gain, fit.family);
    }
    say!("constant {:.6} {output}, rest input {} {input}", model.constant, model.rest_input);
    if model.input_path.dead_time_s > 0.0 || model.input_path.lag_time_constant_s > 0.0 {
        say!("dead time {:.4} s, lag {:.4} s", model.input_path.dead_time_s, model.input_path.lag_time_constant_s);
    }
    if let Some([low, middle, high]) = fit.curve_slopes {
        say!("slope of the curve at the low end {low:.3}, in the middle {middle:.3}, at the high end {high:.3}");
    }
    if fit.searched_every > 1 {
        let every = fit.searched_every;
        say!(
            "note: thresholds were searched on one sample in {every}, weights and intervals are those of all; --every-sample searches on all"
        );
    }
    let gaps: usize = recordings.iter().map(|recording| recording.gaps.len()).sum();
    if gaps > 0 {
        say!("note: {gaps} gap(s) in time; the model runs across them as if the input had gone straight");
    }
    say!(
        "rmse {:.3e} {output}, {:.3} % of the range, {} samples -> {}",
        fit.rmse,
        100.0 * fit.nrmse,
        model.provenance.samples,
        arguments.out.display()
    );
}

fn print_kinds(kinds: &[Judged], chosen: usize, unit: &str) {
    let Some(taken) = kinds.get(chosen) else {
        say!("no error on the next recording is known: the recordings are too short, or too long, to fit parts of them");
        return;
    };
    for (index, kind) in kinds.iter().enumerate().filter(|_| kinds.len() > 1) {
        let mark = if index == chosen { "  <- chosen" } else { "" };
        say!("{:>12.6} {unit} on what was left out: {}{mark}", kind.cv_rmse, kind.name);
    }
    let [low, high] = taken.cv_interval;
    say!("expect {:.4e} {unit} on the next recording, {low:.3e} to {high:.3e} with 95 %", taken.cv_rmse);
}

fn choice(text: &str) -> Result<Choice, String> {
    if text == "auto" {
        return Ok(Choice::Auto);
    }
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value >= 0.0 => Ok(Choice::Given(value)),
        _ => Err("a time in seconds, zero or positive, or `auto` is wanted".to_owned()),
    }
}
