//! `resonance`: something swings: the tip, a mass on a spring behind the hysteresis; a part of the tip, when the sensor looks at a place
//! that is held elsewhere too; or the pressure before the hysteresis, air in a tube (Helmholtz) or a regulator that overshoots; on the gas in the
//! muscle, which is the stiffer the higher its pressure, `1 + k v`; its frequency is that at half of the span.

use std::f64::consts::PI;

use crate::chain::columns::{Columns, Filter};
use crate::chain::filters::{grid, ladder};
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec, Told};
use crate::chain::side_by_side::{self, leads_input};
use crate::data::session::Run;
use crate::effects::{dead_time, pneumatic_lag};

/// All forms.
pub const FORMS: &[&dyn Form] = &[&TIP, &SHAKEN, &Changing, &PartOfTip, &PRESSURE, &GasSpring];

/// Something that swings as a whole.
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

/// Damped more than this it no longer swings, and any lag or delay would pass for it.
const DAMPING_OF_AIR: Parameter = Parameter { high: 0.6, ..DAMPING };

static PRESSURE: Swinging =
    Swinging { form: ("pressure", "swinging pressure"), place: Place::Tube, parameters: &[FREQUENCY, DAMPING_OF_AIR], shaken: false };

struct PartOfTip;

const FREQUENCY: Parameter = Parameter { name: "frequency", quantity: Quantity::Frequency, low: 0.4, high: 15.0, logarithmic: true };

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
            period_s,
        }
    }

    /// The same where the drag is one against what moves it: `y = (1 + 2 D / o d/dt) w`.
    fn shaken(self, shaken: bool) -> Self {
        Self { carried_s: if shaken { self.behind_s } else { 0.0 }, ..self }
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
        *place + self.carried_s * *rate
    }
}

/// A mass of which the sensor sees a share only.
struct Part {
    swing: Swing,
    share: f64,
}

impl Filter<3> for Part {
    fn begin(&self, first: f64) -> [f64; 3] {
        self.swing.begin(first)
    }
    #[inline(always)]
    fn step(&self, memory: &mut [f64; 3], value: f64) -> f64 {
        value + self.share * (self.swing.step(memory, value) - value)
    }
}

/// Damping ratio from which on that is tried.
const HARDLY_SWINGS: f64 = 0.4;

impl Form for PartOfTip {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                FREQUENCY,
                DAMPING,
                Parameter { name: "swinging_share", quantity: Quantity::Ratio, low: 0.02, high: 0.98, logarithmic: false },
            ],
            starts: || ladder(1.2, 8.0, 8).into_iter().map(|frequency| vec![frequency, 0.12, 0.5]).collect(),
            ..Spec::new("resonance", ("part-of-tip", "a part of the tip swings"), Place::Tip)
        }
    }
    fn output(&self, parameters: &[f64], run: &Run, _: &[f64], columns: &mut Columns) {
        columns.filter(&Part { swing: Swing::new(parameters[0], parameters[1], run.period_s), share: parameters[2] });
    }
}

/// Air in a tube on the gas of the muscle.
struct GasSpring;

impl Form for GasSpring {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                FREQUENCY,
                DAMPING_OF_AIR,
                Parameter { name: "stiffening", quantity: Quantity::PerInput, low: 0.1, high: 5.0, logarithmic: true },
            ],
            steps: &[0.15, 0.15, 0.4],
            starts: || ladder(1.2, 8.0, 8).into_iter().map(|frequency| vec![frequency, 0.12, 0.8]).collect(),
            ..Spec::new("resonance", ("gas-spring", "swinging pressure, stiffer under pressure"), Place::Tube)
        }
    }
    leads_input!(|self, parameters, run| Gas {
        frequency_hz: parameters[0],
        damping: parameters[1],
        stiffening: parameters[2],
        period_s: run.period_s
    });
}

