//! The rig's physics, one stage after the other, integrated at 10 kHz.
//!
//! Terms. A *stage* is one thing a signal passes on its way from the commanded pressure to the recorded displacement. Stages before the
//! muscle act on a pressure in bar, stages behind it on a displacement in mm. Nothing here is shared with the effects that
//! discovery fits, and the laws are others on purpose.

use std::collections::VecDeque;
use std::f64::consts::PI;

/// Integration step, s.
pub const STEP_S: f64 = 1e-4;

/// Where and when a step happens.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// Time since the session began, s.
    pub session_s: f64,
    /// Number of the recording in the session.
    pub recording: usize,
}

/// One stage of the rig.
pub trait Stage: Send {
    /// Output for `input` one integration step later.
    fn step(&mut self, input: f64, moment: &Moment) -> f64;
    /// What a pause does to it, once everything has come to rest.
    fn pause(&mut self) {}
}

/// A tube that carries pressure waves: everything arrives later.
pub struct Tube {
    waves: VecDeque<f64>,
}

impl Tube {
    /// A tube that is `transit_s` long.
    #[must_use]
    pub fn new(transit_s: f64) -> Self {
        Self { waves: VecDeque::from(vec![0.0; (transit_s / STEP_S).round() as usize]) }
    }
}

impl Stage for Tube {
    fn step(&mut self, input: f64, _: &Moment) -> f64 {
        self.waves.push_back(input);
        self.waves.pop_front().unwrap_or(input)
    }
}

/// A restriction into a volume behind a valve spool that itself takes a little time: two poles, one of them fast.
pub struct Volume {
    /// Time constant of the volume, s.
    pub slow_s: f64,
    /// Time constant of the spool, s.
    pub fast_s: f64,
    /// Spool.
    pub spool: f64,
    /// Pressure.
    pub level: f64,
}

impl Stage for Volume {
    fn step(&mut self, input: f64, _: &Moment) -> f64 {
        self.spool += STEP_S / self.fast_s * (input - self.spool);
        self.level += STEP_S / self.slow_s * (self.spool - self.level);
        self.level
    }
}

/// Two orifices, one to the supply and one to the room, whose flow grows a little less than the pressure across them.
pub struct Orifices {
    /// Time constant of filling at small differences, s.
    pub fill_s: f64,
    /// Time constant of venting at small differences, s.
    pub vent_s: f64,
    /// Difference at which the flow begins to choke, bar.
    pub choke_bar: f64,
    /// Pressure.
    pub level: f64,
}

impl Stage for Orifices {
    fn step(&mut self, input: f64, _: &Moment) -> f64 {
        let difference = input - self.level;
        let drive = difference / (1.0 + difference.abs() / self.choke_bar).sqrt();
        self.level += STEP_S * drive / if difference > 0.0 { self.fill_s } else { self.vent_s };
        self.level
    }
}

/// A converter that reads its command once in a period, on a clock that the recording's program starts.
pub struct Converter {
    /// Period, s.
    pub period_s: f64,
    /// Time of the first reading after the program has started, s.
    pub first_s: f64,
    /// Time to the next reading, s.
    pub left_s: f64,
    /// Number of the recording.
    pub recording: usize,
    /// What it read last, bar.
    pub held_bar: f64,
}

impl Stage for Converter {
    fn step(&mut self, input: f64, moment: &Moment) -> f64 {
        if moment.recording != self.recording {
            (self.recording, self.left_s) = (moment.recording, self.first_s);
        }
        self.left_s -= STEP_S;
        if self.left_s <= 0.0 {
            self.left_s += self.period_s;
            self.held_bar = input;
        }
        self.held_bar
    }
}

/// A regulator that shuts for a time when its command turns, and then passes a flow that grows with the root of the difference.
pub struct ShutAtTurns {
    /// How long it stays shut, s.
    pub hold_s: f64,
    /// Rate of the pressure at a difference of one bar, bar/s.
    pub flow_bar: f64,
    /// How long it stays shut yet, s.
    pub left_s: f64,
    /// Where the command has got to since it turned, bar.
    pub top_bar: f64,
    /// Which way.
    pub sign: f64,
    /// Pressure.
    pub level: f64,
}

