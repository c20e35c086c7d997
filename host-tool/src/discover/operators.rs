//! The bank of play operators, several side by side so that none waits for its own last step.

use pulp::{Arch, Simd, WithSimd};

use super::catalogue::Habit;
use super::columns::{Rows, SIDE};
use super::turning::between_samples;

/// What a bank of operators is led along.
pub struct Lead<'a> {
    /// Turning points before the recording, oldest first.
    pub history: &'a [f64],
    /// The input as the operators see it.
    pub path: &'a [f64],
    /// How the operators deviate from plain ones.
    pub habit: &'a Habit,
    /// Sample period, s.
    pub period_s: f64,
}

/// What an operator's threshold is multiplied by, what is added to it, and by what its multiple is larger on the unloading branch.
type Gap = [f64; 3];

/// Writes the operators of these thresholds into the first columns of `rows`, [`SIDE`] at a time: what follows them is overwritten.
pub fn write(thresholds: &[f64], lead: &Lead<'_>, rows: &mut Rows) {
    let turns = between_samples(lead.path);
    let (before, now) = if lead.habit.is_plain() {
        (Vec::new(), Vec::new())
    } else {
        (gaps(lead.history, lead.habit, None, &[]), gaps(lead.path, lead.habit, Some(lead.period_s), &turns))
    };
    Arch::new().dispatch(Writing { thresholds, lead, turns: &turns, before: &before, now: &now, rows });
}

/// Writes a bank, a few operators at a time.
struct Writing<'a> {
    thresholds: &'a [f64],
    lead: &'a Lead<'a>,
    turns: &'a [(usize, f64)],
    before: &'a [Gap],
    now: &'a [Gap],
    rows: &'a mut Rows,
}

impl WithSimd for Writing<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let Self { thresholds, lead, turns, before, now, rows } = self;
        for (group, thresholds) in thresholds.chunks(SIDE).enumerate() {
            let mut lanes = [0.0; SIDE];
            lanes[..thresholds.len()].copy_from_slice(thresholds);
            let side = Side { lead, thresholds: &lanes, turns, before, now };
            let mut state = side.begin();
            let from = group * SIDE;
            let write = |row: &mut [f64], state: &[f64; SIDE]| row[from..from + SIDE].copy_from_slice(state);
            if lead.habit.viscous_s > 0.0 {
                side.follow_late(&mut state, rows, write);
            } else {
                side.follow(&mut state, rows, write);
            }
        }
    }
}

/// A few operators.
struct Side<'a> {
    lead: &'a Lead<'a>,
    thresholds: &'a [f64; SIDE],
    turns: &'a [(usize, f64)],
    /// Gaps at the turning points before the recording; empty for plain operators.
    before: &'a [Gap],
    /// Gaps at the samples; empty for plain operators.
    now: &'a [Gap],
}

