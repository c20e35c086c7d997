//! A simulation model under discovery: a bank of play operators and the effects added so far; its fit and its residual.

use std::sync::Arc;

use super::catalogue::{Columns, Form, Habit, Place};
use super::grid;
use super::least_squares::Gram;
use super::session::{Role, Run, Session};
use super::turning::{between_samples, remember};

/// One effect in the model.
#[derive(Clone)]
pub struct Slot {
    /// Its form.
    pub form: &'static dyn Form,
    /// Its non-linear parameters.
    pub parameters: Vec<f64>,
    /// Weights of the columns it adds, as of the last fit.
    pub weights: Vec<f64>,
}

/// The model.
#[derive(Clone)]
pub struct Model {
    /// Thresholds of the operators, normalised.
    pub thresholds: Vec<f64>,
    /// Whether operators remember earlier recordings.
    pub carry: bool,
    /// Whether the operators are stops (what a play lacks to its input: forces of friction) instead of plays (displacements).
    pub stops: bool,
    /// Effects in the order of the signal.
    pub slots: Vec<Slot>,
    /// Constant and weights of the operators as of the last fit.
    pub base: Vec<f64>,
    /// Further columns of free weight for each recording, which belong to no effect and have no say in predictions; none outside a search.
    pub ease: Arc<Vec<Vec<Vec<f64>>>>,
}

/// Sums for the three roles.
#[derive(Clone)]
pub struct Sums {
    /// Samples that are fitted.
    pub fit: Gram,
    /// Samples that select.
    pub select: Gram,
    /// Which weights may be negative.
    pub free: Vec<bool>,
}

/// In which order two effects on the same side of the operators follow each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// That of their places in the chain.
    Usual,
    /// The other way round.
    Turned,
}

/// Which samples a pass looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// A few of those that are fitted: for a first, coarse look.
    Screen,
    /// Those that are fitted.
    Fit,
    /// Those that are fitted and those that select.
    Both,
}

impl Model {
    /// The Prandtl-Ishlinskii model alone, on the coarse grid.
    #[must_use]
    pub fn baseline(carry: bool, stops: bool) -> Self {
        let thresholds = grid::coarse();
        Self { base: vec![0.0; thresholds.len() + 1], thresholds, carry, stops, slots: Vec::new(), ease: Arc::default() }
    }

    /// This model with one more effect, in its place in the chain.
    #[must_use]
    pub fn with(&self, form: &'static dyn Form, parameters: Vec<f64>) -> Self {
        self.with_in(Order::Usual, form, parameters)
    }

    /// This model with one more effect, in its place in the chain or, turned, on the other side of its neighbour there.
    #[must_use]
    pub fn with_in(&self, order: Order, form: &'static dyn Form, parameters: Vec<f64>) -> Self {
        let mut model = self.clone();
        let usual = self.place_of(form);
        let at = match self.neighbour_of(form) {
            Some(neighbour) if order == Order::Turned && neighbour < usual => usual - 1,
            Some(_) if order == Order::Turned => usual + 1,
            _ => usual,
        };
        model.slots.insert(at, Slot { form, parameters, weights: Vec::new() });
        model
    }

    /// Whether the effect has a neighbour in the chain that changes the same side, input or output: then their order matters.
    #[must_use]
    pub fn turns_with(&self, form: &'static dyn Form) -> bool {
        self.neighbour_of(form).is_some()
    }

    /// Where an effect comes in the usual order: behind the last one that comes before it, though others may have changed places.
    fn place_of(&self, form: &'static dyn Form) -> usize {
        self.slots.iter().rposition(|slot| slot.form.place() <= form.place()).map_or(0, |last| last + 1)
    }

    /// The nearest effect on the same side of the operators.
    fn neighbour_of(&self, form: &'static dyn Form) -> Option<usize> {
        let usual = self.place_of(form);
        let side = |form: &'static dyn Form| form.place().cmp(&Place::Operators);
        let beside = |at: &usize| self.slots.get(*at).is_some_and(|slot| side(slot.form) == side(form) && side(form).is_ne());
        usual.checked_sub(1).into_iter().chain([usual]).find(beside)
    }

