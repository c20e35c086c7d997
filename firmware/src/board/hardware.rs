//! Every pin, rate, scale and address of the board, in one place; nothing else in the firmware knows any of them.
//!
//! Sources: RM0090 is the reference manual of the STM32F405/407 (revision 19), DS8626 its data sheet (revision 9).
//!
//! | pin (LQFP64) | function | peripheral | outside |
//! |---|---|---|---|
//! | PA0 (14) | laser, 0.6 to 3.0 V | ADC1_IN0 | 150 ohm to ground across the 4-20 mA loop, 1 kohm and 10 nF in front of the pin |
//! | PA1 (15) | measured pressure, 0.6 to 3.0 V | ADC1_IN1 | the same |
//! | PA4 (20) | valve drive, analogue 0 to 3.3 V | DAC_OUT1, unbuffered | operational amplifier to the valve's 0 to 10 V, 2.2 Mohm to ground |
//! | PA6 (22) | valve drive, pulse width | TIM3_CH1, AF2 | the valve's driver, 10 kohm to ground |
//! | PB0 (26) | emergency stop, high = pressed or broken wire | input | normally closed contact to ground, 4.7 kohm to 3.3 V, 100 nF |
//! | PB1 (27) | dump valve, high = energised = closed | output | gate of the valve's transistor, 10 kohm to ground |
//! | PA9 (42), PA10 (43) | link to the host, 3.3 V levels | USART1 TX, RX, AF7 | USB-serial adapter |
//! | PA13 (46), PA14 (49) | debug probe | SWD | probe |
//!
//! Nothing on the board decides anything: a pull-down on every output and a dump valve that opens without current make a board in reset
//! a vented rig.

use model_export::link::LINE_BAUD;

use crate::calibration::ConverterConfig;
use crate::tick::RigFacts;

/// Name in the Hello.
pub const BOARD_NAME: &str = "stm32f405-rig";

/// The crystal that must be fitted, Hz: any of 4 to 26 MHz (DS8626 table 38). Another one is found out before it drives anything
/// ([`super::clock`]).
pub const CRYSTAL_HZ: u32 = 8_000_000;
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

    /// From the crystal.
    pub const CRYSTAL: Self = Self::of(CRYSTAL_HZ);
    /// From the internal oscillator.
    pub const INTERNAL: Self = Self::of(INTERNAL_HZ);
}
const _: () = assert!(Pll::INTERNAL.core_hz == CORE_HZ);

/// The quotient rounded to nearest, of numbers whose quotient has 32 bits.
pub const fn rounded(product: u64, divisor: u64) -> u32 {
    let [a, b, c, d, ..] = ((product + divisor / 2) / divisor).to_le_bytes();
    u32::from_le_bytes([a, b, c, d])
}

/// Divider of the slow bus, at most 42 MHz; its timers run at twice that (RM0090 section 7.2).
pub const SLOW_BUS_DIVIDER: u32 = 4;
/// Divider of the fast bus, at most 84 MHz.
pub const FAST_BUS_DIVIDER: u32 = 2;

/// Ticks in a second.
pub const TICK_HZ: u32 = 1_000;

/// The frequencies in force.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rates {
    /// Processor and SysTick, Hz.
    pub core_hz: u32,
    /// TIM2, TIM3 and TIM5, Hz.
    pub timer_hz: u32,
    /// USART1 and the ADC's prescaler, Hz.
    pub fast_bus_hz: u32,
}

impl Rates {
    /// With the phase-locked loop at its full frequency.
    pub const FAST: Self = Self::fast(CORE_HZ);
    /// On the internal oscillator alone, nothing divided.
    pub const INTERNAL: Self = Self { core_hz: INTERNAL_HZ, timer_hz: INTERNAL_HZ, fast_bus_hz: INTERNAL_HZ };

    /// With the phase-locked loop at this frequency.
    pub const fn fast(core_hz: u32) -> Self {
        Self { core_hz, timer_hz: core_hz / SLOW_BUS_DIVIDER * 2, fast_bus_hz: core_hz / FAST_BUS_DIVIDER }
    }

