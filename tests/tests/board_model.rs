//! The flashable image, byte for byte, on a register-level model of its chip: equal to the library to the bit, no register without a model,
//! and safe whatever breaks. `cargo xtask test` builds what these tests need.

use host_tool::link::{BoardModel, BoardModelConfig, Breakage, FlashMemory, Hardware, HardwareConfig, Lockstep};
use host_tool::plant::{Plant, PlantConfig};
use model_export::link::fault::Fault;
use model_export::link::profiles::PROFILES;
use rig_tests::board_faults::{ROWS, Row, held_with_drive, measure_all, measure_all_on, profile_ends, slice, slice_in_the_chip};
use rig_tests::board_model::{ModelRig, config, config_of, meet, played, played_on, unmodelled};
use rig_tests::hybrid;

fn rig(seed: u64, flash: &FlashMemory) -> ModelRig {
    rig_of(&rig_config(seed), flash)
}

fn rig_of(config: &BoardModelConfig, flash: &FlashMemory) -> ModelRig {
    let processor = BoardModel::start(config.clone(), flash).unwrap();
    let plant = Plant::new(PlantConfig::default()).unwrap();
    let hardware = Hardware::new(HardwareConfig::default(), Box::new(plant.start(0.0)));
    meet(Lockstep::new(processor, hardware, (), "the board's model", "test").unwrap()).unwrap()
}

fn rig_config(seed: u64) -> BoardModelConfig {
    BoardModelConfig { seed, ..config() }
}

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn the_image_in_closed_loop_is_the_library_to_the_bit_and_every_register_it_touches_has_a_model() {
    let blob = hybrid::exported(&[8]);
    let slice = played(&blob, 6.0, 1);
    println!("{slice:?}");
    assert!(slice.bit_equal, "the library gives other outputs");
    assert!(slice.ticks > 6_000, "{} ticks", slice.ticks);
    assert_eq!(slice.unmodelled, Vec::<String>::new());
}

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn equal_seeds_give_equal_runs() {
    let run = || {
        let mut rig = rig(7, &FlashMemory::default());
        rig.transport().advance_for(300).unwrap();
        let pins = *rig.transport().processor().pins();
        let memory = rig.transport().processor().read(0x2000_0000, 0x2_0000).unwrap();
        (pins, memory, rig.hello().clone())
    };
    assert!(run() == run());
}

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn settings_that_are_saved_lie_in_the_chips_flash_and_outlast_a_reset() {
    use model_export::link::message::Request;
    use model_export::link::settings::{SettingValue, by_name};
    let mut rig = rig(1, &FlashMemory::default());
    host_tool::experiment::settle(&mut rig).unwrap();
    let number = by_name("limits.ceiling_bar").unwrap().number;
    rig.command(&Request::SettingSet { number, value: SettingValue::Float(1.25) }).unwrap();
    rig.command(&Request::SettingsSave).unwrap();
    rig.transport().processor().break_something("reset").unwrap();
    rig.transport().advance_for(200).unwrap();
    assert_eq!(host_tool::device_settings::setting(&mut rig, "limits.ceiling_bar").unwrap(), SettingValue::Float(1.25));
    assert_eq!(unmodelled(&mut rig), Vec::<String>::new());
}

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn the_last_seconds_before_a_fault_outlast_a_reset_and_the_image_logs_what_happened() {
    use host_tool::{experiment, history};
    use model_export::link::message::{Quantity, Request};
    use model_export::link::settings::{SettingValue, by_name};
    use model_export::link::state::State;

    let mut rig = rig(1, &FlashMemory::default());
    experiment::settle(&mut rig).unwrap();
    let build = rig.hello().build;
    assert_eq!(build.chip & 0xfff, 0x413, "the chip's identifier");
    let law = by_name("control.law").unwrap().number;
    rig.command(&Request::SettingSet { number: law, value: SettingValue::Integer(1) }).unwrap();
    rig.transport().advance_for(200).unwrap();
    rig.command(&Request::Arm).unwrap();
    rig.command(&Request::Start).unwrap();
    for _ in 0..230 {
        rig.send(&Request::SetPoint { quantity: Quantity::Pressure, value: 1.5 }).unwrap();
        rig.transport().advance_for(10).unwrap();
    }
    assert_eq!(history::fetch(&mut rig).unwrap(), None, "it records");
    let sample = std::iter::from_fn(|| rig.take_telemetry()).last().expect("telemetry");
    assert!((sample.supply_v.unwrap() - 3.3).abs() < 0.02, "{sample:?}");
    assert!(sample.stack_unused_bytes > 1024 && sample.longest_tick_cycles > 1000, "{sample:?}");

    // The host is silent, the rig vents; then the chip is reset.
    rig.transport().advance_for(400).unwrap();
    let status = experiment::status(&mut rig).unwrap();
    assert_eq!(status.state, State::Fault);
    let before = history::fetch(&mut rig).unwrap().expect("rows");
    assert_eq!(before.len(), 2000);
    rig.transport().processor().break_something("reset").unwrap();
    rig.transport().advance_for(300).unwrap();
    rig.greet_again().unwrap();
    let rows = history::fetch(&mut rig).unwrap().expect("rows");
    assert_eq!(rows, before, "the reset left them alone");
    let last = rows[1999].1;
    assert_eq!((last.state, last.energised), (State::Fault, false));
    assert!(rows[..1990].iter().all(|(_, row)| row.state == State::Running && row.energised && row.set_point_thousandths == 1500));
    let settings = model_export::link::settings::Settings::default();
    let units = history::in_units(&rows, &settings).unwrap();
    assert!((units[1900].pressure_measured_bar - 1.5).abs() < 0.05, "{:?}", units[1900]);

    let log = rig.transport().processor().log().to_owned();
    println!("{log}");
    for text in [
        "custom-f405, firmware",
        "started by",
        "state Running",
        "error E028 in state Running",
        "refused: NoRecord",
        "the run before ended in",
    ] {
        assert!(log.contains(text), "`{text}` is not in the log");
    }
    assert_eq!(unmodelled(&mut rig), Vec::<String>::new());
}

