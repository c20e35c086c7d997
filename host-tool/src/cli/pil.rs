//! `catheter pil`: processor in the loop.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use model_export::link::settings::Settings;
use serde::Serialize;
use sha2::{Digest, Sha256};

use super::{Outcome, Results};
use crate::backend::{BOARD_MODEL, Backend, EMULATED_BOARD, Rig, Simulated};
use crate::excitation::{self, ExcitationConfig, Limits, Segment, Signal};
use crate::experiment::{self, OverTheLink};
use crate::link::{Client, FlashMemory, fault_in_words};
use crate::plant::Plant;
use crate::recording;
use crate::replay_log::{self, Event, ReplayLog};
use crate::{output, report, say};

/// Run a closed-loop experiment with the whole firmware logic as ARM code in QEMU, once more in this process, and compare every tick.
///
/// Tick, supervisor, link, storage and model run as ARM code; valve, muscle, sensors and watchdog are simulated; the host plays an
/// excitation over the link. Every output of every tick and every byte on the link must be the same in both runs, to the bit. With
/// `--backend board-model` the flashable image runs, drivers and all, on a model of the chip, and every output of its ticks must be the same
/// when this process runs them again.
#[derive(clap::Args)]
pub struct Arguments {
    /// The model that runs on both.
    #[arg(long, value_name = "FILE")]
    blob: PathBuf,
    /// The excitation; decaying sines of the paper when absent.
    #[arg(long, value_name = "FILE")]
    excitation: Option<PathBuf>,
    /// Length of the built-in excitation, in s.
    #[arg(long, default_value_t = 20.0, value_name = "S", conflicts_with = "excitation")]
    seconds: f64,
    /// What moves the simulated tip.
    #[arg(long, default_value = "pi", value_name = "FILE|pi|all-effects")]
    plant: String,
    /// Seed of the sensors' noise.
    #[arg(long, default_value_t = 1, value_name = "N")]
    seed: u64,
    /// What runs the ARM code.
    #[arg(long, value_enum, default_value_t = Target::Qemu)]
    backend: Target,
    /// The image that runs there, if it is not where cargo leaves it.
    #[arg(long, value_name = "FILE")]
    image: Option<PathBuf>,
    /// Leave the recording of the ARM run here, and its replay log beside it.
    #[arg(long, value_name = "FILE", value_parser = output::file_argument(".csv"))]
    out: Option<PathBuf>,
    #[command(flatten)]
    results: Results,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Target {
    /// The firmware's logic in the emulator; everything is compared.
    Qemu,
    /// The flashable image on a model of its chip; this process runs again what it tells of its ticks, and compares their outputs.
    BoardModel,
}

/// The first tick in which the two logs differ.
#[derive(Serialize)]
struct FirstDifference {
    tick: usize,
    host: String,
    target: String,
}

#[derive(Serialize)]
struct Written {
    identical: bool,
    ticks: usize,
    samples: usize,
    first_difference: Option<FirstDifference>,
    host_sha256: String,
    target_sha256: String,
    blob_sha256: Option<String>,
    fault: Option<String>,
    wall_seconds: f64,
}

/// Runs the command.
///
/// # Errors
/// When an input is missing, or QEMU or its image.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    let excitation = match &arguments.excitation {
        Some(path) => excitation::read(path)?,
        None => built_in(arguments.seconds)?,
    };
    excitation.sample_within(&Limits::default())?;
    let plant = Plant::named(&arguments.plant)?;
    let inputs: Vec<PathBuf> = std::iter::once(&arguments.blob).chain(&arguments.excitation).cloned().collect();
    let outputs: Vec<&Path> = arguments.out.as_deref().into_iter().chain(arguments.results.files()).collect();
    output::refuse_overwriting(&inputs, &outputs)?;
    arguments.out.iter().try_for_each(|path| output::refuse_any(&path.with_extension("journal")))?;
    let bytes = crate::output::read(&arguments.blob).with_context(|| format!("{}: cannot be read", arguments.blob.display()))?;
    // The comparison of laser and model is off: the blob need not belong to the simulated plant.
    let settings = Settings { mismatch_displacement_mm: 0.0, ..Settings::default() };
    let flash = FlashMemory::with_model(&bytes).with_context(|| arguments.blob.display().to_string())?.with_settings(&settings)?;

    let begun = Instant::now();
    let simulated = || {
        let mut simulated = Simulated::around(&plant, arguments.seed, flash.clone(), EMULATED_BOARD);
        simulated.image.clone_from(&arguments.image);
        Ok(simulated)
    };
    let (target, outcome, host_sha256, difference) = match arguments.backend {
        Target::Qemu => {
            let (target, outcome) = experiment_on(Rig::open(&Backend::Qemu, simulated)?, &excitation)?;
            let (host, _) = experiment_on(Rig::open(&Backend::Virtual, simulated)?, &excitation)?;
            let difference = first_difference(&host, &target);
            (target, outcome, digest(&host)?, difference)
        }
        Target::BoardModel => {
            let mut client = Client::connect(Rig::open(&Backend::BoardModel, simulated)?)?;
            experiment::settle(&mut client)?;
            let over_the_link = OverTheLink { backend: BOARD_MODEL, blob: Some(&bytes) };
            let outcome = experiment::record(&mut client, &excitation, &Limits::default(), Some(over_the_link))?;
            let target = outcome.replay_log.clone().context("the device told no replay log")?;
            let replay = replay_log::replay(&target)?;
            ensure!(
                replay.cut.is_none(),
                "the replay log of the device is not complete: {}",
                replay.cut.map_or_else(String::new, |cut| cut.in_words())
            );
            let difference = replay.first_difference.map(|difference| FirstDifference {
                tick: usize::try_from(difference.tick).unwrap_or(usize::MAX),
                host: format!("{:?}", difference.replayed),
                target: format!("{:?}", difference.recorded),
            });
            // What came out equal has the same digest.
            let sha256 = if difference.is_none() { digest(&target)? } else { String::new() };
            (target, outcome, sha256, difference)
        }
    };
    let wall_seconds = begun.elapsed().as_secs_f64();

    let written = Written {
        identical: difference.is_none(),
        ticks: target.ticks(),
        samples: outcome.samples.len(),
        first_difference: difference,
        host_sha256,
        target_sha256: digest(&target)?,
        blob_sha256: target.header.blob_sha256(),
        fault: outcome.fault.as_ref().map(|record| fault_in_words(record.first)),
        wall_seconds,
    };
    // A run that a fault ended at once has no samples, and that is no error here.
    let recording = match &arguments.out {
        Some(path) => Some(outcome.recording(path)?),
        None => outcome.recording(Path::new("pil.csv")).ok(),
    };
    if let (Some(path), Some(recording)) = (&arguments.out, &recording) {
        recording::write(path, recording)?;
        target.write(&path.with_extension("journal"))?;
    }
    say!("{} ticks as ARM code and in this process, {} samples recorded, in {:.1} s", written.ticks, written.samples, written.wall_seconds);
    match &written.first_difference {
        None => {
            let what = match arguments.backend {
                Target::Qemu => "every output of every tick, every byte on the link",
                Target::BoardModel => "every output of every tick",
            };
            say!("identical to the bit: {what} (SHA-256 {})", &written.target_sha256[..16]);
        }
        Some(difference) => {
            say!("DIFFERENT from tick {} on\n  host   {}\n  target {}", difference.tick, difference.host, difference.target);
        }
    }
    if let Some(fault) = &written.fault {
        say!(
            "The experiment ended early with {fault}; `catheter explain {}` says what it means.",
            fault.split(' ').next().unwrap_or(fault)
        );
    }
    let lead = format!("{}: {} ticks as ARM code, compared with this process.", arguments.blob.display(), written.ticks);
    arguments.results.write("Processor in the loop", &lead, &written, |page| {
        recording.iter().for_each(|recording| report::check::picture(page, recording));
    })?;
    Ok(if written.identical && written.fault.is_none() { Outcome::Success } else { Outcome::CheckFailed })
}

