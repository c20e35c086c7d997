//! Noise of sensors.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// A normal deviate by the polar method.
pub(crate) fn normal(generator: &mut ChaCha8Rng) -> f64 {
    loop {
        let (x, y): (f64, f64) = (generator.random_range(-1.0..1.0), generator.random_range(-1.0..1.0));
        let square = x * x + y * y;
        if square > 0.0 && square < 1.0 {
            return x * (-2.0 * square.ln() / square).sqrt();
        }
    }
}

/// Adds noise, half of it correlated over a tenth of a second where it is coloured.
pub(crate) fn add_noise(output: &mut [f64], deviation: f64, coloured: bool, generator: &mut ChaCha8Rng) {
    // Correlated over a tenth of a second: five samples at 50 Hz.
    let keep = (-0.02_f64 / 0.1).exp();
    let kick = (1.0 - keep * keep).sqrt();
    let mut slow = normal(generator);
    for value in output {
        slow = keep * slow + kick * normal(generator);
        let white = normal(generator);
        *value += deviation * if coloured { std::f64::consts::FRAC_1_SQRT_2 * (white + slow) } else { white };
    }
}
