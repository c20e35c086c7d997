//! What selection and verdict can be set by: level, folds, materiality, the price of an effect, what counts as unexplained, and the computing budget.

/// Level: probability by which an explanation leaves the confidence set that is as good as the best.
pub const LEVEL: f64 = 0.1;

/// Materiality: share of the best explanation's gain by which others may differ and nobody cares, of what is left that a further effect takes away, and
/// of all there was that a pair may leave before others are looked for.
pub const MATERIAL_SHARE: f64 = 0.05;

/// Materiality: that difference at least and at most, nats per sample. Innovations whose standard deviations differ by one percent differ by 0.01.
pub const MATERIAL: [f64; 2] = [0.0025, 0.01];

/// Level: blocked deviations from which on an improvement is taken into the search.
pub const LIKELY: f64 = 2.0;

/// Folds: fewest recordings of which whole halves are left out and between which a law of the session can be seen, and fewest strokes that show any.
pub const FEWEST_FOR_HALVES: usize = 6;

/// Materiality: root mean square over that of the noise from which on something is left to explain.
pub const STANDS_OUT: f64 = 1.15;

/// Materiality: root mean square, relative to the output's span, that a rig with thresholds of its own leaves on the fine grid: up to 0.079 % with
/// twenty random operators and recordings without noise, in the median 0.007 % (first rig) and 0.026 % (second), twelve rigs in a test.
pub const GRID_ERROR: f64 = 0.0008;

/// Price of an effect that jumps or stands beside one that does, in the logarithm of the likelihood per sample. Of four rounds of the virtual rigs'
/// unknown effects (47 cases), the highest were 0.027, 0.025 and 0.023.
pub const JUMPS: f64 = 0.03;

/// Price of an effect that jumps do not look like, beside them.
pub const BESIDE_JUMPS: f64 = 0.015;

/// Largest scatter of break-aways and landings, in break-away distances or in the travel of a tip that lands beyond: with more, a law follows any
/// output by jumping whenever it must.
pub const MOST_SCATTER: f64 = 0.5;

/// Largest share of the mean square above the noise that may stay unexplained beside a named effect, and beside one whose law is another than the
/// catalogue's. A form that is not quite the rig's leaves 2 to 10 %. Of 26 tuning cases with the right effect in front that left more than the first, 17
/// left less than the second; of 56 with something that is none of the effects, two.
pub const UNEXPLAINED: [f64; 2] = [0.12, 0.25];

/// What is closed by less of test recordings is no explanation; nothing that could as well be otherwise is believed by more.
pub const HALF: f64 = 0.5;

/// Computing budget: explanations that are compared in all.
pub const MOST_COMPARED: usize = 14;

/// Computing budget: first effects that a second is looked for beside at first, and smooth explanations whose jumps are fitted in full.
pub const FEW: usize = 2;

/// Computing budget: candidates of a round that are polished.
pub const BREADTH: usize = 5;
