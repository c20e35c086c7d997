//! Every rate, scale and address of the chip, in one place; nothing else in the firmware knows any of them.
//!
//! Sources: RM0090 is the reference manual of the STM32F405/407 (revision 19), DS8626 its data sheet (revision 9).
//!
//!
//! Pins and the HSE are the board's: [`super::wiring`].

use crate::board::clock::{ClockPlan, expected_count};
use crate::board::rates::{Rates, rounded};
use crate::board::watchdog;

/// Internal oscillator, Hz (RM0090 section 7.2.2).
pub const INTERNAL_HZ: u32 = 16_000_000;
/// Tolerance of the internal oscillator over the whole temperature range, in parts per thousand (DS8626 table 41: -8 to +4.5 %).
pub const INTERNAL_TOLERANCE_PER_MILLE: u32 = 80;
/// Processor with the phase-locked loop running, Hz; the most the chip does.
pub const CORE_HZ: u32 = 168_000_000;

/// Frequencies into the phase-locked loop, Hz (RM0090 section 7.3.2): the upper end has the least jitter.
pub const PLL_INPUT_HZ: (u32, u32) = (1_000_000, 2_000_000);
/// Dividers and multipliers of the phase-locked loop (RM0090 section 7.3.2).
const PLL_DIVIDERS: (u32, u32) = (2, 63);
const PLL_MULTIPLIERS: (u32, u32) = (50, 432);
/// Divider to the processor's clock.
pub const PLL_CORE_DIVIDER: u32 = 2;
/// Divider to the 48 MHz domain, which the board does not use.
pub const PLL_48_MHZ_DIVIDER: u8 = 7;
/// Wait states of the flash at 168 MHz and 2.7 to 3.6 V (RM0090 table 10).
pub const FLASH_WAIT_STATES: u8 = 5;

/// What the phase-locked loop does with its input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pll {
    /// Divider of the input.
    pub divider: u8,
    /// Multiplier of the divided input.
    pub multiplier: u16,
    /// Processor frequency that comes of it, Hz, rounded to nearest.
    pub core_hz: u32,
}

impl Pll {
    /// The fastest processor up to [`CORE_HZ`] from this input, with the fastest divided input that gives it; `None` if the loop takes no such
    /// input.
    pub const fn from_input(input_hz: u32) -> Option<Self> {
        let mut best: Option<Self> = None;
        let mut divider = PLL_DIVIDERS.0;
        while divider <= PLL_DIVIDERS.1 {
            if input_hz >= PLL_INPUT_HZ.0 * divider && input_hz <= PLL_INPUT_HZ.1 * divider {
                let full = CORE_HZ as u64 * PLL_CORE_DIVIDER as u64 * divider as u64;
                let multiplier = full / input_hz as u64;
                let product = input_hz as u64 * multiplier;
                let divisor = divider as u64 * PLL_CORE_DIVIDER as u64;
                let core_hz = rounded(product, divisor);
                let is_faster = match best {
                    None => true,
                    Some(best) => core_hz > best.core_hz,
                };
                if is_faster && multiplier >= PLL_MULTIPLIERS.0 as u64 && multiplier <= PLL_MULTIPLIERS.1 as u64 {
                    let ([divider, ..], [low, high, ..]) = (divider.to_le_bytes(), multiplier.to_le_bytes());
                    best = Some(Self { divider, multiplier: u16::from_le_bytes([low, high]), core_hz });
                }
            }
            divider += 1;
        }
        best
    }

    /// From an input that the board was built for.
    const fn of(input_hz: u32) -> Self {
        match Self::from_input(input_hz) {
            Some(pll) => pll,
            None => unreachable!(),
        }
    }

    /// From the internal oscillator.
    pub const INTERNAL: Self = Self::of(INTERNAL_HZ);
}
const _: () = assert!(Pll::INTERNAL.core_hz == CORE_HZ);

/// Divider of the slow bus, at most 42 MHz; its timers run at twice that (RM0090 section 7.2).
pub const SLOW_BUS_DIVIDER: u32 = 4;
/// Divider of the fast bus, at most 84 MHz.
pub const FAST_BUS_DIVIDER: u32 = 2;

/// The frequencies with the phase-locked loop at this frequency.
pub const fn fast(core_hz: u32) -> Rates {
    Rates { core_hz, timer_hz: core_hz / SLOW_BUS_DIVIDER * 2, line_hz: core_hz / FAST_BUS_DIVIDER }
}

