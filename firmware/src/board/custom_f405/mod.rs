#![doc = include_str!("wiring.md")]

use super::stm32f405::wiring::{Pin, Wiring};

/// The board's constants.
pub const WIRING: Wiring = Wiring {
    name: "custom-f405",
    hse_hz: 8_000_000,
    laser: Pin::new('A', 0),
    pressure: Pin::new('A', 1),
    emergency_stop: Pin::new('B', 0),
    dump_valve: Pin::new('B', 1),
    transmit: Pin::new('A', 9),
    receive: Pin::new('A', 10),
};
const _: () = assert!(WIRING.is_possible());
