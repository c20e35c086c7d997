//! Least squares with non-negative coefficients: a compressed orthogonal form of any number of rows, and Lawson and Hanson's
//! active-set method on it (C. L. Lawson, R. J. Hanson, Solving Least Squares Problems, 1974, chapter 23).
//!
//! The rows are folded into an upper triangle by Householder reflections, block by block: memory does not grow with the data, and
//! the condition number is not squared as it is in the normal equations of [`crate::nnls`].

/// Rows folded at a time.
const BLOCK_ROWS: usize = 64;

/// A column whose part outside the span of the others is below this share of its length adds nothing but rounding.
const DEPENDENT: f64 = 1e-11;

/// Sums of squares below this are the remains of rounding; their reciprocals would overflow.
const NOTHING: f64 = 1e-280;

/// The triangle `R` of `[A | y] = Q R`: all that least squares needs to know of the rows of `A x = y`.
#[derive(Clone, Debug)]
pub struct Compressed {
    /// Columns of `A`.
    columns: usize,
    /// Row-major, `columns + 1` wide and high.
    triangle: Vec<f64>,
    /// Rows not yet folded in, `columns + 1` wide.
    pending: Vec<f64>,
    /// What a reflection takes from each column; only while one is made.
    amounts: Vec<f64>,
    /// Rows seen.
    rows: usize,
}

impl Compressed {
    /// An empty system with so many columns.
    #[must_use]
    pub fn new(columns: usize) -> Self {
        let width = columns + 1;
        Self {
            columns,
            triangle: vec![0.0; width * width],
            pending: Vec::with_capacity(BLOCK_ROWS * width),
            amounts: vec![0.0; width],
            rows: 0,
        }
    }

    /// Adds one equation `coefficients . x = right`; `coefficients` has as many values as the system has columns.
    pub fn push(&mut self, coefficients: &[f64], right: f64) {
        debug_assert_eq!(coefficients.len(), self.columns);
        self.pending.extend_from_slice(coefficients);
        self.pending.push(right);
        self.rows += 1;
        if self.pending.len() >= BLOCK_ROWS * (self.columns + 1) {
            self.fold();
        }
    }

    /// Equations seen.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// The rows of the folded triangle, right side last.
    pub fn into_rows(mut self) -> Vec<Vec<f64>> {
        self.fold();
        self.triangle.chunks(self.columns + 1).map(<[f64]>::to_vec).collect()
    }

    /// Reflects the pending rows into the triangle.
    fn fold(&mut self) {
        let width = self.columns + 1;
        let rows = self.pending.len() / width;
        for column in 0..width {
            let below: f64 = (0..rows).map(|row| self.pending[row * width + column].powi(2)).sum();
            // What is left of a column that repeats others shrinks with every block until its square underflows: that is nothing.
            if below < NOTHING {
                continue;
            }
            let top = self.triangle[column * width + column];
            let length = (top * top + below).sqrt();
            let diagonal = if top > 0.0 { -length } else { length };
            let first = top - diagonal;
            let scale = 2.0 / (first * first + below);
            // Row by row, so that the processor takes several of the columns behind this one at a time.
            let amounts = &mut self.amounts[column + 1..];
            amounts.fill(-0.0);
            for row in self.pending.chunks_exact(width) {
                let own = row[column];
                amounts.iter_mut().zip(&row[column + 1..]).for_each(|(product, value)| *product += own * value);
            }
            let above = &mut self.triangle[column * width..][..width];
            for (amount, above) in amounts.iter_mut().zip(&mut above[column + 1..]) {
                *amount = scale * (first * *above + *amount);
                *above -= *amount * first;
            }
            above[column] = diagonal;
            for row in self.pending.chunks_exact_mut(width) {
                let own = row[column];
                row[column + 1..].iter_mut().zip(&*amounts).for_each(|(value, amount)| *value -= amount * own);
            }
        }
        self.pending.clear();
    }

    /// Least squares over all columns, those not `free` held at or above zero.
    #[must_use]
    pub fn solve(&mut self, free: &[bool]) -> Solution {
        self.fold();
        active_set(&self.triangle, self.columns, free)
    }

