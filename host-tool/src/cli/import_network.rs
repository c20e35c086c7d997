//! `catheter import-network`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::Serialize;

use super::{Outcome, Results};
use crate::import::options::{
    DenseActivation, InputOptions, MAX_INPUTS, NetworkInput, Options, activation, dense_activations, features, names, number, positive,
    range, signal,
};
use crate::import::{self, CheckVectors, Found, PARITY, Parity};
use crate::network::{self, Activation, Mode, Network, TrainedModel};
use crate::recording::Signal;
use crate::{output, say};

/// Most bytes of check vectors that are read.
const MOST_CHECK_BYTES: u64 = 1 << 26;

/// Make a model from a network trained in PyTorch, Keras or anything that writes ONNX.
///
/// Reads up to four LSTM, GRU and dense layers of at most 64 units and a dense output. What the model cannot represent is refused by name. With --check,
/// nothing is written unless the model computes what the framework did.
#[derive(clap::Args)]
pub struct Arguments {
    /// The network: safetensors of a PyTorch or Keras state, or an ONNX graph.
    #[arg(value_name = "FILE.safetensors|FILE.onnx")]
    file: PathBuf,
    /// The model to write.
    #[arg(long, value_name = "FILE.safetensors", value_parser = output::file_argument("safetensors"))]
    out: PathBuf,
    /// Quantity and unit of the input, for example `pressure:bar`. A plant with several inputs (four at most): once for each, and the other options
    /// that begin with the input's name, too.
    #[arg(long, value_name = "QUANTITY:UNIT", value_parser = signal)]
    input: Vec<Signal>,
    /// Quantity and unit of the output, for example `displacement:mm`.
    #[arg(long, value_name = "QUANTITY:UNIT", value_parser = signal)]
    output: Option<Signal>,
    /// Time between samples.
    #[arg(long, value_name = "S", value_parser = positive)]
    sample_period_s: Option<f64>,
    /// Smallest and largest input in training, in its unit; the check vectors' when absent.
    #[arg(long, value_name = "LOW,HIGH", value_parser = two_numbers, allow_hyphen_values = true)]
    input_range: Vec<Ends>,
    /// Smallest and largest output in training, in its unit; the check vectors' when absent.
    #[arg(long, value_name = "LOW,HIGH", value_parser = two_numbers, allow_hyphen_values = true)]
    output_range: Option<Ends>,
    /// The network saw `(input - OFFSET) / scale`; 0 when absent.
    #[arg(long, value_name = "OFFSET", value_parser = number, allow_hyphen_values = true)]
    input_offset: Vec<f64>,
    /// The network saw `(input - offset) / SCALE`; 1 when absent.
    #[arg(long, value_name = "SCALE", value_parser = positive)]
    input_scale: Vec<f64>,
    /// The network saw `(input - LOW) / (HIGH - LOW)`.
    #[arg(long, value_name = "LOW,HIGH", value_parser = two_numbers, allow_hyphen_values = true, conflicts_with_all = ["input_offset", "input_scale"])]
    input_min_max: Vec<Ends>,
    /// The network gave `(output - OFFSET) / scale`; 0 when absent.
    #[arg(long, value_name = "OFFSET", value_parser = number, allow_hyphen_values = true)]
    output_offset: Option<f64>,
    /// The network gave `(output - offset) / SCALE`; 1 when absent.
    #[arg(long, value_name = "SCALE", value_parser = positive)]
    output_scale: Option<f64>,
    /// The network gave `(output - LOW) / (HIGH - LOW)`.
    #[arg(long, value_name = "LOW,HIGH", value_parser = two_numbers, allow_hyphen_values = true, conflicts_with_all = ["output_offset", "output_scale"])]
    output_min_max: Option<Ends>,
    /// The network's inputs in their order: `input`, `difference`, and `lag:N`, the input N samples ago; `lag:9..0` is the last ten samples,
    /// the oldest first. `input2`, `difference2` and `lag2:N` are those of the second input of the plant.
    #[arg(long, value_name = "LIST", value_parser = feature_list)]
    features: Option<FeatureList>,
    /// What the difference of two samples was divided by; the scale of the input when absent.
    #[arg(long, value_name = "SCALE", value_parser = positive)]
    difference_scale: Vec<f64>,
    /// Largest change of the input from one sample to the next in training; the check vectors' when absent.
    #[arg(long, value_name = "STEP", value_parser = positive)]
    largest_step: Vec<f64>,
    /// Every output comes from the last SAMPLES, from zero state.
    #[arg(long, value_name = "SAMPLES", value_parser = clap::value_parser!(u16).range(1..), conflicts_with = "streaming")]
    window: Option<u16>,
    /// The state is carried from sample to sample.
    #[arg(long)]
    streaming: bool,
    /// Activation of the recurrent layers, where the file does not tell: `tanh`, `relu` or `hard` (-1 to 1).
    #[arg(long, value_name = "NAME", value_parser = activation)]
    activation: Option<Activation>,
    /// What follows the dense layers before the output, where the file does not tell: `tanh`, `relu`, `hard`, `sigmoid` or `linear`, one for
    /// all or one each.
    #[arg(long, value_name = "NAME,NAME", value_parser = dense_activation_list)]
    dense_activation: Option<DenseActivationList>,
    /// The layers in the order of the signal, where their widths leave a choice; the output may be left out.
    #[arg(long, value_name = "NAME,NAME", value_parser = name_list)]
    layers: Option<NameList>,
    /// CSV file with the columns `input` (`input2` and so on) and `output` as the framework computes them, in the channels' units; an optional column
    /// `sequence` changes where the state starts from zero.
    #[arg(long, value_name = "FILE.csv")]
    check: Option<PathBuf>,
    #[command(flatten)]
    results: Results,
}

