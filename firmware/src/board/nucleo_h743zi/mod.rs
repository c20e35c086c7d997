#![doc = include_str!("wiring.md")]

use super::stm32f405::wiring::Pin;
use super::stm32h743::wiring::Wiring;

/// The board's constants.
pub const WIRING: Wiring = Wiring {
    name: "nucleo-h743zi",
    hse_hz: 8_000_000,
    has_clock_signal: true,
    laser: Pin::new('A', 3),
    pressure: Pin::new('C', 0),
    emergency_stop: Pin::new('E', 9),
    dump_valve: Pin::new('E', 11),
};
const _: () = assert!(WIRING.is_possible());
