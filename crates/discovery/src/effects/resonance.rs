//! `resonance`: something swings: the tip, a mass on a spring behind the hysteresis; a part of the tip, when the sensor looks at a place
//! that is held elsewhere too; or the pressure before the hysteresis, air in a tube (Helmholtz) or a regulator that overshoots; on the gas in the
//! muscle, which is the stiffer the higher its pressure, `1 + k v`; its frequency is that at half of the span. Where drag or stiffness change, it matters
//! when between two samples a command jumps: that is a parameter then.

use std::f64::consts::PI;

use crate::chain::columns::{Columns, Filter};
use crate::chain::filters::{grid, ladder};
use crate::chain::form::{Form, Limits, Parameter, Place, Quantity, Spec, Told};
use crate::data::session::{Run, Session};
use crate::effects::{dead_time, pneumatic_lag};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&TIP, &SHAKEN, &CHANGING_TIP, &PART_OF_TIP, &PRESSURE, &GAS_SPRING];

/// Something that swings as a whole, or by the share that is a third parameter.
struct Swinging {
    form: Told,
    place: Place,
    parameters: &'static [Parameter],
    /// Whether the drag is one against what moves it, and moves it too.
    shaken: bool,
}

static TIP: Swinging = Swinging { form: ("tip", "swinging tip"), place: Place::Tip, parameters: &[FREQUENCY, DAMPING], shaken: false };

/// Base excitation (Den Hartog 1956, section 2.12).
static SHAKEN: Swinging = Swinging { form: ("shaken-tip", "swinging tip, moved by its drag as well"), shaken: true, ..TIP };

/// What else holds the place that the sensor looks at follows at once.
static PART_OF_TIP: Swinging = Swinging {
    form: ("part-of-tip", "a part of the tip swings"),
    parameters: &[
        FREQUENCY,
        DAMPING,
        Parameter { name: "swinging_share", quantity: Quantity::Ratio, low: 0.02, high: 0.98, logarithmic: false },
    ],
    ..TIP
};

/// Damped more than this it no longer swings, and any lag or delay would pass for it.
const DAMPING_OF_AIR: Parameter = Parameter { high: 0.6, ..DAMPING };

static PRESSURE: Swinging =
    Swinging { form: ("pressure", "swinging pressure"), place: Place::Tube, parameters: &[FREQUENCY, DAMPING_OF_AIR], shaken: false };

const FREQUENCY: Parameter = Parameter { name: "frequency", quantity: Quantity::Frequency, low: 0.4, high: 15.0, logarithmic: true };

/// Growth of the damping ratio with the speed over that of a swing through the span.
const DRAG: Parameter = Parameter { name: "drag", quantity: Quantity::Ratio, low: 0.0, high: 10.0, logarithmic: false };

/// Where within a sample the command has jumped half of its way, when it jumps: a step that is set behind a sample is over long before the next one.
const JUMPS_AT: Parameter =
    Parameter { name: "jumps_at_share_of_a_sample", quantity: Quantity::Ratio, low: 0.02, high: 0.98, logarithmic: false };

/// As if it moved by a straight line.
const MIDWAY: f64 = 0.5;

const DAMPING: Parameter = Parameter { name: "damping_ratio", quantity: Quantity::Ratio, low: 0.01, high: 0.95, logarithmic: true };

/// A swinging mass that starts at rest; exact for straight lines between samples.
#[derive(PartialEq)]
struct Swing {
    position: [f64; 2],
    speed: [f64; 2],
    /// How far it is behind a command of this slope, s.
    behind_s: f64,
    /// What the drag carries along, per unit of its speed, s.
    carried_s: f64,
    /// Share of the swinging mass in what the sensor sees.
    share: f64,
    period_s: f64,
}

impl Swing {
    fn new(frequency_hz: f64, damping: f64, period_s: f64) -> Self {
        let omega = 2.0 * PI * frequency_hz;
        let damped = omega * (1.0 - damping * damping).max(1e-6).sqrt();
        let decay = (-damping * omega * period_s).exp();
        let (sine, cosine) = (damped * period_s).sin_cos();
        let ratio = damping * omega / damped;
        Self {
            position: [decay * (cosine + ratio * sine), decay * sine / damped],
            speed: [-decay * omega * omega * sine / damped, decay * (cosine - ratio * sine)],
            behind_s: 2.0 * damping / omega,
            carried_s: 0.0,
            share: 1.0,
            period_s,
        }
    }
}

