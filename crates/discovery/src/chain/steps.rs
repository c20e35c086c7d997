//! Where to begin the search of what holds and jumps: its steps are matched with those that a model misses.

use std::ops::Range;

use identification::nnls;
use pulp::{Arch, Simd, WithSimd};

use crate::chain::columns::SIDE;
use crate::chain::filters::lag;
use crate::data::session::{Role, Run, Session};

/// Time constants, s, of lags and limits of the rate, spans per s, whose work is not for steps to explain: whatever is late looks like steps, and what
/// others do is nearly a sum of theirs.
const SLOW: [(f64, f64); 4] = [(0.02, f64::MAX), (0.1, f64::MAX), (1e-3, 5.0), (1e-3, 1.5)];

/// Points of a grid that a matched score leaves.
const MATCHED: usize = 24;

/// What a model misses of the output's steps on a third of the recordings that are fitted.
pub struct Steps<'a> {
    runs: Vec<OfRun<'a>>,
}

/// The steps of one recording, or of a stretch of it.
struct OfRun<'a> {
    run: &'a Run,
    /// Time from the start of the recording to that of the stretch, s.
    begun_s: f64,
    /// What holds or is held: the command, or the output.
    signal: Vec<f64>,
    /// What the model misses; the same without what is merely slow; then what is slow, orthogonal and of length one. Zeros fill up the last lanes.
    directions: Vec<Vec<f64>>,
    /// Products of a jump by one at each sample, and of the signal itself, with these and with the signal's steps.
    of_jumps: Vec<[f64; PRODUCTS]>,
    of_signal: [f64; PRODUCTS],
}

fn dot(one: &[f64], other: &[f64]) -> f64 {
    one.iter().zip(other).map(|(x, y)| x * y).sum()
}

/// Steps over two samples of what has become of a signal.
#[inline(always)]
fn steps(after: &[f64], before: &[f64]) -> Vec<f64> {
    after.windows(3).zip(before.windows(3)).map(|(after, before)| after[2] - before[2] - after[0] + before[0]).collect()
}

fn without(mut one: Vec<f64>, slow: &[Vec<f64>]) -> Vec<f64> {
    for slow in slow {
        let share = dot(&one, slow);
        one.iter_mut().zip(slow).for_each(|(value, slow)| *value -= share * slow);
    }
    one
}

/// Most directions that steps are multiplied with.
const DIRECTIONS: usize = 2 + SLOW.len();

/// The same and the signal's own steps.
const PRODUCTS: usize = DIRECTIONS + 1;

/// Products of the steps that become of a signal with all directions, and the sum of their squares.
struct Products<'a> {
    after: &'a [f64],
    of: &'a OfRun<'a>,
}

impl WithSimd for Products<'_> {
    type Output = ([f64; DIRECTIONS], f64);

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> Self::Output {
        let mut own = steps(self.after, &self.of.signal);
        own.resize(own.len().next_multiple_of(SIDE), 0.0);
        let product = |direction: &[f64]| {
            let mut lanes = [0.0; SIDE];
            for (own, direction) in own.chunks_exact(SIDE).zip(direction.chunks_exact(SIDE)) {
                (0..SIDE).for_each(|lane| lanes[lane] += own[lane] * direction[lane]);
            }
            lanes.iter().sum()
        };
        let mut products = [0.0; DIRECTIONS];
        products.iter_mut().zip(&self.of.directions).for_each(|(sum, direction)| *sum = product(direction));
        (products, product(&own))
    }
}

impl<'a> Steps<'a> {
    /// The steps that are missed by `residual`, of what holds some `signal`.
    pub fn new(session: &'a Session, residual: &[Vec<f64>], signal: impl Fn(&Run) -> Vec<f64>) -> Self {
        Self::in_stretches(session, residual, signal, usize::MAX)
    }

