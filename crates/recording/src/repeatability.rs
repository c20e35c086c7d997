//! What a rig repeats: the error that no model of the input's history can get below.
//!
//! Method. Where two samples have the same past of the input, see `history`, a model gives them the same output; half their mean
//! squared difference is what it cannot explain. Pasts are never quite the same, so the difference is extrapolated to distance zero by a
//! straight line over the squared distance, as in the Gamma test (Stefánsson, Končar and Jones, "A note on the Gamma test", Neural Computing
//! & Applications 5, 1997). A least-squares surface over the past is taken off first: it vanishes from the difference at distance zero and
//! flattens the line. Distances are those by which a linear model says the outputs may differ, in standard deviations of the output.
//!
//! Pairs come from different recordings, so that offsets between recordings count. Where recordings do not repeat each other, strokes of one
//! recording are compared, and the result says so.

use std::collections::HashMap;

use super::{Recording, clock, history, surface};

/// Samples that look for a neighbour, and samples they look among, at most.
const QUERIES: usize = 1500;
const CANDIDATES: usize = 6000;
/// Neighbours of one sample, each in another recording or stroke.
const NEIGHBOURS: usize = 4;
/// Pasts whose outputs may differ by more than this, in standard deviations of the output, do not repeat each other.
const NEAR: f64 = 0.25;
/// What a coordinate counts at least, in standard deviations of the output over those of the input: the output may bend with it.
const LEAST_WEIGHT: f64 = 0.1;
/// Fewest near pairs, and fewest recordings and strokes that they come from.
const FEWEST_PAIRS: usize = 60;
const FEWEST_PLACES: usize = 6;
/// When near pasts differ by more than this share of what the surface leaves of all, in squares, they are not near enough to tell.
const RESOLVED: f64 = 0.5;
/// Distance at which pasts are the same for any purpose.
const SAME: f64 = 0.03;
/// Most pairs of the extrapolation, nearest first.
const MOST_PAIRS: usize = 2000;
/// Samples of a window in which the sensor's noise is looked for.
const WINDOW: usize = 8;
/// What a quarter of such windows do not exceed when the noise is white and normal: the root of the quarter quantile of chi-squared with five
/// degrees of freedom, 2.675, over five.
const QUARTER: f64 = 0.731_4;

/// How well a rig repeats, in the unit of the output.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Repeatability {
    /// Standard deviation of the sensor's noise: what changes from sample to sample where the output is quiet.
    pub noise: f64,
    /// Root mean square of what differs when the input's past repeats, noise included; absent where nothing repeats.
    pub repeatability: Option<f64>,
    /// The same between groups alone (days, loads), where there are groups.
    pub between_groups: Option<f64>,
    /// How it was found, or why it could not be, in words.
    pub method: String,
    /// Pairs of samples with a like past that were compared.
    pub pairs: usize,
}

/// One sample as the search sees it.
struct Sample {
    past: Vec<f64>,
    /// What the surface leaves of the output.
    left: f64,
    recording: usize,
    group: usize,
    /// Number of the stroke within the recording, about.
    stroke: usize,
    time_s: f64,
}

/// Two samples with a like past.
#[derive(Clone, Copy)]
struct Pair {
    /// Recording and stroke of the sample that looked.
    place: (usize, usize),
    squared_distance: f64,
    /// Half the squared difference of the outputs.
    half_square: f64,
}

/// Estimates noise and repeatability of recordings of one rig; all have the same inputs.
#[must_use]
pub fn estimate(recordings: &[Recording]) -> Repeatability {
    let noise = noise(recordings);
    let nothing = |why: &str| Repeatability { noise, repeatability: None, between_groups: None, method: why.to_owned(), pairs: 0 };
    let strokes =
        recordings.iter().flat_map(|recording| recording.inputs().into_iter().filter_map(|values| history::stroke_s(recording, values)));
    let strokes: Vec<f64> = strokes.collect();
    if strokes.is_empty() {
        return nothing("no input moves to and fro, so no past repeats");
    }
    let stroke_s = clock::quantile(strokes, 0.5);
    let samples = samples(recordings, stroke_s);
    let groups = samples.iter().map(|sample| sample.group).max().map_or(0, |most| most + 1);
    let unexplained = samples.iter().map(|sample| sample.left * sample.left).sum::<f64>() / samples.len() as f64;
    let judge = |may_pair: &dyn Fn(&Sample, &Sample) -> bool| gamma(&pairs(&samples, stroke_s, may_pair), unexplained);
    let across = judge(&|one, other| one.recording != other.recording);
    let within = || judge(&|one, other| one.recording == other.recording);
    let (found, method) = match across {
        Some(found) => (found, "samples of different recordings whose inputs had the same past"),
        None => match within() {
            Some(found) => (
                found,
                "strokes of the same recording; no two recordings repeat each other closely, so offsets between recordings are not in it",
            ),
            None => return nothing("no past of the input comes near enough to another, within a recording or between two"),
        },
    };
    let between = (groups > 1).then(|| judge(&|one, other| one.group != other.group)).flatten();
    let rms = |gamma: Gamma| gamma.at_zero.max(noise * noise).sqrt();
    Repeatability {
        noise,
        repeatability: Some(rms(found)),
        between_groups: between.map(rms),
        method: method.to_owned(),
        pairs: found.pairs,
    }
}

