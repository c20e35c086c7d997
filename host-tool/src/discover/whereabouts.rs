//! Where simulation and measurement disagree: along which quantity, in which region, and whether that could be chance.
//!
//! The energy of the residual is taken in blocks of half a second. A region (say, the falling half of the strokes) disagrees when its
//! blocks hold more energy than the others. Chance is what remains when the energies are turned against the regions by whole shifts of
//! the session, which keeps the correlation of neighbours (circular surrogates). Of all regions tested those are told whose false
//! discovery rate stays below 5 % (Benjamini and Hochberg 1995).

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use super::noise;
use super::session::Session;

/// A region in which model and measurement disagree.
#[derive(Clone, Debug, Serialize)]
pub struct Disagreement {
    /// Quantity that the region is cut from.
    pub axis: String,
    /// The region, in words and units.
    pub region: String,
    /// Share of the residual's energy above the noise that lies there, 0 to 1.
    pub share: f64,
    /// Probability of so much more energy than elsewhere by chance.
    pub p_value: f64,
}

/// Surrogates drawn.
const SURROGATES: usize = 400;
/// False discovery rate that is allowed.
const FALSE_DISCOVERIES: f64 = 0.05;

/// One way to cut the session: a name and the region of every sample.
struct Cut {
    axis: &'static str,
    regions: Vec<String>,
    /// Region of each sample, recording after recording.
    of_sample: Vec<usize>,
}

/// Regions whose disagreement is no chance, the most significant first, largest share first among equals.
#[must_use]
pub fn disagreements(session: &Session, residual: &[Vec<f64>], seed: u64) -> Vec<Disagreement> {
    let block = (0.5 / session.runs[0].period_s).round().max(4.0) as usize;
    let floor_square = noise::floor(session, residual).powi(2);
    let energy: Vec<f64> = session
        .runs
        .iter()
        .zip(residual)
        .flat_map(|(run, residual)| {
            residual.iter().zip(&run.keep).map(|(value, &keep)| if keep { value * value - floor_square } else { 0.0 })
        })
        .collect();
    let total: f64 = energy.iter().sum::<f64>().max(1e-30);
    let blocks = energy.len().div_ceil(block);
    let energy_of: Vec<f64> = energy.chunks(block).map(|chunk| chunk.iter().sum()).collect();
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    let shifts: Vec<usize> = (0..SURROGATES).map(|_| generator.random_range(1..blocks.max(2))).collect();
    let mut all = Vec::new();
    for cut in cuts(session) {
        for (region, words) in cut.regions.iter().enumerate() {
            let membership: Vec<f64> =
                cut.of_sample.chunks(block).map(|chunk| chunk.iter().filter(|&&of| of == region).count() as f64).collect();
            let members: f64 = membership.iter().sum();
            if members < 2.0 * block as f64 || members > 0.98 * energy.len() as f64 {
                continue;
            }
            let held = |shift: usize| -> f64 {
                membership.iter().enumerate().map(|(at, members)| members * energy_of[(at + shift) % blocks]).sum::<f64>() / block as f64
            };
            let here = held(0);
            let above = shifts.iter().filter(|&&shift| held(shift) >= here).count();
            let share: f64 =
                energy.iter().zip(&cut.of_sample).filter(|&(_, &of)| of == region).map(|(value, _)| value).sum::<f64>() / total;
            all.push(Disagreement {
                axis: cut.axis.to_owned(),
                region: words.clone(),
                share: share.clamp(0.0, 1.0),
                p_value: (above + 1) as f64 / (SURROGATES + 1) as f64,
            });
        }
    }
    all.sort_by(|x, y| x.p_value.total_cmp(&y.p_value).then(y.share.total_cmp(&x.share)));
    let tested = all.len() as f64;
    let last = all.iter().enumerate().rposition(|(rank, one)| one.p_value <= FALSE_DISCOVERIES * (rank + 1) as f64 / tested);
    all.truncate(last.map_or(0, |last| last + 1));
    all
}

