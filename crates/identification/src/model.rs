//! A fitted model: structure, constant and weights; run on inputs, and read from and written to a file by whoever owns files.

use serde::{Deserialize, Serialize};

use crate::{Structure, Weights};

/// A weighted sum of columns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinearModel {
    /// Constant, in the output's unit.
    pub constant: f64,
    /// One weight a column, in the output's unit.
    pub weights: Vec<f64>,
    /// The output is held between these, in its unit: well beyond the data, where nothing is known.
    pub limits: [f64; 2],
    /// What makes the columns.
    pub structure: Structure,
}

/// How far beyond the fitted output's range a model of free signs may go, as a share of that range: an input beyond the data may well
/// ask for more than was seen, but nothing is known about how much.
const BEYOND: f64 = 1.0;
/// The same where signs are bound: physics goes on. A limit is kept against inputs that are no pressures at all.
const BEYOND_BOUND: f64 = 100.0;

/// Largest magnitude of any number in a model, in whatever unit: what is larger was damaged.
const LARGEST: f64 = 1e15;
/// Columns and inputs at most, and samples of dead time.
const MOST_COLUMNS: usize = 100_000;
const MOST_INPUTS: usize = 64;
const MOST_DELAYED: f64 = 1e7;

/// Why a model cannot be run.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum ModelFault {
    /// A number of it is not finite or out of its domain.
    #[error("{0}")]
    Value(String),
}

impl LinearModel {
    /// From fitted weights; `origin` is what was taken off the output before the fit, `range` the smallest and largest fitted output,
    /// `bound` whether weights were bound in sign.
    #[must_use]
    pub fn new(structure: Structure, weights: &Weights, origin: f64, range: (f64, f64), bound: bool) -> Self {
        let beyond = if bound { BEYOND_BOUND } else { BEYOND } * (range.1 - range.0);
        let limits = [range.0 - beyond, range.1 + beyond];
        Self { constant: weights.constant + origin, weights: weights.columns.clone(), limits, structure }
    }

    /// The output for inputs of one length, free running from the equilibrium of the first sample; memory starts anew at every index in
    /// `gaps`.
    ///
    /// # Panics
    /// When there are fewer inputs than the model has; see [`Self::check`].
    #[must_use]
    pub fn simulate(&self, inputs: &[&[f64]], gaps: &[usize]) -> Vec<f64> {
        let mut output = vec![self.constant; inputs.first().map_or(0, |input| input.len())];
        self.structure.for_each_column(inputs, gaps, |index, values| {
            let weight = self.weights[index];
            if weight != 0.0 {
                output.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
            }
        });
        output.iter_mut().for_each(|value| *value = value.max(self.limits[0]).min(self.limits[1]));
        output
    }

    /// Number of inputs.
    #[must_use]
    pub fn inputs(&self) -> usize {
        self.structure.scalings.len()
    }

    /// Numbers that were fitted or chosen.
    #[must_use]
    pub fn parameters(&self) -> usize {
        let used = self.weights.iter().filter(|&&weight| weight != 0.0).count();
        let path = usize::from(self.structure.dead_time_s > 0.0) + usize::from(self.structure.lag_s > 0.0);
        1 + used + path + 2 * usize::from(self.structure.widening.is_some())
    }

    /// Multiplications of one step, about.
    #[must_use]
    pub fn multiplications(&self) -> usize {
        use crate::Basis;
        let one = |column: &crate::Column| {
            let basis = match &column.basis {
                Basis::Polynomial { degree, .. } => *degree,
                Basis::Play { .. } => 1 + usize::from(self.structure.widening.is_some()),
                Basis::Product { .. } | Basis::Ramp { .. } => 1,
                Basis::Oscillator { .. } => 5,
                Basis::Sigmoid { columns, .. } => columns.len() + 20,
            };
            1 + basis + column.lag.map_or(0, |lag| usize::from(lag.order))
        };
        let speed = if self.structure.widening.is_some() { 20 } else { 0 };
        self.structure.columns.iter().map(one).sum::<usize>() + (1 + speed) * self.inputs()
    }

