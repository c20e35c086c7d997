//! The input path in `f64`: what the blob's front end does to the input before the operators.

/// The input path: a dead time with linear interpolation between samples, then a first-order lag `v += a (u - v)`, both at the
/// equilibrium of the first sample. The same arithmetic as the blob's front end, in f64.
#[must_use]
pub fn input_path(input: &[f64], dead_time_samples: f64, lag_coefficient: f64) -> Vec<f64> {
    let Some(&first) = input.first() else { return Vec::new() };
    let whole = dead_time_samples.floor();
    let part = dead_time_samples - whole;
    let whole = whole as usize;
    let ago = |index: usize, samples: usize| index.checked_sub(samples).map_or(first, |before| input[before]);
    let mut path = first;
    (0..input.len())
        .map(|index| {
            let delayed = if part == 0.0 { ago(index, whole) } else { (1.0 - part) * ago(index, whole) + part * ago(index, whole + 1) };
            if lag_coefficient == 1.0 {
                return delayed;
            }
            path += lag_coefficient * (delayed - path);
            path
        })
        .collect()
}

/// The coefficient of a first-order filter for a time constant; 1 (no filter) for none.
pub(super) fn coefficient(sample_period_s: f64, time_constant_s: f64) -> f64 {
    if time_constant_s > 0.0 { -(-sample_period_s / time_constant_s).exp_m1() } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_input_path_delays_and_lags() {
        let input: Vec<f64> = (0..50).map(|k| f64::from(k * k)).collect();
        let delayed = input_path(&input, 2.25, 1.0);
        assert!((delayed[10] - (0.75 * 64.0 + 0.25 * 49.0)).abs() < 1e-12 && delayed[0] == 0.0);
        let step: Vec<f64> = (0..50).map(|k| f64::from(u8::from(k > 0))).collect();
        let lagged = input_path(&step, 0.0, 0.25);
        assert!((lagged[3] - (1.0 - 0.75_f64.powi(3))).abs() < 1e-12);
    }
}
