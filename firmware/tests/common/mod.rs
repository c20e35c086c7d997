//! A bench for the tick: a rig with a muscle, a valve, two noisy sensors, a host that sends set-points, and ways to break each of them.
#![allow(dead_code, reason = "every test file uses its own part of the bench")]

use firmware::calibration::ConverterConfig;
use firmware::control::SetPoint;
use firmware::drivers::RawSample;
use firmware::supervisor::Event;
use firmware::tick::{Action, BootReport, Command, ModelStep, Rig, RigFacts, TickConfig, TickInputs, TickOutputs};
use model_export::link::fault::FaultSet;
use model_export::link::message::{PlaybackChunk, Quantity, Reply};
use model_export::link::settings::Settings;
use model_export::link::state::State;

/// Two conversions of 12 bits summed, 3.3 V reference.
pub const FACTS: RigFacts = RigFacts { converter: ConverterConfig { full_scale_code: 8190, full_scale_v: 3.3 } };

/// Displacement of the simulated tip per bar; the play operator under it is 0.1 bar wide.
const STROKE_MM_PER_BAR: f32 = 5.0;
const PLAY_BAR: f32 = 0.1;
/// The tip's inertia and damping: it cannot jump even if the muscle bursts.
const TIP_TIME_CONSTANT_MS: f32 = 30.0;
/// Where the laser sees the straight tip.
const REST_MM: f32 = 2.0;

/// What is broken, from which tick on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Breakage {
    LaserCode(u16),
    LaserFrozen,
    /// Frozen, with the noise of a live one.
    LaserFrozenNoisy,
    LaserOffsetMm(f32),
    PressureCode(u16),
    PressureFrozen,
    /// Frozen, with the noise of a live one.
    PressureFrozenNoisy,
    PressureOffsetBar(f32),
    EmergencyStop,
    HostSilent,
    ModelNotANumber,
    ModelOffsetMm(f32),
    EveryTickLate,
    TicksLost(u16),
    BackgroundHangs,
    MuscleBursts,
    SupplyFails,
    ValveFullyOpen,
    DumpValveStuckClosed,
}

/// The muscle, the valve and the sensors, advanced by one millisecond a step.
#[derive(Clone, Debug)]
pub struct Plant {
    pub pressure_bar: f32,
    /// Supply regulator; the wiring instructions ask to set it to the ceiling, so a valve that sticks open cannot exceed it.
    pub supply_bar: f32,
    pub peak_bar: f32,
    play_bar: f32,
    displacement_mm: f32,
    noise: u32,
    frozen_laser: Option<u16>,
    frozen_pressure: Option<u16>,
}

impl Plant {
    fn new(seed: u32) -> Self {
        Self {
            pressure_bar: 0.0,
            supply_bar: 3.0,
            peak_bar: 0.0,
            play_bar: 0.0,
            displacement_mm: REST_MM,
            noise: seed,
            frozen_laser: None,
            frozen_pressure: None,
        }
    }

    pub fn advance(&mut self, energised: bool, output_bar: f32, breakage: Option<Breakage>) {
        let dump_open = !energised && breakage != Some(Breakage::DumpValveStuckClosed);
        let (target_bar, time_constant_ms) = match breakage {
            Some(Breakage::MuscleBursts) => (0.0, 12.0),
            _ if dump_open => (0.0, 40.0),
            Some(Breakage::ValveFullyOpen) => (self.supply_bar, 15.0),
            Some(Breakage::SupplyFails) => (0.0, 15.0),
            // A regulator that holds its pressure when asked for zero: why there is a dump valve.
            _ if !energised => (self.pressure_bar, 15.0),
            _ => (output_bar.min(self.supply_bar), 15.0),
        };
        self.pressure_bar += (target_bar - self.pressure_bar) / time_constant_ms;
        self.peak_bar = self.peak_bar.max(self.pressure_bar);
        self.play_bar = self.play_bar.clamp(self.pressure_bar - PLAY_BAR, self.pressure_bar + PLAY_BAR);
        self.displacement_mm += (REST_MM + STROKE_MM_PER_BAR * self.play_bar - self.displacement_mm) / TIP_TIME_CONSTANT_MS;
    }