    /// Checks everything that [`Self::simulate`] relies on.
    ///
    /// # Errors
    /// The first thing that is out of its domain, in words.
    pub fn check(&self) -> Result<(), ModelFault> {
        use crate::{Basis, OutputPath};
        let fault = |text: &str| Err(ModelFault::Value(text.to_owned()));
        let structure = &self.structure;
        if self.weights.len() != structure.columns.len() {
            return fault("there is not one weight for each column");
        }
        if structure.columns.len() > MOST_COLUMNS || structure.scalings.len() > MOST_INPUTS {
            return fault("there are more columns or inputs than any fit makes");
        }
        let sane = |value: f64| value.abs() <= LARGEST;
        if !sane(self.constant) || !self.weights.iter().all(|&weight| sane(weight)) {
            return fault("a weight or the constant is not a number that a fit makes");
        }
        if !(self.limits[0] <= self.limits[1] && self.limits.iter().all(|&limit| sane(limit))) {
            return fault("the limits of the output are not two ascending numbers");
        }
        let time = |value: f64| (0.0..=1e9).contains(&value);
        if !(structure.sample_period_s > 0.0 && time(structure.sample_period_s)) {
            return fault("sample_period_s must be positive");
        }
        if !time(structure.dead_time_s) || !time(structure.lag_s) {
            return fault("dead_time_s and lag_s must be zero or positive");
        }
        if structure.dead_time_s > MOST_DELAYED * structure.sample_period_s {
            return fault("dead_time_s is longer than any recording");
        }
        if structure.scalings.is_empty()
            || structure.scalings.iter().any(|one| !(one.half > 1.0 / LARGEST && sane(one.half) && sane(one.centre)))
        {
            return fault("every input needs a centre and a positive half range");
        }
        if structure.rest.as_ref().is_some_and(|rest| rest.len() != self.inputs() || !rest.iter().all(|&value| sane(value))) {
            return fault("rest needs one finite value for each input");
        }
        if structure.widening.is_some_and(|widening| !(widening.speed > 1.0 / LARGEST && sane(widening.speed) && sane(widening.gain))) {
            return fault("the widening needs a positive speed and a gain");
        }
        match structure.output_path {
            OutputPath::Direct => {}
            OutputPath::Lag { time_constant_s } if time(time_constant_s) => {}
            OutputPath::Oscillator { frequency_hz, damping }
                if frequency_hz > 0.0 && frequency_hz.is_finite() && damping > 0.0 && damping.is_finite() => {}
            _ => return fault("the output path needs a positive time constant, or frequency and damping"),
        }
        for (index, column) in structure.columns.iter().enumerate() {
            let known = |input: usize| input < self.inputs();
            let good = match &column.basis {
                Basis::Polynomial { input, degree } => known(*input) && (1..=20).contains(degree),
                Basis::Ramp { input, from, to } => known(*input) && sane(*from) && sane(*to) && from < to,
                Basis::Play { input, threshold } => known(*input) && (0.0..=LARGEST).contains(threshold),
                Basis::Product { first, second } => known(*first) && known(*second),
                Basis::Oscillator { input, frequency_hz, damping, .. } => {
                    let positive = |value: f64| value > 0.0 && value.is_finite();
                    known(*input) && positive(*frequency_hz) && positive(*damping)
                }
                Basis::Sigmoid { columns, gains, bias } => {
                    columns.len() == gains.len()
                        && columns.iter().all(|&other| other < index)
                        && gains.iter().chain([bias]).all(|&value| sane(value))
                }
            };
            let lagged = column.lag.is_none_or(|lag| time(lag.time_constant_s) && lag.order <= 8);
            if !good || !lagged {
                return Err(ModelFault::Value(format!("column {index} is out of its domain")));
            }
        }
        Ok(())
    }

    /// Without columns that weigh nothing and that nobody looks at.
    #[must_use]
    pub fn pruned(mut self) -> Self {
        use crate::Basis;
        let count = self.structure.columns.len();
        let mut needed: Vec<bool> = self.weights.iter().map(|&weight| weight != 0.0).collect();
        for index in (0..count).rev() {
            if let (true, Basis::Sigmoid { columns, .. }) = (needed[index], &self.structure.columns[index].basis) {
                columns.iter().for_each(|&column| needed[column] = true);
            }
        }
        let place: Vec<usize> = needed.iter().scan(0, |next, &kept| Some(std::mem::replace(next, *next + usize::from(kept)))).collect();
        let mut kept = needed.iter();
        self.structure.columns.retain(|_| *kept.next().unwrap_or(&false));
        for column in &mut self.structure.columns {
            if let Basis::Sigmoid { columns, .. } = &mut column.basis {
                columns.iter_mut().for_each(|column| *column = place[*column]);
            }
        }
        let mut kept = needed.iter();
        self.weights.retain(|_| *kept.next().unwrap_or(&false));
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Basis, Column, Lag, OutputPath, Scaling, Widening};

    fn model() -> LinearModel {
        LinearModel {
            constant: 0.1,
            weights: vec![1.0],
            limits: [-2.0, 2.0],
            structure: Structure {
                sample_period_s: 0.01,
                dead_time_s: 0.0,
                lag_s: 0.0,
                scalings: vec![Scaling { centre: 0.0, half: 1.0 }],
                rest: None,
                widening: None,
                output_path: OutputPath::Direct,
                columns: vec![Column { basis: Basis::Play { input: 0, threshold: 0.1 }, lag: None }],
            },
        }
    }

    #[test]
    fn damaged_numbers_are_refused() {
        assert_eq!(model().check(), Ok(()));
        let damages: [fn(&mut LinearModel); 14] = [
            |model| model.constant = 1e300,
            |model| model.weights[0] = f64::NAN,
            |model| model.weights[0] = -1e300,
            |model| model.limits = [f64::NAN, 1.0],
            |model| model.limits = [-1e300, 1e300],
            |model| model.structure.lag_s = -0.1,
            |model| model.structure.dead_time_s = 1e8,
            |model| model.structure.widening = Some(Widening { speed: 0.0, gain: 1.0 }),
            |model| model.structure.widening = Some(Widening { speed: 1.0, gain: f64::NAN }),
            |model| model.structure.scalings[0].half = 1e-300,
            |model| model.structure.scalings[0].centre = f64::INFINITY,
            |model| model.structure.columns[0].basis = Basis::Play { input: 0, threshold: 1e300 },
            |model| model.structure.columns[0].lag = Some(Lag { time_constant_s: -1.0, order: 1 }),
            |model| model.structure.columns[0].basis = Basis::Polynomial { input: 0, degree: usize::MAX },
        ];
        for (number, damage) in damages.iter().enumerate() {
            let mut damaged = model();
            damage(&mut damaged);
            assert!(damaged.check().is_err(), "damage {number}");
        }
    }
}
