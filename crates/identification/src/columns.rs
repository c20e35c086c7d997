//! Columns: signals computed from the inputs alone, which a model weighs and adds.
//!
//! With `u_i` the inputs, `T` the sample period and every state at the equilibrium of the first sample of a stretch:
//!
//! ```text
//! v_i : v_i(k) += (1 - exp(-T/lag)) (u_i(k T - dead_time) - v_i(k-1))         input path
//! x_i = (v_i - centre_i) / half_i                                             scaled to -1..1 over the data
//! b   = T_n(x_i) | ramp(x_i) | play(x_i, r) | x_i x_j | tanh(a . z + c)                   basis
//! c   = b, or b behind one or more first-order lags                           filter
//! ```
//!
//! `T_n` are Chebyshev polynomials of the first kind; those above the first are held at the ends of the data, where they would run
//! away. The play operator is eq. (2) of the paper; its threshold may follow the speed, see [`Widening`]. The output path filters the sum of
//! all columns, which is the same as filtering each.

use std::ops::Range;

use hysteresis::play;
use serde::{Deserialize, Serialize};

use crate::filters::{Oscillator, coefficient};
use crate::series::segments;

/// Centre and half range of an input over the data that a model was made from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scaling {
    /// Value that maps to zero.
    pub centre: f64,
    /// Distance from there that maps to one; positive.
    pub half: f64,
}

impl Scaling {
    /// Over the range of some values, without a few that stand far apart from all others: those are mistakes of a sensor, and one of
    /// them would make everything else small. A signal that never moves maps to zero.
    #[must_use]
    pub fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut values: Vec<f64> = values.collect();
        values.sort_by(f64::total_cmp);
        let mut kept = values.as_slice();
        for _ in 0..(values.len() / ONE_IN).min(APART_MOST) {
            let [lowest, low, .., high, highest] = kept else { break };
            let apart = APART * (high - low);
            kept = if highest - high > apart && highest - high >= low - lowest {
                &kept[..kept.len() - 1]
            } else if low - lowest > apart {
                &kept[1..]
            } else {
                break;
            };
        }
        let (low, high) = (kept.first().copied().unwrap_or(f64::INFINITY), kept.last().copied().unwrap_or(f64::NEG_INFINITY));
        let half = 0.5 * (high - low);
        Self { centre: low + half, half: if half > 0.0 { half } else { 1.0 } }
    }

    /// The scaled value.
    #[must_use]
    pub fn apply(&self, value: f64) -> f64 {
        (value - self.centre) / self.half
    }
}

/// Values that stand apart at most, and how many there must be for each of them.
const APART_MOST: usize = 4;
const ONE_IN: usize = 500;
/// Distance of such a value from the next, over the range of the others.
const APART: f64 = 0.5;

/// First-order lags in a row.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lag {
    /// Time constant of each in s.
    pub time_constant_s: f64,
    /// How many.
    pub order: u8,
}

/// A memoryless or hysteretic function of the inputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Basis {
    /// Chebyshev polynomial of one scaled input.
    Polynomial {
        /// Which input.
        input: usize,
        /// Degree, 1 or more.
        degree: usize,
    },
    /// `(x - from) / (to - from)`, held at 0 below and 1 above; at the ends of -1..1 it goes on. Ramps with weights of one sign add up to a
    /// monotone curve.
    Ramp {
        /// Which input.
        input: usize,
        /// Where it begins, in scaled input.
        from: f64,
        /// Where it ends, above `from`.
        to: f64,
    },
    /// Play operator on one scaled input.
    Play {
        /// Which input.
        input: usize,
        /// Threshold in scaled input.
        threshold: f64,
    },
    /// Product of two scaled inputs.
    Product {
        /// First input.
        first: usize,
        /// Second input.
        second: usize,
    },
    /// One scaled input behind `y'' + 2 damping w y' + w^2 y = w^2 x` with `w = 2 pi frequency_hz`: `y`, or `y' / w`.
    Oscillator {
        /// Which input.
        input: usize,
        /// Undamped natural frequency in Hz.
        frequency_hz: f64,
        /// Damping ratio.
        damping: f64,
        /// Whether it is `y' / w`.
        rate: bool,
    },
    /// `tanh(sum_k gains_k column_k + bias)` of columns further up.
    Sigmoid {
        /// Indices of the columns.
        columns: Vec<usize>,
        /// Their gains.
        gains: Vec<f64>,
        /// Constant.
        bias: f64,
    },
}

