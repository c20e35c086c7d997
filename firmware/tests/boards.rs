//! The boards' constants: what their chips can do, what their drawings say, what else is on them.

use firmware::board::stm32f405::wiring::{DRIVE, PROBE, PULSE, Pin, Wiring};
use firmware::board::{custom_f405, feather_f405};

#[test]
fn a_board_that_the_chip_cannot_do_is_refused() {
    let good = custom_f405::WIRING;
    assert!(good.is_possible());
    for wrong in [
        Wiring { laser: Pin::new('B', 7), ..good },
        Wiring { pressure: good.laser, ..good },
        Wiring { dump_valve: DRIVE, ..good },
        Wiring { emergency_stop: Pin::new('A', 13), ..good },
        Wiring { transmit: Pin::new('C', 6), ..good },
        Wiring { crystal_hz: 27_000_000, ..good },
    ] {
        assert!(!wrong.is_possible(), "{wrong:?}");
    }
}

/// Each board's drawing names each of its pins, with what it is for.
#[test]
fn every_pin_is_in_the_boards_drawing() {
    for (wiring, drawing) in [
        (custom_f405::WIRING, include_str!("../src/board/custom_f405/wiring.md")),
        (feather_f405::WIRING, include_str!("../src/board/feather_f405/wiring.md")),
    ] {
        let functions = [
            (wiring.laser, "laser"),
            (wiring.pressure, "measured pressure"),
            (DRIVE, "valve drive, analogue"),
            (PULSE, "valve drive, pulse width"),
            (wiring.emergency_stop, "emergency stop"),
            (wiring.dump_valve, "dump valve"),
            (wiring.transmit, "link, TX"),
            (wiring.receive, "link, RX"),
        ];
        for (pin, function) in functions {
            let name = format!("P{}{}", char::from_u32('A' as u32 + pin.port).unwrap(), pin.number);
            let is_drawn = |line: &str| line.contains(function) && line.split(|c: char| !c.is_alphanumeric()).any(|word| word == name);
            assert!(drawing.lines().any(is_drawn), "{}: {name}, {function}", wiring.name);
        }
        assert!(drawing.contains(&format!("{} MHz", wiring.crystal_hz / 1_000_000)), "{}", wiring.name);
    }
}

/// What is fitted on the Feather and where: flash chip, card socket, NeoPixel, battery divider, LED, USB, 32 kHz crystal.
#[test]
fn no_pin_of_the_feather_is_taken_by_something_on_it() {
    let taken = [
        ('B', 3),
        ('B', 4),
        ('B', 5),
        ('A', 15), // flash chip
        ('C', 8),
        ('C', 9),
        ('C', 10),
        ('C', 11),
        ('C', 12),
        ('D', 2),
        ('B', 12), // card
        ('C', 0),
        ('C', 1),
        ('A', 3),
        ('A', 11),
        ('A', 12),
        ('C', 14),
        ('C', 15),
    ];
    // What its headers carry, without power and the probe's connector.
    let broken_out = [
        ('A', 4),
        ('A', 5),
        ('A', 6),
        ('A', 7),
        ('C', 4),
        ('C', 5),
        ('B', 13),
        ('B', 15),
        ('B', 14),
        ('B', 11),
        ('B', 10),
        ('C', 7),
        ('C', 6),
        ('B', 8),
        ('B', 9),
        ('C', 3),
        ('C', 2),
        ('C', 1),
        ('B', 6),
        ('B', 7),
    ];
    let among = |pin: Pin, list: &[(char, u32)]| list.iter().any(|(port, number)| pin == Pin::new(*port, *number));
    for pin in feather_f405::WIRING.pins().into_iter().filter(|pin| !PROBE.contains(pin)) {
        assert!(among(pin, &broken_out) && !among(pin, &taken), "{pin:?}");
    }
}
