//! `catheter dashboard`.

use std::ffi::OsString;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use ::dashboard::{Config, Foreign, JobKind, Jobs, Loaded, Opener, Problem, Role, Server, Tls};
use anyhow::{Context, Result, ensure};
use clap::Args;

use super::Outcome;
use super::reading::is_told;
use super::rig::read_hardware;
use crate::backend::{Backend, EMULATED_BOARD, Rig, Simulated, VIRTUAL_BOARD};
use crate::link::{FlashMemory, Hardware, HardwareConfig, InProcess, Lockstep};
use crate::operate::{Controller, Line, Offers, OperatedRig};
use crate::plant::Plant;
use crate::recording::{self, ReadOptions, Signal};
use crate::report::{self, calibration::Heading};
use crate::track::{self, CONTROLLERS, Reach, reference};
use crate::{output, say};

/// Operate a rig from a page in the browser: live pressure, laser and estimate, the loop, a vent button that always works.
#[derive(Args)]
pub struct Arguments {
    /// Where the rig is: virtual (in this process), qemu (as ARM code), board-model (the flashable image on a model of its chip) or
    /// serial:PORT.
    #[arg(long, default_value = "virtual", value_name = "virtual|qemu|board-model|serial:PORT")]
    backend: Backend,
    /// What moves the tip of a simulated rig.
    #[arg(long, default_value = "pi", value_name = "FILE|pi|all-effects")]
    plant: String,
    /// Begin with the flash of a simulated rig (settings, models) from this file.
    #[arg(long, value_name = "FILE")]
    flash: Option<PathBuf>,
    /// Numbers of a simulated rig's hardware, by name (TOML): supply, valve, sensors and how they err.
    #[arg(long, value_name = "FILE.toml")]
    hardware: Option<PathBuf>,
    /// The image that the emulator or the board's model runs, if it is not where cargo leaves it.
    #[arg(long, value_name = "FILE")]
    image: Option<PathBuf>,
    /// Seed of a simulated rig's sensor noise.
    #[arg(long, default_value_t = 1, value_name = "N")]
    seed: u64,
    /// Port of the page; 0 picks a free one.
    #[arg(long, default_value_t = 8040, value_name = "N")]
    port: u16,
    /// Listen at this address instead of on this machine alone; beyond it the page is in TLS, and --role says what others may do.
    #[arg(long, value_name = "ADDR", requires = "role")]
    listen: Option<IpAddr>,
    /// The most that anybody may do who knows an address: observe (watch and vent), operate, configure (settings and models too).
    #[arg(long, value_name = "observe|operate|configure")]
    role: Option<Role>,
    /// A name under which others reach this machine; may be repeated.
    #[arg(long = "name", value_name = "HOST", requires = "listen")]
    names: Vec<String>,
    /// Certificate in PEM; without one a certificate is made for this run, and its fingerprint is printed.
    #[arg(long, value_name = "FILE", requires_all = ["key", "listen"])]
    certificate: Option<PathBuf>,
    /// The certificate's key in PEM.
    #[arg(long, value_name = "FILE", requires = "certificate")]
    key: Option<PathBuf>,
    /// Do not open a browser.
    #[arg(long)]
    no_open: bool,
    /// Folder for recordings, for what is computed of them, and for the audit log.
    #[arg(long, default_value = "sessions", value_name = "DIR")]
    folder: PathBuf,
    /// Samples a second; more than 1,000 there are none.
    #[arg(long, default_value_t = 1000, value_name = "HZ", value_parser = clap::value_parser!(u32).range(1..=1000))]
    rate_hz: u32,
}

