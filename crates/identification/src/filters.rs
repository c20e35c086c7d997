//! Linear filters of one signal, in the steps of its samples.

/// A second-order filter by the bilinear transformation, which keeps it stable at any step.
pub struct Oscillator {
    /// Weights of the present input and of the two before.
    forward: [f64; 3],
    /// Weights of the two outputs before.
    back: [f64; 2],
    /// Output at rest over input.
    rest: f64,
}

impl Oscillator {
    /// `angle` is the natural angular frequency times the sample period; `rate`: its output is `y' / w` instead of `y`.
    pub fn new(angle: f64, damping: f64, rate: bool) -> Self {
        // Pre-warped, so that the natural frequency is met; held below the Nyquist frequency.
        let k = (0.5 * angle.min(3.0)).tan();
        let scale = 1.0 + 2.0 * damping * k + k * k;
        let forward = if rate { [k / scale, 0.0, -k / scale] } else { [k * k / scale, 2.0 * k * k / scale, k * k / scale] };
        let back = [2.0 * (k * k - 1.0) / scale, (1.0 - 2.0 * damping * k + k * k) / scale];
        Self { forward, back, rest: f64::from(u8::from(!rate)) }
    }

    /// Filters in place from the equilibrium of the first value.
    pub fn run(&self, values: &mut [f64]) {
        let Some(&start) = values.first() else { return };
        let (mut x1, mut x2, mut y1, mut y2) = (start, start, self.rest * start, self.rest * start);
        for value in values {
            let x = *value;
            let y = self.forward[0] * x + self.forward[1] * x1 + self.forward[2] * x2 - self.back[0] * y1 - self.back[1] * y2;
            (x2, x1, y2, y1) = (x1, x, y1, y);
            *value = y;
        }
    }
}

/// The coefficient of a first-order filter for a time constant; 1 (no filter) for none.
pub fn coefficient(sample_period_s: f64, time_constant_s: f64) -> f64 {
    if time_constant_s > 0.0 { -(-sample_period_s / time_constant_s).exp_m1() } else { 1.0 }
}
