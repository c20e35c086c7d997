//! Nuisances: what moves the output of a whole recording, or of its rest, and is no part of the map from inputs to output.
//!
//! Terms. A recording's *zero* is its constant. A *step* is one place in a recording behind which its zero is another. A *covariate* is
//! a slow signal beside the inputs, such as session time or temperature, to which the zero answers in proportion; its coefficient is
//! one for all recordings.
//!
//! One principle decides on all of them, on the recordings of a fit alone:
//!
//! 1. A flexible reference predicts each recording from the others. Its weights come from normal equations out of which the zero on
//!    each side of each candidate step is projected, so that no nuisance can hide in them.
//! 2. What it leaves is tested: a step by the means of blocks on its two sides, zeros by the means of the two halves of each
//!    recording (analysis of variance with random effects, R. A. Fisher, 1925: the scatter between the halves is what slow errors of
//!    the model explain), a covariate by the line through the recordings' means. Each test has the level [`LEVEL`].
//! 3. What is significant must also matter. Recordings left out must be predicted clearly better: zeros from the *other* half of the
//!    recording, a covariate from the other recordings, both against a reference that knows of no nuisance. A recording cannot win by
//!    having a constant of its own, and a memory that only looks like a zero is already explained by the reference without.

use statrs::function::beta::beta_reg;

use crate::Series;

/// Chance at which a test names what is not there.
pub const LEVEL: f64 = 0.005;
/// Mean square error that zeros must take away, as a share, and that a covariate must.
const ZEROS_MATTER: f64 = 0.5;
const COVARIATE_MATTERS: f64 = 0.15;
/// Share of what the reference leaves of a recording that a step must explain.
const STEP_CLEAR: f64 = 0.5;
/// Steps below this share of the output's range are of no interest.
const STEP_SMALL: f64 = 0.01;
/// A step is sharp: within two windows of this share of a recording it shows so much of its height, and no other place shows more than
/// such a share of that.
const STEP_WINDOW: f64 = 0.02;
const STEP_SHARP: f64 = 0.7;
const STEP_ELSEWHERE: f64 = 0.5;
/// Strokes of the input that a recording must have, and each side of a step: fewer say too little of what the input explains.
const STROKES: usize = 8;
const STROKES_BESIDE: usize = 3;
/// A stroke moves an input by this share of its range in the recording.
const STROKE: f64 = 0.2;
/// Places of a step are tried between this share of a recording and one less this share.
const STEP_MARGIN: f64 = 0.15;
/// Blocks of a recording whose means tell a step.
const STEP_BLOCKS: usize = 16;
/// Fewest recordings whose zeros can be compared, and fewest that can show a line.
const FEWEST: usize = 3;
const FEWEST_LINE: usize = 5;
/// Samples that a place is looked for in, at most.
const SCANNED: usize = 1200;

/// A slow signal beside the inputs.
#[derive(Clone, Debug, PartialEq)]
pub struct Covariate {
    /// What it is: `drift` for session time, `temperature`.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// One value a sample, one list a recording.
    pub values: Vec<Vec<f64>>,
}

/// What a search knows of possible nuisances before it looks at any two recordings together.
#[derive(Clone, Debug, Default)]
pub(crate) struct Candidates {
    /// Index of the first sample behind the most likely step of each recording.
    pub steps: Vec<Option<usize>>,
    /// Covariates, less [`Self::centres`] and over [`Self::halves`].
    pub covariates: Vec<Covariate>,
    /// Mean over the recordings of each covariate: where a model stands.
    pub centres: Vec<f64>,
    /// Half of each one's range.
    pub halves: Vec<f64>,
}

/// What is decided, and what it was estimated as.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Nuisances {
    /// Whether each recording has a zero of its own.
    pub zeros: bool,
    /// Whether each recording has a step.
    pub steps: Vec<bool>,
    /// Coefficient of each covariate, for the covariate centred and scaled; absent: no nuisance.
    pub covariates: Vec<Option<f64>>,
    /// Estimates by the reference, for recordings that took part: the zero less the mean zero.
    pub offsets: Vec<f64>,
    /// The same: height of each step.
    pub heights: Vec<f64>,
}

/// What a reference leaves of a recording that took no part in it.
pub(crate) struct Left {
    pub series: usize,
    /// Samples in order, and what is left there by a reference without zeros in its weights.
    pub samples: Vec<usize>,
    pub left: Vec<f64>,
    /// The same by a reference that knows of steps alone, constant taken off.
    pub as_is: Vec<f64>,
}

