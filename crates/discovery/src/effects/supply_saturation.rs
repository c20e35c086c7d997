//! `supply-saturation`: the supply's pressure is the most there is, `v = min(u, L)`, or hardly more: a relief valve lets `o (u - L)` pass. With a rounded
//! corner: of a width of its own, or, where a regulator droops long before its limit, `v = u / (1 + (u / L)^n)^(1 / n)`. A small tank, `p`, is emptied by
//! filling the muscle and fills again, `v = min(u, p)`, `dp/dt = (L - p) / T - k max(dv/dt, 0)`. Or the muscle fills through an inlet by what the supply has
//! above it, or follows the command where that is slower, `dv/dt = min((u - v) / S, (L - v) / T)`.

use crate::chain::columns::Filter;
use crate::chain::filters::grid;
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec};
use crate::chain::side_by_side::leads_input;
use crate::data::session::Run;

/// All forms.
pub const FORMS: &[&dyn Form] = &[&Corner, &Drooping, &Tank, &Inlet];

struct Corner;

struct Drooping;

struct Tank;

struct Inlet;

const NAME: &str = "supply-saturation";

const LIMIT: Parameter = Parameter { name: "limit", quantity: Quantity::Input, low: 0.3, high: 1.0, logarithmic: false };

/// A droop that is none: a sharp corner.
const SHARP: f64 = 300.0;

impl Form for Corner {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                LIMIT,
                Parameter { name: "rounding", quantity: Quantity::Ratio, low: 1e-3, high: 0.15, logarithmic: true },
                Parameter { name: "override", quantity: Quantity::Ratio, low: 0.0, high: 0.2, logarithmic: false },
            ],
            simpler_at: &[(1, 1e-3), (2, 0.0)],
            is_static: true,
            starts: || grid(&[&[0.5, 0.6, 0.7, 0.78, 0.85, 0.91, 0.96], &[0.005, 0.04], &[0.0, 0.06]]),
            ..Spec::new(NAME, ("rounded", "rounded corner"), Place::Supply)
        }
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        for value in path {
            let beyond = *value - parameters[0];
            *value -= 0.5 * (1.0 - parameters[2]) * (beyond + (beyond * beyond + parameters[1] * parameters[1]).sqrt());
        }
    }
}

impl Form for Drooping {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[LIMIT, Parameter { name: "sharpness", quantity: Quantity::Ratio, low: 4.0, high: SHARP, logarithmic: true }],
            simpler_at: &[(1, SHARP)],
            is_static: true,
            starts: || grid(&[&[0.55, 0.65, 0.75, 0.85, 0.94], &[10.0, 30.0]]),
            ..Spec::new(NAME, ("drooping", "a regulator that droops towards its limit"), Place::Supply)
        }
    }
    fn input(&self, parameters: &[f64], _: &Run, path: &mut [f64]) {
        path.iter_mut().for_each(|value| *value = drooping(*value, parameters[0], parameters[1]));
    }
}

/// What a regulator makes of a command: in logarithms, for a power of 300 is soon more than a number can be.
fn drooping(command: f64, limit: f64, sharpness: f64) -> f64 {
    if command <= 0.0 {
        return command;
    }
    let beyond = sharpness * (command / limit).ln();
    command * (-(beyond.max(0.0) + (-beyond.abs()).exp().ln_1p()) / sharpness).exp()
}

impl Form for Tank {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                LIMIT,
                Parameter { name: "emptied", quantity: Quantity::Ratio, low: 0.01, high: 1.0, logarithmic: true },
                Parameter { name: "filling_time", quantity: Quantity::Time, low: 0.1, high: 20.0, logarithmic: true },
            ],
            starts: || grid(&[&[0.6, 0.75, 0.9], &[0.05, 0.2], &[0.6, 3.0]]),
            ..Spec::new(NAME, ("tank", "a small tank that filling empties"), Place::Supply)
        }
    }
    leads_input!(|self, parameters, run| Supplied {
        limit: parameters[0],
        emptied: parameters[1],
        filled: 1.0 - (-run.period_s / parameters[2]).exp()
    });
}

/// What [`Tank`] does to the input; its memory is the tank's pressure, and the muscle's.
#[derive(PartialEq)]
struct Supplied {
    limit: f64,
    emptied: f64,
    filled: f64,
}

impl Filter<2> for Supplied {
    fn begin(&self, first: f64) -> [f64; 2] {
        [self.limit, first.min(self.limit)]
    }
    #[inline(always)]
    fn step(&self, [tank, muscle]: &mut [f64; 2], value: f64) -> f64 {
        *tank += self.filled * (self.limit - *tank);
        // What flows lowers the tank while it raises the muscle: they meet in between.
        let met = (*tank + self.emptied * *muscle) / (1.0 + self.emptied);
        let next = if value > *muscle { value.min(met.max(*muscle)) } else { value };
        *tank -= self.emptied * (next - *muscle).max(0.0);
        *muscle = next;
        next
    }
}

