//! How much of the residual is noise: from rest, where nothing else can be, or from the residual's fast part.

use super::mask::fast_noise;
use super::session::{Role, Session};

/// Standard deviation of the noise, normalised, from the residuals of all recordings.
///
/// Rest tells it with its colour: each stretch loses its mean, and what that takes away of correlated noise is given back by the
/// correlation of neighbours (an AR(1) law). Without a hundred samples of rest, or where something moves during it, the fast part has to
/// do, which misses coloured noise. A pump too fast to be told by that shows as a line of the spectrum at rest, and lines are no noise. A sensor that reads in steps wider than its noise hides at rest what it adds in motion: a uniform
/// error of the step's width.
#[must_use]
pub fn floor(session: &Session, residual: &[Vec<f64>]) -> f64 {
    let mut sum = 0.0;
    let mut neighbours = 0.0;
    let mut count = 0.0;
    let mut freedom = 0.0;
    let mut lengths = 0.0;
    let mut stretches = 0.0;
    let mut slow = SlowMotion::new(session.runs[0].period_s);
    let mut lines = Lines::new();
    for (run, residual) in session.runs.iter().zip(residual) {
        for rest in &run.rest {
            let values: Vec<f64> = rest.clone().filter(|&sample| run.keep[sample]).map(|sample| residual[sample]).collect();
            if values.len() < 10 {
                continue;
            }
            // Straight line off: creep and drift move during rest, noise does not.
            let n = values.len() as f64;
            let mean = values.iter().sum::<f64>() / n;
            let centre = 0.5 * (n - 1.0);
            let slope = values.iter().enumerate().map(|(at, value)| (at as f64 - centre) * value).sum::<f64>() / (n * (n * n - 1.0) / 12.0);
            let flat: Vec<f64> = values.iter().enumerate().map(|(at, value)| value - mean - slope * (at as f64 - centre)).collect();
            sum += flat.iter().map(|value| value * value).sum::<f64>();
            slow.add(&flat);
            lines.add(&flat);
            neighbours += flat.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>();
            count += n;
            freedom += n - 2.0;
            lengths += n;
            stretches += 1.0;
        }
    }
    let fast = || {
        let mut floors: Vec<f64> = residual.iter().map(|values| fast_noise(values)).collect();
        floors.sort_by(f64::total_cmp);
        floors[floors.len() / 2]
    };
    let step = session.output_step;
    let with_step = |square: f64| if step * step > 0.25 * square { square + step * step / 12.0 } else { square };
    let over_fast = (sum / count).sqrt() / fast().max(1e-30);
    if count < 100.0 || (slow.is_there() && over_fast > 2.0) || (slow.swings() && over_fast > 1.3) {
        return with_step(fast().powi(2)).sqrt();
    }
    let of_lines = lines.share();
    // A line's correlation is not the noise's.
    let correlation = if of_lines > 0.0 { 0.0 } else { (neighbours / sum.max(1e-30)).clamp(0.0, 0.9) };
    let mean_length = lengths / stretches;
    let lost = (2.0 * (1.0 + correlation) / (1.0 - correlation) / mean_length).min(0.6);
    let white_lost = 2.0 / mean_length;
    let whole = blocks(session, residual, |run, sample| session.runs[run].role[sample] != Role::Kept);
    let whole = whole.iter().sum::<f64>() / whole.len().max(1) as f64;
    // Rest in recordings that the model does not fit may hold more than noise; the noise is never more than the whole residual.
    with_step(sum / freedom * (1.0 - of_lines) * (1.0 - white_lost) / (1.0 - lost)).min(whole).sqrt()
}

/// Motion during rest that is too slow for a sensor's noise: a rhythm, a hand, a valve that hunts. It must not pass for noise, or the
/// very effect that is sought would raise the floor above itself.
struct SlowMotion {
    lags: Vec<usize>,
    products: Vec<f64>,
    energy: f64,
}

impl SlowMotion {
    /// Looks at delays of 0.15 to 0.5 s; a sensor's filter is faster.
    fn new(period_s: f64) -> Self {
        let lags: Vec<usize> = (0..8).map(|step| ((0.15 + 0.05 * f64::from(step)) / period_s).round().max(1.0) as usize).collect();
        Self { products: vec![0.0; lags.len()], lags, energy: 1e-30 }
    }

