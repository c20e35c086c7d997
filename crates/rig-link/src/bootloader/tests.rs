use super::image::tests_support::{elf, program};
use super::model::{Mishap, Model};
use super::*;

/// Three sectors and a bit.
const LENGTH: usize = 50_000;

fn image() -> ProgramImage {
    ProgramImage::of(&elf(&program(LENGTH), |_| {})).expect("a sound image")
}

fn update(model: &mut Model) -> Result<(), UpdateError> {
    let mut bootloader = Bootloader::connect(model)?;
    bootloader.update(&image(), |_| {})
}

/// The new program is whole, or nothing starts; models and settings are as they were in any case.
fn is_safe(model: &Model) -> bool {
    let image = image();
    let new = &model.flash[..image.bytes().len()] == image.bytes();
    let old = model.flash[..LENGTH].iter().all(|byte| *byte == 0x11);
    let no_start = model.flash[4..8] == [0xff; 4];
    // A start that was only half erased or half written is none either: its low word would have to be right for that.
    let no_stack = model.flash[..8] != image.bytes()[..8] && !old;
    assert!(model.flash[512 * 1024..].iter().all(|byte| *byte == 0x5a), "models and settings stay");
    new || old || no_start || no_stack
}

fn with_old_program() -> Model {
    Model::over(&[0x11; LENGTH])
}

#[test]
fn a_program_is_erased_written_read_back_and_started() {
    let mut model = with_old_program();
    let image = image();
    let mut heard = Vec::new();
    let mut bootloader = Bootloader::connect(&mut model).unwrap();
    bootloader.update(&image, |bytes| heard.push(bytes)).unwrap();
    bootloader.go(FLASH_BASE).unwrap();
    assert_eq!(&model.flash[..image.bytes().len()], image.bytes());
    // Four sectors, and no more: what lies behind the last of them is untouched.
    assert!(model.flash[image.bytes().len()..512 * 1024].iter().all(|byte| *byte == 0xff));
    assert_eq!((heard.last(), model.started_at), (Some(&image.bytes().len()), Some(FLASH_BASE)));
    assert!(is_safe(&model));
}

#[test]
fn another_chip_is_left_as_it_is() {
    let mut model = with_old_program();
    model.chip = 0x450;
    assert!(matches!(update(&mut model), Err(UpdateError::OtherChip { found: 0x450, expected: 0x413 })));
    assert_eq!(model.counts[1], 0, "nothing was erased or written");
}

#[test]
fn nobody_at_the_other_end_is_named() {
    let mut model = with_old_program();
    model.cut_at = Some(1);
    assert!(matches!(update(&mut model), Err(UpdateError::Silent)));
}

#[test]
fn every_single_byte_that_is_lost_or_flipped_on_either_way_is_made_good() {
    // The bytes of the first steps, of the first erases and of some blocks: every kind of moment there is.
    for mishap in [Mishap::Lost, Mishap::Flipped] {
        for number in (1..700).chain((700..70_000).step_by(997)) {
            for to_device in [true, false] {
                let mut model = with_old_program();
                let plan = Box::new(move |count: usize| if count == number { mishap } else { Mishap::None });
                if to_device {
                    model.to_device = plan
                } else {
                    model.from_device = plan
                }
                let outcome = update(&mut model);
                assert!(outcome.is_ok(), "byte {number} {mishap:?}, to the device: {to_device}: {outcome:?}");
                assert_eq!(&model.flash[..image().bytes().len()], image().bytes(), "byte {number} {mishap:?}");
            }
        }
    }
}

#[test]
fn refusals_are_tried_again_and_too_many_of_them_are_an_error_that_says_where() {
    let mut model = with_old_program();
    model.refuses = vec![1, 2, 3, 7, 8, 20, 22, 24];
    update(&mut model).unwrap();
    let mut model = with_old_program();
    model.refuses = (10..200).collect();
    let failed = update(&mut model).unwrap_err();
    assert!(matches!(failed, UpdateError::Failed { what: "erasing a sector", address: FLASH_BASE }), "{failed}");
    assert!(failed.to_string().contains("--in-bootloader"));
    assert!(is_safe(&model));
}

#[test]
fn a_bad_line_ends_in_the_program_or_in_an_error_and_never_in_half_a_program_that_starts() {
    let (mut whole, mut failed) = (0, 0);
    for seed in 1..60_u64 {
        let mut model = with_old_program();
        // A byte in 80 to 5,000 goes wrong.
        let rate = u64::MAX / (80 * (1 + seed * seed % 67));
        let noise = |mut state: u64| {
            move |_: usize| {
                state ^= state << 13;
                state ^= state >> 7;
                state ^= state << 17;
                if state > rate {
                    Mishap::None
                } else if state & 1 == 0 {
                    Mishap::Lost
                } else {
                    Mishap::Flipped
                }
            }
        };
        model.to_device = Box::new(noise(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15)));
        model.from_device = Box::new(noise(seed.wrapping_mul(0xd1b5_4a32_d192_ed03)));
        match update(&mut model) {
            Ok(()) => {
                assert_eq!(&model.flash[..image().bytes().len()], image().bytes(), "seed {seed}");
                whole += 1;
            }
            Err(_) => failed += 1,
        }
        assert!(is_safe(&model), "seed {seed}");
    }
    assert!(whole > 10 && failed > 3, "{whole} whole, {failed} failed");
}

#[test]
fn a_power_cut_at_any_moment_leaves_nothing_that_starts_and_the_next_attempt_mends_it() {
    let mut reference = with_old_program();
    update(&mut reference).unwrap();
    let [bytes, operations, _] = reference.counts;
    let cuts = (1..400).chain((400..bytes).step_by(1499)).map(|at| (Some(at), None));
    for (cut_at, cut_in_operation) in cuts.chain((1..=operations).map(|at| (None, Some(at)))) {
        let mut model = with_old_program();
        (model.cut_at, model.cut_in_operation) = (cut_at, cut_in_operation);
        assert!(update(&mut model).is_err(), "cut at byte {cut_at:?}, operation {cut_in_operation:?}");
        assert!(is_safe(&model), "cut at byte {cut_at:?}, operation {cut_in_operation:?}");
        model.power_up();
        update(&mut model).unwrap();
        assert_eq!(&model.flash[..image().bytes().len()], image().bytes());
    }
}