/// What [`GasSpring`] does to the input: its stiffness stands still within a sample.
#[derive(PartialEq)]
struct Gas {
    frequency_hz: f64,
    damping: f64,
    stiffening: f64,
    period_s: f64,
}

impl Filter<3> for Gas {
    fn begin(&self, first: f64) -> [f64; 3] {
        [first, 0.0, first]
    }
    #[inline(always)]
    fn step(&self, memory: &mut [f64; 3], value: f64) -> f64 {
        let stiff = ((1.0 + self.stiffening * memory[0]) / (1.0 + 0.5 * self.stiffening)).max(0.1).sqrt();
        Swing::new(self.frequency_hz * stiff, (self.damping / stiff).min(MOST_DAMPING), self.period_s).step(memory, value)
    }
}

/// A tip whose drag grows with its speed, and whose stiffness changes with its deflection from where it would rest.
struct Changing;

/// How it would swing on its own: for each sample its drag and its frequency, by which the columns swing that add up to it.
struct Along {
    swings: Vec<Swing>,
}

impl Along {
    /// Along a friction-free displacement, over its span: `w'' + 2 o (D + d |w'| / o) w' + o^2 (1 + k |s|) (w - s) = 0`.
    fn new(parameters: &[f64], sum: &[f64], period_s: f64) -> Self {
        let [frequency_hz, damping, drag, stiffening] = [parameters[0], parameters[1], parameters[2], parameters[3]];
        let omega = 2.0 * PI * frequency_hz;
        let mut memory = [sum[0], 0.0, sum[0]];
        let swing = |&value: &f64| {
            let stiff = (1.0 + stiffening * value).max(0.1).sqrt();
            let damped = (damping + drag * memory[1].abs() / omega) / stiff;
            let swing = Swing::new(frequency_hz * stiff, damped.min(MOST_DAMPING), period_s);
            swing.step(&mut memory, value);
            swing
        };
        Self { swings: sum.iter().map(swing).collect() }
    }
}

/// Damping ratio that a swing is not damped by more.
const MOST_DAMPING: f64 = 0.98;

impl Filter<4> for Along {
    fn begin(&self, first: f64) -> [f64; 4] {
        [first, 0.0, first, 0.0]
    }
    #[inline(always)]
    fn step(&self, [place, rate, last, sample]: &mut [f64; 4], value: f64) -> f64 {
        let mut memory = [*place, *rate, *last];
        let swung = self.swings[*sample as usize].step(&mut memory, value);
        [*place, *rate, *last] = memory;
        *sample += 1.0;
        swung
    }
}

impl Form for Changing {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                FREQUENCY,
                DAMPING,
                Parameter { name: "drag", quantity: Quantity::Ratio, low: 0.0, high: 10.0, logarithmic: false },
                Parameter { name: "stiffening", quantity: Quantity::Ratio, low: -0.8, high: 3.0, logarithmic: false },
            ],
            steps: &[0.15, 0.15, 0.2, 0.2],
            simpler_at: &[(2, 0.0), (3, 0.0)],
            needs_sum: true,
            starts: || ladder(1.2, 8.0, 8).into_iter().map(|frequency| vec![frequency, 0.08, 0.3, 0.0]).collect(),
            ..Spec::new("resonance", ("changing-tip", "swinging tip, its drag or its stiffness not in proportion"), Place::Tip)
        }
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        columns.filter(&Along::new(parameters, sum, run.period_s));
    }
}

