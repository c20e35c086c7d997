//! Further stages of a physics model: what the supply, the valve, the line, the muscle and the tip do beside hysteresis.

use model_export::schema;
use serde::{Deserialize, Serialize};

use super::input_path::coefficient;
use super::points::Points;

/// A flow that what is missing drives, at the model's sample period: a lag is a straight line, a limit of the rate a flat end, an orifice a
/// power law. Both curves count sizes, in input units, and begin at zero.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Flow {
    /// By how much the signal rises in a sample, of what is missing.
    pub fill: Points,
    /// By how much it falls, of what is too much.
    pub vent: Points,
}

/// A second-order filter with a gain of one at rest, at the model's sample period; the equation is that of [`schema::Filter`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Filter {
    /// Share of the last step that goes on.
    pub momentum: f64,
    /// Gains of this sample and of the two before.
    pub gains: [f64; 3],
}

/// How thresholds of the play operators hang on where the path is and how fast it goes; the equations are those of [`schema::Growth`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ThresholdGrowth {
    /// Growth per input unit, of the rising branch and of the falling one.
    pub per_input: [f64; 2],
    /// By how much branches part, in input units: with the path, its square and its cube in input units.
    pub apart: [f64; 3],
    /// What growth goes with, dimensionless, at a size of the path's step in input units a sample; without it nothing grows with the rate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub law: Option<Points>,
    /// Share of themselves that thresholds grow by, times the law.
    #[serde(default)]
    pub share: f64,
    /// What they grow by in input units, times the law.
    #[serde(default)]
    pub extra: f64,
    /// Time constant with which the size of step is forgotten, s; 0 is at once.
    #[serde(default)]
    pub fading_time_s: f64,
    /// How far operators go towards their bounds in a sample, of the distance in input units; without it all the way.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub follow: Option<Points>,
}

/// The stages in the order of the signal. Everything counts from the rest input.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stages {
    /// What the supply gives of the command, in input units.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub supply: Option<Points>,
    /// How fast the valve goes, and how the muscle fills and vents.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flow: Option<Flow>,
    /// What swings in the line.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub line: Option<Filter>,
    /// What the muscle makes of its pressure, in input units.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub muscle: Option<Points>,
    /// How the thresholds change.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub growth: Option<ThresholdGrowth>,
    /// What swings or lags behind the operators.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tip: Option<Filter>,
}

impl Filter {
    /// The filter that answers a signal as `answer` does, where that is one of the second order or less with a gain of one at rest.
    #[must_use]
    pub fn of(answer: impl Fn(&[f64]) -> Vec<f64>) -> Option<Self> {
        /// Samples of the answer that are looked at, and what counts as the same.
        const LENGTH: usize = 400;
        const SAME: f64 = 1e-7;
        let mut impulse = vec![0.0; LENGTH];
        impulse[1] = 1.0;
        let wanted = answer(&impulse);
        let h = &wanted[1..];
        // From the third sample behind the impulse on, h(k) = a1 h(k-1) + a2 h(k-2): least squares.
        let sums = |shift: usize, other: usize| (3..h.len()).map(|at| h[at - shift] * h[at - other]).sum::<f64>();
        let (one, both, two, by_one, by_two) = (sums(1, 1), sums(1, 2), sums(2, 2), sums(0, 1), sums(0, 2));
        let determinant = one * two - both * both;
        let (a1, a2) = if determinant > 1e-9 * one * two {
            ((by_one * two - by_two * both) / determinant, (by_two * one - by_one * both) / determinant)
        } else {
            (if one > 0.0 { by_one / one } else { 0.0 }, 0.0)
        };
        let gains = [h[0], h[1] - a1 * h[0], h[2] - a1 * h[1] - a2 * h[0]];
        let filter = Self { momentum: -a2, gains };
        let found = filter.run(&impulse);
        let is_same = found.iter().zip(&wanted).all(|(found, wanted)| (found - wanted).abs() < SAME);
        (is_same && filter.as_wire().validate().is_ok()).then_some(filter)
    }