/// All the cuts.
fn cuts(session: &Session) -> Vec<Cut> {
    let unit = &session.input_unit;
    let samples: Vec<(usize, usize)> =
        session.runs.iter().enumerate().flat_map(|(run, of)| (0..of.input.len()).map(move |sample| (run, sample))).collect();
    let rate = |run: usize, sample: usize| {
        let of = &session.runs[run];
        let (before, after) = (sample.saturating_sub(1), (sample + 1).min(of.input.len() - 1));
        (of.input[after] - of.input[before]) / ((after - before) as f64 * of.period_s)
    };
    let mut cuts = Vec::new();
    let mut quantiles = |axis: &'static str, values: Vec<f64>, count: usize, words: &dyn Fn(f64, f64) -> String| {
        let mut sorted = values.clone();
        sorted.sort_by(f64::total_cmp);
        let edge = |index: usize| sorted[(index * (sorted.len() - 1)) / count];
        let mut edges: Vec<f64> = (0..=count).map(edge).collect();
        edges.dedup();
        if edges.len() < 3 {
            return;
        }
        let regions = edges.windows(2).map(|pair| words(pair[0], pair[1])).collect();
        let last = edges.len() - 2;
        let of_sample = values.iter().map(|value| edges[1..=last].partition_point(|edge| edge <= value)).collect();
        cuts.push(Cut { axis, regions, of_sample });
    };
    let scale = session.input_scale;
    let offset = session.input_offset;
    quantiles("input", samples.iter().map(|&(run, sample)| session.runs[run].input[sample]).collect(), 5, &|low, high| {
        format!("{:.3} to {:.3} {unit}", low * scale + offset, high * scale + offset)
    });
    quantiles("rate", samples.iter().map(|&(run, sample)| rate(run, sample).abs()).collect(), 4, &|low, high| {
        format!("{:.3} to {:.3} {unit}/s", low * scale, high * scale)
    });
    quantiles("time since reversal", since_reversal(session), 4, &|low, high| format!("{low:.2} to {high:.2} s"));
    quantiles("time in the recording", samples.iter().map(|&(run, sample)| session.runs[run].time_s[sample]).collect(), 4, &|low, high| {
        format!("{low:.1} to {high:.1} s")
    });
    quantiles("session time", samples.iter().map(|&(run, sample)| session.runs[run].session_s[sample]).collect(), 4, &|low, high| {
        format!("{low:.0} to {high:.0} s")
    });
    let still = 1e-3 * session.fastest_per_s;
    cuts.push(Cut {
        axis: "direction",
        regions: vec!["rising".into(), "falling".into(), "at rest".into()],
        of_sample: samples
            .iter()
            .map(|&(run, sample)| {
                let rate = rate(run, sample);
                if rate > still {
                    0
                } else if rate < -still {
                    1
                } else {
                    2
                }
            })
            .collect(),
    });
    if session.runs.len() > 1 {
        cuts.push(Cut {
            axis: "recording",
            regions: session.runs.iter().map(|run| run.name.clone()).collect(),
            of_sample: samples.iter().map(|&(run, _)| run).collect(),
        });
    }
    cuts
}

/// Time since the input last turned round, s, for every sample.
fn since_reversal(session: &Session) -> Vec<f64> {
    let mut all = Vec::new();
    for run in &session.runs {
        let mut extreme = run.input[0];
        let mut rising = true;
        let mut turned_s = run.time_s[0];
        for (&value, &time_s) in run.input.iter().zip(&run.time_s) {
            let ahead = if rising { value - extreme } else { extreme - value };
            if ahead >= 0.0 {
                extreme = value;
            } else if ahead < -0.01 {
                rising = !rising;
                extreme = value;
                turned_s = time_s;
            }
            all.push(time_s - turned_s);
        }
    }
    all
}

/// The first few disagreements as a sentence.
#[must_use]
pub fn sentence(found: &[Disagreement]) -> String {
    if found.is_empty() {
        return "Simulation and measurement disagree nowhere in particular.".to_owned();
    }
    let mut seen: Vec<&str> = Vec::new();
    let mut parts = Vec::new();
    for one in found {
        if !seen.contains(&one.axis.as_str()) && one.axis != "recording" {
            seen.push(&one.axis);
            parts.push(format!("{} {} ({:.0} % of it, p = {:.3})", one.axis, one.region, 100.0 * one.share, one.p_value));
        }
    }
    if parts.is_empty() {
        return format!("The disagreement lies in the recording {}.", found[0].region);
    }
    parts.truncate(4);
    format!("The disagreement lies mostly at {}.", parts.join("; "))
}