impl Stage for ShutAtTurns {
    fn step(&mut self, input: f64, _: &Moment) -> f64 {
        self.left_s -= STEP_S;
        let onward = self.sign * (input - self.top_bar);
        if onward < -1e-5 {
            self.sign = -self.sign;
            if self.left_s <= 0.0 {
                self.left_s = self.hold_s;
            }
        }
        if !(-1e-5..=0.0).contains(&onward) {
            self.top_bar = input;
        }
        if self.left_s <= 0.0 {
            let difference = input - self.level;
            // Laminar where hardly anything flows.
            self.level += STEP_S * self.flow_bar * difference / (difference.abs() + 0.02).sqrt();
        }
        self.level
    }
}

/// Threads of a braid that rub on each other: friction that nears its bound exponentially with the travel (Dahl 1968) holds a share of the pressure back.
pub struct Braid {
    /// Largest friction, bar.
    pub bound_bar: f64,
    /// Share of it that the muscle feels.
    pub share: f64,
    /// Friction, bar.
    pub friction_bar: f64,
    /// Pressure a step before, bar.
    pub last_bar: f64,
}

impl Stage for Braid {
    fn step(&mut self, input: f64, _: &Moment) -> f64 {
        let travel = input - self.last_bar;
        let bound_bar = self.bound_bar * travel.signum();
        self.friction_bar = bound_bar + (self.friction_bar - bound_bar) * (-travel.abs() / self.bound_bar).exp();
        self.last_bar = input;
        input - self.share * self.friction_bar
    }
}

/// A valve whose flow saturates smoothly.
pub struct ChokedFlow {
    /// Fastest change, bar/s.
    pub fastest_bar_per_s: f64,
    /// Time constant while unsaturated, s.
    pub fast_s: f64,
    /// Pressure.
    pub level: f64,
}

impl Stage for ChokedFlow {
    fn step(&mut self, input: f64, _: &Moment) -> f64 {
        let wanted = (input - self.level) / self.fast_s;
        self.level += STEP_S * self.fastest_bar_per_s * (wanted / self.fastest_bar_per_s).tanh();
        self.level
    }
}

/// An on-off valve: it opens when the error passes its band and closes when little of it is left.
pub struct OnOffValve {
    /// Error at which it opens, bar.
    pub open_bar: f64,
    /// Error at which it closes, bar.
    pub close_bar: f64,
    /// Time constant while open, s.
    pub flow_s: f64,
    /// Whether it is open.
    pub open: bool,
    /// Pressure.
    pub level: f64,
}

impl Stage for OnOffValve {
    fn step(&mut self, input: f64, _: &Moment) -> f64 {
        let error = input - self.level;
        if error.abs() > self.open_bar {
            self.open = true;
        } else if error.abs() < self.close_bar {
            self.open = false;
        }
        if self.open {
            self.level += STEP_S / self.flow_s * error;
        }
        self.level
    }
}

/// A supply that gives way gradually near its pressure.
pub struct Supply {
    /// Pressure it cannot pass, bar.
    pub limit_bar: f64,
    /// How sharply it gives way.
    pub sharpness: f64,
}

impl Stage for Supply {
    fn step(&mut self, input: f64, _: &Moment) -> f64 {
        if input <= 0.0 { input } else { input / (1.0 + (input / self.limit_bar).powf(self.sharpness)).powf(1.0 / self.sharpness) }
    }
}

/// A bladder that must first touch its sleeve.
pub struct Bladder {
    /// Pressure at which it touches, bar.
    pub touch_bar: f64,
    /// Width of the transition, bar.
    pub width_bar: f64,
}

