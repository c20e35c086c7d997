//! The parameters of a model's effects on one line, and in the units in which a search moves them.

use crate::chain::form::Parameter;
use crate::model::structure::{Model, Slot};

/// A parameter as the search sees it.
#[derive(Clone, Copy)]
pub struct Axis {
    /// The parameter.
    pub parameter: Parameter,
    /// First step: a unit of the search.
    pub step: f64,
}

/// Parameters of all effects on one line.
pub fn axes(model: &Model) -> Vec<Axis> {
    let of = |slot: &Slot| {
        let form = slot.form;
        form.parameters().iter().enumerate().map(|(index, &parameter)| Axis { parameter, step: form.step(index) })
    };
    model.slots.iter().flat_map(of).collect()
}

/// Values in units of the search: first steps, in the logarithm or in quarters of the range.
pub fn inward(axes: &[Axis], values: &[f64]) -> Vec<f64> {
    axes.iter()
        .zip(values)
        .map(
            |(Axis { parameter, step }, &value)| {
                if parameter.logarithmic { value.ln() / step } else { value / (parameter.high - parameter.low) * 4.0 / step }
            },
        )
        .collect()
}

/// The values of a point, within their limits.
pub fn outward(axes: &[Axis], values: &[f64]) -> Vec<f64> {
    axes.iter()
        .zip(values)
        .map(|(Axis { parameter, step }, &value)| {
            let value = if parameter.logarithmic { (value * step).exp() } else { value * step / 4.0 * (parameter.high - parameter.low) };
            value.clamp(parameter.low, parameter.high)
        })
        .collect()
}

/// Puts parameters on one line into the model's effects.
pub fn place(model: &mut Model, values: &[f64]) {
    let mut at = 0;
    for slot in &mut model.slots {
        let count = slot.parameters.len();
        slot.parameters.copy_from_slice(&values[at..at + count]);
        at += count;
    }
}

/// Some parameters of a model in units of the search.
#[derive(Clone)]
pub struct Line {
    axes: Vec<Axis>,
    indices: Vec<usize>,
    /// All parameters as they were.
    values: Vec<f64>,
}

impl Line {
    /// The parameters at `indices` on the line of all parameters.
    pub fn of(model: &Model, indices: &[usize]) -> Self {
        let all = axes(model);
        let values = model.slots.iter().flat_map(|slot| slot.parameters.iter().copied()).collect();
        Self { axes: indices.iter().map(|&index| all[index]).collect(), indices: indices.to_vec(), values }
    }

    /// Where they are.
    pub fn begin(&self) -> Vec<f64> {
        inward(&self.axes, &self.indices.iter().map(|&index| self.values[index]).collect::<Vec<_>>())
    }

    /// Gives a model the parameters of a point.
    pub fn put(&self, model: &mut Model, point: &[f64]) {
        let mut values = self.values.clone();
        for (&index, value) in self.indices.iter().zip(outward(&self.axes, point)) {
            values[index] = value;
        }
        place(model, &values);
    }

    /// Whether a coordinate lies beyond the upper limit of its parameter.
    pub fn is_at_upper_limit(&self, axis: usize, coordinate: f64) -> bool {
        let limit = self.axes[axis].parameter.high;
        inward(&self.axes[axis..=axis], &[limit])[0] < coordinate
    }
}
