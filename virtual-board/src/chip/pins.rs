//! What is on the part's pins, and what of it is broken.

use super::flash::Speed;
use super::oscillators::Oscillators;
use crate::boards::stm32f405::wiring::Wiring;

/// The supply as it should be, mV.
pub const SUPPLY_MV: u32 = 3300;
/// The option bytes as delivered: no protection, brown-out reset off (RM0090 section 3.9.6).
const OPTIONS_OF_THE_FACTORY: u64 = 0x0fff_aaed;

/// What is on the part's pins; it outlasts resets.
#[derive(Debug, Clone, Copy)]
pub struct Pins {
    /// Which pin is what.
    pub wiring: Wiring,
    /// Frequency of the HSE, Hz.
    pub hse_hz: u64,
    /// Frequency of the watchdog's oscillator, Hz: 17 to 47 kHz (DS8626 table 42).
    pub watchdog_hz: u64,
    /// The oscillators' health.
    pub oscillators: Oscillators,
    /// The supply, mV.
    pub supply_mv: u32,
    /// The analogue supply, mV, where it is not the supply itself.
    pub analogue_mv: Option<u32>,
    /// The code at the drive's pin whatever the converter does there.
    pub drive_stuck: Option<u16>,
    /// The level at the dump valve's pin whatever the port does there.
    pub dump_stuck: Option<bool>,
    /// The level at the pulse width's pin whatever the timer does there.
    pub pulse_stuck: Option<bool>,
    /// Whether the two analogue inputs are exchanged.
    pub swapped: bool,
    /// The option bytes, as OPTCR shows them after a reset (3.9.6).
    pub option_bytes: u64,
    /// Whether the emergency stop's contact is open.
    pub stop_pressed: bool,
    /// How fast flash is.
    pub flash: Speed,
}

impl Pins {
    /// A board as it should be.
    pub fn of(wiring: Wiring) -> Self {
        Self {
            wiring,
            hse_hz: u64::from(wiring.hse_hz),
            watchdog_hz: 32_000,
            oscillators: Oscillators::default(),
            supply_mv: SUPPLY_MV,
            analogue_mv: None,
            drive_stuck: None,
            dump_stuck: None,
            pulse_stuck: None,
            swapped: false,
            option_bytes: OPTIONS_OF_THE_FACTORY,
            stop_pressed: false,
            flash: Speed::Typical,
        }
    }
}
