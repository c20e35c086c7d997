//! The response of a channel to a command: dead time and time constant of the first-order response that fits best.
//!
//! `y(t) = offset + gain x(t)`, `time_constant x'(t) + x(t) = u(t - dead_time)`, with the command `u` as it was, slewed or not, held between samples,
//! and at rest before the first one. Offset and gain are linear and solved for at each pair of times. The times are searched on a grid and
//! refined by Gauss and Newton with halved steps, from which their intervals follow.

use crate::least_squares::Fit;
use crate::{CalibrationError, Estimate};

/// A fit that leaves more than this share of the variance has no response to fit: the best of many responses to noise explains a few per cent.
const UNEXPLAINED: f64 = 0.7;
/// Steps of the grid, along each of the times.
const GRID: u32 = 36;
/// Rounds of refinement.
const ROUNDS: usize = 40;
/// Fewest samples.
const FEWEST: usize = 8;

/// A first-order response with dead time.
#[derive(Clone, Debug, PartialEq)]
pub struct Response {
    /// Time until anything happens, s.
    pub dead_time_s: Estimate,
    /// Time constant from then on, s.
    pub time_constant_s: Estimate,
    /// Change of the value per change of the command.
    pub gain: f64,
    /// The fitted value at each sample.
    pub fitted: Vec<f64>,
    /// Standard deviation about the fit.
    pub residual: f64,
}

/// Dead time and time constant, s.
type Times = (f64, f64);

/// The command behind dead time and lag, at each sample.
fn filtered(period_s: f64, commands: &[f64], (dead_time_s, time_constant_s): Times) -> Vec<f64> {
    let whole = (dead_time_s / period_s).floor();
    // Within a period the delayed command is first the older, then the newer of two.
    let first_s = dead_time_s - whole * period_s;
    let whole = whole as usize;
    let rest = commands.first().copied().unwrap_or(0.0);
    let before = |index: usize, back: usize| index.checked_sub(back).map_or(rest, |index| commands[index]);
    let decay = |time_s: f64| (-time_s / time_constant_s).exp();
    let (all, newer) = (decay(period_s), decay(period_s - first_s));
    let mut state = rest;
    (0..commands.len())
        .map(|index| {
            if index > 0 {
                let (old, new) = (before(index, whole + 2), before(index, whole + 1));
                state = state * all + old * (newer - all) + new * (1.0 - newer);
            }
            state
        })
        .collect()
}

/// A response under search.
struct Search<'a> {
    period_s: f64,
    commands: &'a [f64],
    values: &'a [f64],
}

impl Search<'_> {
    /// Offset, gain and sum of squares at these times.
    fn at(&self, times: Times) -> Option<([f64; 2], f64)> {
        let rows: Vec<([f64; 2], f64)> =
            filtered(self.period_s, self.commands, times).into_iter().map(|x| [1.0, x]).zip(self.values.iter().copied()).collect();
        let fit = Fit::of(&rows).ok()?;
        let [offset, gain] = fit.coefficients;
        let squares = rows.iter().map(|(columns, value)| (value - offset - gain * columns[1]).powi(2)).sum();
        Some(([offset, gain], squares))
    }

    /// Rows of the derivatives by offset, gain, dead time and time constant, and the residual.
    fn linearised(&self, [offset, gain]: [f64; 2], times: Times) -> Vec<([f64; 4], f64)> {
        let here = filtered(self.period_s, self.commands, times);
        let step_s = 1e-3 * self.period_s;
        let later = filtered(self.period_s, self.commands, (times.0 + step_s, times.1));
        let slower = filtered(self.period_s, self.commands, (times.0, times.1 + step_s));
        (0..here.len())
            .map(|index| {
                let x = here[index];
                let columns = [1.0, x, gain * (later[index] - x) / step_s, gain * (slower[index] - x) / step_s];
                (columns, self.values[index] - offset - gain * x)
            })
            .collect()
    }

    /// The best pair of a grid: dead times up to half of the time, time constants from a quarter of a sample to half of the time.
    fn on_a_grid(&self) -> (Times, f64) {
        let longest_s = self.period_s * self.commands.len() as f64;
        let (mut best, mut at) = (f64::INFINITY, (0.0, 0.1 * longest_s));
        for dead in 0..GRID {
            for constant in 0..GRID {
                let share = |index: u32| f64::from(index) / f64::from(GRID - 1);
                let times = (
                    0.5 * longest_s * share(dead).powi(2), //
                    0.25 * self.period_s * (2.0 * longest_s / self.period_s).powf(share(constant)),
                );
                if let Some((_, squares)) = self.at(times)
                    && squares < best
                {
                    (best, at) = (squares, times);
                }
            }
        }
        (at, best)
    }

    fn refined(&self, (mut times, mut best): (Times, f64)) -> Times {
        for _ in 0..ROUNDS {
            let Some((linear, _)) = self.at(times) else { break };
            let Ok(fit) = Fit::of(&self.linearised(linear, times)) else { break };
            let [_, _, dead_step_s, constant_step_s] = fit.coefficients;
            let halved = std::iter::successors(Some(1.0), |factor| (*factor > 1e-6).then_some(0.5 * factor));
            let better = halved
                .map(|factor| ((times.0 + factor * dead_step_s).max(0.0), times.1 + factor * constant_step_s))
                .filter(|tried| tried.1 > 0.0)
                .find_map(|tried| self.at(tried).filter(|(_, squares)| *squares < best).map(|(_, squares)| (tried, squares)));
            let Some((tried, squares)) = better else { break };
            let gained = best - squares;
            (times, best) = (tried, squares);
            if gained < 1e-14 * best {
                break;
            }
        }
        times
    }
}

