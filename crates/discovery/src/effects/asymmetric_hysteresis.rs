//! `asymmetric-hysteresis`: the loop is not its own mirror image: friction grows with the pressure, on both branches or on one, the branches
//! bend apart, or they part the more the higher the pressure is; or friction by a differential equation has a bound for each direction.

use crate::chain::columns::Columns;
use crate::chain::filters::{grid, row};
use crate::chain::form::{Form, OfOperators, Parameter, Place, Quantity, Spec};
use crate::data::session::Run;
use crate::data::turning::large_turns;
use crate::effects::creep;

/// All forms.
pub const FORMS: &[&dyn Form] = &[
    &GROWS,
    &GROWS_UNLOADING,
    &GROWS_LOADING,
    &BENDS,
    &EACH,
    &BoucWen { remembers: false },
    &BoucWen { remembers: true },
    &Dahl { remembers: false },
    &Dahl { remembers: true },
];

const BEND: &[Parameter] = &[Parameter { name: "bend", quantity: Quantity::Ratio, low: -0.6, high: 0.9, logarithmic: false }];

const GROWTH: &[Parameter] = &[Parameter { name: "growth", quantity: Quantity::PerInput, low: -0.9, high: 12.0, logarithmic: false }];

const NAME: &str = "asymmetric-hysteresis";

/// Where the search for [`GROWTH`] begins.
fn growths() -> Vec<Vec<f64>> {
    row(&[-0.7, -0.3, 0.3, 0.8, 1.5, 3.0, 6.0])
}

/// Thresholds that grow with the input, on both branches or on one; the other keeps its thresholds.
static GROWS: OfOperators =
    OfOperators::new((NAME, ("thresholds-grow", "thresholds grow with the input")), GROWTH, growths, |parameters, law| {
        law.growth_per_input = parameters[0]
    });

static GROWS_UNLOADING: OfOperators = OfOperators::new(
    (NAME, ("unloading-thresholds-grow", "thresholds of the unloading branch grow with the input")),
    GROWTH,
    growths,
    |parameters, law| law.growth_unloading = parameters[0],
);

static GROWS_LOADING: OfOperators = OfOperators::new(
    (NAME, ("loading-thresholds-grow", "thresholds of the loading branch grow with the input")),
    GROWTH,
    growths,
    |parameters, law| [law.growth_per_input, law.growth_unloading] = [parameters[0], -parameters[0]],
);

static BENDS: OfOperators = OfOperators::new(
    (NAME, ("bend-apart", "the branches bend apart")),
    BEND,
    || row(&[-0.3, -0.1, 0.08, 0.2, 0.35, 0.5]),
    |parameters, law| law.envelopes[1] = parameters[0],
);

/// Generalised play operators: each branch is a curve of its own. What both do alike is a curve of the input and no asymmetry: where the plain curve does as
/// well, it is that. Bends of any size follow much that is neither.
static EACH: OfOperators = OfOperators {
    spec: Spec {
        parameters: &[
            Parameter { name: "loading_bend", quantity: Quantity::Ratio, low: -0.8, high: 0.8, logarithmic: false },
            Parameter { name: "unloading_bend", quantity: Quantity::Ratio, low: -0.8, high: 0.8, logarithmic: false },
            Parameter { name: "loading_cubic", quantity: Quantity::Ratio, low: -0.6, high: 0.6, logarithmic: false },
            Parameter { name: "unloading_cubic", quantity: Quantity::Ratio, low: -0.6, high: 0.6, logarithmic: false },
            Parameter { name: "opening", quantity: Quantity::Ratio, low: -0.4, high: 0.8, logarithmic: false },
        ],
        is_static: true,
        starts: || {
            grid(&[-0.25, 0.25], &[-0.25, 0.25]).iter().flat_map(|of| [0.0, 0.1].map(|open| [of, &[0.0, 0.0, open][..]].concat())).collect()
        },
        ..Spec::new(NAME, ("each-curves", "each branch has a curve of its own"), Place::Operators)
    },
    set: |of, law| law.envelopes = [0.5 * of[4], 0.5 * (of[1] - of[0]), 0.5 * (of[3] - of[2])],
    curve: |of, path| {
        for value in path {
            let v = value.clamp(0.0, 1.0);
            *value += 0.5 * v * (1.0 - v) * (of[0] + of[1] + (of[2] + of[3]) * (1.0 - 2.0 * v));
        }
    },
};

