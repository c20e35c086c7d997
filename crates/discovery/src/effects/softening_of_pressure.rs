//! `first-cycle-softening` before the hysteresis: the virgin muscle makes another use of the pressure, and needs one to begin with,
//! `v = u (1 - A F(c)) - B F(c)`, not below rest. What works it, `c`, is the way of the input since the recording began. Long strokes may work it more than
//! as many short ones, or hardly more, so that strokes count: `dc = (q + 1) x^q |du|`, a way `x` after a turn.

use crate::chain::columns::Filter;
use crate::chain::elementary;
use crate::chain::filters::with;
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec};
use crate::chain::side_by_side::leads_input;
use crate::data::session::Run;

/// The form.
pub const OF_THE_PRESSURE: OfThePressure = OfThePressure;

/// Of the pressure before the hysteresis.
pub struct OfThePressure;

impl Form for OfThePressure {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "missing_share", quantity: Quantity::Ratio, low: -0.5, high: 0.5, logarithmic: false },
                Parameter { name: "missing_pressure", quantity: Quantity::Input, low: -0.3, high: 0.3, logarithmic: false },
                Parameter { name: "distance_in_input_spans", quantity: Quantity::Ratio, low: 0.3, high: 20.0, logarithmic: true },
                Parameter { name: "power_of_the_stroke", quantity: Quantity::Ratio, low: -0.7, high: 4.0, logarithmic: false },
            ],
            simpler_at: &[(0, 0.0), (1, 0.0), (3, 0.0)],
            starts: || {
                let sizes = [[-0.12, 0.0], [0.12, 0.0], [0.0, 0.08]].map(Vec::from).to_vec();
                with(with(sizes, &[1.0, 4.0]), &[-0.5, 2.0])
            },
            ..Spec::new(
                "first-cycle-softening",
                ("of-the-pressure", "of the pressure's effect, with the strokes since the recording began"),
                Place::Muscle,
            )
        }
    }
    leads_input!(|self, parameters, _run| {
        let [missing, begins_at, spans, power] = [0, 1, 2, 3].map(|at: usize| parameters[at]);
        Virgin { missing, begins_at, spans, power }
    });
}

/// What [`OfThePressure`] does to the input; its memory is the last input, where the stroke turned and which way it goes, and what has worked it.
#[derive(PartialEq)]
struct Virgin {
    missing: f64,
    begins_at: f64,
    spans: f64,
    power: f64,
}

impl Filter<4> for Virgin {
    fn begin(&self, first: f64) -> [f64; 4] {
        [first, first, 0.0, 0.0]
    }
    #[inline(always)]
    fn step(&self, [last, turned, way, worked]: &mut [f64; 4], value: f64) -> f64 {
        let moved = value - *last;
        if moved * *way < 0.0 {
            *turned = *last;
        }
        *way = if moved == 0.0 { *way } else { moved };
        // The integral of `(q + 1) x^q` over the way.
        let up_to = |place: f64| elementary::power((place - *turned).abs(), self.power + 1.0);
        *worked += up_to(value) - up_to(*last);
        *last = value;
        let left = elementary::exp(-*worked / self.spans);
        (value - (self.missing * value + self.begins_at) * left).max(value.min(0.0))
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::SQRT_2;

    use super::*;

    #[test]
    fn a_long_stroke_works_more_than_as_many_short_ones() {
        // A half up, and down again, twice; or all of it at once.
        let short = [0.0, 0.25, 0.5, 0.2, 0.0, 0.5, 0.0];
        let long = [0.0, 0.5, 1.0, 0.4, 0.0];
        for (power, of_short, of_long) in [(0.0, 2.0, 2.0), (2.0, 0.5, 2.0), (-0.5, 2.0 * SQRT_2, 2.0)] {
            for (input, worked) in [(&short[..], of_short), (&long[..], of_long)] {
                let mut path = [input, &[1.0]].concat();
                Virgin { missing: 0.2, begins_at: 0.0, spans: 1.5, power }.run(&mut path);
                // The last step is a way of one more.
                let expected = 1.0 - 0.2 * (-(worked + 1.0) / 1.5_f64).exp();
                assert!((path[input.len()] - expected).abs() < 1e-6, "{power}: {} instead of {expected}", path[input.len()]);
            }
        }
    }
    #[test]
    fn a_pressure_to_begin_with_is_gone_after_strokes_and_never_below_rest() {
        let mut path = vec![0.0, 0.04, 1.0, 0.0, 1.0];
        Virgin { missing: 0.0, begins_at: 0.1, spans: 1.5, power: 0.0 }.run(&mut path);
        let missing = |travelled: f64| 0.1 * (-travelled / 1.5).exp();
        assert_eq!(path[..2], [0.0, 0.0]);
        assert!((path[2] - (1.0 - missing(1.0))).abs() < 1e-12 && (path[4] - (1.0 - missing(3.0))).abs() < 1e-12, "{path:?}");
    }
}