impl Candidates {
    /// Looks for a place in each recording by itself, and centres the covariates.
    pub fn of(series: &[Series], columns: impl Fn(&Series, &[usize]) -> Vec<Vec<f64>>) -> Self {
        Self { steps: series.iter().map(|one| place(one, &columns)).collect(), ..Self::default() }
    }

    /// Takes covariates that move.
    pub fn with(mut self, covariates: Vec<Covariate>, recordings: usize) -> Self {
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let useful = |covariate: &Covariate| {
            let (low, high) = range(covariate.values.iter().flatten().copied());
            high > low && covariate.values.len() == recordings && (high - low).is_finite()
        };
        for mut covariate in covariates.into_iter().filter(useful) {
            let (low, high) = range(covariate.values.iter().flatten().copied());
            let centre = mean(&covariate.values.iter().map(|one| mean(one)).collect::<Vec<_>>());
            let half = 0.5 * (high - low);
            covariate.values.iter_mut().flatten().for_each(|value| *value = (*value - centre) / half);
            self.covariates.push(covariate);
            self.centres.push(centre);
            self.halves.push(half);
        }
        self
    }
}

impl Nuisances {
    /// None at all.
    pub(crate) fn none(candidates: &Candidates) -> Self {
        Self {
            zeros: false,
            steps: vec![false; candidates.steps.len()],
            covariates: vec![None; candidates.covariates.len()],
            offsets: vec![0.0; candidates.steps.len()],
            heights: vec![0.0; candidates.steps.len()],
        }
    }

    /// All that can be projected out: for a reference.
    pub(crate) fn all(candidates: &Candidates) -> Self {
        Self { zeros: true, steps: candidates.steps.iter().map(Option::is_some).collect(), ..Self::none(candidates) }
    }

    /// Whether nothing is named.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        !self.zeros && !self.steps.contains(&true) && self.covariates.iter().all(Option::is_none)
    }

    /// What the covariates move sample `index` of a recording by.
    pub(crate) fn moved(&self, candidates: &Candidates, series: usize, index: usize) -> f64 {
        let pairs = self.covariates.iter().zip(&candidates.covariates);
        pairs.filter_map(|(coefficient, covariate)| Some((*coefficient)? * covariate.values[series][index])).sum()
    }

    /// The output of a recording that took part, its nuisances taken off; the mean zero stays.
    pub(crate) fn cleaned(&self, candidates: &Candidates, series: usize, output: &[f64]) -> Vec<f64> {
        let step = candidates.steps[series].filter(|_| self.steps[series]).unwrap_or(usize::MAX);
        let height = |index: usize| if index >= step { self.heights[series] } else { 0.0 };
        let own = if self.zeros { self.offsets[series] } else { 0.0 };
        output.iter().enumerate().map(|(index, value)| value - own - height(index) - self.moved(candidates, series, index)).collect()
    }
}

/// The steps that are clear in what a reference leaves. `range` is that of the output.
pub(crate) fn decide_on_steps(candidates: &Candidates, left: &[Left], range: f64) -> Nuisances {
    let mut found = Nuisances::none(candidates);
    for one in left {
        found.steps[one.series] = candidates.steps[one.series].is_some_and(|step| height_is_clear(one, step, range));
    }
    found
}

