//! `first-cycle-softening` (Mullins): the first strokes are others, `y = s - V(s) F(c)`. What is left of the virgin material, `F`, goes with what has
//! worked it, `c`: the distance travelled since the recording began, where the muscle recovers in between (and maybe in time), or since the session
//! began, where it does not; the strokes done, counted by their height or by a level that is crossed (ASTM E1049), each as much as the one before or
//! less and less; the time under load; or the largest load so far (Mullins 1969). Mostly it is stiffer, `V(s) = A s`; in general it is a parabola,
//! `a s + b + c s^2`, and `d` times the integral of `F ds`: a set that stays, a threshold that the first strokes have to pass, stiffness at large
//! displacements alone or of the tangent. Or below its own peak `p`, which may fade, it is softer than on the way there,
//! `y = s (1 + A erf((p - s) / D))` (Ogden and Roxburgh 1999). Or it runs in: a loop that is there at first, a play operator whose threshold is `W F`,
//! is gone later. Or the virgin muscle makes another use of the pressure: [`super::softening_of_pressure`].

use std::collections::BTreeMap;

use statrs::function::erf::erf;

use crate::chain::columns::Columns;
use crate::chain::filters::{grid, ladder};
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec};
use crate::data::session::{Run, Session};
use crate::effects::softening_of_pressure::OF_THE_PRESSURE;

/// All forms.
pub const FORMS: &[&dyn Form] = &[
    &Softening { by: Wear::Distance, curved: false },
    &Softening { by: Wear::Strokes, curved: false },
    &Softening { by: Wear::Crossings, curved: false },
    &Softening { by: Wear::Load, curved: false },
    &Softening { by: Wear::Lasting, curved: false },
    &Softening { by: Wear::Largest { heals: true }, curved: false },
    &Softening { by: Wear::Largest { heals: false }, curved: false },
    &Softening { by: Wear::Distance, curved: true },
    &Softening { by: Wear::Strokes, curved: true },
    &Softening { by: Wear::Largest { heals: true }, curved: true },
    &BelowPeak,
    &RunningIn,
    &OF_THE_PRESSURE,
];

/// A virgin material that work turns into another.
struct Softening {
    by: Wear,
    /// Whether the virgin material differs by a parabola of the displacement and by its tangent, not by its stiffness alone.
    curved: bool,
}

/// What works it.
enum Wear {
    /// The distance travelled in a recording.
    Distance,
    /// The strokes that are done in a recording.
    Strokes,
    /// How often in a recording the displacement has been above a level and back (level-crossing counting, ASTM E1049).
    Crossings,
    /// The time under load in a recording, in proportion to the displacement.
    Load,
    /// The distance travelled in the session.
    Lasting,
    /// The highest input, since the recording began where the muscle heals in between, or since the session began.
    Largest { heals: bool },
}

/// Softer below the displacement's own peak since the recording began.
struct BelowPeak;

/// A loop that fades with the distance travelled in a recording.
struct RunningIn;

/// A recovery that no session lasts for, s.
const NEVER_S: f64 = 1e4;

/// Shortest way up that is a stroke, spans.
const LEAST_STROKE: f64 = 0.1;

/// Way up and down that an input takes.
fn travel(input: &[f64]) -> f64 {
    input.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum()
}

const NAME: &str = "first-cycle-softening";

const DISTANCE: Parameter = Parameter { quantity: Quantity::Output, ..ratio("distance", 0.1, 10.0) };
const STROKES: Parameter = ratio("strokes", 0.2, 30.0);
/// How much less each further stroke counts.
const SLOWING: Parameter = ratio("slowing", EVENLY, 3.0);
/// Each stroke counts alike.
const EVENLY: f64 = 1e-3;
const LEVEL: Parameter = Parameter { logarithmic: false, ..ratio("level", 0.1, 0.9) };
const SPANS: Parameter = ratio("distance_in_input_spans", 0.3, 20.0);
const UNDER_LOAD: Parameter = Parameter { quantity: Quantity::Time, ..ratio("time_under_load", 0.2, 20.0) };
const RECOVERY: Parameter = Parameter { quantity: Quantity::Time, ..ratio("recovery_time", 3.0, NEVER_S) };