impl Filter<3> for Swing {
    fn begin(&self, first: f64) -> [f64; 3] {
        [first, 0.0, first]
    }
    #[inline(always)]
    fn step(&self, [place, rate, last]: &mut [f64; 3], value: f64) -> f64 {
        let slope = (value - *last) / self.period_s;
        let behind = self.behind_s * slope;
        let (off, off_rate) = (*place - (*last - behind), *rate - slope);
        *place = self.position[0] * off + self.position[1] * off_rate + value - behind;
        *rate = self.speed[0] * off + self.speed[1] * off_rate + slope;
        *last = value;
        self.share * (*place + self.carried_s * *rate) + (1.0 - self.share) * value
    }
}

/// Damping ratio from which on a delay and a lag are tried in its place.
const HARDLY_SWINGS: f64 = 0.4;

/// Angle that one step of the integration turns by at most, and the most steps on a straight line of the input.
const STEP: [f64; 2] = [0.3, 64.0];

/// Ways of the sample before, and of the span on top: more within a sample is a jump.
const JUMPS_BY: [f64; 2] = [4.0, 0.02];

/// The steps that a sample is integrated in: shares of the input's way where each begins and ends, and of the sample that it takes. The input had moved by
/// `moved` in the sample before; it moves by a straight line, over the whole sample or as far to either side of a jump as there is room.
fn steps([before, value, moved]: [f64; 3], jumps_at: f64, turns: f64) -> impl Iterator<Item = ([f64; 2], f64)> {
    let at = if (value - before).abs() > JUMPS_BY[0] * moved + JUMPS_BY[1] { jumps_at } else { MIDWAY };
    let half = at.min(1.0 - at);
    let share = move |place: f64| ((place - at + half) / (2.0 * half)).clamp(0.0, 1.0);
    let lines = [[0.0, at - half], [at - half, at + half], [at + half, 1.0]].into_iter().filter(|[from, to]| to > from);
    lines.flat_map(move |[from, to]| {
        let count = ((to - from) * turns / STEP[0]).ceil().clamp(1.0, STEP[1]);
        let place = move |step: u32| share(from + (to - from) * f64::from(step) / count);
        (0..count as u32).map(move |step| ([place(step), place(step + 1)], (to - from) / count))
    })
}

/// One step of Runge and Kutta's fourth order; `slope` hears which of its four looks it is, and the input there, which moves by a straight line.
#[inline(always)]
fn runge_kutta(state: [f64; 2], [from, to]: [f64; 2], step_s: f64, mut slope: impl FnMut(usize, [f64; 2], f64) -> [f64; 2]) -> [f64; 2] {
    let on = |slope: [f64; 2], by_s: f64| [0, 1].map(|at: usize| state[at] + by_s * slope[at]);
    let first = slope(0, state, from);
    let second = slope(1, on(first, 0.5 * step_s), 0.5 * (from + to));
    let third = slope(2, on(second, 0.5 * step_s), 0.5 * (from + to));
    let fourth = slope(3, on(third, step_s), to);
    on([0, 1].map(|at: usize| (first[at] + 2.0 * (second[at] + third[at]) + fourth[at]) / 6.0), step_s)
}

/// Something that swings, against a drag that grows with its speed, on a stiffness that changes.
struct Changing {
    form: Told,
    place: Place,
    parameters: &'static [Parameter],
}

/// A tip, the stiffer the farther it is bent or swings out (Duffing 1918).
static CHANGING_TIP: Changing = Changing {
    form: ("changing-tip", "swinging tip, its drag or its stiffness not in proportion"),
    place: Place::Tip,
    parameters: &[
        FREQUENCY,
        DAMPING,
        DRAG,
        Parameter { name: "stiffening", quantity: Quantity::Ratio, low: -0.8, high: 3.0, logarithmic: false },
        JUMPS_AT,
        Parameter { name: "hardening", quantity: Quantity::Ratio, low: -10.0, high: 200.0, logarithmic: false },
    ],
};

/// Air in a tube on the gas of the muscle.
static GAS_SPRING: Changing = Changing {
    form: ("gas-spring", "swinging pressure, its drag or its stiffness not in proportion"),
    place: Place::Tube,
    parameters: &[
        FREQUENCY,
        DAMPING_OF_AIR,
        DRAG,
        Parameter { name: "stiffening", quantity: Quantity::PerInput, low: 0.0, high: 5.0, logarithmic: false },
        JUMPS_AT,
    ],
};

