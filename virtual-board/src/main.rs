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
use virtual_board::boards::{BOARDS, Kind};
use virtual_board::chip::part::Stm32f405;
use virtual_board::chip::pins::Pins;
use virtual_board::log::Log;
use virtual_board::machine::Machine;
use virtual_board::part::RigPart;
use virtual_board::stm32h743::part::{self as stm32h743, Stm32h743};

const USAGE: &str = "\
usage: virtual-board --image FILE [options]

  --image FILE        the image, sealed: target/thumbv7em-none-eabihf/release/rig, built by `cargo xtask firmware`
  --board NAME        custom-f405 (default), feather-f405 or nucleo-h743zi; the image must be of it
  --flash FILE@ADDR   what the flash holds besides, at a hexadecimal address; may be given more than once
  --seed N            seed of what memory holds without supply (default 1)
  --core-hz N         rate of the core's own timer, which does not follow the clock tree (default: the full frequency)

Requests on standard input, answers on standard output: see `virtual-board/src/protocol.rs`.
";

struct Arguments {
    image: PathBuf,
    board: Kind,
    flash: Vec<(PathBuf, u64)>,
    seed: u64,
    core_hz: Option<NonZeroU64>,
}

fn arguments(mut words: impl Iterator<Item = String>) -> Result<Option<Arguments>, String> {
    let mut image = None;
    let mut board = BOARDS[0];
    let mut flash = Vec::new();
    let (mut seed, mut core_hz) = (1, None);
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or_else(|| format!("{word} wants a value"));
        match word.as_str() {
            "--help" | "-h" => return Ok(None),
            "--image" => image = Some(PathBuf::from(value()?)),
            "--board" => board = Kind::named(&value()?)?,
            "--flash" => {
                let value = value()?;
                let (path, address) = value.rsplit_once('@').ok_or("--flash wants FILE@ADDR")?;
                let address = address.trim_start_matches("0x");
                let address = u64::from_str_radix(address, 16).map_err(|_| format!("`{address}` is no hexadecimal address"))?;
                flash.push((PathBuf::from(path), address));
            }
            "--seed" => seed = value()?.parse().map_err(|_| "--seed wants a number")?,
            "--core-hz" => core_hz = Some(value()?.parse().map_err(|_| "--core-hz wants a number above zero")?),
            _ => return Err(format!("`{word}` is no option")),
        }
    }
    let image = image.ok_or("--image FILE is missing")?;
    Ok(Some(Arguments { image, board, flash, seed, core_hz }))
}

fn read(path: &Path) -> Result<Vec<u8>, String> {
    std::fs::read(path).map_err(|error| format!("{}: {error}", path.display()))
}

fn serve(arguments: &Arguments) -> Result<(), String> {
    let bytes = read(&arguments.image)?;
    // The name is what its Hello will say. On another board's pins an image would do nothing that can be understood.
    let name = arguments.board.name();
    if !bytes.windows(name.len()).any(|window| window == name.as_bytes()) {
        return Err(format!("{} is no image of the board {name}", arguments.image.display()));
    }
    let log = Log::of(&bytes);
    match arguments.board {
        Kind::Stm32f405(wiring) => run_on(arguments, bytes, log, Stm32f405::new(Pins::of(wiring))),
        Kind::Stm32h743(wiring) => run_on(arguments, bytes, log, Stm32h743::new(stm32h743::Pins::of(wiring))),
    }
}

fn run_on<P: RigPart + 'static>(
    arguments: &Arguments,
    bytes: Vec<u8>,
    log: Option<Log>,
    part: Result<P, rigless::soc::Error>,
) -> Result<(), String> {
    let placed = |error: rigless::image::Error| error.to_string();
    let mut images = vec![Image::new(&arguments.image, bytes, None).map_err(placed)?];
    let (address, word) = P::CALIBRATION;
    images.push(Image::new(Path::new("calibration"), word.to_le_bytes().to_vec(), Some(address)).map_err(placed)?);
    for (path, address) in &arguments.flash {
        images.push(Image::new(path, read(path)?, Some(*address)).map_err(placed)?);
    }
    let (board, far_end) = RigBoard::new(part.map_err(|error| error.to_string())?, arguments.core_hz);
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