    /// As [`Self::solve`], for the right sides with the other sign.
    #[must_use]
    pub fn solve_opposite(&mut self, free: &[bool]) -> Solution {
        self.fold();
        let mut opposite = self.triangle.clone();
        opposite.iter_mut().skip(self.columns).step_by(self.columns + 1).for_each(|right| *right = -*right);
        active_set(&opposite, self.columns, free)
    }

    /// The inverse of the Gram matrix restricted to some columns, row-major; columns that depend on others get zeros.
    #[must_use]
    pub fn inverse_gram(&mut self, columns: &[usize]) -> Vec<f64> {
        self.fold();
        let n = columns.len();
        let mut small = Subset::new(&self.triangle, self.columns, columns);
        let mut inverse = vec![0.0; n * n];
        for index in 0..n {
            // Column `index` of (R^T R)^-1 by two triangular solves.
            let column = small.solve_gram_column(index);
            (0..n).for_each(|row| inverse[row * n + index] = column[row]);
        }
        inverse
    }
}

/// The result of a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// One coefficient a column.
    pub coefficients: Vec<f64>,
    /// Sum of squared residuals.
    pub squared_residual: f64,
}

/// Lawson and Hanson's method; the columns that are `free` in sign never leave the passive set.
pub fn active_set(triangle: &[f64], columns: usize, free: &[bool]) -> Solution {
    let width = columns + 1;
    let entry = |row: usize, column: usize| triangle[row * width + column];
    let norms: Vec<f64> = (0..columns).map(|column| (0..width).map(|row| entry(row, column).powi(2)).sum::<f64>().sqrt()).collect();
    let right_norm = (0..width).map(|row| entry(row, columns).powi(2)).sum::<f64>().sqrt();
    let residual = |coefficients: &[f64]| -> Vec<f64> {
        (0..width)
            .map(|row| entry(row, columns) - (0..columns).map(|column| entry(row, column) * coefficients[column]).sum::<f64>())
            .collect()
    };
    let mut passive: Vec<bool> = free.to_vec();
    let mut barred = vec![false; columns];
    let mut coefficients = vec![0.0; columns];
    // Each round adds a column; the bound only guards against a cycle by rounding.
    for round in 0..=3 * columns {
        if round > 0 {
            let left = residual(&coefficients);
            let gradient =
                |column: usize| (0..width).map(|row| entry(row, column) * left[row]).sum::<f64>() / norms[column].max(f64::MIN_POSITIVE);
            let best = (0..columns)
                .filter(|&column| !passive[column] && !barred[column] && norms[column] > 0.0)
                .map(|column| (gradient(column), column))
                .max_by(|first, second| first.0.total_cmp(&second.0));
            match best {
                Some((gradient, column)) if gradient > 1e-15 * right_norm => passive[column] = true,
                _ => break,
            }
        }
        loop {
            let chosen: Vec<usize> = (0..columns).filter(|&column| passive[column]).collect();
            let (trial, dependent) = Subset::new(triangle, columns, &chosen).solve();
            for (&column, _) in chosen.iter().zip(&dependent).filter(|&(_, &dependent)| dependent) {
                passive[column] = free[column];
                barred[column] = true;
                coefficients[column] = 0.0;
            }
            let negative = |index: usize| !free[chosen[index]] && trial[index] <= 0.0 && !dependent[index];
            if !(0..chosen.len()).any(negative) {
                for (index, &column) in chosen.iter().enumerate() {
                    coefficients[column] = trial[index];
                }
                break;
            }
            // Go towards the trial until the first coefficient reaches zero; that one leaves.
            let step = (0..chosen.len())
                .filter(|&index| negative(index))
                .map(|index| coefficients[chosen[index]] / (coefficients[chosen[index]] - trial[index]).max(f64::MIN_POSITIVE))
                .fold(1.0, f64::min);
            for (index, &column) in chosen.iter().enumerate() {
                coefficients[column] += step * (trial[index] - coefficients[column]);
                if !free[column] && negative(index) && coefficients[column] <= 1e-14 * trial[index].abs() {
                    coefficients[column] = 0.0;
                    passive[column] = false;
                    // A column that leaves at once would be chosen again for ever.
                    barred[column] = step == 0.0;
                }
            }
        }
    }
    let squared_residual = residual(&coefficients).iter().map(|value| value * value).sum();
    Solution { coefficients, squared_residual }
}