    /// Between -2 and 2 codes: half a step of a 12-bit converter's noise, summed over two conversions.
    fn noise(&mut self) -> i32 {
        self.noise = self.noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        i32::try_from((self.noise >> 16) % 5).unwrap() - 2
    }

    fn sample(&mut self, rig: &Rig, breakage: Option<Breakage>) -> RawSample {
        let laser_offset_mm = if let Some(Breakage::LaserOffsetMm(offset)) = breakage { offset } else { 0.0 };
        let pressure_offset_bar = if let Some(Breakage::PressureOffsetBar(offset)) = breakage { offset } else { 0.0 };
        let laser = rig.built().laser().calibration().code(self.displacement_mm + laser_offset_mm);
        let pressure = rig.built().pressure().calibration().code(self.pressure_bar + pressure_offset_bar);
        let noisy = |code: u16, noise: i32| u16::try_from((i32::from(code) + noise).clamp(0, 8190)).unwrap();
        let mut sample = RawSample { laser_code: noisy(laser, self.noise()), pressure_code: noisy(pressure, self.noise()) };
        match breakage {
            Some(Breakage::LaserCode(code)) => sample.laser_code = code,
            Some(Breakage::PressureCode(code)) => sample.pressure_code = code,
            Some(Breakage::LaserFrozen) => sample.laser_code = *self.frozen_laser.get_or_insert(sample.laser_code),
            Some(Breakage::PressureFrozen) => sample.pressure_code = *self.frozen_pressure.get_or_insert(sample.pressure_code),
            Some(Breakage::LaserFrozenNoisy) => {
                let frozen = *self.frozen_laser.get_or_insert(sample.laser_code);
                sample.laser_code = noisy(frozen, self.noise());
            }
            Some(Breakage::PressureFrozenNoisy) => {
                let frozen = *self.frozen_pressure.get_or_insert(sample.pressure_code);
                sample.pressure_code = noisy(frozen, self.noise());
            }
            _ => {}
        }
        sample
    }
}

/// A model that knows the simulated tip, but for its inertia: the same play operator.
#[derive(Clone, Debug, Default)]
pub struct ExactModel {
    play_bar: f32,
    pub breakage: Option<Breakage>,
}

impl ModelStep for ExactModel {
    fn step(&mut self, pressure_bar: f32) -> f32 {
        self.play_bar = self.play_bar.clamp(pressure_bar - PLAY_BAR, pressure_bar + PLAY_BAR);
        match self.breakage {
            Some(Breakage::ModelNotANumber) => f32::NAN,
            Some(Breakage::ModelOffsetMm(offset)) => REST_MM + STROKE_MM_PER_BAR * self.play_bar + offset,
            _ => REST_MM + STROKE_MM_PER_BAR * self.play_bar,
        }
    }

    fn reset(&mut self) {
        self.play_bar = 0.0;
    }

    fn is_present(&self) -> bool {
        true
    }
}

/// Rig, plant and host together.
#[derive(Clone)]
pub struct Bench {
    pub rig: Rig,
    pub plant: Plant,
    pub model: ExactModel,
    pub time_ms: u32,
    pub breakage: Option<Breakage>,
    pub outputs: TickOutputs,
    beat: u32,
    pub vent: bool,
    pub replies: Vec<Reply>,
}

impl Bench {
    pub fn new(settings: &Settings) -> Self {
        Self::booted(settings, BootReport::default())
    }

    pub fn booted(settings: &Settings, boot: BootReport) -> Self {
        let tick = TickConfig { settings, facts: FACTS }.build().unwrap();
        let mut rig = Rig::new(tick, boot);
        let outputs = rig.tick(&mut ExactModel::default(), TickInputs { background_beat: 1, ..TickInputs::default() });
        Self {
            rig,
            plant: Plant::new(12_345),
            model: ExactModel::default(),
            time_ms: 0,
            breakage: None,
            outputs,
            beat: 1,
            vent: false,
            replies: Vec::new(),
        }
    }

