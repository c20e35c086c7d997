//! Everything at once against the rig: random codes, lost ticks, commands in any order, garbage set-points, a model that lies, settings
//! changed on the fly. Whatever comes, the output stays within ceiling and slew, and a vented rig gives nothing.

mod common;

use common::{Bench, FACTS, chunk, set_point_settings};
use firmware::control::SetPoint;
use firmware::drivers::RawSample;
use firmware::supervisor::Event;
use firmware::tick::{Action, BootReport, Command, ModelStep, Rig, TickConfig, TickInputs};
use model_export::link::fault::{Fault, FaultSet};
use model_export::link::message::{PlaybackChunk, Quantity};
use model_export::link::settings::{INFO, SettingValue, Settings};
use model_export::link::state::{ResetCause, State};
use proptest::prelude::*;
use proptest::sample::select;
use proptest::strategy::ValueTree;

/// A model that gives whatever bits the test wants.
struct Liar(Vec<u32>);

impl ModelStep for Liar {
    fn step(&mut self, _pressure_bar: f32) -> f32 {
        f32::from_bits(self.0.pop().unwrap_or(0))
    }

    fn reset(&mut self) {}

    fn is_present(&self) -> bool {
        true
    }
}

fn garbage() -> impl Strategy<Value = f32> {
    prop_oneof![4 => -10.0f32..10.0, 1 => any::<u32>().prop_map(f32::from_bits), 1 => Just(f32::NAN)]
}

/// One setting changed to a value within its bounds: what the link lets through.
fn settings() -> impl Strategy<Value = Settings> {
    prop::collection::vec((select(INFO), 0.0f64..=1.0), 0..4).prop_map(|changes| {
        let mut settings = set_point_settings();
        for (info, share) in changes {
            let value = match (info.minimum, info.maximum) {
                (SettingValue::Float(low), SettingValue::Float(high)) => {
                    let value = f64::from(low) + share * (f64::from(high) - f64::from(low));
                    SettingValue::Float((value as f32).clamp(low, high))
                }
                (SettingValue::Integer(low), SettingValue::Integer(high)) => {
                    SettingValue::Integer(low + (share * f64::from(high - low)) as u32)
                }
                _ => SettingValue::Flag(share > 0.5),
            };
            settings.set(info.number, value).unwrap();
        }
        settings
    })
}

fn set_point() -> impl Strategy<Value = SetPoint> {
    prop_oneof![
        6 => garbage().prop_map(|value| SetPoint::Value(Quantity::Pressure, value)),
        1 => garbage().prop_map(|value| SetPoint::Value(Quantity::Displacement, value)),
        2 => (0u32..100, any::<bool>(), prop::collection::vec(garbage(), 0..32)).prop_map(|(first_index, last, values)| {
            let values_bar = heapless::Vec::from_slice(&values).unwrap();
            SetPoint::Chunk(PlaybackChunk { first_index, last, values_bar })
        }),
    ]
}

fn action() -> impl Strategy<Value = Action> {
    prop_oneof![
        8 => select(Event::ALL.as_slice()).prop_map(Action::Request),
        20 => set_point().prop_map(Action::SetPoint),
        1 => Just(Action::PlaybackClear),
        2 => settings().prop_filter_map("contradict each other", |settings| {
            Some(Action::Configure(TickConfig { settings: &settings, facts: FACTS }.build().ok()?))
        }),
        2 => (0u64..8, prop::option::of(1u16..50)).prop_map(|(faults, period)| Action::SelfTestReport {
            faults: if faults == 0 { [Fault::GoldenMismatch].into_iter().collect() } else { FaultSet::EMPTY },
            model_period: period.and_then(core::num::NonZeroU16::new),
        }),
        1 => select(Fault::ALL).prop_map(Action::Raise),
        1 => Just(Action::Status),
        1 => Just(Action::FaultRecord),
    ]
}

#[derive(Clone, Debug)]
struct Step {
    repeat: u16,
    honest_sample: bool,
    sample: RawSample,
    emergency_stop: bool,
    overran: bool,
    lost_ticks: u16,
    beats: bool,
    vent: bool,
    action: Option<Action>,
}

fn step() -> impl Strategy<Value = Step> {
    (
        prop_oneof![3 => 1u16..3, 1 => 1u16..120],
        prop::bool::weighted(0.95),
        any::<(u16, u16)>(),
        prop::bool::weighted(0.02),
        prop::bool::weighted(0.05),
        prop_oneof![30 => Just(0u16), 1 => any::<u16>()],
        (prop::bool::weighted(0.95), prop::bool::weighted(0.02)),
        prop::option::weighted(0.7, action()),
    )
        .prop_map(
            |(repeat, honest_sample, (laser_code, pressure_code), emergency_stop, overran, lost_ticks, (beats, vent), action)| Step {
                repeat,
                honest_sample,
                sample: RawSample { laser_code, pressure_code },
                emergency_stop,
                overran,
                lost_ticks,
                beats,
                vent,
                action,
            },
        )
}

/// The promise, checked from outside with the settings then in force.
struct Watch {
    last_ubar: i32,
    was_energised: bool,
}

