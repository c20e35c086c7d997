//! What closed-form rigs of the tests share.

/// Nearly normal deviates of unit variance, the same for equal seeds: the sum of twelve uniform ones (xorshift; Marsaglia 2003).
pub fn deviates(seed: u64) -> impl FnMut() -> f64 {
    let mut kept = seed;
    move || {
        (0..12).fold(-6.0, |sum, _| {
            kept ^= kept << 13;
            kept ^= kept >> 7;
            kept ^= kept << 17;
            sum + (kept >> 11) as f64 / (1_u64 << 53) as f64
        })
    }
}