// `clap` takes an array, a `Vec` or an option of them for an option that is repeated.
type Ends = Box<[f64; 2]>;
type FeatureList = std::sync::Arc<[NetworkInput]>;
type NameList = std::sync::Arc<[String]>;
type DenseActivationList = std::sync::Arc<[DenseActivation]>;

fn two_numbers(text: &str) -> Result<Ends, String> {
    range(text).map(Box::new)
}

fn feature_list(text: &str) -> Result<FeatureList, String> {
    features(text).map(Into::into)
}

fn dense_activation_list(text: &str) -> Result<DenseActivationList, String> {
    dense_activations(text).map(Into::into)
}

fn name_list(text: &str) -> Result<NameList, String> {
    names(text).map(Into::into)
}

/// What `--json` gets.
#[derive(Serialize)]
struct Summary<'a> {
    source: &'a str,
    framework: &'a str,
    units: Vec<usize>,
    /// The layers in words.
    layers: String,
    parameters: usize,
    activation: Option<Activation>,
    mode: Mode,
    written: bool,
    /// Absent without check vectors.
    check: Option<Parity>,
    tolerance_of_range: f64,
    notes: &'a [String],
}

impl Arguments {
    /// Each option as often as there are inputs, or not at all.
    fn inputs(&self) -> Result<[InputOptions; MAX_INPUTS]> {
        let mut inputs: [InputOptions; MAX_INPUTS] = Default::default();
        let given = [
            ("--input", self.input.len()),
            ("--input-range", self.input_range.len()),
            ("--input-offset", self.input_offset.len()),
            ("--input-scale", self.input_scale.len()),
            ("--input-min-max", self.input_min_max.len()),
            ("--difference-scale", self.difference_scale.len()),
            ("--largest-step", self.largest_step.len()),
        ];
        for (option, count) in given {
            anyhow::ensure!(count <= MAX_INPUTS, "{option} is given {count} times; a model has at most {MAX_INPUTS} inputs");
        }
        for (index, input) in inputs.iter_mut().enumerate() {
            let ends = self.input_min_max.get(index);
            *input = InputOptions {
                signal: self.input.get(index).cloned(),
                range: self.input_range.get(index).map(|range| **range),
                offset: self.input_offset.get(index).copied().or(ends.map(|ends| ends[0])),
                scale: self.input_scale.get(index).copied().or(ends.map(|ends| ends[1] - ends[0])),
                difference_scale: self.difference_scale.get(index).copied(),
                largest_step: self.largest_step.get(index).copied(),
            };
        }
        Ok(inputs)
    }

