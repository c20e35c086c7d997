//! The bank of play operators, several side by side so that none waits for its own last step.

use pulp::{Arch, Simd, WithSimd};

use crate::chain::columns::{AHEAD, Rows, SIDE};
use crate::chain::form::OperatorLaw;
use crate::data::turning::between_samples;

/// What operators know when a recording begins.
#[derive(Clone, Copy, Debug)]
pub enum Begin<'a> {
    /// Turning points before the recording, oldest first.
    After(&'a [f64]),
    /// Their states.
    From(&'a [f64]),
}

/// What a bank of operators is led along.
pub struct Lead<'a> {
    /// What the operators begin with.
    pub begin: Begin<'a>,
    /// The input as the operators see it.
    pub path: &'a [f64],
    /// How the operators deviate from plain ones.
    pub operator_law: &'a OperatorLaw,
    /// Sample period, s.
    pub period_s: f64,
}

/// What an operator's threshold is multiplied by, what is added to it, and by what its multiple is larger on the unloading branch.
type Gap = [f64; 3];

/// Writes the operators of these thresholds into the columns of `rows` behind the first [`AHEAD`], as many at a time as the processor takes:
/// whatever else is in the rows is overwritten.
pub fn write(thresholds: &[f64], lead: &Lead<'_>, rows: &mut Rows) {
    let turns = between_samples(lead.path);
    let (history, states): (&[f64], &[f64]) = match lead.begin {
        Begin::After(history) => (history, &[]),
        Begin::From(states) => (&[], states),
    };
    let (before, now) = if lead.operator_law.is_plain() {
        (Vec::new(), Vec::new())
    } else {
        (gaps(history, lead.operator_law, None, &[]), gaps(lead.path, lead.operator_law, Some(lead.period_s), &turns))
    };
    let mut padded = vec![0.0; rows.stride];
    padded[AHEAD..AHEAD + thresholds.len()].copy_from_slice(thresholds);
    let mut begun = vec![0.0; rows.stride];
    begun[AHEAD..AHEAD + states.len()].copy_from_slice(states);
    let followed: Vec<f64> = padded.iter().map(|threshold| lead.operator_law.followed(*threshold, lead.period_s)).collect();
    Arch::new().dispatch(Writing {
        thresholds: &padded,
        followed: &followed,
        begun: &begun,
        history,
        lead,
        turns: &turns,
        before: &before,
        now: &now,
        rows,
    });
}

/// States of operators from one recording to the next.
pub struct States<'a> {
    thresholds: &'a [f64],
    operator_law: OperatorLaw,
    states: Vec<f64>,
    rows: Rows,
}

impl<'a> States<'a> {
    /// The states behind these turning points.
    pub fn new(thresholds: &'a [f64], history: &[f64], operator_law: OperatorLaw) -> Self {
        let mut begun = Self { thresholds, operator_law, states: vec![0.0; thresholds.len()], rows: Rows::default() };
        if let Some((&last, before)) = history.split_last() {
            begun.lead_from(Begin::After(before), &[last], 1.0);
        }
        begun
    }

    /// What a recording begins with now.
    #[must_use]
    pub fn begin(&self) -> Begin<'_> {
        Begin::From(&self.states)
    }

    /// The states themselves.
    #[must_use]
    pub fn states(&self) -> &[f64] {
        &self.states
    }

    /// Leads the operators through a recording.
    pub fn lead(&mut self, path: &[f64], period_s: f64) {
        let states = std::mem::take(&mut self.states);
        self.lead_from(Begin::From(&states), path, period_s);
    }

    fn lead_from(&mut self, begin: Begin<'_>, path: &[f64], period_s: f64) {
        let count = AHEAD + self.thresholds.len();
        self.rows.shape(path.len(), count, count.next_multiple_of(SIDE));
        write(self.thresholds, &Lead { begin, path, operator_law: &self.operator_law, period_s }, &mut self.rows);
        let last = self.rows.values.len() - self.rows.stride;
        self.states = self.rows.values[last + AHEAD..last + count].to_vec();
    }
}

/// Writes a bank; the thresholds are as many as there are places in a row.
struct Writing<'a> {
    thresholds: &'a [f64],
    /// What each goes of the way to its bound in a sample, where they follow late.
    followed: &'a [f64],
    /// States before the turning points of `history`.
    begun: &'a [f64],
    history: &'a [f64],
    lead: &'a Lead<'a>,
    turns: &'a [(usize, f64)],
    /// Gaps at the turning points before the recording; empty for plain operators.
    before: &'a [Gap],
    /// Gaps at the samples; empty for plain operators.
    now: &'a [Gap],
    rows: &'a mut Rows,
}

/// Vectors of operators side by side, where there are enough.
const VECTORS: usize = 4;

impl WithSimd for Writing<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let vectors = self.thresholds.len() / S::F64_LANES;
        let mut first = 0;
        while first < vectors {
            if vectors - first >= VECTORS {
                self.side::<S, VECTORS>(simd, first);
                first += VECTORS;
            } else {
                self.side::<S, 1>(simd, first);
                first += 1;
            }
        }
    }
}