impl Stage for Bladder {
    fn step(&mut self, input: f64, _: &Moment) -> f64 {
        let past = (input - self.touch_bar) / self.width_bar;
        let rest = (-self.touch_bar / self.width_bar).exp().ln_1p();
        self.width_bar * (if past > 30.0 { past } else { past.exp().ln_1p() } - rest)
    }
}

/// Bending by a muscle off the axis: an angle that turns into a displacement, or a braid that stiffens.
pub struct Geometry {
    /// Value at which the bend has turned far.
    pub reach: f64,
    /// Positive bends the curve down as a sine does, negative up as a tangent does.
    pub bend: f64,
}

impl Stage for Geometry {
    fn step(&mut self, input: f64, _: &Moment) -> f64 {
        let angle = input / self.reach;
        if self.bend > 0.0 { self.reach * angle.sin() } else { self.reach * angle.tan() }
    }
}

/// Three springs, each with its own dashpot, in series with the muscle.
pub struct KelvinVoigt {
    /// Compliance of each element relative to the muscle's.
    pub compliance: [f64; 3],
    /// Retardation time of each element, s.
    pub time_s: [f64; 3],
    /// Strain of each element.
    pub strain: [f64; 3],
}

impl Stage for KelvinVoigt {
    fn step(&mut self, input: f64, _: &Moment) -> f64 {
        let mut sum = input;
        for element in 0..3 {
            self.strain[element] += STEP_S / self.time_s[element] * (self.compliance[element] * input - self.strain[element]);
            sum += self.strain[element];
        }
        sum
    }
}

/// Rubber that the first strokes soften and a pause between recordings stiffens again.
pub struct Rubber {
    /// Gain that is still missing when fresh.
    pub missing: f64,
    /// Distance that breaks most of the bonds.
    pub distance: f64,
    /// Bonds left.
    pub bonds: f64,
    /// Last input.
    pub last: f64,
}

impl Stage for Rubber {
    fn step(&mut self, input: f64, _: &Moment) -> f64 {
        self.bonds -= self.bonds * (input - self.last).abs() / self.distance;
        self.last = input;
        input * (1.0 - self.missing * self.bonds)
    }
    fn pause(&mut self) {
        self.bonds = 1.0;
    }
}

/// A light tip pulled by a spring over a surface with Stribeck friction, LuGre form.
pub struct LuGreTip {
    /// Static friction over spring stiffness, mm.
    pub static_mm: f64,
    /// Sliding friction over spring stiffness, mm.
    pub sliding_mm: f64,
    /// Stribeck speed, mm/s.
    pub stribeck_mm_per_s: f64,
    /// Viscous friction over spring stiffness, s.
    pub viscous_s: f64,
    /// Mass over spring stiffness, s^2.
    pub inertia_s2: f64,
    /// Bristle stiffness over spring stiffness.
    pub bristle: f64,
    /// Bristle deflection, mm.
    pub deflection_mm: f64,
    /// Tip speed, mm/s.
    pub speed_mm_per_s: f64,
    /// Tip position, mm.
    pub position_mm: f64,
}

impl LuGreTip {
    /// A light tip with stiff bristles, at rest.
    pub const fn stiff(static_mm: f64, sliding_mm: f64) -> Self {
        Self {
            static_mm,
            sliding_mm,
            stribeck_mm_per_s: 2.0,
            viscous_s: 0.004,
            inertia_s2: 2e-5,
            bristle: 30.0,
            deflection_mm: 0.0,
            speed_mm_per_s: 0.0,
            position_mm: 0.0,
        }
    }
}

