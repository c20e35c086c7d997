//! `catheter dashboard`.

use std::ffi::OsString;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use ::dashboard::{Config, JobKind, Jobs, Opener, Problem, Role, Server, Tls};
use anyhow::{Context, Result};
use clap::Args;

use super::Outcome;
use crate::backend::{Backend, EMULATED_BOARD, Rig, Simulated, VIRTUAL_BOARD};
use crate::link::{FlashMemory, Hardware, InProcess, Lockstep};
use crate::operate::{Line, OperatedRig};
use crate::plant::Plant;
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
    if !matches!(arguments.backend, Backend::Serial(_)) {
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
    };
    let server = Server::bind(config)?;
    let addresses = server.addresses();
    let first = addresses.first().map(|(_, address)| address.clone()).context("no role is given out")?;
    // Scripts read it, with --quiet, too.
    output::print_bytes(format!("listening on {first}\n").as_bytes());
    for (role, address) in addresses.iter().skip(1) {
        say!("to {} only: {address}", role.name());
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
    let Arguments { backend, plant, flash, image, seed, rate_hz, .. } = arguments;
    let (backend, plant, image, seed, telemetry_ms) = (backend.clone(), plant.clone(), image.clone(), *seed, 1000 / rate_hz);
    let flash = flash.as_deref().map_or_else(|| Ok(FlashMemory::default()), FlashMemory::read)?;
    let simulated = move || -> Result<Simulated> {
        let board = if backend == Backend::Qemu { EMULATED_BOARD } else { VIRTUAL_BOARD };
        let mut simulated = Simulated::around(&Plant::named(&plant)?, seed, flash.clone(), board);
        simulated.image.clone_from(&image);
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
            Ok(Box::new(OperatedRig::new(line, &plant, telemetry_ms)?))
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

/// What can be computed of recordings.
const KINDS: &[JobKind] = &[
    JobKind { name: "check", title: "Check: what is in them", arguments: check, report: "report.html" },
    JobKind { name: "identify", title: "Identify: play operators", arguments: identify, report: "report.html" },
    JobKind { name: "fit", title: "Fit: the ladder of models", arguments: fit, report: "report.html" },
    JobKind { name: "discover", title: "Discover: what the simulation lacks", arguments: discover, report: "report.html" },
];

fn line(command: &str, data: &[PathBuf], rest: &[(&str, &Path)]) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = vec![command.into(), "--data".into()];
    arguments.extend(data.iter().map(OsString::from));
    arguments.extend(rest.iter().flat_map(|(option, path)| [OsString::from(option), path.as_os_str().to_owned()]));
    arguments
}

fn check(data: &[PathBuf], folder: &Path) -> Vec<OsString> {
    line("check", data, &[("--html", &folder.join("report.html"))])
}

fn identify(data: &[PathBuf], folder: &Path) -> Vec<OsString> {
    let [model, result, page] = ["model.toml", "result.json", "report.html"].map(|name| folder.join(name));
    line("identify", data, &[("--out", &model), ("--json", &result), ("--html", &page)])
}

fn fit(data: &[PathBuf], folder: &Path) -> Vec<OsString> {
    line("fit", data, &[("--out", folder)])
}

fn discover(data: &[PathBuf], folder: &Path) -> Vec<OsString> {
    line("discover", data, &[("--out", folder)])
}
