//! Least squares on sums of products: what one set of samples has to say about the weights.

/// Sums of products of one set of samples: all that a linear fit needs to know of them.
#[derive(Clone, Debug)]
pub struct Gram {
    /// Number of columns.
    pub columns: usize,
    /// Products of columns with columns, row by row.
    pub products: Vec<f64>,
    /// Products of columns with the measured output.
    pub target: Vec<f64>,
    /// Sum of squares of the measured output.
    pub energy: f64,
    /// Number of samples.
    pub samples: f64,
}

impl Gram {
    /// No samples yet.
    #[must_use]
    pub fn new(columns: usize) -> Self {
        Self { columns, products: vec![0.0; columns * columns], target: vec![0.0; columns], energy: 0.0, samples: 0.0 }
    }

    /// The samples of both.
    pub fn add(&mut self, other: &Self) {
        for (sum, value) in self.products.iter_mut().zip(&other.products) {
            *sum += value;
        }
        for (sum, value) in self.target.iter_mut().zip(&other.target) {
            *sum += value;
        }
        self.energy += other.energy;
        self.samples += other.samples;
    }

    /// Mean square of the residual that `weights` leave.
    #[must_use]
    pub fn mean_square(&self, weights: &[f64]) -> f64 {
        let mut sum = self.energy;
        for row in 0..self.columns {
            if weights[row] == 0.0 {
                continue;
            }
            let line = &self.products[row * self.columns..(row + 1) * self.columns];
            let product: f64 = line.iter().zip(weights).map(|(x, y)| x * y).sum();
            sum += weights[row] * (product - 2.0 * self.target[row]);
        }
        sum.max(0.0) / self.samples.max(1.0)
    }

    /// Weights of the smallest residual; those with `free[i] == false` are not negative.
    #[must_use]
    pub fn solve(&self, free: &[bool]) -> Vec<f64> {
        let n = self.columns;
        // Columns of unit length: thresholds and creep columns differ by orders of magnitude.
        let scale: Vec<f64> = (0..n).map(|i| 1.0 / self.products[i * n + i].max(1e-30).sqrt()).collect();
        let gram: Vec<f64> = (0..n * n)
            .map(|at| {
                let (row, column) = (at / n, at % n);
                // A ridge far below what noise does keeps twin columns apart.
                self.products[at] * scale[row] * scale[column] + if row == column { 1e-9 } else { 0.0 }
            })
            .collect();
        let right: Vec<f64> = (0..n).map(|i| self.target[i] * scale[i]).collect();
        let non_negative: Vec<bool> = free.iter().map(|free| !free).collect();
        let mut weights = crate::identify::nnls::solve(&gram, &right, &non_negative);
        for (weight, scale) in weights.iter_mut().zip(&scale) {
            *weight *= scale;
        }
        weights
    }
}
