//! Instructions and stack of the whole 1 kHz tick, in the worst case that a run over all states and commands finds.

use cortex_m_semihosting::hprintln;
use firmware::calibration::ConverterConfig;
use firmware::control::{Compensator, SetPoint};
use firmware::drivers::RawSample;
use firmware::estimator::Kernel;
use firmware::model::RunningModel;
use firmware::parity::Noise;
use firmware::self_test::Report;
use firmware::supervisor::Event;
use firmware::tick::{Action, BootReport, Command, Direction, ModelStep, Rig, RigFacts, Tick, TickConfig, TickInputs};
use model_export::link::fault::FaultSet;
use model_export::link::message::{PlaybackChunk, Quantity};
use model_export::link::settings::Settings;
use model_export::link::state::State;

use crate::machine::{Counter, Stack};

/// Two conversions of 12 bits summed, 3.3 V reference: the board's converter.
const FACTS: RigFacts = RigFacts { converter: ConverterConfig { full_scale_code: 8190, full_scale_v: 3.3 } };

/// Ticks in which the rig stays idle and is given new settings over and over.
const IDLE_TICKS: usize = 1000;

/// Tells whether a tick had a model step in it.
struct Observed<'a, K: Kernel> {
    model: RunningModel<'a, K>,
    stepped: bool,
}

impl<K: Kernel> ModelStep for Observed<'_, K> {
    fn step(&mut self, pressure_bar: f32) -> f32 {
        self.stepped = true;
        self.model.step(pressure_bar)
    }

    fn reset(&mut self) {
        self.model.reset();
    }

    fn is_present(&self) -> bool {
        self.model.is_present()
    }

    fn direction(&self) -> Direction {
        self.model.direction()
    }

    fn compensator(&self) -> Option<&Compensator> {
        self.model.compensator()
    }

    fn is_outside_domain(&self) -> bool {
        self.model.is_outside_domain()
    }
}

/// Runs `ticks` ticks with each control law; a line each: law, most instructions, most without a model step,
/// bytes of stack, whether the law ever ran.
pub fn count_ticks(counter: &Counter, blob: &[u8], memory: &mut [u32], seed: u32, ticks: usize) {
    for control_law in 0.. {
        // The random weights of the model know nothing of a displacement.
        // Of the ways to track the one that computes most: the inverse of the physics, and feedback from laser and estimate.
        let settings = Settings {
            control_law,
            feed_forward: 3,
            feedback_sensor: 3,
            pid_integral_per_s: 1.0,
            mismatch_displacement_mm: 0.0,
            ..Settings::default()
        };
        let Ok(tick) = (TickConfig { settings: &settings, facts: FACTS }).build() else { break };
        let mut model = RunningModel::default();
        let Ok(facts) = model.load(blob, &mut *memory) else {
            hprintln!("error: the model is refused");
            return;
        };
        let report = Report { faults: FaultSet::EMPTY, model: Some(facts) };
        let mut run = Run {
            rig: Rig::new(tick.clone(), BootReport::default()),
            model: Observed { model, stepped: false },
            tick,
            report: report.action(),
            noise: Noise::new(seed),
            next_point: 0,
        };
        let worst = run.count(counter, ticks);
        let ran = u8::from(worst.reached_running);
        hprintln!("{} {} {} {} {}", control_law, worst.with_model, worst.without_model, worst.stack_bytes, ran);
    }
}

struct Run<'a, K: Kernel> {
    rig: Rig,
    model: Observed<'a, K>,
    tick: Tick,
    report: Action,
    noise: Noise,
    /// Index of the next playback point.
    next_point: u32,
}

#[derive(Default)]
struct Worst {
    with_model: u32,
    without_model: u32,
    stack_bytes: usize,
    reached_running: bool,
}

impl<K: Kernel> Run<'_, K> {
    #[inline(never)]
    fn count(&mut self, counter: &Counter, ticks: usize) -> Worst {
        let mut worst = Worst::default();
        let (mut state, mut output_bar) = (State::Boot, 0.0);
        let stack = Stack::paint();
        for number in 0..ticks {
            let code = self.rig.built().pressure().calibration().code(output_bar);
            let laser_code = self.rig.built().laser().calibration().code(2.0 + 5.0 * output_bar);
            let jitter = u16::from(self.noise.below(2) == 0);
            let inputs = TickInputs {
                sample: RawSample { laser_code: laser_code + jitter, pressure_code: code + jitter },
                background_beat: u32::try_from(number).unwrap_or(0),
                command: self.command(number, state).map(|action| Command { token: Some(1), action }),
                ..TickInputs::default()
            };
            self.model.stepped = false;
            let (count, outputs) = counter.count(|| self.rig.tick(&mut self.model, core::hint::black_box(inputs)));
            let most = if self.model.stepped { &mut worst.with_model } else { &mut worst.without_model };
            *most = count.max(*most);
            state = outputs.state;
            output_bar = outputs.output.bar();
            worst.reached_running |= state == State::Running;
        }
        worst.stack_bytes = stack.used();
        worst
    }

    /// What the host asks for: to get going, and once it runs everything there is, so that each meets a model step.
    fn command(&mut self, number: usize, state: State) -> Option<Action> {
        let stays_idle = number < IDLE_TICKS;
        match state {
            State::SelfTest => return Some(self.report.clone()),
            State::Idle if !stays_idle && number.is_multiple_of(50) => return Some(Action::Request(Event::Arm)),
            State::Fault if number.is_multiple_of(50) => return Some(Action::Request(Event::Acknowledge)),
            // A good while before the host has been silent too long.
            State::Armed if number.is_multiple_of(100) => return Some(Action::Request(Event::Start)),
            _ => {}
        }
        let bar = 0.6 + 0.5 * self.noise.symmetric();
        Some(match self.noise.below(8) {
            0 => Action::Status,
            1 => Action::FaultRecord,
            2 => Action::SetPoint(SetPoint::Value(Quantity::Displacement, 5.0 * bar)),
            3 if stays_idle => Action::Configure(self.tick.clone()),
            3 if number.is_multiple_of(37) => Action::Request(Event::Vent),
            4 | 5 => self.chunk(bar),
            6 => return None,
            _ => Action::SetPoint(SetPoint::Value(Quantity::Pressure, bar)),
        })
    }

    fn chunk(&mut self, bar: f32) -> Action {
        let values_bar = core::iter::repeat_n(bar, 32).collect();
        let first_index = self.next_point;
        self.next_point += 32;
        if self.next_point > 4096 {
            self.next_point = 0;
            return Action::PlaybackClear;
        }
        Action::SetPoint(SetPoint::Chunk(PlaybackChunk { first_index, last: false, values_bar }))
    }
}
