//! The map of a valve: drive to pressure, with its dead band and its hysteresis.

use crate::least_squares::Fit;
use crate::{CalibrationError, Estimate};

/// Levels below this share of the highest pressure are too near the dead band to lie on the line.
const ON_THE_LINE: f64 = 0.06;
/// A level whose rise to the next one is below this share of the middle rise is taken for saturated.
const SATURATED: f64 = 0.5;

/// A level of a staircase, settled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Drive, share of full.
    pub share: f64,
    /// Pressure, bar.
    pub pressure_bar: f64,
    /// Whether it was reached from below.
    pub rising: bool,
}

/// `pressure = span * (share - begin)` with one span and a beginning for each direction.
#[derive(Clone, Debug, PartialEq)]
pub struct ValveMap {
    fit: Fit<3>,
    /// Levels that the lines go through.
    pub used: usize,
    /// Whether the upper levels were left out because the pressure did not rise any more.
    pub saturates: bool,
}

impl ValveMap {
    /// Of the levels of a staircase up and down.
    ///
    /// # Errors
    /// When no pressure comes, or too few levels lie on the lines.
    pub fn of(levels: &[Level]) -> Result<Self, CalibrationError> {
        let highest_bar = levels.iter().map(|level| level.pressure_bar).fold(0.0, f64::max);
        if highest_bar < 0.02 {
            return Err(CalibrationError::NoResponse(format!(
                "the pressure stays below {highest_bar:.3} bar whatever the valve is asked for"
            )));
        }
        let limit_share = saturation(levels);
        let on_the_line: Vec<&Level> =
            levels.iter().filter(|level| level.pressure_bar > ON_THE_LINE * highest_bar && level.share <= limit_share).collect();
        let rows: Vec<([f64; 3], f64)> = on_the_line
            .iter()
            .map(|level| {
                let rising = f64::from(u8::from(level.rising));
                ([level.share, rising, 1.0 - rising], level.pressure_bar)
            })
            .collect();
        if rows.len() < 4 {
            return Err(CalibrationError::TooFew { found: rows.len(), wanted: 4 });
        }
        let fit = Fit::of(&rows).map_err(|error| match error {
            CalibrationError::Degenerate(_) => CalibrationError::Degenerate("span and hysteresis of the valve"),
            other => other,
        })?;
        if fit.coefficients[0] <= 0.0 {
            return Err(CalibrationError::NoResponse("the pressure falls when the valve is asked for more".to_owned()));
        }
        Ok(Self { fit, used: rows.len(), saturates: limit_share.is_finite() })
    }

    /// Drive at which pressure begins, in the middle between rising and falling, share of full.
    #[must_use]
    pub fn begin_share(&self) -> Estimate {
        let [span, up, down] = self.fit.coefficients;
        let value = -(up + down) / (2.0 * span);
        self.fit.estimate(value, [-value / span, -0.5 / span, -0.5 / span])
    }

    /// Drive at which a rising pressure begins, share of full.
    #[must_use]
    pub fn begin_rising_share(&self) -> Estimate {
        let [span, up, _] = self.fit.coefficients;
        self.fit.estimate(-up / span, [up / (span * span), -1.0 / span, 0.0])
    }

    /// Difference of drive between rising and falling at the same pressure, share of full.
    #[must_use]
    pub fn hysteresis_share(&self) -> Estimate {
        let [span, up, down] = self.fit.coefficients;
        let value = (down - up) / span;
        self.fit.estimate(value, [-value / span, -1.0 / span, 1.0 / span])
    }

    /// Pressure at this drive, in the middle between rising and falling, bar.
    #[must_use]
    pub fn pressure_bar(&self, share: f64) -> Estimate {
        let [span, up, down] = self.fit.coefficients;
        self.fit.estimate(span * share + 0.5 * (up + down), [share, 0.5, 0.5])
    }

    /// Standard deviation of the levels about the lines, bar.
    #[must_use]
    pub fn residual_bar(&self) -> Option<f64> {
        self.fit.residual
    }
}

