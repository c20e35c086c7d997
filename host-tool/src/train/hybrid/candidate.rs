//! A front end being identified, and the schema's form of it.

use model_export::schema::{self, Feature, FeatureSource};

use super::weights::Fit;

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

/// A front end being identified.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    pub(super) dead_time_samples: f64,
    /// Lag time constant in samples; 0 is none.
    pub(super) lag_samples: f64,
    pub(super) kind: Kind,
    pub(super) thresholds: Vec<f64>,
    /// Creep coefficients, and the play weights that their sum is made with.
    pub(super) creep: Vec<f64>,
    pub(super) creep_sum: Vec<f64>,
    /// Segments of the curve that bends the sum; 0 is none.
    pub(super) segments: usize,
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
    /// Drops the stop operators that carry next to nothing. A force of friction has few; what a network does with the others on motions
    /// smaller than those it was trained on is guesswork.
    pub(super) fn keep_carrying(&mut self, fit: &Fit) {
        let total: f64 = fit.weights.iter().sum();
        let mut carries = fit.weights.iter().map(|weight| *weight > CARRIES * total);
        self.thresholds.retain(|_| carries.next().unwrap_or(true));
    }

    /// Drops the operators without weight, unless that is all of them; the creep filters follow the sum of the others.
    pub(super) fn drop_idle(&mut self, fit: &Fit) {
        let carrying = self.thresholds.iter().copied().zip(fit.weights.iter().copied()).filter(|(_, weight)| *weight > 0.0);
        let (thresholds, weights): (Vec<f64>, Vec<f64>) = carrying.unzip();
        if !thresholds.is_empty() {
            (self.thresholds, self.creep_sum) = (thresholds, weights);
        }
    }

    /// The front end whose features are what the fit needs: path, plays, creeps.
    pub(super) fn probe(&self) -> schema::FrontEnd {
        let mut front_end = self.bare();
        let plain = |source| Feature { source, offset: 0.0, gain: 1.0 };
        let _ = front_end.features.push(plain(FeatureSource::Path));
        for index in 0..self.thresholds.len() {
            let _ = front_end.features.push(plain(FeatureSource::Play(index_u8(index))));
        }
        for index in 0..self.creep.len() {
            let _ = front_end.features.push(plain(FeatureSource::Creep(index_u8(index))));
        }
        front_end
    }

    /// Path, thresholds and creep filters, with the play weights that the creep filters are fed by.
    fn bare(&self) -> schema::FrontEnd {
        let weight = |index: usize| self.creep_sum.get(index).copied().unwrap_or(0.0);
        schema::FrontEnd {
            dead_time_samples: narrow(self.dead_time_samples),
            lag_coefficient: narrow(coefficient(self.lag_samples)),
            play_thresholds: self.thresholds.iter().map(|value| narrow(*value)).collect(),
            play_weights: (0..self.thresholds.len()).map(|index| narrow(weight(index))).collect(),
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
    let (weights, input_weight): (Vec<f64>, f64) = match candidate.kind {
        Kind::Play => (fit.weights.clone(), fit.input_weight),
        Kind::Stop => {
            let slopes: Vec<f64> = fit.weights.iter().zip(&candidate.thresholds).map(|(weight, threshold)| weight / threshold).collect();
            (slopes.iter().map(|slope| -slope).collect(), fit.input_weight + slopes.iter().sum::<f64>())
        }
    };
    front_end.play_weights = weights.iter().map(|value| narrow(*value)).collect();
    front_end.input_weight = narrow(input_weight);
    // The creep filters were fitted behind `creep_sum`, which settled on these weights.
    front_end.creep_weights = fit.creep_weights.iter().map(|value| narrow(*value)).collect();
    front_end.bias = narrow(fit.bias);
    front_end.curve = fit.curve.clone();

    // A friction force without a spring beside it is the same anywhere in the range: then the network must not see where it is.
    let slope: f64 = fit.weights.iter().zip(&candidate.thresholds).map(|(weight, threshold)| weight / threshold).sum();
    let anywhere = candidate.kind == Kind::Stop && fit.input_weight.abs() < NO_SPRING * slope;
    let mut sources = vec![FeatureSource::InputDifference];
    if !anywhere {
        sources.push(FeatureSource::Input);
    }
    if candidate.dead_time_samples > 0.0 || candidate.lag_samples > 0.0 {
        sources.push(FeatureSource::PathDifference);
        if !anywhere {
            sources.push(FeatureSource::Path);
        }
    }
    sources.extend((0..candidate.thresholds.len()).map(|index| FeatureSource::Stop(index_u8(index))));
    sources.push(FeatureSource::Readout);
    sources.extend((0..candidate.creep.len()).map(|index| FeatureSource::Creep(index_u8(index))));
    // Offset and gain are set from the data afterwards.
    front_end.features = sources.into_iter().map(|source| Feature { source, offset: 0.0, gain: 1.0 }).collect();
    front_end
}
