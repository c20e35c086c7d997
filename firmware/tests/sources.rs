//! Rules that hold for the board's sources, which no desktop test can run.

use std::path::Path;

/// The chips.
const CHIPS: [&str; 2] = ["stm32f405", "stm32h743"];

/// Every file of a chip's registers, with its text.
fn chip_sources(chip: &str) -> Vec<(String, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/board").join(chip).join("registers");
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let sources: Vec<_> =
        files.map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), std::fs::read_to_string(&path).unwrap())).collect();
    assert!(sources.len() >= 9, "{}", sources.len());
    sources
}

/// Places where a peripheral's clock is switched on by hand.
fn clocks_switched_on_by_hand(text: &str) -> usize {
    text.lines().filter(|line| line.contains("enr()") && line.contains("set_bit()") && !line.contains("$register")).count()
}

#[test]
fn peripherals_clocks_are_switched_on_only_where_their_arrival_is_waited_for() {
    for chip in CHIPS {
        let mut users = 0;
        for (name, text) in chip_sources(chip) {
            assert_eq!(clocks_switched_on_by_hand(&text), 0, "{chip}, {name}: use enable_clock!");
            users += text.matches("enable_clock!(").count();
        }
        assert!(users >= 8, "{chip}: {users}");
    }
    assert_eq!(clocks_switched_on_by_hand("rcc.apb1enr().modify(|_, w| w.tim3en().set_bit());"), 1, "the rule can fail");
}

#[test]
fn the_dump_valves_pin_goes_high_in_one_place() {
    for chip in CHIPS {
        let (mut highs, mut makers) = (0, 0);
        for (name, text) in chip_sources(chip) {
            let in_pins = name == "pins.rs";
            let count = text.matches("write(1 << WIRING.dump_valve.number").count();
            assert!(count == 0 || in_pins, "{chip}, {name}");
            highs += count;
            let count = text.matches("DumpValve::new(").count();
            assert!(count == 0 || in_pins, "{chip}, {name}");
            makers += count;
        }
        assert_eq!((highs, makers), (1, 1), "{chip}");
    }
}
