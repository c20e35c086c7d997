//! Least-squares surfaces: what a simple dependence leaves of values.

use super::clock;

/// Of the square of the largest column, added to the diagonal: columns that say the same share their weight.
const RIDGE: f64 = 1e-9;

/// What a constant, the first three powers of the coordinates, and bends of the first coordinate leave of the values, by least squares.
pub(super) fn residuals(points: &[&[f64]], values: &[f64]) -> Vec<f64> {
    let first: Vec<f64> = points.iter().map(|point| point[0]).collect();
    let bends: Vec<f64> = (1..8).map(|part| clock::quantile(first.clone(), f64::from(part) / 8.0)).collect();
    let columns: Vec<Vec<f64>> = points
        .iter()
        .map(|point| {
            let powers = (1..=3).flat_map(|power| point.iter().map(move |value| value.powi(power)));
            let bent = bends.iter().map(|bend| (point[0] - bend).max(0.0));
            std::iter::once(1.0).chain(powers).chain(bent).collect()
        })
        .collect();
    left(&columns, values)
}

/// Root mean square of what a parabola leaves of even samples, per degree of freedom.
pub(super) fn left_of_parabola(values: &[f64]) -> f64 {
    let count = values.len() as f64;
    let rows: Vec<Vec<f64>> = (0..values.len())
        .map(|index| {
            let place = 2.0 * index as f64 / (count - 1.0) - 1.0;
            vec![1.0, place, place * place]
        })
        .collect();
    (left(&rows, values).iter().map(|value| value * value).sum::<f64>() / (count - 3.0)).sqrt()
}

/// What the columns of `rows` leave of the values.
pub(super) fn left(rows: &[Vec<f64>], values: &[f64]) -> Vec<f64> {
    // The ridge would hold the constant of values far from zero back.
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    let values: Vec<f64> = values.iter().map(|value| value - mean).collect();
    let weights = solve(rows, &values);
    let fitted = |row: &Vec<f64>| row.iter().zip(&weights).map(|(value, weight)| value * weight).sum::<f64>();
    rows.iter().zip(&values).map(|(row, value)| value - fitted(row)).collect()
}

/// Least-squares weights by the normal equations with a small ridge.
pub(super) fn solve(rows: &[Vec<f64>], values: &[f64]) -> Vec<f64> {
    let size = rows.first().map_or(0, Vec::len);
    let mut matrix = vec![vec![0.0; size + 1]; size];
    for (row, value) in rows.iter().zip(values) {
        for (one, line) in row.iter().zip(&mut matrix) {
            for (sum, other) in line.iter_mut().zip(row.iter().chain([value])) {
                *sum += one * other;
            }
        }
    }
    let largest = (0..size).map(|index| matrix[index][index]).fold(0.0, f64::max);
    (0..size).for_each(|index| matrix[index][index] += RIDGE * largest);
    for pivot in 0..size {
        let best = (pivot..size).max_by(|&one, &other| matrix[one][pivot].abs().total_cmp(&matrix[other][pivot].abs()));
        matrix.swap(pivot, best.unwrap_or(pivot));
        let lead = matrix[pivot].clone();
        if lead[pivot] == 0.0 {
            continue;
        }
        for line in &mut matrix[pivot + 1..] {
            let factor = line[pivot] / lead[pivot];
            line.iter_mut().zip(&lead).skip(pivot).for_each(|(value, lead)| *value -= factor * lead);
        }
    }
    let mut weights = vec![0.0; size];
    for index in (0..size).rev() {
        let known: f64 = (index + 1..size).map(|other| matrix[index][other] * weights[other]).sum();
        let lead = matrix[index][index];
        weights[index] = if lead == 0.0 { 0.0 } else { (matrix[index][size] - known) / lead };
    }
    weights
}