/// The samples that take part, evenly picked from all recordings.
fn samples(recordings: &[Recording], stroke_s: f64) -> Vec<Sample> {
    let scales = history::scales(recordings);
    let total: usize = recordings.iter().map(Recording::len).sum();
    let stride = total.div_ceil(CANDIDATES).max(1);
    let mut names: Vec<&str> = Vec::new();
    let (mut samples, mut outputs) = (Vec::new(), Vec::new());
    for (number, recording) in recordings.iter().enumerate() {
        let group = match names.iter().position(|name| *name == recording.group && !name.is_empty()) {
            Some(known) => known,
            None => {
                names.push(&recording.group);
                names.len() - 1
            }
        };
        // Recordings without groups are one group: nothing is between them but what is between recordings.
        let group = if recording.group.is_empty() { 0 } else { group };
        let pasts = history::points(recording, &scales, stroke_s);
        for (index, past) in pasts.into_iter().enumerate().step_by(stride) {
            let time_s = recording.time_s[index];
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count of strokes, not negative")]
            let stroke = (0.5 * (time_s - recording.time_s[0]) / stroke_s) as usize;
            samples.push(Sample { past, left: 0.0, recording: number, group, stroke, time_s });
            outputs.push(recording.output[index]);
        }
    }
    let pasts: Vec<&[f64]> = samples.iter().map(|sample| sample.past.as_slice()).collect();
    let left = surface::residuals(&pasts, &outputs);
    let weights = weights(&pasts, &outputs);
    for (sample, left) in samples.iter_mut().zip(left) {
        sample.left = left;
        sample.past.iter_mut().zip(&weights).for_each(|(value, weight)| *value *= weight);
    }
    samples
}

/// What each coordinate counts: its weight in a linear model of the output, in standard deviations of the output.
fn weights(pasts: &[&[f64]], outputs: &[f64]) -> Vec<f64> {
    let mean = outputs.iter().sum::<f64>() / outputs.len() as f64;
    let spread = (outputs.iter().map(|output| (output - mean).powi(2)).sum::<f64>() / outputs.len() as f64).sqrt();
    let rows: Vec<Vec<f64>> = pasts.iter().map(|past| std::iter::once(1.0).chain(past.iter().copied()).collect()).collect();
    let scale = if spread > 0.0 { spread } else { 1.0 };
    surface::solve(&rows, outputs).iter().skip(1).map(|weight| (weight / scale).abs().max(LEAST_WEIGHT)).collect()
}

