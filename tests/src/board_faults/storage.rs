//! Rows of the matrix that damage flash or cut its operations.

use std::time::Duration;

use firmware::storage::HEADER_BYTES;
use host_tool::experiment;
use host_tool::link::{BoardModelConfig, FlashMemory};
use model_export::link::fault::Fault;
use model_export::link::message::Request;
use model_export::link::settings::{SettingValue, Settings, by_name};
use model_export::link::state::State;

use super::more::{joined, measured};
use super::{Bench, Expected, Measured, Row, is_thorough, set_point_flash};
use crate::hybrid;

/// First addresses of the settings' and the models' first slot (`firmware/src/board/stm32f405/facts.rs`).
const SETTINGS_SLOT: u32 = 0x080c_0000;
const MODEL_SLOT: u32 = 0x0808_0000;
/// Operations that a saving takes at least: an erase, a header, settings, an activation.
const FEWEST_OPERATIONS: u32 = 10;
/// Words of an activation (`firmware/src/storage.rs`).
const FIRST_ACTIVATION_WORD: u32 = 8;
const ACTIVATION_WORDS: u32 = 4;
/// From power to a state that a status tells.
const START_MS: u32 = 260;
/// The same for damaged settings, which are told before the self-test.
const SETTINGS_START_MS: u32 = 30;

fn ceiling_bar(bench: &mut Bench) -> Option<f32> {
    match host_tool::device_settings::setting(&mut bench.rig, "limits.ceiling_bar") {
        Ok(SettingValue::Float(bar)) => Some(bar),
        _ => None,
    }
}

/// Addresses of the words that a slot holds: header, first activation, payload.
fn words(slot: u32, payload_bytes: usize) -> Vec<u32> {
    let payload_words = u32::try_from(payload_bytes.div_ceil(4)).expect("a slot");
    let header = 0..5;
    let activation = FIRST_ACTIVATION_WORD..FIRST_ACTIVATION_WORD + ACTIVATION_WORDS;
    let payload = HEADER_BYTES / 4..HEADER_BYTES / 4 + payload_words;
    header.chain(activation).chain(payload).map(|word| slot + 4 * word).collect()
}

/// What became of the flipped bits of a sweep.
#[derive(Default)]
struct SweepCount {
    harmless: u32,
    detected: u32,
    /// Words with a bit whose flip was neither.
    missed: Vec<u32>,
}

impl SweepCount {
    /// Adds this to what was measured meanwhile.
    fn told(self, mut measured: Measured) -> Measured {
        let Self { harmless, detected, missed } = self;
        let remark = if missed.is_empty() {
            format!("{} flips: {detected} told, {harmless} harmless", harmless + detected)
        } else {
            format!("neither harmless nor told: {missed:#010x?}")
        };
        measured.ok &= missed.is_empty();
        measured.remark = joined(&measured.remark, &remark);
        measured
    }
}

/// Flips a bit, starts again, lets `judge` look, and flips it back; counts what was harmless, what was detected, and what was neither.
fn sweep(
    bench: &mut Bench,
    start_ms: u32,
    bits: impl IntoIterator<Item = (u32, u32)>,
    mut judge: impl FnMut(&mut Bench) -> Option<bool>,
) -> SweepCount {
    let mut count = SweepCount::default();
    for (word, bit) in bits {
        let flip = format!("flip {:08x} {}", word + bit / 8, bit % 8);
        bench.break_something(&flip);
        bench.break_something("reset");
        bench.pass(start_ms);
        let _ = bench.rig.greet_again();
        match judge(bench) {
            Some(true) => count.harmless += 1,
            Some(false) => count.detected += 1,
            None => count.missed.push(word),
        }
        bench.break_something(&flip);
    }
    count
}

/// Every bit of every word of the stored settings, on a board for each core; in a sample one bit of each.
pub(super) fn settings_bits() -> Measured {
    let ceiling = 1.25;
    let settings = Settings { control_law: 1, ceiling_bar: ceiling, ..Settings::default() };
    let bytes = firmware::settings::encode(&settings).expect("settings that can be encoded").len();
    let words = words(SETTINGS_SLOT, bytes);
    let boards = if is_thorough() { std::thread::available_parallelism().map_or(1, usize::from) } else { 1 };
    let parts: Vec<(Measured, SweepCount)> = std::thread::scope(|scope| {
        let parts = words.chunks(words.len().div_ceil(boards));
        let parts: Vec<_> = parts.map(|words| scope.spawn(|| settings_bits_of(words, ceiling))).collect();
        parts.into_iter().map(|part| part.join().expect("a sweep that ends")).collect()
    });
    let mut whole = SweepCount::default();
    for (_, part) in &parts {
        whole.harmless += part.harmless;
        whole.detected += part.detected;
        whole.missed.extend(&part.missed);
    }
    let worst = parts.into_iter().map(|(measured, _)| measured).reduce(|one, other| {
        let peak_bar = one.peak_bar.max(other.peak_bar);
        Measured { peak_bar, ..if one.ok { other } else { one } }
    });
    whole.told(worst.expect("a board at least"))
}

