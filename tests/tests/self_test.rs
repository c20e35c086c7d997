//! The self-test and the tick with a real exported model: a hybrid of play operators and a small quantised LSTM.

use firmware::calibration::ConverterConfig;
use firmware::control::SetPoint;
use firmware::drivers::RawSample;
use firmware::estimator::{Estimator, EstimatorState, Portable, StepBudget, StepTimer};
use firmware::model::{RunningModel, examine};
use firmware::self_test::{ClockCheck, Report, SelfTest};
use firmware::supervisor::Event;
use firmware::tick::{Action, BootReport, Command, Rig, RigFacts, TickConfig, TickInputs, TickOutputs};
use host_tool::network::{Activation, Mode};
use model_export::blob::{self, crc32};
use model_export::link::fault::{Fault, FaultSet};
use model_export::link::message::Quantity;
use model_export::link::settings::Settings;
use model_export::link::state::State;
use model_export::schema::{FeatureSource, Model};
use rig_tests::models;

fn exported() -> Vec<u8> {
    rig_tests::hybrid::exported(&[16])
}

/// The blob again with something changed: frame, checksum and hash are right, the contents are not.
fn forged(bytes: &[u8], change: impl FnOnce(&mut Model<'_>)) -> Vec<u8> {
    let mut model = blob::decode(bytes).unwrap().model;
    change(&mut model);
    blob::encode(&model).unwrap()
}

#[test]
fn a_sound_model_passes_and_tells_its_period_and_identity() {
    let bytes = exported();
    let facts = examine(&bytes, Portable).unwrap();
    assert_eq!(facts.period.get(), 20);
    assert_eq!(facts.id, blob::decode(&bytes).unwrap().content_hash[..8]);
}

#[test]
fn any_flipped_bit_is_a_corrupt_model_or_an_unsupported_one() {
    let bytes = exported();
    for bit in (0..bytes.len() * 8).step_by(101) {
        let mut damaged = bytes.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert_eq!(examine(&damaged, Portable), Err(Fault::ModelCorrupt), "bit {bit}");
    }
    for length in [0, 7, 51, bytes.len() - 1] {
        assert_eq!(examine(&bytes[..length], Portable), Err(Fault::ModelCorrupt), "{length} bytes");
    }
}

#[test]
fn golden_vectors_catch_a_changed_parameter_and_a_changed_output() {
    let bytes = exported();
    let other_weight = forged(&bytes, |model| model.front_end.play_weights[0] += 0.01);
    assert_eq!(examine(&other_weight, Portable), Err(Fault::GoldenMismatch));
    // One unit in the last place of one weight: within the tolerance, but other bits than the exporter saw.
    let last_place = forged(&bytes, |model| model.front_end.play_weights[0] = model.front_end.play_weights[0].next_up());
    assert_eq!(examine(&last_place, Portable), Err(Fault::GoldenMismatch));
    let golden = blob::decode(&bytes).unwrap().model.golden.output.to_vec();
    let mut wrong = golden;
    let at = wrong.len() / 2 / 4 * 4;
    wrong[at..at + 4].copy_from_slice(&99.0f32.to_le_bytes());
    let mut model = blob::decode(&bytes).unwrap().model;
    model.golden.output = &wrong;
    assert_eq!(examine(&blob::encode(&model).unwrap(), Portable), Err(Fault::GoldenMismatch));
}

#[test]
fn a_check_that_cannot_fail_is_a_fault() {
    // No vectors: everything would pass.
    let blind = forged(&exported(), |model| {
        model.golden.input = &[];
        model.golden.output = &[];
        model.golden.digest = 0;
    });
    assert_eq!(examine(&blind, Portable), Err(Fault::SelfTestBlind));
}

#[test]
fn a_model_in_other_units_or_between_ticks_is_unsupported() {
    for change in [
        (|model: &mut Model<'_>| model.input.unit = "V") as fn(&mut Model<'_>),
        |model| model.output.unit = "um",
        |model| model.sample_period_s = 0.0205,
        |model| model.sample_period_s = 100.0,
    ] {
        assert_eq!(examine(&forged(&exported(), change), Portable), Err(Fault::ModelUnsupported));
    }
}

#[test]
fn the_self_test_tells_everything_it_finds() {
    let program = [1, 2, 3, 4];
    let clock = ClockCheck { counted: 16_100_000, expected: 16_000_000, tolerance_per_mille: 10 };
    let pieces = [&program[..3], &program[3..]];
    let good = SelfTest { program: &pieces, program_crc32: crc32(0, &program), clock: Some(clock) };
    assert_eq!(good.run(), FaultSet::EMPTY);
    assert_eq!(SelfTest { clock: None, ..good }.run(), FaultSet::EMPTY);

    let slow = ClockCheck { counted: 15_800_000, ..clock };
    let bad = SelfTest { program_crc32: 0, clock: Some(slow), ..good }.run();
    assert_eq!(bad.iter().collect::<Vec<_>>(), [Fault::FlashCorrupt, Fault::ClockInaccurate]);
}

/// Counts as many cycles a step as it is told; an interruption lengthens every so many readings.
struct Stopwatch {
    step: u32,
    tick_every: u32,
    now: std::cell::Cell<u32>,
    readings: std::cell::Cell<u32>,
}

impl Stopwatch {
    fn new(step: u32, tick_every: u32) -> Self {
        Self { step, tick_every, now: 0.into(), readings: 0.into() }
    }
}

impl StepTimer for Stopwatch {
    fn cycles(&self) -> u32 {
        let readings = self.readings.get() + 1;
        self.readings.set(readings);
        // Every second reading ends a step.
        if readings.is_multiple_of(2) {
            let interrupted = self.tick_every > 0 && !(readings / 2).is_multiple_of(self.tick_every);
            self.now.set(self.now.get().wrapping_add(self.step + if interrupted { 40_000 } else { 0 }));
        }
        self.now.get()
    }
}

#[test]
fn a_model_is_measured_at_its_golden_vectors_and_refused_above_its_share_of_a_tick() {
    let bytes = exported();
    let load = |stopwatch: Stopwatch| {
        let budget = StepBudget { timer: stopwatch, cycles: 100_800 };
        let admitted = RunningModel::default().load_within(&bytes, Portable, &budget).map(|facts| facts.period.get());
        (admitted, budget.timer.readings.get() / 2)
    };
    assert_eq!(load(Stopwatch::new(100_800, 0)).0, Ok(20));
    assert_eq!(load(Stopwatch::new(100_801, 0)), (Err(Fault::ModelTooSlow), 4), "it is given up at once, not after minutes");
    // Two of three steps are interrupted by a tick.
    assert_eq!(load(Stopwatch::new(90_000, 3)).0, Ok(20));
    assert_eq!(load(Stopwatch::new(110_000, 3)).0, Err(Fault::ModelTooSlow));
}

#[test]
fn a_window_model_that_no_board_could_run_in_a_tick_is_refused_without_measuring() {
    let front_end = models::plain_front_end(&[FeatureSource::Input]);
    let window = |length, units: &[usize]| {
        let network = models::network(5, 1, units, Activation::Tanh, 1.5);
        models::exported(&models::model(front_end.clone(), Some(network), Mode::Window { length }), 5)
    };
    for (length, units, admitted) in [(50, &[32][..], false), (50, &[64, 64][..], false), (5, &[16][..], true)] {
        let outcome = examine(&window(length, units), Portable).map(|_| ());
        let expected = if admitted { Ok(()) } else { Err(Fault::ModelTooSlow) };
        assert_eq!(outcome, expected, "a window of {length} over {units:?} units");
    }
}

/// A rig whose sensors follow the output at once, with a code of noise.
struct Bench<'a> {
    rig: Rig,
    model: RunningModel<'a, Portable>,
    tick: u32,
    outputs: Option<TickOutputs>,
}