/// A basis function, perhaps behind lags.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Column {
    /// The function.
    pub basis: Basis,
    /// The lags.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lag: Option<Lag>,
}

/// Thresholds of play operators that follow the speed of their input: `r + gain ln(1 + |dx/dt| / speed)`, not below zero, with `x` the scaled
/// input behind dead time and lag (M. Al Janaideh, S. Rakheja and C.-Y. Su, Mechatronics 19, 2009, with one gain for all operators).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Widening {
    /// Speed from which the thresholds follow less and less, in half ranges a second.
    pub speed: f64,
    /// Gain, in half ranges; below zero, loops narrow as the input gets faster.
    pub gain: f64,
}

impl Widening {
    /// What it adds to the thresholds at each sample of a stretch; nothing at its first.
    fn of(&self, x: &[f64], sample_period_s: f64, widths: &mut [f64]) {
        for (sample, width) in widths.iter_mut().enumerate() {
            let speed = (x[sample] - x[sample.saturating_sub(1)]).abs() / sample_period_s;
            *width = self.gain * (speed / self.speed).ln_1p();
        }
    }
}

/// A filter on the whole sum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OutputPath {
    /// None.
    #[default]
    Direct,
    /// `y'' + 2 damping w y' + w^2 y = w^2 s` with `w = 2 pi frequency_hz`.
    Oscillator {
        /// Undamped natural frequency in Hz.
        frequency_hz: f64,
        /// Damping ratio.
        damping: f64,
    },
    /// A first-order lag.
    Lag {
        /// Time constant in s.
        time_constant_s: f64,
    },
}

/// Everything that turns inputs into columns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Structure {
    /// Time between samples in s.
    pub sample_period_s: f64,
    /// Dead time of the inputs in s.
    pub dead_time_s: f64,
    /// Time constant of a first-order lag of the inputs in s; 0 is none.
    pub lag_s: f64,
    /// Scaling of each input.
    pub scalings: Vec<Scaling>,
    /// Where play operators rest before the first sample, in scaled input; absent: at the first sample.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rest: Option<Vec<f64>>,
    /// How thresholds follow the speed; absent: they stand still.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub widening: Option<Widening>,
    /// The filter of the sum.
    #[serde(default)]
    pub output_path: OutputPath,
    /// The columns.
    pub columns: Vec<Column>,
}