fn settings_bits_of(words: &[u32], ceiling: f32) -> (Measured, SweepCount) {
    let mut bench = Bench::start(&set_point_flash(ceiling), None);
    bench.pass(START_MS);
    let from = bench.watch.len();
    let all = words.iter().flat_map(|word| (0..32).map(move |bit| (*word, bit)));
    let all = all.filter(|(word, bit)| is_thorough() || word / 4 * 7 % 32 == *bit);
    let count = sweep(&mut bench, SETTINGS_START_MS, all, |bench| {
        let status = bench.status()?;
        if status.faults.contains(Fault::SettingsInvalid) {
            // Told, and it cannot be armed.
            let _ = bench.rig.ask(&Request::Arm);
            return (bench.status()?.state != State::Armed).then_some(false);
        }
        ceiling_bar(bench).is_some_and(|bar| bar <= ceiling).then_some(true)
    });
    (bench.measure(from, Expected::Bounded), count)
}

/// Power goes in the middle of every operation on flash of a saving, from the erase to the last word; in a sample of every ninth.
pub(super) fn cut_at_every_operation() -> Measured {
    // More than there are; the sweep ends with the first that there is not.
    const MOST: u32 = 200;
    let (mut cuts, mut peak_bar) = (0, 0.0f64);
    let stride = if is_thorough() { 1 } else { 9 };
    for operation in (1..=MOST).step_by(stride as usize) {
        let (measured, is_cut) = cut_at(operation);
        peak_bar = peak_bar.max(measured.peak_bar);
        if !measured.ok || !is_cut {
            let remark = if measured.ok {
                format!("{cuts} operations, one in {stride} of them cut")
            } else {
                format!("{operation}: {}", measured.remark)
            };
            return Measured { peak_bar, ok: measured.ok && cuts >= FEWEST_OPERATIONS, remark, ..measured };
        }
        cuts += stride;
    }
    Measured { detected_ms: None, peak_bar, fault: 0, ok: false, remark: format!("still at it after {MOST} operations") }
}

/// Bits all over the stored model.
pub(super) fn model_bits() -> Measured {
    let blob = hybrid::exported(&[8]);
    let flash = FlashMemory::with_model(&blob).expect("a model that fits");
    let mut bench = Bench::start(&flash, None);
    bench.pass(START_MS);
    let from = bench.watch.len();
    let all = words(MODEL_SLOT, blob.len());
    let (head, payload) = all.split_at(9);
    let some: Vec<u32> = head.iter().chain(payload.iter().step_by(payload.len().div_ceil(32))).copied().collect();
    // Another bit in every word.
    let bits = some.into_iter().zip((0..).step_by(11)).map(|(word, bit)| (word, bit % 32));
    let count = sweep(&mut bench, START_MS, bits, |bench| {
        experiment::settle(&mut bench.rig).ok();
        let status = bench.status()?;
        Some(!status.faults.contains(Fault::ModelCorrupt))
    });
    // A bit of the payload is under its checksum: only the log of activations corrects one.
    let harmless = count.harmless;
    let mut measured = count.told(bench.measure(from, Expected::Bounded));
    measured.ok &= harmless <= ACTIVATION_WORDS;
    measured
}

/// The upper half of what was saved is erased: a sector whose erase did not end, or cells that lost their charge.
pub(super) fn half_settings(board: &BoardModelConfig, row: &Row) -> Measured {
    let settings = Settings { control_law: 1, ceiling_bar: 1.25, ..Settings::default() };
    let bytes = firmware::settings::encode(&settings).expect("settings that can be encoded").len();
    let flash = FlashMemory::default().with_settings(&settings).expect("settings that fit");
    let mut bench = Bench::start_on(board.clone(), &flash, None);
    bench.pass(START_MS);
    let first = SETTINGS_SLOT + HEADER_BYTES;
    let end = first + u32::try_from(bytes).expect("a slot");
    for place in (first + (end - first) / 8 * 4..end).step_by(2) {
        bench.break_something(&format!("store {place:08x} ffff"));
    }
    bench.break_something("reset");
    let from = bench.watch.len();
    bench.pass(700);
    let _ = bench.rig.greet_again();
    let _ = bench.rig.ask(&Request::Arm);
    let _ = bench.rig.ask(&Request::Start);
    bench.hold(200);
    bench.measure(from, row.expected)
}