impl Form for Swinging {
    fn spec(&self) -> Spec {
        let starts = || grid(&ladder(1.2, 8.0, 8), &[0.08, 0.3]);
        Spec { parameters: self.parameters, starts, ..Spec::new("resonance", self.form, self.place) }
    }
    /// What follows a slow command hardly differently from a swing that is damped so much.
    fn nested_limits(&self, parameters: &[f64]) -> Vec<(&'static dyn Form, Vec<f64>)> {
        let [frequency_hz, damping] = [parameters[0], parameters[1]];
        let behind_s = vec![damping / (PI * frequency_hz)];
        let limits = vec![(dead_time::FORMS[0], behind_s.clone()), (pneumatic_lag::FORMS[0], behind_s)];
        if damping < HARDLY_SWINGS { Vec::new() } else { limits }
    }
    fn inputs(&self, parameters: &[f64], runs: &[&Run], paths: &mut [Vec<f64>]) {
        if self.place < Place::Operators {
            side_by_side::filter(runs, paths, |run| Swing::new(parameters[0], parameters[1], run.period_s));
        }
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        if self.place < Place::Operators {
            Swing::new(parameters[0], parameters[1], run.period_s).run(path);
        }
    }
    fn output(&self, parameters: &[f64], run: &Run, _: &[f64], columns: &mut Columns) {
        if self.place > Place::Operators {
            columns.filter(&Swing::new(parameters[0], parameters[1], run.period_s).shaken(self.shaken));
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
        for [damping, drag, stiffening] in [[0.1, 0.0, 0.0], [0.05, 2.0, 0.0], [0.05, 0.0, 1.5], [0.05, 1.0, -0.5]] {
            let mut found = sum.clone();
            Along::new(&[2.5, damping, drag, stiffening], &sum, period_s).run(&mut found);
            let omega = 2.0 * PI * 2.5;
            let (mut place, mut rate) = (sum[0], 0.0_f64);
            let mut error: f64 = 0.0;
            for (sample, found) in found.iter().enumerate().skip(1) {
                for look in 0..1000 {
                    let value = sum[sample - 1] + (sum[sample] - sum[sample - 1]) * f64::from(look) / 1000.0;
                    let force = omega * omega * (1.0 + stiffening * value) * (value - place);
                    rate += 1e-3 * period_s * (force - 2.0 * omega * (damping + drag * rate.abs() / omega) * rate);
                    place += 1e-3 * period_s * rate;
                }
                error = error.max((found - place).abs());
            }
            worst.push(error);
        }
        // Drag and stiffness stand still within a sample; without either it is exact but for the Euler steps.
        assert!(worst[0] < 1e-4 && worst.iter().all(|error| *error < 5e-3), "{worst:?}");
    }

    #[test]
    fn a_plug_of_air_swings_on_the_gas_in_the_muscle() {
        let (period_s, stiffening) = (0.01, 0.7);
        let mut found: Vec<f64> = (0..600).map(|sample| 0.5 - 0.5 * (3.0 * f64::from(sample) * period_s).cos()).collect();
        let input = found.clone();
        Gas { frequency_hz: 2.5, damping: 0.1, stiffening, period_s }.run(&mut found);
        let omega = 2.0 * PI * 2.5;
        // It flows by its inertia, and what has flowed raises the pressure by the gas's own.
        let (mut place, mut flow, mut error) = (0.0, 0.0, 0.0_f64);
        for (sample, found) in found.iter().enumerate().skip(1) {
            for look in 0..1000 {
                let value = input[sample - 1] + (input[sample] - input[sample - 1]) * f64::from(look) / 1000.0;
                flow += 1e-3 * period_s * (omega * omega * (value - place) - 2.0 * 0.1 * omega * flow);
                place += 1e-3 * period_s * flow * (1.0 + stiffening * place) / (1.0 + 0.5 * stiffening);
            }
            error = error.max((found - place).abs());
        }
        assert!(error < 0.02, "{error}");
    }

    #[test]
    fn what_shakes_the_tip_moves_it_through_its_drag_too() {
        let (period_s, frequency_hz, damping) = (0.01, 2.5, 0.3);
        let base = |time_s: f64| 0.5 - 0.5 * (3.0 * time_s).cos();
        let mut found: Vec<f64> = (0..600).map(|sample| base(f64::from(sample) * period_s)).collect();
        Swing::new(frequency_hz, damping, period_s).shaken(true).run(&mut found);
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