/// Names the most significant covariate that is not named yet, if it is significant and matters; whether there was one. What is left by
/// either reference may show it: the one with zeros of their own where those are large, the other where recordings are at different
/// operating points, whose levels tell nothing once each has a zero.
pub(crate) fn name_covariate(candidates: &Candidates, left: &[Left], found: &mut Nuisances) -> bool {
    if left.len() < FEWEST_LINE {
        return false;
    }
    let plain = Nuisances { covariates: vec![None; found.covariates.len()], ..found.clone() };
    let columns: Vec<Vec<f64>> = candidates.covariates.iter().map(|one| means(one, candidates, left, found)).collect();
    let named: Vec<usize> = (0..columns.len()).filter(|&index| found.covariates[index].is_some()).collect();
    let free: Vec<usize> = (0..columns.len()).filter(|index| !named.contains(index)).collect();
    let freedom = left.len() as f64 - named.len() as f64 - 2.0;
    if freedom < 1.0 {
        return false;
    }
    let trial = |with_zeros: bool, more: usize| {
        let halves: Vec<Halves> = left.iter().map(|one| Halves::of(candidates, one, one.values(with_zeros), &plain)).collect();
        let zeros: Vec<f64> = halves.iter().map(Halves::mean).collect();
        // Mean square of what each recording leaves about a zero that is predicted from the others.
        let scatter: f64 = halves.iter().map(|one| one.square_about(one.mean())).sum();
        let now: Vec<&[f64]> = named.iter().map(|&index| columns[index].as_slice()).collect();
        let with: Vec<&[f64]> = now.iter().copied().chain([columns[more].as_slice()]).collect();
        let (_, without, _) = line(&now, &zeros)?;
        let (coefficients, squares, left_out) = line(&with, &zeros)?;
        let chance = f_beyond((without - squares) / (squares / freedom).max(f64::MIN_POSITIVE), 1.0, freedom);
        Some((chance, left_out + scatter, more, coefficients))
    };
    let trials = [true, false].into_iter().flat_map(|with_zeros| free.iter().filter_map(move |&more| trial(with_zeros, more)));
    let tried = 2.0 * free.len() as f64;
    let before = square_as_is(candidates, left, found);
    let good = trials.filter(|(chance, after, ..)| chance * tried < LEVEL && *after < (1.0 - COVARIATE_MATTERS) * before);
    let Some((_, _, more, coefficients)) = good.min_by(|one, other| one.1.total_cmp(&other.1)) else { return false };
    for (index, coefficient) in named.into_iter().chain([more]).zip(coefficients) {
        found.covariates[index] = Some(coefficient);
    }
    true
}

/// Estimates the named covariates anew from what is left by the reference with or without zeros.
pub(crate) fn estimate_covariates(candidates: &Candidates, left: &[Left], with_zeros: bool, found: &mut Nuisances) {
    let named: Vec<usize> = (0..found.covariates.len()).filter(|&index| found.covariates[index].is_some()).collect();
    if named.is_empty() {
        return;
    }
    let plain = Nuisances { covariates: vec![None; found.covariates.len()], ..found.clone() };
    let zeros: Vec<f64> = left.iter().map(|one| Halves::of(candidates, one, one.values(with_zeros), &plain).mean()).collect();
    let columns: Vec<Vec<f64>> = named.iter().map(|&index| means(&candidates.covariates[index], candidates, left, found)).collect();
    if let Some((coefficients, ..)) = line(&columns.iter().map(Vec::as_slice).collect::<Vec<_>>(), &zeros) {
        named.iter().zip(coefficients).for_each(|(&index, coefficient)| found.covariates[index] = Some(coefficient));
    }
}

/// Decides whether each recording has a zero of its own, beside steps and covariates that are named. `inside` is what the reference
/// without zeros leaves of recordings that it was fitted to: levels that it can explain at all may belong to an operating point.
pub(crate) fn decide_on_zeros(candidates: &Candidates, left: &[Left], inside: &[Left], found: &mut Nuisances) {
    if left.len() < FEWEST {
        return;
    }
    let halves: Vec<Halves> = left.iter().map(|one| Halves::of(candidates, one, &one.left, found)).collect();
    let mean = halves.iter().map(Halves::mean).sum::<f64>() / halves.len() as f64;
    let after: f64 = halves.iter().map(Halves::crossed).sum();
    let between = halves.iter().map(|one| 2.0 * (one.mean() - mean).powi(2)).sum::<f64>() / (halves.len() - 1) as f64;
    let within = halves.iter().map(|one| 0.5 * (one.first - one.second).powi(2)).sum::<f64>() / halves.len() as f64;
    let chance = f_beyond(between / within.max(f64::MIN_POSITIVE), (halves.len() - 1) as f64, halves.len() as f64);
    let before = square_as_is(candidates, left, found).min(square_as_is(candidates, inside, found));
    found.zeros = chance < LEVEL && after < (1.0 - ZEROS_MATTER) * before;
}

