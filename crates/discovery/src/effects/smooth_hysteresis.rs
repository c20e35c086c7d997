//! `smooth-hysteresis`: a loop that bends smoothly from each turn on, as friction by a differential equation has it (Bouc 1967, Wen 1976; Dahl 1968), where
//! play operators have corners. With another bound in each direction it is `asymmetric-hysteresis`.

use crate::chain::columns::Columns;
use crate::chain::filters::grid;
use crate::chain::form::{Form, Limits, Parameter, Place, Quantity, Spec, Told};
use crate::data::session::Run;
use crate::data::turning::large_turns;
use crate::effects::creep;

/// All forms.
pub const FORMS: &[&dyn Form] = &[
    &BoucWen { leans: false, remembers: false },
    &BoucWen { leans: false, remembers: true },
    &Dahl { leans: false, remembers: false },
    &Dahl { leans: false, remembers: true },
];

/// Name of the effect with one bound for both directions.
const NAME: &str = "smooth-hysteresis";

/// Name of the effect with a bound for each.
pub const LEANING: &str = "asymmetric-hysteresis";

/// How much wider the bound is in one direction than in the mean of both.
const LEAN: Parameter = Parameter { name: "lean", quantity: Quantity::Ratio, low: -0.9, high: 0.9, logarithmic: false };

/// The law that is alike in both directions in the place of one that leans, whose lean is its second parameter.
fn without_lean(leans: bool, alike: &'static dyn Form, parameters: &[f64]) -> Limits {
    if leans { vec![(alike, [&parameters[..1], &parameters[2..]].concat())] } else { Vec::new() }
}

/// Friction by a differential equation that saturates (Bouc 1967, Wen 1976), where it leans at another level in each direction, beside the operators:
/// `A z' = x' (1 - |z|^n (c + L sign(x')))` of the displacement `x`, with the onset `A`, the lean `L`, the exponent `n` and `c` one where `x' z > 0`,
/// else the turning `T`.
pub struct BoucWen {
    /// Whether each direction has a level of its own.
    pub leans: bool,
    /// Whether what earlier recordings have left of it is there when a recording begins.
    pub remembers: bool,
}

/// What the friction of [`BoucWen`] is after a motion over so many onsets.
fn bouc_wen(friction: f64, motion: f64, [lean, turning, exponent]: [f64; 3]) -> f64 {
    /// Most onsets of a step where there is no closed form, and of a motion: after that it has forgotten what was before.
    const MOST: [f64; 2] = [0.1, 40.0];
    if exponent == 1.0 {
        return bouc_wen_of_one(friction, motion, [lean, turning]);
    }
    let motion = motion.clamp(-MOST[1], MOST[1]);
    let steps = (motion.abs() / MOST[0]).ceil();
    let step = motion / steps.max(1.0);
    let lean = lean * motion.signum();
    let slope = |z: f64| 1.0 - z.abs().powf(exponent) * (lean + if z * motion > 0.0 { 1.0 } else { turning });
    // The midpoint method, which must not leave the widest bound.
    let widest = (1.0 - lean.abs()).powf(-1.0 / exponent);
    (0..steps as usize).fold(friction, |z, _| (z + step * slope(z + 0.5 * step * slope(z))).clamp(-widest, widest))
}

/// The same in closed form, for the exponent one.
fn bouc_wen_of_one(mut friction: f64, mut motion: f64, [lean, turning]: [f64; 2]) -> f64 {
    if motion == 0.0 {
        return friction;
    }
    let towards = motion.signum();
    let lean = lean * towards;
    // Away from what was before, down to none.
    if friction * motion < 0.0 {
        let decay = turning + lean;
        let decay = if decay.abs() < 1e-9 { 1e-9 } else { decay };
        let left = friction.abs() * (decay * motion.abs()).exp() - (decay * motion.abs()).exp_m1() / decay;
        if left > 0.0 {
            return -left * towards;
        }
        motion += towards * (-decay * friction.abs()).ln_1p() / decay;
        friction = 0.0;
    }
    let most = 1.0 / (1.0 + lean);
    towards * (most + (friction.abs() - most) * (-motion.abs() / most).exp())
}

/// Turning points of the recording before that friction can remember: the last ones.
const REMEMBERED: usize = 8;

/// Size of what counts as a turn, spans.
const TURNS: f64 = 0.01;

/// Where the input of the recording before this one turned last, oldest first.
pub fn turns_before(run: &Run) -> Vec<f64> {
    let earlier = run.index.checked_sub(1).and_then(|before| run.session.get(before)).map_or(&[][..], |earlier| &earlier.input);
    let turns = large_turns(earlier, TURNS);
    turns[turns.len().saturating_sub(REMEMBERED)..].iter().map(|turn| earlier[*turn]).collect()
}

