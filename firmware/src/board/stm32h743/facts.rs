//! Every rate, scale and address of the chip, in one place; nothing else in the firmware knows any of them.
//!
//! Sources: RM0433 is the reference manual of the STM32H742/743/753/750 (revision 9), DS12110 the data sheet of the STM32H743 (revision 11).
//! Pins and the HSE are the board's: [`super::wiring`].

use crate::board::clock::{ClockPlan, expected_count};
use crate::board::rates::Rates;
use crate::board::watchdog;

/// Internal oscillator, Hz (RM0433 section 8.5.2).
pub const INTERNAL_HZ: u32 = 64_000_000;
/// Its tolerance over the whole temperature range, in parts per thousand: 1 to 2 % (DS12110 table 53), with a margin.
pub const INTERNAL_TOLERANCE_PER_MILLE: u32 = 30;
/// Processor with the phase-locked loop running, Hz: the most at voltage scale 1 (DS12110 table 22).
pub const CORE_HZ: u32 = 400_000_000;
/// Divided input of the loop, Hz (RM0433 section 8.7.12, range 4 to 8 MHz).
const LOOP_INPUT_HZ: u32 = 4_000_000;
/// The loop's own frequency over its divided input: 800 MHz; and its divider to the core.
pub const LOOP_MULTIPLIER: u32 = 200;
/// See [`LOOP_MULTIPLIER`].
pub const LOOP_CORE_DIVIDER: u32 = 2;
const _: () = assert!(LOOP_INPUT_HZ * LOOP_MULTIPLIER / LOOP_CORE_DIVIDER == CORE_HZ);
/// Wait states of the flash, and the code of the programming delay, for a bus of 200 MHz at scale 1 (RM0433 table 17).
pub const FLASH_WAIT_STATES: u8 = 2;
/// See [`FLASH_WAIT_STATES`].
pub const FLASH_DELAY: u8 = 2;

/// What the phase-locked loop does with its input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pll {
    /// Divider of the input, 1 to 63.
    pub divider: u8,
}

impl Pll {
    /// From an input of a multiple of 4 MHz.
    pub const fn of(input_hz: u32) -> Self {
        let [divider, ..] = (input_hz / LOOP_INPUT_HZ).to_le_bytes();
        Self { divider }
    }
}

/// The frequencies with the loop: buses and memories at half of the core's, peripherals at half of that, timers at twice the peripherals'.
pub const FAST_RATES: Rates = Rates { core_hz: CORE_HZ, timer_hz: CORE_HZ / 2, line_hz: CORE_HZ / 4 };
/// On the internal oscillator alone, nothing divided.
pub const INTERNAL_RATES: Rates = Rates { core_hz: INTERNAL_HZ, timer_hz: INTERNAL_HZ, line_hz: INTERNAL_HZ };
// 0.5 % and 0.6 % off; a receiver tolerates about 3 %.
const _: () = assert!(FAST_RATES.meets_the_line(6) && INTERNAL_RATES.meets_the_line(7));

/// What the clock becomes with this HSE or signal.
pub const fn plan(hse_hz: u32) -> ClockPlan<Pll> {
    ClockPlan {
        expected_count: expected_count(INTERNAL_HZ, hse_hz),
        tolerance_per_mille: INTERNAL_TOLERANCE_PER_MILLE,
        from_hse: Pll::of(hse_hz),
        hse_rates: FAST_RATES,
        from_internal: Pll::of(INTERNAL_HZ),
        internal_fast_rates: FAST_RATES,
        internal_rates: INTERNAL_RATES,
    }
}

/// Channel of the chip's own reference voltage, on the third converter (RM0433 table 209).
pub const REFERENCE_CHANNEL: u8 = 19;
/// Where the factory left the reference voltage's code at 3.3 V and 30 degrees, of 16 bits (DS12110 table 118).
pub const REFERENCE_CALIBRATION: usize = 0x1ff1_e860;

/// AHB4 peripheral clock enable register (RM0433 section 8.7.43), for the code that runs before there is RAM. Bit 0 is port A's.
pub const RCC_AHB4ENR: u32 = 0x5802_44e0;

/// Watchdog oscillator, Hz, at its slowest and fastest (DS12110 table 55).
pub const WATCHDOG_HZ: (u32, u32) = (29_760, 33_600);
const _: () = assert!(watchdog::OSCILLATOR_HZ.0 <= WATCHDOG_HZ.0 && WATCHDOG_HZ.1 <= watchdog::OSCILLATOR_HZ.1);

/// Supply below which the board vents while it still can: 2.8 V falling (DS12110 table 26, level 6).
pub const BROWN_OUT_LEVEL: u8 = 6;

/// First address and number in bank 2 of the flash sectors in use (RM0433 table 15), each of [`SECTOR_BYTES`]. Bank 1 belongs to the program.
pub const MODEL_SECTORS: [(u32, u8); 2] = [(0x0810_0000, 0), (0x0812_0000, 1)];
/// See [`MODEL_SECTORS`].
pub const SETTINGS_SECTORS: [(u32, u8); 2] = [(0x0814_0000, 2), (0x0816_0000, 3)];
/// Length of each of these sectors.
pub const SECTOR_BYTES: usize = 128 * 1024;
/// Longest erase of such a sector with 64-bit parallelism, ms (DS12110 table 140).
pub const SECTOR_ERASE_MS: u32 = 2_000;
const _: () = assert!(SECTOR_ERASE_MS <= watchdog::LONGEST_ERASE_MS);

/// Device and revision identifiers, DBGMCU_IDC (RM0433 chapter 60).
pub const IDCODE: usize = 0x5c00_1000;
/// The chip's unique number (RM0433 chapter 61).
pub const UNIQUE_NUMBER: usize = 0x1ff1_e800;