/// Estimates what is named, from what a reference that all recordings took part in leaves.
pub(crate) fn estimate(candidates: &Candidates, left: &[Left], found: &mut Nuisances) {
    if found.zeros {
        estimate_covariates(candidates, left, true, found);
    }
    let halves: Vec<Halves> = left.iter().map(|one| Halves::of(candidates, one, &one.left, found)).collect();
    let mean = halves.iter().map(Halves::mean).sum::<f64>() / halves.len().max(1) as f64;
    for (one, halves) in left.iter().zip(&halves) {
        found.offsets[one.series] = halves.mean() - mean;
        let behind = before_step(candidates, one, found).end..one.samples.len();
        if found.steps[one.series] && !behind.is_empty() {
            let count = behind.len() as f64;
            let sum: f64 = behind.map(|place| one.left[place] - found.moved(candidates, one.series, one.samples[place])).sum();
            found.heights[one.series] = sum / count - halves.mean();
        }
    }
}

/// Mean of a covariate over each recording before its step.
fn means(covariate: &Covariate, candidates: &Candidates, left: &[Left], found: &Nuisances) -> Vec<f64> {
    let mean = |one: &Left| {
        let kept = before_step(candidates, one, found);
        let count = kept.len().max(1) as f64;
        kept.map(|place| covariate.values[one.series][one.samples[place]]).sum::<f64>() / count
    };
    left.iter().map(mean).collect()
}

/// Mean square of the error of the reference without zeros, the covariates' part taken off, summed over recordings.
fn square_as_is(candidates: &Candidates, left: &[Left], found: &Nuisances) -> f64 {
    let of = |one: &Left| {
        let kept = before_step(candidates, one, found);
        let count = kept.len().max(1) as f64;
        let left = |place: usize| one.as_is[place] - found.moved(candidates, one.series, one.samples[place]);
        kept.map(|place| left(place).powi(2)).sum::<f64>() / count
    };
    left.iter().map(of).sum()
}

/// Places of what is left that lie before a step that is named.
fn before_step(candidates: &Candidates, one: &Left, found: &Nuisances) -> std::ops::Range<usize> {
    let step = candidates.steps[one.series].filter(|_| found.steps[one.series]).unwrap_or(usize::MAX);
    0..one.samples.partition_point(|&sample| sample < step)
}

impl Left {
    /// What the reference with zeros in its weights leaves, or the one without.
    fn values(&self, with_zeros: bool) -> &[f64] {
        if with_zeros { &self.left } else { &self.as_is }
    }
}

/// The two halves of what is left of a recording before its step, the covariates' part taken off.
struct Halves {
    /// Means, and mean squares about them.
    first: f64,
    second: f64,
    first_square: f64,
    second_square: f64,
}

impl Halves {
    fn of(candidates: &Candidates, one: &Left, values: &[f64], found: &Nuisances) -> Self {
        let places = before_step(candidates, one, found);
        let values: Vec<f64> = places.map(|place| values[place] - found.moved(candidates, one.series, one.samples[place])).collect();
        let (first, second) = values.split_at(values.len() / 2);
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let square = |values: &[f64]| {
            let centre = mean(values);
            mean(&values.iter().map(|value| (value - centre).powi(2)).collect::<Vec<_>>())
        };
        Self { first: mean(first), second: mean(second), first_square: square(first), second_square: square(second) }
    }

    fn mean(&self) -> f64 {
        0.5 * (self.first + self.second)
    }

    /// Mean square about a given zero.
    fn square_about(&self, zero: f64) -> f64 {
        0.5 * (self.first_square + self.second_square + (self.first - zero).powi(2) + (self.second - zero).powi(2))
    }

    /// Mean square of each half about the zero of the other.
    fn crossed(&self) -> f64 {
        0.5 * (self.first_square + self.second_square) + (self.first - self.second).powi(2)
    }
}