    fn add(&mut self, flat: &[f64]) {
        self.energy += flat.iter().map(|value| value * value).sum::<f64>();
        for (product, &lag) in self.products.iter_mut().zip(&self.lags) {
            *product += flat.iter().zip(flat.iter().skip(lag)).map(|(x, y)| x * y).sum::<f64>();
        }
    }

    /// Whether it goes to and fro, as noise that merely fades does not.
    fn swings(&self) -> bool {
        self.products.iter().any(|product| product / self.energy < -0.4)
    }

    fn is_there(&self) -> bool {
        self.products.iter().any(|product| (product / self.energy).abs() > 0.5)
    }
}

/// The spectrum at rest, averaged over windows: noise of any colour is smooth, a pump is a line.
struct Lines {
    powers: [f64; WINDOW / 2],
    windows: f64,
}

/// Samples of a window; windows overlap by half.
const WINDOW: usize = 64;
/// Fewest windows whose average tells a line: it scatters by 0.3 of itself then.
const FEWEST_WINDOWS: f64 = 12.0;
/// Power of a line over the median of its surroundings, seven such scatters above one.
const LINE: f64 = 3.0;
/// Lowest bin that may be a line: noise correlated over a tenth of a second rises steeply below.
const LOWEST_LINE: usize = 4;

impl Lines {
    fn new() -> Self {
        Self { powers: [0.0; WINDOW / 2], windows: 0.0 }
    }

    fn add(&mut self, flat: &[f64]) {
        let turn = 2.0 * std::f64::consts::PI / WINDOW as f64;
        for start in (0..(flat.len() + 1).saturating_sub(WINDOW)).step_by(WINDOW / 2) {
            // Hann's window keeps a line within two bins of its own.
            let faded: Vec<f64> = (0..WINDOW).map(|at| flat[start + at] * 0.5 * (1.0 - (turn * (at as f64 + 0.5)).cos())).collect();
            for (bin, power) in self.powers.iter_mut().enumerate() {
                let angle = |at: usize| turn * (bin * at % WINDOW) as f64;
                let (re, im) = faded.iter().enumerate().fold((0.0, 0.0), |(re, im), (at, value)| {
                    let (sine, cosine) = angle(at).sin_cos();
                    (re + value * cosine, im + value * sine)
                });
                *power += re * re + im * im;
            }
            self.windows += 1.0;
        }
    }

    /// Share of the energy that is in lines.
    fn share(&self) -> f64 {
        if self.windows < FEWEST_WINDOWS {
            return 0.0;
        }
        let last = self.powers.len();
        let around = |bin: usize| {
            let far = |other: &usize| other.abs_diff(bin) > 2;
            let mut near: Vec<f64> =
                (bin.saturating_sub(6).max(1)..(bin + 7).min(last)).filter(far).map(|other| self.powers[other]).collect();
            near.sort_by(f64::total_cmp);
            near[near.len() / 2]
        };
        let is_line = |bin: usize| self.powers[bin] > LINE * around(bin);
        let lines: Vec<usize> = (LOWEST_LINE..last).filter(|&bin| is_line(bin)).collect();
        let belongs = |bin: &usize| lines.iter().any(|line| line.abs_diff(*bin) <= 2);
        let excess: f64 = (1..last).filter(belongs).map(|bin| (self.powers[bin] - around(bin)).max(0.0)).sum();
        excess / self.powers[1..].iter().sum::<f64>().max(1e-30)
    }
}

/// Mean squares of blocks of about one second, over the samples for which `wanted` holds.
#[must_use]
pub fn blocks(session: &Session, residual: &[Vec<f64>], wanted: impl Fn(usize, usize) -> bool) -> Vec<f64> {
    let mut all = Vec::new();
    for (index, (run, residual)) in session.runs.iter().zip(residual).enumerate() {
        let length = (1.0 / run.period_s).round().max(4.0) as usize;
        for start in (0..residual.len()).step_by(length) {
            let samples: Vec<usize> =
                (start..(start + length).min(residual.len())).filter(|&sample| run.keep[sample] && wanted(index, sample)).collect();
            if samples.len() * 2 >= length {
                all.push(samples.iter().map(|&sample| residual[sample].powi(2)).sum::<f64>() / samples.len() as f64);
            }
        }
    }
    all
}
