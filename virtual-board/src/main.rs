//! `virtual-board --image FILE`: runs the image and answers on standard output what is asked on standard input.

use std::io::{BufReader, BufWriter};
use std::num::NonZeroU64;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use rigless::emulator::{Start, run};
use rigless::image::Image;
use rigless::session::Session;
use rigless::time::VirtualNanos;
use virtual_board::board::RigBoard;
use virtual_board::chip::part::Pins;
use virtual_board::log::Log;
use virtual_board::machine::Machine;

const USAGE: &str = "\
usage: virtual-board --image FILE [options]

  --image FILE        the image, sealed: target/thumbv7em-none-eabihf/release/rig, built by `cargo xtask firmware`
  --flash FILE@ADDR   what the flash holds besides, at a hexadecimal address; may be given more than once
  --seed N            seed of what memory holds without supply (default 1)
  --core-hz N         rate of the core's own timer, which does not follow the clock tree (default 168000000)

Requests on standard input, answers on standard output: see `virtual-board/src/protocol.rs`.
";

struct Arguments {
    image: PathBuf,
    flash: Vec<(PathBuf, u64)>,
    seed: u64,
    core_hz: NonZeroU64,
}

fn arguments(mut words: impl Iterator<Item = String>) -> Result<Option<Arguments>, String> {
    let mut image = None;
    let mut flash = Vec::new();
    let (mut seed, mut core_hz) = (1, const { NonZeroU64::new(168_000_000).unwrap() });
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or_else(|| format!("{word} wants a value"));
        match word.as_str() {
            "--help" | "-h" => return Ok(None),
            "--image" => image = Some(PathBuf::from(value()?)),
            "--flash" => {
                let value = value()?;
                let (path, address) = value.rsplit_once('@').ok_or("--flash wants FILE@ADDR")?;
                let address = address.trim_start_matches("0x");
                let address = u64::from_str_radix(address, 16).map_err(|_| format!("`{address}` is no hexadecimal address"))?;
                flash.push((PathBuf::from(path), address));
            }
            "--seed" => seed = value()?.parse().map_err(|_| "--seed wants a number")?,
            "--core-hz" => core_hz = value()?.parse().map_err(|_| "--core-hz wants a number above zero")?,
            _ => return Err(format!("`{word}` is no option")),
        }
    }
    let image = image.ok_or("--image FILE is missing")?;
    Ok(Some(Arguments { image, flash, seed, core_hz }))
}

fn read(path: &Path) -> Result<Vec<u8>, String> {
    std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))
}

fn serve(arguments: &Arguments) -> Result<(), String> {
    let bytes = read(&arguments.image)?;
    let log = Log::of(&bytes);
    let placed = |error: rigless::image::Error| error.to_string();
    let mut images = vec![Image::new(&arguments.image, bytes, None).map_err(placed)?];
    for (path, address) in &arguments.flash {
        images.push(Image::new(path, read(path)?, Some(*address)).map_err(placed)?);
    }
    let (board, far_end) = RigBoard::new(Pins::default(), arguments.core_hz).map_err(|error| error.to_string())?;
    let session = Session::new(Box::new(board), 0, VirtualNanos(0)).map_err(|error| error.to_string())?;
    let machine = Machine::new(BufReader::new(std::io::stdin()), BufWriter::new(std::io::stdout()), far_end, log, arguments.seed);
    let finished = run(session, &Start::new(&images), machine).map_err(|error| error.to_string())?;
    match finished.driver.broken {
        Some(error) => Err(format!("the conversation broke: {error}")),
        None => Ok(()),
    }
}

fn main() -> ExitCode {
    let result = match arguments(std::env::args().skip(1)) {
        Ok(Some(arguments)) => serve(&arguments),
        Ok(None) => {
            print!("{USAGE}");
            Ok(())
        }
        Err(problem) => Err(format!("{problem}\n\n{USAGE}")),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(problem) => {
            eprintln!("error: {problem}");
            ExitCode::FAILURE
        }
    }
}
