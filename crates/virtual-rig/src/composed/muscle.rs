//! The muscle of the composed rig.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::draw::{STEP_S, ThresholdLaw};

/// The bank of play operators.
pub(super) struct Muscle {
    pub(super) thresholds_bar: Vec<f64>,
    pub(super) weights_mm_per_bar: Vec<f64>,
    pub(super) states: Vec<f64>,
    pub(super) law: ThresholdLaw,
    pub(super) carries: bool,
    pub(super) last: f64,
    pub(super) rate: f64,
    pub(super) span_bar: f64,
}

impl Muscle {
    pub(super) fn draw(generator: &mut ChaCha8Rng, span_bar: f64) -> Self {
        let count = generator.random_range(8..80);
        let widest = span_bar * generator.random_range(0.25..0.5);
        // Exponential, even or heaped around one threshold.
        let shape = generator.random_range(0..3);
        let heap = generator.random_range(0.2..0.8);
        let thresholds_bar: Vec<f64> = (0..count).map(|index| widest * f64::from(index) / f64::from(count)).collect();
        let mut weights: Vec<f64> = thresholds_bar
            .iter()
            .map(|threshold| {
                let share = threshold / widest;
                match shape {
                    0 => (-2.0 * share).exp(),
                    1 => generator.random_range(0.5..1.5),
                    _ => (-((share - heap) / 0.15).powi(2)).exp() + 0.05,
                }
            })
            .collect();
        let elastic = generator.random_range(0.3..0.6);
        let sum: f64 = weights[1..].iter().sum();
        let gain = generator.random_range(1.0..6.0);
        weights[1..].iter_mut().for_each(|weight| *weight *= gain * (1.0 - elastic) / sum);
        weights[0] = gain * elastic;
        let states = vec![0.0; weights.len()];
        let carries = generator.random_bool(0.4);
        Self { thresholds_bar, weights_mm_per_bar: weights, states, law: ThresholdLaw::default(), carries, last: 0.0, rate: 0.0, span_bar }
    }

    pub(super) fn begin(&mut self) {
        if !self.carries {
            self.states.fill(0.0);
        }
        (self.last, self.rate) = (0.0, 0.0);
    }

    pub(super) fn step(&mut self, input: f64) -> f64 {
        let law = self.law;
        self.rate += 0.05 * ((input - self.last).abs() / STEP_S - self.rate);
        self.last = input;
        let share = (input / self.span_bar).clamp(0.0, 1.2);
        let [up, down] = match (law.powers, law.saturations) {
            (Some(powers), _) => powers.map(|power| self.span_bar * share.powf(power)),
            (None, Some(bends)) => bends.map(|bend| self.span_bar * (bend * share).tanh() / bend.tanh()),
            (None, None) => [input; 2],
        };
        let faster = law.logarithmic_rate * self.rate.ln_1p() + law.root_of_rate * self.rate.sqrt() + law.linear_rate * self.rate;
        let wider = 1.0 + law.taper * share + faster;
        let mut sum = 0.0;
        for ((threshold, weight), state) in self.thresholds_bar.iter().zip(&self.weights_mm_per_bar).zip(&mut self.states) {
            let gap = threshold * wider;
            let aim = (up - gap).max((down + gap).min(*state));
            *state += (aim - *state) * if law.sliding_s > 0.0 && *threshold > 0.0 { STEP_S / (STEP_S + law.sliding_s) } else { 1.0 };
            sum += weight * *state;
        }
        sum
    }
}