impl Side<'_> {
    /// Where the recordings before have left them.
    #[inline(always)]
    fn begin(&self) -> [f64; SIDE] {
        let mut state = [0.0; SIDE];
        for (at, &value) in self.lead.history.iter().enumerate() {
            self.play(&mut state, value, self.before.get(at));
        }
        state
    }

    /// One step of plain operators, or of ones whose thresholds are changed by `gap`.
    #[inline(always)]
    fn play(&self, state: &mut [f64; SIDE], value: f64, gap: Option<&Gap>) {
        match gap {
            None => {
                for (state, threshold) in state.iter_mut().zip(self.thresholds) {
                    *state = between(value - threshold, *state, value + threshold);
                }
            }
            Some(&[factor, extra, unloading]) => {
                for (state, threshold) in state.iter_mut().zip(self.thresholds) {
                    let gap = greater(factor * threshold + extra, 0.0);
                    *state = between(value - gap, *state, value + greater(gap + unloading * threshold, 0.0));
                }
            }
        }
    }

    /// Operators that are at their bounds as soon as these have reached them.
    #[inline(always)]
    fn follow(&self, state: &mut [f64; SIDE], rows: &mut Rows, write: impl Fn(&mut [f64], &[f64; SIDE])) {
        let stride = rows.stride;
        let mut from = 0;
        for &(to, turn) in self.turns.iter().chain(&[(self.lead.path.len(), f64::NAN)]) {
            for ((sample, value), row) in
                (from..to).zip(&self.lead.path[from..to]).zip(rows.values[from * stride..].chunks_exact_mut(stride))
            {
                self.play(state, *value, self.now.get(sample));
                write(row, state);
            }
            if to < self.lead.path.len() {
                // They are still on the stroke that ends there, at its rate.
                self.play(state, turn, self.now.get(to - 1));
            }
            from = to;
        }
    }

    /// Operators that follow their bounds late.
    #[inline(always)]
    fn follow_late(&self, state: &mut [f64; SIDE], rows: &mut Rows, write: impl Fn(&mut [f64], &[f64; SIDE])) {
        let Lead { path, habit, period_s, .. } = *self.lead;
        let share = 1.0 - (-period_s / habit.viscous_s).exp();
        for ((sample, &value), row) in path.iter().enumerate().zip(rows.values.chunks_exact_mut(rows.stride)) {
            let gap = self.now.get(sample);
            if sample == 0 {
                self.play(state, value, gap);
            } else if habit.stiffening > 0.0 {
                self.stiffening(state, [path[sample - 1], value], gap);
            } else {
                let mut bound = *state;
                self.play(&mut bound, value, gap);
                for (state, bound) in state.iter_mut().zip(bound) {
                    *state += share * (bound - *state);
                }
            }
            write(row, state);
        }
    }

    /// Operators that follow their bounds at the speed `x / T (1 + (x / E)^2)` for a distance `x`: the first terms of Eyring's law.
    #[inline(always)]
    fn stiffening(&self, state: &mut [f64; SIDE], [before, now]: [f64; 2], gap: Option<&Gap>) {
        let Lead { habit, period_s, .. } = *self.lead;
        let growth = (2.0 * period_s / LOOKS as f64 / habit.viscous_s).min(700.0).exp();
        let far = 1.0 / (habit.stiffening * habit.stiffening);
        for look in 1..=LOOKS {
            let mut bound = *state;
            self.play(&mut bound, before + (now - before) * look as f64 / LOOKS as f64, gap);
            for (state, bound) in state.iter_mut().zip(bound) {
                let size = bound - *state;
                // Exact for a bound that stands still. At the bound the quotient is infinite and nothing is left, as it should be.
                let left = 1.0 / ((1.0 / (size * size) + far) * growth - far).sqrt();
                *state += size - left.copysign(size);
            }
        }
    }
}

/// Steps of a stiffening operator inside a sample.
const LOOKS: usize = 2;

/// `state`, or the limit that it is beyond; a comparison and a choice is one instruction where `f64::max`, which minds what is no
/// number, is several.
#[inline(always)]
fn between(low: f64, state: f64, high: f64) -> f64 {
    let raised = greater(low, state);
    if high < raised { high } else { raised }
}

/// The greater of two numbers.
#[inline(always)]
fn greater(one: f64, other: f64) -> f64 {
    if one > other { one } else { other }
}

/// The gap at every sample of `path`; rates count where there is a sample period.
fn gaps(path: &[f64], habit: &Habit, period_s: Option<f64>, turns: &[(usize, f64)]) -> Vec<Gap> {
    let last = path.len().saturating_sub(1);
    let with_rate = habit.growth_per_rate != 0.0 || habit.extra_per_rate != 0.0;
    let fading = period_s.map_or(0.0, |period_s| -(-period_s / habit.rate_memory_s).exp_m1());
    let mut faded = 0.0;
    let mut turns = turns.iter().map(|turn| turn.0).peekable();
    let mut turned = false;
    let gap = |(index, &value): (usize, &f64)| {
        let turned_before = std::mem::replace(&mut turned, turns.next_if_eq(&(index + 1)).is_some());
        let rate = match period_s {
            Some(period_s) if with_rate && habit.rate_memory_s > 0.0 => {
                let step = (value - path[index.saturating_sub(1)]).abs() / period_s;
                faded += (step - faded) * fading;
                faded
            }
            Some(period_s) if with_rate => {
                // Not across a turn: the mean of both strokes' rates would be next to nothing.
                let before = if turned_before { index } else { index.saturating_sub(1) };
                let after = if turned { index } else { (index + 1).min(last) };
                let rate = (path[after] - path[before]).abs() / ((after - before).max(1) as f64 * period_s);
                if habit.rate_power == 1.0 { rate } else { rate.powf(habit.rate_power) }
            }
            _ => 0.0,
        };
        let factor = (1.0 + habit.growth_per_input * value).max(0.0) + habit.growth_per_rate * rate;
        let unloading = habit.growth_unloading * value;
        [factor, habit.envelope_bend * value * (1.0 - value) + habit.extra_per_rate * rate, unloading]
    };
    path.iter().enumerate().map(gap).collect()
}