/// What the image's stack is for: messages, a model that is uploaded, checked and activated, settings that are saved, each under a tick.
#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn an_upload_and_its_check_leave_a_quarter_of_the_stack() {
    use host_tool::experiment;
    use model_export::link::message::Request;

    let blob = hybrid::exported(&[8]);
    let mut rig = rig(1, &FlashMemory::default());
    experiment::settle(&mut rig).unwrap();
    let at_the_start = experiment::status(&mut rig).unwrap().stack_unused_bytes;
    experiment::upload(&mut rig, &blob, &mut |_| {}).unwrap();
    let id = model_export::blob::content_id(&blob).unwrap();
    rig.command(&Request::ModelActivate { id }).unwrap();
    experiment::settle_after_change(&mut rig).unwrap();
    rig.command(&Request::SettingsSave).unwrap();
    // The image looks at its stack now and then.
    rig.transport().advance_for(500).unwrap();
    let unused = experiment::status(&mut rig).unwrap().stack_unused_bytes;
    println!("stack never used: {at_the_start} bytes after the start, {unused} after an upload");
    assert!(unused > 4096, "{unused} bytes of stack left");
}

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn both_drives_hold_the_same_pressure() {
    let [(by_voltage_bar, voltage), (by_width_bar, width)] = [0, 1].map(held_with_drive);
    // A step of the converter is 1.2 mbar at 5 bar full scale, one of the pulse width as much.
    assert!((by_voltage_bar - by_width_bar).abs() < 0.005, "{by_voltage_bar} and {by_width_bar} bar");
    assert!(voltage.abs_diff(width) < 64, "{voltage} and {width}");
}

/// Whether all that there is is asked for.
fn measures_all() -> bool {
    std::env::var("BOARD_FAULTS").is_ok_and(|rows| rows == "all")
}