/// On the internal oscillator alone, nothing divided.
pub const INTERNAL_RATES: Rates = Rates { core_hz: INTERNAL_HZ, timer_hz: INTERNAL_HZ, line_hz: INTERNAL_HZ };
const _: () = assert!(fast(CORE_HZ).meets_the_line(3));

/// What the clock becomes with this HSE, of 4 to 26 MHz.
pub const fn plan(hse_hz: u32) -> ClockPlan<Pll> {
    let from_hse = Pll::of(hse_hz);
    ClockPlan {
        expected_count: expected_count(INTERNAL_HZ, hse_hz),
        tolerance_per_mille: INTERNAL_TOLERANCE_PER_MILLE,
        from_hse,
        hse_rates: fast(from_hse.core_hz),
        from_internal: Pll::INTERNAL,
        internal_fast_rates: fast(Pll::INTERNAL.core_hz),
        internal_rates: INTERNAL_RATES,
    }
}

/// Channel of the chip's own reference voltage (RM0090 section 13.3.3), and of the drive's pin, where the analogue drive can be read back. A regular
/// conversion a tick reads them in turn, behind the injected ones.
pub const READ_BACK_CHANNELS: [u8; 2] = [17, 4];
/// Channel of the chip's temperature sensor (RM0090 section 13.10), read four times a second in between.
pub const CHIP_CHANNEL: u8 = 16;
/// Where the factory left the temperature sensor's codes at 30 and 110 degrees and 3.3 V (DS8626 table 74).
pub const CHIP_CALIBRATION: [usize; 2] = [0x1fff_7a2c, 0x1fff_7a2e];
/// Device and revision identifiers, DBGMCU_IDCODE (RM0090 section 38.6.1).
pub const IDCODE: usize = 0xe004_2000;
/// The chip's unique number (RM0090 section 39.1).
pub const UNIQUE_NUMBER: usize = 0x1fff_7a10;
/// Where the factory left the reference voltage's code at 3.3 V and 30 degrees (DS8626 table 77).
pub const REFERENCE_CALIBRATION: usize = 0x1fff_7a2a;
/// The ADC's clock is the fast bus over this: 21 MHz of at most 36 (DS8626 table 67).
pub const ADC_CLOCK_DIVIDER: u32 = 4;
const _: () = assert!(CORE_HZ / FAST_BUS_DIVIDER / ADC_CLOCK_DIVIDER <= 36_000_000);
// The sampling time is 84 ADC cycles (4 us) for the 1 kohm in front of the pins; a conversion 96, a tick's four 18 us.

/// AHB1 peripheral clock enable register (RM0090 section 7.3.10), for the code that runs before there is RAM. Bit 0 is port A's.
pub const RCC_AHB1ENR: u32 = 0x4002_3830;

/// Watchdog oscillator, Hz, at its slowest and fastest (DS8626 table 42).
pub const WATCHDOG_HZ: (u32, u32) = (17_000, 47_000);
const _: () = assert!(watchdog::OSCILLATOR_HZ.0 <= WATCHDOG_HZ.0 && WATCHDOG_HZ.1 <= watchdog::OSCILLATOR_HZ.1);

/// Supply below which the board vents while it still can: 2.9 V falling (DS8626 table 23, level 7).
pub const BROWN_OUT_LEVEL: u8 = 7;

/// First address and number of the flash sectors in use (RM0090 table 5), each of [`SECTOR_BYTES`]: models in 8 and 9, settings in 10 and
/// 11. Sectors 0 to 7 belong to the program.
pub const MODEL_SECTORS: [(u32, u8); 2] = [(0x0808_0000, 8), (0x080a_0000, 9)];
/// See [`MODEL_SECTORS`].
pub const SETTINGS_SECTORS: [(u32, u8); 2] = [(0x080c_0000, 10), (0x080e_0000, 11)];
/// Length of each of these sectors.
pub const SECTOR_BYTES: usize = 128 * 1024;
/// Longest erase of such a sector with 32-bit parallelism, ms (DS8626 table 46).
pub const SECTOR_ERASE_MS: u32 = 2_000;
const _: () = assert!(SECTOR_ERASE_MS <= watchdog::LONGEST_ERASE_MS);