    /// Sends a signal through; it begins at rest.
    #[must_use]
    pub fn run(&self, signal: &[f64]) -> Vec<f64> {
        let Some(&first) = signal.first() else { return Vec::new() };
        let (mut outputs, mut inputs) = ([first; 2], [first; 2]);
        let [now, at_last, at_before] = self.gains;
        signal
            .iter()
            .map(|&input| {
                let [last, before] = outputs;
                let moved =
                    self.momentum * (last - before) + now * (input - last) + at_last * (inputs[0] - last) + at_before * (inputs[1] - last);
                outputs = [last + moved, last];
                inputs = [input, inputs[0]];
                outputs[0]
            })
            .collect()
    }

    #[expect(clippy::cast_possible_truncation, reason = "the estimator works in f32")]
    fn as_wire(&self) -> schema::Filter {
        schema::Filter { momentum: self.momentum as f32, gains: self.gains.map(|gain| gain as f32) }
    }
}

impl Flow {
    /// Leads a state along a signal from where that begins.
    #[must_use]
    pub fn run(&self, signal: &[f64]) -> Vec<f64> {
        let mut state = signal.first().copied().unwrap_or_default();
        let step = |&target: &f64| {
            state = towards(&self.fill, &self.vent, state, target);
            state
        };
        signal.iter().map(step).collect()
    }
}

/// A value on its way to a target, by a curve of the distance for each direction; never beyond.
fn towards(up: &Points, down: &Points, from: f64, target: f64) -> f64 {
    let distance = (target - from).abs();
    let curve = if target > from { up } else { down };
    from + curve.at(distance).clamp(0.0, distance) * (target - from).signum()
}

impl ThresholdGrowth {
    /// The gaps of an operator to its rising and its falling branch.
    fn gaps(&self, threshold: f64, path: f64, law: f64) -> [f64; 2] {
        let [linear, square, cube] = self.apart;
        let extra = self.extra * law + path * (linear + path * (square + path * cube));
        self.per_input.map(|growth| (((1.0 + growth * path).max(0.0) + self.share * law) * threshold + extra).max(0.0))
    }

    /// The weighted sum of play operators along a path from rest.
    #[must_use]
    pub fn sums(&self, path: &[f64], operators: &[(f64, f64)], sample_period_s: f64) -> Vec<f64> {
        let fading = coefficient(sample_period_s, self.fading_time_s);
        let mut plays = vec![0.0; operators.len()];
        let (mut last, mut size) = (None, 0.0);
        path.iter()
            .map(|&value| {
                let step = last.map_or(0.0, |last: f64| (value - last).abs());
                size = if last.is_some() { size + fading * (step - size) } else { 0.0 };
                let law = self.law.as_ref().map_or(0.0, |law| law.at(size));
                let follow = self.follow.as_ref().filter(|_| last.is_some());
                last = Some(value);
                let play = |(play, &(threshold, weight)): (&mut f64, &(f64, f64))| {
                    let [rising, falling] = self.gaps(threshold, value, law);
                    let bound = (value - rising).max((value + falling).min(*play));
                    *play = follow.map_or(bound, |follow| towards(follow, follow, *play, bound));
                    weight * *play
                };
                plays.iter_mut().zip(operators).map(play).sum()
            })
            .collect()
    }
}

impl Stages {
    /// Whether no stage does anything.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Whether what they do hangs on how fast the input goes.
    #[must_use]
    pub fn depend_on_rate(&self) -> bool {
        let by_rate = |growth: &ThresholdGrowth| growth.law.is_some() || growth.follow.is_some();
        self.flow.is_some() || self.line.is_some() || self.tip.is_some() || self.growth.as_ref().is_some_and(by_rate)
    }

    /// Numbers in them.
    #[must_use]
    pub fn parameters(&self) -> usize {
        let growth = |growth: &ThresholdGrowth| {
            let single = [growth.share, growth.extra, growth.fading_time_s];
            single.iter().chain(&growth.per_input).chain(&growth.apart).filter(|value| **value != 0.0).count()
        };
        let filters = 4 * [self.line, self.tip].iter().flatten().count();
        self.curves().map(|curve| 2 * curve.from.len()).sum::<usize>() + filters + self.growth.as_ref().map_or(0, growth)
    }

    fn curves(&self) -> impl Iterator<Item = &Points> {
        let flow = self.flow.iter().flat_map(|flow| [&flow.fill, &flow.vent]);
        let of_operators = self.growth.iter().flat_map(|growth| growth.law.iter().chain(&growth.follow));
        self.supply.iter().chain(&self.muscle).chain(flow).chain(of_operators)
    }

