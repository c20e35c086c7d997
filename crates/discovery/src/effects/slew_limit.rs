//! `slew-limit`: the valve passes only so much air, `|dv/dt| <= S`; one limit, or one for each direction, or such that set in gradually.

use crate::chain::columns::Filter;
use crate::chain::elementary;
use crate::chain::filters::{grid, ladder};
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec, Told};
use crate::chain::side_by_side::leads_input;
use crate::data::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&SYMMETRIC, &SYMMETRIC_HELD, &TWO_SIDED, &TWO_SIDED_HELD, &GRADUAL, &GRADUAL_HELD];

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

/// Limits that set in gradually.
struct Gradual {
    form: Told,
    /// As in [`Limit`].
    held: bool,
}

static GRADUAL: Gradual = Gradual { form: ("gradual", "limits that set in gradually"), held: false };

static GRADUAL_HELD: Gradual =
    Gradual { form: ("gradual-held", "limits that set in gradually, of a command that holds between samples"), held: true };

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
        let shares = grid(&[0.15, 0.4, 0.6, 0.8], &[0.15, 0.4, 0.6, 0.8]).into_iter().filter(|pair| pair[0] != pair[1]);
        shares.map(|pair| pair.into_iter().map(of_fastest).collect()).collect()
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let (up, down) = (parameters[0] * run.period_s, parameters[parameters.len() - 1] * run.period_s);
        let mut state = path[0];
        let mut last = path[0];
        for value in path {
            let target = if self.held { last } else { *value };
            state += (target - state).clamp(-down, up);
            last = *value;
            *value = state;
        }
    }
}

impl Form for Gradual {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                ONE,
                Parameter { name: "time_constant", quantity: Quantity::Time, low: 1e-3, high: 0.2, logarithmic: true },
                Parameter { name: "falling_over_rising", quantity: Quantity::Ratio, low: 0.2, high: 5.0, logarithmic: true },
            ],
            simpler_at: &[(1, 1e-3), (2, 1.0)],
            // While the limit is out of reach this is a lag.
            cost: Some(2 + usize::from(self.held)),
            ..Spec::new("slew-limit", self.form, Place::Flow)
        }
    }
    fn starts(&self, session: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let of = |share: f64| [0.7, 1.0, 1.4].map(|falling| vec![share * session.fastest_per_s, 0.01, falling]);
        ladder(0.1, 0.97, 6).into_iter().flat_map(of).collect()
    }
    leads_input!(|self, parameters, run| {
        let step_s = 0.5 * run.period_s;
        let rising = parameters[0] * step_s;
        let follow = 1.0 - (-step_s / parameters[1]).exp();
        Saturating { follow, falling: rising * parameters[2], rising, held: self.held }
    });
}

/// What [`Gradual`] does to the input: a lag while the error is small, the limit when it is large, `a e / (1 + |a e / S h|^3)^(1/3)` a step of
/// length `h`. A square in place of the cube would come to the limit so late that other effects look like what is missing.
#[derive(PartialEq)]
struct Saturating {
    /// Share of the error that a step takes away.
    follow: f64,
    /// The most that it takes away, and that it brings.
    falling: f64,
    rising: f64,
    held: bool,
}

impl Saturating {
    /// What a step, half a sample, makes of the state.
    #[inline(always)]
    fn towards(&self, target: f64, state: f64) -> f64 {
        let wanted = self.follow * (target - state);
        let steep = (wanted / if wanted < 0.0 { self.falling } else { self.rising }).abs();
        state + wanted * elementary::power(1.0 + steep * steep * steep, -1.0 / 3.0)
    }
}

impl Filter<2> for Saturating {
    fn begin(&self, first: f64) -> [f64; 2] {
        [first; 2]
    }
    #[inline(always)]
    fn step(&self, [state, last]: &mut [f64; 2], value: f64) -> f64 {
        // Written out, for a loop in here would keep recordings from going side by side.
        let middle = if self.held { *last } else { *last + 0.5 * (value - *last) };
        let half = self.towards(middle, *state);
        *state = self.towards(if self.held { *last } else { value }, half);
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
}