    /// One millisecond with a command.
    pub fn step_with(&mut self, action: Option<Action>) -> &TickOutputs {
        let sample = self.plant.sample(&self.rig, self.breakage);
        if self.breakage != Some(Breakage::BackgroundHangs) {
            self.beat = self.beat.wrapping_add(1);
        }
        let lost_ticks = match self.breakage {
            Some(Breakage::TicksLost(ticks)) => ticks,
            _ => 0,
        };
        self.model.breakage = self.breakage;
        let inputs = TickInputs {
            sample,
            emergency_stop: self.breakage == Some(Breakage::EmergencyStop),
            overran: self.breakage == Some(Breakage::EveryTickLate),
            lost_ticks,
            background_beat: self.beat,
            vent: core::mem::take(&mut self.vent),
            command: action.map(|action| Command { token: Some(7), action }),
            telemetry_dropped: 0,
        };
        self.outputs = self.rig.tick(&mut self.model, inputs);
        self.replies.extend(self.outputs.answer.take().map(|answer| answer.reply));
        for _ in 0..=lost_ticks {
            self.plant.advance(self.outputs.energised, self.outputs.output.bar(), self.breakage);
            self.time_ms += 1;
        }
        &self.outputs
    }

    pub fn step(&mut self) -> &TickOutputs {
        self.step_with(None)
    }

    pub fn run(&mut self, ticks: u32) {
        for _ in 0..ticks {
            self.step();
        }
    }

    /// A command, and its reply.
    pub fn ask(&mut self, action: Action) -> Reply {
        self.step_with(Some(action));
        self.replies.last().cloned().expect("every command with a token is answered in its tick")
    }

    pub fn request(&mut self, event: Event) -> Reply {
        self.ask(Action::Request(event))
    }

    pub fn state(&self) -> State {
        self.outputs.state
    }

    pub fn first_fault(&self) -> u8 {
        self.rig.supervisor().record().first
    }

    /// Boot, self-test without findings, idle.
    pub fn into_idle(mut self) -> Self {
        while self.state() != State::SelfTest {
            self.step();
            assert!(self.time_ms < 1000, "no self-test after a second: {:?}", self.state());
        }
        self.ask(Action::SelfTestReport { faults: FaultSet::EMPTY, model_period: core::num::NonZeroU16::new(20) });
        self.run(10);
        assert_eq!(self.state(), State::Idle);
        self
    }

    pub fn into_armed(self) -> Self {
        let mut bench = self.into_idle();
        assert_eq!(bench.request(Event::Arm), Reply::Done);
        assert_eq!(bench.state(), State::Armed);
        bench
    }

    pub fn into_running(self) -> Self {
        let mut bench = self.into_armed();
        assert_eq!(bench.request(Event::Start), Reply::Done);
        assert_eq!(bench.state(), State::Running);
        bench
    }

    /// One millisecond of a host that follows a sine between 0.1 and 2.5 bar at 0.8 Hz, a set-point every 10 ms.
    pub fn step_sine(&mut self) -> &TickOutputs {
        let due = self.time_ms.is_multiple_of(10) && self.breakage != Some(Breakage::HostSilent);
        let phase = self.time_ms as f32 * 0.001 * 0.8 * core::f32::consts::TAU;
        let value = 1.3 - 1.2 * phase.cos();
        self.step_with(due.then_some(Action::SetPoint(SetPoint::Value(Quantity::Pressure, value))))
    }
}

/// Settings with the set-point control law.
pub fn set_point_settings() -> Settings {
    Settings { control_law: 1, ..Settings::default() }
}

/// A chunk of a playback.
pub fn chunk(first_index: u32, last: bool, values_bar: &[f32]) -> Action {
    Action::SetPoint(SetPoint::Chunk(PlaybackChunk { first_index, last, values_bar: heapless::Vec::from_slice(values_bar).unwrap() }))
}
