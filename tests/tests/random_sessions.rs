//! Random sessions with faults on the simulated rig: whatever host, sensors, pneumatics and settings do, the output stays below the ceiling,
//! moves no faster than the slew limit, and the pressure in the muscle never exceeds the ceiling.
//!
//! A slice of them runs with every test; `CATHETER_SESSIONS=10000 cargo test --release -p rig-tests --test random_sessions` runs all.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::OnceLock;

use firmware::device::exchange::InjectedFault;
use host_tool::experiment;
use host_tool::link::{Breakage, Client, FlashMemory, Hardware, HardwareConfig, InProcess, Lockstep, Observer, TickRecord, Transport};
use host_tool::network::Mode;
use host_tool::plant::{Plant, PlantConfig};
use model_export::link::message::{PlaybackChunk, Quantity, Request};
use model_export::link::settings::Settings;
use model_export::link::state::State;
use rig_tests::models;

/// Sessions in a test run; all 10,000 take about a minute.
const SLICE: u64 = 150;
/// Times at which the host does something.
const TURNS: u32 = 120;

/// The splitmix64 generator: a few lines, and every session has its own seed.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    fn below(&mut self, limit: u64) -> u64 {
        self.next() % limit
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// What a session saw.
#[derive(Default)]
struct Seen {
    tracks: bool,
    ticks: u64,
    energised_ticks: u64,
    highest_ubar: i32,
    faults: u64,
    violation: Option<String>,
}

/// Holds every tick against the limits.
struct Watch {
    seen: Rc<RefCell<Seen>>,
    ceiling_ubar: i32,
    up_ubar: i32,
    down_ubar: i32,
    before_ubar: i32,
    before: State,
}

impl Observer for Watch {
    fn see(&mut self, record: &TickRecord<'_>, _hardware: &Hardware) {
        let TickRecord::Tick { inputs, outputs, .. } = record else {
            if matches!(record, TickRecord::Boot { .. }) {
                (self.before_ubar, self.before) = (0, State::Boot);
            }
            return;
        };
        let mut seen = self.seen.borrow_mut();
        seen.ticks += 1;
        seen.energised_ticks += u64::from(outputs.energised);
        seen.highest_ubar = seen.highest_ubar.max(outputs.output_ubar);
        seen.faults += u64::from(outputs.state == State::Fault && self.before != State::Fault);
        let change = outputs.output_ubar - self.before_ubar;
        // Lost ticks do not widen the step: the limiter counts its own.
        let too_fast = change > self.up_ubar || (outputs.energised && -change > self.down_ubar);
        let too_high = outputs.output_ubar > self.ceiling_ubar || outputs.output_ubar < 0;
        let without_energy = !outputs.energised && (outputs.output_ubar != 0 || outputs.valve_share != 0);
        if (too_fast || too_high || without_energy) && seen.violation.is_none() {
            let before_ubar = self.before_ubar;
            seen.violation = Some(format!("tick {}: {before_ubar} microbar, then {outputs:?} after {inputs:?}", seen.ticks));
        }
        (self.before_ubar, self.before) = (outputs.output_ubar, outputs.state);
    }
}

/// A number that may be anything, most often a plausible pressure.
fn any_number(random: &mut Random) -> f32 {
    match random.below(12) {
        0 => f32::NAN,
        1 => f32::INFINITY,
        2 => f32::NEG_INFINITY,
        3 => f32::from_bits((random.next() >> 32) as u32),
        4 => random.between(-1e6, 1e6) as f32,
        _ => random.between(-0.5, 6.0) as f32,
    }
}

/// A model with everything that the controllers need of the actuator; not that of the simulated one, so that they err.
fn model() -> &'static [u8] {
    static MODEL: OnceLock<Vec<u8>> = OnceLock::new();
    MODEL.get_or_init(|| {
        let physics = models::model(models::physics_front_end(3, 8, 2), None, Mode::Streaming);
        models::exported_with(&physics, 3, Some(models::compensation()))
    })
}

