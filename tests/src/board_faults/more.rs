//! Rows of the matrix that need more than one thing to strike: frames, memory, instructions, inputs.

use host_tool::experiment;
use host_tool::link::{BoardModel, BoardModelConfig, HardwareConfig, Lockstep, Transport};
use model_export::link::fault::Fault;
use model_export::link::message::{Message, Quantity, Request, RequestFrame};
use model_export::link::state::State;

use super::{
    Bench, CEILING_BAR, Expected, Injection, Measured, Row, SET_POINT_BAR, WATCHED_MS, at_rest, is_thorough, power, set_point_flash,
};
use crate::board_model::{Watch, meet};

/// Where static memory begins, and how much of it the sweep takes (`memory.x`: the stack is below).
const STATICS: u32 = 0x2000_4000;
const STATICS_BYTES: u32 = 20 << 10;
/// The tick's entry in the vector table: interrupt 18, ADC (RM0090 table 62).
const TICK_VECTOR: u32 = 0x0800_0000 + 4 * (16 + 18);
/// The program's flash.
const PROGRAM: u32 = 0x0800_0000;
const PROGRAM_BYTES: u32 = 256 << 10;
/// Executable flash behind every image (`memory.x`).
const UNUSED_PROGRAM: u32 = 0x0807_f000;

pub(super) fn measured(bench: &mut Bench, from: usize, problem: Option<String>, remark: String) -> Measured {
    let mut measured = bench.measure(from, Expected::Bounded);
    measured.ok &= problem.is_none();
    measured.remark = joined(&measured.remark, &problem.unwrap_or(remark));
    measured
}

pub(super) fn joined(one: &str, other: &str) -> String {
    [one, other].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("; ")
}

