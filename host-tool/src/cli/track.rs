//! `catheter track`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use model_export::link::settings::SettingValue;
use serde::Serialize;

use super::{Common, Outcome};
use crate::backend::{BOARD_MODEL, Backend, Rig};
use crate::interrupt;
use crate::link::{Client, FlashMemory, InProcess, Processor};
use crate::replay_log::Tracing;
use crate::track::beyond::{Beyond, beyond};
use crate::track::compare::{self, Run};
use crate::track::missed::missed;
use crate::track::rig::{self, Mover, REALISTIC, Truth};
use crate::track::{Controller, Figures, Reach, Reference, SettingValues, controller, reference, rig_settings, run, setting};
use crate::tune::Tuned;
use crate::{output, recording, report, say, setting_words};

/// Follow a reference with one controller after the other.
///
/// On the virtual rig the controllers are first tuned on recordings made there, unless `--settings` and `--model` bring what `catheter
/// tune` wrote. Errors are those of the true tip, which only a virtual rig can show; on a board they are the laser's.
#[derive(clap::Args)]
#[command(after_long_help = "\
References: steps, a, b, c, d (the paper's families), point-to-point, hand (synthetic), or a CSV file with time_s,reference_mm.

Examples:
  catheter track --reference point-to-point --controllers open-loop,physics-inverse,sensorless --json tracking.json
  catheter track --reference a --controllers pid,physics-inverse+pid --html tracking.html --seed 7
  catheter track --backend qemu --reference steps --controllers sensorless
  catheter track --backend board-model --reference steps --controllers sensorless
  catheter track --backend serial:/dev/ttyACM0 --settings tuned/settings.toml --model tuned/control.blob --reference path.csv --controllers physics-inverse+pid")]
pub struct Arguments {
    /// Where to run: virtual (in this process), qemu (as ARM code), board-model (the flashable image on a model of its chip), serial:PORT, or serial
    /// for the one port at which a board answers.
    #[arg(long, default_value = "virtual", env = "CATHETER_BACKEND", value_name = "virtual|qemu|board-model|serial[:PORT]")]
    backend: Backend,
    /// As `--backend serial:PORT`.
    #[arg(long, value_name = "PORT", hide = true)]
    port: Option<PathBuf>,
    /// The image that the emulator or the board's model runs, if it is not where cargo leaves it.
    #[arg(long, value_name = "FILE")]
    image: Option<PathBuf>,
    /// What moves the tip of a simulated rig: `realistic` (a pneumatic muscle in continuous time, every effect at the strength that a bench
    /// may have, and a heartbeat; drawn from the seed), or a plant as everywhere.
    #[arg(long, alias = "preset", default_value = REALISTIC, value_name = "FILE|realistic|pi|all-effects")]
    plant: String,
    /// Name of a reference, or a CSV file.
    #[arg(long, value_name = "FILE|NAME")]
    reference: String,
    /// Names of controllers, separated by commas.
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', required = true, value_parser = super::tune::controller_names())]
    controllers: Vec<String>,
    /// Settings that `catheter tune` wrote.
    #[arg(long, value_name = "FILE.toml", requires = "model")]
    settings: Option<PathBuf>,
    /// The model that `catheter tune` wrote, or `result/model` of `catheter fit`: the blob beside it is taken.
    #[arg(long, value_name = "FILE", requires = "settings")]
    model: Option<PathBuf>,
    /// The model of learned-inverse: `catheter train --inverse`, exported with `--compensation`.
    #[arg(long, value_name = "FILE.blob")]
    inverse_model: Option<PathBuf>,
    /// How far ahead the inverse model is shown the reference, ms; `catheter train --inverse` says it.
    #[arg(long, value_name = "MS", default_value_t = 130, value_parser = clap::value_parser!(u32).range(0..=500))]
    look_ahead_ms: u32,
    /// Leave a replay log of every run in this folder, for `catheter replay`. A board tells it over the link, for which it begins each run as
    /// after a start.
    #[arg(long, value_name = "DIR")]
    journals: Option<PathBuf>,
    /// Leave every run as a recording in this folder: output, tip, reference, what was measured and estimated, and whether the limiter held back.
    #[arg(long, value_name = "DIR")]
    csv: Option<PathBuf>,
    /// Leave the recordings and the model of the tuning on the virtual rig in this folder.
    #[arg(long, value_name = "DIR", conflicts_with = "settings")]
    keep: Option<PathBuf>,
    /// Lowest and highest displacement of a named reference, mm; where the recordings lay when absent. With `--settings` it is needed.
    #[arg(long, value_name = "LOW,HIGH", value_parser = parse_reach)]
    reach_mm: Option<Reach>,
    #[command(flatten)]
    common: Common,
}

/// The controller whose model runs the other way round.
const LEARNED: &str = "learned-inverse";

#[derive(Serialize)]
struct Summary<'a> {
    controllers: Vec<&'a Figures>,
    /// Models that the reference asks for more than they were made from.
    beyond_range: &'a [Beyond],
    /// Controllers that did not follow at all, in sentences.
    missed: &'a [String],
}