impl Stage for LuGreTip {
    fn step(&mut self, input: f64, _: &Moment) -> f64 {
        // Bristle damping keeps the pre-sliding oscillation of tip and bristle down.
        let damping_s = 2.0 * (self.bristle * self.inertia_s2).sqrt();
        let ratio = self.speed_mm_per_s / self.stribeck_mm_per_s;
        let breakaway = self.sliding_mm + (self.static_mm - self.sliding_mm) * (-ratio * ratio).exp();
        let pace = STEP_S * self.bristle * self.speed_mm_per_s.abs() / breakaway;
        let rate = if pace < 1.0 {
            self.speed_mm_per_s - self.bristle * self.speed_mm_per_s.abs() / breakaway * self.deflection_mm
        } else {
            // A slip so fast that the bristles yield within a step: their approach to it is exponential, which a straight step would overshoot.
            let sliding_mm = self.speed_mm_per_s.signum() * breakaway / self.bristle;
            (self.deflection_mm - sliding_mm) * (-pace).exp_m1() / STEP_S
        };
        self.deflection_mm += STEP_S * rate;
        let friction = self.bristle * self.deflection_mm + damping_s * rate + self.viscous_s * self.speed_mm_per_s;
        self.speed_mm_per_s += STEP_S * (input - self.position_mm - friction) / self.inertia_s2;
        self.position_mm += STEP_S * self.speed_mm_per_s;
        self.position_mm
    }
}

/// A catheter tip that swings.
pub struct Pendulum {
    /// Undamped frequency, Hz.
    pub frequency_hz: f64,
    /// Damping ratio.
    pub damping: f64,
    /// Position.
    pub position: f64,
    /// Speed.
    pub speed: f64,
}

impl Stage for Pendulum {
    fn step(&mut self, input: f64, _: &Moment) -> f64 {
        let omega = 2.0 * PI * self.frequency_hz;
        self.speed += STEP_S * (omega * omega * (input - self.position) - 2.0 * self.damping * omega * self.speed);
        self.position += STEP_S * self.speed;
        self.position
    }
}

/// A heart that beats against the tip: a wave with overtones, running on between recordings.
pub struct Heart {
    /// Beats, Hz.
    pub frequency_hz: f64,
    /// Fundamental, mm.
    pub size_mm: f64,
    /// Second and third harmonic relative to the first.
    pub overtones: [f64; 2],
    /// Phase at the start of the session.
    pub phase: f64,
}

impl Stage for Heart {
    fn step(&mut self, input: f64, moment: &Moment) -> f64 {
        let angle = 2.0 * PI * self.frequency_hz * moment.session_s + self.phase;
        input + self.size_mm * (angle.sin() + self.overtones[0] * (2.0 * angle + 0.7).sin() + self.overtones[1] * (3.0 * angle + 1.9).sin())
    }
}

/// A mount that warms up: the zero wanders towards where it will stay.
pub struct WarmUp {
    /// Whole drift; mm for an offset, a share for a gain.
    pub size: f64,
    /// Time constant, s.
    pub time_s: f64,
    /// Whether it is the gain that wanders.
    pub gain: bool,
}

impl Stage for WarmUp {
    fn step(&mut self, input: f64, moment: &Moment) -> f64 {
        let share = self.size * (1.0 - (-moment.session_s / self.time_s).exp());
        if self.gain { input * (1.0 + share) } else { input + share }
    }
}

/// Somebody moved the sensor or the load between two recordings.
pub struct Remount {
    /// First recording with the new set-up.
    pub from: usize,
    /// Shift of the zero, mm.
    pub shift_mm: f64,
    /// Gain of the new set-up.
    pub gain: f64,
}

impl Stage for Remount {
    fn step(&mut self, input: f64, moment: &Moment) -> f64 {
        if moment.recording < self.from { input } else { self.shift_mm + self.gain * input }
    }
}

/// A muscle behind a closed valve with a hole in it: strokes pass, what is held trickles away.
pub struct Hole {
    /// Time in which a pressure of one bar would be lost, s.
    pub time_s: f64,
    /// Command of the last step, bar.
    pub last_bar: f64,
    /// Pressure in the muscle, bar.
    pub level: f64,
}

impl Stage for Hole {
    fn step(&mut self, input: f64, _: &Moment) -> f64 {
        // Turbulent loss: it grows a little slower than the pressure.
        self.level += input - self.last_bar - STEP_S / self.time_s * self.level.max(0.0).powf(0.85);
        self.level = self.level.max(0.0);
        self.last_bar = input;
        self.level
    }
}