/// How it would swing on its own, and for each sample the place and the rate that a unit of its place, of its rate, and of its input before and behind
/// come to: by these the columns swing that add up to it.
struct Along {
    swung: Vec<f64>,
    units: Vec<[[f64; 2]; 4]>,
}

impl Changing {
    /// Along a displacement, `w' = r`, `r' = o^2 (1 + k s + h (w - s)^2) (s - w) - 2 o (D + d |r| / o) r`, or a pressure, `w' = r (1 + k w) / (1 + k / 2)`: what
    /// has flowed, `r`, raises it by the gas's own.
    fn along(&self, parameters: &[f64], path: &[f64], period_s: f64) -> Along {
        let [frequency_hz, damping, drag, stiffening, jumps_at] = [0, 1, 2, 3, 4].map(|at| parameters[at]);
        let (omega, hardening, is_gas) = (2.0 * PI * frequency_hz, parameters.get(5).copied().unwrap_or(0.0), self.place == Place::Tube);
        // What a rate moves by, the spring and the drag.
        let law = |place: f64, rate: f64, input: f64| {
            let gas = (1.0 + stiffening * place) / (1.0 + 0.5 * stiffening);
            let tip = 1.0 + stiffening * input + hardening * (input - place).powi(2);
            let [gas, tip] = if is_gas { [gas.max(LEAST_STIFF), 1.0] } else { [1.0, tip.max(LEAST_STIFF)] };
            [gas, omega * omega * tip, 2.0 * (damping * omega + drag * rate.abs())]
        };
        let slope =
            |[gas, spring, drag]: [f64; 3], [place, rate]: [f64; 2], input: f64| [gas * rate, spring * (input - place) - drag * rate];
        let (mut swung, mut before, mut moved) = ([path[0], 0.0], path[0], 0.0_f64);
        let sample = |&value: &f64| {
            let [place, rate] = swung;
            // Stiffest where all its energy is the spring's.
            let far = (place - before).abs().max((place - value).abs()).powi(2);
            let energy = (rate / omega).powi(2) + far * (1.0 + 0.5 * hardening * far);
            let stiffest = (1.0 + 2.0 * hardening * energy).max(1.0).sqrt() + stiffening.max(0.0) * value.max(before).max(0.0);
            let turns = period_s * (omega * stiffest.sqrt() + drag * rate.abs());
            let mut units = [[1.0, 0.0], [0.0, 1.0], [0.0; 2], [0.0; 2]];
            for (shares, long) in steps([before, value, moved], jumps_at, turns) {
                let (step_s, mut laws) = (long * period_s, [[0.0; 3]; 4]);
                swung = runge_kutta(swung, shares.map(|share| before + share * (value - before)), step_s, |look, swung, input| {
                    laws[look] = law(swung[0], swung[1], input);
                    slope(laws[look], swung, input)
                });
                let of_a_unit = [[0.0; 2], [0.0; 2], shares.map(|share| 1.0 - share), shares];
                for (unit, inputs) in units.iter_mut().zip(of_a_unit).take(if is_gas { 0 } else { 4 }) {
                    *unit = runge_kutta(*unit, inputs, step_s, |look, swung, input| slope(laws[look], swung, input));
                }
            }
            (before, moved) = (value, (value - before).abs());
            (swung[0], units)
        };
        let (swung, units) = path.iter().map(sample).unzip();
        Along { swung, units }
    }
}

/// Stiffness, over that of the frequency, that nothing is softer than.
const LEAST_STIFF: f64 = 0.1;

impl Filter<4> for Along {
    fn begin(&self, first: f64) -> [f64; 4] {
        [first, 0.0, first, 0.0]
    }
    #[inline(always)]
    fn step(&self, [place, rate, last, sample]: &mut [f64; 4], value: f64) -> f64 {
        let units = self.units[*sample as usize].iter().zip([*place, *rate, *last, value]);
        let swung = units.fold([0.0; 2], |swung, (unit, size)| [swung[0] + unit[0] * size, swung[1] + unit[1] * size]);
        [*place, *rate, *last] = [swung[0], swung[1], value];
        *sample += 1.0;
        *place
    }
}

