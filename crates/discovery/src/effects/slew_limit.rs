//! `slew-limit`: the valve passes only so much air, `|dv/dt| <= S`; one limit, or one for each direction, of a pressure that follows at once or lags.

use crate::chain::columns::Filter;
use crate::chain::filters::{grid, ladder, lag_coefficients};
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec, Told};
use crate::chain::side_by_side::leads_input;
use crate::data::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&SYMMETRIC, &SYMMETRIC_HELD, &TWO_SIDED, &TWO_SIDED_HELD, &Lagging];

/// A limit of the rate, or one for each direction.
struct Limit {
    form: Told,
    parameters: &'static [Parameter],
    /// Whether the command holds from one sample to the next, as behind a converter, instead of going straight: then the pressure of a
    /// sample is on the way to the command of the sample before.
    held: bool,
}

const ONE: Parameter = Parameter { name: "limit", quantity: Quantity::InputRate, low: 0.02, high: 200.0, logarithmic: true };

const RISING: Parameter = Parameter { name: "rising_limit", ..ONE };

const FALLING: Parameter = Parameter { name: "falling_limit", ..ONE };

const fn limit(form: Told, parameters: &'static [Parameter], held: bool) -> Limit {
    Limit { form, parameters, held }
}

static SYMMETRIC: Limit = limit(("one", "one limit"), &[ONE], false);

static SYMMETRIC_HELD: Limit = limit(("one-held", "one limit, of a command that holds between samples"), &[ONE], true);

static TWO_SIDED: Limit = limit(("two-sided", "a limit for each direction"), &[RISING, FALLING], false);

static TWO_SIDED_HELD: Limit =
    limit(("two-sided-held", "a limit for each direction, of a command that holds between samples"), &[RISING, FALLING], true);

/// Limits of a pressure that lags.
pub struct Lagging;

impl Form for Limit {
    fn spec(&self) -> Spec {
        Spec {
            parameters: self.parameters,
            cost: Some(self.parameters.len() + usize::from(self.held)),
            ..Spec::new("slew-limit", self.form, Place::Flow)
        }
    }
    fn starts(&self, session: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let of_fastest = |share: f64| share * session.fastest_per_s;
        if self.parameters.len() == 1 {
            return ladder(0.05, 0.97, 9).into_iter().map(|share| vec![of_fastest(share)]).collect();
        }
        // Limits that differ little show at the fastest strokes only: pairs near each other as well as far apart.
        let shares = grid(&[&[0.15, 0.4, 0.6, 0.8], &[0.15, 0.4, 0.6, 0.8]]).into_iter().filter(|pair| pair[0] != pair[1]);
        shares.map(|pair| pair.into_iter().map(of_fastest).collect()).collect()
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let (up, down) = (parameters[0] * run.period_s, parameters[parameters.len() - 1] * run.period_s);
        let (mut state, mut last) = (path[0], path[0]);
        for value in path {
            let target = if self.held { last } else { *value };
            state += (target - state).clamp(-down, up);
            last = *value;
            *value = state;
        }
    }
}

impl Form for Lagging {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                ONE,
                Parameter { name: "time_constant", quantity: Quantity::Time, low: 1e-3, high: 0.2, logarithmic: true },
                Parameter { name: "falling_over_rising", quantity: Quantity::Ratio, low: 0.2, high: 5.0, logarithmic: true },
            ],
            simpler_at: &[(1, 1e-3), (2, 1.0)],
            ..Spec::new("slew-limit", ("lagging", "limits of a pressure that lags"), Place::Flow)
        }
    }
    fn starts(&self, session: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let of = |share: f64| [0.7, 1.0, 1.4].map(|falling| vec![share * session.fastest_per_s, 0.01, falling]);
        ladder(0.1, 0.97, 6).into_iter().flat_map(of).collect()
    }
    leads_input!(|self, parameters, run| {
        let step_s = 0.5 * run.period_s;
        let rising = parameters[0] * step_s;
        Within { lag: lag_coefficients(parameters[1], step_s), falling: rising * parameters[2], rising }
    });
}

/// What [`Lagging`] does to the input.
#[derive(PartialEq)]
struct Within {
    lag: (f64, f64, f64),
    /// The most that a step takes away, and that it brings.
    falling: f64,
    rising: f64,
}

impl Within {
    /// What a step, half a sample, in which the command goes straight makes of the state.
    #[inline(always)]
    fn towards(&self, [from, to]: [f64; 2], state: f64) -> f64 {
        let (keep, now, before) = self.lag;
        (keep * state + now * to + before * from).max(state - self.falling).min(state + self.rising)
    }
}

impl Filter<2> for Within {
    fn begin(&self, first: f64) -> [f64; 2] {
        [first; 2]
    }
    #[inline(always)]
    fn step(&self, [state, last]: &mut [f64; 2], value: f64) -> f64 {
        // Written out, for a loop in here would keep recordings from going side by side.
        let middle = *last + 0.5 * (value - *last);
        let half = self.towards([*last, middle], *state);
        *state = self.towards([middle, value], half);
        *last = value;
        *state
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use recording::{Recording, Signal};
    use std::path::Path;

    #[test]
    fn a_command_that_holds_between_samples_moves_the_pressure_a_sample_later() {
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = (0..1000).map(|sample| if sample < 500 { 0.0 } else { 1.0 }).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        let through = |limit: &Limit, parameters: &[f64]| {
            let mut path = run.input.clone();
            limit.input(parameters, run, &mut path);
            path[498..504].iter().map(|value| (value * 100.0).round() as i32).collect::<Vec<_>>()
        };
        // Five spans a second are a tenth of a span in 20 ms.
        assert_eq!(through(&SYMMETRIC, &[5.0]), [0, 0, 10, 20, 30, 40]);
        assert_eq!(through(&SYMMETRIC_HELD, &[5.0]), [0, 0, 0, 10, 20, 30]);
        assert_eq!(through(&TWO_SIDED, &[10.0, 5.0]), [0, 0, 20, 40, 60, 80]);
    }

    #[test]
    fn a_pressure_that_lags_follows_its_law_within_the_limits() {
        let (period_s, time_s, [rising, falling]) = (0.02, 0.03, [1.0, 1.5]);
        let input: Vec<f64> = (0..600).map(|sample| 0.5 - 0.5 * (4.0 * f64::from(sample) * period_s).cos()).collect();
        let mut path = input.clone();
        let lag = lag_coefficients(time_s, 0.5 * period_s);
        Within { lag, falling: 0.5 * falling * period_s, rising: 0.5 * rising * period_s }.run(&mut path);
        // Small steps of Euler's.
        let mut state = input[0];
        for (sample, value) in path.iter().enumerate().skip(1) {
            for look in 0..200 {
                let share = (f64::from(look) + 0.5) / 200.0;
                let command = input[sample - 1] + share * (input[sample] - input[sample - 1]);
                state += 1e-4 * ((command - state) / time_s).clamp(-falling, rising);
            }
            assert!((value - state).abs() < 3e-3, "sample {sample}: {value} instead of {state}");
        }
    }
}
