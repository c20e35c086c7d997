//! The law of holding and jumping, its parameters, and what the observers see and say.

use crate::chain::columns::Bank;
use crate::chain::form::{Drive, Parameter, Quantity};
use crate::chain::valve::Valve;

/// Density, per span of the output, of a sample that no law explains: one in a hundred anywhere in the range.
pub(crate) const OUTLIER_DENSITY: f64 = 0.01;

/// Weight of a history below which it is given up: it could not come back within two samples.
pub(crate) const PRUNING_THRESHOLD: f64 = 1e-9;

/// Time over which the quasi-static response's error drifts, s.
pub(crate) const MODEL_ERROR_S: f64 = 0.6;

/// A law of holding and jumping, normalised; lengths in those of the drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlipLaw {
    /// What it breaks away by.
    pub drive: Drive,
    /// Distance of drive and stick position at which it breaks away.
    pub break_away: f64,
    /// How far beyond the drive it lands, in break-away distances; a tip may land short of it. Of a valve: where in its band the quasi-static response stands, for weights that were
    /// fitted without it have taken the mean error for hysteresis; zero for weights of the muscle alone, which is led by the pressure.
    pub overshoot: f64,
    /// Speed of the quasi-static response, per s, from which a tip slides: it follows the quasi-static response until that has become a good deal slower.
    pub sliding_speed: f64,
    /// Share of the quasi-static response's way by which a tip that holds gives way: bristles and seals yield before they slide (Dahl, 1968).
    pub presliding: f64,
    /// By how much a tip's slip grows with the speed of the quasi-static response, s: friction takes time to fall and to build up.
    pub slip_per_speed_s: f64,
    /// How much a tip's break-away distance falls with the speed of the quasi-static response, at the sliding speed: static friction takes time to build up
    /// (Johannes, Green and Brockley, 1973; Richardson and Nolle, 1976).
    pub rate_weakening: f64,
    /// How far behind the quasi-static response a tip slides, in break-away distances.
    pub kinetic_friction: f64,
    /// How long a tip's slip takes, s.
    pub slip_s: f64,
    /// Where a tip sits when a recording begins, from the quasi-static response, in spans of the output.
    pub begins: f64,
    /// Error, in break-away distances, at which an open valve closes.
    pub closing: f64,
    /// Time constant with which the pressure follows through an open valve, s.
    pub flow_s: f64,
    /// What passes through an open valve at most, spans per s.
    pub most_flow: f64,
    /// Scatter of break-away and slip overshoot, in break-away distances.
    pub scatter: f64,
    /// Standard deviation of the quasi-static response's model error, in spans of the output.
    pub model_error: f64,
    /// Time constant with which a tip follows while it moves, and the pressure of a valve that is never shut, s; the quasi-static response has it already.
    pub lag_s: f64,
}

const fn linear(name: &'static str, quantity: Quantity, high: f64) -> Parameter {
    Parameter { name, quantity, low: 0.0, high, logarithmic: false }
}

const fn distance(quantity: Quantity) -> Parameter {
    Parameter { name: "break_away", quantity, low: 1e-3, high: 0.5, logarithmic: true }
}

const OVERSHOOT: Parameter = linear("landing", Quantity::Ratio, 1.0);

const OVERSHOOT_OF_A_TIP: Parameter = Parameter { low: LEAST_OVERSHOOT_OF_A_TIP, ..OVERSHOOT };

const SCATTER: Parameter = linear("scatter", Quantity::Ratio, 1.0);

const MODEL_ERROR: Parameter = linear("pull_wander", Quantity::Output, 0.5);

const FOLLOWING: Parameter = linear("lag", Quantity::Time, 0.3);

const NOISY: Parameter = linear("noise", Quantity::Output, 0.5);

/// Parameters of a form whose stick position is that of a tip.
pub const OF_A_TIP: &[Parameter] = &[
    distance(Quantity::Output),
    OVERSHOOT_OF_A_TIP,
    Parameter { name: "sliding_speed", quantity: Quantity::OutputRate, low: 1e-2, high: NEVER, logarithmic: true },
    SCATTER,
    MODEL_ERROR,
    FOLLOWING,
    NOISY,
    linear("yielding", Quantity::Ratio, MOST_PRESLIDING),
    Parameter { low: -MOST_SLIP_PER_SPEED_S, ..linear("leap_per_speed", Quantity::Time, MOST_SLIP_PER_SPEED_S) },
    linear("fall_with_rate", Quantity::Ratio, MOST_RATE_WEAKENING),
    Parameter { low: -MOST_KINETIC_FRICTION, ..linear("slides_behind", Quantity::Ratio, MOST_KINETIC_FRICTION) },
    linear("leap_time", Quantity::Time, MOST_SLIP_S),
    Parameter { low: -0.5, ..linear("seat_at_first", Quantity::Output, 0.5) },
];