impl Arguments {
    /// The backend, with the port that `--port` names.
    fn backend(&self) -> Result<Backend> {
        let Some(port) = &self.port else { return Ok(self.backend.clone()) };
        match self.backend {
            Backend::AnySerial => Ok(Backend::Serial(port.to_string_lossy().into_owned())),
            _ => bail!("--port is for --backend serial; --backend serial:PORT says both"),
        }
    }
}

/// The blob of a model: the file itself, or the one that `catheter fit` left beside it.
fn read_model(path: &Path) -> Result<Vec<u8>> {
    let read = |path: &Path| output::read(path).with_context(|| format!("cannot read {}", path.display()));
    let bytes = read(path)?;
    if bytes.starts_with(&model_export::blob::MAGIC) {
        return Ok(bytes);
    }
    let mut beside = path.as_os_str().to_owned();
    beside.push(".blob");
    let beside = PathBuf::from(beside);
    if !beside.is_file() {
        bail!(
            "{} is no blob, and there is no {}: `catheter export` makes one where the model fits the board",
            path.display(),
            beside.display()
        );
    }
    say!("{} runs on the desktop; the board gets {}", path.display(), beside.display());
    read(&beside)
}

/// Runs the command.
///
/// # Errors
/// On bad input, or when the device refuses.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    check_reference(&arguments.reference)?;
    let backend = arguments.backend()?;
    let chosen: Vec<Controller> = arguments.controllers.iter().filter_map(|name| controller(name)).collect();
    if arguments.inverse_model.is_none() && chosen.iter().any(|controller| controller.name == LEARNED) {
        bail!("{LEARNED} needs --inverse-model: an inverse model, made by `catheter train --inverse` and `catheter export`");
    }
    let read = |path: &PathBuf| output::read(path).with_context(|| format!("cannot read {}", path.display()));
    let inverse = arguments.inverse_model.as_ref().map(read).transpose()?;
    let look_ahead = setting("control.learned_look_ahead_ms", SettingValue::Integer(arguments.look_ahead_ms));
    let given = match (&arguments.settings, &arguments.model) {
        (Some(settings), Some(model)) => Some(Control::Given { settings: read_settings(settings)?, blob: read_model(model)? }),
        _ => None,
    };
    refuse_replacing(arguments, &chosen)?;
    let mover = Mover::named(&arguments.plant).context("--plant takes `realistic`, too")?;
    let seed = arguments.common.seed;
    let (reference, beyond, runs) = match &backend {
        board if board.is_board() => {
            let Some(control) = given else { bail!("a board needs --settings and --model; `catheter tune` makes both from a recording") };
            let reference = the_reference(arguments, None)?;
            let beyond = what_is_beyond(&control, &chosen, inverse.as_deref(), &reference);
            interrupt::watch();
            let mut client = Client::connect(Rig::open(board, || bail!("a board is not simulated"))?)?;
            let mut loaded: Option<&[u8]> = None;
            let one = |controller: &Controller| -> Result<Run> {
                let mut settings = control.settings(*controller);
                settings.push(look_ahead);
                let blob = control.blob_for(*controller, inverse.as_deref());
                // A model stays on the board until another is wanted.
                let fresh = Some(blob).filter(|blob| loaded != Some(*blob));
                loaded = Some(blob);
                run::prepare(&mut client, &settings, fresh)?;
                let Some(folder) = &arguments.journals else {
                    return Ok(compare::follow(&mut client, &Truth::default(), *controller, &reference)?);
                };
                let tracing = Tracing::begin(&mut client, "serial", Some(blob))?;
                let run = compare::follow(&mut client, &Truth::default(), *controller, &reference);
                // A run that went wrong is what a replay log is for.
                tracing.end(&mut client).write(&replay_log_path(folder, *controller))?;
                Ok(run?)
            };
            let runs = chosen.iter().map(one).collect::<Result<Vec<Run>>>()?;
            (reference, beyond, runs)
        }
        // Every controller gets a rig of its own that begins at rest.
        simulated => {
            let control = match given {
                Some(control) => control,
                None => {
                    let working = output::working("track", "tuning on recordings of the virtual rig");
                    let (tuned, recordings) = compare::tune_on(&mover, seed, seed)?;
                    drop(working);
                    if let Some(folder) = &arguments.keep {
                        for recording in &recordings {
                            recording::write(&folder.join("recordings").join(&recording.path), recording)?;
                        }
                        output::write_atomic(&folder.join(KEPT_MODEL), &tuned.blob)?;
                    }
                    Control::Tuned(Box::new(tuned))
                }
            };
            let reference = the_reference(arguments, control.reach())?;
            let beyond = what_is_beyond(&control, &chosen, inverse.as_deref(), &reference);
            if beyond.is_empty() {
                note_what_is_out_of_reach(&reference, control.reach());
            }
            // The same reference for each: their times are alike.
            let bar = output::progress(chosen.len() as u64, "track");
            let one = |controller: &Controller| -> Result<Run> {
                bar.set_message(controller.name);
                bar.tick();
                let mut settings = mover.settings();
                settings.extend(control.settings(*controller));
                settings.push(look_ahead);
                let blob = control.blob_for(*controller, inverse.as_deref());
                let on = Simulated { arguments, mover: &mover, settings, blob, controller: *controller, reference: &reference };
                let run = match simulated {
                    Backend::Qemu => on.run(rig::emulator(arguments.image.as_deref())?, "qemu"),
                    Backend::BoardModel => on.run_traced(rig::board_model(arguments.image.as_deref())?, BOARD_MODEL),
                    _ => on.run(InProcess::new(FlashMemory::default()), "virtual"),
                };
                bar.inc(1);
                run
            };
            let runs = chosen.iter().map(one).collect::<Result<Vec<Run>>>()?;
            bar.finish_and_clear();
            (reference, beyond, runs)
        }
    };
    let name = reference.name;
    print(&name, &runs);
    let missed: Vec<String> = runs.iter().filter_map(|run| missed(&run.figures.name, &run.samples)).collect();
    missed.iter().for_each(|one| say!("FAILED: {one}"));
    if let Some(path) = &arguments.common.results.json {
        let controllers = runs.iter().map(|run| &run.figures).collect();
        output::write_result(path, &Summary { controllers, beyond_range: &beyond, missed: &missed })?;
    }
    if let Some(folder) = &arguments.csv {
        for run in &runs {
            let path = csv_path(folder, &run.figures.name);
            recording::write(&path, &run.recording(&path)?)?;
        }
    }
    if let Some(path) = &arguments.common.results.html {
        let warnings: Vec<String> = beyond.iter().map(Beyond::sentence).chain(missed.iter().cloned()).collect();
        let rig = match backend {
            Backend::Virtual => format!("a simulated rig ({})", arguments.plant),
            Backend::Qemu => format!("a simulated rig ({}) around QEMU", arguments.plant),
            Backend::BoardModel => format!("a simulated rig ({}) around the board's model", arguments.plant),
            Backend::Serial(_) | Backend::AnySerial => "a board".to_owned(),
        };
        output::write_atomic(path, report::track::page(&name, &rig, &runs, &warnings).as_bytes())?;
    }
    Ok(if missed.is_empty() { Outcome::Success } else { Outcome::CheckFailed })
}

