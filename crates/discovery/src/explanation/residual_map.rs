//! Where simulation and measurement disagree: along which quantity, in which region, and whether that could be chance.
//!
//! The energy of the residual is taken sample by sample. A region (say, the falling half of the strokes) disagrees when it holds more
//! energy than its share of the samples. How much more it might hold by chance is found by drawing blocks of two seconds again and
//! again with replacement (block bootstrap: neighbours stay together, so their correlation counts). Of all regions tested those are
//! told whose false discovery rate stays below 5 % (Benjamini and Hochberg 1995).

use output::text::plain_number;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::data::noise;
use crate::data::phasors::transform;
use crate::data::session::{Run, Session};
use crate::data::statistics::tail;

/// A region in which model and measurement disagree.
#[derive(Clone, Debug, Serialize)]
pub struct Disagreement {
    /// Quantity that the region is cut from.
    pub axis: String,
    /// The region, in words and units.
    pub region: String,
    /// Share of the residual's energy above the noise that lies there, 0 to 1.
    pub share: f64,
    /// Share that would lie there if the energy were spread evenly, 0 to 1.
    pub even_share: f64,
    /// Probability of so much more energy than elsewhere by chance.
    pub p_value: f64,
}

/// Draws of the bootstrap.
const DRAWS: usize = 300;

/// Length of its blocks, s.
const BLOCK_S: f64 = 2.0;

/// False discovery rate that is allowed.
const FALSE_DISCOVERIES: f64 = 0.05;

/// What is significant but hardly more than an even share helps nobody.
const LEAST_EXCESS: f64 = 1.15;

/// One way to cut the session: a name and the region of every sample.
struct Cut {
    axis: &'static str,
    regions: Vec<String>,
    /// Region of each sample, recording after recording.
    of_sample: Vec<usize>,
}

/// A region of a cut with what each block has to say of it.
struct Tested {
    axis: &'static str,
    region: String,
    share: f64,
    even_share: f64,
    /// Energy in the region less its even share, block by block.
    surplus: Vec<f64>,
}

/// Regions whose disagreement is no chance, the most significant first, largest share first among equals.
#[must_use]
pub fn disagreements(session: &Session, residual: &[Vec<f64>], seed: u64) -> Vec<Disagreement> {
    let floor_square = noise::floor(session, residual).powi(2);
    let samples: usize = session.runs.iter().map(|run| run.input.len()).sum();
    let mut energy = Vec::with_capacity(samples);
    let mut kept = Vec::with_capacity(samples);
    let mut block_of = Vec::with_capacity(samples);
    let mut blocks = 0;
    for (run, residual) in session.runs.iter().zip(residual) {
        let length = (BLOCK_S / run.period_s).round().max(4.0) as usize;
        for (sample, value) in residual.iter().enumerate() {
            let counts = run.counts(sample);
            energy.push(if counts { value * value } else { 0.0 });
            kept.push(if counts { 1.0 } else { 0.0 });
            block_of.push(blocks + sample / length);
        }
        blocks += residual.len().div_ceil(length);
    }
    let count: f64 = kept.iter().sum();
    let total: f64 = energy.iter().sum();
    let excess = total - floor_square * count;
    // Nothing above the noise can be anywhere in particular.
    if excess < 0.02 * floor_square * count {
        return Vec::new();
    }
    let mut tested = Vec::new();
    for cut in cuts(session) {
        for (region, words) in cut.regions.iter().enumerate() {
            let (mut members, mut held) = (0.0, 0.0);
            for at in (0..samples).filter(|&at| cut.of_sample[at] == region) {
                members += kept[at];
                held += energy[at];
            }
            let even_share = members / count;
            if !(0.005..=0.98).contains(&even_share) {
                continue;
            }
            let mut surplus = vec![0.0; blocks];
            for at in 0..samples {
                let member = if cut.of_sample[at] == region { 1.0 } else { 0.0 };
                surplus[block_of[at]] += (member - even_share) * energy[at];
            }
            let share = ((held - floor_square * members) / excess).clamp(0.0, 1.0);
            tested.push(Tested { axis: cut.axis, region: words.clone(), share, even_share, surplus });
        }
    }
    tested.extend(frequencies(session, residual, floor_square));
    judge(tested, seed)
}

