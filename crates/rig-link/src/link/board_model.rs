//! The flashable image on a register-level model of its chip, as the processor of a simulated rig.
//!
//! The program `virtual-board` runs the image; `virtual-board/src/protocol.rs` says what is exchanged. The chip keeps its own time, its own
//! watchdog and its own resets: what comes out are its pins, as a logic analyser would see them. So there is no record of every tick from
//! here: a replay log is asked for over the link, as of a board.

use std::io::{ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use firmware::board::{stm32f405, stm32h743};
use firmware::device::DeviceInputs;
use firmware::device::exchange::{DeviceOutputs, InjectedFault};
use firmware::drivers::RawSample;
use model_export::link::fault::Fault;
use model_export::link::state::ResetCause;

use super::flash::{MODEL_SLOT_BYTES, SETTINGS_SLOT_BYTES};
use super::lockstep::{Boot, Processor, Turn};
use super::{FlashMemory, LinkError};

/// The command that builds the program, and the one that builds the image.
pub const BOARD_MODEL_BUILD: &str = "cargo xtask board-model";
const PROGRAM: &str = "virtual-board/target/release/virtual-board";
/// The board of an image whose name does not tell.
const FIRST_BOARD: &str = "custom-f405";
const IMAGE: &str = "target/thumbv7em-none-eabihf/release/rig";
/// Name other places for them.
const PROGRAM_VARIABLE: &str = "CATHETER_BOARD_MODEL";
const IMAGE_VARIABLE: &str = "CATHETER_RIG_IMAGE";

/// Address and length of the slots on a board: settings A and B, models A and B.
fn slots(board: &str) -> [(u32, usize); 4] {
    let (settings, models) = match board {
        "nucleo-h743zi" => (stm32h743::facts::SETTINGS_SECTORS, stm32h743::facts::MODEL_SECTORS),
        _ => (stm32f405::facts::SETTINGS_SECTORS, stm32f405::facts::MODEL_SECTORS),
    };
    let of = |sectors: [(u32, u8); 2], bytes| sectors.map(|(address, _)| (address, bytes));
    let ([a, b], [c, d]) = (of(settings, SETTINGS_SLOT_BYTES), of(models, MODEL_SLOT_BYTES));
    [a, b, c, d]
}

/// Length of an answer to a tick before its bytes for the host.
const TICK_BYTES: usize = 35;
/// Code of a converter that is not connected to its pin, and of one at full scale.
const NOT_DRIVEN: u16 = u16::MAX;
const FULL_CODE: u32 = 4095;

/// Pressure at full drive, microbar: that of the simulated hardware.
const VALVE_FULL_SCALE_UBAR: i64 = 5_000_000;

/// What to run.
#[derive(Clone, Debug)]
pub struct BoardModelConfig {
    /// The program.
    pub program: PathBuf,
    /// The image.
    pub image: PathBuf,
    /// The board that the image is for.
    pub board: String,
    /// Seed of what memory holds without supply.
    pub seed: u64,
    /// Rate of the core's own timer, which does not follow the clock tree, if it is not the usual one.
    pub core_hz: Option<u64>,
}

impl BoardModelConfig {
    /// The image named on the command line or in the environment, or where cargo leaves it; the program likewise.
    ///
    /// # Errors
    /// When one of them is not there, with the command that builds it.
    pub fn find(image: Option<&Path>) -> Result<Self, LinkError> {
        let image = find(image, IMAGE_VARIABLE, IMAGE)?;
        // `cargo xtask firmware --board NAME` leaves `rig-NAME`, and `rig` for the first board.
        let name = image.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let board = name.strip_prefix("rig-").unwrap_or(FIRST_BOARD).to_owned();
        Ok(Self { program: find(None, PROGRAM_VARIABLE, PROGRAM)?, image, board, seed: 1, core_hz: None })
    }
}

fn find(named: Option<&Path>, variable: &str, usual: &str) -> Result<PathBuf, LinkError> {
    let here = std::env::current_dir().unwrap_or_default();
    let ours = std::env::current_exe().unwrap_or_default();
    let candidates: Vec<PathBuf> = match named.map(Path::to_path_buf).or_else(|| std::env::var_os(variable).map(PathBuf::from)) {
        Some(path) => vec![path],
        None => here.ancestors().chain(ours.ancestors().skip(1)).map(|folder| folder.join(usual)).collect(),
    };
    candidates.iter().find(|path| path.is_file()).cloned().ok_or_else(|| {
        let first = candidates.first().map_or_else(|| usual.to_owned(), |path| path.display().to_string());
        LinkError::Emulator(format!("there is no file {first}; build it in the project's folder with `{BOARD_MODEL_BUILD}`"))
    })
}

/// What the pins showed at the end of a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BoardPins {
    /// Virtual time, ns.
    pub time_ns: u64,
    /// Whether the dump valve is energised.
    pub energised: bool,
    /// The valve's drive, of 65535; by the converter or by the pulse width, whichever is more.
    pub valve_share: u16,
    /// Whether the supply is gone.
    pub unpowered: bool,
    /// Whether the processor stands still while flash is busy.
    pub standing: bool,
    /// Groups of conversions since the start.
    pub groups: u32,
    /// Resets since the start.
    pub resets: u32,
    /// Instructions since the start, which the emulator counts.
    pub instructions: u64,
}