/// More than this share of the quasi-static response's way is no holding.
pub const MOST_PRESLIDING: f64 = 0.3;

/// Largest change of a slip with the speed of the quasi-static response, s: the time that a slip takes.
pub const MOST_SLIP_PER_SPEED_S: f64 = MOST_SLIP_S;

/// Largest fall of a tip's break-away distance with the speed of the quasi-static response.
pub const MOST_RATE_WEAKENING: f64 = 1.5;

/// Farthest that a tip slides behind the quasi-static response, or before one that has taken the mean of that for hysteresis, in break-away distances.
pub const MOST_KINETIC_FRICTION: f64 = 1.0;

/// Longest slip, s.
pub const MOST_SLIP_S: f64 = 0.12;

/// Shortest slip of a tip: less than a third of what it breaks away by is hardly one.
const LEAST_OVERSHOOT_OF_A_TIP: f64 = -0.7;

/// Parameters of a form whose stick position is a valve's pressure.
pub const OF_A_VALVE: &[Parameter] = &[
    distance(Quantity::Input),
    OVERSHOOT,
    linear("closing", Quantity::Ratio, 1.0),
    SCATTER,
    MODEL_ERROR,
    FOLLOWING,
    NOISY,
    linear("flow_time_constant", Quantity::Time, 0.3),
    Parameter { name: "most_flow", quantity: Quantity::InputRate, low: LEAST_FLOW, high: NEVER, logarithmic: true },
];

/// Least limit of what passes through an open valve, spans per s.
pub const LEAST_FLOW: f64 = 1.0;

/// Least share of its band by which the mean error of a valve may be in the weights, if it is there at all.
const LEAST_OVERSHOOT: f64 = 0.01;

/// Which of them is the lag.
pub const LAG: usize = 5;

/// A speed, per s, that nothing reaches.
pub const NEVER: f64 = 1e3;

impl SlipLaw {
    /// The law from which others differ: it holds within nothing, and slips whole.
    pub(crate) const fn plain(drive: Drive) -> Self {
        Self {
            drive,
            break_away: 0.0,
            overshoot: 0.0,
            sliding_speed: NEVER,
            presliding: 0.0,
            slip_per_speed_s: 0.0,
            rate_weakening: 0.4,
            kinetic_friction: 0.0,
            slip_s: 0.0,
            begins: 0.0,
            closing: 0.0,
            flow_s: 0.0,
            most_flow: NEVER,
            scatter: 0.0,
            model_error: 0.0,
            lag_s: 0.0,
        }
    }

    /// The valve of this law.
    pub(crate) fn valve(&self) -> Valve {
        let closing = self.closing * self.break_away;
        Valve { band: self.break_away, closing, flow_s: self.flow_s.max(1e-4), most_flow: self.most_flow }
    }

    /// Whether the operators are those of the muscle behind a valve, and have taken nothing of the valve for hysteresis of theirs.
    pub fn leads_the_muscle(&self) -> bool {
        self.drive == Drive::Command && self.overshoot == 0.0
    }

    /// The law with this break-away distance. A tip keeps its travel, which recordings show far better than where in it the quasi-static response is.
    pub fn with_break_away(&self, break_away: f64) -> Self {
        let overshoot = match self.drive {
            Drive::QuasiStatic => ((1.0 + self.overshoot) * self.break_away / break_away - 1.0).clamp(LEAST_OVERSHOOT_OF_A_TIP, 1.0),
            Drive::Command => self.overshoot,
        };
        Self { break_away, overshoot, ..*self }
    }

    /// A tip's law for a quasi-static response that is farther from the stick position by this on every way: it moves as before.
    pub fn of_a_response_farther(&self, by: f64) -> Self {
        let break_away = self.break_away + by;
        let share = self.break_away / break_away;
        let overshoot = (1.0 + self.overshoot) * share - 1.0;
        let behind = ((self.kinetic_friction * self.break_away + by) / break_away).min(MOST_KINETIC_FRICTION);
        Self {
            break_away,
            overshoot,
            kinetic_friction: behind,
            scatter: self.scatter * share,
            rate_weakening: self.rate_weakening * share,
            ..*self
        }
    }