/// The model of the tuning, as `--keep` leaves it.
const KEPT_MODEL: &str = "control.blob";

fn csv_path(folder: &Path, controller: &str) -> PathBuf {
    folder.join(format!("{controller}.csv"))
}

fn replay_log_path(folder: &Path, controller: Controller) -> PathBuf {
    folder.join(format!("{}.journal", controller.name))
}

/// One run on a simulated rig.
struct Simulated<'a> {
    arguments: &'a Arguments,
    mover: &'a Mover,
    settings: SettingValues,
    blob: &'a [u8],
    controller: Controller,
    reference: &'a Reference,
}

impl Simulated<'_> {
    fn run(self, processor: impl Processor, backend: &str) -> Result<Run> {
        let Self { arguments, mover, settings, blob, controller, reference } = self;
        let seed = arguments.common.seed;
        let recorder = arguments.journals.is_some().then(|| rig::recorder(backend, mover, seed));
        let (mut client, truth) = rig::connect(processor, mover.hardware(seed, 1), &format!("the simulated rig, {backend}"), recorder)?;
        let run = compare::run_one(&mut client, &truth, &settings, Some(blob), controller, reference)?;
        let rig = client.into_transport();
        if let (Some(folder), Some(replay_log)) = (&arguments.journals, rig.observer().replay_log()) {
            replay_log.write(&replay_log_path(folder, controller))?;
        }
        Ok(run)
    }
}