    /// The same, recordings that are at least twice so many samples long in equal stretches of at least so many.
    pub fn in_stretches(session: &'a Session, residual: &[Vec<f64>], signal: impl Fn(&Run) -> Vec<f64>, samples: usize) -> Self {
        let of = |run: &'a Run, range: Range<usize>| {
            let (signal, mut slow) = (signal(run)[range.clone()].to_vec(), Vec::<Vec<f64>>::new());
            for (time_s, most_per_s) in SLOW {
                let (mut late, most) = (signal.clone(), most_per_s * run.period_s);
                lag(&mut late, time_s, run.period_s);
                late.iter_mut().reduce(|last, value| {
                    *value = value.clamp(*last - most, *last + most);
                    value
                });
                let late = steps(&late, &signal);
                let own = without(late.clone(), &slow);
                let size = dot(&own, &own).sqrt();
                // What the others do already is no further direction.
                if size > 1e-3 * dot(&late, &late).sqrt() {
                    slow.push(own.iter().map(|value| value / size).collect());
                }
            }
            let missed: Vec<f64> = residual[run.index][range.clone()].windows(3).map(|now| now[2] - now[0]).collect();
            let mut directions: Vec<_> = [missed.clone(), without(missed, &slow)].into_iter().chain(slow).collect();
            directions.iter_mut().for_each(|one| one.resize(one.len().next_multiple_of(SIDE), 0.0));
            let own: Vec<f64> = signal.windows(3).map(|now| now[2] - now[0]).collect();
            let (mut of_jumps, mut of_signal) = (vec![[0.0; PRODUCTS]; signal.len()], [0.0; PRODUCTS]);
            for (at, one) in directions.iter().enumerate().chain([(DIRECTIONS, &own)]) {
                of_signal[at] = dot(&own, one);
                // A jump is in two of the steps that go over two samples.
                for (step, value) in one.iter().take(own.len()).enumerate() {
                    of_jumps[step + 1][at] += value;
                    of_jumps[step + 2][at] += value;
                }
            }
            OfRun { run, begun_s: range.start as f64 * run.period_s, signal, directions, of_jumps, of_signal }
        };
        let ranges = |run: &'a Run| {
            let (length, count) = (run.input.len(), (run.input.len() / samples).max(1));
            (0..count).map(move |part| (run, part * length / count..(part + 1) * length / count))
        };
        let fitted = session.runs.iter().filter(|run| run.role.contains(&Role::Fit)).step_by(3);
        Self { runs: fitted.flat_map(ranges).map(|(run, range)| of(run, range)).collect() }
    }

    /// Numbers here of recordings or stretches, the recording, and the time from its start to that of the stretch, s.
    pub fn runs(&self) -> impl Iterator<Item = (usize, &'a Run, f64)> {
        self.runs.iter().enumerate().map(|(at, of)| (at, of.run, of.begun_s))
    }

    /// Time that the longest recording or stretch takes, s.
    pub fn longest_s(&self) -> f64 {
        self.runs.iter().map(|of| (of.signal.len() - 1) as f64 * of.run.period_s).fold(0.0, f64::max)
    }

    /// Product of the steps that `change` makes of the signal of a recording and the missed ones, and the square of the former: of all that it makes, and
    /// of what of it is not merely slow.
    pub fn matched(&self, at: usize, change: impl FnOnce(&Run, &mut [f64])) -> [(f64, f64); 2] {
        let of = &self.runs[at];
        let mut path = of.signal.clone();
        change(of.run, &mut path);
        let (products, squares) = Arch::new().dispatch(Products { after: &path, of });
        both(products, squares)
    }

    /// Square of the missed steps of a recording or stretch, without what is merely slow.
    pub fn missed(&self, at: usize) -> f64 {
        dot(&self.runs[at].directions[1], &self.runs[at].directions[1])
    }

    /// As [`Self::matched`], by what is not merely slow, where `staircase` makes jumps of the signal, samples and values in order, three samples apart at least.
    pub fn matched_jumps(&self, at: usize, staircase: impl FnOnce(&Run, &[f64], &mut dyn FnMut(usize, f64))) -> (f64, f64) {
        let of = &self.runs[at];
        let mut products = of.of_signal.map(|product| -product);
        let (mut squares, mut last) = (of.of_signal[DIRECTIONS], None);
        staircase(of.run, &of.signal, &mut |sample, value| {
            let jump = last.map_or(0.0, |last| value - last);
            last = Some(value);
            // At an end one step goes over it, elsewhere two.
            squares += sample.min(of.signal.len() - sample).min(2) as f64 * jump * jump;
            products.iter_mut().zip(&of.of_jumps[sample]).for_each(|(sum, product)| *sum += jump * product);
        });
        // The steps of the difference: those of the jumps, less those of the signal.
        squares -= 2.0 * (products[DIRECTIONS] + of.of_signal[DIRECTIONS]);
        let [products @ .., _] = products;
        both(products, squares)[1]
    }

    /// Points of a grid that go best with what is missed: the best by all that `change` makes of the signals, and as many by what of it is not
    /// merely slow, which may be lost in the former.
    pub fn best(&self, grid: impl Iterator<Item = Vec<f64>>, change: impl Fn(&[f64], &Run, &mut [f64])) -> Vec<Vec<f64>> {
        let of = |point: Vec<f64>| {
            let matched = (0..self.runs.len()).map(|at| self.matched(at, |run, path| change(&point, run, path)));
            let matched: Vec<_> = matched.collect();
            ([0, 1].map(|by: usize| over(matched.iter().map(|of| of[by]))), point)
        };
        let mut scored: Vec<([f64; 2], Vec<f64>)> = grid.map(of).collect();
        let best = |by: usize| {
            scored.sort_by(|x, y| y.0[by].total_cmp(&x.0[by]));
            let count = scored.len().min(MATCHED / 2);
            scored.drain(..count).map(|one| one.1).collect::<Vec<_>>()
        };
        [0, 1].map(best).concat()
    }
}

