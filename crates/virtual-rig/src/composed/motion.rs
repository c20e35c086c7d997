//! How a signal moves: its speed, the stroke that it is on, and what goes with its way.

use super::draw::STEP_S;

/// How fast a signal moves, smoothed.
#[derive(Default)]
pub(super) struct Speed {
    last: f64,
    per_s: f64,
}

impl Speed {
    /// Units per second after a step, with their sign.
    pub(super) fn step(&mut self, value: f64, smooth_s: f64) -> f64 {
        self.per_s += ((value - self.last) / STEP_S - self.per_s) * STEP_S / smooth_s;
        self.last = value;
        self.per_s
    }
}

/// The stroke that a signal is on.
#[derive(Default)]
pub(super) struct Stroke {
    /// Where it began.
    pub(super) start: f64,
    /// Whether it goes down.
    pub(super) falls: bool,
    farthest: f64,
}

impl Stroke {
    /// How long the last stroke was, if the signal has just turned back by more than `margin`.
    pub(super) fn turned(&mut self, value: f64, margin: f64) -> Option<f64> {
        let ahead = if self.falls { self.farthest - value } else { value - self.farthest };
        if ahead >= 0.0 {
            self.farthest = value;
        }
        if ahead >= -margin {
            return None;
        }
        let length = (self.farthest - self.start).abs();
        *self = Self { start: self.farthest, falls: !self.falls, farthest: value };
        Some(length)
    }
}

/// Nears `aim` exponentially over the way `onset`, whatever the size of the steps.
pub(super) fn nears(state: f64, aim: f64, way: f64, onset: f64) -> f64 {
    aim + (state - aim) * (-way.abs() / onset).exp()
}