/// Settings of a session; any way of tracking, with gains from sensible to absurd.
fn any_settings(random: &mut Random) -> Settings {
    Settings {
        ceiling_bar: random.between(0.5, 3.5) as f32,
        slew_up_bar_per_s: random.between(0.5, 60.0) as f32,
        slew_down_bar_per_s: random.between(0.5, 60.0) as f32,
        control_law: random.below(4).min(2) as u32,
        playback_period_ms: random.between(1.0, 40.0) as u32,
        laser_required: random.below(2) == 0,
        feed_forward: random.below(4) as u32,
        feedback_sensor: random.below(4) as u32,
        pid_proportional: 10f64.powf(random.between(-2.0, 2.0)) as f32,
        pid_integral_per_s: 10f64.powf(random.between(-1.0, 3.0)) as f32,
        pid_derivative_s: 10f64.powf(random.between(-3.0, 1.0)) as f32,
        pid_limit_mm: random.between(0.0, 1000.0) as f32,
        transfer_s: 10f64.powf(random.between(-3.0, 1.0)) as f32,
        outside_domain: random.below(3) as u32,
        estimate_by_physics: random.below(2) == 0,
        mismatch_displacement_mm: if random.below(2) == 0 { 0.0 } else { 5.0 },
        ..Settings::default()
    }
}

fn any_request(random: &mut Random, index: &mut u32) -> Request {
    match random.below(30) {
        0 | 1 => Request::Arm,
        2 | 3 => Request::Start,
        4 => Request::Stop,
        5 => Request::Disarm,
        6 => Request::Vent,
        7 | 8 => Request::Acknowledge,
        9 => Request::PlaybackClear,
        10 => Request::Status,
        11..=18 => {
            let values_bar =
                (0..random.below(6)).map(|_| any_number(random)).filter(|value| value.is_finite()).collect::<heapless::Vec<_, 32>>();
            let first_index = *index;
            *index += values_bar.len() as u32;
            Request::Playback(PlaybackChunk { first_index, last: random.below(10) == 0, values_bar })
        }
        19..=22 => Request::SetPoint { quantity: Quantity::Displacement, value: 3.0 * any_number(random) },
        _ => Request::SetPoint { quantity: Quantity::Pressure, value: any_number(random) },
    }
}

fn any_breakage(random: &mut Random) -> Option<Breakage> {
    let code = random.below(8191) as u16;
    Some(match random.below(14) {
        0 => Breakage::LaserCode(code),
        1 => Breakage::LaserFrozen,
        2 => Breakage::LaserOffsetMm(random.between(-20.0, 20.0)),
        3 => Breakage::PressureCode(code),
        4 => Breakage::PressureFrozen,
        5 => Breakage::PressureOffsetBar(random.between(-3.0, 3.0)),
        6 => Breakage::EmergencyStop,
        7 => Breakage::EveryTickLate,
        8 => Breakage::TicksLost(random.below(60) as u16),
        9 => Breakage::MuscleBursts,
        10 => Breakage::SupplyFails,
        11 => Breakage::ValveFullyOpen,
        12 => Breakage::DumpValveStuckClosed,
        _ => return None,
    })
}