const fn ratio(name: &'static str, low: f64, high: f64) -> Parameter {
    Parameter { name, quantity: Quantity::Ratio, low, high, logarithmic: true }
}

impl Form for Softening {
    fn spec(&self) -> Spec {
        let form = match (&self.by, self.curved) {
            (Wear::Distance, false) => {
                ("distance-in-recording", "with the distance that the displacement has travelled since the recording began")
            }
            (Wear::Distance, true) => ("distance-curved", "another curve at first, by the distance travelled since the recording began"),
            (Wear::Strokes, false) => ("strokes-in-recording", "with the strokes that are done since the recording began"),
            (Wear::Strokes, true) => ("strokes-curved", "another curve at first, by the strokes done since the recording began"),
            (Wear::Crossings, _) => {
                ("crossings-in-recording", "with how often the displacement has been above a level since the recording began")
            }
            (Wear::Load, _) => ("load-in-recording", "with the time under load since the recording began"),
            (Wear::Lasting, _) => ("distance-in-session", "with the distance that the input has travelled since the session began"),
            (Wear::Largest { heals: true }, false) => ("highest-in-recording", "by the highest input since the recording began"),
            (Wear::Largest { heals: true }, true) => ("highest-curved", "another curve below the highest input since the recording began"),
            (Wear::Largest { heals: false }, _) => ("highest-in-session", "by the highest input since the session began"),
        };
        let plain = Spec { weights: if self.curved { 4 } else { 1 }, needs_sum: true, ..Spec::new(NAME, form, Place::Material) };
        match (&self.by, self.curved) {
            (Wear::Distance, false) => Spec {
                parameters: &[DISTANCE, RECOVERY],
                simpler_at: &[(1, NEVER_S)],
                starts: || grid(&[&ladder(0.3, 6.0, 6), &[20.0, NEVER_S]]),
                ..plain
            },
            (Wear::Distance, true) => Spec { parameters: &[DISTANCE], starts: || grid(&[&ladder(0.3, 6.0, 4)]), ..plain },
            (Wear::Strokes, true) => Spec { parameters: &[STROKES], starts: || grid(&[&[0.5, 1.5, 4.0]]), ..plain },
            (Wear::Strokes, false) => Spec {
                parameters: &[STROKES, SLOWING],
                simpler_at: &[(1, EVENLY)],
                starts: || grid(&[&[0.5, 1.5, 4.0], &[EVENLY, 1.0]]),
                ..plain
            },
            (Wear::Crossings, _) => Spec {
                parameters: &[STROKES, SLOWING, LEVEL],
                simpler_at: &[(1, EVENLY)],
                starts: || grid(&[&[0.5, 1.5, 4.0], &[EVENLY, 1.0], &[0.2, 0.35, 0.5, 0.65]]),
                ..plain
            },
            (Wear::Load, _) => Spec { parameters: &[UNDER_LOAD], starts: || grid(&[&[0.5, 1.5, 5.0]]), ..plain },
            // First cycles are few: what goes on for many recordings is a drift of the gain. Over like strokes a gain that drifts towards a limit
            // does the same: where that does as well, it is drift.
            (Wear::Lasting, _) => Spec { parameters: &[SPANS], cost: Some(3), starts: || grid(&[&ladder(1.0, 15.0, 4)]), ..plain },
            (Wear::Largest { .. }, _) => Spec { cost: Some(1 + plain.weights), ..plain },
        }
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        let virgin = self.by.virgin(parameters, run, sum);
        columns.push(true, |sample| sum[sample] * virgin[sample]);
        if self.curved {
            columns.push(true, |sample| virgin[sample]);
            columns.push(true, |sample| sum[sample] * sum[sample] * virgin[sample]);
            let mut passed = 0.0;
            columns.push(true, |sample| {
                let last = sample.saturating_sub(1);
                passed += self.by.on_the_way(virgin[last], virgin[sample]) * (sum[sample] - sum[last]);
                passed
            });
        }
    }
    fn tell(&self, _: &[f64], weights: &[f64], _: &Session) -> BTreeMap<String, f64> {
        // Of the whole stroke, which is one long.
        BTreeMap::from([("missing_gain".to_owned(), -weights.iter().sum::<f64>())])
    }
}

