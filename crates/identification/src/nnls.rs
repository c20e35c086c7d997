//! Linear least squares on the normal equations with some coefficients held non-negative.
//!
//! Lawson and Hanson, *Solving Least Squares Problems*, 1974, chapter 23, in the form of Bro and de Jong (1997) that needs only the
//! Gram matrix: with it at hand a fit costs microseconds, however long the recordings are. The matrix squares the condition number;
//! where the last digits count (noise-free data) [`crate::linear::Compressed`] folds the rows themselves.

use crate::linear::{active_set, cholesky};

/// The normal equations of a least-squares problem `min |A x - y|^2`, accumulated row by row.
#[derive(Clone, Debug)]
pub struct Normal {
    columns: usize,
    /// `A^T A`, `columns` rows of `columns`.
    pub gram: Vec<f64>,
    /// `A^T y`.
    pub right: Vec<f64>,
    /// `y^T y`.
    pub square: f64,
    /// Rows seen.
    pub rows: usize,
}

impl Normal {
    /// No rows yet.
    #[must_use]
    pub fn new(columns: usize) -> Self {
        Self { columns, gram: vec![0.0; columns * columns], right: vec![0.0; columns], square: 0.0, rows: 0 }
    }

    /// Number of columns.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Adds one row of `A`, `columns` long, and its right-hand side.
    pub fn add(&mut self, row: &[f64], target: f64) {
        for (i, &left) in row.iter().enumerate() {
            for (sum, &right) in self.gram[i * self.columns..][..=i].iter_mut().zip(row) {
                *sum += left * right;
            }
            self.right[i] += left * target;
        }
        self.square += target * target;
        self.rows += 1;
    }

    /// Fills the upper triangle, which [`Self::add`] leaves alone.
    pub fn complete(&mut self) {
        for i in 0..self.columns {
            for j in 0..i {
                self.gram[j * self.columns + i] = self.gram[i * self.columns + j];
            }
        }
    }

    /// The rows of both.
    #[must_use]
    pub fn sum<'a>(parts: impl IntoIterator<Item = &'a Self>, columns: usize) -> Self {
        let mut total = Self::new(columns);
        for part in parts {
            total.gram.iter_mut().zip(&part.gram).for_each(|(sum, value)| *sum += value);
            total.right.iter_mut().zip(&part.right).for_each(|(sum, value)| *sum += value);
            total.square += part.square;
            total.rows += part.rows;
        }
        total
    }

    /// `|A x - y|^2`, not below zero.
    #[must_use]
    pub fn residual_square(&self, x: &[f64]) -> f64 {
        let mut sum = self.square;
        for (i, &xi) in x.iter().enumerate() {
            let row: f64 = self.gram[i * self.columns..][..self.columns].iter().zip(x).map(|(g, xj)| g * xj).sum();
            sum += xi * (row - 2.0 * self.right[i]);
        }
        sum.max(0.0)
    }
}

/// Minimises `x^T G x - 2 r^T x` with `x[i] >= 0` wherever `non_negative[i]`; `gram` is `n` rows of `n`, symmetric.
///
/// Columns that add nothing (a pivot below 1e-13 of the diagonal) get zero. The other columns are free in sign.
///
/// # Panics
/// When the lengths do not fit together.
#[must_use]
pub fn solve(gram: &[f64], right: &[f64], non_negative: &[bool]) -> Vec<f64> {
    let n = right.len();
    assert!(gram.len() == n * n && non_negative.len() == n, "a square Gram matrix and one bound a column are wanted");
    let width = n + 1;
    // Cholesky: G = R^T R and z = R^-T r make the triangle [R | z] of a system with the same solution.
    let mut triangle = vec![0.0_f64; width * width];
    for row in 0..n {
        let above: f64 = (0..row).map(|k| triangle[k * width + row].powi(2)).sum();
        let pivot = gram[row * n + row] - above;
        if pivot <= 1e-13 * gram[row * n + row] {
            continue;
        }
        let diagonal = pivot.sqrt();
        triangle[row * width + row] = diagonal;
        for column in row + 1..width {
            let value = if column == n { right[row] } else { gram[row * n + column] };
            let above: f64 = (0..row).map(|k| triangle[k * width + row] * triangle[k * width + column]).sum();
            triangle[row * width + column] = (value - above) / diagonal;
        }
    }
    let free: Vec<bool> = non_negative.iter().map(|bounded| !bounded).collect();
    active_set(&triangle, n, &free).coefficients
}

