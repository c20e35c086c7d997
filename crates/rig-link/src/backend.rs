//! Which rig: a board on a serial port, the flashable image on a model of its chip, the emulator, or a rig in this process; opened, they
//! all are a [`Transport`].

use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use crate::link::{
    BoardModel, BoardModelConfig, FlashMemory, Hardware, HardwareConfig, InProcess, Injection, LinkError, Lockstep, Muscle, Processor,
    Qemu, QemuConfig, Serial, Transport, find_board,
};
use crate::replay_log::{Header, Recorder, ReplayLog};
use simulation::plant::Plant;

/// The name that the emulated device gives; the rig in this process takes it too where both are compared.
pub const EMULATED_BOARD: &str = "qemu";
/// The name of the rig in this process.
pub const VIRTUAL_BOARD: &str = "virtual";
/// The name of the backend that runs the flashable image.
pub const BOARD_MODEL: &str = "board-model";

/// Where a rig is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Backend {
    /// In this process.
    Virtual,
    /// In the emulator.
    Qemu,
    /// The flashable image on a model of its chip.
    BoardModel,
    /// On this serial port.
    Serial(String),
    /// On the one serial port at which a board answers.
    AnySerial,
}

impl Backend {
    /// Whether it is a board in a laboratory.
    #[must_use]
    pub fn is_board(&self) -> bool {
        matches!(self, Self::Serial(_) | Self::AnySerial)
    }

    /// Its name, without the port.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Virtual => VIRTUAL_BOARD,
            Self::Qemu => "qemu",
            Self::BoardModel => BOARD_MODEL,
            Self::Serial(_) | Self::AnySerial => "serial",
        }
    }
}

impl FromStr for Backend {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(':') {
            Some(("serial", port)) if !port.is_empty() => Ok(Self::Serial(port.to_owned())),
            None if text == "serial" => Ok(Self::AnySerial),
            None if text == "virtual" => Ok(Self::Virtual),
            None if text == "qemu" => Ok(Self::Qemu),
            None if text == BOARD_MODEL => Ok(Self::BoardModel),
            _ => Err("virtual, qemu, board-model or serial:PORT is wanted, for example serial:/dev/ttyUSB0 or serial:COM3; serial alone finds the board".to_owned()),
        }
    }
}

/// What a simulated rig is made of.
pub struct Simulated {
    /// Numbers of the hardware.
    pub hardware: HardwareConfig,
    /// What moves the tip.
    pub muscle: Box<dyn Muscle>,
    /// What moves the tip, for the replay log.
    pub plant: String,
    /// What the flash holds.
    pub flash: FlashMemory,
    /// The image, if it is not where cargo leaves it.
    pub image: Option<PathBuf>,
    /// The name that the device gives.
    pub board: &'static str,
    /// What breaks, and when.
    pub injections: Vec<Injection>,
}

impl Simulated {
    /// A rig around a plant, with noise from this seed.
    #[must_use]
    pub fn around(plant: &Plant, seed: u64, flash: FlashMemory, board: &'static str) -> Self {
        let [a, b, c, d, e, f, g, h] = seed.to_le_bytes();
        let seed = u32::from_le_bytes([a ^ e, b ^ f, c ^ g, d ^ h]);
        Self {
            hardware: HardwareConfig { seed, ..HardwareConfig::default() },
            muscle: Box::new(plant.start(0.0)),
            plant: plant.config().to_toml(),
            flash,
            image: None,
            board,
            injections: Vec::new(),
        }
    }
}

/// A rig, opened.
pub enum Rig {
    /// In this process.
    Virtual(Box<Lockstep<InProcess, Recorder>>),
    /// In the emulator.
    Qemu(Box<Lockstep<Qemu, Recorder>>),
    /// On a model of the chip.
    BoardModel(Box<Lockstep<BoardModel>>),
    /// A board.
    Serial(Serial),
}

impl Rig {
    /// Opens a rig. `simulated` is asked only if it is a simulated one.
    ///
    /// # Errors
    /// When it cannot be opened or started.
    pub fn open(backend: &Backend, simulated: impl FnOnce() -> anyhow::Result<Simulated>) -> anyhow::Result<Self> {
        let mut injections = Vec::new();
        let simulated = || {
            let mut simulated = simulated()?;
            injections = std::mem::take(&mut simulated.injections);
            anyhow::Ok(simulated)
        };
        let mut rig = match backend {
            Backend::Serial(port) => Self::Serial(Serial::open(port)?),
            Backend::AnySerial => Self::Serial(find_board()?),
            Backend::Virtual => {
                let Simulated { hardware, muscle, plant, flash, board, .. } = simulated()?;
                let recorder = Recorder::new(Header::new("virtual", board, plant, &flash));
                let place = "the rig in this process";
                Self::Virtual(Box::new(Lockstep::new(InProcess::new(flash), Hardware::new(hardware, muscle), recorder, place, board)?))
            }
            Backend::Qemu => {
                let Simulated { hardware, muscle, plant, flash, image, board, .. } = simulated()?;
                let recorder = Recorder::new(Header::new("qemu", board, plant, &flash));
                let processor = Qemu::start(QemuConfig::find(image.as_deref())?, &flash)?;
                Self::Qemu(Box::new(Lockstep::new(processor, Hardware::new(hardware, muscle), recorder, "the rig in QEMU", board)?))
            }
            Backend::BoardModel => {
                let Simulated { hardware, muscle, flash, image, board, .. } = simulated()?;
                let processor = BoardModel::start(BoardModelConfig::find(image.as_deref())?, &flash)?;
                let place = "the flashable image on the board's model";
                Self::BoardModel(Box::new(Lockstep::new(processor, Hardware::new(hardware, muscle), (), place, board)?))
            }
        };
        if let Some(hardware) = rig.hardware() {
            hardware.inject(&injections);
        }
        Ok(rig)
    }