    fn options(&self) -> Result<Options> {
        let offset = |given: Option<f64>, ends: &Option<Ends>| given.or(ends.as_ref().map(|ends| ends[0]));
        let scale = |given: Option<f64>, ends: &Option<Ends>| given.or(ends.as_ref().map(|ends| ends[1] - ends[0]));
        Ok(Options {
            inputs: self.inputs()?,
            output: self.output.clone(),
            sample_period_s: self.sample_period_s,
            output_range: self.output_range.as_deref().copied(),
            output_offset: offset(self.output_offset, &self.output_min_max),
            output_scale: scale(self.output_scale, &self.output_min_max),
            features: self.features.as_deref().map(<[NetworkInput]>::to_vec),
            mode: match self.window {
                Some(length) => Some(Mode::Window { length: length.into() }),
                None => self.streaming.then_some(Mode::Streaming),
            },
            activation: self.activation,
            dense_activation: self.dense_activation.as_deref().map(<[DenseActivation]>::to_vec),
            layers: self.layers.as_deref().map(<[String]>::to_vec),
            framework: None,
        })
    }
}

/// Runs the command.
///
/// # Errors
/// On bad input.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let path = arguments.file.display();
    let inputs: Vec<PathBuf> = [Some(&arguments.file), arguments.check.as_ref()].into_iter().flatten().cloned().collect();
    let outputs: Vec<&Path> = std::iter::once(arguments.out.as_path()).chain(arguments.results.files()).collect();
    output::refuse_overwriting(&inputs, &outputs)?;
    let mut found = import::read(&arguments.file, arguments.options()?).with_context(|| path.to_string())?;
    let check = arguments.check.as_deref().map(|path| vectors(path, &found)).transpose()?;
    let model = found.model(check.as_ref()).with_context(|| path.to_string())?;
    let parity = check.as_ref().map(|check| check.compare(&model)).transpose().with_context(|| path.to_string())?;
    let passed = parity.is_none_or(|parity| parity.passed);
    if passed {
        network::save(&arguments.out, &model)?;
    }
    print(arguments, &found, &model, parity);
    let network = model.network.as_ref();
    let summary = Summary {
        source: found.network.kind,
        framework: &model.provenance.preset,
        units: network.map_or_else(Vec::new, |network| network.layers.iter().map(|layer| layer.units).collect()),
        layers: network.map_or_else(String::new, Network::described),
        parameters: network.map_or(0, network::Network::parameters),
        activation: network.map(|network| network.activation),
        mode: model.mode,
        written: passed,
        check: parity,
        tolerance_of_range: PARITY,
        notes: &found.notes,
    };
    let lead =
        format!("{}: {}.", path, if passed { "it computes what the framework does, as far as it was checked" } else { "the check failed" });
    arguments.results.write("An imported network", &lead, &summary, |_| {})?;
    Ok(if passed { Outcome::Success } else { Outcome::CheckFailed })
}

fn vectors(path: &Path, found: &Found) -> Result<CheckVectors> {
    let shown = || path.display().to_string();
    let length = std::fs::metadata(path).with_context(shown)?.len();
    anyhow::ensure!(length <= MOST_CHECK_BYTES, "{}: {length} bytes of check vectors, some hundred rows are enough", path.display());
    let bytes = output::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let inputs: Vec<Option<&Signal>> =
        found.options.inputs[..found.options.named_inputs()?.max(1)].iter().map(|input| input.signal.as_ref()).collect();
    Ok(CheckVectors::parse(&bytes, path, &inputs, found.options.output.as_ref())?)
}

fn print(arguments: &Arguments, found: &Found, model: &TrainedModel, parity: Option<Parity>) {
    let unit = &model.output.unit;
    if parity.is_none_or(|parity| parity.passed) {
        let time = match model.mode {
            Mode::Streaming => "streaming".to_owned(),
            Mode::Window { length } => format!("window of {length}"),
        };
        let layers = model.network.as_ref().map_or_else(String::new, Network::described);
        say!("{}: {}, {layers}, {time}", arguments.out.display(), model.provenance.preset);
    }
    for note in &found.notes {
        say!("note: {note}");
    }
    match parity {
        None => say!("not checked: give --check with what the framework computes"),
        Some(parity) if parity.passed => say!(
            "check passed: {} samples, largest difference {:.2e} {unit}, {:.2e} of the range; allowed {PARITY:.0e}",
            parity.samples,
            parity.largest,
            parity.largest_of_range
        ),
        Some(parity) => {
            say!(
                "check failed, nothing written: at sample {} the framework has {} {unit}, the model {}; that is {:.2e} of the range, allowed {PARITY:.0e}",
                parity.at_sample,
                parity.expected,
                parity.computed,
                parity.largest_of_range
            );
            say!("look at the offsets and scales, --features, --difference-scale, --window, and whether the vectors start from zero state");
        }
    }
}
