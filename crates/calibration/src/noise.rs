//! The noise of a quiet channel.

use crate::CalibrationError;

/// Noise of a channel while nothing moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Mean.
    pub mean: f64,
    /// Standard deviation about the straight line through the samples: drift is no noise.
    pub standard_deviation: f64,
    /// Largest less smallest sample.
    pub peak_to_peak: f64,
    /// Change from the first to the last sample along that line.
    pub drift: f64,
}

impl Noise {
    /// Of equally spaced samples.
    ///
    /// # Errors
    /// With fewer than three.
    pub fn of(samples: &[f64]) -> Result<Self, CalibrationError> {
        let count = samples.len();
        if count < 3 {
            return Err(CalibrationError::TooFew { found: count, wanted: 3 });
        }
        let points: Vec<(f64, f64)> = samples.iter().enumerate().map(|(index, sample)| (index as f64, *sample)).collect();
        let line = crate::line::Line::through(&points)?;
        let (low, high) = samples.iter().fold((f64::MAX, f64::MIN), |(low, high), sample| (low.min(*sample), high.max(*sample)));
        Ok(Self {
            mean: samples.iter().sum::<f64>() / count as f64,
            standard_deviation: line.residual().unwrap_or(0.0),
            peak_to_peak: high - low,
            drift: line.span().value * (count - 1) as f64,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drift_is_told_apart_from_noise() {
        let samples: Vec<f64> = (0..1000).map(|index| f64::from(index) * 0.01 + if index % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let noise = Noise::of(&samples).unwrap();
        assert!((noise.drift - 9.99).abs() < 0.02, "{noise:?}");
        // A square wave of amplitude one has a standard deviation of one.
        assert!((noise.standard_deviation - 1.0).abs() < 0.01, "{noise:?}");
        assert!(Noise::of(&[1.0, 2.0]).is_err());
    }
}