impl Form for BoucWen {
    fn spec(&self) -> Spec {
        const ONSET: Parameter = Parameter { name: "onset", quantity: Quantity::Output, low: 0.02, high: 1.0, logarithmic: true };
        const TURNING: Parameter = Parameter { name: "turning", quantity: Quantity::Ratio, low: -0.95, high: 0.95, logarithmic: false };
        const EXPONENT: Parameter = Parameter { name: "exponent", quantity: Quantity::Ratio, low: 1.0, high: 3.0, logarithmic: true };
        let shared = |name, form| Spec { weights: 1, needs_sum: true, ..Spec::new(name, form, Place::Material) };
        if self.leans {
            const FORMS: [Told; 2] = [
                ("bouc-wen", "Bouc-Wen friction with a level for each direction"),
                ("bouc-wen-going-on", "Bouc-Wen friction with a level for each direction, going on from recording to recording"),
            ];
            return Spec {
                parameters: &[ONSET, LEAN, TURNING, EXPONENT],
                simpler_at: &[(2, 0.0), (3, 1.0)],
                starts: || grid(&[&[0.08, 0.3], &[-0.4, 0.4], &[0.0], &[1.2]]),
                ..shared(LEANING, FORMS[usize::from(self.remembers)])
            };
        }
        const FORMS: [Told; 2] =
            [("bouc-wen", "Bouc-Wen friction"), ("bouc-wen-going-on", "Bouc-Wen friction, going on from recording to recording")];
        Spec {
            parameters: &[ONSET, TURNING, EXPONENT],
            simpler_at: &[(1, 0.0), (2, 1.0)],
            starts: || grid(&[&[0.08, 0.3], &[-0.5, 0.0], &[1.2]]),
            ..shared(NAME, FORMS[usize::from(self.remembers)])
        }
    }
    fn nested_limits(&self, parameters: &[f64]) -> Limits {
        without_lean(self.leans, FORMS[usize::from(self.remembers)], parameters)
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        let law = match *parameters {
            [_, lean, turning, exponent] => [lean, turning, exponent],
            [_, turning, exponent] => [0.0, turning, exponent],
            _ => return,
        };
        let step = |friction: f64, motion: f64| bouc_wen(friction, motion, law);
        // The displacement of the recording before is in proportion to its input, closely enough.
        let mut friction = if self.remembers { going_on(run, creep::gain(&run.input, sum) / parameters[0], step) } else { 0.0 };
        let mut last = sum[0];
        columns.push(true, |sample| {
            friction = step(friction, (sum[sample] - last) / parameters[0]);
            last = sum[sample];
            friction
        });
    }
}

/// What the turning points of the recording before have left of a friction that changes by a `step` for each motion, an onset being one over `onsets`.
fn going_on(run: &Run, onsets: f64, step: impl Fn(f64, f64) -> f64) -> f64 {
    let mut turns = run.earlier.as_ref().map_or_else(|| turns_before(run), |earlier| earlier.turns.clone());
    turns.push(run.input[0]);
    turns.windows(2).fold(0.0, |friction, pair| step(friction, (pair[1] - pair[0]) * onsets))
}

/// Friction that holds the pressure's effect back and nears its bound exponentially with the travel (Dahl 1968), where it leans another bound in each
/// direction: `z' = u' (sign(u') - z / B)`, `v = u - S z` with `B = A (1 + L)` for a pressure that rises and `A (1 - L)` for one that falls.
pub struct Dahl {
    /// Whether each direction has a bound of its own.
    pub leans: bool,
    /// As in [`BoucWen`].
    pub remembers: bool,
}

/// What the friction of [`Dahl`] is after a motion over so many mean bounds, in these.
fn dahl(friction: f64, motion: f64, lean: f64) -> f64 {
    let bound = 1.0 + lean * motion.signum();
    let aim = bound * motion.signum();
    aim + (friction - aim) * (-motion.abs() / bound).exp()
}

