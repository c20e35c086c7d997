//! What a parametric bootstrap of the innovations would call `unknown`, beside what the verdict does, for whoever works on that verdict:
//!
//! ```text
//! innovations composed-tuning paper 3404 effects aliens
//! ```
//!
//! The simulation's errors are taken for white noise, and for white noise with an Ornstein-Uhlenbeck process (a slowly varying model
//! error). The numbers of either law are those of the greatest likelihood on the recordings that were worked with. Statistic, on the test
//! recordings: Ljung and Box's sum over `LAGS` lags, and the mean square's distance from one. Its distribution: recordings of as many
//! samples drawn from the fitted law, the law fitted again to each draw (Efron and Tibshirani 1993, chapter 16).
//!
//! A smooth answer only: what jumps is not simulated.

use clap::ValueEnum;
use discovery::{DiscoverConfig, Discovery, Finding, Role, Run, Verdict, discover};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use virtual_rig::{self as rig, CaseConfig, EFFECTS, Excitation, Generator};

/// Lags at which innovations are correlated with themselves.
const LAGS: usize = 20;

/// Draws of the bootstrap.
const DRAWS: usize = 99;

/// Effects that jump.
const JUMP: [&str; 2] = ["valve-dead-band", "stick-slip"];

/// White noise, and a model error that varies slowly: standard deviations, and how much of it stays from sample to sample.
#[derive(Clone, Copy, Debug)]
struct Law {
    noise: f64,
    error: f64,
    stay: f64,
}

/// A recording's errors, which of them count, and whether it was worked with.
struct Errors {
    values: Vec<f64>,
    keep: Vec<bool>,
    is_test: bool,
}

impl Law {
    /// Standardised innovations of the samples that count, and the logarithm of their likelihood.
    fn innovations(self, errors: &Errors) -> (Vec<f64>, f64) {
        let (mut mean, mut variance, mut likelihood) = (0.0, self.error.powi(2), 0.0);
        let mut innovations = Vec::with_capacity(errors.values.len());
        for (value, keep) in errors.values.iter().zip(&errors.keep) {
            mean *= self.stay;
            variance = self.stay.powi(2) * variance + self.error.powi(2) * (1.0 - self.stay.powi(2));
            if !keep {
                continue;
            }
            let whole = variance + self.noise.powi(2);
            let innovation = value - mean;
            likelihood -= 0.5 * (whole.ln() + innovation.powi(2) / whole);
            innovations.push(innovation / whole.sqrt());
            let gain = variance / whole;
            mean += gain * innovation;
            variance *= 1.0 - gain;
        }
        (innovations, likelihood)
    }

    /// That of the greatest likelihood on the recordings that were worked with; `slow` with a model error.
    fn fitted(recordings: &[Errors], slow: bool) -> Self {
        let worked = || recordings.iter().filter(|one| !one.is_test);
        let kept =
            |one: &Errors| one.values.iter().zip(&one.keep).filter(|(_, keep)| **keep).map(|(value, _)| *value).collect::<Vec<f64>>();
        let squares: Vec<f64> = worked().flat_map(kept).map(|value| value * value).collect();
        let all = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        let mut best = Self { noise: all, error: 0.0, stay: 0.0 };
        if !slow {
            return best;
        }
        let likelihood = |law: Self| worked().map(|one| law.innovations(one).1).sum::<f64>();
        best = Self { noise: 0.7 * all, error: 0.7 * all, stay: 0.95 };
        let mut most = likelihood(best);
        let mut step = 1.6_f64;
        while step > 1.005 {
            let before = most;
            for axis in 0..3 {
                for factor in [step, 1.0 / step] {
                    let mut law = best;
                    match axis {
                        0 => law.noise *= factor,
                        1 => law.error *= factor,
                        _ => law.stay = 1.0 - ((1.0 - law.stay) * factor).min(1.0),
                    }
                    let likelihood = likelihood(law);
                    if likelihood > most {
                        (best, most) = (law, likelihood);
                    }
                }
            }
            if most <= before {
                step = step.sqrt();
            }
        }
        best
    }

