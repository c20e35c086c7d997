//! Decimation: from the 1 kHz tick to the model's period, with one filter for every channel.
//!
//! The filter is the mean of the window. It has zeros at every multiple of the output rate, which is where aliases to slow motion would
//! come from, and a delay of half a window that is the same for the command, the measured pressure and the displacement. A filter on
//! one channel only would open a fake loop: 20 ms of lag between channels is 10 % of the amplitude at 0.8 Hz.

use core::num::NonZeroU16;

/// Length of the window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DecimatorConfig {
    /// Ticks from one output to the next.
    pub factor: NonZeroU16,
}

/// The filter, ready to run over `CHANNELS` channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decimator<const CHANNELS: usize> {
    factor: u16,
    reciprocal: f32,
}

/// The window so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DecimatorState<const CHANNELS: usize> {
    sums: [Option<f32>; CHANNELS],
    ticks: u16,
}

impl DecimatorConfig {
    /// Builds the filter.
    pub fn build<const CHANNELS: usize>(self) -> Decimator<CHANNELS> {
        let factor = self.factor.get();
        Decimator { factor, reciprocal: 1.0 / f32::from(factor) }
    }
}

impl<const CHANNELS: usize> Default for DecimatorState<CHANNELS> {
    fn default() -> Self {
        Self { sums: [Some(0.0); CHANNELS], ticks: 0 }
    }
}

impl<const CHANNELS: usize> DecimatorState<CHANNELS> {
    /// Whether the next sample opens a new window.
    pub fn is_between_windows(&self) -> bool {
        self.ticks == 0
    }
}

impl<const CHANNELS: usize> Decimator<CHANNELS> {
    /// Ticks from one output to the next.
    pub fn factor(&self) -> u16 {
        self.factor
    }

    /// Takes one sample of every channel; at the end of a window gives the means.
    ///
    /// A channel that was missing anywhere in the window is missing in the result: a mean over part of the window would have
    /// another delay than the others.
    ///
    /// # Deadline
    /// One addition per channel, one multiplication per channel at the window's end.
    pub fn step(&self, state: &mut DecimatorState<CHANNELS>, samples: [Option<f32>; CHANNELS]) -> Option<[Option<f32>; CHANNELS]> {
        for (sum, sample) in state.sums.iter_mut().zip(samples) {
            *sum = sum.zip(sample).map(|(sum, sample)| sum + sample);
        }
        state.ticks = state.ticks.saturating_add(1);
        if state.ticks < self.factor {
            return None;
        }
        let means = state.sums.map(|sum| sum.map(|sum| sum * self.reciprocal));
        *state = DecimatorState::default();
        Some(means)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::vec::Vec;

    fn decimator(factor: u16) -> Decimator<2> {
        DecimatorConfig { factor: NonZeroU16::new(factor).unwrap() }.build()
    }

    #[test]
    fn both_channels_have_the_same_delay_of_half_a_window() {
        let filter = decimator(20);
        let mut state = DecimatorState::default();
        let mut outputs = Vec::new();
        for tick in 0..200u16 {
            let ramp = f32::from(tick);
            if let Some([Some(first), Some(second)]) = filter.step(&mut state, [Some(ramp), Some(2.0 * ramp)]) {
                outputs.push((tick, first, second));
            }
        }
        assert_eq!(outputs.len(), 10);
        for (tick, first, second) in outputs {
            assert!((f32::from(tick) - first - 9.5).abs() < 1e-4, "{tick}: {first}");
            assert!((second - 2.0 * first).abs() < 1e-4);
        }
    }

    #[test]
    fn a_tone_at_a_multiple_of_the_output_rate_does_not_alias() {
        let filter = decimator(20);
        for harmonic in 1..10u16 {
            let mut state = DecimatorState::default();
            for tick in 0..400u16 {
                let tone = (f32::from(tick) * f32::from(harmonic) * core::f32::consts::TAU / 20.0 + 0.3).sin();
                if let Some([Some(mean), _]) = filter.step(&mut state, [Some(tone), Some(0.0)]) {
                    assert!(mean.abs() < 1e-5, "harmonic {harmonic}: {mean}");
                }
            }
        }
    }

    #[test]
    fn a_channel_with_a_gap_is_missing_for_that_window_only() {
        let filter = decimator(4);
        let mut state = DecimatorState::default();
        let mut outputs = Vec::new();
        for tick in 0..12 {
            let gap = (tick != 5).then_some(1.0);
            outputs.extend(filter.step(&mut state, [gap, Some(3.0)]));
        }
        assert_eq!(outputs, [[Some(1.0), Some(3.0)], [None, Some(3.0)], [Some(1.0), Some(3.0)]]);
    }
}