/// Runs the command.
///
/// # Errors
/// When nothing can be served; a rig that cannot be reached is told on the page and tried again.
pub fn run(arguments: &Arguments) -> Result<Outcome> {
    // What is wrong with the command line is said before anything is served.
    if arguments.backend.is_board() {
        ensure!(arguments.hardware.is_none(), "--hardware: only on a simulated rig; {} is a board", arguments.backend.name());
    } else {
        Plant::named(&arguments.plant)?;
    }
    let tls = match (&arguments.listen, &arguments.certificate, &arguments.key) {
        (_, Some(certificate), Some(key)) => Tls::Files { certificate: certificate.clone(), key: key.clone() },
        (Some(address), ..) if !address.is_loopback() => Tls::SelfSigned,
        _ => Tls::Off,
    };
    let config = Config {
        listen: SocketAddr::new(arguments.listen.unwrap_or(IpAddr::V4(Ipv4Addr::LOCALHOST)), arguments.port),
        names: arguments.names.clone(),
        role: arguments.role.unwrap_or(Role::Configure),
        tls,
        folder: arguments.folder.clone(),
        jobs: Jobs { program: std::env::current_exe().context("this program does not find itself")?, kinds: KINDS.to_vec() },
        loader: load,
    };
    let server = Server::bind(config)?;
    let addresses = server.addresses();
    let first = addresses.first().map(|(_, address)| address.clone()).context("no role is given out")?;
    // Scripts read it, with --quiet, too.
    output::print_bytes(format!("listening on {first}\n").as_bytes());
    for (role, address) in addresses.iter().skip(1) {
        say!("to {} only: {address}", role.name());
    }
    if let Some(address) = server.viewer_address() {
        say!("to Foxglove and PlotJuggler: {address}");
    }
    if let Some(fingerprint) = server.fingerprint() {
        say!("certificate, SHA-256: {fingerprint}");
    }
    say!("recordings and audit log in {}; Ctrl-C vents and ends", arguments.folder.display());
    output::finish()?;
    if !arguments.no_open {
        open_browser(&first);
    }
    server.run(opener(arguments)?)?;
    Ok(Outcome::Success)
}

/// Opens the rig, as often as it takes.
fn opener(arguments: &Arguments) -> Result<Opener> {
    let Arguments { backend, plant, flash, hardware, image, seed, rate_hz, .. } = arguments;
    let (backend, plant, image, seed, telemetry_ms) = (backend.clone(), plant.clone(), image.clone(), *seed, 1000 / rate_hz);
    let flash = flash.as_deref().map_or_else(|| Ok(FlashMemory::default()), FlashMemory::read)?;
    let numbers = hardware.as_deref().map(read_hardware).transpose()?;
    let simulated = move || -> Result<Simulated> {
        let board = if backend == Backend::Qemu { EMULATED_BOARD } else { VIRTUAL_BOARD };
        let mut simulated = Simulated::around(&Plant::named(&plant)?, seed, flash.clone(), board);
        simulated.image.clone_from(&image);
        if let Some(numbers) = &numbers {
            simulated.hardware = HardwareConfig { seed: simulated.hardware.seed, ..numbers.clone() };
        }
        Ok(simulated)
    };
    let (backend, plant) = (arguments.backend.clone(), arguments.plant.clone());
    Ok(Box::new(move || {
        let open = || -> Result<Box<dyn ::dashboard::Rig>> {
            let line = if backend == Backend::Virtual {
                let Simulated { hardware, muscle, flash, board, .. } = simulated()?;
                let place = "the rig in this process";
                Line::Virtual(Box::new(Lockstep::new(InProcess::new(flash), Hardware::new(hardware, muscle), (), place, board)?))
            } else {
                Line::Other(Rig::open(&backend, &simulated)?)
            };
            Ok(Box::new(OperatedRig::new(line, &plant, telemetry_ms, OFFERS)?))
        };
        open().map_err(|error| Problem::Gone(format!("{error:#}")))
    }))
}

/// Shows the page, where there is something to show it with; the address is on standard output anyway.
fn open_browser(address: &str) {
    let opener = if cfg!(target_os = "macos") {
        "open"
    } else if cfg!(windows) {
        "explorer"
    } else {
        "xdg-open"
    };
    let _ = Command::new(opener).arg(address).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
}

/// What the page offers beyond the link.
const OFFERS: Offers = Offers {
    controllers: &CHOICE,
    references: &reference::NAMES,
    reference_period_s: reference::PERIOD_S,
    reference: |name, [low_mm, high_mm], seed| Some(reference::named(name, Reach { low_mm, high_mm }, seed)?.points_mm),
    calibration_page: |board, firmware, saved, findings, changes| {
        let date = crate::cli::rig::today();
        report::calibration::page(&Heading { board, firmware, date: &date, saved }, findings, changes)
    },
};

/// The controllers that need nothing beside one model on the device.
const CHOICE: [Controller; CONTROLLERS.len()] = {
    let mut choice = [Controller { name: "", feed_forward: 0, sensor: 0 }; CONTROLLERS.len()];
    let mut at = 0;
    while at < choice.len() {
        let track::Controller { name, feed_forward, sensor } = CONTROLLERS[at];
        choice[at] = Controller { name, feed_forward, sensor };
        at += 1;
    }
    choice
};