    /// The name of the backend, where it is asked for its replay log over the link.
    #[must_use]
    pub fn traced_as(&self) -> Option<&'static str> {
        match self {
            Self::Virtual(_) | Self::Qemu(_) => None,
            Self::BoardModel(_) => Some(BOARD_MODEL),
            Self::Serial(_) => Some("serial"),
        }
    }

    /// Whether its time is simulated.
    #[must_use]
    pub fn is_simulated(&self) -> bool {
        !matches!(self, Self::Serial(_))
    }

    /// What went into it so far, tick by tick; a board and its model are asked for their replay log over the link.
    #[must_use]
    pub fn replay_log(&self) -> Option<&ReplayLog> {
        match self {
            Self::Virtual(rig) => Some(rig.observer().replay_log()),
            Self::Qemu(rig) => Some(rig.observer().replay_log()),
            Self::BoardModel(_) | Self::Serial(_) => None,
        }
    }

    /// What the image logged, where somebody sees it.
    pub fn log(&mut self) -> Option<&str> {
        match self {
            Self::BoardModel(rig) => Some(rig.processor().log()),
            Self::Virtual(_) | Self::Qemu(_) | Self::Serial(_) => None,
        }
    }

    /// The simulated hardware.
    pub fn hardware(&mut self) -> Option<&mut Hardware> {
        match self {
            Self::Virtual(rig) => Some(rig.hardware()),
            Self::Qemu(rig) => Some(rig.hardware()),
            Self::BoardModel(rig) => Some(rig.hardware()),
            Self::Serial(_) => None,
        }
    }

    /// The flash of a simulated rig as it is now.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn flash(&mut self) -> Result<Option<FlashMemory>, LinkError> {
        match self {
            Self::Virtual(rig) => rig.processor().read_flash().map(Some),
            Self::Qemu(rig) => rig.processor().read_flash().map(Some),
            Self::BoardModel(rig) => rig.processor().read_flash().map(Some),
            Self::Serial(_) => Ok(None),
        }
    }
}

impl Transport for Rig {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        match self {
            Self::Virtual(rig) => rig.send(bytes),
            Self::Qemu(rig) => rig.send(bytes),
            Self::BoardModel(rig) => rig.send(bytes),
            Self::Serial(port) => port.send(bytes),
        }
    }

    fn receive(&mut self, limit: Duration, into: &mut Vec<u8>) -> Result<(), LinkError> {
        match self {
            Self::Virtual(rig) => rig.receive(limit, into),
            Self::Qemu(rig) => rig.receive(limit, into),
            Self::BoardModel(rig) => rig.receive(limit, into),
            Self::Serial(port) => port.receive(limit, into),
        }
    }

    fn elapsed(&self) -> Duration {
        match self {
            Self::Virtual(rig) => rig.elapsed(),
            Self::Qemu(rig) => rig.elapsed(),
            Self::BoardModel(rig) => rig.elapsed(),
            Self::Serial(port) => port.elapsed(),
        }
    }

    fn place(&self) -> &str {
        match self {
            Self::Virtual(rig) => rig.place(),
            Self::Qemu(rig) => rig.place(),
            Self::BoardModel(rig) => rig.place(),
            Self::Serial(port) => port.place(),
        }
    }

    fn token_before_the_first(&self) -> u32 {
        match self {
            Self::Virtual(_) | Self::Qemu(_) | Self::BoardModel(_) => 0,
            Self::Serial(port) => port.token_before_the_first(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backends_are_read_from_the_command_line() {
        assert_eq!("virtual".parse(), Ok(Backend::Virtual));
        assert_eq!("qemu".parse(), Ok(Backend::Qemu));
        assert_eq!("board-model".parse(), Ok(Backend::BoardModel));
        assert_eq!("serial:COM3".parse(), Ok(Backend::Serial("COM3".to_owned())));
        assert_eq!("serial".parse(), Ok(Backend::AnySerial));
        for wrong in ["", "serial:", "virtual:1", "usb"] {
            assert!(wrong.parse::<Backend>().is_err(), "{wrong}");
        }
    }
}