/// Products with what is missed and squares, of all, and of what is not merely slow.
fn both([whole, rest, slow @ ..]: [f64; DIRECTIONS], squares: f64) -> [(f64, f64); 2] {
    let energy = squares + 1e-30;
    [(whole, energy), (rest, (energy - slow.iter().map(|share| share * share).sum::<f64>()).max(1e-9 * energy))]
}

/// The products of the way that goes best.
pub fn best_of(ways: impl Iterator<Item = (f64, f64)>) -> (f64, f64) {
    ways.max_by(|one, other| (one.0 / one.1.sqrt()).total_cmp(&(other.0 / other.1.sqrt()))).unwrap_or((0.0, 1e-30))
}

/// The score of several recordings together.
pub fn over(products: impl Iterator<Item = (f64, f64)>) -> f64 {
    let (cross, energy) = products.fold((0.0, 0.0), |all, one| (all.0 + one.0, all.1 + one.1));
    cross / energy.sqrt()
}

/// Thresholds, spans, of a few play operators. The first of them remember what went before the recording.
const FEW: [f64; SIDE] = [0.05, 0.12, 0.25, 0.45, 0.0, 0.08, 0.2, 0.4];

/// How many of them remember.
const REMEMBERING: usize = 4;

/// Time constant, s, by which what is slow is taken from the operators and from the measured output.
const SLOWLY_S: f64 = 1.0;

/// Products of what a few operators of a path make faster than [`SLOWLY_S`] with each other and with the measured output, and the square of the latter.
struct Fast<'a> {
    path: &'a [f64],
    run: &'a Run,
    states: [f64; SIDE],
    keep: f64,
}