impl Wear {
    /// The mean of what is left on the way from one sample to the next: a step of the command may be the whole stroke.
    fn on_the_way(&self, before: f64, after: f64) -> f64 {
        // It falls as an exponential of the way.
        let is_exponential = matches!(self, Self::Distance) && before > 1.001 * after;
        if is_exponential { (before - after) / (before / after).ln() } else { 0.5 * (before + after) }
    }

    /// What is left of the virgin material at each sample.
    fn virgin(&self, parameters: &[f64], run: &Run, sum: &[f64]) -> Vec<f64> {
        // A model from a file goes on with a muscle that has been worked long ago.
        let worked = run.session.is_empty() && run.index > 0;
        // After so many strokes; the limit of `slowing` to zero is exponential, that of many strokes a logarithm.
        let left = |done: f64| match parameters.get(1) {
            Some(&slowing) => (-(slowing * done).ln_1p() / (slowing * parameters[0])).exp(),
            None => (-done / parameters[0]).exp(),
        };
        match self {
            // It goes with the distance travelled and comes back with time: `dF = (1 - F) dt / T - F |ds| / D`.
            Self::Distance => {
                let recovers_per_s = parameters.get(1).filter(|time_s| **time_s < NEVER_S).map_or(0.0, |time_s| 1.0 / time_s);
                let mut last = sum[0];
                let step = |left: &mut f64, &value: &f64| {
                    let back = recovers_per_s * run.period_s;
                    let gone = (value - last).abs() / parameters[0] + back;
                    last = value;
                    // Exact while both go on at the same speeds.
                    let settled = if gone > 0.0 { back / gone } else { 1.0 };
                    *left = settled + (*left - settled) * (-gone).exp();
                    Some(*left)
                };
                sum.iter().scan(1.0, step).collect()
            }
            Self::Strokes => {
                // Where the stroke began, and how far it came; nothing while it goes back.
                let (mut done, mut lowest, mut highest) = (0.0, run.input[0], None);
                let count = |&now: &f64| {
                    if let Some(top) = highest {
                        // A stroke is done when half of its way is taken back.
                        let is_done = f64::max(top, now) - now > 0.5 * (f64::max(top, now) - lowest);
                        (done, highest) = if is_done { (done + 1.0, None) } else { (done, Some(f64::max(top, now))) };
                        lowest = if is_done { now } else { lowest };
                    } else {
                        lowest = lowest.min(now);
                        highest = (now - lowest > LEAST_STROKE).then_some(now);
                    }
                    left(done)
                };
                run.input.iter().map(count).collect()
            }
            Self::Crossings => {
                let (mut done, mut is_above) = (0.0, false);
                let count = |&now: &f64| {
                    let was_above = is_above;
                    is_above = now > if was_above { parameters[2] - LEAST_STROKE } else { parameters[2] };
                    done += if was_above && !is_above { 1.0 } else { 0.0 };
                    left(done)
                };
                sum.iter().map(count).collect()
            }
            Self::Load => {
                let mut loaded_s = 0.0;
                let step = |&value: &f64| {
                    loaded_s += value.max(0.0) * run.period_s;
                    (-loaded_s / parameters[0]).exp()
                };
                sum.iter().map(step).collect()
            }
            Self::Lasting => {
                let before = || if worked { f64::INFINITY } else { travelled_before(run) };
                let mut travelled = run.earlier.as_ref().map_or_else(before, |earlier| earlier.travelled);
                let mut last = run.input[0];
                let step = |&value: &f64| {
                    travelled += (value - last).abs();
                    last = value;
                    (-travelled / parameters[0]).exp()
                };
                run.input.iter().map(step).collect()
            }
            Self::Largest { heals } => {
                let before = || if worked { 1.0 } else { highest_before(run) };
                let mut highest: f64 = if *heals { 0.0 } else { run.earlier.as_ref().map_or_else(before, |earlier| earlier.highest) };
                let step = |&value: &f64| {
                    highest = highest.max(value);
                    1.0 - highest
                };
                run.input.iter().map(step).collect()
            }
        }
    }
}

