//! Adam and AdamW on a part of the parameters, with a running average of the weights.

use pulp::{Arch, Simd, WithSimd};
use serde::{Deserialize, Serialize};

/// Settings of the optimiser.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OptimizerConfig {
    /// Decay of the gradient's running mean (Kingma and Ba, 2015).
    pub beta1: f32,
    /// Decay of the squared gradient's running mean.
    pub beta2: f32,
    /// Added to the root of the squared mean.
    pub epsilon: f32,
    /// Decoupled weight decay per unit of learning rate (Loshchilov and Hutter, 2019); 0 is plain Adam.
    pub weight_decay: f32,
    /// The gradient of the whole network is scaled down to this Euclidean norm when it is longer.
    pub clip_norm: f32,
    /// Decay of the weights' running average, per step; 0 is no averaging.
    pub average_decay: f32,
}

impl Default for OptimizerConfig {
    fn default() -> Self {
        Self { beta1: 0.9, beta2: 0.999, epsilon: 1e-8, weight_decay: 0.0, clip_norm: 1.0, average_decay: 0.0 }
    }
}

/// A contiguous part of the parameters with its optimiser state.
#[derive(Clone, Debug, PartialEq)]
pub struct Shard {
    /// The parameters.
    pub values: Vec<f32>,
    /// Running mean of the gradient.
    pub mean: Vec<f32>,
    /// Running mean of the squared gradient.
    pub square: Vec<f32>,
    /// Running average of the parameters.
    pub average: Vec<f32>,
}

impl Shard {
    /// A part with these starting values.
    #[must_use]
    pub fn new(values: &[f32]) -> Self {
        let zeros = vec![0.0; values.len()];
        Self { values: values.to_vec(), mean: zeros.clone(), square: zeros, average: values.to_vec() }
    }

    /// One step along `gradient * scale`; `step` counts from 1.
    pub fn update(&mut self, config: &OptimizerConfig, gradient: &[f32], scale: f32, learning_rate: f32, step: u64) {
        let count = i32::try_from(step).unwrap_or(i32::MAX);
        let first = f64::from(config.beta1).powi(count);
        let second = f64::from(config.beta2).powi(count);
        #[expect(clippy::cast_possible_truncation, reason = "the optimiser works in f32")]
        let (rate, unbias) = ((f64::from(learning_rate) / (1.0 - first)) as f32, (1.0 / (1.0 - second)) as f32);
        // Early on the average follows closely, so that it does not remember the starting values.
        #[expect(clippy::cast_precision_loss, reason = "a ratio of counts")]
        let average_decay = config.average_decay.min((1.0 + step as f32) / (10.0 + step as f32));
        let average_decay = if config.average_decay > 0.0 { average_decay } else { 0.0 };
        let decay = 1.0 - learning_rate * config.weight_decay;
        Arch::new().dispatch(Step { shard: self, config, gradient, scale, rate, unbias, average_decay, decay });
    }
}

/// One step over all parameters of a shard; a struct, so that it is compiled for the vector instructions it is dispatched to.
struct Step<'a> {
    shard: &'a mut Shard,
    config: &'a OptimizerConfig,
    gradient: &'a [f32],
    scale: f32,
    rate: f32,
    unbias: f32,
    average_decay: f32,
    decay: f32,
}

impl WithSimd for Step<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { shard, config, gradient, scale, rate, unbias, average_decay, decay } = self;
        let states = shard.mean.iter_mut().zip(shard.square.iter_mut());
        let values = shard.values.iter_mut().zip(shard.average.iter_mut());
        for ((gradient, (mean, square)), (value, average)) in gradient.iter().zip(states).zip(values) {
            let gradient = gradient * scale;
            *mean = config.beta1 * *mean + (1.0 - config.beta1) * gradient;
            *square = config.beta2 * *square + (1.0 - config.beta2) * gradient * gradient;
            *value = decay * *value - rate * *mean / ((*square * unbias).sqrt() + config.epsilon);
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
        let mut shard = Shard::new(&[1.0, 1.0, 1.0]);
        shard.update(&OptimizerConfig::default(), &[1e-3, -5.0, 0.2], 1.0, 0.01, 1);
        for (value, expected) in shard.values.iter().zip([0.99, 1.01, 0.99]) {
            assert!((value - expected).abs() < 1e-6, "{value} {expected}");
        }
    }

    #[test]
    fn a_quadratic_is_minimised_and_the_average_follows() {
        let config = OptimizerConfig { average_decay: 0.99, ..OptimizerConfig::default() };
        let mut shard = Shard::new(&[3.0, -2.0]);
        for step in 1..=3000 {
            let gradient: Vec<f32> = shard.values.iter().zip([1.0, 0.5]).map(|(value, target)| 2.0 * (value - target)).collect();
            shard.update(&config, &gradient, 1.0, 0.01, step);
        }
        for (value, target) in shard.values.iter().chain(&shard.average).zip([1.0, 0.5, 1.0, 0.5]) {
            assert!((value - target).abs() < 1e-3, "{value} {target}");
        }
    }

    #[test]
    fn decoupled_decay_shrinks_weights_that_get_no_gradient() {
        let config = OptimizerConfig { weight_decay: 0.1, ..OptimizerConfig::default() };
        let mut shard = Shard::new(&[2.0]);
        shard.update(&config, &[0.0], 1.0, 0.01, 1);
        assert!((shard.values[0] - 2.0 * (1.0 - 0.001)).abs() < 1e-6);
    }
}