impl Writing<'_> {
    /// Writes `N` vectors of operators.
    #[inline(always)]
    fn side<S: Simd, const N: usize>(&mut self, simd: S, first: usize) {
        let Lead { path, operator_law, .. } = *self.lead;
        let (thresholds, _) = S::as_simd_f64s(self.thresholds);
        let (begun, _) = S::as_simd_f64s(self.begun);
        let (followed, _) = S::as_simd_f64s(self.followed);
        let of_these = |values: &[S::f64s]| std::array::from_fn::<_, N, _>(|at| values[first + at]);
        let side = Side { simd, lead: self.lead, thresholds: of_these(thresholds), followed: of_these(followed) };
        let mut state: [S::f64s; N] = std::array::from_fn(|at| begun[first + at]);
        for (at, &value) in self.history.iter().enumerate() {
            side.play(&mut state, value, self.before.get(at));
        }
        let stride = self.rows.stride;
        let write = |row: &mut [f64], state: &[S::f64s; N]| {
            let (row, _) = S::as_mut_simd_f64s(row);
            row[first..first + N].copy_from_slice(state);
        };
        if operator_law.viscous_s > 0.0 {
            for (sample, row) in self.rows.values.chunks_exact_mut(stride).enumerate() {
                side.follow_late(&mut state, sample, self.now.get(sample));
                write(row, &state);
            }
            return;
        }
        let mut from = 0;
        for &(to, turn) in self.turns.iter().chain(&[(path.len(), f64::NAN)]) {
            let rows = self.rows.values[from * stride..to * stride].chunks_exact_mut(stride);
            for ((sample, &value), row) in (from..to).zip(&path[from..to]).zip(rows) {
                side.play(&mut state, value, self.now.get(sample));
                write(row, &state);
            }
            if to < path.len() {
                // They are still on the stroke that ends there, at its rate.
                side.play(&mut state, turn, self.now.get(to - 1));
            }
            from = to;
        }
    }
}

/// A few vectors of operators.
struct Side<'a, S: Simd, const N: usize> {
    simd: S,
    lead: &'a Lead<'a>,
    thresholds: [S::f64s; N],
    followed: [S::f64s; N],
}

impl<S: Simd, const N: usize> Side<'_, S, N> {
    /// One step of plain operators, or of ones whose thresholds are changed by `gap`.
    #[inline(always)]
    fn play(&self, state: &mut [S::f64s; N], value: f64, gap: Option<&Gap>) {
        let simd = self.simd;
        let value = simd.splat_f64s(value);
        let Some(gap) = gap else {
            for (state, &threshold) in state.iter_mut().zip(&self.thresholds) {
                let raised = simd.max_f64s(simd.sub_f64s(value, threshold), *state);
                *state = simd.min_f64s(simd.add_f64s(value, threshold), raised);
            }
            return;
        };
        let [factor, extra, unloading] = gap.map(|part| simd.splat_f64s(part));
        let zero = simd.splat_f64s(0.0);
        for (state, &threshold) in state.iter_mut().zip(&self.thresholds) {
            let gap = simd.max_f64s(simd.add_f64s(simd.mul_f64s(factor, threshold), extra), zero);
            let wide = simd.max_f64s(simd.add_f64s(gap, simd.mul_f64s(unloading, threshold)), zero);
            let raised = simd.max_f64s(simd.sub_f64s(value, gap), *state);
            *state = simd.min_f64s(simd.add_f64s(value, wide), raised);
        }
    }

    /// One sample of operators that follow their bounds late.
    #[inline(always)]
    fn follow_late(&self, state: &mut [S::f64s; N], sample: usize, gap: Option<&Gap>) {
        let Lead { path, operator_law, .. } = *self.lead;
        let simd = self.simd;
        if sample == 0 {
            self.play(state, path[0], gap);
        } else if operator_law.stiffening > 0.0 {
            self.stiffening(state, [path[sample - 1], path[sample]], gap);
        } else {
            let mut bound = *state;
            self.play(&mut bound, path[sample], gap);
            for ((state, bound), share) in state.iter_mut().zip(bound).zip(self.followed) {
                *state = simd.add_f64s(*state, simd.mul_f64s(share, simd.sub_f64s(bound, *state)));
            }
        }
    }

    /// Operators that follow their bounds at the speed `x / T (1 + (x / E)^2)` for a distance `x`: the first terms of Eyring's law.
    #[inline(always)]
    fn stiffening(&self, state: &mut [S::f64s; N], [before, now]: [f64; 2], gap: Option<&Gap>) {
        let Lead { operator_law, period_s, .. } = *self.lead;
        let simd = self.simd;
        let growth = simd.splat_f64s((2.0 * period_s / LOOKS as f64 / operator_law.viscous_s).min(700.0).exp());
        let far = simd.splat_f64s(1.0 / (operator_law.stiffening * operator_law.stiffening));
        let (zero, one) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0));
        for look in 1..=LOOKS {
            let mut bound = *state;
            self.play(&mut bound, before + (now - before) * look as f64 / LOOKS as f64, gap);
            for (state, bound) in state.iter_mut().zip(bound) {
                let size = simd.sub_f64s(bound, *state);
                // Exact for a bound that stands still. At the bound the quotient is infinite and nothing is left, as it should be.
                let near = simd.add_f64s(simd.div_f64s(one, simd.mul_f64s(size, size)), far);
                let left = simd.div_f64s(one, simd.sqrt_f64s(simd.sub_f64s(simd.mul_f64s(near, growth), far)));
                let left = simd.select_f64s(simd.less_than_f64s(size, zero), simd.sub_f64s(zero, left), left);
                *state = simd.add_f64s(*state, simd.sub_f64s(size, left));
            }
        }
    }
}

