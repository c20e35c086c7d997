//! The objective of a search, the simplex of Nelder and Mead in scaled coordinates, and the top of a grid along its axes.

use crate::model::line::Line;
use crate::model::structure::{Model, Scope};
use crate::model::workspace::Workspace;

/// What a parameter must bring, as a share of the mean square, when effects compete.
pub const PENALTY: f64 = 0.012;

/// What competing models are ordered by, the better the less: the logarithm of the mean square that remains and the price of the parameters.
pub fn penalised(model: &Model, select: f64) -> f64 {
    select.max(1e-30).ln() + PENALTY * model.cost() as f64
}

/// A fitted candidate.
#[derive(Clone)]
pub struct Fitted {
    /// The model with the candidate.
    pub model: Model,
    /// Mean square of the selecting samples.
    pub select: f64,
}

impl Fitted {
    /// What competing models are ordered by.
    pub fn penalised(&self) -> f64 {
        penalised(&self.model, self.select)
    }
}

/// Mean square of the fitted samples with the weights solved for and the model's own output as it is.
pub(crate) fn objective(model: &Model, workspace: &mut Workspace<'_>, scope: Scope) -> f64 {
    let sums = workspace.sums(model, scope);
    let weights = sums.fit.solve(&sums.free, &model.weights());
    sums.fit.mean_square(&weights)
}

/// How long a search goes on.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Samples that it looks at.
    pub scope: Scope,
    /// Length of the first steps, in those of the forms.
    pub size: f64,
    /// Most evaluations.
    pub evaluations: usize,
    /// Relative difference of the mean squares at which the corners count as equal.
    pub spread: f64,
}

/// Improves the parameters at `indices` (on the line of all parameters) from where they are.
pub fn simplex(model: &mut Model, workspace: &mut Workspace<'_>, indices: &[usize], effort: Effort) -> f64 {
    let Effort { scope, size, evaluations, spread: enough } = effort;
    if indices.is_empty() {
        return objective(model, workspace, scope);
    }
    let line = Line::of(model, indices);
    let begin = line.begin();
    let mut trial = model.clone();
    let mut spent = 0;
    let mut evaluate = |point: &[f64], spent: &mut usize| {
        *spent += 1;
        line.put(&mut trial, point);
        objective(&trial, workspace, scope)
    };
    let n = begin.len();
    let mut points: Vec<(f64, Vec<f64>)> = vec![(evaluate(&begin, &mut spent), begin.clone())];
    for axis in 0..n {
        let mut point = begin.clone();
        point[axis] += size;
        points.push((evaluate(&point, &mut spent), point));
    }
    while spent < evaluations {
        points.sort_by(|x, y| x.0.total_cmp(&y.0));
        let spread = (points[n].0 - points[0].0) / points[0].0.max(1e-30);
        let width = (0..n).map(|axis| (points[n].1[axis] - points[0].1[axis]).abs()).fold(0.0, f64::max);
        if spread < enough || width < 1e-3 {
            break;
        }
        let centre: Vec<f64> = (0..n).map(|axis| points[..n].iter().map(|point| point.1[axis]).sum::<f64>() / n as f64).collect();
        let along = |factor: f64| -> Vec<f64> { (0..n).map(|axis| centre[axis] + factor * (points[n].1[axis] - centre[axis])).collect() };
        let reflected = along(-1.0);
        let value = evaluate(&reflected, &mut spent);
        if value < points[0].0 {
            let expanded = along(-2.0);
            let further = evaluate(&expanded, &mut spent);
            points[n] = if further < value { (further, expanded) } else { (value, reflected) };
        } else if value < points[n - 1].0 {
            points[n] = (value, reflected);
        } else {
            let contracted = if value < points[n].0 { along(-0.5) } else { along(0.5) };
            let nearer = evaluate(&contracted, &mut spent);
            if nearer < points[n].0.min(value) {
                points[n] = (nearer, contracted);
            } else {
                let best = points[0].1.clone();
                for point in &mut points[1..] {
                    for (coordinate, best) in point.1.iter_mut().zip(&best) {
                        *coordinate = best + 0.5 * (*coordinate - best);
                    }
                    point.0 = evaluate(&point.1, &mut spent);
                }
            }
        }
    }
    points.sort_by(|x, y| x.0.total_cmp(&y.0));
    line.put(model, &points[0].1);
    points[0].0
}

/// Indices of the parameters of slot `slot` on the line of all parameters.
pub(crate) fn indices_of(model: &Model, slot: usize) -> Vec<usize> {
    let before: usize = model.slots[..slot].iter().map(|slot| slot.parameters.len()).sum();
    (before..before + model.slots[slot].parameters.len()).collect()
}

/// The point of a grid that `value` is greatest for, along one axis after the other until none leads any higher, from the first value of each.
pub fn most_along<const N: usize>(axes: [&[f64]; N], value: impl Fn(&[f64; N]) -> f64) -> [f64; N] {
    let mut best = axes.map(|axis| axis[0]);
    let mut greatest = value(&best);
    // Axes since the last that led higher.
    let mut idle = 0;
    for (axis, values) in axes.iter().enumerate().cycle() {
        let before = best[axis];
        for &other in values.iter().filter(|other| **other != before) {
            let there = std::array::from_fn(|at| if at == axis { other } else { best[at] });
            let valued = value(&there);
            if valued > greatest {
                (greatest, best) = (valued, there);
            }
        }
        idle = if best[axis] == before { idle + 1 } else { 1 };
        if idle >= N {
            break;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::most_along;

    #[test]
    fn axis_by_axis_leads_to_the_top_of_a_ridge_that_is_not_along_an_axis() {
        let axis: Vec<f64> = (0..9).map(f64::from).collect();
        for top in [[0.0, 8.0, 3.0], [7.0, 1.0, 4.0], [8.0, 8.0, 8.0]] {
            let looked_at = std::cell::Cell::new(0);
            let hill = |at: &[f64; 3]| {
                looked_at.set(looked_at.get() + 1);
                let off: Vec<f64> = at.iter().zip(top).map(|(at, top)| at - top).collect();
                -off.iter().map(|off| off * off).sum::<f64>() - 0.8 * off[0] * off[2]
            };
            assert_eq!(most_along([&axis, &axis, &axis], hill), top);
            assert!(looked_at.get() < 9 * 9 * 9 / 5, "{} points", looked_at.get());
        }
    }
}
