//! Random parameters, histories and signals for the property tests.

use proptest::collection::vec;
use proptest::prelude::*;

/// This many random cases; a failure prints its smallest input, and no file is written beside the sources.
#[must_use]
pub fn cases(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

/// Thresholds from zero and weights, such that every partial sum of the weights lies in 0.1 to 3: each inverse amplifies rounding by ten
/// at most. Single weights may be negative.
pub fn invertible() -> impl Strategy<Value = (Vec<f64>, Vec<f64>)> {
    vec((0.001..0.5f64, 0.1..3.0f64), 1..12).prop_map(|operators| {
        let (mut thresholds, mut weights) = (Vec::new(), Vec::new());
        let (mut threshold, mut slope) = (0.0, 0.0);
        for (index, (distance, next_slope)) in operators.into_iter().enumerate() {
            threshold += if index == 0 { 0.0 } else { distance };
            thresholds.push(threshold);
            weights.push(next_slope - slope);
            slope = next_slope;
        }
        (thresholds, weights)
    })
}

/// White samples, and walks that dwell and turn: the two reach different memories.
pub fn signal() -> impl Strategy<Value = Vec<f64>> {
    let white = vec(-5.0..5.0f64, 1..200);
    let walk = vec(prop_oneof![Just(0.0), -1.0..1.0f64, -0.01..0.01f64], 1..200).prop_map(|steps| {
        let mut position: f64 = 0.0;
        steps
            .into_iter()
            .map(|step| {
                position = (position + step).clamp(-5.0, 5.0);
                position
            })
            .collect()
    });
    prop_oneof![white, walk]
}

/// The largest distance between two signals of one length.
pub fn largest_difference(left: &[f64], right: &[f64]) -> f64 {
    assert_eq!(left.len(), right.len());
    left.iter().zip(right).map(|(left, right)| (left - right).abs()).fold(0.0, f64::max)
}
