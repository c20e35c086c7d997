//! `first-cycle-softening` (Mullins): the first strokes are stiffer, `y = s (1 - A exp(-d / D))` with the distance travelled `d` since the
//! recording began, where the muscle recovers in between (and maybe in time), or since the session began, where it does not; or with the number of
//! strokes done. Or it is the largest load so far
//! that counts, and the way back is another one than the way there (Mullins 1969): `y = s (1 - A (1 - U))` with the highest input `U`; or below its own
//! peak `p` it is softer than on the way there, `y = s (1 + A erf((p - s) / D))` (Ogden and Roxburgh 1999).

use std::collections::BTreeMap;

use statrs::function::erf::erf;

use crate::chain::columns::Columns;
use crate::chain::filters::{grid, ladder, row};
use crate::chain::form::{Form, Parameter, Place, Quantity, Spec, Told};
use crate::data::session::{Run, Session};

/// All forms.
pub const FORMS: &[&dyn Form] = &[
    &Softening::Distance,
    &Softening::Strokes,
    &Softening::Lasting,
    &Softening::Largest { heals: true },
    &Softening::Largest { heals: false },
    &Softening::BelowPeak,
];

/// What softens.
enum Softening {
    /// The distance travelled in a recording.
    Distance,
    /// The strokes that are done in a recording.
    Strokes,
    /// That distance in the session.
    Lasting,
    /// The highest input, since the recording began where the muscle heals in between, or since the session began.
    Largest { heals: bool },
    /// How far the displacement is below its own peak since the recording began.
    BelowPeak,
}

/// A recovery that no session lasts for, s.
const NEVER_S: f64 = 1e4;

/// Shortest way up that is a stroke, spans.
const LEAST_STROKE: f64 = 0.1;

/// Way up and down that an input takes.
fn travel(input: &[f64]) -> f64 {
    input.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum()
}