    /// This model without one effect.
    #[must_use]
    pub fn without(&self, slot: usize) -> Self {
        let mut model = self.clone();
        model.slots.remove(slot);
        model
    }

    /// Names of the effects, in the order of the signal.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        self.slots.iter().map(|slot| slot.form.name())
    }

    /// Number of parameters that the effects add.
    #[must_use]
    pub fn cost(&self) -> usize {
        self.slots.iter().map(|slot| slot.form.cost()).sum()
    }

    /// Whether some effect needs the model's own output.
    #[must_use]
    pub fn needs_sum(&self) -> bool {
        self.slots.iter().any(|slot| slot.form.needs_sum())
    }

    /// All columns of the linear part for one recording.
    pub fn columns(&self, run: &Run, columns: &mut Columns) {
        self.columns_after(run, &self.history(run), columns);
    }

    /// All columns of the linear part for one recording after these turning points.
    fn columns_after(&self, run: &Run, history: &[f64], columns: &mut Columns) {
        let samples = run.input.len();
        columns.samples = samples;
        columns.values.clear();
        columns.free.clear();
        let mut path = run.input.clone();
        let mut habit = Habit { rate_power: 1.0, ..Habit::default() };
        columns.command.clone_from(&path);
        for slot in &self.slots {
            slot.form.input(&slot.parameters, run, &mut path);
            if slot.form.place() < Place::Muscle {
                columns.command.clone_from(&path);
            }
            slot.form.habit(&slot.parameters, &mut habit);
        }
        columns.push(true, |_| 1.0);
        self.operators(run, history, &path, &habit, columns);
        if self.stops {
            // The first operator has no threshold: its play is the path itself, the spring beside the sliders.
            for column in columns.values[2 * samples..].chunks_exact_mut(samples) {
                for (value, input) in column.iter_mut().zip(&path) {
                    *value = input - *value;
                }
            }
        }
        let mut weights = self.base.clone();
        let mut sum = Vec::new();
        columns.at_sensor.clear();
        columns.at_sensor.resize(samples, 0.0);
        for slot in &self.slots {
            if slot.form.needs_sum() {
                sum.clear();
                sum.resize(samples, 0.0);
                let first = usize::from(slot.form.jumps().is_none());
                weigh(columns, &weights, first, &mut sum);
            }
            slot.form.output(&slot.parameters, run, &sum, columns);
            let before = weights.len();
            weights.extend(&slot.weights);
            weights.resize(columns.free.len(), 0.0);
            if slot.form.place() == Place::Sensor {
                let mut added = std::mem::take(&mut columns.at_sensor);
                weigh(columns, &weights, before, &mut added);
                columns.at_sensor = added;
            }
        }
        for column in self.ease.get(run.index).into_iter().flatten() {
            columns.push(true, |sample| column[sample]);
        }
    }

    /// Columns of one recording and what they come to with the weights of the last fit.
    #[must_use]
    pub fn columns_and_output(&self, run: &Run) -> (Columns, Vec<f64>) {
        let mut columns = Columns::default();
        self.columns(run, &mut columns);
        let weights: Vec<f64> = self.base.iter().chain(self.slots.iter().flat_map(|slot| &slot.weights)).copied().collect();
        let mut sum = vec![0.0; run.input.len()];
        weigh(&columns, &weights, 0, &mut sum);
        (columns, sum)
    }

    /// Whether the operators remember what stages with a memory of their own made of earlier recordings.
    fn follows_history(&self) -> bool {
        self.carry && self.slots.iter().any(|slot| slot.form.follows_history())
    }

    /// Adds the turning points of one recording, as the operators see it, to those of earlier ones.
    fn follow(&self, run: &Run, history: &mut Vec<f64>) {
        let mut path = run.input.clone();
        self.slots.iter().for_each(|slot| slot.form.input(&slot.parameters, run, &mut path));
        remember(history, &path);
    }

    /// Turning points, before this recording, of the input as the operators see it.
    fn history(&self, run: &Run) -> Vec<f64> {
        let mut history = Vec::new();
        // A model from a file has its memory in turning points alone.
        if self.follows_history() && !run.session.is_empty() {
            run.session.iter().take(run.index).for_each(|earlier| self.follow(earlier, &mut history));
        } else if self.carry {
            history.clone_from(&run.history);
            for slot in self.slots.iter().filter(|slot| slot.form.is_static()) {
                slot.form.input(&slot.parameters, run, &mut history);
            }
        }
        history
    }

    /// The play operators' columns, several operators side by side so that none waits for its own last step.
    fn operators(&self, run: &Run, history: &[f64], path: &[f64], habit: &Habit, columns: &mut Columns) {
        let samples = path.len();
        let start = columns.values.len();
        columns.values.resize(start + samples * self.thresholds.len(), 0.0);
        columns.free.resize(columns.free.len() + self.thresholds.len(), false);
        let turns = between_samples(path);
        let (before, now) = if habit.is_plain() {
            (Vec::new(), Vec::new())
        } else {
            (gaps(history, habit, None, &[]), gaps(path, habit, Some(run.period_s), &turns))
        };
        let values = &mut columns.values[start..];
        for (group, block) in self.thresholds.chunks(SIDE).zip(values.chunks_mut(SIDE * samples)) {
            let mut thresholds = [0.0; SIDE];
            thresholds[..group.len()].copy_from_slice(group);
            let mut state = [0.0_f64; SIDE];
            for (at, &value) in history.iter().enumerate() {
                play(&mut state, &thresholds, value, before.get(at));
            }
            let mut lanes: Vec<&mut [f64]> = block.chunks_exact_mut(samples).collect();
            let mut turns = turns.iter().peekable();
            for (sample, &value) in path.iter().enumerate() {
                let gap = now.get(sample);
                let turn = turns.next_if(|(at, _)| *at == sample);
                if let Some((_, turn)) = turn.filter(|_| habit.viscous_s <= 0.0) {
                    // It is still on the stroke that ends there, at its rate.
                    play(&mut state, &thresholds, *turn, now.get(sample - 1));
                }
                if habit.viscous_s <= 0.0 || sample == 0 {
                    play(&mut state, &thresholds, value, gap);
                } else if habit.stiffening > 0.0 {
                    stiffening(&mut state, &thresholds, [path[sample - 1], value], gap, run.period_s, habit);
                } else {
                    let follow = 1.0 - (-run.period_s / habit.viscous_s).exp();
                    let mut bound = state;
                    play(&mut bound, &thresholds, value, gap);
                    for (state, bound) in state.iter_mut().zip(bound) {
                        *state += follow * (bound - *state);
                    }
                }
                for (lane, state) in lanes.iter_mut().zip(&state) {
                    lane[sample] = *state;
                }
            }
        }
    }

    /// Sums of products over the session.
    #[must_use]
    pub fn sums(&self, session: &Session, scope: Scope) -> Sums {
        let mut columns = Columns::default();
        let mut sums: Option<Sums> = None;
        let wanted = |role: Role| role == Role::Fit || (scope == Scope::Both && role == Role::Select);
        let looked_at = |run: &Run| (scope != Scope::Screen || run.screens) && run.role.iter().any(|&role| wanted(role));
        let last = session.runs.iter().rposition(looked_at).unwrap_or(0);
        let follows = self.follows_history();
        let mut history = Vec::new();
        for run in &session.runs[..=last] {
            if looked_at(run) {
                let before = if follows { &history } else { &self.history(run) };
                self.columns_after(run, before, &mut columns);
            }
            if follows {
                self.follow(run, &mut history);
            }
            if !looked_at(run) {
                continue;
            }
            let width = columns.free.len();
            columns.push(true, |sample| run.output[sample]);
            if run.keep.iter().any(|keep| !keep) {
                columns.filter(|column| column.iter_mut().zip(&run.keep).filter(|(_, keep)| !**keep).for_each(|(value, _)| *value = 0.0));
            }
            let sums =
                sums.get_or_insert_with(|| Sums { fit: Gram::new(width), select: Gram::new(width), free: columns.free[..width].to_vec() });
            let mut start = 0;
            while start < run.input.len() {
                let role = run.role[start];
                let end = (start..run.input.len()).find(|&sample| run.role[sample] != role).unwrap_or(run.input.len());
                if wanted(role) {
                    accumulate(if role == Role::Fit { &mut sums.fit } else { &mut sums.select }, &columns, run, start..end);
                }
                start = end;
            }
        }
        sums.unwrap_or_else(|| Sums { fit: Gram::new(0), select: Gram::new(0), free: Vec::new() })
    }

    /// Takes the weights of a fit.
    pub fn take(&mut self, weights: &[f64]) {
        let base = self.thresholds.len() + 1;
        self.base = weights[..base].to_vec();
        let mut at = base;
        for slot in &mut self.slots {
            let count = slot.form.weights();
            slot.weights = weights[at..at + count].to_vec();
            at += count;
        }
    }

    /// Fits the weights, with passes where an effect acts on the model's own output; mean squares of fitted and selecting samples.
    ///
    /// With passes the figures are those of the last weights on columns made with them: what [`Self::predict`] then leaves, whether or not
    /// the passes have settled.
    pub fn fit(&mut self, session: &Session, scope: Scope) -> (f64, f64) {
        let mut sums = self.sums(session, scope);
        let mut weights = sums.fit.solve(&sums.free);
        self.take(&weights);
        if self.needs_sum() {
            for _ in 0..PASSES {
                sums = self.sums(session, scope);
                weights = sums.fit.solve(&sums.free);
                self.take(&weights);
            }
            sums = self.sums(session, scope);
        }
        (sums.fit.mean_square(&weights), sums.select.mean_square(&weights))
    }

    /// Fits the weights to fitted and selecting samples together.
    pub fn fit_all(&mut self, session: &Session) -> f64 {
        let passes = if self.needs_sum() { 1 + PASSES } else { 1 };
        let mut result = f64::MAX;
        for _ in 0..passes {
            let mut sums = self.sums(session, Scope::Both);
            sums.fit.add(&sums.select.clone());
            let weights = sums.fit.solve(&sums.free);
            result = sums.fit.mean_square(&weights);
            self.take(&weights);
        }
        result
    }

    /// Model output for one recording, normalised.
    #[must_use]
    pub fn predict(&self, run: &Run) -> Vec<f64> {
        self.columns_and_output(run).1
    }

    /// Measured minus predicted for every recording.
    #[must_use]
    pub fn residuals(&self, session: &Session) -> Vec<Vec<f64>> {
        session.runs.iter().map(|run| run.output.iter().zip(self.predict(run)).map(|(y, p)| y - p).collect()).collect()
    }
}