/// Keeps what is no chance.
fn judge(tested: Vec<Tested>, seed: u64) -> Vec<Disagreement> {
    let mut all: Vec<Disagreement> = tested
        .into_iter()
        .map(|one| {
            let mut generator = ChaCha8Rng::seed_from_u64(seed);
            let count = one.surplus.len();
            let here: f64 = one.surplus.iter().sum();
            let draws: Vec<f64> = (0..DRAWS).map(|_| (0..count).map(|_| one.surplus[generator.random_range(0..count)]).sum()).collect();
            let mean = draws.iter().sum::<f64>() / DRAWS as f64;
            let deviation = (draws.iter().map(|draw| (draw - mean).powi(2)).sum::<f64>() / DRAWS as f64).sqrt();
            Disagreement {
                axis: one.axis.to_owned(),
                region: one.region,
                share: one.share,
                even_share: one.even_share,
                p_value: tail(here / deviation.max(1e-30)),
            }
        })
        .collect();
    all.sort_by(|x, y| x.p_value.total_cmp(&y.p_value).then(y.share.total_cmp(&x.share)));
    let number = all.len() as f64;
    let last = all.iter().enumerate().rposition(|(rank, one)| one.p_value <= FALSE_DISCOVERIES * (rank + 1) as f64 / number);
    all.truncate(last.map_or(0, |last| last + 1));
    all.retain(|one| one.share >= LEAST_EXCESS * one.even_share && one.share >= 0.05);
    all
}

/// The residual's power in bands of frequency, stretches of 512 samples as blocks.
fn frequencies(session: &Session, residual: &[Vec<f64>], floor_square: f64) -> Vec<Tested> {
    const LENGTH: usize = 512;
    let period_s = session.runs[0].period_s;
    let highest_hz = 0.5 / period_s;
    let mut edges = vec![0.0];
    let mut edge = 0.25;
    while edge < 0.7 * highest_hz {
        edges.push(edge);
        edge *= 2.0;
    }
    edges.push(highest_hz);
    let line_hz = 1.0 / (LENGTH as f64 * period_s);
    let lines: Vec<usize> = (1..LENGTH / 2).collect();
    let band_of: Vec<usize> =
        lines.iter().map(|&line| edges[1..edges.len() - 1].partition_point(|edge| *edge <= line as f64 * line_hz)).collect();
    let bands = edges.len() - 1;
    let lines_hz: Vec<f64> = lines.iter().map(|&line| line as f64 * line_hz).collect();
    let mut of_stretch: Vec<Vec<f64>> = Vec::new();
    for values in residual {
        for stretch in values.chunks_exact(LENGTH) {
            let mut power = vec![0.0; bands];
            let [re, im] = transform(stretch, 0.0, period_s, &lines_hz);
            for ((&band, re), im) in band_of.iter().zip(re).zip(im) {
                power[band] += 2.0 * (re * re + im * im) / (LENGTH * LENGTH) as f64;
            }
            of_stretch.push(power);
        }
    }
    if of_stretch.len() < 6 {
        return Vec::new();
    }
    let total: f64 = of_stretch.iter().flatten().sum();
    // White noise of the floor's size puts the same power on every line.
    let noise_line = 2.0 * floor_square / LENGTH as f64;
    let excess = total - noise_line * (lines.len() * of_stretch.len()) as f64;
    (0..bands)
        .filter_map(|band| {
            let members = band_of.iter().filter(|&&of| of == band).count() as f64;
            if members == 0.0 || excess <= 0.0 {
                return None;
            }
            let even_share = members / lines.len() as f64;
            let held: f64 = of_stretch.iter().map(|power| power[band]).sum();
            let share = ((held - noise_line * members * of_stretch.len() as f64) / excess).clamp(0.0, 1.0);
            let surplus = of_stretch.iter().map(|power| power[band] - even_share * power.iter().sum::<f64>()).collect();
            let region = format!("{} to {} Hz", plain_number(edges[band], 3), plain_number(edges[band + 1], 3));
            Some(Tested { axis: "frequency", region, share, even_share, surplus })
        })
        .collect()
}