impl Form for Changing {
    fn spec(&self) -> Spec {
        static SIMPLER: [(usize, f64); 4] = [(2, 0.0), (3, 0.0), (4, MIDWAY), (5, 0.0)];
        Spec {
            parameters: self.parameters,
            steps: &[0.15, 0.15, 0.2, 0.2, 0.2, 5.0],
            simpler_at: &SIMPLER[..self.parameters.len() - 2],
            needs_sum: self.place == Place::Tip,
            ..Spec::new("resonance", self.form, self.place)
        }
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let other = if self.place == Place::Tip { [0.15, 0.0, 0.0, MIDWAY, 20.0] } else { [0.12, 0.0, 0.8, MIDWAY, 0.0] };
        let starts =
            ladder(1.2, 8.0, 8).into_iter().flat_map(|frequency| [[0.08, 0.3, 0.0, MIDWAY, 0.0], other].map(|rest| (frequency, rest)));
        starts.map(|(frequency, rest)| [&[frequency], &rest[..self.parameters.len() - 1]].concat()).collect()
    }
    /// With drag and stiffness in proportion.
    fn nested_limits(&self, parameters: &[f64]) -> Limits {
        vec![(if self.place == Place::Tip { &TIP } else { &PRESSURE }, parameters[..2].to_vec())]
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        if self.place == Place::Tube {
            path.copy_from_slice(&self.along(parameters, path, run.period_s).swung);
        }
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        if self.place == Place::Tip {
            columns.filter(&self.along(parameters, sum, run.period_s));
        }
    }
}

