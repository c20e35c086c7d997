//! What the next recording may bring: a prediction interval for its RMSE.
//!
//! The logarithms of the errors on recordings that took no part are taken as normal with a variance that is known a little beforehand
//! (scaled inverse chi-squared, A. Gelman et al., Bayesian Data Analysis, section 2.6): with few recordings the interval is that
//! of rigs in general, with many that of this one. The next error then is Student-t about the mean.

/// Standard deviation of the logarithmic error between recordings of one rig: what is expected before any was seen.
pub const PRIOR_SPREAD: f64 = 0.35;
/// Recordings that this expectation is worth.
pub const PRIOR_RECORDINGS: f64 = 4.0;
/// Blocks of a recording are copies of their neighbours: what the error on another recording is larger by, in logarithm, and the standard
/// deviation of that. Measured on the five development maps of one recording (`tests/baselines/maps.toml`): 2.1 times, 1.2 to 3.9.
pub const BLOCK_EXCESS: f64 = 0.74;
/// See [`BLOCK_EXCESS`].
pub const BLOCK_SPREAD: f64 = 0.5;
/// Maps that these two were measured on.
pub const BLOCK_MAPS: f64 = 5.0;

/// The central 95 % prediction interval for the next recording's RMSE, in the unit of the errors.
///
/// `errors` has one RMSE for each unit that took no part; `independent` is how many of them tell of each other only through the
/// rig: recordings, or groups of recordings; `None` for blocks. Not finite errors are left out; with none left the interval is
/// everything.
#[must_use]
pub fn next(errors: &[f64], independent: Option<usize>) -> [f64; 2] {
    let logs: Vec<f64> = errors.iter().filter(|error| error.is_finite()).map(|error| error.max(f64::MIN_POSITIVE).ln()).collect();
    if logs.is_empty() {
        return [0.0, f64::INFINITY];
    }
    let n = logs.len() as f64;
    let mean = logs.iter().sum::<f64>() / n + if independent.is_none() { BLOCK_EXCESS } else { 0.0 };
    let variance = logs.iter().map(|log| (log - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    // Blocks of one recording say nothing about the spread between recordings.
    let (prior, seen, count) = match independent {
        Some(independent) => (PRIOR_SPREAD, independent.saturating_sub(1) as f64, independent.max(1) as f64),
        None => (BLOCK_SPREAD, 0.0, BLOCK_MAPS),
    };
    let freedom = PRIOR_RECORDINGS + seen;
    let variance = (PRIOR_RECORDINGS * prior * prior + seen * variance) / freedom;
    let half = student(freedom) * (variance * (1.0 + 1.0 / count)).sqrt();
    [(mean - half).exp(), (mean + half).exp()]
}

/// The same where zeros of recordings are nuisances: `shapes` are errors with each recording's own zero taken off, `zeros` the mean
/// errors of recordings that took no part, with their signs. The next zero is Student-t about nothing and may vanish.
#[must_use]
pub fn next_with_zeros(shapes: &[f64], zeros: &[f64], independent: Option<usize>) -> [f64; 2] {
    let [low, high] = next(shapes, independent);
    let zeros: Vec<f64> = zeros.iter().copied().filter(|zero| zero.is_finite()).collect();
    if zeros.is_empty() || !high.is_finite() {
        return [low, high];
    }
    let count = zeros.len() as f64;
    let square = zeros.iter().map(|zero| zero * zero).sum::<f64>() / count;
    // The wide zero with a shape as in the middle, or the wide shape with a zero as in the middle (the median of chi-squared is 0.455).
    let far = (low * high + student(count.max(2.0)).powi(2) * square).sqrt();
    [low, far.max((high * high + 0.455 * square).sqrt())]
}

/// The 97.5 % point of Student's t, by the expansion of Cornish and Fisher (M. Abramowitz and I. Stegun, 26.7.5); within 0.01 from
/// four degrees of freedom on.
fn student(freedom: f64) -> f64 {
    let x = 1.959_963_985_f64;
    let (x3, x5, x7, x9) = (x.powi(3), x.powi(5), x.powi(7), x.powi(9));
    let terms = [
        (x3 + x) / 4.0,
        (5.0 * x5 + 16.0 * x3 + 3.0 * x) / 96.0,
        (3.0 * x7 + 19.0 * x5 + 17.0 * x3 - 15.0 * x) / 384.0,
        (79.0 * x9 + 776.0 * x7 + 1482.0 * x5 - 1920.0 * x3 - 945.0 * x) / 92_160.0,
    ];
    terms.iter().zip(1..).fold(x, |sum, (term, power)| sum + term / freedom.powi(power))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_quantile_is_that_of_tables() {
        for (freedom, table) in [(4.0, 2.776), (6.0, 2.447), (10.0, 2.228), (30.0, 2.042)] {
            assert!((student(freedom) - table).abs() < 0.01, "{freedom}: {}", student(freedom));
        }
    }

    #[test]
    fn many_equal_errors_make_it_narrow_and_one_leaves_it_wide() {
        let [low, high] = next(&[1.0; 60], Some(60));
        assert!(low > 0.75 && high < 1.35, "{low} {high}");
        let [low, high] = next(&[1.0], Some(1));
        assert!(low < 0.4 && high > 2.5, "{low} {high}");
        assert_eq!(next(&[f64::NAN], None), [0.0, f64::INFINITY]);
    }

    #[test]
    fn zeros_widen_it_upwards_alone() {
        let shapes = [1.0; 12];
        assert_eq!(next_with_zeros(&shapes, &[0.0; 12], Some(12)), next(&shapes, Some(12)));
        let zeros: Vec<f64> = (0..12).map(|index| 5.0 * (2.3 * f64::from(index)).sin()).collect();
        let ([low, _], [same, high]) = (next(&shapes, Some(12)), next_with_zeros(&shapes, &zeros, Some(12)));
        assert!(low == same && (7.0..12.0).contains(&high), "{low} {same} {high}");
    }
}