    /// The path that the operators follow, for the input behind the dead time, both from the rest input.
    #[must_use]
    pub fn lead(&self, delayed: &[f64]) -> Vec<f64> {
        let mut path = delayed.to_vec();
        if let Some(supply) = &self.supply {
            path.iter_mut().for_each(|value| *value = supply.at(*value));
        }
        if let Some(flow) = &self.flow {
            path = flow.run(&path);
        }
        if let Some(line) = &self.line {
            path = line.run(&path);
        }
        if let Some(muscle) = &self.muscle {
            path.iter_mut().for_each(|value| *value = muscle.at(*value));
        }
        path
    }

    /// In the blob's form, for an input divided by `input_scale`; otherwise which stage has no room there.
    ///
    /// # Errors
    /// With the stage's name.
    #[expect(clippy::cast_possible_truncation, reason = "the estimator works in f32")]
    pub fn as_wire(&self, sample_period_s: f64, input_scale: f64) -> Result<schema::Stages, &'static str> {
        let curve = |points: &Option<Points>, stage: &'static str| {
            points.as_ref().map(|points| points.dead_zones(input_scale, input_scale).ok_or(stage)).transpose()
        };
        let of_sizes = |points: &Points| points.dead_zones(input_scale, input_scale);
        let growth = |growth: &ThresholdGrowth| -> Result<schema::Growth, &'static str> {
            let [linear, square, cube] = growth.apart;
            let law = growth.law.as_ref().map(|law| law.dead_zones(input_scale, 1.0).ok_or("growth")).transpose()?;
            Ok(schema::Growth {
                per_path: growth.per_input.map(|per_input| (per_input * input_scale) as f32),
                apart: [linear as f32, (square * input_scale) as f32, (cube * input_scale * input_scale) as f32],
                law: law.unwrap_or_default(),
                share: growth.share as f32,
                extra: (growth.extra / input_scale) as f32,
                fading: coefficient(sample_period_s, growth.fading_time_s) as f32,
                follow: growth.follow.as_ref().map(|follow| of_sizes(follow).ok_or("growth")).transpose()?,
            })
        };
        let flow = |flow: &Flow| {
            Ok::<_, &'static str>(schema::Flow { fill: of_sizes(&flow.fill).ok_or("flow")?, vent: of_sizes(&flow.vent).ok_or("flow")? })
        };
        Ok(schema::Stages {
            supply: curve(&self.supply, "supply")?,
            flow: self.flow.as_ref().map(flow).transpose()?,
            line: self.line.map(|line| line.as_wire()),
            muscle: curve(&self.muscle, "muscle")?,
            growth: self.growth.as_ref().map(growth).transpose()?,
            tip: self.tip.map(|tip| tip.as_wire()),
        })
    }

    /// What contradicts itself in the values, if anything.
    pub(super) fn problem(&self) -> Option<String> {
        let growth = self.growth.as_ref();
        if let Some(problem) = self.curves().filter_map(Points::problem).next() {
            return Some(problem.to_owned());
        }
        if [self.line, self.tip].into_iter().flatten().any(|filter| filter.as_wire().validate().is_err()) {
            return Some("a filter of the line or the tip does not settle".to_owned());
        }
        let finite = growth.map(|growth| {
            let single = [growth.share, growth.extra, growth.fading_time_s];
            growth.per_input.iter().chain(&growth.apart).chain(&single).all(|value| value.is_finite()) && growth.fading_time_s >= 0.0
        });
        (finite == Some(false)).then(|| "the growth of thresholds needs finite numbers and times that are not negative".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_filter_is_found_from_its_answer() {
        for wanted in [
            Filter { momentum: 0.9, gains: [0.02, 0.03, 0.01] },
            Filter { momentum: 0.0, gains: [0.3, 0.1, 0.0] },
            Filter { momentum: 0.25, gains: [0.05, 0.1, 0.1] },
        ] {
            let found = Filter::of(|signal| wanted.run(signal)).expect("a filter");
            let pairs = [(found.momentum, wanted.momentum)].into_iter().chain(found.gains.into_iter().zip(wanted.gains));
            pairs.for_each(|(found, wanted)| assert!((found - wanted).abs() < 1e-6, "{found} and {wanted}"));
        }
        let curved = |signal: &[f64]| signal.iter().enumerate().map(|(at, value)| value + 0.1 * (at as f64).sin()).collect();
        assert_eq!(Filter::of(curved), None);
    }
}
