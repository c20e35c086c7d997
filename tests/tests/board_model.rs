//! The flashable image, byte for byte, on a register-level model of its chip: equal to the library to the bit, no register without a model,
//! and safe whatever breaks. `cargo xtask test` builds what these tests need.

use host_tool::link::{BoardModel, FlashMemory, Hardware, HardwareConfig, Lockstep};
use host_tool::plant::{Plant, PlantConfig};
use rig_tests::board_faults::{ROWS, held_with_drive, measure};
use rig_tests::board_model::{ModelRig, config, played, unmodelled};
use rig_tests::hybrid;

fn rig(seed: u64, flash: &FlashMemory) -> ModelRig {
    let processor = BoardModel::start(rig_config(seed), flash).unwrap();
    let plant = Plant::new(PlantConfig::default()).unwrap();
    let hardware = Hardware::new(HardwareConfig::default(), Box::new(plant.start(0.0)));
    ModelRig::connect(Lockstep::new(processor, hardware, (), "the board's model", "test").unwrap()).unwrap()
}

fn rig_config(seed: u64) -> host_tool::link::BoardModelConfig {
    host_tool::link::BoardModelConfig { seed, ..config() }
}

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn the_image_in_closed_loop_is_the_library_to_the_bit_and_every_register_it_touches_has_a_model() {
    let blob = hybrid::exported(&[8]);
    let slice = played(&blob, 10.0, 1);
    println!("{slice:?}");
    assert!(slice.bit_equal, "the library gives other outputs");
    assert!(slice.ticks > 10_000, "{} ticks", slice.ticks);
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
    assert_eq!(host_tool::experiment::setting(&mut rig, "limits.ceiling_bar").unwrap(), SettingValue::Float(1.25));
    assert_eq!(unmodelled(&mut rig), Vec::<String>::new());
}

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn both_drives_hold_the_same_pressure() {
    let [(by_voltage_bar, voltage), (by_width_bar, width)] = [0, 1].map(held_with_drive);
    // A step of the converter is 1.2 mbar at 5 bar full scale, one of the pulse width as much.
    assert!((by_voltage_bar - by_width_bar).abs() < 0.005, "{by_voltage_bar} and {by_width_bar} bar");
    assert!(voltage.abs_diff(width) < 64, "{voltage} and {width}");
}

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn every_fault_of_the_matrix_ends_as_its_row_says() {
    let mut failed = Vec::new();
    for row in ROWS {
        let measured = measure(row);
        println!("{:26} {:?}", row.name, measured);
        if !measured.ok {
            failed.push(format!("{}: {}", row.name, measured.remark));
        }
    }
    assert!(failed.is_empty(), "{}", failed.join("\n"));
}
