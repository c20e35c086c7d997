//! Stillness: a sensor that does not move although its quantity must have moved.
//!
//! A frozen sensor may carry noise, so identical codes are no condition. Two hypotheses are compared since the sensor last moved: the quantity moved as
//! expected, or the sensor is frozen and shows noise alone. With an expected motion `e`, an observed one of nothing, and noise of a standard
//! deviation `s`, the log-likelihood ratio of the two grows by `e^2 / 2 s^2` with every sample. The converter's noise is 0.005 mm, and an expected motion of
//! 0.2 mm gives 800 a sample: noise never limits the decision. What limits it is how far the expectation can be trusted, since friction may hold
//! a living tip. So the sensor is **still** while it stays within [`STILL_SHARE`] of its range, which is forty times the noise, and it is lost once
//! the command, followed at once or with the rig's slowest time constant, whichever moved less, went through `still_command_bar`. A model's estimate
//! does not decide: one that was validated on another rig lost a sound laser.
//!
//! During a hold the command does not move, and nothing is judged: a model may drift then.

use crate::number::MicroBar;

/// Share of the measured range within which a sensor counts as still: more than any noise, less than any motion worth the name.
pub const STILL_SHARE: f32 = 0.01;
/// Time constants at zero command after which a sensor that was still may prove itself again: everything is at rest then.
const FORGOTTEN: f32 = 5.0;

/// The watch over a sensor, ready to run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Stillness {
    band: f32,
    command_bar: f32,
    /// Share of the way to the command that the rig goes in a tick.
    response: f32,
    forgotten_ticks: f32,
}

/// Since when a sensor is still, and how far everything else moved meanwhile.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct StillnessState {
    /// The command as the slowest rig follows it, bar.
    followed_bar: f32,
    /// Since the sensor moved last: what the command went through, what the slowest rig would have followed, and the
    /// sensor's values.
    command_bar: Range,
    slow_bar: Range,
    value: Range,
    /// Ticks at zero command.
    zero_ticks: f32,
}

/// Lowest and highest of what was seen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Range {
    lowest: f32,
    highest: f32,
}

impl Range {
    fn at(value: f32) -> Self {
        Self { lowest: value, highest: value }
    }

    /// Takes in a value and gives the width.
    fn width_with(&mut self, value: f32) -> f32 {
        self.lowest = self.lowest.min(value);
        self.highest = self.highest.max(value);
        self.highest - self.lowest
    }
}

impl Stillness {
    /// Over a sensor with this range, and a rig with this time constant.
    pub(super) fn new(measured_range: f32, command_bar: f32, response_ms: f32) -> Self {
        Self {
            band: STILL_SHARE * measured_range,
            command_bar,
            // Backward Euler of a first-order lag: stable for every time constant.
            response: 1.0 / (1.0 + response_ms),
            forgotten_ticks: FORGOTTEN * response_ms,
        }
    }

    /// Whether the sensor has been still for too long.
    ///
    /// # Deadline
    /// No loops: a few comparisons and one multiplication.
    pub(super) fn step(&self, state: &mut StillnessState, value: f32, command: MicroBar) -> bool {
        state.followed_bar += self.response * (command.bar() - state.followed_bar);
        state.zero_ticks = if command == MicroBar::ZERO { state.zero_ticks + 1.0 } else { 0.0 };
        if state.value.width_with(value) > self.band || state.zero_ticks > self.forgotten_ticks {
            state.value = Range::at(value);
            state.command_bar = Range::at(command.bar());
            state.slow_bar = Range::at(state.followed_bar);
        }
        // Both: a rig that is fast has come to rest before a slow one would have moved.
        let (command_bar, slow_bar) = (state.command_bar.width_with(command.bar()), state.slow_bar.width_with(state.followed_bar));
        command_bar.min(slow_bar) >= self.command_bar
    }
}