impl Form for Swinging {
    fn spec(&self) -> Spec {
        Spec { parameters: self.parameters, ..Spec::new("resonance", self.form, self.place) }
    }
    fn starts(&self, _: &Session, _: &[Vec<f64>]) -> Vec<Vec<f64>> {
        grid(&[&ladder(1.2, 8.0, 8), &[0.08, 0.3]]).iter().map(|of| [&of[..], &[0.5][..self.parameters.len() - 2]].concat()).collect()
    }
    /// What follows a slow command hardly differently from a swing that is damped so much.
    fn nested_limits(&self, parameters: &[f64]) -> Limits {
        let [frequency_hz, damping] = [parameters[0], parameters[1]];
        let behind_s = vec![damping / (PI * frequency_hz)];
        let limits = vec![(dead_time::FORMS[0], behind_s.clone()), (pneumatic_lag::FORMS[0], behind_s)];
        if damping < HARDLY_SWINGS || parameters.len() > 2 { Vec::new() } else { limits }
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        if self.place < Place::Operators {
            Swing::new(parameters[0], parameters[1], run.period_s).run(path);
        }
    }
    fn output(&self, parameters: &[f64], run: &Run, _: &[f64], columns: &mut Columns) {
        if self.place > Place::Operators {
            let share = parameters.get(2).copied().unwrap_or(1.0);
            let swing = Swing::new(parameters[0], parameters[1], run.period_s);
            // A drag against what moves it: `y = (1 + 2 D / o d/dt) w`.
            columns.filter(&Swing { share, carried_s: if self.shaken { swing.behind_s } else { 0.0 }, ..swing });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tip_swings_against_a_drag_that_grows_and_on_a_stiffness_that_changes() {
        let period_s = 0.01;
        let sum: Vec<f64> = (0..600).map(|sample| 0.5 - 0.5 * (3.0 * f64::from(sample) * period_s).cos()).collect();
        let mut worst = Vec::new();
        for [damping, drag, stiffening, hardening] in
            [[0.1, 0.0, 0.0, 0.0], [0.05, 2.0, 0.0, 0.0], [0.05, 0.0, 1.5, 0.0], [0.05, 1.0, -0.5, 0.0], [0.1, 0.0, 0.0, 40.0]]
        {
            let along = CHANGING_TIP.along(&[2.5, damping, drag, stiffening, MIDWAY, hardening], &sum, period_s);
            let mut found = sum.clone();
            along.run(&mut found);
            assert!(found.iter().zip(&along.swung).all(|(found, swung)| (found - swung).abs() < 1e-12));
            let omega = 2.0 * PI * 2.5;
            let (mut place, mut rate) = (sum[0], 0.0_f64);
            let mut error: f64 = 0.0;
            for (sample, found) in found.iter().enumerate().skip(1) {
                for look in 0..1000 {
                    let value = sum[sample - 1] + (sum[sample] - sum[sample - 1]) * f64::from(look) / 1000.0;
                    let away = value - place;
                    let force = omega * omega * (1.0 + stiffening * value + hardening * away * away) * away;
                    rate += 1e-3 * period_s * (force - 2.0 * omega * (damping + drag * rate.abs() / omega) * rate);
                    place += 1e-3 * period_s * rate;
                }
                error = error.max((found - place).abs());
            }
            worst.push(error);
        }
        // As exact as the Euler steps.
        assert!(worst.iter().all(|error| *error < 2e-4), "{worst:?}");
    }

    #[test]
    fn a_jump_that_is_over_long_before_the_next_sample_sets_another_swing_off() {
        let (period_s, frequency_hz, damping, hardening) = (0.025, 3.0, 0.1, 40.0);
        let sum: Vec<f64> = (0..200).map(|sample| if sample < 20 { 0.0 } else { 0.7 }).collect();
        let omega = 2.0 * PI * frequency_hz;
        let (mut place, mut rate) = (0.0, 0.0);
        let mut exact = vec![0.0];
        for sample in 1..sum.len() {
            for look in 0..2500 {
                // A way of 10 ms.
                let share = (f64::from(look) * period_s / 2500.0 / 0.01).min(1.0);
                let away = sum[sample - 1] + share * (sum[sample] - sum[sample - 1]) - place;
                rate += period_s / 2500.0 * (omega * omega * (1.0 + hardening * away * away) * away - 2.0 * damping * omega * rate);
                place += period_s / 2500.0 * rate;
            }
            exact.push(place);
        }
        let error = |jumps_at: f64| {
            let mut found = sum.clone();
            CHANGING_TIP.along(&[frequency_hz, damping, 0.0, 0.0, jumps_at, hardening], &sum, period_s).run(&mut found);
            found.iter().zip(&exact).map(|(found, exact)| (found - exact).abs()).fold(0.0, f64::max)
        };
        assert!(error(0.2) < 0.01 && error(MIDWAY) > 0.2, "{} and {}", error(0.2), error(MIDWAY));
    }

    #[test]
    fn a_plug_of_air_swings_on_the_gas_in_the_muscle_against_a_drag_that_grows() {
        let (period_s, stiffening, drag) = (0.01, 0.7, 1.5);
        let input: Vec<f64> = (0..600).map(|sample| 0.5 - 0.5 * (3.0 * f64::from(sample) * period_s).cos()).collect();
        let found = GAS_SPRING.along(&[2.5, 0.1, drag, stiffening, MIDWAY], &input, period_s).swung;
        let omega = 2.0 * PI * 2.5;
        // It flows by its inertia, and what has flowed raises the pressure by the gas's own.
        let (mut place, mut flow, mut error) = (0.0, 0.0_f64, 0.0_f64);
        for (sample, found) in found.iter().enumerate().skip(1) {
            for look in 0..1000 {
                let value = input[sample - 1] + (input[sample] - input[sample - 1]) * f64::from(look) / 1000.0;
                flow += 1e-3 * period_s * (omega * omega * (value - place) - 2.0 * omega * (0.1 + drag * flow.abs() / omega) * flow);
                place += 1e-3 * period_s * flow * (1.0 + stiffening * place) / (1.0 + 0.5 * stiffening);
            }
            error = error.max((found - place).abs());
        }
        assert!(error < 2e-3, "{error}");
    }

    #[test]
    fn what_shakes_the_tip_moves_it_through_its_drag_too() {
        let (period_s, frequency_hz, damping) = (0.01, 2.5, 0.3);
        let base = |time_s: f64| 0.5 - 0.5 * (3.0 * time_s).cos();
        let mut found: Vec<f64> = (0..600).map(|sample| base(f64::from(sample) * period_s)).collect();
        let swing = Swing::new(frequency_hz, damping, period_s);
        Swing { carried_s: swing.behind_s, ..swing }.run(&mut found);
        let omega = 2.0 * PI * frequency_hz;
        let (mut place, mut rate) = (0.0, 0.0);
        for (sample, found) in found.iter().enumerate().skip(1) {
            for look in 0..1000 {
                let time_s = ((sample - 1) as f64 + f64::from(look) / 1000.0) * period_s;
                let acceleration = omega * omega * (base(time_s) - place) + 2.0 * damping * omega * (1.5 * (3.0 * time_s).sin() - rate);
                rate += 1e-3 * period_s * acceleration;
                place += 1e-3 * period_s * rate;
            }
            assert!((found - place).abs() < 1e-3, "sample {sample}: {found} instead of {place}");
        }
    }
}