/// Adds the columns from `first` on, each by its weight, to `sum`.
fn weigh(columns: &Columns, weights: &[f64], first: usize, sum: &mut [f64]) {
    for (index, &weight) in weights.iter().enumerate().skip(first) {
        if weight != 0.0 {
            for (value, column) in sum.iter_mut().zip(columns.column(index)) {
                *value += weight * column;
            }
        }
    }
}

/// Passes after the first where an effect acts on the model's own output.
const PASSES: usize = 2;

/// Operators side by side.
const SIDE: usize = 8;

/// What an operator's threshold is multiplied by, what is added to it, and by what its multiple is larger on the unloading branch, at every
/// sample of `path`; rates count where there is a sample period.
fn gaps(path: &[f64], habit: &Habit, period_s: Option<f64>, turns: &[(usize, f64)]) -> Vec<[f64; 3]> {
    let last = path.len().saturating_sub(1);
    let with_rate = habit.growth_per_rate != 0.0 || habit.extra_per_rate != 0.0;
    let mut faded = 0.0;
    let gap = |(index, &value): (usize, &f64)| {
        let rate = match period_s {
            Some(period_s) if with_rate && habit.rate_memory_s > 0.0 => {
                let step = (value - path[index.saturating_sub(1)]).abs() / period_s;
                faded += (step - faded) * -(-period_s / habit.rate_memory_s).exp_m1();
                faded
            }
            Some(period_s) if with_rate => {
                // Not across a turn: the mean of both strokes' rates would be next to nothing.
                let turned = |at: usize| turns.binary_search_by_key(&at, |turn| turn.0).is_ok();
                let before = if turned(index) { index } else { index.saturating_sub(1) };
                let after = if turned(index + 1) { index } else { (index + 1).min(last) };
                ((path[after] - path[before]).abs() / ((after - before).max(1) as f64 * period_s)).powf(habit.rate_power)
            }
            _ => 0.0,
        };
        let factor = (1.0 + habit.growth_per_input * value).max(0.0) + habit.growth_per_rate * rate;
        let unloading = habit.growth_unloading * value;
        [factor, habit.envelope_bend * value * (1.0 - value) + habit.extra_per_rate * rate, unloading]
    };
    path.iter().enumerate().map(gap).collect()
}

