//! Rows of the matrix that need more than one thing to strike: storage, frames, memory, instructions.

use std::time::Duration;

use firmware::storage::HEADER_BYTES;
use host_tool::experiment;
use host_tool::link::{BoardModelConfig, FlashMemory, Transport};
use model_export::link::fault::Fault;
use model_export::link::message::{Message, Quantity, Request, RequestFrame};
use model_export::link::settings::{SettingValue, Settings, by_name};
use model_export::link::state::State;

use super::{Bench, CEILING_BAR, Expected, Injection, Measured, Row, SET_POINT_BAR, WATCHED_MS, set_point_flash};
use crate::hybrid;

/// First addresses of the settings' and the models' first slot (`firmware/src/board/stm32f405/facts.rs`).
const SETTINGS_SLOT: u32 = 0x080c_0000;
const MODEL_SLOT: u32 = 0x0808_0000;
/// Where static memory begins, and how much of it the sweep takes (`memory.x`: the stack is below).
const STATICS: u32 = 0x2000_4000;
const STATICS_BYTES: u32 = 20 << 10;
/// Operations that a saving takes at least: an erase, a header, settings, an activation.
const FEWEST_OPERATIONS: u32 = 10;
/// Words of an activation (`firmware/src/storage.rs`).
const FIRST_ACTIVATION_WORD: u32 = 8;
const ACTIVATION_WORDS: u32 = 4;
/// The tick's entry in the vector table: interrupt 18, ADC (RM0090 table 62).
const TICK_VECTOR: u32 = 0x0800_0000 + 4 * (16 + 18);
/// From power to a state that a status tells.
const START_MS: u32 = 260;
/// The same for damaged settings, which are told before the self-test.
const SETTINGS_START_MS: u32 = 30;

fn measured(bench: &mut Bench, from: usize, problem: Option<String>, remark: String) -> Measured {
    let mut measured = bench.measure(from, Expected::Bounded);
    measured.ok &= problem.is_none();
    measured.remark = joined(&measured.remark, &problem.unwrap_or(remark));
    measured
}

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

