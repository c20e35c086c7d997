//! What the run needs of a part, whatever its family.

use std::num::NonZeroU64;

use rigless::emulator::CoreSpec;
use rigless::mcu::Mcu;
use rigless::snapshot::Store;
use rigless::soc::Width;
use rigless::time::VirtualNanos;

use crate::line::FarEnd;
use crate::protocol::Fault;

/// What the part does to the pins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Outputs {
    /// Code at the drive's pin, if the converter drives it.
    pub drive_code: Option<u16>,
    /// Duty cycle at the pulse width's pin as compare value and period, if the timer drives it.
    pub pulse: Option<(u16, u16)>,
    /// Whether the dump valve's pin is driven high.
    pub dump_valve: bool,
}

/// A change of the array.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Change {
    /// Bits that a store clears.
    Program {
        /// Where.
        address: u64,
        /// How many bits.
        width: Width,
        /// What was stored.
        value: u64,
    },
    /// A sector becomes all ones.
    Erase {
        /// Which.
        sector: usize,
    },
    /// The option bytes become this.
    Options {
        /// OPTCR without its two commands.
        value: u64,
    },
}

/// A part with the rig's surroundings on its pins.
pub trait RigPart: Mcu + Store + Send + std::fmt::Debug {
    /// The part's name.
    const NAME: &'static str;
    /// Rate of the core's own timer, which does not follow the clock tree, unless another is asked for, Hz.
    const CORE_HZ: NonZeroU64;
    /// Memory that forgets without supply: first address, length.
    const FORGETFUL: &'static [(u64, u64)];
    /// The factory's calibration in system memory, for the reference voltage of the converter's model and an analogue supply of 3.3 V: address, word.
    const CALIBRATION: (u64, u32);

    /// The board it is on.
    fn board(&self) -> &'static str;
    /// Its core.
    fn core(&self, clock_hz: NonZeroU64) -> CoreSpec;
    /// Puts the line's far end on its serial port.
    fn attach(&mut self, far_end: FarEnd);
    /// Codes of the next groups of conversions, at 3.3 V.
    fn set_codes(&mut self, codes: [[u16; 2]; 2]);
    /// Opens or closes the emergency stop's contact, unless it is so already: high is pressed, or a broken wire.
    fn press_stop(&mut self, pressed: bool, at: VirtualNanos);
    /// What it does to the pins.
    fn outputs(&self) -> Outputs;
    /// Groups of conversions so far.
    fn groups(&self) -> u64;
    /// Whether the serial port has the pins that the line to the host is soldered to: from the part, and to it.
    fn line_is_connected(&self) -> (bool, bool);

    /// Breaks something of the part's; whether the core hears of it by its NMI.
    ///
    /// # Errors
    /// When this part has no such thing in its model.
    fn break_something(&mut self, fault: Fault, at: VirtualNanos) -> Result<bool, String>;

    /// Moves the supply, mV.
    fn set_supply(&mut self, millivolts: u32, at: VirtualNanos);
    /// Whether the supply went so low that memory forgets.
    fn forgets(&self) -> bool {
        false
    }
    /// The operation on flash under way, where the processor stands still for it.
    fn flash_running(&self) -> Option<Change> {
        None
    }
    /// Changes that the flash has to show now, where the run makes them.
    fn take_flash_changes(&mut self) -> Vec<Change> {
        Vec::new()
    }
}