/// The running program.
pub struct BoardModel {
    config: BoardModelConfig,
    child: Running,
    input: ChildStdin,
    output: ChildStdout,
    pins: BoardPins,
    log: String,
    /// Groups of conversions when the chip started; until there are more, it does not tick yet.
    starting: Option<u32>,
    _folder: tempfile::TempDir,
}

impl BoardModel {
    /// Starts the program with this flash.
    ///
    /// # Errors
    /// When it is not there or does not start.
    pub fn start(config: BoardModelConfig, flash: &FlashMemory) -> Result<Self, LinkError> {
        let problem = |what: &str, error: &dyn std::fmt::Display| LinkError::Emulator(format!("{what}: {error}"));
        let folder =
            tempfile::Builder::new().prefix("catheter-board-").tempdir().map_err(|error| problem("no folder to work in", &error))?;
        let mut command = Command::new(&config.program);
        command.arg("--image").arg(&config.image).args(["--board", &config.board]).arg("--seed").arg(config.seed.to_string());
        if let Some(hz) = config.core_hz {
            command.arg("--core-hz").arg(hz.to_string());
        }
        let bytes = flash.to_bytes();
        let mut rest = bytes.as_slice();
        for (address, length) in slots(&config.board) {
            let (slot, behind) = rest.split_at(length);
            rest = behind;
            // What is erased need not be placed.
            if let Some(last) = slot.iter().rposition(|byte| *byte != 0xff) {
                let path = folder.path().join(format!("{address:08x}.bin"));
                std::fs::write(&path, &slot[..=last]).map_err(|error| problem("its flash cannot be written", &error))?;
                let mut argument = path.into_os_string();
                argument.push(format!("@{address:08x}"));
                command.arg("--flash").arg(argument);
            }
        }
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = Running(command.spawn().map_err(|error| problem(&config.program.display().to_string(), &error))?);
        let (Some(input), Some(output)) = (child.0.stdin.take(), child.0.stdout.take()) else {
            return Err(LinkError::Emulator("it has no standard streams".to_owned()));
        };
        let pins = BoardPins::default();
        Ok(Self { config, child, input, output, pins, log: String::new(), starting: Some(0), _folder: folder })
    }

    /// What runs.
    #[must_use]
    pub fn config(&self) -> &BoardModelConfig {
        &self.config
    }

    /// What the pins showed at the end of the last tick.
    #[must_use]
    pub fn pins(&self) -> &BoardPins {
        &self.pins
    }

    /// What the image logged so far, a line an entry.
    #[must_use]
    pub fn log(&self) -> &str {
        &self.log
    }

    /// Breaks something; `Fault` in `virtual-board/src/protocol.rs` lists what.
    ///
    /// # Errors
    /// When the program refuses or is gone.
    pub fn break_something(&mut self, what: &str) -> Result<(), LinkError> {
        self.ask(2, what.as_bytes()).map(drop)
    }

    /// Reads the chip's memory.
    ///
    /// # Errors
    /// When there is none, or the program is gone.
    pub fn read(&mut self, address: u32, length: u32) -> Result<Vec<u8>, LinkError> {
        self.ask(3, &[address.to_le_bytes(), length.to_le_bytes()].concat())
    }

    /// Which registers the image touched so far, and which of them no model answered for, as JSON.
    ///
    /// # Errors
    /// When the program is gone.
    pub fn report(&mut self) -> Result<String, LinkError> {
        self.ask(4, &[]).map(|bytes| String::from_utf8_lossy(&bytes).into_owned())
    }

    fn ask(&mut self, kind: u8, body: &[u8]) -> Result<Vec<u8>, LinkError> {
        match self.exchange(kind, body) {
            Ok((255, reason)) => Err(LinkError::Rig(String::from_utf8_lossy(&reason).into_owned())),
            Ok((_, answer)) => Ok(answer),
            Err(error) => Err(self.gone(&error)),
        }
    }

    fn exchange(&mut self, kind: u8, body: &[u8]) -> std::io::Result<(u8, Vec<u8>)> {
        let length = u32::try_from(body.len() + 1).map_err(|_| ErrorKind::InvalidInput)?;
        let mut message = Vec::with_capacity(body.len() + 5);
        message.extend(length.to_le_bytes());
        message.push(kind);
        message.extend(body);
        self.input.write_all(&message)?;
        self.input.flush()?;
        let mut length = [0; 4];
        self.output.read_exact(&mut length)?;
        let mut kind = [0];
        self.output.read_exact(&mut kind)?;
        let mut answer = vec![0; (u32::from_le_bytes(length) as usize).saturating_sub(1)];
        self.output.read_exact(&mut answer)?;
        Ok((kind[0], answer))
    }