/// Friction by a differential equation that saturates at another level in each direction (Bouc 1967, Wen 1976, with an asymmetric term), beside the
/// operators: `A z' = x' (1 - |z| (c + L sign(x')))` of the displacement `x`, with the onset `A`, the lean `L` and `c` one where `x' z > 0`,
/// else the turning `T`.
struct BoucWen {
    /// Whether what earlier recordings have left of it is there when a recording begins.
    remembers: bool,
}

/// What the friction of [`BoucWen`] is after a motion over so many onsets.
fn bouc_wen(mut friction: f64, mut motion: f64, [lean, turning]: [f64; 2]) -> f64 {
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
    let mut turns = large_turns(earlier, TURNS);
    turns.drain(..turns.len().saturating_sub(REMEMBERED));
    turns
}

impl Form for BoucWen {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "onset", quantity: Quantity::Output, low: 0.02, high: 1.0, logarithmic: true },
                Parameter { name: "lean", quantity: Quantity::Ratio, low: -0.9, high: 0.9, logarithmic: false },
                Parameter { name: "turning", quantity: Quantity::Ratio, low: -0.95, high: 0.95, logarithmic: false },
            ],
            weights: 1,
            needs_sum: true,
            simpler_at: &[(2, 0.0)],
            starts: || grid(&[0.08, 0.3], &[-0.4, 0.4]).into_iter().map(|of| [&of[..], &[0.0]].concat()).collect(),
            ..Spec::new(
                NAME,
                if self.remembers {
                    ("bouc-wen-going-on", "Bouc-Wen friction with a level for each direction, going on from recording to recording")
                } else {
                    ("bouc-wen", "Bouc-Wen friction with a level for each direction")
                },
                Place::Material,
            )
        }
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        let law = [parameters[1], parameters[2]];
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

/// Friction that holds the pressure's effect back and nears its bound exponentially with the travel (Dahl 1968), the bound another one in each direction:
/// `z' = u' (sign(u') - z / B)`, `v = u - S z` with `B = A (1 + L)` for a pressure that rises and `A (1 - L)` for one that falls.
struct Dahl {
    /// As in [`BoucWen`].
    remembers: bool,
}

/// What the friction of [`Dahl`] is after a motion over so many mean bounds, in these.
fn dahl(friction: f64, motion: f64, lean: f64) -> f64 {
    let bound = 1.0 + lean * motion.signum();
    let aim = bound * motion.signum();
    aim + (friction - aim) * (-motion.abs() / bound).exp()
}

impl Form for Dahl {
    fn spec(&self) -> Spec {
        Spec {
            parameters: &[
                Parameter { name: "bound", quantity: Quantity::Input, low: 0.01, high: 0.5, logarithmic: true },
                Parameter { name: "lean", quantity: Quantity::Ratio, low: -0.9, high: 0.9, logarithmic: false },
                Parameter { name: "share", quantity: Quantity::Ratio, low: 0.02, high: 1.5, logarithmic: true },
            ],
            starts: || grid(&[0.05, 0.15], &[-0.4, 0.4]).into_iter().map(|of| [&of[..], &[0.7]].concat()).collect(),
            ..Spec::new(
                NAME,
                if self.remembers {
                    ("dahl-going-on", "Dahl friction with a bound for each direction, going on from recording to recording")
                } else {
                    ("dahl", "Dahl friction with a bound for each direction")
                },
                Place::Muscle,
            )
        }
    }
    fn input(&self, parameters: &[f64], run: &Run, path: &mut [f64]) {
        let &[bound, lean, share] = parameters else { return };
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
    use crate::model::initial_state::InitialState;
    use crate::model::structure::Model;
    use recording::{Recording, Signal};
    use std::path::Path;

    #[test]
    fn each_branch_follows_its_own_curve() {
        let input: Vec<f64> = (0..1000).map(|sample| 0.5 - 0.5 * (std::f64::consts::TAU * 0.1 * f64::from(sample) * 0.02).cos()).collect();
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input.clone());
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let model = Model { thresholds: vec![0.05], base: vec![0.0; 2], ..Model::baseline(InitialState::Fresh, false) };
        let mut columns = Columns::default();
        let [loading, unloading] = [[0.0, 0.0], [0.2, -0.1]];
        model.with(&EACH, vec![loading[0], unloading[0], loading[1], unloading[1], 0.1]).columns(&session.runs[0], &mut columns);
        let operator = columns.column(1);
        let curve = |[bend, cubic]: [f64; 2], v: f64| v + v * (1.0 - v) * (bend + cubic * (1.0 - 2.0 * v));
        // A quarter and three quarters of the way up, and down again. What parts the branches is a function of the input that their mean has bent.
        for (sample, envelope, gap) in [(83, loading, -0.05), (167, loading, -0.05), (333, unloading, 0.05), (417, unloading, 0.05)] {
            let wanted = curve(envelope, input[sample]) + gap * (1.0 + input[sample]);
            assert!((operator[sample] - wanted).abs() < 3e-3, "{} instead of {wanted} at {sample}", operator[sample]);
        }
    }