/// The triangle of some of the columns, in an order of its own choice.
struct Subset {
    /// Row-major `order.len()` square, columns in `order`.
    triangle: Vec<f64>,
    right: Vec<f64>,
    count: usize,
    dependent: Vec<bool>,
}

impl Subset {
    /// Orthogonalises the chosen columns of the big triangle (modified Gram-Schmidt, twice: as exact as Householder).
    fn new(triangle: &[f64], columns: usize, chosen: &[usize]) -> Self {
        let width = columns + 1;
        let column_of = |column: usize| (0..width).map(|row| triangle[row * width + column]).collect::<Vec<f64>>();
        let right = column_of(columns);
        let count = chosen.len();
        let mut small = vec![0.0; count * count];
        let mut basis: Vec<Vec<f64>> = Vec::with_capacity(count);
        let mut dependent = vec![false; count];
        for (index, &column) in chosen.iter().enumerate() {
            let mut vector = column_of(column);
            let length = dot(&vector, &vector).sqrt();
            for _ in 0..2 {
                for (before, direction) in basis.iter().enumerate() {
                    let amount = dot(direction, &vector);
                    small[before * count + index] += amount;
                    vector.iter_mut().zip(direction).for_each(|(value, part)| *value -= amount * part);
                }
            }
            let rest = dot(&vector, &vector).sqrt();
            if rest <= DEPENDENT * length || length == 0.0 {
                dependent[index] = true;
                vector.fill(0.0);
            } else {
                vector.iter_mut().for_each(|value| *value /= rest);
                small[index * count + index] = rest;
            }
            basis.push(vector);
        }
        let right = basis.iter().map(|direction| dot(direction, &right)).collect();
        Self { triangle: small, right, count, dependent }
    }

    /// Coefficients of the chosen columns, zero for those that depend on earlier ones, and which those are.
    fn solve(self) -> (Vec<f64>, Vec<bool>) {
        let coefficients = self.back_substitute(&self.right);
        (coefficients, self.dependent)
    }

    fn back_substitute(&self, right: &[f64]) -> Vec<f64> {
        let n = self.count;
        let mut result = vec![0.0; n];
        for row in (0..n).rev().filter(|&row| !self.dependent[row]) {
            let known: f64 = (row + 1..n).map(|column| self.triangle[row * n + column] * result[column]).sum();
            result[row] = (right[row] - known) / self.triangle[row * n + row];
        }
        result
    }

    /// One column of the inverse of the Gram matrix.
    fn solve_gram_column(&mut self, index: usize) -> Vec<f64> {
        let n = self.count;
        let mut half = vec![0.0; n];
        for row in (0..n).filter(|&row| !self.dependent[row]) {
            let known: f64 = (0..row).map(|above| self.triangle[above * n + row] * half[above]).sum();
            half[row] = (f64::from(u8::from(row == index)) - known) / self.triangle[row * n + row];
        }
        self.back_substitute(&half)
    }
}

/// Solves a symmetric positive definite system, row-major, by Cholesky factorisation; `None` when it is not positive definite.
///
/// Column by column, what a column takes from each element of the rest is added to that element's sum at once: whole rows of sums, which the
/// compiler makes vectors of, where a dot product would wait for each addition. The order within each sum is the same.
#[must_use]
pub fn cholesky(mut matrix: Vec<f64>, mut right: Vec<f64>) -> Option<Vec<f64>> {
    let n = right.len();
    let (mut sums, mut column) = (vec![0.0; n * n], vec![0.0; n]);
    for at in 0..n {
        let diagonal = matrix[at * n + at];
        let pivot = diagonal - sums[at * n + at];
        // Not below rounding of the diagonal, and not NaN.
        if pivot.is_nan() || pivot <= 1e-13 * diagonal {
            return None;
        }
        let root = pivot.sqrt();
        matrix[at * n + at] = root;
        for row in at + 1..n {
            let value = (matrix[row * n + at] - sums[row * n + at]) / root;
            matrix[row * n + at] = value;
            column[row] = value;
            for (sum, other) in sums[row * n..][at + 1..=row].iter_mut().zip(&column[at + 1..=row]) {
                *sum += value * other;
            }
        }
    }
    for row in 0..n {
        let sum: f64 = matrix[row * n..][..row].iter().zip(&right).map(|(factor, value)| factor * value).sum();
        right[row] = (right[row] - sum) / matrix[row * n + row];
    }
    for row in (0..n).rev() {
        let value = right[row] / matrix[row * n + row];
        right[row] = value;
        for above in 0..row {
            right[above] -= matrix[row * n + above] * value;
        }
    }
    Some(right)
}