impl Simulated<'_> {
    /// As [`Self::run`], with a replay log that comes over the link.
    fn run_traced(self, processor: impl Processor, backend: &str) -> Result<Run> {
        let Self { arguments, mover, settings, blob, controller, reference } = self;
        let place = format!("the simulated rig, {backend}");
        let (mut client, truth) = rig::connect(processor, mover.hardware(arguments.common.seed, 1), &place, None)?;
        let Some(folder) = &arguments.journals else {
            return Ok(compare::run_one(&mut client, &truth, &settings, Some(blob), controller, reference)?);
        };
        run::prepare(&mut client, &settings, Some(blob))?;
        let tracing = Tracing::begin(&mut client, backend, Some(blob))?;
        let run = compare::follow(&mut client, &truth, controller, reference);
        tracing.end(&mut client).write(&replay_log_path(folder, controller))?;
        Ok(run?)
    }
}

/// What the controllers are set up with.
enum Control {
    /// On recordings made just before.
    Tuned(Box<Tuned>),
    /// By files.
    Given { settings: SettingValues, blob: Vec<u8> },
}

impl Control {
    fn blob(&self) -> &[u8] {
        match self {
            Self::Tuned(tuned) => &tuned.blob,
            Self::Given { blob, .. } => blob,
        }
    }

    /// The model that a controller runs with.
    fn blob_for<'a>(&'a self, controller: Controller, inverse: Option<&'a [u8]>) -> &'a [u8] {
        inverse.filter(|_| controller.name == LEARNED).unwrap_or(self.blob())
    }

    fn reach(&self) -> Option<Reach> {
        match self {
            Self::Tuned(tuned) => Some(tuned.reach),
            Self::Given { .. } => None,
        }
    }

    /// All settings of a controller; what chooses it comes last and wins.
    fn settings(&self, controller: Controller) -> SettingValues {
        let mut all = rig_settings();
        match self {
            Self::Tuned(tuned) => all.extend(tuned.settings(controller)),
            Self::Given { settings, .. } => {
                all.extend(settings.iter().copied());
                all.extend(controller.settings());
            }
        }
        all
    }
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
    reference::from_file(Path::new(&arguments.reference))
}

/// Refuses, before any work, to replace runs that were left earlier.
fn refuse_replacing(arguments: &Arguments, chosen: &[Controller]) -> Result<()> {
    let journals = arguments.journals.iter().flat_map(|folder| chosen.iter().map(|controller| replay_log_path(folder, *controller)));
    let csv = arguments.csv.iter().flat_map(|folder| chosen.iter().map(|controller| csv_path(folder, controller.name)));
    let kept = arguments.keep.iter().map(|folder| folder.join(KEPT_MODEL));
    journals.chain(csv).chain(kept).try_for_each(|path| output::refuse_any(&path))
}

/// Refuses, before any work, a reference that is neither a name nor a file.
fn check_reference(name: &str) -> Result<()> {
    if !reference::NAMES.contains(&name) && !Path::new(name).exists() {
        bail!("--reference {name}: is neither a file nor one of {}", reference::NAMES.join(", "));
    }
    Ok(())
}

/// The rig is safe whatever it is asked for, but what the muscle cannot do nobody follows.
fn note_what_is_out_of_reach(reference: &Reference, reach: Option<Reach>) {
    let (low, high) = reference.points_mm.iter().fold((f64::MAX, f64::MIN), |(low, high), point| (low.min(*point), high.max(*point)));
    if let Some(Reach { low_mm, high_mm }) = reach
        && (low < low_mm || high > high_mm)
    {
        say!("The reference goes from {low:.2} to {high:.2} mm; the recordings show that {low_mm:.2} to {high_mm:.2} mm can be followed.");
    }
}

/// Tells, before anything moves, which of the models that the controllers run with the reference asks for more than they were made from.
fn what_is_beyond(control: &Control, chosen: &[Controller], inverse: Option<&[u8]>, reference: &Reference) -> Vec<Beyond> {
    let has = |learned: bool| chosen.iter().any(|controller| (controller.name == LEARNED) == learned);
    let models = [
        ("the model", has(false).then(|| control.blob())), //
        ("the inverse model", inverse.filter(|_| has(true))),
    ];
    let found: Vec<Beyond> = models.into_iter().filter_map(|(name, bytes)| beyond(name, bytes?, reference)).collect();
    found.iter().for_each(|one| say!("warning: {}", one.sentence()));
    found
}

/// Settings by name from a file.
fn read_settings(path: &Path) -> Result<SettingValues> {
    Ok(setting_words::read(path)?.into_iter().map(|(info, value)| (info.number, value)).collect())
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