    /// Timer counts in a tick, rounded to nearest: 12 ppm off at most with the phase-locked loop.
    pub const fn timer_counts_per_tick(self) -> u32 {
        (self.timer_hz + TICK_HZ / 2) / TICK_HZ
    }

    /// Processor cycles in a tick: exactly the timers' one, since the tick monitor must not drift against the sampling.
    pub const fn cycles_per_tick(self) -> u32 {
        self.timer_counts_per_tick() * ((self.core_hz + self.timer_hz / 2) / self.timer_hz)
    }

    /// USART divider of the link, rounded to nearest; with 16-fold oversampling it is the register's value (RM0090 section 30.3.4).
    pub const fn link_divider(self) -> u16 {
        // At most 84 MHz over 921,600 baud: far below 16 bits.
        let [low, high, ..] = ((self.fast_bus_hz + LINE_BAUD / 2) / LINE_BAUD).to_le_bytes();
        u16::from_le_bytes([low, high])
    }
}

// 0.2 % off with the phase-locked loop; a receiver tolerates about 3 %.
const _: () = assert!((Rates::FAST.link_divider() as u32 * LINE_BAUD).abs_diff(Rates::FAST.fast_bus_hz) < Rates::FAST.fast_bus_hz / 333);
/// Bytes the link receives in a tick at most, and a reserve of the background's longest pause while energised.
pub const RECEIVE_QUEUE: usize = 1024;
/// Bytes waiting for the line: two of the longest frames.
pub const TRANSMIT_QUEUE: usize = 768;

/// Sequence of the injected conversions. Mirrored, so that the means of both channels belong to the same instant.
pub const SAMPLING_SEQUENCE: [Channel; 4] = [Channel::Laser, Channel::Pressure, Channel::Pressure, Channel::Laser];
/// Channel of the chip's own reference voltage (RM0090 section 13.3.3), and of PA4, where the analogue drive can be read back. A regular
/// conversion a tick reads them in turn, behind the injected ones.
pub const READ_BACK_CHANNELS: [u8; 2] = [17, 4];
/// Where the factory left the reference voltage's code at 3.3 V and 30 degrees (DS8626 table 77).
pub const REFERENCE_CALIBRATION: usize = 0x1fff_7a2a;
/// Conversions of each channel in a tick, summed.
pub const CONVERSIONS_PER_CHANNEL: u16 = 2;
/// Code of one conversion at the reference voltage.
pub const CONVERTER_FULL_SCALE: u16 = 4095;
/// Reference voltage of the converters, VDDA.
pub const REFERENCE_V: f32 = 3.3;
/// What the logic needs to know of the converter.
pub const FACTS: RigFacts =
    RigFacts { converter: ConverterConfig { full_scale_code: CONVERTER_FULL_SCALE * CONVERSIONS_PER_CHANNEL, full_scale_v: REFERENCE_V } };
/// The ADC's clock is the fast bus over this: 21 MHz of at most 36 (DS8626 table 67).
pub const ADC_CLOCK_DIVIDER: u32 = 4;
const _: () = assert!(Rates::FAST.fast_bus_hz / ADC_CLOCK_DIVIDER <= 36_000_000);
// The sampling time is 84 ADC cycles (4 us) for the 1 kohm in front of the pins; a conversion 96, a tick's four 18 us.

/// An analogue input: the number is the ADC's channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Channel {
    /// PA0.
    Laser = 0,
    /// PA1.
    Pressure = 1,
}

/// Port B pin of the emergency stop.
pub const EMERGENCY_STOP_PIN: u32 = 0;
/// Port B pin of the dump valve.
pub const DUMP_VALVE_PIN: u32 = 1;
/// AHB1 peripheral clock enable register (RM0090 section 7.3.10), for the code that runs before there is RAM.
pub const RCC_AHB1ENR: u32 = 0x4002_3830;
/// Bit of port B in it.
pub const PORT_B_CLOCK: u32 = 1 << 1;
/// Port B's registers (RM0090 section 2.3).
pub const PORT_B: u32 = 0x4002_0400;

/// Watchdog oscillator, Hz, at its slowest and fastest (DS8626 table 42).
pub const WATCHDOG_HZ: (u32, u32) = (17_000, 47_000);

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