fn dot(first: &[f64], second: &[f64]) -> f64 {
    first.iter().zip(second).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn system(seed: u64, rows: usize, columns: usize) -> (Vec<Vec<f64>>, Vec<f64>) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let matrix = (0..rows).map(|_| (0..columns).map(|_| random.random::<f64>() - 0.3).collect()).collect();
        (matrix, (0..rows).map(|_| random.random::<f64>() - 0.5).collect())
    }

    #[test]
    fn solutions_satisfy_the_kuhn_tucker_conditions() {
        for seed in 0..50 {
            let (matrix, right) = system(seed, 200, 9);
            let mut compressed = Compressed::new(9);
            matrix.iter().zip(&right).for_each(|(row, &right)| compressed.push(row, right));
            let free: Vec<bool> = (0..9).map(|column| column == 4).collect();
            let solution = compressed.solve(&free);
            let residual: Vec<f64> = matrix.iter().zip(&right).map(|(row, right)| right - dot(row, &solution.coefficients)).collect();
            assert!((dot(&residual, &residual) - solution.squared_residual).abs() < 1e-10, "seed {seed}");
            for column in 0..9 {
                let gradient: f64 = matrix.iter().zip(&residual).map(|(row, left)| row[column] * left).sum();
                let coefficient = solution.coefficients[column];
                if free[column] || coefficient > 0.0 {
                    assert!(gradient.abs() < 1e-10, "seed {seed}: column {column} is not at its optimum");
                } else {
                    assert!(coefficient == 0.0 && gradient < 1e-10, "seed {seed}: column {column} should have entered");
                }
            }
            let gram: Vec<f64> = (0..81).map(|k| matrix.iter().map(|row| row[k / 9] * row[k % 9]).sum()).collect();
            let product: Vec<f64> = (0..9).map(|k| matrix.iter().zip(&right).map(|(row, right)| row[k] * right).sum()).collect();
            let mut constrained = compressed.clone();
            let wanted = constrained.solve(&[false; 9]).coefficients;
            for (got, wanted) in crate::nnls::solve(&gram, &product, &[true; 9]).iter().zip(&wanted) {
                assert!((got - wanted).abs() < 1e-10, "seed {seed}");
            }
        }
    }

    #[test]
    fn the_opposite_right_side_is_solved_from_the_same_rows() {
        let (matrix, right) = system(6, 150, 5);
        let fold = |sign: f64| {
            let mut compressed = Compressed::new(5);
            matrix.iter().zip(&right).for_each(|(row, &right)| compressed.push(row, sign * right));
            compressed
        };
        let free = [false, false, true, false, true];
        assert_eq!(fold(1.0).solve_opposite(&free), fold(-1.0).solve(&free));
        assert_ne!(fold(1.0).solve(&free), fold(-1.0).solve(&free));
    }

    #[test]
    fn dependent_and_empty_columns_do_no_harm() {
        let (matrix, _) = system(77, 100, 3);
        let mut compressed = Compressed::new(6);
        for row in &matrix {
            let wide = [row[0], row[1], row[0], 0.0, row[2], row[0] + row[1]];
            compressed.push(&wide, 2.0 * row[0] + row[1] + 0.5 * row[2]);
        }
        let solution = compressed.solve(&[false; 6]);
        assert!(solution.squared_residual < 1e-24, "{solution:?}");
        assert!(solution.coefficients.iter().all(|&value| value >= 0.0) && solution.coefficients[3] == 0.0);
    }

    #[test]
    fn a_repeated_column_stays_harmless_over_any_number_of_rows() {
        let mut compressed = Compressed::new(4);
        for k in 0..20_000 {
            let (x, y) = ((f64::from(k) * 0.013).sin(), (f64::from(k) * 0.0071).cos());
            compressed.push(&[x, x, y, x], 2.0 * x + 0.5 * y + 1e-3 * (f64::from(k) * 1.7).sin());
        }
        let solution = compressed.solve(&[false; 4]);
        let (sum, other) = (solution.coefficients[0] + solution.coefficients[1] + solution.coefficients[3], solution.coefficients[2]);
        assert!((sum - 2.0).abs() < 1e-4 && (other - 0.5).abs() < 1e-4, "{solution:?}");
        assert!((solution.squared_residual / 20_000.0 - 0.5e-6).abs() < 1e-8, "{solution:?}");
    }

    #[test]
    fn the_inverse_gram_matrix_is_one() {
        let (matrix, right) = system(5, 60, 4);
        let mut compressed = Compressed::new(4);
        matrix.iter().zip(&right).for_each(|(row, &right)| compressed.push(row, right));
        let chosen = [0, 2, 3];
        let inverse = compressed.inverse_gram(&chosen);
        for row in 0..3 {
            for column in 0..3 {
                let product: f64 = (0..3)
                    .map(|k| inverse[row * 3 + k] * matrix.iter().map(|line| line[chosen[k]] * line[chosen[column]]).sum::<f64>())
                    .sum();
                assert!((product - f64::from(u8::from(row == column))).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn cholesky_solves_and_refuses() {
        let matrix = vec![4.0, 2.0, 0.5, 2.0, 5.0, 1.0, 0.5, 1.0, 3.0];
        let wanted = [1.0, -2.0, 0.25];
        let right = (0..3).map(|row| (0..3).map(|column| matrix[row * 3 + column] * wanted[column]).sum()).collect();
        for (got, wanted) in cholesky(matrix, right).expect("positive definite").iter().zip(wanted) {
            assert!((got - wanted).abs() < 1e-14);
        }
        assert!(cholesky(vec![1.0, 1.0, 1.0, 1.0], vec![1.0, 1.0]).is_none());
        assert!(cholesky(vec![f64::NAN], vec![1.0]).is_none());
    }

    /// The same sums in the same order as in a textbook's loop over dot products: equal bits.
    #[test]
    fn cholesky_adds_in_the_order_of_the_textbook() {
        let mut random = ChaCha8Rng::seed_from_u64(11);
        for n in [1, 2, 5, 17, 64] {
            let factor: Vec<f64> = (0..n * n).map(|_| random.random_range(-1.0..1.0)).collect();
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).fold(0.0, |sum, (a, b)| sum + a * b);
            let mut matrix: Vec<f64> = (0..n * n).map(|at| dot(&factor[at / n * n..][..n], &factor[at % n * n..][..n])).collect();
            (0..n).for_each(|row| matrix[row * n + row] += 0.1);
            let right: Vec<f64> = (0..n).map(|_| random.random_range(-1.0..1.0)).collect();

            let mut lower = vec![0.0; n * n];
            for row in 0..n {
                for column in 0..=row {
                    let sum = dot(&lower[row * n..][..column], &lower[column * n..][..column]);
                    let rest = matrix[row * n + column] - sum;
                    lower[row * n + column] = if column == row { rest.sqrt() } else { rest / lower[column * n + column] };
                }
            }
            let mut wanted = right.clone();
            for row in 0..n {
                wanted[row] = (wanted[row] - dot(&lower[row * n..][..row], &wanted[..row])) / lower[row * n + row];
            }
            for row in (0..n).rev() {
                wanted[row] /= lower[row * n + row];
                for above in 0..row {
                    wanted[above] -= lower[row * n + above] * wanted[row];
                }
            }
            let found = cholesky(matrix, right).expect("positive definite");
            assert_eq!(
                found.iter().map(|value| value.to_bits()).collect::<Vec<_>>(),
                wanted.iter().map(|value| value.to_bits()).collect::<Vec<_>>()
            );
        }
    }
}