/// For each of some samples the nearest ones of other recordings or strokes, one of each, that `may_pair`.
fn pairs(samples: &[Sample], stroke_s: f64, may_pair: impl Fn(&Sample, &Sample) -> bool) -> Vec<Pair> {
    let stride = samples.len().div_ceil(QUERIES).max(1);
    let mut pairs = Vec::new();
    let mut nearest: Vec<((usize, usize), Pair)> = Vec::new();
    // Where the pair of a place stands: a short stroke makes thousands of places.
    let mut known: HashMap<(usize, usize), usize> = HashMap::new();
    for (start, query) in samples.iter().enumerate().step_by(stride) {
        nearest.clear();
        known.clear();
        // From the query on and around: equally near ones of all recordings get their turn.
        for other in samples[start..].iter().chain(&samples[..start]) {
            let same = query.recording == other.recording;
            if !may_pair(query, other) || (same && (query.time_s - other.time_s).abs() < stroke_s) {
                continue;
            }
            let squared_distance = squared_distance(&query.past, &other.past, NEAR * NEAR);
            if squared_distance >= NEAR * NEAR {
                continue;
            }
            let place = (other.recording, if same { other.stroke } else { 0 });
            let pair =
                Pair { place: (query.recording, query.stroke), squared_distance, half_square: 0.5 * (query.left - other.left).powi(2) };
            match known.get(&place) {
                Some(&index) if nearest[index].1.squared_distance <= squared_distance => {}
                Some(&index) => nearest[index].1 = pair,
                None => {
                    known.insert(place, nearest.len());
                    nearest.push((place, pair));
                }
            }
        }
        nearest.sort_by(|one, other| one.1.squared_distance.total_cmp(&other.1.squared_distance));
        pairs.extend(nearest.iter().take(NEIGHBOURS).map(|(_, pair)| *pair));
    }
    pairs
}

/// The squared distance of two points, or something above `enough` as soon as that is sure.
fn squared_distance(one: &[f64], other: &[f64], enough: f64) -> f64 {
    let mut sum = 0.0;
    for (one, other) in one.iter().zip(other) {
        sum += (one - other).powi(2);
        if sum > enough {
            break;
        }
    }
    sum
}

/// The extrapolation to distance zero.
#[derive(Clone, Copy)]
struct Gamma {
    at_zero: f64,
    pairs: usize,
}

/// The line of half squared differences over squared distances, at zero. None with too few near pairs, from too few places, or when they are
/// not near enough: `unexplained` is the mean square of what the surface leaves of all samples.
fn gamma(pairs: &[Pair], unexplained: f64) -> Option<Gamma> {
    // Mixed first, so that of many equally near pairs not the first recordings' are kept (the multiplier is 2^64 over the golden ratio).
    let mut mixed: Vec<(u64, Pair)> =
        pairs.iter().enumerate().map(|(index, pair)| ((index as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15), *pair)).collect();
    mixed.sort_by_key(|(key, _)| *key);
    let mut pairs: Vec<Pair> = mixed.into_iter().map(|(_, pair)| pair).collect();
    pairs.sort_by(|one, other| one.squared_distance.total_cmp(&other.squared_distance));
    pairs.truncate(MOST_PAIRS.min((pairs.len() / 2).max(FEWEST_PAIRS)));
    let mut places: Vec<(usize, usize)> = pairs.iter().map(|pair| pair.place).collect();
    places.sort_unstable();
    places.dedup();
    if pairs.len() < FEWEST_PAIRS || places.len() < FEWEST_PLACES {
        return None;
    }
    let mean = |pairs: &[Pair], value: &dyn Fn(&Pair) -> f64| pairs.iter().map(value).sum::<f64>() / pairs.len() as f64;
    let (x, y) = (mean(&pairs, &|pair| pair.squared_distance), mean(&pairs, &|pair| pair.half_square));
    let xx = mean(&pairs, &|pair| (pair.squared_distance - x).powi(2));
    let xy = mean(&pairs, &|pair| (pair.squared_distance - x) * (pair.half_square - y));
    // More distance never explains less difference, and a line through scatter must not promise what no pair shows: half of what the
    // nearest quarter differs by, root mean square, is the least.
    let slope = if xx > 0.0 { (xy / xx).max(0.0) } else { 0.0 };
    let nearest = mean(&pairs[..pairs.len() / 4], &|pair| pair.half_square);
    let at_zero = (y - slope * x).max(0.25 * nearest);
    (at_zero < RESOLVED * unexplained || x < SAME * SAME).then_some(Gamma { at_zero, pairs: pairs.len() })
}

/// The sensor's noise: what a parabola leaves of short windows, in the quietest quarter of them. A coarse resolution is noise of its own.
#[must_use]
pub fn noise(recordings: &[Recording]) -> f64 {
    let mut left = Vec::new();
    for recording in recordings {
        for segment in recording.segments() {
            left.extend(recording.output[segment].chunks_exact(WINDOW).map(surface::left_of_parabola));
        }
    }
    let quiet = clock::quantile(left, 0.25) / QUARTER;
    let steps: Vec<f64> = recordings.iter().filter_map(|recording| super::condition::resolution(&recording.output)).collect();
    quiet.max(clock::quantile(steps, 0.5) / 12.0_f64.sqrt())
}