/// Whether a step is clear in what is left of a recording.
fn height_is_clear(one: &Left, step: usize, range: f64) -> bool {
    let edge = one.samples.partition_point(|&sample| sample < step);
    let count = one.samples.len();
    let share = edge as f64 / count.max(1) as f64;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a small count")]
    let first = (share * STEP_BLOCKS as f64).round() as usize;
    if first < 2 || first + 2 > STEP_BLOCKS || edge < STEP_BLOCKS || count - edge < STEP_BLOCKS {
        return false;
    }
    let means = |values: &[f64], blocks: usize| -> Vec<f64> {
        let block = |index: usize| &values[index * values.len() / blocks..(index + 1) * values.len() / blocks];
        (0..blocks).map(|index| block(index).iter().sum::<f64>() / block(index).len() as f64).collect()
    };
    let mut blocks = means(&one.left[..edge], first);
    blocks.extend(means(&one.left[edge..], STEP_BLOCKS - first));
    let side: Vec<f64> = (0..STEP_BLOCKS).map(|index| f64::from(u8::from(index >= first))).collect();
    let order: Vec<f64> = (0..STEP_BLOCKS).map(|index| index as f64).collect();
    let (Some((_, constant, _)), Some((coefficients, stepped, _)), Some((_, sloped, _))) =
        (line(&[], &blocks), line(&[&side], &blocks), line(&[&order], &blocks))
    else {
        return false;
    };
    let freedom = STEP_BLOCKS as f64 - 2.0;
    let chance = f_beyond((constant - stepped) / (stepped / freedom).max(f64::MIN_POSITIVE), 1.0, freedom);
    let height = coefficients[0];
    let mean = one.left.iter().sum::<f64>() / count as f64;
    let square = one.left.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count as f64;
    if !is_sharp(&one.left, edge, height) {
        return false;
    }
    // The place was chosen among many: as many as there are blocks.
    let clear = chance * (STEP_BLOCKS as f64) < LEVEL && stepped < sloped;
    clear && height.powi(2) * share * (1.0 - share) > STEP_CLEAR * square && height.abs() > STEP_SMALL * range
}

/// Whether values jump at a place, by about a height, and nowhere else: the error of a model of the input changes with the input, and
/// that more than once.
fn is_sharp(values: &[f64], edge: usize, height: f64) -> bool {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a count")]
    let window = ((STEP_WINDOW * values.len() as f64) as usize).max(3);
    let mut sums = vec![0.0];
    sums.extend(values.iter().scan(0.0, |sum, value| {
        *sum += value;
        Some(*sum)
    }));
    let jump = |at: usize| ((sums[at + window] - sums[at]) - (sums[at] - sums[at - window])).abs() / window as f64;
    let places = window..=values.len().saturating_sub(window);
    if !places.contains(&edge) || jump(edge) < STEP_SHARP * height.abs() {
        return false;
    }
    let elsewhere = places.filter(|at| at.abs_diff(edge) >= window).map(jump).fold(0.0, f64::max);
    elsewhere <= STEP_ELSEWHERE * jump(edge)
}

/// Samples at which the input that turns most often turns.
fn turns(series: &Series) -> Vec<usize> {
    let of = |values: &Vec<f64>| {
        let values = &values[series.skip.min(values.len())..];
        let (low, high) = range(values.iter().copied());
        let (mut extreme, mut rising, mut found) = (values.first().copied().unwrap_or(0.0), true, Vec::new());
        for (index, &value) in values.iter().enumerate() {
            let beyond = if rising { value - extreme } else { extreme - value };
            if beyond > 0.0 {
                extreme = value;
            } else if beyond < -STROKE * (high - low) {
                found.push(series.skip + index);
                (extreme, rising) = (value, !rising);
            }
        }
        found
    };
    series.inputs.iter().map(of).max_by_key(Vec::len).unwrap_or_default()
}

/// The most likely place of a step in one recording by itself: the maximum of the likelihood ratio of a step beside columns of the input.
fn place(series: &Series, columns: impl Fn(&Series, &[usize]) -> Vec<Vec<f64>>) -> Option<usize> {
    let turns = turns(series);
    if turns.len() < STROKES {
        return None;
    }
    let counted = series.skip..series.len();
    let stride = counted.len().div_ceil(SCANNED).max(1);
    let kept: Vec<usize> = counted.step_by(stride).collect();
    let (count, columns) = (kept.len(), columns(series, &kept));
    if count < 4 * columns.len().max(STEP_BLOCKS) {
        return None;
    }
    let mut basis: Vec<Vec<f64>> = Vec::new();
    let residual = |basis: &[Vec<f64>], mut values: Vec<f64>| {
        for column in basis {
            let product: f64 = column.iter().zip(&values).map(|(one, other)| one * other).sum();
            values.iter_mut().zip(column).for_each(|(value, column)| *value -= product * column);
        }
        values
    };
    let square = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>();
    for column in std::iter::once(vec![1.0; count]).chain(columns) {
        let before = square(&column);
        let left = residual(&basis, column);
        let after = square(&left);
        // What the others nearly make up would only follow noise.
        if after > 1e-6 * before {
            basis.push(left.iter().map(|value| value / after.sqrt()).collect());
        }
    }
    let left = residual(&basis, kept.iter().map(|&sample| series.output[sample]).collect());
    // Sums from the end: those over the samples behind each place.
    let mut tails = vec![0.0; basis.len()];
    let mut tail = 0.0;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a count")]
    let margin = (STEP_MARGIN * count as f64).ceil() as usize;
    let mut best = (0.0, None);
    for place in (0..count).rev() {
        tail += left[place];
        tails.iter_mut().zip(&basis).for_each(|(sum, column)| *sum += column[place]);
        if place < margin || place + margin > count {
            continue;
        }
        let size = (count - place) as f64 - square(&tails);
        let gain = if size > 1e-3 * (count - place) as f64 { tail * tail / size } else { 0.0 };
        if gain > best.0 {
            best = (gain, Some(kept[place]));
        }
    }
    best.1.filter(|place| (STROKES_BESIDE..=turns.len() - STROKES_BESIDE).contains(&turns.partition_point(|turn| turn < place)))
}

