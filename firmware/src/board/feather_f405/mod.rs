#![doc = include_str!("wiring.md")]

use super::stm32f405::wiring::{Pin, Wiring};

/// The board's constants.
pub const WIRING: Wiring = Wiring {
    name: "feather-f405",
    hse_hz: 12_000_000,
    laser: Pin::new('C', 4),
    pressure: Pin::new('C', 5),
    emergency_stop: Pin::new('C', 6),
    dump_valve: Pin::new('C', 7),
    transmit: Pin::new('B', 6),
    receive: Pin::new('B', 7),
};
const _: () = assert!(WIRING.is_possible());