/// One step of plain operators, or of ones whose thresholds are changed by `gap`.
fn play(state: &mut [f64; SIDE], thresholds: &[f64; SIDE], value: f64, gap: Option<&[f64; 3]>) {
    let &[factor, extra, unloading] = gap.unwrap_or(&[1.0, 0.0, 0.0]);
    for (state, threshold) in state.iter_mut().zip(thresholds) {
        let gap = (factor * threshold + extra).max(0.0);
        *state = state.max(value - gap).min(value + (gap + unloading * threshold).max(0.0));
    }
}

/// Steps of a stiffening operator inside a sample.
const LOOKS: usize = 2;

/// Operators that follow their bounds at the speed `x / T (1 + (x / E)^2)` for a distance `x`: the first terms of Eyring's law.
fn stiffening(
    state: &mut [f64; SIDE],
    thresholds: &[f64; SIDE],
    [before, now]: [f64; 2],
    gap: Option<&[f64; 3]>,
    period_s: f64,
    habit: &Habit,
) {
    let growth = (2.0 * period_s / LOOKS as f64 / habit.viscous_s).min(700.0).exp();
    let far = 1.0 / (habit.stiffening * habit.stiffening);
    for look in 1..=LOOKS {
        let mut bound = *state;
        play(&mut bound, thresholds, before + (now - before) * look as f64 / LOOKS as f64, gap);
        for (state, bound) in state.iter_mut().zip(bound) {
            let size = bound - *state;
            // Exact for a bound that stands still. At the bound the quotient is infinite and nothing is left, as it should be.
            let left = ((1.0 / (size * size) + far) * growth - far).sqrt().recip();
            *state += size - left.copysign(size);
        }
    }
}