impl Bench<'_> {
    fn step(&mut self, action: Option<Action>) -> TickOutputs {
        self.tick += 1;
        let output_bar = self.outputs.as_ref().map_or(0.0, |outputs| outputs.output.bar());
        let noise = u16::from(self.tick.is_multiple_of(2));
        let pressure_code = self.rig.built().pressure().calibration().code(output_bar) + noise;
        let laser_code = self.rig.built().laser().calibration().code(2.0 + 5.0 * output_bar) + noise;
        let inputs = TickInputs {
            sample: RawSample { laser_code, pressure_code },
            background_beat: self.tick,
            command: action.map(|action| Command { token: None, action }),
            ..TickInputs::default()
        };
        let outputs = self.rig.tick(&mut self.model, inputs);
        self.outputs = Some(outputs.clone());
        outputs
    }
}

#[test]
fn the_estimate_in_the_telemetry_is_the_estimators_to_the_bit() {
    let bytes = exported();
    // The forged output scale of this untrained model is no displacement, so the comparison with the laser is off.
    let settings = Settings { control_law: 1, mismatch_displacement_mm: 0.0, ..Settings::default() };
    let facts = RigFacts { converter: ConverterConfig { full_scale_code: 8190, full_scale_v: 3.3 } };
    let tick = TickConfig { settings: &settings, facts }.build().unwrap();
    let mut model = RunningModel::default();
    let facts = model.load(&bytes, Portable).unwrap();
    let report = Report { faults: FaultSet::EMPTY, model: Some(facts) };
    let mut bench = Bench { rig: Rig::new(tick, BootReport::default()), model, tick: 0, outputs: None };
    while bench.step(None).state != State::SelfTest {}

    let estimator = Estimator::new(&blob::decode(&bytes).unwrap().model).unwrap();
    let mut state = EstimatorState::default();
    let mut compared = 0;
    let (mut lowest, mut highest) = (f32::MAX, f32::MIN);
    for millisecond in 0..6_000u32 {
        let phase = millisecond as f32 * 0.005;
        let action = match millisecond {
            0 => Some(report.action()),
            10 => Some(Action::Request(Event::Arm)),
            20 => Some(Action::Request(Event::Start)),
            _ if millisecond.is_multiple_of(10) => Some(Action::SetPoint(SetPoint::Value(Quantity::Pressure, 1.2 - 1.2 * phase.cos()))),
            _ => None,
        };
        let outputs = bench.step(action);
        if let Some(sample) = outputs.telemetry
            && millisecond > 0
        {
            let expected = estimator.step(&mut state, sample.command_bar).value;
            assert_eq!(sample.estimate_mm.map(f32::to_bits), Some(expected.to_bits()), "{millisecond} ms");
            (lowest, highest) = (lowest.min(expected), highest.max(expected));
            compared += 1;
        }
    }
    assert_eq!(bench.outputs.unwrap().state, State::Running);
    assert_eq!(compared, 300);
    assert!(highest - lowest > 5.0, "the estimate moved from {lowest} to {highest} mm");
}
