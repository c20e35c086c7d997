//! `static-nonlinearity`: a curve without memory, of the pressure or of the displacement.

use std::collections::BTreeMap;

use crate::chain::columns::Columns;
use crate::chain::filters::grid;
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec, Told};
use crate::data::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Pressure, &Power, &CUBIC, &QUINTIC, &SShaped, &Pieces, &Parallel];

struct Pressure;

struct Power;

/// A polynomial of the output.
struct Displacement {
    form: Told,
    /// What the powers from the second on are called.
    powers: &'static [&'static str],
}

static CUBIC: Displacement =
    Displacement { form: ("output-cubic", "curve of the output: y = s + a s^2 + b s^3"), powers: &["quadratic", "cubic"] };

/// Bends both ways at both ends, as a laser's or a joint's characteristic may.
static QUINTIC: Displacement = Displacement {
    form: ("output-quintic", "curve of the output: y = s + a s^2 + b s^3 + c s^4 + d s^5"),
    powers: &["quadratic", "cubic", "quartic", "quintic"],
};

/// A logistic curve of the output that leaves zero and span where they are, or a share of it beside the straight line.
struct SShaped;

struct Parallel;

/// Straight pieces: what a stop or a joint with play at its ends does, and what no polynomial follows.
struct Pieces;

/// Pieces of equal length over the span.
const PIECES: usize = 8;

impl Form for Pressure {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "quadratic", quantity: Quantity::Ratio, low: -0.8, high: 0.8, logarithmic: false },
                Parameter { name: "cubic", quantity: Quantity::Ratio, low: -0.6, high: 0.6, logarithmic: false },
                Parameter { name: "quartic", quantity: Quantity::Ratio, low: -0.6, high: 0.6, logarithmic: false },
            ],
            is_static: true,
            simpler_at: &[(2, 0.0)],
            starts: || [-0.4, -0.15, 0.15, 0.4].into_iter().flat_map(|a| [vec![a, -0.08, 0.0], vec![a, 0.08, 0.0]]).collect(),
            ..Spec::new(
                "static-nonlinearity",
                ("input-cubic", "curve of the input: v = u + u (1 - u) (a + b (1 - 2 u) + c (1 - 2 u)^2)"),
                Place::Muscle,
            )
        }
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        for value in path {
            // Outside the span the curve goes on straight.
            let u = value.clamp(0.0, 1.0);
            *value += u * (1.0 - u) * (parameters[0] + (1.0 - 2.0 * u) * (parameters[1] + parameters[2] * (1.0 - 2.0 * u)));
        }
    }
}

/// Hill's curve (`b > 1`), and its inverse, which gets ever steeper (`b < 1`). A power has no finite slope or curvature at zero, which no polynomial follows: what is
/// missing there would pass for a threshold.
impl Form for Power {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "exponent", quantity: Quantity::Ratio, low: 0.3, high: 4.0, logarithmic: true },
                Parameter { name: "bulge", quantity: Quantity::Ratio, low: 0.1, high: 40.0, logarithmic: true },
            ],
            is_static: true,
            simpler_at: &[(1, 1.0)],
            starts: || [grid(&[&[0.6, 0.85, 1.2, 1.6], &[1.0]]), grid(&[&[1.2, 2.2], &[2.0, 5.0]]), grid(&[&[1.0, 2.0], &[0.4]])].concat(),
            ..Spec::new(
                "static-nonlinearity",
                ("input-rational", "power of the input that saturates or steepens: v = b u^n / (1 + (b - 1) u^n)"),
                Place::Muscle,
            )
        }
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        let [exponent, bulge] = [parameters[0], parameters[1]];
        path.iter_mut().for_each(|value| {
            let power = value.abs().powf(exponent);
            *value = value.signum() * bulge * power / (1.0 + (bulge - 1.0) * power).max(MOST_STEEP);
        });
    }
}

/// A denominator below which a curve gets no steeper.
const MOST_STEEP: f64 = 0.05;

impl Form for Displacement {
    fn spec(&self) -> Spec {
        Spec { weights: self.powers.len(), needs_sum: true, ..Spec::new("static-nonlinearity", self.form, Place::Material) }
    }
    fn output(&self, _: &[f64], _: &Run, sum: &[f64], columns: &mut Columns) {
        for (power, _) in (2..).zip(self.powers) {
            columns.push(true, |sample| sum[sample].powi(power));
        }
    }
    fn tell(&self, _: &[f64], weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        let unit = &session.output_unit;
        let of = |((exponent, power), weight): ((i32, &&str), &f64)| {
            let per = if exponent == 1 { String::new() } else { exponent.to_string() };
            (format!("{power}_per_{unit}{per}"), weight / session.output_scale.powi(exponent))
        };
        (1..).zip(self.powers).zip(weights).map(of).collect()
    }
}