/// Adds the samples of `range` to the sums. The last column is the measured output; masked samples are zero in all columns.
fn accumulate(gram: &mut Gram, columns: &Columns, run: &Run, range: std::ops::Range<usize>) {
    let width = columns.free.len();
    let samples = columns.samples;
    assert!(width * samples <= columns.values.len() && range.end <= samples && !range.is_empty());
    let mut products = vec![0.0; width * width];
    let stride = isize::try_from(samples).unwrap_or(isize::MAX);
    let order = isize::try_from(width).unwrap_or(isize::MAX);
    let first = columns.values[range.start..].as_ptr();
    // SAFETY: the assertion above keeps `width` columns of `samples` values inside the slice; the range lies inside a column, so every
    // element `first + column * samples + k` with `k < range.len()` does too. The target is `width * width` long and not aliased.
    unsafe {
        gemm::gemm(
            width,
            width,
            range.len(),
            products.as_mut_ptr(),
            1,
            order,
            false,
            first,
            1,
            stride,
            first,
            stride,
            1,
            0.0,
            1.0,
            false,
            false,
            false,
            gemm::Parallelism::None,
        );
    }
    let inner = width - 1;
    for row in 0..inner {
        for column in 0..inner {
            gram.products[row * inner + column] += products[row * width + column];
        }
        gram.target[row] += products[row * width + inner];
    }
    gram.energy += products[width * width - 1];
    gram.samples += run.keep[range].iter().filter(|keep| **keep).count() as f64;
}
