//! `catheter track`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use model_export::link::settings::{INFO, SettingValue, by_name};
use serde::Serialize;

use super::{Common, Outcome};
use crate::link::{Client, Serial};
use crate::track::compare::{self, Run};
use crate::track::rig::Truth;
use crate::track::{Controller, Figures, Reach, Reference, SettingValues, controller, reference, rig_settings};
use crate::{output, report, say};

/// Follow a reference with one controller after the other.
///
/// On the virtual rig the controllers are first tuned on recordings made there, unless `--settings` and `--model` bring what `catheter
/// tune` wrote. Errors are those of the true tip, which only a virtual rig can show; on a board they are the laser's.
#[derive(clap::Args)]
#[command(after_long_help = "\
References: steps, a, b, c, d (the paper's families), point-to-point, hand (synthetic), or a CSV file with time_s,reference_mm.

Examples:
  catheter track --reference point-to-point --controllers open-loop,physics-inverse,sensorless --json tracking.json
  catheter track --reference a --controllers pid,physics-inverse+pid --report tracking.html --seed 7
  catheter track --backend serial --port /dev/ttyACM0 --settings tuned/settings.toml --model tuned/control.blob --reference path.csv --controllers physics-inverse+pid")]
pub struct Arguments {
    /// Where to run.
    #[arg(long, value_enum, default_value_t = Backend::Virtual)]
    backend: Backend,
    /// Serial port of the board.
    #[arg(long, value_name = "PORT", required_if_eq("backend", "serial"))]
    port: Option<PathBuf>,
    /// The virtual rig.
    #[arg(long, value_enum, default_value_t = Preset::AllEffects)]
    preset: Preset,
    /// Name of a reference, or a CSV file.
    #[arg(long, value_name = "FILE|NAME")]
    reference: String,
    /// Names of controllers, separated by commas.
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', required = true, value_parser = super::tune::controller_names())]
    controllers: Vec<String>,
    /// Settings that `catheter tune` wrote.
    #[arg(long, value_name = "FILE.toml", requires = "model")]
    settings: Option<PathBuf>,
    /// The model that `catheter tune` wrote; for learned-inverse, an inverse model.
    #[arg(long, value_name = "FILE.blob", requires = "settings")]
    model: Option<PathBuf>,
    /// Lowest and highest displacement of a named reference, mm; where the recordings lay when absent.
    #[arg(long, value_name = "LOW,HIGH", value_parser = parse_reach)]
    reach_mm: Option<Reach>,
    /// Write a page with plots.
    #[arg(long, value_name = "FILE.html", value_parser = output::file_argument("html"))]
    report: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Backend {
    /// The firmware in this process around a simulated rig.
    Virtual,
    /// A board.
    Serial,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Preset {
    /// Every effect of the discovery catalogue at realistic strength, and a heartbeat.
    AllEffects,
}

#[derive(Serialize)]
struct Summary<'a> {
    controllers: Vec<&'a Figures>,
}

/// Runs the command.
///
/// # Errors
/// On bad input, or when the device refuses.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let chosen: Vec<Controller> = arguments.controllers.iter().filter_map(|name| controller(name)).collect();
    if arguments.model.is_none() && chosen.iter().any(|controller| controller.name == "learned-inverse") {
        bail!("learned-inverse needs an inverse model; train one with input and output exchanged and give it with --model and --settings");
    }
    let given = match (&arguments.settings, &arguments.model) {
        (Some(settings), Some(model)) => {
            Some((read_settings(settings)?, std::fs::read(model).with_context(|| format!("cannot read {}", model.display()))?))
        }
        _ => None,
    };
    let seed = arguments.common.seed;
    let (name, runs) = match (arguments.backend, given) {
        (Backend::Virtual, None) => {
            let (tuned, _) = compare::tune_virtual_rig(seed, seed)?;
            let reference = the_reference(arguments, Some(tuned.reach))?;
            let runs = compare::on_the_virtual_rig(&tuned, seed, &reference, &chosen)?;
            (reference.name, runs)
        }
        (Backend::Virtual, Some((settings, blob))) => {
            let reference = the_reference(arguments, None)?;
            let one = |controller: &Controller| -> Result<Run> {
                let (mut client, truth) = crate::track::rig::in_process(seed, 1)?;
                let settings = with(settings.clone(), *controller);
                Ok(compare::run_one(&mut client, &truth, &settings, Some(&blob), *controller, &reference)?)
            };
            let runs: Vec<Run> = chosen.iter().map(one).collect::<Result<_>>()?;
            (reference.name, runs)
        }
        (Backend::Serial, None) => bail!("a board needs --settings and --model; `catheter tune` makes both from a recording"),
        (Backend::Serial, Some((settings, blob))) => {
            let reference = the_reference(arguments, None)?;
            let port = arguments.port.as_deref().context("--port is needed")?;
            let mut client = Client::connect(Serial::open(&port.to_string_lossy())?)?;
            let mut runs = Vec::new();
            for (index, controller) in chosen.iter().enumerate() {
                let model = (index == 0).then_some(blob.as_slice());
                let settings = with(settings.clone(), *controller);
                runs.push(compare::run_one(&mut client, &Truth::default(), &settings, model, *controller, &reference)?);
            }
            (reference.name, runs)
        }
    };
    print(&name, &runs);
    if let Some(path) = &arguments.common.json {
        output::write_json(path, &Summary { controllers: runs.iter().map(|run| &run.figures).collect() })?;
    }
    if let Some(path) = &arguments.report {
        let rig = if arguments.backend == Backend::Virtual { "the all-effects rig" } else { "a board" };
        output::write_atomic(path, report::track::page(&name, rig, &runs).as_bytes())?;
    }
    Ok(Outcome::Success)
}

/// The settings of a controller on top of those given.
fn with(mut settings: SettingValues, controller: Controller) -> SettingValues {
    let mut all = rig_settings();
    let chosen = controller.settings();
    settings.retain(|(number, _)| !chosen.iter().any(|(taken, _)| taken == number));
    all.extend(settings);
    all.extend(chosen);
    all
}

/// Two displacements with a comma between them.
fn parse_reach(text: &str) -> Result<Reach, String> {
    let number = |text: &str| text.trim().parse::<f64>().ok().filter(|value| value.is_finite());
    let bounds = text.split_once(',').and_then(|(low, high)| Some((number(low)?, number(high)?)));
    match bounds {
        Some((low_mm, high_mm)) if low_mm < high_mm => Ok(Reach { low_mm, high_mm }),
        Some((low_mm, high_mm)) => Err(format!("{low_mm} is not below {high_mm}")),
        None => Err("two numbers are wanted, for example 3,9".to_owned()),
    }
}

fn the_reference(arguments: &Arguments, reach: Option<Reach>) -> Result<Reference> {
    if reference::NAMES.contains(&arguments.reference.as_str()) {
        let reach = arguments.reach_mm.or(reach).context("a named reference needs --reach-mm LOW,HIGH when the settings are given")?;
        return reference::named(&arguments.reference, reach, arguments.common.seed).context("no such reference");
    }
    let path = Path::new(&arguments.reference);
    if !path.exists() {
        bail!("{}: is neither a file nor one of {}", path.display(), reference::NAMES.join(", "));
    }
    reference::from_file(path)
}

/// Settings by name from a file.
fn read_settings(path: &Path) -> Result<SettingValues> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let table: toml::Table = toml::from_str(&text).with_context(|| format!("{}: is no TOML", path.display()))?;
    let mut settings = Vec::new();
    for (name, value) in &table {
        let info = by_name(name).with_context(|| format!("{}: there is no setting {name:?}; there are {}", path.display(), INFO.len()))?;
        let value = match (info.default, value) {
            (SettingValue::Float(_), toml::Value::Float(number)) => SettingValue::Float(*number as f32),
            (SettingValue::Float(_), toml::Value::Integer(number)) => SettingValue::Float(*number as f32),
            (SettingValue::Integer(_), toml::Value::Integer(number)) => {
                SettingValue::Integer(u32::try_from(*number).with_context(|| format!("{}: {name} is {number}", path.display()))?)
            }
            (SettingValue::Flag(_), toml::Value::Boolean(flag)) => SettingValue::Flag(*flag),
            _ => bail!("{}: {name} has the wrong type", path.display()),
        };
        settings.push((info.number, value));
    }
    Ok(settings)
}

fn print(reference: &str, runs: &[Run]) {
    say!("reference {reference}");
    say!("controller             RMSE [mm]  largest [mm]  settling [s]  overshoot [mm]  effort [bar/s]  limited");
    for run in runs {
        let figures = &run.figures;
        let settling = figures.settling_s.map_or_else(|| "-".to_owned(), |settling| format!("{settling:.3}"));
        say!(
            "{:<22} {:>9.4}  {:>12.4}  {settling:>12}  {:>14.4}  {:>14.3}  {:>5.1} %",
            figures.name,
            figures.rmse_mm,
            figures.max_mm,
            figures.overshoot_mm,
            figures.effort_bar_per_s,
            100.0 * figures.limited_share
        );
    }
}