    #[test]
    fn friction_is_as_its_equation_says_and_a_long_stroke_is_many_short_ones() {
        for law in [[0.0, 0.0], [0.4, -0.4], [-0.3, 0.5], [0.6, -0.6]] {
            let (mut found, mut at_once, mut state) = (0.0, 0.0, 0.0_f64);
            for (stroke, motion) in [1.3, -2.1, 0.7, -0.2, 3.0, -6.0, 0.0, 1.0].into_iter().enumerate() {
                at_once = bouc_wen(at_once, motion, law);
                (0..50).for_each(|_| found = bouc_wen(found, motion / 50.0, law));
                for _ in 0..100_000 {
                    let step = motion * 1e-5;
                    let along = if step * state > 0.0 { 1.0 + law[0] * step.signum() } else { law[1] + law[0] * step.signum() };
                    state += step * (1.0 - state.abs() * along);
                }
                assert!((at_once - found).abs() < 1e-12, "{law:?}: {at_once} or {found}");
                assert!((found - state).abs() < 1e-3, "{law:?}, stroke {stroke}: {found} instead of {state}");
            }
            assert!((bouc_wen(0.0, 50.0, law) - 1.0 / (1.0 + law[0])).abs() < 1e-9);
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
        Dahl { remembers: false }.input(&[bound, lean, share], run, &mut path);
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
            BoucWen { remembers }.output(&[0.2, 0.3, 0.0], run, &run.input, &mut columns);
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
                wanted = bouc_wen(wanted, (pair[1] - pair[0]) / 0.2, [0.3, 0.0]);
                wanted
            })
            .collect();
        for (found, wanted) in friction(second, true).iter().zip(&wanted[first.input.len() - 1..]) {
            assert!((found - wanted).abs() < 1e-3, "{found} instead of {wanted}");
        }
        assert!((friction(second, false)[1] - wanted[first.input.len()]).abs() > 0.1);
    }

    #[test]
    fn the_branch_whose_thresholds_grow_is_late_and_the_other_is_where_it_was() {
        let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = time_s.iter().map(|time| 0.5 - 0.5 * (2.0 * std::f64::consts::PI * 0.1 * time).cos()).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        let operator = |forms: &[(&'static dyn Form, f64)]| {
            let mut model = Model { thresholds: vec![0.1], base: vec![0.0; 2], ..Model::baseline(InitialState::Fresh, false) };
            for &(form, size) in forms {
                model = model.with(form, vec![size]);
            }
            let mut columns = Columns::default();
            model.columns(run, &mut columns);
            columns.column(1)
        };
        let (plain, unloading, loading) = (operator(&[]), operator(&[(&GROWS_UNLOADING, 2.0)]), operator(&[(&GROWS_LOADING, 2.0)]));
        // Half way up (2.5 s) and half way down (7.5 s): the threshold there is twice as wide on the branch that grows.
        for (sample, of_unloading, of_loading) in [(125, 0.0, -0.1), (375, 0.1, 0.0)] {
            assert!((unloading[sample] - plain[sample] - of_unloading).abs() < 1e-9, "{} {}", unloading[sample], plain[sample]);
            assert!((loading[sample] - plain[sample] - of_loading).abs() < 1e-9, "{} {}", loading[sample], plain[sample]);
        }
    }
}