impl Watch {
    fn check(&mut self, rig: &Rig, outputs: &firmware::tick::TickOutputs) {
        let limiter = rig.built().limiter();
        let output = outputs.output.0;
        assert!((0..=limiter.ceiling().0).contains(&output), "{outputs:?}");
        assert!(output <= 4_000_000, "{outputs:?}");
        assert!(output - self.last_ubar <= limiter.up_per_tick().0, "rises by {} ubar", output - self.last_ubar);
        if outputs.energised {
            assert!(self.last_ubar - output <= limiter.down_per_tick().0, "falls by {} ubar", self.last_ubar - output);
        } else {
            assert_eq!((output, outputs.valve_share), (0, 0), "a vented rig gives nothing");
        }
        assert_eq!(outputs.energised, outputs.state.is_energised());
        if outputs.energised && !self.was_energised {
            assert_eq!(outputs.state, State::Armed);
        }
        self.last_ubar = output;
        self.was_energised = outputs.energised;
    }
}

fn attack(mut bench: Bench, steps: Vec<Step>, lies: Vec<u32>) -> (u32, i32) {
    let mut watch = Watch { last_ubar: bench.outputs.output.0, was_energised: bench.outputs.energised };
    let mut model = Liar(lies);
    let mut beat = 1_000_000;
    let (mut running_ticks, mut highest_ubar) = (0, 0);
    for step in steps {
        let mut action = step.action;
        for _ in 0..step.repeat {
            if step.honest_sample {
                // Lets the plant follow, so that the rig is not faulted at once by its own sensors.
                bench.model.breakage = None;
                bench.step_with(action.take());
                watch.check(&bench.rig, &bench.outputs);
            } else {
                beat += u32::from(step.beats);
                let inputs = TickInputs {
                    sample: step.sample,
                    emergency_stop: step.emergency_stop,
                    overran: step.overran,
                    lost_ticks: step.lost_ticks,
                    background_beat: beat,
                    vent: step.vent,
                    command: action.take().map(|action| Command { token: None, action }),
                    telemetry_dropped: 0,
                };
                let outputs = bench.rig.tick(&mut model, inputs);
                watch.check(&bench.rig, &outputs);
                bench.outputs = outputs;
            }
            running_ticks += u32::from(bench.state() == State::Running);
            highest_ubar = highest_ubar.max(bench.outputs.output.0);
        }
    }
    (running_ticks, highest_ubar)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn no_sequence_from_a_running_rig_leaves_the_limits(
        steps in prop::collection::vec(step(), 1..120),
        lies in prop::collection::vec(any::<u32>(), 0..100),
    ) {
        let bench = RUNNING.with(Clone::clone);
        attack(bench, steps, lies);
    }

    #[test]
    fn no_sequence_from_a_fresh_rig_leaves_the_limits(
        steps in prop::collection::vec(step(), 1..120),
        lies in prop::collection::vec(any::<u32>(), 0..100),
        settings in settings(),
    ) {
        if let Ok(tick) = (TickConfig { settings: &settings, facts: FACTS }).build() {
            let mut bench = Bench::new(&set_point_settings());
            bench.rig = Rig::new(tick, BootReport { reset_cause: ResetCause::PowerOn, faults: FaultSet::EMPTY });
            attack(bench, steps, lies);
        }
    }
}

thread_local! {
    static RUNNING: Bench = Bench::new(&set_point_settings()).into_running();
}

/// The properties above say nothing if the adversary never gets the rig to move.
#[test]
fn the_adversary_does_reach_running_rigs_under_pressure() {
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let strategy = (prop::collection::vec(step(), 1..120), prop::collection::vec(any::<u32>(), 0..100));
    let (mut moved, mut long) = (0, 0);
    for _ in 0..200 {
        let (steps, lies) = strategy.new_tree(&mut runner).unwrap().current();
        let (running_ticks, highest_ubar) = attack(RUNNING.with(Clone::clone), steps, lies);
        moved += u32::from(highest_ubar > 100_000);
        long += u32::from(running_ticks > 20);
    }
    println!("of 200 attacks {moved} moved the output, {long} ran for more than 20 ms");
    assert!(moved > 60 && long > 60, "{moved} {long}");
}

/// A garbage session against the playback law: from a good start, chunks of anything.
#[test]
fn a_playback_that_asks_for_27_bar_stays_below_the_ceiling() {
    let settings = Settings::default();
    let mut bench = Bench::new(&settings).into_armed();
    // A literal ascending eq. (1) of the paper asks for 9 to 27 bar.
    let rising: Vec<f32> = (0..32u8).map(|index| f32::from(index) * 0.85).collect();
    bench.ask(chunk(0, false, &rising));
    bench.request(Event::Start);
    let mut watch = Watch { last_ubar: 0, was_energised: true };
    for tick in 0..2_000u32 {
        let keep_alive = tick.is_multiple_of(100).then(|| chunk(32, false, &[]));
        bench.step_with(keep_alive);
        watch.check(&bench.rig, &bench.outputs);
    }
    assert_eq!((bench.state(), bench.outputs.output.0), (State::Running, 3_000_000), "at the ceiling, and running");
}