/// The longest tick, in cycles of the emulated processor, and late ticks, while pressure is held for half a second; with nonsense beside the host's
/// frames or without.
fn longest_tick(board: &BoardModelConfig, nonsense: Option<&[u8]>) -> (u32, u32, Bench) {
    let mut bench = Bench::start_on(board.clone(), &set_point_flash(CEILING_BAR as f32), None);
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
pub(super) fn babble_beside_the_host(board: &BoardModelConfig) -> Measured {
    // Ends of frames among them, so that the device has something to check all the time, and the host's frames begin after one.
    let nonsense: Vec<u8> = (0..69u8).map(|index| if index % 23 == 22 { 0 } else { index.wrapping_mul(89) | 1 }).collect();
    let (quiet, ..) = longest_tick(board, None);
    let (loud, late, mut bench) = longest_tick(board, Some(&nonsense));
    // A thousandth of a tick.
    let problem = (loud > quiet + 168 || late > 0).then(|| format!("{quiet} cycles without, {loud} with, {late} late ticks"));
    measured(&mut bench, 0, problem, format!("{quiet} cycles without, {loud} with"))
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

/// A branch from one place to another behind it (B.W, Armv7-M manual section A7.7.12, encoding T4).
fn branch(from: u32, to: u32) -> [u16; 2] {
    let halfwords = (to - from - 4) / 2;
    let [low, high] = [halfwords & 0x7ff, halfwords >> 11];
    assert!(high < 0x400, "a short way");
    [0xf000 | high, 0xb800 | low].map(|word| u16::try_from(word).expect("16 bits"))
}

/// Instructions in place of the tick's. They lie in flash that the program does not use.
pub(super) fn in_the_tick(board: &BoardModelConfig, row: &Row, instructions: &[u16], milliseconds: u32) -> Measured {
    let mut bench = Bench::start_on(board.clone(), &set_point_flash(CEILING_BAR as f32), None);
    bench.run_up();
    let read = |bench: &mut Bench, address| bench.rig.transport().processor().read(address, 4).expect("memory");
    let entry = read(&mut bench, TICK_VECTOR);
    let entry = u32::from_le_bytes([entry[0], entry[1], entry[2], entry[3]]) & !1;
    let halfwords = |first: u32, words: &[u16]| (first..).step_by(2).zip(words.to_vec()).collect::<Vec<_>>();
    let branch = halfwords(entry, &branch(entry, UNUSED_PROGRAM));
    let before: Vec<(u32, u16)> = branch
        .iter()
        .map(|(place, _)| {
            let bytes = bench.rig.transport().processor().read(*place, 2).expect("memory");
            (*place, u16::from_le_bytes([bytes[0], bytes[1]]))
        })
        .collect();
    let from = bench.watch.len();
    let store = |bench: &mut Bench, words: &[(u32, u16)]| {
        for (place, word) in words {
            bench.break_something(&format!("store {place:08x} {word:04x}"));
        }
    };
    store(&mut bench, &halfwords(UNUSED_PROGRAM, instructions));
    store(&mut bench, &branch);
    bench.pass(milliseconds);
    store(&mut bench, &before);
    bench.pass(400);
    bench.watch_from(from, at_rest);
    bench.measure(from, row.expected)
}

/// Bits of the program, from the vector table to the last constant, each before a start of its own. What the start itself needs cannot tell
/// anything when it is damaged: it has to leave the pins alone. All else has to be found by the check of the program.
pub(super) fn program_bits(board: &BoardModelConfig) -> Measured {
    /// Places of a sample, and of the whole sweep.
    const PLACES: (usize, usize) = (12, 256);
    let flash = set_point_flash(CEILING_BAR as f32);
    let (mut intact, _) = power(board.clone(), &flash, None, HardwareConfig::default());
    let program = intact.processor().read(PROGRAM, PROGRAM_BYTES).expect("memory");
    let length = program.iter().rposition(|byte| *byte != 0xff).expect("a program");
    let places = if is_thorough() { PLACES.1 } else { PLACES.0 };
    let (mut told, mut silent, mut missed, mut peak_bar) = (0, 0, Vec::new(), 0.0f64);
    for (offset, bit) in (0..length).step_by(length.div_ceil(places)).zip((0..).step_by(3)) {
        let place = PROGRAM + u32::try_from(offset).expect("an address");
        let flip = format!("flip {place:08x} {}", bit % 8);
        let start = || power(board.clone(), &flash, Some((&flip, None)), HardwareConfig::default());
        let (lockstep, watch) = start();
        let is_told = meet(lockstep).ok().map(|rig| {
            let mut bench = Bench { rig, watch: watch.clone() };
            let _ = experiment::settle(&mut bench.rig);
            let _ = bench.rig.ask(&Request::Arm);
            let _ = bench.rig.ask(&Request::Start);
            bench.hold(100);
            // Where the damage lies in what tells it, the log has it still.
            bench.status().is_some_and(|status| status.faults.contains(Fault::FlashCorrupt))
                || bench.rig.transport().processor().log().contains(Fault::FlashCorrupt.explanation().name)
        });
        let moments = watch.since(0);
        peak_bar = moments.iter().map(|moment| moment.pressure_bar).fold(peak_bar, f64::max);
        match is_told {
            _ if moments.iter().any(|moment| moment.energised) => missed.push(place),
            Some(true) => told += 1,
            None if rests(start().0) => silent += 1,
            _ => missed.push(place),
        }
    }
    let ok = missed.is_empty() && told > 2 * silent;
    let remark = if missed.is_empty() {
        format!("{} flips: {told} told, {silent} silent and vented", told + silent)
    } else {
        format!("energised or not told: {missed:#010x?}")
    };
    let fault = if told > 0 { Fault::FlashCorrupt.number() } else { 0 };
    Measured { detected_ms: None, peak_bar, fault, ok, remark }
}

/// Whether the pins of a board that never ticks are at rest for a second: nobody else sees them.
fn rests(mut lockstep: Lockstep<BoardModel, Watch>) -> bool {
    (0..1000).all(|_| {
        lockstep.advance().expect("a running board");
        let pins = lockstep.processor().pins();
        !pins.energised && pins.valve_share == 0
    })
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

/// Laser and pressure exchanged in the middle of a ramp, where both read alike, so that nothing jumps.
pub(super) fn inputs_swap_alike(board: &BoardModelConfig, row: &Row) -> Measured {
    /// Of the ranges: less than what either reading may jump by.
    const ALIKE: f64 = 0.005;
    const RAMP_BAR_PER_S: f64 = 0.5;
    // The straight tip stands where the pressure sensor reads 1.2 bar.
    let hardware = HardwareConfig { rest_mm: 4.0, ..HardwareConfig::default() };
    let HardwareConfig { rest_mm, laser_range_mm, pressure_range_bar, .. } = hardware;
    let mut bench = Bench::start_with(board.clone(), &set_point_flash(CEILING_BAR as f32), None, hardware);
    bench.run_up();
    let ramp = |first_bar: f64| move |ms: u32| (first_bar + RAMP_BAR_PER_S * f64::from(ms) / 1000.0).min(CEILING_BAR);
    bench.ask_for(2000, |_| 0.3);
    let are_alike = |bench: &mut Bench| {
        let hardware = bench.rig.transport().hardware();
        let laser = (rest_mm + hardware.displacement_mm()) / laser_range_mm;
        (laser - hardware.pressure_bar() / pressure_range_bar).abs() < ALIKE
    };
    let mut ms = 0;
    while !are_alike(&mut bench) && ms < 5400 {
        bench.ask_for(10, |_| ramp(0.3)(ms));
        ms += 10;
    }
    let (found, from) = (are_alike(&mut bench), bench.watch.len());
    bench.break_something("inputs swapped");
    bench.watch_from(from, ramp(ramp(0.3)(ms)));
    let mut measured = bench.measure(from, row.expected);
    measured.ok &= found;
    if !found {
        measured.remark = joined(&measured.remark, "they never read alike");
    }
    measured
}

/// Everything that moved the rig is said again after a reset, before and after the next host has begun.
pub(super) fn boot_before(board: &BoardModelConfig, row: &Row) -> Measured {
    let mut bench = Bench::start_on(board.clone(), &set_point_flash(CEILING_BAR as f32), None);
    bench.run_up();
    let session = bench.rig.hello().session;
    let set_point = Request::SetPoint { quantity: Quantity::Pressure, value: 2.5 };
    let frames: Vec<_> = (u32::MAX - 3..)
        .zip([Request::Arm, Request::Start, set_point])
        .map(|(token, request)| RequestFrame { token, session, request }.to_wire().expect("a frame"))
        .collect();
    let from = bench.watch.len();
    bench.break_something("reset");
    bench.pass(700);
    let say_again = |bench: &mut Bench| {
        for frame in &frames {
            bench.rig.transport().send(frame).expect("a line");
            bench.pass(50);
        }
    };
    say_again(&mut bench);
    let _ = bench.rig.greet_again();
    experiment::settle(&mut bench.rig).expect("a self-test that ends");
    say_again(&mut bench);
    let vented = bench.watch.since(from).iter().skip_while(|moment| moment.energised).all(|moment| !moment.energised);
    let mut measured = bench.measure(from, row.expected);
    if !vented {
        measured.ok = false;
        measured.remark = joined(&measured.remark, "an old session closed the dump valve");
    }
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