/// As [`solve`], for a positive definite matrix: Cholesky on the columns in use, `n^3 / 3` operations a change of their set, and begun with
/// the columns of `start`, for example those of a neighbouring problem. `None` when the matrix is not positive definite.
///
/// # Panics
/// When the lengths do not fit together.
#[must_use]
pub fn solve_definite(gram: &[f64], right: &[f64], non_negative: &[bool], start: &[bool]) -> Option<Vec<f64>> {
    let n = right.len();
    assert!(gram.len() == n * n && non_negative.len() == n && start.len() == n, "a square Gram matrix and one bound a column are wanted");
    let mut x = vec![0.0; n];
    let mut used: Vec<bool> = (0..n).map(|column| !non_negative[column] || start[column]).collect();
    let tolerance = 1e-12 * right.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    // Each round adds a column; the bound only guards against a cycle by rounding.
    for _ in 0..=3 * n + 3 {
        loop {
            let chosen: Vec<usize> = (0..n).filter(|&column| used[column]).collect();
            let small: Vec<f64> = chosen.iter().flat_map(|&row| chosen.iter().map(move |&column| gram[row * n + column])).collect();
            let trial = cholesky(small, chosen.iter().map(|&row| right[row]).collect())?;
            // Towards the trial until the first bound is met; that column leaves.
            let leaves = |index: usize| non_negative[chosen[index]] && trial[index] <= 0.0;
            let step = (0..chosen.len())
                .filter(|&index| leaves(index))
                .map(|index| x[chosen[index]] / (x[chosen[index]] - trial[index]).max(f64::MIN_POSITIVE))
                .fold(1.0, f64::min);
            let blocked = (0..chosen.len()).any(leaves);
            for (index, &column) in chosen.iter().enumerate() {
                // Without rounding where nothing blocks: the solution is then the same wherever the search began.
                x[column] = if blocked { x[column] + step * (trial[index] - x[column]) } else { trial[index] };
                if leaves(index) && x[column] <= 1e-14 * trial[index].abs() {
                    (x[column], used[column]) = (0.0, false);
                }
            }
            if !blocked {
                break;
            }
        }
        let gradient = |row: usize| right[row] - gram[row * n..][..n].iter().zip(&x).map(|(g, x)| g * x).sum::<f64>();
        let best = (0..n).filter(|&column| !used[column]).map(|column| (gradient(column), column)).max_by(|a, b| a.0.total_cmp(&b.0));
        match best {
            Some((gradient, column)) if gradient > tolerance => used[column] = true,
            _ => break,
        }
    }
    Some(x)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn normal(rows: &[Vec<f64>], targets: &[f64]) -> Normal {
        let mut normal = Normal::new(rows[0].len());
        rows.iter().zip(targets).for_each(|(row, &target)| normal.add(row, target));
        normal.complete();
        normal
    }

    proptest! {
        #[test]
        fn the_solution_satisfies_the_kuhn_tucker_conditions(
            values in prop::collection::vec(-1.0f64..1.0, 12 * 5),
            targets in prop::collection::vec(-1.0f64..1.0, 12),
            free in prop::collection::vec(any::<bool>(), 5),
        ) {
            let rows: Vec<Vec<f64>> = values.chunks(5).map(<[f64]>::to_vec).collect();
            let normal = normal(&rows, &targets);
            let bounded: Vec<bool> = free.iter().map(|free| !free).collect();
            let x = solve(&normal.gram, &normal.right, &bounded);
            let definite = solve_definite(&normal.gram, &normal.right, &bounded, &[false, true, false, true, true]).unwrap();
            for i in 0..5 {
                prop_assert!((definite[i] - x[i]).abs() < 1e-6, "{definite:?} {x:?}");
                let gradient = normal.right[i] - (0..5).map(|j| normal.gram[i * 5 + j] * x[j]).sum::<f64>();
                if bounded[i] {
                    prop_assert!(x[i] >= 0.0 && gradient <= 1e-9, "x {} gradient {gradient}", x[i]);
                    prop_assert!(x[i] == 0.0 || gradient.abs() <= 1e-9);
                } else {
                    prop_assert!(gradient.abs() <= 1e-9, "gradient {gradient}");
                }
            }
        }
    }

    #[test]
    fn a_repeated_column_and_an_empty_one_do_no_harm() {
        let rows: Vec<Vec<f64>> = (0..20).map(f64::from).map(|t| vec![t, t, 0.0, 1.0]).collect();
        let targets: Vec<f64> = (0..20).map(|i| 2.0 * f64::from(i) + 3.0).collect();
        let x = solve(&normal(&rows, &targets).gram, &normal(&rows, &targets).right, &[true, true, true, false]);
        assert!((x[0] + x[1] - 2.0).abs() < 1e-9 && x[2] == 0.0 && (x[3] - 3.0).abs() < 1e-9, "{x:?}");
    }

    #[test]
    fn the_residual_of_a_fit_is_what_it_leaves() {
        let rows = [vec![1.0, 0.0], vec![1.0, 1.0], vec![1.0, 2.0]];
        let targets = [0.0, 1.0, 5.0];
        let normal = normal(&rows, &targets);
        let direct: f64 = rows.iter().zip(&targets).map(|(row, y)| (row[0] * 0.5 + row[1] * 1.5 - y).powi(2)).sum();
        assert!((normal.residual_square(&[0.5, 1.5]) - direct).abs() < 1e-12);
    }
}