/// Saves settings while flash takes its longest times: nothing bites, and the new ones are there.
pub(super) fn slow_erase() -> Measured {
    let mut bench = Bench::start(&set_point_flash(2.0), Some(("late-flash", None)));
    experiment::settle(&mut bench.rig).expect("a self-test that ends");
    let number = by_name("limits.ceiling_bar").expect("a setting").number;
    let resets = bench.rig.transport().processor().pins().resets;
    let from = bench.watch.len();
    bench.rig.command(&Request::SettingSet { number, value: SettingValue::Float(1.0) }).expect("a setting that is taken");
    let _ = bench.rig.send(&Request::SettingsSave);
    bench.pass(3000);
    let _ = bench.rig.listen(Duration::from_millis(50));
    let (now, fault) = (bench.rig.transport().processor().pins().resets, bench.fault().0);
    let saved = bench.status().is_some_and(|status| !status.settings_unsaved);
    let problem = (now != resets || fault != 0 || !saved).then(|| format!("{} resets, E{fault:03}, saved: {saved}", now - resets));
    measured(&mut bench, from, problem, String::new())
}

/// A second model arrives and power goes: the first one is still there, or the second is.
pub(super) fn cut_while_uploading(operation: u32) -> Measured {
    let (old, new) = (hybrid::exported(&[4]), hybrid::exported(&[8]));
    // The header and the activation are the last eight words.
    let operation = if operation == 0 { 1 + u32::try_from(new.len().div_ceil(4)).expect("a slot") + 4 } else { operation };
    let flash = FlashMemory::with_model(&old).expect("a model that fits");
    let mut bench = Bench::start(&flash, None);
    experiment::settle(&mut bench.rig).expect("a self-test that ends");
    bench.break_something(&format!("cut {operation}"));
    let from = bench.watch.len();
    let outcome = experiment::upload(&mut bench.rig, &new, &mut |_| {});
    bench.pass(3000);
    let _ = bench.rig.greet_again();
    let resets = bench.rig.transport().processor().pins().resets;
    let settled = experiment::settle(&mut bench.rig).is_ok();
    let corrupt = bench.status().is_none_or(|status| status.faults.contains(Fault::ModelCorrupt));
    let problem = (!settled || corrupt || resets == 0).then(|| format!("settled: {settled}, {resets} resets, upload: {outcome:?}"));
    measured(&mut bench, from, problem, String::new())
}

/// Saves a lower ceiling and cuts the supply meanwhile.
pub(super) fn cut_while_saving(operation: u32) -> Measured {
    cut_at(operation).0
}

/// The same, and whether there was an operation to cut.
fn cut_at(operation: u32) -> (Measured, bool) {
    const OLD_BAR: f32 = 2.0;
    const NEW_BAR: f32 = 1.0;
    /// The longest that saving and the start behind a cut take, ms.
    const LONGEST_MS: u32 = 4000;
    let mut bench = Bench::start(&set_point_flash(OLD_BAR), None);
    experiment::settle(&mut bench.rig).expect("a self-test that ends");
    let number = by_name("limits.ceiling_bar").expect("a setting").number;
    let value = SettingValue::Float(NEW_BAR);
    bench.rig.command(&Request::SettingSet { number, value }).expect("a setting that is taken");
    bench.break_something(&format!("cut {operation}"));
    let from = bench.watch.len();
    let _ = bench.rig.send(&Request::SettingsSave);
    let mut passed_ms = 0;
    while passed_ms < LONGEST_MS && bench.rig.transport().processor().pins().resets == 0 {
        bench.pass(20);
        passed_ms += 20;
    }
    bench.pass(60);
    let _ = bench.rig.listen(Duration::from_millis(50));
    let is_cut = bench.rig.transport().processor().pins().resets > 0;
    let _ = bench.rig.greet_again();
    let after = host_tool::device_settings::setting(&mut bench.rig, "limits.ceiling_bar").ok();
    let mut measured = bench.measure(from, Expected::OldOrNew);
    let float = |bar: f32| Some(SettingValue::Float(bar));
    if after != float(OLD_BAR) && after != float(NEW_BAR) {
        measured.ok = false;
        measured.remark = format!("the ceiling is {after:?} afterwards");
    } else if !is_cut {
        // So few operations: nothing was cut, and the new value has to be there.
        measured.ok = after == float(NEW_BAR);
        measured.remark = "the saving was over before".to_owned();
    }
    (measured, is_cut)
}