impl Form for SShaped {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "steepness", quantity: Quantity::Ratio, low: 1.0, high: 30.0, logarithmic: true },
                Parameter { name: "middle", quantity: Quantity::Output, low: 0.02, high: 1.2, logarithmic: false },
            ],
            weights: 1,
            needs_sum: true,
            starts: || grid(&[&[5.0, 12.0], &[0.25, 0.5, 0.75]]),
            ..Spec::new("static-nonlinearity", ("output-logistic", "logistic curve of the output, or a share of it"), Place::Material)
        }
    }
    fn output(&self, parameters: &[f64], _: &Run, sum: &[f64], columns: &mut Columns) {
        let logistic = |s: f64| 1.0 / (1.0 + (parameters[0] * (parameters[1] - s)).exp());
        let (low, high) = (logistic(0.0), logistic(1.0));
        columns.push(true, |sample| (logistic(sum[sample]) - low) / (high - low) - sum[sample]);
    }
}

impl Form for Parallel {
    fn spec(&self) -> Spec {
        Spec {
            weights: 2,
            ..Spec::new(
                "static-nonlinearity",
                ("beside-hysteresis", "curve of the input beside the hysteresis: y = s + a u^2 + b u^3"),
                Place::Material,
            )
        }
    }
    fn output(&self, _: &[f64], run: &Run, _: &[f64], columns: &mut Columns) {
        columns.push(true, |sample| run.input[sample] * run.input[sample]);
        columns.push(true, |sample| run.input[sample].powi(3));
    }
    fn tell(&self, _: &[f64], weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        let (input, output) = (&session.input_unit, &session.output_unit);
        BTreeMap::from([
            (format!("quadratic_{output}_per_{input}2"), weights[0] * session.output_scale / session.input_scale.powi(2)),
            (format!("cubic_{output}_per_{input}3"), weights[1] * session.output_scale / session.input_scale.powi(3)),
        ])
    }
}

impl Form for Pieces {
    fn spec(&self) -> Spec {
        Spec {
            weights: PIECES - 1,
            needs_sum: true,
            ..Spec::new("static-nonlinearity", ("output-pieces", "curve of the output: eight straight pieces"), Place::Material)
        }
    }
    fn output(&self, _: &[f64], _: &Run, sum: &[f64], columns: &mut Columns) {
        for corner in 1..PIECES {
            let corner = corner as f64 / PIECES as f64;
            columns.push(true, |sample| (sum[sample] - corner).max(0.0));
        }
    }
    fn tell(&self, _: &[f64], weights: &[f64], session: &Session) -> BTreeMap<String, f64> {
        let of = |(corner, weight): (usize, &f64)| {
            let place = corner as f64 / PIECES as f64 * session.output_scale.abs();
            (format!("slope_more_from_{place:.3}_{}", session.output_unit), *weight)
        };
        (1..).zip(weights).map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use recording::{Recording, Signal};
    use std::path::Path;

    #[test]
    fn a_power_saturates_or_steepens_or_is_a_plain_one() {
        let input: Vec<f64> = (0..1000).map(|sample| f64::from(sample) / 999.0).collect();
        let time_s = input.iter().map(|value| 20.0 * value).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        let curve = |parameters: &[f64]| {
            let mut path = vec![0.25, 0.5, 1.0, -0.5];
            Power.input(parameters, run, &mut path);
            path
        };
        let is = |parameters: &[f64], wanted: [f64; 4]| {
            curve(parameters).iter().zip(wanted).all(|(found, wanted)| (found - wanted).abs() < 1e-12)
        };
        assert!(is(&[2.0, 1.0], [0.0625, 0.25, 1.0, -0.25]));
        // Hill's curve, half of it at half of the span, and its inverse.
        assert!(is(&[2.0, 5.0], [0.25, 0.625, 1.0, -0.625]));
        assert!(is(&[1.0, 0.2], [0.0625, 1.0 / 6.0, 1.0, -1.0 / 6.0]));
    }
}