impl Structure {
    /// Calls `each` with the index and the samples of every column, in order.
    ///
    /// `inputs` has one slice an input, all of one length; states start anew at every index in `gaps`.
    ///
    /// # Panics
    /// When there are fewer inputs than the structure names.
    pub fn for_each_column(&self, inputs: &[&[f64]], gaps: &[usize], mut each: impl FnMut(usize, &[f64])) {
        let length = inputs.first().map_or(0, |input| input.len());
        let segments = segments(length, gaps);
        let scaled: Vec<Vec<f64>> = inputs
            .iter()
            .zip(&self.scalings)
            .map(|(input, scaling)| {
                let mut path = vec![0.0; length];
                for segment in &segments {
                    self.input_path(&input[segment.clone()], &mut path[segment.clone()]);
                }
                path.iter_mut().for_each(|value| *value = scaling.apply(*value));
                path
            })
            .collect();
        let widths: Vec<Vec<f64>> = self.widening.map_or_else(Vec::new, |widening| {
            let width = |x: &Vec<f64>| {
                let mut widths = vec![0.0; length];
                let stretches = segments.iter().cloned();
                stretches.for_each(|stretch| widening.of(&x[stretch.clone()], self.sample_period_s, &mut widths[stretch]));
                widths
            };
            scaled.iter().map(width).collect()
        });
        let rests = |input: usize, first: f64| self.rest.as_ref().and_then(|rest| rest.get(input)).copied().unwrap_or(first);
        // Columns that a sigmoid looks at are kept.
        let kept = self.kept();
        let mut store: Vec<Vec<f64>> = vec![Vec::new(); self.columns.len()];
        let mut values = vec![0.0; length];
        for (index, column) in self.columns.iter().enumerate() {
            match &column.basis {
                Basis::Polynomial { input, degree } => {
                    values.iter_mut().zip(&scaled[*input]).for_each(|(value, &x)| *value = chebyshev(*degree, x));
                }
                Basis::Ramp { input, from, to } => {
                    let low = if *from <= -1.0 { f64::NEG_INFINITY } else { 0.0 };
                    let high = if *to >= 1.0 { f64::INFINITY } else { 1.0 };
                    let ramp = |x: f64| ((x - from) / (to - from)).max(low).min(high);
                    values.iter_mut().zip(&scaled[*input]).for_each(|(value, &x)| *value = ramp(x));
                }
                Basis::Product { first, second } => {
                    let pairs = scaled[*first].iter().zip(&scaled[*second]);
                    values.iter_mut().zip(pairs).for_each(|(value, (&a, &b))| *value = a.clamp(-1.0, 1.0) * b.clamp(-1.0, 1.0));
                }
                Basis::Play { input, threshold } => {
                    let (x, width) = (&scaled[*input], widths.get(*input));
                    for segment in &segments {
                        let mut state = rests(*input, x[segment.start]);
                        for sample in segment.clone() {
                            let threshold = width.map_or(*threshold, |width| (threshold + width[sample]).max(0.0));
                            state = play::step(threshold, x[sample], state);
                            values[sample] = state;
                        }
                    }
                }
                Basis::Oscillator { input, frequency_hz, damping, rate } => {
                    let oscillator = Oscillator::new(std::f64::consts::TAU * frequency_hz * self.sample_period_s, *damping, *rate);
                    values.copy_from_slice(&scaled[*input]);
                    segments.iter().for_each(|segment| oscillator.run(&mut values[segment.clone()]));
                }
                Basis::Sigmoid { columns, gains, bias } => {
                    values.fill(*bias);
                    for (&column, &gain) in columns.iter().zip(gains) {
                        values.iter_mut().zip(&store[column]).for_each(|(value, &other)| *value += gain * other);
                    }
                    values.iter_mut().for_each(|value| *value = value.tanh());
                }
            }
            if let Some(lag) = column.lag {
                for _ in 0..lag.order {
                    self.low_pass(&mut values, &segments, lag.time_constant_s);
                }
            }
            if kept[index] {
                store[index].clone_from(&values);
            }
            match self.output_path {
                OutputPath::Direct => each(index, &values),
                path => {
                    let mut filtered = values.clone();
                    self.filter_output(path, &mut filtered, &segments);
                    each(index, &filtered);
                }
            }
        }
    }

    /// Which columns a sigmoid looks at.
    fn kept(&self) -> Vec<bool> {
        let mut kept = vec![false; self.columns.len()];
        for column in &self.columns {
            if let Basis::Sigmoid { columns, .. } = &column.basis {
                columns.iter().for_each(|&column| kept[column] = true);
            }
        }
        kept
    }

    /// Dead time with linear interpolation between samples, then the lag; both at the equilibrium of the first sample.
    fn input_path(&self, input: &[f64], path: &mut [f64]) {
        let dead_time = self.dead_time_s / self.sample_period_s;
        let (whole, part) = (dead_time.floor(), dead_time.fract());
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count of samples, checked not negative")]
        let whole = whole as usize;
        let ago = |index: usize, samples: usize| input[index.saturating_sub(samples)];
        let coefficient = coefficient(self.sample_period_s, self.lag_s);
        let mut state = input[0];
        for (index, value) in path.iter_mut().enumerate() {
            let delayed = if part == 0.0 { ago(index, whole) } else { (1.0 - part) * ago(index, whole) + part * ago(index, whole + 1) };
            state += coefficient * (delayed - state);
            *value = state;
        }
    }