fn joined(one: &str, other: &str) -> String {
    [one, other].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("; ")
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

/// Whether sweeps are complete: when rows are asked for by name (`BOARD_FAULTS`). Beside all the others they take a sample.
fn is_thorough() -> bool {
    std::env::var_os("BOARD_FAULTS").is_some_and(|rows| rows != "all")
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
        let (measured, is_cut) = super::cut_at(operation);
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

/// The longest tick, in cycles of the emulated processor, and late ticks, while pressure is held for half a second; with nonsense beside the host's
/// frames or without.
fn longest_tick(nonsense: Option<&[u8]>) -> (u32, u32, Bench) {
    let mut bench = Bench::start(&set_point_flash(CEILING_BAR as f32), None);
    bench.run_up();
    forget_longest_tick(&mut bench);
    for ms in 0..500 {
        if ms % 10 == 0 {
            bench.rig.send(&Request::SetPoint { quantity: Quantity::Pressure, value: SET_POINT_BAR as f32 }).expect("a line");
        }
        if let Some(nonsense) = nonsense {
            bench.rig.transport().send(nonsense).expect("a line");
        }
        bench.pass(1);
    }
    let status = bench.status().expect("a status");
    assert_eq!(status.state, State::Running, "the host goes on");
    (status.longest_tick_cycles, status.late_ticks, bench)
}

/// The device keeps the longest tick since its start, which does more than any tick afterwards. Here its memory of that is cleared.
fn forget_longest_tick(bench: &mut Bench) {
    let longest = bench.status().expect("a status").longest_tick_cycles;
    let statics = bench.rig.transport().processor().read(STATICS, STATICS_BYTES).expect("memory");
    let words = statics.as_chunks::<4>().0.iter().zip((STATICS..).step_by(4));
    let places: Vec<u32> = words.filter(|(word, _)| u32::from_le_bytes(**word) == longest).map(|(_, place)| place).collect();
    assert!(!places.is_empty(), "the longest tick is nowhere in memory");
    for place in places {
        bench.break_something(&format!("store {place:08x} 0000"));
    }
}

/// Whatever the line carries, the tick takes as long as without.
pub(super) fn babble_beside_the_host() -> Measured {
    // Ends of frames among them, so that the device has something to check all the time, and the host's frames begin after one.
    let nonsense: Vec<u8> = (0..69u8).map(|index| if index % 23 == 22 { 0 } else { index.wrapping_mul(89) | 1 }).collect();
    let (quiet, ..) = longest_tick(None);
    let (loud, late, mut bench) = longest_tick(Some(&nonsense));
    // A thousandth of a tick.
    let problem = (loud > quiet + 168 || late > 0).then(|| format!("{quiet} cycles without, {loud} with, {late} late ticks"));
    measured(&mut bench, 0, problem, format!("{quiet} cycles without, {loud} with"))
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

/// Bits of static memory under pressure, some hundred, on as many chips as vent.
pub(super) fn memory_bits() -> Measured {
    const FLIPS: u32 = 200;
    let (mut flips, mut vented, mut chance) = (0, 0, 0x2545_f491u32);
    let (mut peak_bar, mut problem) = (0.0f64, None);
    loop {
        let mut bench = Bench::start(&set_point_flash(CEILING_BAR as f32), None);
        bench.run_up();
        let from = bench.watch.len();
        while flips < FLIPS && bench.watch.since(from).iter().all(|moment| moment.energised) {
            chance = chance.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let (address, bit) = (STATICS + (chance >> 8) % STATICS_BYTES, chance >> 29);
            bench.break_something(&format!("flip {address:08x} {bit}"));
            flips += 1;
            bench.hold(20);
        }
        vented += u32::from(bench.watch.since(from).iter().any(|moment| !moment.energised));
        bench.hold(100);
        let measured = bench.measure(from, Expected::Bounded);
        peak_bar = peak_bar.max(measured.peak_bar);
        if !measured.ok {
            problem = Some(measured.remark);
        }
        if flips >= FLIPS || problem.is_some() {
            let ok = problem.is_none();
            let remark = problem.unwrap_or(format!("{flips} flips, {vented} vented, none went beyond its limits"));
            return Measured { detected_ms: None, peak_bar, fault: 0, ok, remark };
        }
    }
}

/// Instructions in place of the tick's.
pub(super) fn in_the_tick(board: &BoardModelConfig, row: &Row, instructions: &[u16]) -> Measured {
    let mut bench = Bench::start_on(board.clone(), &set_point_flash(CEILING_BAR as f32), None);
    bench.run_up();
    let read = |bench: &mut Bench, address| bench.rig.transport().processor().read(address, 4).expect("memory");
    let entry = read(&mut bench, TICK_VECTOR);
    let entry = u32::from_le_bytes([entry[0], entry[1], entry[2], entry[3]]) & !1;
    let places: Vec<u32> = (0..).step_by(2).map(|offset| entry + offset).take(instructions.len()).collect();
    let before: Vec<u16> = places
        .iter()
        .map(|place| {
            let bytes = bench.rig.transport().processor().read(*place, 2).expect("memory");
            u16::from_le_bytes([bytes[0], bytes[1]])
        })
        .collect();
    let from = bench.watch.len();
    let store = |bench: &mut Bench, words: &[u16]| {
        for (place, word) in places.iter().zip(words) {
            bench.break_something(&format!("store {place:08x} {word:04x}"));
        }
    };
    store(&mut bench, instructions);
    bench.pass(20);
    store(&mut bench, &before);
    bench.pass(400);
    bench.hold(WATCHED_MS);
    bench.measure(from, row.expected)
}

/// The supply falls slowly, stays low, and comes back.
pub(super) fn supply_ramp(row: &Row, step_mv: u32) -> Measured {
    let mut bench = Bench::start(&set_point_flash(CEILING_BAR as f32), None);
    bench.run_up();
    let from = bench.watch.len();
    let mut supply_mv = 3300;
    while supply_mv > 1500 {
        supply_mv -= step_mv;
        bench.break_something(&format!("supply {supply_mv}"));
        bench.pass(1);
    }
    bench.pass(WATCHED_MS);
    bench.break_something("supply 3300");
    bench.pass(400);
    bench.measure(from, row.expected)
}

/// Laser and pressure exchanged by whoever wired the rig.
pub(super) fn inputs_swapped(board: &BoardModelConfig, row: &Row) -> Measured {
    let mut bench = Bench::start_on(board.clone(), &set_point_flash(CEILING_BAR as f32), Some(("inputs swapped", None)));
    experiment::settle(&mut bench.rig).ok();
    let from = bench.watch.len();
    let _ = bench.rig.ask(&Request::Arm);
    let _ = bench.rig.ask(&Request::Start);
    bench.hold(WATCHED_MS);
    let mut measured = bench.measure(from, row.expected);
    measured.ok &= measured.fault != 0;
    measured
}

/// Frames that are not this host's, or not new.
pub(super) fn strange_frames(board: &BoardModelConfig, row: &Row) -> Measured {
    let mut bench = Bench::start_on(board.clone(), &set_point_flash(CEILING_BAR as f32), None);
    bench.run_up();
    let session = bench.rig.hello().session;
    let more = Request::SetPoint { quantity: Quantity::Pressure, value: 2.5 };
    let (token, session) = if row.injection == Injection::OldFrame { (1, session) } else { (u32::MAX, session ^ 0x5a5a) };
    let frame = RequestFrame { token, session, request: more }.to_wire().expect("a frame");
    let from = bench.watch.len();
    for _ in 0..WATCHED_MS / 10 {
        bench.rig.transport().send(&frame).expect("a line");
        bench.hold(10);
    }
    let highest = bench.watch.since(from).iter().map(|moment| moment.pressure_bar).fold(0.0, f64::max);
    let running = bench.status().is_some_and(|status| status.state == State::Running);
    let problem = (highest > SET_POINT_BAR + 0.1 || !running).then(|| format!("{highest:.2} bar, running: {running}"));
    measured(&mut bench, from, problem, String::new())
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