/// Which rows to measure: those that `BOARD_FAULTS` names, with commas; with `all` every one; without it the slice.
fn wanted(slice: Vec<&'static Row>) -> Vec<&'static Row> {
    match std::env::var("BOARD_FAULTS") {
        Err(_) => slice,
        Ok(all) if all == "all" => ROWS.iter().collect(),
        Ok(names) => ROWS.iter().filter(|row| names.split(',').any(|name| name == row.name)).collect(),
    }
}

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn every_fault_of_the_matrix_ends_as_its_row_says() {
    let rows = wanted(slice());
    let all = measure_all(&rows, |row, measured| println!("{:26} {measured:?}", row.name));
    assert_eq!(all.len(), rows.len(), "every row was measured");
    let failed: Vec<String> = rows
        .iter()
        .zip(&all)
        .filter(|(_, measured)| !measured.ok)
        .map(|(row, measured)| format!("{}: {}", row.name, measured.remark))
        .collect();
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn the_feathers_image_in_closed_loop_on_its_own_pins_and_hse_is_the_library_to_the_bit() {
    let slice = played_on(&config_of("feather-f405"), &hybrid::exported(&[8]), 2.0, 3);
    println!("{slice:?}");
    assert!(slice.bit_equal, "the library gives other outputs");
    assert!(slice.ticks > 2_000, "{} ticks", slice.ticks);
    assert_eq!(slice.unmodelled, Vec::<String>::new());
    assert!(slice.log.contains("MHz from the HSE"), "{}", slice.log);
}

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn the_second_chip_familys_image_in_closed_loop_is_the_library_to_the_bit() {
    let slice = played_on(&config_of("nucleo-h743zi"), &hybrid::exported(&[8]), 2.0, 4);
    println!("{slice:?}");
    assert!(slice.bit_equal, "the library gives other outputs");
    assert!(slice.ticks > 2_000, "{} ticks", slice.ticks);
    assert_eq!(slice.unmodelled, Vec::<String>::new());
    assert!(slice.log.contains("400 MHz from the HSE"), "{}", slice.log);
}

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn every_profile_holds_pressure_on_the_image_and_ends_in_its_safe_state() {
    let full_scale = host_tool::link::FACTS.converter;
    let code_of = |v: f32| (v / full_scale.full_scale_v * f32::from(full_scale.full_scale_code)).round() as u16;
    let mut was_stopped = false;
    for profile in PROFILES {
        // A sensor's profile has its error signals to show, a valve's that its drive rests; beside them, each end that the others have. Without
        // being asked for all of it, one signal of each sensor.
        let mut breakages = Vec::new();
        if profile.is_sensor() {
            let signals = if measures_all() { profile.error_signals } else { &profile.error_signals[..1.min(profile.error_signals.len())] };
            let codes = signals.iter().map(|signal| code_of(profile.circuit.pin_v(*signal)));
            breakages.extend(codes.map(|code| (Breakage::LaserCode(code), Fault::LaserRange)));
        } else {
            breakages.push((Breakage::PressureCode(0), Fault::PressureRange));
        }
        if measures_all() || !profile.is_sensor() && !std::mem::replace(&mut was_stopped, true) {
            breakages.push((Breakage::EmergencyStop, Fault::EmergencyStop));
        }
        for (breakage, fault) in breakages {
            let end = profile_ends(profile, breakage);
            println!("{end:?}");
            assert!(end.rests && end.stays, "{end:?}");
            assert!((end.held_bar - 1.0).abs() < 0.05, "{end:?}");
            // What a single fault may take, whatever the valve and the sensors.
            assert!(end.safe_ms.is_some_and(|ms| ms <= 50), "{end:?}");
            assert_eq!(end.fault, fault.number(), "{end:?}");
        }
    }
}

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn the_noise_at_rest_is_what_the_sensors_have() {
    use model_export::link::message::{Reply, Request};
    let mut rig = rig(1, &FlashMemory::default());
    host_tool::experiment::settle(&mut rig).unwrap();
    rig.transport().advance_for(2500).unwrap();
    let Reply::RestNoise(noise) = rig.request(&Request::RestNoise).unwrap() else { panic!("no noise") };
    println!("{noise:?}");
    // The simulated sensors have noise of two codes to either side, evenly spread: 1.4 codes. A code is 20 mm or 6 bar of 2.4 V, 8190 of 3.3 V.
    for codes in [noise.laser_codes, noise.pressure_codes] {
        assert!((1.0..2.0).contains(&codes), "{noise:?}");
    }
    let per_code = 3.3 / 8190.0 / 2.4;
    assert!((noise.laser_mm / noise.laser_codes - 20.0 * per_code).abs() < 1e-6, "{noise:?}");
    assert!((noise.pressure_bar / noise.pressure_codes - 6.0 * per_code).abs() < 1e-6, "{noise:?}");
}

/// What the second chip's model can break. The rest needs parts that it has not: see the book.
const OF_THE_SECOND_CHIP: [&str; 31] = [
    "core-hangs",
    "reset-while-running",
    "reset-while-armed",
    "reset-in-self-test",
    "emergency-stop",
    "laser-wire-broken",
    "laser-at-full-scale",
    "laser-fault-code-in-band",
    "laser-frozen",
    "laser-jumps-5-mm",
    "laser-frozen-with-noise",
    "pressure-wire-broken",
    "pressure-at-full-scale",
    "pressure-frozen",
    "pressure-jumps-1-bar",
    "host-silent",
    "host-babbles",
    "babble-beside-the-host",
    "line-noise-2-percent",
    "valve-fully-open",
    "supply-pressure-fails",
    "muscle-bursts",
    "drive-pin-stuck-high",
    "drive-pin-stuck-low",
    "pulse-pin-stuck-high",
    "pulse-pin-stuck-low",
    "dump-pin-stuck-low",
    "dump-pin-stuck-high",
    "inputs-swap-under-pressure",
    "frames-of-another-session",
    "undefined-instruction",
];

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn the_faults_that_the_second_chips_model_knows_end_as_their_rows_say_on_its_image() {
    let board = config_of("nucleo-h743zi");
    let known = |row: &&Row| OF_THE_SECOND_CHIP.contains(&row.name);
    assert_eq!(ROWS.iter().filter(known).count(), OF_THE_SECOND_CHIP.len(), "every name is a row");
    let rows: Vec<&Row> = wanted(slice_in_the_chip(&OF_THE_SECOND_CHIP)).into_iter().filter(known).collect();
    println!("{} rows", rows.len());
    let failed: Vec<String> = measure_all_on(&board, &rows, |row, measured| println!("{:26} {measured:?}", row.name))
        .iter()
        .zip(&rows)
        .filter(|(measured, _)| !measured.ok)
        .map(|(measured, row)| format!("{}: {}", row.name, measured.remark))
        .collect();
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn the_second_chip_family_tells_which_chip_it_is_and_raises_its_brown_out_level_once() {
    let mut rig = rig_of(&config_of("nucleo-h743zi"), &FlashMemory::default());
    assert_eq!(rig.hello().build.chip & 0xfff, 0x450, "the chip's identifier (RM0433 chapter 60)");
    rig.transport().processor().break_something("reset").unwrap();
    rig.transport().advance_for(200).unwrap();
    let log = rig.transport().processor().log().to_owned();
    assert_eq!(log.matches("nucleo-h743zi, firmware").count(), 2, "two starts: {log}");
    assert_eq!(log.matches("brown-out level programmed").count(), 1, "{log}");
    assert_eq!(unmodelled(&mut rig), Vec::<String>::new());
}

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn settings_of_the_second_chip_family_lie_in_its_flash_and_outlast_a_reset() {
    use model_export::link::message::Request;
    use model_export::link::settings::{SettingValue, by_name};
    let mut rig = rig_of(&config_of("nucleo-h743zi"), &FlashMemory::default());
    host_tool::experiment::settle(&mut rig).unwrap();
    let number = by_name("limits.ceiling_bar").unwrap().number;
    for ceiling_bar in [1.25, 1.5, 0.75] {
        rig.command(&Request::SettingSet { number, value: SettingValue::Float(ceiling_bar) }).unwrap();
        rig.command(&Request::SettingsSave).unwrap();
        rig.transport().processor().break_something("reset").unwrap();
        rig.transport().advance_for(200).unwrap();
        assert_eq!(host_tool::device_settings::setting(&mut rig, "limits.ceiling_bar").unwrap(), SettingValue::Float(ceiling_bar));
        host_tool::experiment::settle(&mut rig).unwrap();
    }
    assert_eq!(unmodelled(&mut rig), Vec::<String>::new());
}

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn an_image_on_another_boards_pins_is_refused() {
    let wrong = host_tool::link::BoardModelConfig { board: "feather-f405".to_owned(), ..config() };
    let mut processor = BoardModel::start(wrong, &FlashMemory::default()).unwrap();
    let error = processor.report().unwrap_err().to_string();
    assert!(error.contains("is no image of the board feather-f405"), "{error}");
}