/// The drive from which on the pressure rises no more; infinite if it always does.
fn saturation(levels: &[Level]) -> f64 {
    let rising: Vec<&Level> = levels.iter().filter(|level| level.rising).collect();
    let slopes: Vec<(f64, f64)> = rising
        .windows(2)
        .filter(|pair| pair[1].share > pair[0].share)
        .map(|pair| (pair[0].share, (pair[1].pressure_bar - pair[0].pressure_bar) / (pair[1].share - pair[0].share)))
        .collect();
    let mut sorted: Vec<f64> = slopes.iter().map(|(_, slope)| *slope).collect();
    sorted.sort_by(f64::total_cmp);
    // Above the middle lie the slopes of the line itself, whatever dead band and saturation take.
    let Some(typical) = sorted.get(sorted.len() * 3 / 4) else { return f64::INFINITY };
    // From the top down: the dead band at the bottom is no saturation.
    let flat = slopes.iter().rev().take_while(|(_, slope)| *slope < SATURATED * typical).last();
    flat.map_or(f64::INFINITY, |(share, _)| *share)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A staircase up and down on a valve in closed form.
    fn staircase(dead: f64, width: f64, full_bar: f64, supply_bar: f64, top: f64) -> Vec<Level> {
        let up = (1..=24).map(|index| f64::from(index) / 24.0 * top);
        let at = |share: f64, rising: bool| {
            let spool = if rising { share - 0.5 * width } else { share + 0.5 * width };
            // At the top the spool still stands where it came to.
            let spool = if rising { spool } else { spool.min(top - 0.5 * width) };
            let pressure_bar = (full_bar * ((spool - dead) / (1.0 - dead)).max(0.0)).min(supply_bar);
            Level { share, pressure_bar, rising }
        };
        let down: Vec<f64> = up.clone().rev().filter(|share| share + width <= top).collect();
        up.map(|share| at(share, true)).chain(down.into_iter().map(|share| at(share, false))).collect()
    }

    #[test]
    fn no_pressure_and_too_few_levels_are_told() {
        assert!(matches!(ValveMap::of(&[]), Err(CalibrationError::NoResponse(_))));
        let dead = staircase(0.3, 0.0, 0.0, 9.0, 0.5);
        assert!(matches!(ValveMap::of(&dead), Err(CalibrationError::NoResponse(_))));
        let few: Vec<Level> = staircase(0.0, 0.0, 5.0, 9.0, 0.5).into_iter().take(2).collect();
        assert!(ValveMap::of(&few).is_err());
    }

    proptest! {
        #[test]
        fn dead_band_hysteresis_and_full_scale_are_found_exactly(
            dead in 0.0..0.15_f64, width in 0.0..0.03_f64, full_bar in 2.0..8.0_f64, top in 0.35..0.6_f64,
        ) {
            let map = ValveMap::of(&staircase(dead, width, full_bar, 99.0, top)).unwrap();
            prop_assert!((map.begin_share().value - dead).abs() < 1e-9, "{map:?}");
            prop_assert!((map.begin_rising_share().value - dead - 0.5 * width).abs() < 1e-9);
            prop_assert!((map.hysteresis_share().value - width).abs() < 1e-9);
            prop_assert!((map.pressure_bar(1.0).value - full_bar).abs() < 1e-8);
            prop_assert!(!map.saturates);
        }

        /// What the supply cannot give does not bend the line.
        #[test]
        fn levels_above_the_supply_are_left_out(dead in 0.0..0.1_f64, supply in 0.5..0.8_f64) {
            let (full_bar, top) = (5.0, 0.6);
            let map = ValveMap::of(&staircase(dead, 0.0, full_bar, supply * full_bar * top, top)).unwrap();
            prop_assert!(map.saturates);
            prop_assert!((map.begin_share().value - dead).abs() < 0.01, "{} for {dead}", map.begin_share().value);
            prop_assert!((map.pressure_bar(1.0).value / full_bar - 1.0).abs() < 0.04, "{}", map.pressure_bar(1.0).value);
        }
    }
}
