//! `catheter rig firmware`: a new program over the line, without a debug probe.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use model_export::link::fault::Blocker;
use model_export::link::message::Request;
use model_export::link::state::State;
use serde::Serialize;

use super::Which;
use crate::backend::{Backend, Rig};
use crate::bootloader::{Bootloader, FLASH_BASE, ProgramImage};
use crate::cli::Outcome;
use crate::experiment;
use crate::link::{Client, Serial, Transport as _, find_board, state_name, version};
use crate::say;

/// The reply goes out, the chip resets, its bootloader starts (AN2606: some 100 ms).
const BOOTLOADER_STARTS: Duration = Duration::from_millis(300);
/// The program starts, and listens.
const PROGRAM_STARTS: Duration = Duration::from_millis(500);

/// Put a new program onto a board.
#[derive(clap::Subcommand)]
pub enum Command {
    /// Write and verify an image over the same line, by the bootloader in the chip's ROM; only while vented. Settings and models stay.
    Update(Arguments),
}

/// Which image.
#[derive(clap::Args)]
pub struct Arguments {
    /// The sealed image that `cargo xtask firmware` makes.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// The board is in its bootloader already: started with BOOT0 high, or left there by an update that failed.
    #[arg(long)]
    in_bootloader: bool,
}

#[derive(Serialize)]
struct Written {
    #[serde(rename = "seal")]
    crc: String,
    bytes: usize,
    before: Option<String>,
    after: String,
}

/// Reads an image and checks what can be checked without a board.
fn read(path: &Path) -> Result<ProgramImage> {
    let file = output::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    ProgramImage::of(&file).with_context(|| format!("{}", path.display()))
}

/// Puts the image onto the board.
pub fn update(arguments: &Arguments, which: &Which) -> Result<Outcome> {
    let image = read(&arguments.file)?;
    let found;
    let port = match &which.backend {
        Backend::Serial(port) => port,
        Backend::AnySerial if !arguments.in_bootloader => {
            found = find_board()?.place().to_owned();
            &found
        }
        _ => bail!("only a board on a serial port has a bootloader: --backend serial:PORT"),
    };
    let before = if arguments.in_bootloader { None } else { Some(leave(Client::connect(super::open(which)?)?, &image)?) };
    say!("{} bytes with the CRC {:08x} go onto the board; do not switch it off", image.bytes().len(), image.crc());
    let line = Serial::open_bootloader(port)?;
    let mut bootloader = Bootloader::connect(line)?;
    let bar = indicatif::ProgressBar::new(image.bytes().len() as u64);
    bootloader.update(&image, |written| bar.set_position(written as u64))?;
    bar.finish_and_clear();
    bootloader.go(FLASH_BASE)?;
    drop(bootloader);
    std::thread::sleep(PROGRAM_STARTS);
    let rig =
        Client::meet(super::open(which)?).context("the program is written and verified, but does not answer; power-cycle the board")?;
    let after = version(rig.hello().firmware);
    say!("written and verified; the board answers with firmware {after}");
    which.write(&Written { crc: format!("{:08x}", image.crc()), bytes: image.bytes().len(), before, after })?;
    Ok(Outcome::Success)
}

/// Makes the program at the other end give way to the bootloader; gives its version.
fn leave(mut rig: Client<Rig>, image: &ProgramImage) -> Result<String> {
    image.check_board(&rig.hello().board)?;
    let status = experiment::status(&mut rig)?;
    let is_vented = matches!(status.state, State::Idle | State::Fault) && !status.blockers.contains(Blocker::VentNotVerified);
    ensure!(
        is_vented,
        "the rig is not known to be without pressure (state `{}`): `catheter rig ... vent` first; nothing was erased",
        state_name(status.state)
    );
    let firmware = version(rig.hello().firmware);
    rig.command(&Request::EnterBootloader).context("the board does not enter its bootloader; nothing was erased")?;
    drop(rig);
    std::thread::sleep(BOOTLOADER_STARTS);
    Ok(firmware)
}