impl Form for Softening {
    fn spec(&self) -> Spec {
        let of = |form: Told| Spec { weights: 1, needs_sum: true, ..Spec::new("first-cycle-softening", form, Place::Material) };
        match self {
            Self::Distance => Spec {
                parameters: &[
                    Parameter { name: "distance", quantity: Quantity::Output, low: 0.1, high: 10.0, logarithmic: true },
                    Parameter { name: "recovery_time", quantity: Quantity::Time, low: 3.0, high: NEVER_S, logarithmic: true },
                ],
                simpler_at: &[(1, NEVER_S)],
                starts: || grid(&ladder(0.3, 6.0, 6), &[20.0, NEVER_S]),
                ..of(("distance-in-recording", "with the distance that the displacement has travelled since the recording began"))
            },
            Self::Strokes => Spec {
                parameters: &[Parameter { name: "strokes", quantity: Quantity::Ratio, low: 0.2, high: 10.0, logarithmic: true }],
                starts: || row(&[0.5, 1.5, 4.0]),
                ..of(("strokes-in-recording", "with the strokes that are done since the recording began"))
            },
            Self::Lasting => Spec {
                // First cycles are few: what goes on for many recordings is a drift of the gain.
                parameters: &[Parameter {
                    name: "distance_in_input_spans",
                    quantity: Quantity::Ratio,
                    low: 0.3,
                    high: 20.0,
                    logarithmic: true,
                }],
                // Over like strokes a gain that drifts towards a limit does the same: where that does as well, it is drift.
                cost: Some(3),
                starts: || row(&ladder(1.0, 15.0, 4)),
                ..of(("distance-in-session", "with the distance that the input has travelled since the session began"))
            },
            Self::Largest { heals: true } => {
                Spec { cost: Some(2), ..of(("highest-in-recording", "by the highest input since the recording began")) }
            }
            Self::Largest { heals: false } => {
                Spec { cost: Some(2), ..of(("highest-in-session", "by the highest input since the session began")) }
            }
            Self::BelowPeak => Spec {
                parameters: &[Parameter { name: "distance", quantity: Quantity::Output, low: 0.03, high: 2.0, logarithmic: true }],
                starts: || row(&[0.1, 0.3, 1.0]),
                ..of(("below-peak", "below the highest displacement since the recording began"))
            },
        }
    }
    fn output(&self, parameters: &[f64], run: &Run, sum: &[f64], columns: &mut Columns) {
        // A model from a file goes on with a muscle that has been worked long ago.
        let worked = run.session.is_empty() && run.index > 0;
        match self {
            // What is stiffer, `R`, goes with the distance travelled and comes back with time: `dR = (1 - R) dt / T - R |ds| / D`.
            Self::Distance => {
                let recovers_per_s = if parameters[1] < NEVER_S { 1.0 / parameters[1] } else { 0.0 };
                let (mut stiff, mut last) = (1.0, sum[0]);
                columns.push(true, |sample| {
                    let back = recovers_per_s * run.period_s;
                    let gone = (sum[sample] - last).abs() / parameters[0] + back;
                    last = sum[sample];
                    // Exact while both go on at the same speeds.
                    let settled = if gone > 0.0 { back / gone } else { 1.0 };
                    stiff = settled + (stiff - settled) * (-gone).exp();
                    sum[sample] * stiff
                });
            }
            Self::Strokes => {
                // Where the stroke began, and how far it came; nothing while it goes back.
                let (mut done, mut lowest, mut highest) = (0.0, run.input[0], None);
                columns.push(true, |sample| {
                    let now = run.input[sample];
                    if let Some(top) = highest {
                        // A stroke is done when half of its way is taken back.
                        let is_done = f64::max(top, now) - now > 0.5 * (f64::max(top, now) - lowest);
                        (done, highest) = if is_done { (done + 1.0, None) } else { (done, Some(f64::max(top, now))) };
                        lowest = if is_done { now } else { lowest };
                    } else {
                        lowest = lowest.min(now);
                        highest = (now - lowest > LEAST_STROKE).then_some(now);
                    }
                    sum[sample] * (-done / parameters[0]).exp()
                });
            }
            Self::Lasting => {
                let before = || if worked { f64::INFINITY } else { travelled_before(run) };
                let mut travelled = run.earlier.as_ref().map_or_else(before, |earlier| earlier.travelled);
                let mut last = run.input[0];
                columns.push(true, |sample| {
                    travelled += (run.input[sample] - last).abs();
                    last = run.input[sample];
                    sum[sample] * (-travelled / parameters[0]).exp()
                });
            }
            Self::Largest { heals } => {
                let before = || if worked { 1.0 } else { highest_before(run) };
                let mut highest: f64 = if *heals { 0.0 } else { run.earlier.as_ref().map_or_else(before, |earlier| earlier.highest) };
                columns.push(true, |sample| {
                    highest = highest.max(run.input[sample]);
                    sum[sample] * (1.0 - highest)
                });
            }
            Self::BelowPeak => {
                let mut peak = sum[0];
                columns.push(true, |sample| {
                    peak = peak.max(sum[sample]);
                    sum[sample] * erf((peak - sum[sample]) / parameters[0])
                });
            }
        }
    }
    fn tell(&self, _: &[f64], weights: &[f64], _: &Session) -> BTreeMap<String, f64> {
        BTreeMap::from([("missing_gain".to_owned(), -weights[0])])
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
        assert!((virgin_part(&Softening::Lasting, 0, 0) - 1.0).abs() < 1e-12);
        assert!((virgin_part(&Softening::Lasting, 1, 0) - (-1.0_f64).exp()).abs() < 1e-3, "{}", virgin_part(&Softening::Lasting, 1, 0));
        assert!((virgin_part(&Softening::Lasting, 1, 499) - (-2.0_f64).exp()).abs() < 1e-3);
        assert_eq!(virgin_part(&Softening::Distance, 1, 0), 1.0);
    }

    #[test]
    fn a_stroke_counts_when_half_of_it_is_taken_back() {
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
        let mut columns = Columns::of(run.input.len());
        Softening::Strokes.output(&[2.0], run, &vec![1.0; run.input.len()], &mut columns);
        for (sample, done) in [(99, 0.0), (250, 0.0), (340, 0.0), (370, 1.0), (499, 1.0), (540, 1.0), (570, 2.0)] {
            assert!((columns.column(0)[sample] - f64::exp(-0.5 * done)).abs() < 1e-12, "sample {sample}: {}", columns.column(0)[sample]);
        }
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
        Softening::BelowPeak.output(&[0.2], run, &run.input, &mut columns);
        let softer = columns.column(0);
        assert!((0..=100).all(|sample| softer[sample] == 0.0));
        // Half way down, and half way up again.
        for sample in [150, 250] {
            assert!((softer[sample] - run.input[sample] * erf(2.5)).abs() < 1e-2, "sample {sample}: {}", softer[sample]);
        }
    }
}