/// Steps of a stiffening operator inside a sample.
const LOOKS: usize = 2;

/// The gap at every sample of `path`; rates count where there is a sample period.
fn gaps(path: &[f64], operator_law: &OperatorLaw, period_s: Option<f64>, turns: &[(usize, f64)]) -> Vec<Gap> {
    let last = path.len().saturating_sub(1);
    let with_rate = operator_law.growth_per_rate != 0.0
        || operator_law.extra_per_rate != 0.0
        || operator_law.law.is_some_and(|(law, _)| law.has_rate());
    let fading = period_s.map_or(0.0, |period_s| -(-period_s / operator_law.rate_memory_s).exp_m1());
    let mut faded = 0.0;
    let mut turns = turns.iter().peekable();
    let mut turned = None;
    let gap = |(index, &value): (usize, &f64)| {
        let turned_before = std::mem::replace(&mut turned, turns.next_if(|turn| turn.0 == index + 1).map(|turn| turn.1));
        let rate = match period_s {
            Some(period_s) if with_rate && operator_law.rate_memory_s > 0.0 => {
                let from = path[index.saturating_sub(1)];
                let way = turned_before.map_or((value - from).abs(), |turn| (turn - from).abs() + (value - turn).abs());
                faded += (way / period_s - faded) * fading;
                faded
            }
            Some(period_s) if with_rate => {
                // Not across a turn: the mean of both strokes' rates would be next to nothing.
                let before = if turned_before.is_some() { index } else { index.saturating_sub(1) };
                let after = if turned.is_some() { index } else { (index + 1).min(last) };
                (path[after] - path[before]).abs() / ((after - before).max(1) as f64 * period_s)
            }
            _ => 0.0,
        };
        let rate = operator_law.saturated(rate);
        let factor = ((1.0 + operator_law.growth_per_input * value).max(0.0) + operator_law.growth_per_rate * rate)
            * operator_law.factor(value, rate);
        let unloading = operator_law.growth_unloading * value;
        let [slope, bend, cubic] = operator_law.envelopes;
        let apart = value * (slope + (1.0 - value) * (bend + cubic * (1.0 - 2.0 * value)));
        [factor, apart + operator_law.extra_per_rate * rate, unloading]
    };
    path.iter().enumerate().map(gap).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn operators_that_hang_on_rates_go_on_in_the_next_recording_where_the_last_one_left_them() {
        const PERIOD_S: f64 = 0.02;
        let thresholds = [0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7];
        let operator_law = OperatorLaw { growth_per_rate: 0.6, rate_memory_s: 0.02, ..OperatorLaw::default() };
        // Fast strokes, then slow ones half as wide; each recording begins and ends at rest.
        let stroke = |sample: usize, frequency_hz: f64, size: f64| {
            let time_s = (sample.clamp(25, 175) - 25) as f64 * PERIOD_S;
            0.5 * size * (1.0 - (std::f64::consts::TAU * frequency_hz * time_s).cos())
        };
        let fast: Vec<f64> = (0..200).map(|sample| stroke(sample, 2.0, 1.0)).collect();
        let slow: Vec<f64> = (0..200).map(|sample| stroke(sample, 1.0, 0.5)).collect();
        let written = |begin: Begin<'_>, path: &[f64]| {
            let mut rows = Rows::default();
            rows.shape(path.len(), AHEAD + thresholds.len(), (AHEAD + thresholds.len()).next_multiple_of(SIDE));
            write(&thresholds, &Lead { begin, path, operator_law: &operator_law, period_s: PERIOD_S }, &mut rows);
            rows.values.chunks_exact(rows.stride).map(|row| row[AHEAD..AHEAD + thresholds.len()].to_vec()).collect::<Vec<_>>()
        };
        let mut states = States::new(&thresholds, &[], operator_law);
        states.lead(&fast, PERIOD_S);
        let in_two = written(states.begin(), &slow);
        let in_one = written(Begin::After(&[]), &[fast, slow.clone()].concat());
        let most = |one: &[Vec<f64>], other: &[Vec<f64>]| {
            one.iter().flatten().zip(other.iter().flatten()).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max)
        };
        assert!(most(&in_two, &in_one[200..]) < 1e-9);
        // Turning points take every stroke for a slow one.
        assert!(most(&written(Begin::After(&[0.0, 1.0, 0.0]), &slow), &in_two) > 0.01);
    }
}