/// All the cuts in time.
fn cuts(session: &Session) -> Vec<Cut> {
    let unit = &session.input_unit;
    let samples: Vec<(usize, usize)> =
        session.runs.iter().enumerate().flat_map(|(run, of)| (0..of.input.len()).map(move |sample| (run, sample))).collect();
    let rates: Vec<f64> = samples.iter().map(|&(run, sample)| rate(session, run, sample)).collect();
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
    let (scale, offset) = (session.input_scale, session.input_offset);
    let all = |of: fn(&Run) -> &[f64]| session.runs.iter().flat_map(of).copied().collect::<Vec<f64>>();
    quantiles("input", all(|run| &run.input), 5, &|low, high| {
        format!("{} to {} {unit}", plain_number(low * scale + offset, 4), plain_number(high * scale + offset, 4))
    });
    quantiles("rate", rates.iter().map(|rate| rate.abs()).collect(), 4, &|low, high| {
        format!("{} to {} {unit}/s", plain_number(low * scale, 4), plain_number(high * scale, 4))
    });
    let (since_reversal, cycle) = reversals(session);
    quantiles("time since reversal", since_reversal, 4, &|low, high| format!("{low:.2} to {high:.2} s"));
    quantiles("time in the recording", all(|run| &run.time_s), 4, &|low, high| format!("{low:.1} to {high:.1} s"));
    quantiles("session time", all(|run| &run.session_s), 4, &|low, high| format!("{low:.0} to {high:.0} s"));
    cuts.push(Cut {
        axis: "loop",
        regions: vec!["first".into(), "second".into(), "third".into(), "fourth and later".into()],
        of_sample: cycle.into_iter().map(|cycle| cycle.min(3)).collect(),
    });
    let still = 1e-3 * session.fastest_per_s;
    cuts.push(Cut {
        axis: "direction",
        regions: vec!["rising".into(), "falling".into(), "at rest".into()],
        of_sample: rates.iter().map(|rate| if rate.abs() <= still { 2 } else { usize::from(*rate < 0.0) }).collect(),
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

/// Rate of the input, spans per s.
fn rate(session: &Session, run: usize, sample: usize) -> f64 {
    let of = &session.runs[run];
    let (before, after) = (sample.saturating_sub(1), (sample + 1).min(of.input.len() - 1));
    (of.input[after] - of.input[before]) / ((after - before).max(1) as f64 * of.period_s)
}

/// For every sample the time since the input last turned round, s, and how many loops the recording has closed before.
fn reversals(session: &Session) -> (Vec<f64>, Vec<usize>) {
    let (mut since, mut cycles) = (Vec::new(), Vec::new());
    for run in &session.runs {
        let mut extreme = run.input[0];
        let mut rising = true;
        let mut turned_s = run.time_s[0];
        let mut turns = 0;
        for (&value, &time_s) in run.input.iter().zip(&run.time_s) {
            let ahead = if rising { value - extreme } else { extreme - value };
            if ahead >= 0.0 {
                extreme = value;
            } else if ahead < -0.01 {
                rising = !rising;
                extreme = value;
                turned_s = time_s;
                turns += 1;
            }
            since.push(time_s - turned_s);
            cycles.push(turns / 2);
        }
    }
    (since, cycles)
}

/// Root mean square of the residual by level and rate of the input: the levels, then for each rate (falling fast to rising fast) its
/// words and the values in output units; NaN where there are fewer than ten samples.
#[must_use]
pub fn map(session: &Session, residual: &[Vec<f64>]) -> (Vec<f64>, Vec<(String, Vec<f64>)>) {
    const LEVELS: usize = 12;
    const RATES: [f64; 6] = [-0.5, -0.15, -0.002, 0.002, 0.15, 0.5];
    let words = ["\u{2193} fast", "\u{2193}", "\u{2193} slow", "at rest", "\u{2191} slow", "\u{2191}", "\u{2191} fast"];
    let (mut low, mut high) = (f64::MAX, f64::MIN);
    for value in session.runs.iter().flat_map(|run| &run.input) {
        (low, high) = (low.min(*value), high.max(*value));
    }
    let mut sums = vec![[(0.0, 0.0_f64); LEVELS]; RATES.len() + 1];
    for (index, (run, residual)) in session.runs.iter().zip(residual).enumerate() {
        for (sample, value) in residual.iter().enumerate().filter(|&(sample, _)| run.counts(sample)) {
            let row = RATES.partition_point(|edge| edge * session.fastest_per_s <= rate(session, index, sample));
            let column = ((run.input[sample] - low) / (high - low) * LEVELS as f64) as usize;
            let cell = &mut sums[row][column.min(LEVELS - 1)];
            cell.0 += value * value;
            cell.1 += 1.0;
        }
    }
    let scale = session.output_scale.abs();
    let rows = words
        .iter()
        .zip(sums)
        .map(|(words, row)| {
            let values = row.iter().map(|&(sum, count)| if count < 10.0 { f64::NAN } else { (sum / count).sqrt() * scale }).collect();
            ((*words).to_owned(), values)
        })
        .collect();
    let middle = |column: usize| (low + (column as f64 + 0.5) / LEVELS as f64 * (high - low)) * session.input_scale + session.input_offset;
    ((0..LEVELS).map(middle).collect(), rows)
}

/// The most telling disagreements as a sentence.
#[must_use]
pub fn sentence(found: &[Disagreement], rmse: f64, floor: f64, unit: &str) -> String {
    let differ = format!("Simulation and measurement differ by {} {unit}", plain_number(rmse, 4));
    if rmse <= 1.02 * floor {
        return format!("{differ}, which is no more than the noise.");
    }
    let begin = format!("{differ} (noise: {} {unit})", plain_number(floor, 4));
    let mut best: Vec<&Disagreement> = Vec::new();
    for one in found {
        match best.iter_mut().find(|other| other.axis == one.axis) {
            // Of each axis the region that holds most in proportion.
            Some(other) if one.share / one.even_share > other.share / other.even_share => *other = one,
            Some(_) => {}
            None => best.push(one),
        }
    }
    // Every slow effect has low frequencies, and some recording is always the worst: these two come last.
    let rank = |one: &Disagreement| ["frequency", "recording"].contains(&one.axis.as_str());
    best.sort_by(|x, y| rank(x).cmp(&rank(y)).then((y.share - y.even_share).total_cmp(&(x.share - x.even_share))));
    if best.is_empty() {
        return format!("{begin}, spread evenly: no region holds more than its share.");
    }
    let part = |one: &&Disagreement| {
        let place = match one.axis.as_str() {
            "direction" => format!("while the input is {}", one.region).replace("is at rest", "rests"),
            "recording" => format!("in the recording {}", one.region),
            "loop" => format!("in the {} loop of a recording", one.region).replace("fourth and later loop", "fourth and later loops"),
            axis => format!("at {axis} {}", one.region),
        };
        let of = if one.axis == "frequency" { "band" } else { "samples" };
        format!("{place} ({:.0} % of it in {} % of the {of})", 100.0 * one.share, plain_number(100.0 * one.even_share, 2))
    };
    let parts: Vec<String> = best.iter().take(4).map(part).collect();
    format!("{begin}, most of all {}.", parts.join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tested(axis: &'static str, surplus: Vec<f64>) -> Tested {
        Tested { axis, region: "here".into(), share: 0.5, even_share: 0.2, surplus }
    }

    #[test]
    fn what_is_the_same_in_every_block_is_told_and_chance_is_not() {
        let mut generator = ChaCha8Rng::seed_from_u64(500);
        let noise: Vec<f64> = (0..200).map(|_| generator.random_range(-1.0..1.0)).collect();
        let middle = noise.iter().sum::<f64>() / 200.0;
        let chance: Vec<f64> = noise.iter().map(|value| value - middle).collect();
        let steady: Vec<f64> = noise.iter().map(|value| value + 0.4).collect();
        let found = judge(vec![tested("rate", steady), tested("input", chance)], 7);
        assert_eq!(found.iter().map(|one| one.axis.as_str()).collect::<Vec<_>>(), ["rate"]);
        assert!(found[0].p_value < 1e-6, "{}", found[0].p_value);
    }

    #[test]
    fn of_a_thousand_regions_of_noise_next_to_none_is_told() {
        let mut generator = ChaCha8Rng::seed_from_u64(501);
        let regions = (0..1000).map(|_| tested("rate", (0..100).map(|_| generator.random_range(-1.0..1.0)).collect())).collect();
        // The false discovery rate is 5 %: with nothing to discover, some region is told in one of twenty cases.
        assert!(judge(regions, 8).len() <= 2);
    }
}