impl Form for BelowPeak {
    fn spec(&self) -> Spec {
        const BELOW: Parameter = Parameter { low: 0.03, high: 2.0, ..DISTANCE };
        Spec {
            parameters: &[BELOW, RECOVERY],
            simpler_at: &[(1, NEVER_S)],
            starts: || grid(&[&[0.1, 0.3, 1.0], &[10.0, NEVER_S]]),
            weights: 1,
            needs_sum: true,
            ..Spec::new(NAME, ("below-peak", "below the highest displacement since the recording began"), Place::Material)
        }
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        let fades_s = parameters[1];
        let share = if fades_s < NEVER_S { 1.0 - (-run.period_s / fades_s).exp() } else { 0.0 };
        let peak = |peak: &mut f64, &value: &f64| {
            *peak = f64::max(*peak + share * (value - *peak), value);
            Some(*peak - value)
        };
        let below: Vec<f64> = sum.iter().scan(sum[0], peak).collect();
        columns.push(true, |sample| sum[sample] * erf(below[sample] / parameters[0]));
    }
    fn tell(&self, _: &[f64], weights: &[f64], _: &Session) -> BTreeMap<String, f64> {
        BTreeMap::from([("missing_gain".to_owned(), -weights[0])])
    }
}

impl Form for RunningIn {
    fn spec(&self) -> Spec {
        const WIDTH: Parameter = Parameter { name: "half_width", quantity: Quantity::Output, low: 5e-3, high: 0.3, logarithmic: true };
        Spec {
            parameters: &[DISTANCE, WIDTH],
            starts: || grid(&[&[0.5, 1.5, 4.0], &[0.02, 0.06]]),
            weights: 1,
            needs_sum: true,
            ..Spec::new(NAME, ("running-in", "a loop that is gone when the displacement has travelled so far"), Place::Material)
        }
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        let left = Wear::Distance.virgin(&parameters[..1], run, sum);
        let mut state = sum[0];
        columns.push(true, |sample| {
            let half = parameters[1] * left[sample];
            // A sum that is not finite is for the fit to refuse.
            state = state.max(sum[sample] - half).min(sum[sample] + half);
            state - sum[sample]
        });
    }
}

/// How far the input of the recordings before this one has travelled.
pub fn travelled_before(run: &Run) -> f64 {
    run.session.iter().take(run.index).map(|earlier| travel(&earlier.input)).sum()
}