    /// How far the innovations of the test recordings are from white noise of the size that the law expects.
    fn statistic(self, recordings: &[Errors]) -> f64 {
        let of_test: Vec<Vec<f64>> = recordings.iter().filter(|one| one.is_test).map(|one| self.innovations(one).0).collect();
        let count = of_test.iter().map(Vec::len).sum::<usize>() as f64;
        let square = of_test.iter().flatten().map(|value| value * value).sum::<f64>() / count;
        let correlation = |lag: usize| {
            let products = of_test.iter().flat_map(|one| one.iter().zip(one.iter().skip(lag)).map(|(early, late)| early * late));
            products.sum::<f64>() / (count * square)
        };
        let colour: f64 = (1..=LAGS).map(|lag| correlation(lag).powi(2)).sum();
        count * (colour + 0.5 * (square - 1.0).powi(2))
    }

    /// Recordings of as many samples whose errors follow the law.
    fn drawn(self, recordings: &[Errors], generator: &mut ChaCha8Rng) -> Vec<Errors> {
        let mut normal = || {
            let (radius, angle): (f64, f64) = (generator.random_range(f64::MIN_POSITIVE..1.0), generator.random_range(0.0..1.0));
            (-2.0 * radius.ln()).sqrt() * (std::f64::consts::TAU * angle).cos()
        };
        let of = |one: &Errors| {
            let mut slow = self.error * normal();
            let mut next = || {
                slow = self.stay * slow + self.error * (1.0 - self.stay.powi(2)).sqrt() * normal();
                slow + self.noise * normal()
            };
            Errors { values: one.values.iter().map(|_| next()).collect(), keep: one.keep.clone(), is_test: one.is_test }
        };
        recordings.iter().map(of).collect()
    }
}

/// Probability of innovations as far from the law as these.
fn p_value(recordings: &[Errors], slow: bool, seed: u64) -> f64 {
    let law = Law::fitted(recordings, slow);
    let observed = law.statistic(recordings);
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    let farther = (0..DRAWS).filter(|_| {
        let drawn = law.drawn(recordings, &mut generator);
        Law::fitted(&drawn, slow).statistic(&drawn) >= observed
    });
    (1 + farther.count()) as f64 / (1 + DRAWS) as f64
}

/// What the answer's simulation misses.
fn errors(finding: &Finding) -> Vec<Errors> {
    let residuals = finding.after.residuals(&finding.session);
    let of = |(run, values): (&Run, Vec<f64>)| Errors { values, keep: run.keep.clone(), is_test: run.role.contains(&Role::Test) };
    finding.session.runs.iter().zip(residuals).map(of).collect()
}

/// Whether the answer is the effect that was hidden, or that nothing was.
fn is_right(hidden: &[String], discovery: &Discovery) -> bool {
    let named: Vec<&String> = discovery.effects.iter().map(|effect| &effect.name).collect();
    named == hidden.iter().collect::<Vec<_>>() && discovery.verdict != Verdict::Unknown
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let generator = Generator::from_str(&arguments[1], true).expect("a rig");
    let excitation = Excitation::from_str(&arguments[2], true).expect("an excitation");
    let of = |name: &String| match name.as_str() {
        "effects" => EFFECTS.to_vec(),
        "aliens" => generator.aliens().to_vec(),
        _ => vec!["none"],
    };
    for seed in arguments[3].split(',').map(|seed| seed.parse().expect("a seed")) {
        for name in arguments[4..].iter().flat_map(of) {
            let effects: Vec<String> = if name == "none" { Vec::new() } else { vec![name.to_owned()] };
            let config = CaseConfig { effects, seed, generator, excitation, ..CaseConfig::default() };
            let case = rig::hide(&config).expect("a case");
            let finding = discover(&case.recordings, &case.kept_out, &DiscoverConfig::default()).expect("a finding");
            let discovery = &finding.discovery;
            if finding.after.names().any(|name| JUMP.contains(&name)) {
                continue;
            }
            let errors = errors(&finding);
            let [white, slow] = [false, true].map(|slow| p_value(&errors, slow, seed));
            let answer = if is_right(&config.effects, discovery) { "right" } else { "other" };
            let left = discovery.unexplained;
            println!(
                "{answer} {name} {seed} {:?} left {left:.3}, p of white noise {white:.2}, with a slow error {slow:.2}",
                discovery.verdict
            );
        }
    }
}
