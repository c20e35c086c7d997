//! Adam, AdamW and SOAP on a part of the parameters, with a running average of the weights.

use pulp::{Arch, Simd, WithSimd};
use serde::{Deserialize, Serialize};

use super::blocks::Block;
use super::eigenbasis::Eigenbasis;

/// The coordinates in which each parameter gets a step length of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// The parameters themselves (Kingma and Ba, 2015).
    Adam,
    /// The eigenvectors of each weight matrix's gradient moments (Vyas et al., 2024).
    Soap,
}

/// Settings of the optimiser.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OptimizerConfig {
    /// Adam or SOAP.
    pub method: Method,
    /// Decay of the gradient's running mean.
    pub beta1: f32,
    /// Decay of the squared gradient's running mean.
    pub beta2: f32,
    /// SOAP: decay of the running moments whose eigenvectors are the coordinates.
    pub basis_decay: f32,
    /// SOAP: steps between two corrections of the coordinates.
    pub basis_interval: u64,
    /// Added to the root of the squared mean.
    pub epsilon: f32,
    /// Decoupled weight decay per unit of learning rate (Loshchilov and Hutter, 2019).
    pub weight_decay: f32,
    /// The gradient of the whole network is scaled down to this Euclidean norm when it is longer.
    pub clip_norm: f32,
    /// Decay of the weights' running average, per step; 0 is no averaging.
    pub average_decay: f32,
}

impl Default for OptimizerConfig {
    fn default() -> Self {
        Self {
            method: Method::Adam,
            beta1: 0.9,
            beta2: 0.999,
            basis_decay: 0.95,
            basis_interval: 10,
            epsilon: 1e-8,
            weight_decay: 0.0,
            clip_norm: 1.0,
            average_decay: 0.0,
        }
    }
}

/// The parameters that one thread updates, with their optimiser state; all vectors go block by block.
#[derive(Clone, Debug, PartialEq)]
pub struct Shard {
    /// The parameters.
    pub values: Vec<f32>,
    /// Running mean of the gradient; in SOAP's coordinates.
    pub mean: Vec<f32>,
    /// Running mean of the squared gradient; in SOAP's coordinates.
    pub square: Vec<f32>,
    /// Running average of the parameters.
    pub average: Vec<f32>,
    /// SOAP's coordinates of each block; none for Adam.
    pub bases: Vec<Eigenbasis>,
}

/// The coordinates are corrected at each of the first steps: they start as the parameters' own.
const FIRST_TURNS: u64 = 20;

impl Shard {
    /// Blocks with these starting values.
    #[must_use]
    pub fn new(method: Method, blocks: &[Block], values: &[f32]) -> Self {
        let zeros = vec![0.0; values.len()];
        let bases = match method {
            Method::Adam => Vec::new(),
            Method::Soap => blocks.iter().map(|block| Eigenbasis::new(block.rows, block.columns)).collect(),
        };
        Self { values: values.to_vec(), mean: zeros.clone(), square: zeros, average: values.to_vec(), bases }
    }

    /// One step along `gradient * scale`; `step` counts from 1.
    pub fn update(&mut self, config: &OptimizerConfig, gradient: &[f32], scale: f32, learning_rate: f32, step: u64) {
        let count = i32::try_from(step).unwrap_or(i32::MAX);
        let first = f64::from(config.beta1).powi(count);
        let second = f64::from(config.beta2).powi(count);
        #[expect(clippy::cast_possible_truncation, reason = "the optimiser works in f32")]
        let (rate, unbias) = ((f64::from(learning_rate) / (1.0 - first)) as f32, (1.0 / (1.0 - second)) as f32);
        let mut direction: Vec<f32> = gradient.iter().map(|gradient| gradient * scale).collect();
        let mut at = 0;
        for basis in &mut self.bases {
            let block = at..at + basis.elements();
            at = block.end;
            basis.observe(&direction[block.clone()], config.basis_decay);
            if step <= FIRST_TURNS || step.is_multiple_of(config.basis_interval) {
                basis.turn(&mut self.mean[block.clone()], &mut self.square[block.clone()]);
            }
            basis.enter(&mut direction[block]);
        }
        let arch = Arch::new();
        arch.dispatch(Moments { mean: &mut self.mean, square: &mut self.square, direction: &mut direction, config, unbias });
        let mut at = 0;
        for basis in &mut self.bases {
            let block = at..at + basis.elements();
            at = block.end;
            basis.leave(&mut direction[block]);
        }
        // Early on the average follows closely, so that it does not remember the starting values.
        #[expect(clippy::cast_precision_loss, reason = "a ratio of counts")]
        let average_decay = config.average_decay.min((1.0 + step as f32) / (10.0 + step as f32));
        let average_decay = if config.average_decay > 0.0 { average_decay } else { 0.0 };
        let decay = 1.0 - learning_rate * config.weight_decay;
        arch.dispatch(Move { values: &mut self.values, average: &mut self.average, direction: &direction, rate, average_decay, decay });
    }
}

/// Adam's moments; turns the gradient into the direction of the step. A struct, so that it is compiled for the vector instructions it
/// is dispatched to.
struct Moments<'a> {
    mean: &'a mut [f32],
    square: &'a mut [f32],
    /// The gradient, then the direction.
    direction: &'a mut [f32],
    config: &'a OptimizerConfig,
    unbias: f32,
}