    /// The law with its slip overshoot moved by this: a share of a tip's travel, and of a valve's break-away distance.
    pub fn with_overshoot(&self, by: f64) -> Self {
        let overshoot = match self.drive {
            Drive::QuasiStatic => (self.overshoot + (1.0 + self.overshoot) * by).clamp(LEAST_OVERSHOOT_OF_A_TIP, 1.0),
            Drive::Command if self.leads_the_muscle() => 0.0,
            Drive::Command => (self.overshoot + by).clamp(LEAST_OVERSHOOT, 1.0),
        };
        Self { overshoot, ..*self }
    }

    /// The law with these parameters of a form, and the noise behind it.
    pub fn of_parameters(drive: Drive, parameters: &[f64]) -> (Self, f64) {
        let &[break_away, overshoot, of_kind, scatter, model_error, lag_s, noise, ref others @ ..] = parameters else {
            unreachable!("forms whose seat is seen have seven parameters in common");
        };
        let other = |index: usize| others.get(index).copied().unwrap_or(0.0);
        let still = Self { break_away, overshoot, scatter, model_error, lag_s, ..Self::plain(drive) };
        let law = match drive {
            Drive::QuasiStatic => Self {
                sliding_speed: of_kind,
                presliding: other(0),
                slip_per_speed_s: other(1),
                rate_weakening: other(2),
                kinetic_friction: other(3),
                slip_s: other(4),
                begins: other(5),
                ..still
            },
            Drive::Command => Self { closing: of_kind, flow_s: other(0), most_flow: others.get(1).copied().unwrap_or(NEVER), ..still },
        };
        (law, noise)
    }

    /// The parameters of a form with this law.
    pub fn as_parameters(&self, noise: f64) -> Vec<f64> {
        let of = |of_kind: f64| vec![self.break_away, self.overshoot, of_kind, self.scatter, self.model_error, self.lag_s, noise];
        match self.drive {
            Drive::QuasiStatic => {
                let of_a_tip =
                    vec![self.presliding, self.slip_per_speed_s, self.rate_weakening, self.kinetic_friction, self.slip_s, self.begins];
                [of(self.sliding_speed), of_a_tip].concat()
            }
            Drive::Command => [of(self.closing), vec![self.flow_s, self.most_flow]].concat(),
        }
    }
}

/// One recording as the observers see it.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a> {
    /// Input, normalised.
    pub command: &'a [f64],
    /// The pressure that the quasi-static response is made by, normalised.
    pub followed: &'a [f64],
    /// Quasi-static response, normalised.
    pub quasi_static: &'a [f64],
    /// Measured output, normalised.
    pub measured: &'a [f64],
    /// Which samples count.
    pub keep: &'a [bool],
    /// Sample period, s.
    pub period_s: f64,
    /// Standard deviation of the noise.
    pub noise: f64,
    /// What makes the quasi-static response of the pressure, where nothing else does.
    pub bank: Option<&'a Bank>,
}

/// What an observer expected of every sample before it was seen.
#[derive(Clone, Debug, Default)]
pub struct Expected {
    /// Mean.
    pub mean: Vec<f64>,
    /// Variance without the noise.
    pub variance: Vec<f64>,
    /// Logarithm of the likelihood.
    pub log_likelihood: Vec<f64>,
    /// Mean of a valve's pressure; empty for a tip.
    pub stick_position: Vec<f64>,
    /// What a tip tells of its quasi-static response; empty for a valve.
    pub pseudo_measurements: Vec<PseudoMeasurement>,
}

/// What the moment of a slip, or sliding, tells of the quasi-static response.
#[derive(Clone, Copy, Debug)]
pub struct PseudoMeasurement {
    /// At this sample.
    pub sample: usize,
    /// The side of the stick position on which the quasi-static response is: 1 or -1.
    pub direction: f64,
    /// The quasi-static response, normalised.
    pub quasi_static: f64,
    /// Its variance.
    pub variance: f64,
}

/// Normal distribution function, by the logistic one (largest error 0.01).
pub(crate) fn chance(deviations: f64) -> f64 {
    1.0 / (1.0 + (-1.702 * deviations).exp())
}

/// Density of a normal deviate with this error and variance.
pub(crate) fn density(error: f64, variance: f64) -> f64 {
    (1.0 - OUTLIER_DENSITY) * (-0.5 * error * error / variance).exp() / (2.0 * std::f64::consts::PI * variance).sqrt()
}

/// Variance by which the quasi-static response may be off where a sample with this error was trusted so far: one that no history explains is a bad reading,
/// several in a row are a quasi-static response that must be found again.
pub(crate) fn inflation(trust: f64, error: f64) -> f64 {
    (1.0 - trust) * (INFLATION * error).powi(2)
}

/// Share of the error of a sample which is not believed that the quasi-static response may be off by.
const INFLATION: f64 = 0.2;
