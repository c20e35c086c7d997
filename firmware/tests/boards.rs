//! The boards' constants: what their chips can do, what their drawings say, what else is on them.

use firmware::board::stm32f405::wiring::{DRIVE, PROBE, PULSE, Pin, Wiring};
use firmware::board::{custom_f405, feather_f405, nucleo_h743zi, stm32h743};

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
        Wiring { hse_hz: 27_000_000, ..good },
    ] {
        assert!(!wrong.is_possible(), "{wrong:?}");
    }
}

/// Each board's drawing names each of its pins, with what it is for.
#[test]
fn every_pin_is_in_the_boards_drawing() {
    let of_f405 = |wiring: Wiring| {
        let Wiring { laser, pressure, emergency_stop, dump_valve, transmit, receive, .. } = wiring;
        (wiring.name, wiring.hse_hz, [laser, pressure, DRIVE, PULSE, emergency_stop, dump_valve, transmit, receive])
    };
    let of_h743 = |wiring: stm32h743::wiring::Wiring| {
        use stm32h743::wiring::{DRIVE, PULSE, RECEIVE, TRANSMIT, Wiring};
        let Wiring { laser, pressure, emergency_stop, dump_valve, .. } = wiring;
        (wiring.name, wiring.hse_hz, [laser, pressure, DRIVE, PULSE, emergency_stop, dump_valve, TRANSMIT, RECEIVE])
    };
    for ((name, hse_hz, pins), drawing) in [
        (of_f405(custom_f405::WIRING), include_str!("../src/board/custom_f405/wiring.md")),
        (of_f405(feather_f405::WIRING), include_str!("../src/board/feather_f405/wiring.md")),
        (of_h743(nucleo_h743zi::WIRING), include_str!("../src/board/nucleo_h743zi/wiring.md")),
    ] {
        let functions =
            ["laser", "measured pressure", "valve drive, analogue", "valve drive, pulse width", "emergency stop", "dump valve", "TX", "RX"];
        for (pin, function) in pins.into_iter().zip(functions) {
            let pin = format!("P{}{}", char::from_u32('A' as u32 + pin.port).unwrap(), pin.number);
            let is_drawn = |line: &str| line.contains(function) && line.split(|c: char| !c.is_alphanumeric()).any(|word| word == pin);
            assert!(drawing.lines().any(is_drawn), "{name}: {pin}, {function}");
        }
        assert!(drawing.contains(&format!("{} MHz", hse_hz / 1_000_000)), "{name}");
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