/// The highest input of the recordings before this one.
pub fn highest_before(run: &Run) -> f64 {
    run.session.iter().take(run.index).flat_map(|earlier| &earlier.input).copied().fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use recording::{Recording, Signal};
    use std::path::Path;

    const LASTING: Softening = Softening { by: Wear::Lasting, curved: false };
    const TRAVELLED: Softening = Softening { by: Wear::Distance, curved: false };

    #[test]
    fn a_sum_that_is_no_number_is_for_the_fit_to_refuse() {
        let time_s: Vec<f64> = (0..500).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = time_s.iter().map(|time| 0.5 - 0.5 * time.cos()).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let mut columns = Columns::of(500);
        RunningIn.output(&[1.0, 0.1], &session.runs[0], &[f64::NAN; 500], &mut columns);
        assert!(columns.column(0).iter().all(|value| value.is_nan()));
    }

    #[test]
    fn a_stroke_within_one_sample_leaves_what_a_slow_one_does() {
        let time_s: Vec<f64> = (0..400).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = time_s.iter().map(|time| 0.5 - 0.5 * time.cos()).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let left_after = |samples: f64| {
            let stroke: Vec<f64> = (0..400).map(|sample| (f64::from(sample) / samples).min(1.0)).collect();
            let mut columns = Columns::of(stroke.len());
            Softening { by: Wear::Distance, curved: true }.output(&[0.5], &session.runs[0], &stroke, &mut columns);
            columns.column(3)[399]
        };
        // The integral of `exp(-s / D) ds`.
        let exact = 0.5 * (1.0 - (-2.0_f64).exp());
        for samples in [1.0, 3.0, 390.0] {
            assert!((left_after(samples) - exact).abs() < 1e-4, "{samples}: {} instead of {exact}", left_after(samples));
        }
    }

    #[test]
    fn a_lasting_softening_goes_on_where_the_recording_before_left_it() {
        let time_s: Vec<f64> = (0..500).map(|sample| f64::from(sample) * 0.02).collect();
        // Two strokes up and two down: four spans.
        let input: Vec<f64> = time_s.iter().map(|time| 0.5 - 0.5 * (2.0 * std::f64::consts::PI * 0.2 * time).cos()).collect();
        let one = || {
            let (time_s, input) = (time_s.clone(), input.clone());
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input)
        };
        let recordings = [one().expect("a recording"), one().expect("a recording")];
        let session = Session::new(&recordings, &[]).expect("a session");
        let virgin_part = |form: &dyn Form, run: usize, sample: usize| {
            let run = &session.runs[run];
            let mut columns = Columns::of(run.input.len());
            form.output(&[4.0, NEVER_S][..form.parameters().len()], run, &vec![1.0; run.input.len()], &mut columns);
            columns.column(0)[sample]
        };
        assert!((virgin_part(&LASTING, 0, 0) - 1.0).abs() < 1e-12);
        assert!((virgin_part(&LASTING, 1, 0) - (-1.0_f64).exp()).abs() < 1e-3, "{}", virgin_part(&LASTING, 1, 0));
        assert!((virgin_part(&LASTING, 1, 499) - (-2.0_f64).exp()).abs() < 1e-3);
        assert_eq!(virgin_part(&TRAVELLED, 1, 0), 1.0);
    }

    #[test]
    fn time_under_load_and_the_first_strokes_curve_are_what_they_say() {
        let time_s: Vec<f64> = (0..500).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = time_s.iter().map(|time| 0.5 - 0.5 * (2.0 * time).cos()).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        let of = |form: &Softening, parameters: &[f64], sum: &[f64]| -> Vec<Vec<f64>> {
            let mut columns = Columns::of(run.input.len());
            form.output(parameters, run, sum, &mut columns);
            (0..form.spec().weights).map(|at| columns.column(at)).collect()
        };
        // A load of a half for 10 s.
        let load = of(&Softening { by: Wear::Load, curved: false }, &[2.5], &vec![0.5; 500]);
        assert!((load[0][499] - 0.5 * (-2.0_f64).exp()).abs() < 1e-12, "{}", load[0][499]);
        let [plain, curved] = [false, true].map(|curved| of(&Softening { by: Wear::Strokes, curved }, &[1.5], &run.input));
        for sample in 0..500 {
            let (displacement, stiffer) = (run.input[sample], plain[0][sample]);
            let [of_stiffness, of_set, of_square] = [0, 1, 2].map(|at: usize| curved[at][sample]);
            assert_eq!(of_stiffness, stiffer);
            assert!((of_set * displacement - stiffer).abs() < 1e-12 && (of_square - stiffer * displacement).abs() < 1e-12);
        }
        assert!(curved[1][0] == 1.0 && curved[1][499] < 0.2, "{}", curved[1][499]);
    }

    #[test]
    fn a_stroke_counts_when_half_of_it_is_taken_back_or_the_displacement_is_back_below_a_level() {
        let time_s: Vec<f64> = (0..600).map(|sample| f64::from(sample) * 0.02).collect();
        // Up, a short way back and on, down, up, down.
        let knots = [0.0, 0.8, 0.7, 1.0, 0.1, 0.9, 0.0];
        let input: Vec<f64> = (0..600)
            .map(|sample| knots[sample / 100] + (knots[sample / 100 + 1] - knots[sample / 100]) * (sample % 100) as f64 / 100.0)
            .collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        let of = |by: &Wear, parameters: &[f64], sample: usize| by.virgin(parameters, run, &run.input)[sample];
        let is = |value: f64, expected: f64, sample: usize| assert!((value - expected).abs() < 1e-12, "sample {sample}: {value}");
        let strokes = [(99, 0.0), (250, 0.0), (340, 0.0), (370, 1.0), (499, 1.0), (540, 1.0), (570, 2.0)];
        let crossings = [(99, 0.0), (250, 0.0), (330, 0.0), (345, 1.0), (499, 1.0), (520, 1.0), (530, 2.0)];
        for (sample, done) in strokes {
            is(of(&Wear::Strokes, &[2.0], sample), f64::exp(-0.5 * done), sample);
        }
        for (by, counted) in [(Wear::Strokes, strokes), (Wear::Crossings, crossings)] {
            for (sample, done) in counted {
                // The second one counts half as much, by 1 / (1 + n); or as good as alike.
                is(of(&by, &[2.0, 1.0, 0.75], sample), (1.0 + done).powf(-0.5), sample);
                is(of(&by, &[2.0, EVENLY, 0.75], sample), (1.0 + EVENLY * done).powf(-0.5 / EVENLY), sample);
            }
        }
    }

    #[test]
    fn a_peak_fades_and_a_loop_runs_in() {
        let time_s: Vec<f64> = (0..1500).map(|sample| f64::from(sample) * 0.02).collect();
        // Up within 1 s, down to a half, and up and down between a half and nothing.
        let input: Vec<f64> = time_s
            .iter()
            .map(|time| if *time < 2.0 { 1.0 - (0.5 * time - 0.5).abs() } else { 0.25 + 0.25 * (2.0 * (time - 2.0)).cos() })
            .collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        let sum = &run.input;
        let of = |form: &dyn Form, parameters: &[f64]| -> Vec<Vec<f64>> {
            let mut columns = Columns::of(sum.len());
            form.output(parameters, run, sum, &mut columns);
            (0..form.spec().weights).map(|at| columns.column(at)).collect()
        };
        let top = sum.iter().copied().fold(0.0, f64::max);
        for (fades_s, share) in [(NEVER_S, 1.0), (5.0, (-1.0_f64).exp())] {
            let softer = &of(&BelowPeak, &[0.5, fades_s])[0];
            assert!((0..=50).all(|sample| softer[sample].abs() < 1e-12), "on the way up there is no peak to be below");
            // Half a stroke is far below: within 5 s the way to the peak fades to a share, but for where the displacement went meanwhile.
            let (at, now) = (300, sum[300]);
            let [least, most] = [share, share + 0.35 * (1.0 - share)].map(|share| now * erf(share * (top - now) / 0.5));
            assert!(softer[at] > least - 1e-9 && softer[at] < most + 1e-9, "{fades_s} s: {} of {least} to {most}", softer[at]);
        }
        let running_in = of(&RunningIn, &[1.0, 0.1]);
        // It is behind by as much of the half width as the distance so far has left, and by nothing after many strokes.
        let travelled = |at: usize| sum[..=at].windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum::<f64>();
        let expected = -0.1 * (-travelled(40)).exp();
        assert!((running_in[0][40] - expected).abs() < 1e-9, "{} instead of {expected}", running_in[0][40]);
        assert!(running_in[0][1499].abs() < 0.1 * (-travelled(1499)).exp() + 1e-12);
    }

    #[test]
    fn below_its_peak_it_is_softer_and_on_the_way_there_it_is_not() {
        let time_s: Vec<f64> = (0..400).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = time_s.iter().map(|time| 0.5 - 0.5 * (2.0 * std::f64::consts::PI * 0.25 * time).cos()).collect();
        let recording =
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input);
        let session = Session::new(&[recording.expect("a recording")], &[]).expect("a session");
        let run = &session.runs[0];
        let mut columns = Columns::of(run.input.len());
        BelowPeak.output(&[0.2, NEVER_S], run, &run.input, &mut columns);
        let softer = columns.column(0);
        assert!((0..=100).all(|sample| softer[sample] == 0.0));
        // Half way down, and half way up again.
        for sample in [150, 250] {
            assert!((softer[sample] - run.input[sample] * erf(2.5)).abs() < 1e-2, "sample {sample}: {}", softer[sample]);
        }
    }
}