/// Decaying sines of the paper's kind, of this length.
fn built_in(seconds: f64) -> Result<ExcitationConfig> {
    ensure!(seconds.is_finite() && (0.1..=3600.0).contains(&seconds), "--seconds: a length from 0.1 to 3600 s is wanted, not {seconds}");
    let signal = Signal::DescendingSine { amplitude_bar: 1.4, frequency_hz: 0.5, decay_per_s: 0.05, offset_bar: 0.0 };
    Ok(ExcitationConfig { sample_period_s: 0.02, noise_bar: 0.0, seed: 1, segments: vec![Segment { duration_s: seconds, signal }] })
}

/// The experiment on one of the two.
fn experiment_on(rig: Rig, excitation: &ExcitationConfig) -> Result<(ReplayLog, experiment::Outcome)> {
    let mut client = Client::connect(rig)?;
    let outcome = experiment::record(&mut client, excitation, &Limits::default(), None)?;
    let rig = client.into_transport();
    let replay_log = rig.replay_log().context("a simulated rig keeps a replay log")?.clone();
    Ok((replay_log, outcome))
}

fn first_difference(host: &ReplayLog, target: &ReplayLog) -> Option<FirstDifference> {
    let shown = |event: Option<&Event>| event.map_or_else(|| "nothing more".to_owned(), |event| format!("{event:?}"));
    let length = host.events.len().max(target.events.len());
    let at = (0..length).find(|&index| host.events.get(index) != target.events.get(index))?;
    let tick = host.events.iter().take(at).filter(|event| !matches!(event, Event::Boot { .. })).count();
    Some(FirstDifference { tick, host: shown(host.events.get(at)), target: shown(target.events.get(at)) })
}

/// SHA-256 of a log.
fn digest(replay_log: &ReplayLog) -> Result<String> {
    Ok(Sha256::digest(replay_log.event_bytes()?).iter().map(|byte| format!("{byte:02x}")).collect())
}
