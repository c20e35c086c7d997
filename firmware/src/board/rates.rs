//! The frequencies in force, and what follows from them for tick and line.

use model_export::link::LINE_BAUD;

/// Ticks in a second.
pub const TICK_HZ: u32 = 1_000;

/// The frequencies in force.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rates {
    /// Processor and SysTick, Hz.
    pub core_hz: u32,
    /// The timers', Hz.
    pub timer_hz: u32,
    /// The serial port's, Hz.
    pub line_hz: u32,
}

impl Rates {
    /// Timer counts in a tick, rounded to nearest: 12 ppm off at most with the phase-locked loop.
    pub const fn timer_counts_per_tick(self) -> u32 {
        (self.timer_hz + TICK_HZ / 2) / TICK_HZ
    }

    /// Processor cycles in a tick: exactly the timers' one, since the tick monitor must not drift against the sampling.
    pub const fn cycles_per_tick(self) -> u32 {
        self.timer_counts_per_tick() * ((self.core_hz + self.timer_hz / 2) / self.timer_hz)
    }

    /// Divider of the serial port, rounded to nearest; with 16-fold oversampling it is the register's value (RM0090 section 30.3.4, RM0433
    /// section 48.5.7).
    pub const fn link_divider(self) -> u16 {
        // Some 100 MHz over 921,600 baud: far below 16 bits.
        let [low, high, ..] = ((self.line_hz + LINE_BAUD / 2) / LINE_BAUD).to_le_bytes();
        u16::from_le_bytes([low, high])
    }

    /// Whether the line's speed is met within this many parts per thousand; a receiver tolerates about 30.
    pub const fn meets_the_line(self, per_mille: u32) -> bool {
        (self.link_divider() as u32 * LINE_BAUD).abs_diff(self.line_hz) < self.line_hz / 1000 * per_mille
    }
}

/// The quotient rounded to nearest, of numbers whose quotient has 32 bits.
pub const fn rounded(product: u64, divisor: u64) -> u32 {
    let [a, b, c, d, ..] = ((product + divisor / 2) / divisor).to_le_bytes();
    u32::from_le_bytes([a, b, c, d])
}