impl Form for Dahl {
    fn spec(&self) -> Spec {
        const BOUND: Parameter = Parameter { name: "bound", quantity: Quantity::Input, low: 0.01, high: 0.5, logarithmic: true };
        const SHARE: Parameter = Parameter { name: "share", quantity: Quantity::Ratio, low: 0.02, high: 1.5, logarithmic: true };
        if self.leans {
            const FORMS: [Told; 2] = [
                ("dahl", "Dahl friction with a bound for each direction"),
                ("dahl-going-on", "Dahl friction with a bound for each direction, going on from recording to recording"),
            ];
            return Spec {
                parameters: &[BOUND, LEAN, SHARE],
                starts: || grid(&[&[0.05, 0.15], &[-0.4, 0.4], &[0.7]]),
                ..Spec::new(LEANING, FORMS[usize::from(self.remembers)], Place::Muscle)
            };
        }
        const FORMS: [Told; 2] = [("dahl", "Dahl friction"), ("dahl-going-on", "Dahl friction, going on from recording to recording")];
        let plain = Spec::new(NAME, FORMS[usize::from(self.remembers)], Place::Muscle);
        Spec { parameters: &[BOUND, SHARE], starts: || grid(&[&[0.05, 0.15, 0.4], &[0.7]]), ..plain }
    }
    fn nested_limits(&self, parameters: &[f64]) -> Limits {
        without_lean(self.leans, FORMS[2 + usize::from(self.remembers)], parameters)
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let (bound, lean, share) = match *parameters {
            [bound, lean, share] => (bound, lean, share),
            [bound, share] => (bound, 0.0, share),
            _ => return,
        };
        let step = |friction: f64, motion: f64| if motion == 0.0 { friction } else { dahl(friction, motion / bound, lean) };
        let mut friction = if self.remembers { going_on(run, 1.0, step) } else { 0.0 };
        let mut last = path[0];
        for value in path {
            friction = step(friction, *value - last);
            last = *value;
            *value -= share * bound * friction;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::session::Session;
    use recording::{Recording, Signal};
    use std::path::Path;

    #[test]
    fn friction_is_as_its_equation_says_and_a_long_stroke_is_many_short_ones() {
        for law in
            [[0.0, 0.0, 1.0], [0.4, -0.4, 1.0], [-0.3, 0.5, 1.0], [0.6, -0.6, 1.0], [0.0, 0.3, 2.0], [0.3, -0.5, 1.5], [-0.4, 0.0, 2.8]]
        {
            let (mut found, mut at_once, mut state) = (0.0, 0.0, 0.0_f64);
            for (stroke, motion) in [1.3, -2.1, 0.7, -0.2, 3.0, -6.0, 0.0, 1.0].into_iter().enumerate() {
                at_once = bouc_wen(at_once, motion, law);
                (0..50).for_each(|_| found = bouc_wen(found, motion / 50.0, law));
                for _ in 0..100_000 {
                    let step = motion * 1e-5;
                    let along = if step * state > 0.0 { 1.0 + law[0] * step.signum() } else { law[1] + law[0] * step.signum() };
                    state += step * (1.0 - state.abs().powf(law[2]) * along);
                }
                let close = if law[2] == 1.0 { 1e-12 } else { 1e-3 };
                assert!((at_once - found).abs() < close, "{law:?}: {at_once} or {found}");
                assert!((found - state).abs() < 1e-3, "{law:?}, stroke {stroke}: {found} instead of {state}");
            }
            assert!((bouc_wen(0.0, 50.0, law) - (1.0 / (1.0 + law[0])).powf(1.0 / law[2])).abs() < 1e-9);
        }
    }

    #[test]
    fn dahl_friction_is_as_its_equation_says() {
        let time_s: Vec<f64> = (0..400).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = time_s.iter().map(|time| 0.5 - 0.5 * (3.0 * time).cos() * (-0.2 * time).exp()).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        let (bound, lean, share) = (0.12, 0.5, 0.8);
        let mut path = run.input.clone();
        Dahl { leans: true, remembers: false }.input(&[bound, lean, share], run, &mut path);
        let mut friction: f64 = 0.0;
        for (sample, found) in path.iter().enumerate().skip(1) {
            let change = run.input[sample] - run.input[sample - 1];
            for _ in 0..1000 {
                friction += 1e-3 * (change - change.abs() * friction / (bound * (1.0 + lean * change.signum())));
            }
            assert!((found - (run.input[sample] - share * friction)).abs() < 1e-4, "sample {sample}");
        }
    }

    #[test]
    fn friction_begins_where_the_recording_before_left_it_and_without_one_at_none() {
        let record = |seed: u32| {
            let time_s: Vec<f64> = (0..400).map(|sample| f64::from(sample) * 0.02).collect();
            let input: Vec<f64> = time_s.iter().map(|time| 0.5 - 0.5 * (time * (1.0 + f64::from(seed))).cos()).collect();
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input)
                .expect("a recording")
        };
        let session = Session::new(&[record(0), record(1)], &[]).expect("a session");
        let friction = |run: &Run, remembers: bool| {
            let mut columns = Columns::of(run.input.len());
            BoucWen { leans: true, remembers }.output(&[0.2, 0.3, 0.0, 1.0], run, &run.input, &mut columns);
            columns.column(0)
        };
        let [first, second] = [&session.runs[0], &session.runs[1]];
        assert_eq!(friction(first, true), friction(first, false));
        // Of all samples of the recording before, in a row with this one.
        let whole: Vec<f64> = first.input.iter().chain(&second.input).copied().collect();
        let mut wanted = 0.0;
        let wanted: Vec<f64> = whole
            .windows(2)
            .map(|pair| {
                wanted = bouc_wen(wanted, (pair[1] - pair[0]) / 0.2, [0.3, 0.0, 1.0]);
                wanted
            })
            .collect();
        for (found, wanted) in friction(second, true).iter().zip(&wanted[first.input.len() - 1..]) {
            assert!((found - wanted).abs() < 1e-3, "{found} instead of {wanted}");
        }
        assert!((friction(second, false)[1] - wanted[first.input.len()]).abs() > 0.1);
    }
}