    fn low_pass(&self, values: &mut [f64], segments: &[Range<usize>], time_constant_s: f64) {
        let coefficient = coefficient(self.sample_period_s, time_constant_s);
        for segment in segments {
            let mut state = values[segment.start];
            for value in &mut values[segment.clone()] {
                state += coefficient * (*value - state);
                *value = state;
            }
        }
    }

    fn filter_output(&self, path: OutputPath, values: &mut [f64], segments: &[Range<usize>]) {
        match path {
            OutputPath::Direct => {}
            OutputPath::Lag { time_constant_s } => self.low_pass(values, segments, time_constant_s),
            OutputPath::Oscillator { frequency_hz, damping } => {
                let oscillator = Oscillator::new(std::f64::consts::TAU * frequency_hz * self.sample_period_s, damping, false);
                for segment in segments {
                    oscillator.run(&mut values[segment.clone()]);
                }
            }
        }
    }
}

/// Chebyshev polynomial of the first kind; beyond -1..1 the first goes on and the others hold.
fn chebyshev(degree: usize, x: f64) -> f64 {
    if degree == 1 {
        return x;
    }
    let x = x.clamp(-1.0, 1.0);
    let (mut before, mut value) = (1.0, x);
    for _ in 1..degree {
        (before, value) = (value, 2.0 * x * value - before);
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    fn structure(columns: Vec<Column>) -> Structure {
        Structure {
            sample_period_s: 0.01,
            dead_time_s: 0.0,
            lag_s: 0.0,
            scalings: vec![Scaling { centre: 0.0, half: 1.0 }; 2],
            rest: None,
            widening: None,
            output_path: OutputPath::Direct,
            columns,
        }
    }

    fn plain(basis: Basis) -> Column {
        Column { basis, lag: None }
    }

    #[test]
    fn columns_are_their_closed_forms() {
        let x: Vec<f64> = (0..100).map(|k| (f64::from(k) * 0.1).sin()).collect();
        let y: Vec<f64> = (0..100).map(|k| (f64::from(k) * 0.03).cos()).collect();
        let columns = vec![
            plain(Basis::Polynomial { input: 0, degree: 4 }),
            plain(Basis::Product { first: 0, second: 1 }),
            plain(Basis::Sigmoid { columns: vec![0, 1], gains: vec![2.0, -1.0], bias: 0.3 }),
        ];
        let mut made = Vec::new();
        structure(columns).for_each_column(&[&x, &y], &[], |_, values| made.push(values.to_vec()));
        for k in 0..100 {
            let four = (4.0 * x[k].acos()).cos();
            assert!((made[0][k] - four).abs() < 1e-12);
            assert!((made[1][k] - x[k] * y[k]).abs() < 1e-15);
            assert!((made[2][k] - (2.0 * four - x[k] * y[k] + 0.3).tanh()).abs() < 1e-12);
        }
    }

    #[test]
    fn one_outlier_does_not_set_the_scaling_and_a_real_range_does() {
        let wave = |k: u32| (f64::from(k) * 0.01).sin();
        let clean = Scaling::of((0..2000).map(wave));
        assert!((clean.half - 1.0).abs() < 1e-3 && clean.centre.abs() < 1e-3);
        let spiked = Scaling::of((0..2000).map(|k| if k == 700 { 40.0 } else { wave(k) }));
        assert!((spiked.half - clean.half).abs() < 1e-3, "{spiked:?}");
        let steps = Scaling::of((0..2000).map(|k| f64::from(k % 2) * 5.0));
        assert!((steps.half - 2.5).abs() < 1e-12, "two levels are a range");
    }

    #[test]
    fn a_step_meets_lag_and_oscillator_as_it_should() {
        let step: Vec<f64> = (0..2000).map(|k| f64::from(u8::from(k > 0))).collect();
        let base = structure(vec![plain(Basis::Polynomial { input: 0, degree: 1 })]);
        let lagged = Structure { output_path: OutputPath::Lag { time_constant_s: 0.5 }, ..base.clone() };
        lagged.for_each_column(&[&step, &step], &[], |_, values| {
            for k in (10..2000).step_by(100) {
                assert!((values[k] - (1.0 - (-(k as f64) * 0.01 / 0.5).exp())).abs() < 1e-9);
            }
        });
        let (frequency_hz, damping) = (0.8, 0.3);
        let swinging = Structure { output_path: OutputPath::Oscillator { frequency_hz, damping }, ..base };
        swinging.for_each_column(&[&step, &step], &[], |_, values| {
            let w = std::f64::consts::TAU * frequency_hz;
            let wd = w * (1.0_f64 - damping * damping).sqrt();
            for k in (50..2000).step_by(50) {
                // The step comes half a sample before sample 1 for a trapezoidal rule.
                let t = (k as f64 - 0.5) * 0.01;
                let exact = 1.0 - (-damping * w * t).exp() * ((wd * t).cos() + damping * w / wd * (wd * t).sin());
                assert!((values[k] - exact).abs() < 1e-3, "{k}: {} {exact}", values[k]);
            }
        });
    }

    #[test]
    fn an_oscillator_gives_position_and_rate() {
        let (frequency_hz, damping) = (0.8, 0.3);
        let w = std::f64::consts::TAU * frequency_hz;
        // At the natural frequency the position lags by a quarter turn with a gain of 1 / (2 damping), and the rate is in phase.
        let drive: Vec<f64> = (0..4000).map(|k| (w * f64::from(k) * 0.01).sin()).collect();
        let oscillator = |rate| plain(Basis::Oscillator { input: 0, frequency_hz, damping, rate });
        let mut made = Vec::new();
        structure(vec![oscillator(false), oscillator(true)])
            .for_each_column(&[&drive, &drive], &[], |_, values| made.push(values.to_vec()));
        for (k, (position, rate)) in made[0].iter().zip(&made[1]).enumerate().skip(3000) {
            let angle = w * k as f64 * 0.01;
            assert!((position + angle.cos() / (2.0 * damping)).abs() < 2e-3, "{k}");
            assert!((rate - angle.sin() / (2.0 * damping)).abs() < 2e-3, "{k}");
        }
        let still = vec![0.7; 50];
        structure(vec![oscillator(false), oscillator(true)]).for_each_column(&[&still, &still], &[], |index, values| {
            let rest = if index == 0 { 0.7 } else { 0.0 };
            assert!(values.iter().all(|value| (value - rest).abs() < 1e-12), "it starts at rest");
        });
    }

    #[test]
    fn thresholds_follow_the_speed() {
        let play = plain(Basis::Play { input: 0, threshold: 0.1 });
        for (gain, speed) in [(0.2, 0.2), (0.2, 1.0), (-0.2, 0.2), (-0.2, 10.0)] {
            // Up at that speed, then at rest.
            let x: Vec<f64> = (0..200).map(|k| speed * 0.01 * f64::from(k.min(100))).collect();
            let widening = Some(Widening { speed: 0.5, gain });
            let mut made = Vec::new();
            Structure { widening, ..structure(vec![play.clone()]) }.for_each_column(&[&x, &x], &[], |_, values| made = values.to_vec());
            let threshold = (0.1 + gain * (1.0 + speed / 0.5_f64).ln()).max(0.0);
            assert!((x[100] - made[100] - threshold).abs() < 1e-9, "{gain} {speed}: {}", x[100] - made[100]);
            // At rest a wider threshold lets the state come after.
            assert!((x[199] - made[199] - threshold.min(0.1)).abs() < 1e-9, "{gain} {speed}: {}", x[199] - made[199]);
        }
    }

    #[test]
    fn a_gap_starts_memory_anew() {
        let x: Vec<f64> = (0..60).map(|k| (f64::from(k) * 0.2).sin()).collect();
        let columns = vec![Column { basis: Basis::Play { input: 0, threshold: 0.4 }, lag: Some(Lag { time_constant_s: 0.1, order: 2 }) }];
        let (mut whole, mut part) = (Vec::new(), Vec::new());
        let structure = structure(columns);
        structure.for_each_column(&[&x, &x], &[25], |_, values| whole = values.to_vec());
        structure.for_each_column(&[&x[25..], &x[25..]], &[], |_, values| part = values.to_vec());
        assert_eq!(whole[25..], part[..]);
    }
}