impl Response {
    /// Of a command and a value at equal periods, in s.
    ///
    /// # Errors
    /// With fewer than eight samples, or when nothing responds.
    pub fn of(period_s: f64, commands: &[f64], values: &[f64]) -> Result<Self, CalibrationError> {
        let count = commands.len().min(values.len());
        if count < FEWEST {
            return Err(CalibrationError::TooFew { found: count, wanted: FEWEST });
        }
        let (commands, values) = (&commands[..count], &values[..count]);
        if commands.iter().chain(values).any(|value| !value.is_finite()) || period_s.is_nan() || period_s <= 0.0 {
            return Err(CalibrationError::NotFinite("a sample"));
        }
        let nothing = || CalibrationError::NoResponse("nothing responds to the command".to_owned());
        let search = Search { period_s, commands, values };
        let times = search.refined(search.on_a_grid());
        let ([offset, gain], squares) = search.at(times).ok_or_else(nothing)?;
        let mean = values.iter().sum::<f64>() / count as f64;
        let total: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        if gain == 0.0 || squares > UNEXPLAINED * total {
            return Err(nothing());
        }
        let fit = Fit::of(&search.linearised([offset, gain], times));
        let estimate = |value: f64, gradient: [f64; 4]| match &fit {
            Ok(fit) => fit.estimate(value, gradient),
            Err(_) => Estimate { value, half_width: None },
        };
        Ok(Self {
            dead_time_s: estimate(times.0, [0.0, 0.0, 1.0, 0.0]),
            time_constant_s: estimate(times.1, [0.0, 0.0, 0.0, 1.0]),
            gain,
            fitted: filtered(period_s, commands, times).into_iter().map(|x| offset + gain * x).collect(),
            residual: (squares / (count - 4) as f64).sqrt(),
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const PERIOD_S: f64 = 0.002;

    /// A ramp of the command from zero to one, of this length, and the closed form of the response to it.
    fn ramp(ramp_s: f64, dead_s: f64, constant_s: f64, gain: f64, noise: f64) -> (Vec<f64>, Vec<f64>) {
        // Integral of the step response: the response to a ramp of slope one.
        let integral = |time_s: f64| if time_s <= 0.0 { 0.0 } else { time_s - constant_s * (1.0 - (-time_s / constant_s).exp()) };
        let times = (0..300).map(|index| f64::from(index) * PERIOD_S - 0.02);
        let command = |time_s: f64| (time_s / ramp_s).clamp(0.0, 1.0);
        let value = |(index, time_s): (usize, f64)| {
            let wobble = noise * (index as f64 * 2.399_963).sin() * std::f64::consts::SQRT_2;
            gain * (integral(time_s - dead_s) - integral(time_s - dead_s - ramp_s)) / ramp_s + wobble
        };
        // Held between samples, a ramp is early by half a period on average.
        (times.clone().map(|time_s| command(time_s + 0.5 * PERIOD_S)).collect(), times.enumerate().map(value).collect())
    }

    #[test]
    fn a_quiet_channel_is_no_response() {
        let (commands, values) = ramp(0.01, 0.02, 0.05, 0.0, 0.01);
        assert!(matches!(Response::of(PERIOD_S, &commands, &values), Err(CalibrationError::NoResponse(_))));
        assert!(matches!(Response::of(PERIOD_S, &[0.0], &[1.0]), Err(CalibrationError::TooFew { .. })));
        assert!(matches!(Response::of(PERIOD_S, &[1.0; 20], &values), Err(CalibrationError::NoResponse(_))));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn the_closed_form_of_a_ramp_is_found_up_and_down(
            ramp_s in 0.004..0.1_f64, dead_s in 0.0..0.06_f64, constant_s in 0.01..0.1_f64, size in 0.2..2.0_f64, falls in any::<bool>(),
        ) {
            let gain = if falls { -size } else { size };
            let (commands, values) = ramp(ramp_s, dead_s, constant_s, gain, 0.0);
            let response = Response::of(PERIOD_S, &commands, &values).unwrap();
            // Within what is lost by looking every 2 ms.
            prop_assert!((response.dead_time_s.value - dead_s).abs() < 1e-3, "{} for {dead_s}", response.dead_time_s.value);
            prop_assert!((response.time_constant_s.value - constant_s).abs() < 1e-3 + 0.01 * constant_s, "{:?}", response.time_constant_s);
            prop_assert!((response.gain / gain - 1.0).abs() < 0.02);
        }

        /// With noise of 2 % of the step the interval holds the truth and is no wider than it must be.
        #[test]
        fn noise_widens_the_interval_about_the_truth(dead_s in 0.01..0.05_f64, constant_s in 0.02..0.06_f64) {
            let (commands, values) = ramp(0.03, dead_s, constant_s, 1.0, 0.02);
            let response = Response::of(PERIOD_S, &commands, &values).unwrap();
            let half = response.time_constant_s.half_width.unwrap();
            prop_assert!(half > 1e-4 && half < 0.01, "{half}");
            prop_assert!((response.time_constant_s.value - constant_s).abs() < 2.0 * half, "{:?}", response.time_constant_s);
        }
    }
}