    fn gone(&mut self, error: &std::io::Error) -> LinkError {
        let _ = self.child.0.kill();
        let mut said = String::new();
        if let Some(mut stderr) = self.child.0.stderr.take() {
            let _ = stderr.read_to_string(&mut said);
        }
        LinkError::Emulator(format!("it ended ({error}) {}", said.trim()))
    }

    fn take_tick(&mut self, answer: &[u8], to_host: &mut Vec<u8>) -> Option<()> {
        let (head, rest) = answer.split_at_checked(TICK_BYTES)?;
        let word = |at: usize| u16::from_le_bytes([head[at], head[at + 1]]);
        let long = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
        let (code, compare, period, state) = (word(8), word(10), word(12), head[14]);
        let share = |part: u32, whole: u32| u16::try_from((part * u32::from(u16::MAX) + whole / 2) / whole).unwrap_or(u16::MAX);
        let by_code = if code == NOT_DRIVEN { 0 } else { share(u32::from(code).min(FULL_CODE), FULL_CODE) };
        let by_width = if period == 0 { 0 } else { share(u32::from(compare.min(period)), u32::from(period)) };
        self.pins = BoardPins {
            time_ns: u64::from(long(0)) | u64::from(long(4)) << 32,
            energised: state & 1 != 0,
            valve_share: by_code.max(by_width),
            unpowered: state & 2 != 0,
            standing: state & 4 != 0,
            groups: long(15),
            resets: long(19),
            instructions: u64::from(long(23)) | u64::from(long(27)) << 32,
        };
        let (line, log) = rest.split_at_checked(long(31) as usize)?;
        to_host.extend_from_slice(line);
        self.log.push_str(&String::from_utf8_lossy(log));
        Some(())
    }
}

/// The codes of the two conversions that a sum is made of.
fn conversions(sum: u16) -> [u8; 4] {
    let second = sum / 2;
    let ([a, b], [c, d]) = ((sum - second).to_le_bytes(), second.to_le_bytes());
    [a, b, c, d]
}

impl Processor for BoardModel {
    fn boot(&mut self, _boot: Boot) -> Result<Option<Fault>, LinkError> {
        // The chip starts by itself, and what it finds it tells over the link.
        Ok(None)
    }

    fn tick(&mut self, inputs: DeviceInputs, from_host: &[u8], injected: InjectedFault, to_host: &mut Vec<u8>) -> Result<Turn, LinkError> {
        match injected {
            InjectedFault::None => {}
            InjectedFault::Hang => self.break_something("hang")?,
            InjectedFault::StackOverflow | InjectedFault::Panic => {
                return Err(LinkError::Rig("the flashable image has no panic or stack overflow to ask for".to_owned()));
            }
        }
        let RawSample { laser_code, pressure_code } = inputs.sample;
        let mut body = Vec::with_capacity(9 + from_host.len());
        body.extend(conversions(laser_code));
        body.extend(conversions(pressure_code));
        body.push(u8::from(inputs.emergency_stop));
        body.extend(from_host);
        let answer = self.ask(1, &body)?;
        let before = self.pins;
        self.take_tick(&answer, to_host).ok_or_else(|| LinkError::Emulator("its answer is too short".to_owned()))?;
        let BoardPins { energised, valve_share, groups, resets, .. } = self.pins;
        if resets != before.resets {
            self.starting = Some(groups);
        }
        if self.starting.is_some_and(|at_start| groups == at_start) {
            return Ok(Turn::Restarted);
        }
        self.starting = None;
        // The chip has a watchdog of its own, and its state is the link's to tell.
        let output_ubar = (i64::from(valve_share) * VALVE_FULL_SCALE_UBAR / i64::from(u16::MAX)).try_into().unwrap_or_default();
        Ok(Turn::Done(DeviceOutputs { energised, valve_share, output_ubar, feed_watchdog: true, ..DeviceOutputs::default() }))
    }

    fn cause_of_restart(&self) -> ResetCause {
        ResetCause::Software
    }

    fn condition(&self) -> String {
        format!("\n{:?}\n{}", self.pins, self.log.trim_end())
    }

    fn read_flash(&mut self) -> Result<FlashMemory, LinkError> {
        let mut bytes = Vec::new();
        for (address, length) in slots(&self.config.board) {
            bytes.extend(self.read(address, u32::try_from(length).unwrap_or_default())?);
        }
        FlashMemory::from_bytes(&bytes).ok_or_else(|| LinkError::Emulator("its flash has another size".to_owned()))
    }
}

/// A child that ends with us.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sum_is_split_into_two_codes_that_make_it_again() {
        for sum in [0u16, 1, 1489, 8189, 8190] {
            let [a, b, c, d] = conversions(sum);
            let (first, second) = (u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d]));
            assert!(first <= 4095 && second <= 4095 && first + second == sum, "{sum}");
        }
    }
}