/// One session; what it saw.
fn session(seed: u64) -> Seen {
    let mut random = Random(seed);
    let settings = any_settings(&mut random);
    let tracks = settings.control_law == 2;
    let (ceiling_bar, up, down) = (settings.ceiling_bar, settings.slew_up_bar_per_s, settings.slew_down_bar_per_s);
    let seen = Rc::new(RefCell::new(Seen { tracks, ..Seen::default() }));
    let watch = Watch {
        seen: Rc::clone(&seen),
        ceiling_ubar: (f64::from(ceiling_bar) * 1e6) as i32,
        up_ubar: (f64::from(up) * 1e3) as i32,
        down_ubar: (f64::from(down) * 1e3) as i32,
        before_ubar: 0,
        before: State::Boot,
    };
    let flash = if tracks { FlashMemory::with_model(model()).unwrap() } else { FlashMemory::default() };
    let flash = flash.with_settings(&settings).unwrap();
    let plant = Plant::new(PlantConfig::default()).unwrap();
    // The wiring instructions: the supply is set to the ceiling.
    let config = HardwareConfig { supply_bar: f64::from(ceiling_bar), seed: seed as u32, ..HardwareConfig::default() };
    let hardware = Hardware::new(config, Box::new(plant.start(0.0)));
    let rig = Lockstep::new(InProcess::new(flash), hardware, watch, "a random session", "virtual").unwrap();
    let mut rig = Client::connect(rig).unwrap();
    experiment::settle(&mut rig).unwrap();
    // Most sessions begin as a sensible host would, so that the faults strike a rig under pressure.
    if random.below(4) > 0 {
        rig.send(&Request::Playback(PlaybackChunk { first_index: 0, last: false, values_bar: [0.4, 0.8].into_iter().collect() })).unwrap();
        rig.send(&Request::Arm).unwrap();
        rig.transport().advance_for(3).unwrap();
        rig.send(&Request::Start).unwrap();
    }
    let mut index = 2;
    for turn in 0..TURNS {
        let calm = turn < TURNS / 3 && random.below(8) > 0;
        let request = if calm && tracks {
            Request::SetPoint { quantity: Quantity::Displacement, value: random.between(0.0, 20.0) as f32 }
        } else if calm {
            Request::SetPoint { quantity: Quantity::Pressure, value: random.between(0.0, 4.0) as f32 }
        } else {
            any_request(&mut random, &mut index)
        };
        rig.send(&request).unwrap();
        if random.below(20) == 0 {
            let noise: Vec<u8> = (0..random.below(40)).map(|_| random.next() as u8).collect();
            rig.transport().send(&noise).unwrap();
        }
        if random.below(15) == 0 {
            let breakage = if random.below(3) == 0 { None } else { any_breakage(&mut random) };
            rig.transport().hardware().set_breakage(breakage);
        }
        if random.below(200) == 0 {
            rig.transport().injected([InjectedFault::Hang, InjectedFault::StackOverflow, InjectedFault::Panic][random.below(3) as usize]);
        }
        rig.transport().advance_for(random.below(40) as u32).unwrap();
        rig.listen(std::time::Duration::ZERO).unwrap();
    }
    let peak_bar = rig.transport().hardware().peak_bar();
    drop(rig);
    let mut seen = Rc::into_inner(seen).expect("the rig has ended").into_inner();
    if peak_bar > f64::from(ceiling_bar) && seen.violation.is_none() {
        seen.violation = Some(format!("the muscle saw {peak_bar} bar, the ceiling is {ceiling_bar} bar"));
    }
    seen
}

#[test]
fn no_random_session_exceeds_ceiling_or_slew() {
    let sessions = std::env::var("CATHETER_SESSIONS").ok().and_then(|count| count.parse().ok()).unwrap_or(SLICE);
    let (mut ticks, mut energised, mut faults, mut highest_ubar) = (0, 0, 0, 0);
    let mut tracking = (0, 0);
    for seed in 0..sessions {
        let seen = session(seed);
        assert!(seen.violation.is_none(), "seed {seed}: {}", seen.violation.unwrap_or_default());
        (ticks, energised, faults) = (ticks + seen.ticks, energised + seen.energised_ticks, faults + seen.faults);
        highest_ubar = highest_ubar.max(seen.highest_ubar);
        if seen.tracks {
            tracking = (tracking.0 + seen.ticks, tracking.1 + seen.energised_ticks);
        }
    }
    println!("{sessions} sessions, {ticks} ticks, {energised} of them energised, {faults} faults, highest output {highest_ubar} microbar");
    // The sessions must be worth something: pressure in a good part of them, and faults in most.
    assert!(energised * 10 > ticks, "{energised} of {ticks} ticks energised");
    assert!(tracking.0 * 3 > ticks && tracking.1 * 10 > tracking.0, "{tracking:?} ticks tracking, of them energised");
    assert!(faults > sessions / 3, "{faults} faults in {sessions} sessions");
    assert!(highest_ubar > 2_500_000, "{highest_ubar}");
}