impl WithSimd for Fast<'_> {
    type Output = ([[f64; SIDE]; SIDE], [f64; SIDE], f64);

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> Self::Output {
        let Self { path, run, mut states, keep } = self;
        let (mut products, mut target, mut energy) = ([[0.0; SIDE]; SIDE], [0.0; SIDE], 0.0);
        let lead = |states: &mut [f64; SIDE], value: f64| {
            for (state, threshold) in states.iter_mut().zip(FEW) {
                let (low, high) = (value - threshold, value + threshold);
                let raised = if *state > low { *state } else { low };
                *state = if raised < high { raised } else { high };
            }
        };
        let mut slow: Option<([f64; SIDE], f64)> = None;
        for ((value, output), seen) in path.iter().zip(&run.output).zip(&run.keep) {
            lead(&mut states, *value);
            if !seen {
                continue;
            }
            let (slow, slow_output) = slow.get_or_insert((states, *output));
            let mut fast = [0.0; SIDE];
            for at in 0..SIDE {
                fast[at] = states[at] - slow[at];
                slow[at] = states[at] - keep * fast[at];
            }
            let fast_output = output - *slow_output;
            *slow_output = output - keep * fast_output;
            energy += fast_output * fast_output;
            for at in 0..SIDE {
                target[at] += fast[at] * fast_output;
                (at / 4 * 4..SIDE).for_each(|other| products[at][other] += fast[at] * fast[other]);
            }
        }
        (4..SIDE).for_each(|at| (0..4).for_each(|other| products[at][other] = products[other][at]));
        (products, target, energy)
    }
}

/// How little of the measured output's fast motion, as far as that is seen, a few play operators of a path leave, their weights not negative: minus the
/// sum of squares.
pub fn agreement(path: &[f64], run: &Run) -> f64 {
    let mut states = [0.0; SIDE];
    for value in &run.history {
        (0..REMEMBERING).for_each(|at| states[at] = f64::clamp(states[at], value - FEW[at], value + FEW[at]));
    }
    let keep = (-run.period_s / SLOWLY_S).exp();
    let (mut products, target, energy) = Arch::new().dispatch(Fast { path, run, states, keep });
    (0..SIDE).for_each(|at| products[at][at] += 1e-9 * (products[at][at] + 1.0));
    let (gram, bounded) = (products.as_flattened(), [true; SIDE]);
    let weights = nnls::solve_definite(gram, &target, &bounded, &bounded).unwrap_or_else(|| nnls::solve(gram, &target, &bounded));
    // At the optimum the weights take away what they have in common with the output.
    dot(&weights, &target) - energy
}

/// The best of some places, the first of equal ones, made three times as fine so often.
pub fn best_place(places: impl Iterator<Item = f64>, mut spacing: f64, refinements: usize, mut score: impl FnMut(f64) -> f64) -> f64 {
    let mut best = (f64::MIN, 0.0);
    let mut offer = |at: f64, best: &mut (f64, f64)| {
        let found = score(at);
        if found > best.0 {
            *best = (found, at);
        }
    };
    places.for_each(|at| offer(at, &mut best));
    for _ in 0..refinements {
        spacing /= 3.0;
        let centre = best.1;
        [centre - spacing, centre + spacing].into_iter().for_each(|at| offer(at, &mut best));
    }
    best.1
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use recording::{Recording, Signal};

    use super::*;
    use crate::tests::deviates;

    #[test]
    fn jumps_and_the_path_that_they_make_have_the_same_products() {
        let time_s: Vec<f64> = (0..400).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = time_s.iter().map(|time| 0.5 - 0.5 * (1.7 * time).cos()).collect();
        let signals = (Signal::pressure_bar(), Signal::displacement_mm());
        let recording = Recording::new(Path::new("run.csv"), signals.0, signals.1, time_s, input.clone(), input).expect("a recording");
        let session = Session::new(&[recording], &[]).expect("a session");
        let mut deviate = deviates(0x57E9);
        let residual = vec![(0..400).map(|_| deviate()).collect::<Vec<f64>>()];
        let steps = Steps::new(&session, &residual, |run| run.input.clone());
        // Three samples are the fewest that a value is held for.
        for held in [3, 7, 40] {
            let [_, (product, square)] = steps.matched(0, |_, path| path.chunks_mut(held).for_each(|held| held.fill(held[0])));
            let (of_jumps, square_of_jumps) = steps.matched_jumps(0, |_, signal, jump| {
                signal.chunks(held).enumerate().for_each(|(at, value)| jump(at * held, value[0]));
            });
            assert!((product - of_jumps).abs() < 1e-9 * square.sqrt(), "{held}: {product} and {of_jumps}");
            assert!((square_of_jumps / square - 1.0).abs() < 1e-9, "{held}: {square} and {square_of_jumps}");
        }
    }
}