impl WithSimd for Moments<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { mean, square, direction, config, unbias } = self;
        for ((direction, mean), square) in direction.iter_mut().zip(mean).zip(square) {
            let gradient = *direction;
            *mean = config.beta1 * *mean + (1.0 - config.beta1) * gradient;
            *square = config.beta2 * *square + (1.0 - config.beta2) * gradient * gradient;
            *direction = *mean / ((*square * unbias).sqrt() + config.epsilon);
        }
    }
}

/// No parameter grows beyond this. Fixed point scales a weight of a feature, in Q1.14, up to 15.875, and those of hidden states further (see
/// [`model_export::quantise`]); a larger one would leave its row's others few bits, and a gate is saturated long before.
const LARGEST_WEIGHT: f32 = 15.75;

/// One step of all parameters of a shard.
struct Move<'a> {
    values: &'a mut [f32],
    average: &'a mut [f32],
    direction: &'a [f32],
    rate: f32,
    average_decay: f32,
    decay: f32,
}

impl WithSimd for Move<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { values, average, direction, rate, average_decay, decay } = self;
        for ((value, average), direction) in values.iter_mut().zip(average).zip(direction) {
            *value = (decay * *value - rate * direction).clamp(-LARGEST_WEIGHT, LARGEST_WEIGHT);
            *average = average_decay * *average + (1.0 - average_decay) * *value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_has_the_length_of_the_learning_rate() {
        // Bias correction makes the first Adam step `rate * sign(gradient)` whatever the gradient's size.
        let mut shard = Shard::new(Method::Adam, &[], &[1.0, 1.0, 1.0]);
        shard.update(&OptimizerConfig::default(), &[1e-3, -5.0, 0.2], 1.0, 0.01, 1);
        for (value, expected) in shard.values.iter().zip([0.99, 1.01, 0.99]) {
            assert!((value - expected).abs() < 1e-6, "{value} {expected}");
        }
    }

    #[test]
    fn a_quadratic_is_minimised_and_the_average_follows() {
        let config = OptimizerConfig { average_decay: 0.99, ..OptimizerConfig::default() };
        let mut shard = Shard::new(Method::Adam, &[], &[3.0, -2.0]);
        for step in 1..=3000 {
            let gradient: Vec<f32> = shard.values.iter().zip([1.0, 0.5]).map(|(value, target)| 2.0 * (value - target)).collect();
            shard.update(&config, &gradient, 1.0, 0.01, step);
        }
        for (value, target) in shard.values.iter().chain(&shard.average).zip([1.0, 0.5, 1.0, 0.5]) {
            assert!((value - target).abs() < 1e-3, "{value} {target}");
        }
    }

    #[test]
    fn no_weight_outgrows_what_fixed_point_can_scale() {
        let mut shard = Shard::new(Method::Adam, &[], &[30.0, -30.0, 0.0]);
        for step in 1..=50 {
            shard.update(&OptimizerConfig::default(), &[-1.0, 1.0, -1.0], 1.0, 0.1, step);
        }
        assert_eq!(shard.values[..2], [LARGEST_WEIGHT, -LARGEST_WEIGHT]);
        assert!((shard.values[2] - 5.0).abs() < 1e-3, "{}", shard.values[2]);
    }

    #[test]
    fn decoupled_decay_shrinks_weights_that_get_no_gradient() {
        let config = OptimizerConfig { weight_decay: 0.1, ..OptimizerConfig::default() };
        let mut shard = Shard::new(Method::Adam, &[], &[2.0]);
        shard.update(&config, &[0.0], 1.0, 0.01, 1);
        assert!((shard.values[0] - 2.0 * (1.0 - 0.001)).abs() < 1e-6);
    }

    /// Steps until a quadratic, whose steep directions lie across the parameters, has fallen a millionfold.
    fn steps_to_the_bottom(method: Method) -> u64 {
        let config = OptimizerConfig { method, beta1: 0.9, beta2: 0.95, ..OptimizerConfig::default() };
        let block = Block { start: 0, rows: 2, columns: 2 };
        let mut shard = Shard::new(method, &[block], &[1.0, -1.0, 0.5, 2.0]);
        let loss = |values: &[f32]| -> (f32, Vec<f32>) {
            // 1000 (a + b)^2 + (a - b)^2 for each column.
            let (mut sum, mut gradient) = (0.0, vec![0.0; 4]);
            for column in 0..2 {
                let (a, b) = (values[column], values[2 + column]);
                sum += 1000.0 * (a + b).powi(2) + (a - b).powi(2);
                gradient[column] = 2000.0 * (a + b) + 2.0 * (a - b);
                gradient[2 + column] = 2000.0 * (a + b) - 2.0 * (a - b);
            }
            (sum, gradient)
        };
        let start = loss(&shard.values).0;
        for step in 1..=20_000 {
            let (value, gradient) = loss(&shard.values);
            if value < 1e-6 * start {
                return step;
            }
            shard.update(&config, &gradient, 1.0, 0.02 / (1.0 + 0.01 * step as f32), step);
        }
        u64::MAX
    }

    #[test]
    fn soap_goes_along_a_slanting_valley_that_adam_crosses_back_and_forth() {
        let (adam, soap) = (steps_to_the_bottom(Method::Adam), steps_to_the_bottom(Method::Soap));
        assert!(soap < 1000 && adam > 2 * soap, "Adam takes {adam} steps, SOAP {soap}");
    }
}
