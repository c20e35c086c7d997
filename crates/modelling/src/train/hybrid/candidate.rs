//! A front end being identified, its weights, and the schema's form of it.

use model_export::schema::{self, FeatureSource};

use super::super::front_end::see;

/// Share of all weights that a stop operator must have to stay.
const CARRIES: f64 = 0.01;
/// Share of the operators' slope below which a force does not depend on where in the range it acts.
const NO_SPRING: f64 = 0.02;

/// What the bank is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Play,
    Stop,
}

/// An operator of the bank.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Operator {
    pub(super) threshold: f64,
    /// The input that it follows, counted from 0.
    pub(super) input: usize,
}

/// A front end being identified. Weights are counted in the direction in which the output rises; see [`Candidate::sign`].
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    pub(super) dead_time_samples: f64,
    /// Lag time constant in samples; 0 is none.
    pub(super) lag_samples: f64,
    pub(super) kind: Kind,
    /// Whether the output falls when an input rises, of each input.
    pub(super) falling: Vec<bool>,
    /// With ascending thresholds.
    pub(super) operators: Vec<Operator>,
    /// Creep coefficients, and the play weights that their sum is made with.
    pub(super) creep: Vec<f64>,
    pub(super) creep_sum: Vec<f64>,
    /// Segments of the curve that bends the sum; 0 is none.
    pub(super) segments: usize,
}

/// A candidate's weights and how well it does.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    pub(super) weights: Vec<f64>,
    /// Of each input.
    pub(super) input_weights: Vec<f64>,
    pub(super) creep_weights: Vec<f64>,
    pub(super) bias: f64,
    pub(super) curve: Option<schema::Curve>,
    /// Mean square error over the training samples.
    pub(super) in_sample: f64,
    /// Mean square error over the folds left out; not a number where nobody judges by it.
    pub(super) left_out: f64,
}

#[expect(clippy::cast_possible_truncation, reason = "the estimator works in f32")]
pub(super) fn narrow(value: f64) -> f32 {
    value as f32
}

/// Coefficient of a first-order lag of this time constant for steps of one sample (exact for a held input).
pub(super) fn coefficient(time_constant_samples: f64) -> f64 {
    if time_constant_samples > 0.0 { -(-1.0 / time_constant_samples).exp_m1() } else { 1.0 }
}

impl Candidate {
    /// What a weight of an input is multiplied by in the sum.
    pub(super) fn sign(&self, input: usize) -> f64 {
        if self.falling[input] { -1.0 } else { 1.0 }
    }

    /// Drops the stop operators that carry next to nothing. A force of friction has few; what a network does with the others on motions
    /// smaller than those it was trained on is guesswork.
    pub(super) fn keep_carrying(&mut self, fit: &Fit) {
        let total: f64 = fit.weights.iter().sum();
        let mut carries = fit.weights.iter().map(|weight| *weight > CARRIES * total);
        self.operators.retain(|_| carries.next().unwrap_or(true));
    }

    /// Drops the operators without weight, unless that is all of them; the creep filters follow the sum of the others.
    pub(super) fn drop_idle(&mut self, fit: &Fit) {
        let carrying = self.operators.iter().copied().zip(fit.weights.iter().copied()).filter(|(_, weight)| *weight > 0.0);
        let (operators, weights): (Vec<Operator>, Vec<f64>) = carrying.unzip();
        if !operators.is_empty() {
            (self.operators, self.creep_sum) = (operators, weights);
        }
    }

    /// The front end whose features are what the fit needs: paths, plays, creeps.
    pub(super) fn probe(&self) -> schema::FrontEnd {
        let mut front_end = self.bare();
        let paths = (0..self.falling.len()).map(|input| (FeatureSource::Path, input));
        let plays = (0..self.operators.len()).map(|index| (FeatureSource::Play(index_u8(index)), 0));
        let creeps = (0..self.creep.len()).map(|index| (FeatureSource::Creep(index_u8(index)), 0));
        see(&mut front_end, paths.chain(plays).chain(creeps));
        front_end
    }

    /// Path, thresholds and creep filters, with the play weights that the creep filters are fed by.
    fn bare(&self) -> schema::FrontEnd {
        let weight =
            |(index, operator): (usize, &Operator)| narrow(self.sign(operator.input) * self.creep_sum.get(index).copied().unwrap_or(0.0));
        let several = self.falling.len() > 1;
        schema::FrontEnd {
            dead_time_samples: narrow(self.dead_time_samples),
            lag_coefficient: narrow(coefficient(self.lag_samples)),
            play_thresholds: self.operators.iter().map(|operator| narrow(operator.threshold)).collect(),
            play_weights: self.operators.iter().enumerate().map(weight).collect(),
            play_inputs: self.operators.iter().filter(|_| several).map(|operator| index_u8(operator.input)).collect(),
            more_input_weights: self.falling.iter().skip(1).map(|_| 0.0).collect(),
            creep_coefficients: self.creep.iter().map(|value| narrow(*value)).collect(),
            creep_weights: self.creep.iter().map(|_| 0.0).collect(),
            ..schema::FrontEnd::default()
        }
    }
}

fn index_u8(index: usize) -> u8 {
    u8::try_from(index).unwrap_or(u8::MAX)
}

/// The front end with its weights, and everything that may help the network as features.
pub(super) fn assemble(candidate: &Candidate, fit: &Fit) -> schema::FrontEnd {
    let mut front_end = candidate.bare();
    let slopes: Vec<f64> = fit.weights.iter().zip(&candidate.operators).map(|(weight, operator)| weight / operator.threshold).collect();
    let slope: f64 = slopes.iter().sum();
    let mut input_weights = fit.input_weights.clone();
    let weights: Vec<f64> = match candidate.kind {
        Kind::Play => fit.weights.clone(),
        Kind::Stop => {
            input_weights[0] += slope;
            slopes.iter().map(|slope| -slope).collect()
        }
    };
    let signed = weights.iter().zip(&candidate.operators).map(|(weight, operator)| narrow(candidate.sign(operator.input) * weight));
    front_end.play_weights = signed.collect();
    let mut signed = input_weights.iter().enumerate().map(|(input, weight)| narrow(candidate.sign(input) * weight));
    front_end.input_weight = signed.next().unwrap_or(0.0);
    front_end.more_input_weights = signed.collect();
    // The creep filters were fitted behind `creep_sum`, which settled on these weights.
    front_end.creep_weights = fit.creep_weights.iter().map(|value| narrow(*value)).collect();
    front_end.bias = narrow(fit.bias);
    front_end.curve = fit.curve.clone();

    // A friction force without a spring beside it is the same anywhere in the range: then the network must not see where it is.
    let anywhere = candidate.kind == Kind::Stop && fit.input_weights[0].abs() < NO_SPRING * slope;
    let mut signals = Vec::new();
    for input in 0..candidate.falling.len() {
        signals.push((FeatureSource::InputDifference, input));
        if !anywhere {
            signals.push((FeatureSource::Input, input));
        }
        if candidate.dead_time_samples > 0.0 || candidate.lag_samples > 0.0 {
            signals.push((FeatureSource::PathDifference, input));
            if !anywhere {
                signals.push((FeatureSource::Path, input));
            }
        }
    }
    signals.extend((0..candidate.operators.len()).map(|index| (FeatureSource::Stop(index_u8(index)), 0)));
    signals.push((FeatureSource::Readout, 0));
    signals.extend((0..candidate.creep.len()).map(|index| (FeatureSource::Creep(index_u8(index)), 0)));
    see(&mut front_end, signals);
    front_end
}