impl Form for Inlet {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                LIMIT,
                Parameter { name: "filling_time", quantity: Quantity::Time, low: 5e-3, high: 1.0, logarithmic: true },
                Parameter { name: "following_time", quantity: Quantity::Time, low: AT_ONCE_S, high: 0.1, logarithmic: true },
            ],
            simpler_at: &[(2, AT_ONCE_S)],
            starts: || grid(&[&[0.6, 0.75, 0.9], &[0.03, 0.12], &[0.01]]),
            ..Spec::new(NAME, ("inlet", "through an inlet that fills by what the supply has above the muscle"), Place::Supply)
        }
    }
    leads_input!(|self, parameters, run| {
        let of = |time_s: f64| 1.0 - (-run.period_s / LOOKS as f64 / time_s).exp();
        Let { limit: parameters[0], filled: of(parameters[1]), followed: of(parameters[2]) }
    });
}

/// What follows at once, s.
const AT_ONCE_S: f64 = 1e-4;

/// How often it looks between two samples.
const LOOKS: usize = 4;

/// What [`Inlet`] does to the input; its memory is the muscle's pressure and the last command.
#[derive(PartialEq)]
struct Let {
    limit: f64,
    /// Share of what is missing to the limit, and to the command, that a look brings.
    filled: f64,
    followed: f64,
}

impl Filter<2> for Let {
    fn begin(&self, first: f64) -> [f64; 2] {
        [first.min(self.limit), first]
    }
    #[inline(always)]
    fn step(&self, [muscle, last]: &mut [f64; 2], value: f64) -> f64 {
        for look in 0..LOOKS {
            let command = *last + (value - *last) * (look as f64 + 0.5) / LOOKS as f64;
            *muscle += (self.followed * (command - *muscle)).min(self.filled * (self.limit - *muscle));
        }
        *last = value;
        *muscle
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::session_of;

    /// What a tank makes of a ramp to twice its limit and a hold, `period_s` apart.
    fn supplied(parameters: [f64; 3], period_s: f64) -> Vec<f64> {
        let mut path: Vec<f64> = (0..(4.0 / period_s) as usize).map(|sample| (sample as f64 * period_s).min(1.4)).collect();
        let filled = 1.0 - (-period_s / parameters[2]).exp();
        Supplied { limit: parameters[0], emptied: parameters[1], filled }.run(&mut path);
        path
    }

    #[test]
    fn a_tank_is_emptied_by_what_it_fills_and_fills_again() {
        // By conservation, where nothing comes after: it and the muscle meet at `L / (1 + k)`.
        let closed = supplied([0.7, 0.2, 1e9], 0.01);
        assert!((closed[399] - 0.7 / 1.2).abs() < 1e-6 && closed[50] == 0.5, "{} {}", closed[50], closed[399]);
        // What comes after brings both to the limit, by whatever samples it is looked at.
        let [coarse, fine] = [0.01, 0.001].map(|period_s| supplied([0.7, 0.2, 0.8], period_s));
        assert!((coarse[399] - 0.7).abs() < 0.01, "{}", coarse[399]);
        assert!((0..400).all(|sample| (coarse[sample] - fine[10 * sample]).abs() < 2e-3));
    }

    #[test]
    fn a_relief_valve_passes_its_limit_by_its_override() {
        let run = session_of(400, 0.01, |time_s| time_s).runs.remove(0);
        let mut path = vec![0.3, 0.8, 1.0];
        Corner.input(&[0.6, 1e-3, 0.1], &run, &mut path);
        for (value, expected) in path.iter().zip([0.3, 0.62, 0.64]) {
            assert!((value - expected).abs() < 2e-3, "{path:?}");
        }
    }

    #[test]
    fn an_inlet_lets_in_by_what_the_supply_has_above_the_muscle() {
        let commands = |value: f64| -> Vec<f64> { (0..400).map(|sample| if (10..=200).contains(&sample) { value } else { 0.0 }).collect() };
        let [mut beyond, mut below] = [commands(2.0), commands(0.3)];
        for (path, law) in [(&mut beyond, [0.8, 0.1, 0.02]), (&mut below, [0.8, 0.001, 0.05])] {
            let session = session_of(400, 0.01, |time_s| time_s);
            Inlet.input(&law, &session.runs[0], path);
        }
        // In step 10 the command rises along a line: about a sample of the way is missing.
        let left = |time_s: f64, samples: f64| (-samples * 0.01 / time_s).exp();
        for (path, sample, expected, error) in [
            (&beyond, 20, 0.8 * (1.0 - left(0.1, 10.5)), 0.02),
            (&beyond, 200, 0.8, 1e-6),
            (&beyond, 211, 0.8 * left(0.02, 10.5), 0.02),
            (&below, 20, 0.3 * (1.0 - left(0.05, 10.5)), 0.01),
            (&below, 200, 0.3, 1e-6),
        ] {
            assert!((path[sample] - expected).abs() < error, "sample {sample}: {} instead of {expected}", path[sample]);
        }
    }

    #[test]
    fn a_droop_nears_its_limit_and_a_sharp_one_is_a_corner() {
        let of = |sharpness: f64| -> Vec<f64> { (-10..=200).map(|step| drooping(f64::from(step) * 0.01, 0.8, sharpness)).collect() };
        let (soft, sharp) = (of(8.0), of(SHARP));
        assert!((soft[90] - 0.8 * 0.5_f64.powf(0.125)).abs() < 1e-12, "{}", soft[90]);
        for (sample, value) in sharp.iter().enumerate() {
            let given = (sample as f64 - 10.0) * 0.01;
            assert!((value - given.min(0.8)).abs() < 2e-3 && (given > 0.0 || soft[sample] == given));
        }
    }
}
