//! Laws of `smooth-hysteresis`: friction by a differential equation, one to tune on and one to report on. It lets go in a pause.

use super::draw::{Draw, Moment, Set};
use super::laws::{Drawn, stage};

/// Draws the law of a set.
pub(super) fn smooth_hysteresis(set: Set, draw: &mut Draw<'_>) -> Drawn {
    match set {
        Set::Tuning => bouc_wen(draw),
        Set::Reporting => dahl(draw),
    }
}

/// What a signal has moved since the last step, and friction that begins anew.
#[derive(Default)]
struct Friction {
    last: f64,
    value: f64,
}

impl Friction {
    /// Friction after a step, by what it changes with the travel: a command that steps travels far at once.
    fn step(&mut self, value: f64, moment: &Moment, longest: f64, slope: impl Fn(f64, f64) -> f64) -> f64 {
        let travel = value - self.last;
        self.last = value;
        if moment.begins {
            self.value = 0.0;
            return 0.0;
        }
        let parts = 1 + (travel.abs() / longest) as usize;
        let part = travel / parts as f64;
        for _ in 0..parts {
            self.value += part * slope(self.value, part);
        }
        self.value
    }
}

/// Bouc and Wen's friction with an exponent between one and two, beside the operators.
fn bouc_wen(draw: &mut Draw<'_>) -> Drawn {
    let range = draw.range_mm;
    let (size, onset) = (range * draw.log(0.06, 0.16) * draw.sign(), range * draw.log(0.05, 0.2));
    let (exponent, turning) = (draw.even(1.0, 2.0), draw.even(-0.5, 0.5));
    draw.tell("smooth-hysteresis.turning", turning);
    draw.tell("smooth-hysteresis.exponent", exponent);
    draw.tell("smooth-hysteresis.friction_mm", size);
    let mut friction = Friction::default();
    Drawn::Behind(stage(move |value, moment| {
        let slope = |friction: f64, part: f64| {
            let held = if part * friction > 0.0 { 1.0 } else { turning };
            (1.0 - held * friction.abs().powf(exponent)) / onset
        };
        value + size * friction.step(value, moment, 0.05 * onset, slope)
    }))
}

/// Dahl's friction (1968) with an exponent other than one, before the muscle.
fn dahl(draw: &mut Draw<'_>) -> Drawn {
    let (bound_bar, share) = (draw.span_bar * draw.log(0.04, 0.2), draw.even(0.5, 0.95));
    let exponent = draw.even(0.6, 1.6);
    let mut friction = Friction::default();
    Drawn::Before(stage(move |value, moment| {
        let slope = |friction: f64, part: f64| (1.0 - friction / bound_bar * part.signum()).max(0.0).powf(exponent);
        value - share * friction.step(value, moment, 0.02 * bound_bar, slope)
    }))
}