/// What can be computed of recordings.
const KINDS: &[JobKind] = &[
    kind("check", "Check: what is in them", check, None),
    kind("identify", "Identify: play operators", identify, Some("model.blob")),
    kind("ladder", "Fit: the ladder of models", ladder, Some("model.blob")),
    kind("fit", "Fit with networks: minutes", fit, Some("model.blob")),
    kind("discover", "Discover: what the simulation lacks", discover, None),
    JobKind { settings: Some("result.json"), ..kind("tune", "Tune: controllers", tune, Some("control.blob")) },
];

/// What lies in the folder has our own columns, whatever a lab's other files have.
const OWN_COLUMNS: [&str; 2] = ["--columns", "own"];

/// Reads a recording as every command does, and writes it as one of the rig's own: its input is the pressure and its output the displacement.
fn load(file: &Foreign<'_>, to: &Path) -> std::result::Result<Loaded, String> {
    let read = || -> Result<Loaded> {
        let map = ReadOptions::columns(file.columns).map()?;
        let mut recording = recording::parse(Path::new(file.name), file.bytes, &map)?;
        let units = [("input", &recording.input_signal, "bar"), ("output", &recording.output_signal, "mm")];
        for (role, signal, unit) in units {
            ensure!(
                signal.unit == unit,
                "{}: its {role} `{}` is in {}; recordings of a rig are in bar and mm: name its unit, as in {role}={}:{}",
                file.name,
                signal.quantity,
                signal.unit,
                signal.column(),
                if unit == "bar" { "kPa" } else { "um" }
            );
        }
        ensure!(recording.more_inputs.is_empty(), "{}: has {} inputs, and a rig has one", file.name, recording.more_inputs.len() + 1);
        (recording.input_signal, recording.output_signal) = (Signal::pressure_bar(), Signal::displacement_mm());
        let from = format!("loaded by catheter dashboard {} from {}, sha256 {}", env!("CARGO_PKG_VERSION"), file.name, recording.sha256);
        recording::write_as(to, &recording, &from)?;
        let notes = recording.notes.iter().filter(|note| is_told(note.subject)).map(|note| note.text.clone()).collect();
        let seconds = recording.time_s[recording.len() - 1] - recording.time_s[0];
        Ok(Loaded { samples: recording.len(), seconds, sha256: recording.sha256, notes })
    };
    read().map_err(|error| format!("{error:#}"))
}

type CommandLines = fn(&[PathBuf], &Path) -> Vec<Vec<OsString>>;

const fn kind(name: &'static str, title: &'static str, arguments: CommandLines, model: Option<&'static str>) -> JobKind {
    JobKind { name, title, arguments, report: "report.html", model, settings: None }
}

fn line(command: &str, data: &[PathBuf], rest: &[(&str, &Path)]) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = vec![command.into(), "--data".into()];
    arguments.extend(data.iter().map(OsString::from));
    arguments.extend(OWN_COLUMNS.map(OsString::from));
    arguments.extend(rest.iter().flat_map(|(option, path)| [OsString::from(option), path.as_os_str().to_owned()]));
    arguments
}

fn check(data: &[PathBuf], folder: &Path) -> Vec<Vec<OsString>> {
    vec![line("check", data, &[("--html", &folder.join("report.html"))])]
}

/// Identifies, and makes the model for the device.
fn identify(data: &[PathBuf], folder: &Path) -> Vec<Vec<OsString>> {
    let [model, result, page, blob] = ["model.toml", "result.json", "report.html", "model.blob"].map(|name| folder.join(name));
    let mut export: Vec<OsString> = vec!["export".into(), model.clone().into(), "--calibration".into()];
    export.extend(data.iter().map(OsString::from));
    export.extend(OWN_COLUMNS.map(OsString::from));
    export.extend(["--out".into(), blob.into_os_string()]);
    vec![line("identify", data, &[("--out", &model), ("--json", &result), ("--html", &page)]), export]
}

fn fit(data: &[PathBuf], folder: &Path) -> Vec<Vec<OsString>> {
    vec![line("fit", data, &[("--out", folder)])]
}

/// As [`fit`], without the rungs that take minutes.
fn ladder(data: &[PathBuf], folder: &Path) -> Vec<Vec<OsString>> {
    let mut arguments = line("fit", data, &[("--out", folder)]);
    arguments.push("--no-networks".into());
    vec![arguments]
}

fn discover(data: &[PathBuf], folder: &Path) -> Vec<Vec<OsString>> {
    vec![line("discover", data, &[("--out", folder)])]
}

fn tune(data: &[PathBuf], folder: &Path) -> Vec<Vec<OsString>> {
    let [result, page] = ["result.json", "report.html"].map(|name| folder.join(name));
    vec![line("tune", data, &[("--out", folder), ("--json", &result), ("--html", &page)])]
}