/// Least squares of values on a constant and columns: coefficients of the columns, sum of squares left, and the sum of squares left where
/// each value is predicted from the others.
fn line(columns: &[&[f64]], values: &[f64]) -> Option<(Vec<f64>, f64, f64)> {
    let width = columns.len() + 1;
    let row = |index: usize| -> Vec<f64> { std::iter::once(1.0).chain(columns.iter().map(|column| column[index])).collect() };
    let mut system = crate::linear::Compressed::new(width);
    (0..values.len()).for_each(|index| system.push(&row(index), values[index]));
    let solution = system.solve(&vec![true; width]);
    let inverse = system.inverse_gram(&(0..width).collect::<Vec<_>>());
    if !solution.coefficients.iter().chain(&inverse).all(|value| value.is_finite()) {
        return None;
    }
    let mut left_out = 0.0;
    for (index, value) in values.iter().enumerate() {
        let row = row(index);
        let predicted: f64 = row.iter().zip(&solution.coefficients).map(|(one, other)| one * other).sum();
        let leverage: f64 = (0..width).map(|i| (0..width).map(|j| row[i] * inverse[i * width + j] * row[j]).sum::<f64>()).sum();
        left_out += ((value - predicted) / (1.0 - leverage).max(1e-9)).powi(2);
    }
    Some((solution.coefficients[1..].to_vec(), solution.squared_residual, left_out))
}

/// The chance that Snedecor's F with these degrees of freedom lies above a value (M. Abramowitz and I. Stegun, 26.6.2).
fn f_beyond(value: f64, above: f64, below: f64) -> f64 {
    if value.is_nan() {
        return 1.0;
    }
    beta_reg(0.5 * below, 0.5 * above, below / (below + above * value.max(0.0)))
}

fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)))
}

/// What predictions leave of a unit with its own nuisances taken off, as far as they are named: how well the shape is known.
pub(crate) fn shape_residuals(
    nuisances: &Nuisances,
    candidates: &Candidates,
    predictions: &[f64],
    one: &Series,
    unit: &crate::Unit,
) -> Vec<f64> {
    let left = |sample: usize| one.output[sample] - predictions[sample] - nuisances.moved(candidates, unit.series, sample);
    let mut left: Vec<f64> = unit.samples.clone().map(left).collect();
    let step = candidates.steps[unit.series].filter(|_| nuisances.steps[unit.series]).unwrap_or(usize::MAX);
    let (before, behind) = left.split_at_mut(step.saturating_sub(unit.samples.start).min(unit.samples.len()));
    for (part, has_own_zero) in [(before, nuisances.zeros), (behind, true)] {
        if has_own_zero && !part.is_empty() {
            let zero = part.iter().sum::<f64>() / part.len() as f64;
            part.iter_mut().for_each(|value| *value -= zero);
        }
    }
    left
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chances_are_those_of_tables() {
        // Snedecor's F at its 99 % points.
        for (above, below, point) in [(1.0, 10.0, 10.04), (5.0, 6.0, 8.746), (2.0, 3.0, 30.82), (19.0, 20.0, 2.96)] {
            let chance = f_beyond(point, above, below);
            assert!((chance - 0.01).abs() < 2e-4, "F({above}, {below}) beyond {point}: {chance}");
        }
        assert!((f_beyond(0.0, 2.0, 3.0) - 1.0).abs() < 1e-12 && f_beyond(f64::INFINITY, 2.0, 3.0) < 1e-12);
    }
}
