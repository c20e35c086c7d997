//! A straight line through readings at known references, and back from a reading to the reference.

use crate::least_squares::Fit;
use crate::{CalibrationError, Estimate};

/// `reading = zero + span * reference`: the reference is known, the reading has the error.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    fit: Fit<2>,
}

impl Line {
    /// Fits a line through pairs of reference and reading.
    ///
    /// # Errors
    /// With fewer than two, or when all references are equal.
    pub fn through(points: &[(f64, f64)]) -> Result<Self, CalibrationError> {
        let rows: Vec<([f64; 2], f64)> = points.iter().map(|(reference, reading)| ([1.0, *reference], *reading)).collect();
        let fit = Fit::of(&rows).map_err(|error| match error {
            CalibrationError::Degenerate(_) => CalibrationError::Degenerate("zero and span"),
            other => other,
        })?;
        Ok(Self { fit })
    }

    /// Reading at a reference of zero.
    #[must_use]
    pub fn zero(&self) -> Estimate {
        self.reading(0.0)
    }

    /// Reading per reference.
    #[must_use]
    pub fn span(&self) -> Estimate {
        self.fit.estimate(self.fit.coefficients[1], [0.0, 1.0])
    }

    /// The reading at a reference.
    #[must_use]
    pub fn reading(&self, reference: f64) -> Estimate {
        let [zero, span] = self.fit.coefficients;
        self.fit.estimate(zero + span * reference, [1.0, reference])
    }

    /// The reference that gives a reading.
    #[must_use]
    pub fn reference(&self, reading: f64) -> Estimate {
        let [zero, span] = self.fit.coefficients;
        let value = (reading - zero) / span;
        self.fit.estimate(value, [-1.0 / span, -value / span])
    }

    /// Standard deviation of the readings about the line; `None` with two points.
    #[must_use]
    pub fn residual(&self) -> Option<f64> {
        self.fit.residual
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_interval_of_the_span_is_that_of_the_textbook() {
        let line = Line::through(&[(0.0, 1.0), (1.0, 2.0), (2.0, 4.0), (3.0, 5.0)]).unwrap();
        // y = 0.9 + 1.4 x, residual sum of squares 0.2, s^2 = 0.1, Sxx = 5, t(0.975; 2) = 4.302653.
        assert!((line.zero().value - 0.9).abs() < 1e-12 && (line.span().value - 1.4).abs() < 1e-12);
        let half = line.span().half_width.unwrap();
        assert!((half - 4.302_653 * (0.1_f64 / 5.0).sqrt()).abs() < 1e-5, "{half}");
        let half = line.zero().half_width.unwrap();
        assert!((half - 4.302_653 * (0.1_f64 * (0.25 + 2.25 / 5.0)).sqrt()).abs() < 1e-5, "{half}");
    }

    #[test]
    fn two_points_give_a_line_without_an_interval_and_equal_references_none() {
        let line = Line::through(&[(2.0, 0.9), (18.0, 2.7)]).unwrap();
        assert_eq!(line.span().half_width, None);
        assert!(matches!(Line::through(&[(2.0, 0.9), (2.0, 2.7)]), Err(CalibrationError::Degenerate("zero and span"))));
    }

    proptest! {
        #[test]
        fn an_exact_line_is_found_and_read_back(zero in -10.0..10.0_f64, span in 0.01..10.0_f64, offset in -100.0..100.0_f64) {
            let points: Vec<(f64, f64)> = (0..5).map(|index| offset + f64::from(index)).map(|x| (x, zero + span * x)).collect();
            let line = Line::through(&points).unwrap();
            prop_assert!((line.span().value / span - 1.0).abs() < 1e-6);
            let reference = line.reference(zero + span * (offset + 2.0)).value;
            prop_assert!((reference - offset - 2.0).abs() < 1e-6);
        }

        /// The interval scales with the noise and knows no unit.
        #[test]
        fn intervals_scale_with_the_residuals(scale in 0.001..1000.0_f64) {
            let noise = [0.1, -0.2, 0.15, -0.1, 0.05];
            let at = |factor: f64| Line::through(&std::array::from_fn::<_, 5, _>(|i| (i as f64, 2.0 + 3.0 * i as f64 + factor * noise[i]))).unwrap();
            let (one, many) = (at(1.0).span().half_width.unwrap(), at(scale).span().half_width.unwrap());
            prop_assert!((many / one / scale - 1.0).abs() < 1e-6);
        }
    }
}
