//! A simulation model under discovery: a bank of play operators and the effects added so far; its fit and its residual.

use std::sync::Arc;

use super::catalogue::{Columns, Form, Habit, Place};
use super::columns::{AHEAD, Bank};
use super::effects::seated::NEVER_SHUT;
use super::grid;
use super::jumps::Drive;
use super::least_squares::Gram;
use super::operators::{self, Begin, Lead, States};
use super::past::Past;
use super::paths::Paths;
use super::session::{Beginning, Run, Session};
use super::turning::remember;
use super::workspace::Workspace;

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
    /// What the operators know when a recording begins.
    pub past: Past,
    /// Whether the operators are stops (what a play lacks to its input: forces of friction) instead of plays (displacements).
    pub stops: bool,
    /// Effects in the order of the signal.
    pub slots: Vec<Slot>,
    /// Constant and weights of the operators as of the last fit.
    pub base: Vec<f64>,
    /// Further columns of free weight for each recording, which belong to no effect and have no say in predictions; none outside a search.
    pub ease: Arc<Vec<Vec<Vec<f64>>>>,
    /// Whether a fit leaves the weights as they are, but for that of what jumps: its leaps have told them. Another effect unsettles them.
    pub settled: bool,
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
    pub fn baseline(past: Past, stops: bool) -> Self {
        let thresholds = grid::coarse();
        Self { base: vec![0.0; thresholds.len() + 1], thresholds, past, stops, slots: Vec::new(), ease: Arc::default(), settled: false }
    }

    /// This model with one more effect, in its place in the chain.
    #[must_use]
    pub fn with(&self, form: &'static dyn Form, parameters: Vec<f64>) -> Self {
        self.with_in(Order::Usual, form, parameters)
    }

    /// This model with one more effect, in its place in the chain or, turned, on the other side of its neighbour there.
    #[must_use]
    pub fn with_in(&self, order: Order, form: &'static dyn Form, parameters: Vec<f64>) -> Self {
        let mut model = self.unsettled();
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
        let mut model = self.unsettled();
        model.slots.remove(slot);
        model
    }

    /// This model with another effect in the place of one: where that stood, if both are on the same side of the operators.
    #[must_use]
    pub fn with_in_place_of(&self, slot: usize, form: &'static dyn Form, parameters: Vec<f64>) -> Self {
        let side = |form: &'static dyn Form| form.place().cmp(&Place::Operators);
        if side(self.slots[slot].form) != side(form) {
            return self.without(slot).with(form, parameters);
        }
        let mut model = self.unsettled();
        model.slots[slot] = Slot { form, parameters, weights: Vec::new() };
        model
    }

    /// This model, to be fitted anew.
    fn unsettled(&self) -> Self {
        Self { settled: false, ..self.clone() }
    }

    /// Names of the effects, in the order of the signal.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        self.slots.iter().map(|slot| slot.form.name())
    }

    /// Names of the effects and of their forms, in the order of the signal.
    #[must_use]
    pub fn forms(&self) -> Vec<(&'static str, &'static str)> {
        self.slots.iter().map(|slot| (slot.form.name(), slot.form.form())).collect()
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
        let mut path = run.input.clone();
        columns.command.clone_from(&path);
        for slot in self.before_operators() {
            slot.form.input(&slot.parameters, run, &mut path);
            if slot.form.place() < Place::Muscle {
                columns.command.clone_from(&path);
            }
        }
        match &run.beginning {
            Some(Beginning::After(history)) => self.operators(run, Begin::After(history), &path, columns),
            Some(Beginning::From(states)) => self.operators(run, Begin::From(states), &path, columns),
            None => self.operators(run, Begin::After(&self.history(run)), &path, columns),
        }
        self.add_effects(run, columns);
    }

    /// Effects that show in the operators' columns.
    pub(super) fn before_operators(&self) -> impl Iterator<Item = &Slot> {
        self.slots.iter().filter(|slot| slot.form.leads_operators())
    }

    /// How the operators deviate from plain ones.
    fn habit(&self) -> Habit {
        let mut habit = Habit::default();
        self.before_operators().for_each(|slot| slot.form.habit(&slot.parameters, &mut habit));
        habit
    }

    /// Begins the columns with the operators, led along `path`.
    pub(super) fn operators(&self, run: &Run, begin: Begin<'_>, path: &[f64], columns: &mut Columns) {
        let habit = self.habit();
        columns.bank = match begin {
            Begin::After(history) if self.is_a_bank() => Some(Bank { history: history.to_vec(), ..Bank::default() }),
            _ => None,
        };
        columns.begin(self.thresholds.len(), &run.output, |rows| {
            operators::write(&self.thresholds, &Lead { begin, path, habit: &habit, period_s: run.period_s }, rows);
            if self.stops {
                // The first operator has no threshold: its play is the path itself, the spring beside the sliders.
                for (row, input) in rows.values.chunks_exact_mut(rows.stride).zip(path) {
                    row[AHEAD + 1..AHEAD + self.thresholds.len()].iter_mut().for_each(|value| *value = input - *value);
                }
            }
        });
    }

    /// Whether it is nothing but play operators, behind a valve maybe.
    fn is_a_bank(&self) -> bool {
        let is_a_valve = |slot: &Slot| slot.form.jumps() == Some(Drive::Command) || slot.form.form() == NEVER_SHUT.form();
        !self.stops && self.slots.iter().all(is_a_valve)
    }

    /// What the effects make of the operators' columns, and those that they add.
    pub(super) fn add_effects(&self, run: &Run, columns: &mut Columns) {
        columns.forget_added();
        if let Some(bank) = &mut columns.bank {
            bank.constant = self.base[0];
            bank.operators = self.thresholds.iter().copied().zip(self.base[1..].iter().copied()).collect();
        }
        let samples = run.input.len();
        let mut weights = self.base.clone();
        let mut sum = Vec::new();
        columns.at_sensor.clear();
        columns.at_sensor.resize(samples, 0.0);
        for slot in &self.slots {
            if slot.form.needs_sum() {
                sum.clear();
                sum.resize(samples, 0.0);
                let first = usize::from(slot.form.jumps().is_none() && !slot.form.is_a_zero());
                columns.weigh(&weights, first, &mut sum);
            }
            slot.form.output(&slot.parameters, run, &sum, columns);
            let before = weights.len();
            weights.extend(&slot.weights);
            weights.resize(columns.free.len(), 0.0);
            if slot.form.place() == Place::Sensor {
                let mut added = std::mem::take(&mut columns.at_sensor);
                columns.weigh(&weights, before, &mut added);
                columns.at_sensor = added;
            }
        }
        for column in self.ease.get(run.index).into_iter().flatten() {
            columns.push(true, |sample| column[sample]);
        }
    }

    /// Shows `each` the columns of those recordings that are `wanted`, and what they come to with the weights of the last fit. `paths` are those
    /// of the last model, or none.
    pub(super) fn walk(
        &self,
        session: &Session,
        paths: &mut Paths,
        wanted: impl Fn(&Run) -> bool,
        mut each: impl FnMut(&Run, &Columns, Vec<f64>),
    ) {
        let mut states = self.states();
        let follows = self.follows_history() || states.is_some();
        let end = session.runs.iter().rposition(&wanted).map_or(0, |last| last + 1);
        let runs = &session.runs[..end];
        paths.lead(self, runs, (0..end).filter(|&run| follows || wanted(&runs[run])).collect());
        let weights = self.weights();
        let mut columns = Columns::default();
        let mut followed = self.past.before_the_session();
        for run in runs {
            let path = paths.path(run);
            if wanted(run) {
                columns.command.clear();
                columns.command.extend_from_slice(paths.command(run));
                let own;
                let begin = match &states {
                    Some(states) => states.begin(),
                    None if follows => Begin::After(&followed),
                    None => {
                        own = self.history(run);
                        Begin::After(&own)
                    }
                };
                self.operators(run, begin, path, &mut columns);
                self.add_effects(run, &mut columns);
                let mut sum = vec![0.0; run.input.len()];
                columns.weigh(&weights, 0, &mut sum);
                each(run, &columns, sum);
            }
            if let Some(states) = &mut states {
                states.lead(path, run.period_s);
            } else if follows {
                remember(&mut followed, path);
            }
        }
    }

    /// States of the operators before the session, where each recording begins with what the one before has left, and turning points do not
    /// tell what that is.
    pub(super) fn states(&self) -> Option<States<'_>> {
        let habit = self.habit();
        let carries = self.past.is_carried() && !self.stops && habit.hangs_on_rates();
        carries.then(|| States::new(&self.thresholds, &self.past.before_the_session(), habit))
    }

    /// Weights of the last fit: the constant, the operators, what effects add.
    pub(super) fn weights(&self) -> Vec<f64> {
        self.base.iter().chain(self.slots.iter().flat_map(|slot| &slot.weights)).copied().collect()
    }

    /// Whether the operators remember what stages with a memory of their own made of earlier recordings.
    pub(super) fn follows_history(&self) -> bool {
        self.past.is_carried() && self.slots.iter().any(|slot| slot.form.follows_history())
    }

    /// Turning points, before this recording, of the input as the operators see it.
    pub(super) fn history(&self, run: &Run) -> Vec<f64> {
        let mut history = self.past.before_the_session();
        // A model from a file has its memory in turning points alone.
        if self.follows_history() && !run.session.is_empty() {
            for earlier in run.session.iter().take(run.index) {
                let mut path = earlier.input.clone();
                self.before_operators().for_each(|slot| slot.form.input(&slot.parameters, earlier, &mut path));
                remember(&mut history, &path);
            }
        } else if self.past.is_carried() {
            let mut since = run.history.clone();
            for slot in self.slots.iter().filter(|slot| slot.form.is_static()) {
                slot.form.input(&slot.parameters, run, &mut since);
            }
            history.append(&mut since);
        }
        history
    }

    /// What the operators know when each recording begins, and behind the last.
    #[must_use]
    pub fn beginnings(&self, session: &Session) -> Vec<Beginning> {
        let mut paths = Paths::default();
        paths.lead(self, &session.runs, (0..session.runs.len()).collect());
        let mut states = self.states();
        let follows = self.follows_history();
        let mut followed = self.past.before_the_session();
        let mut beginnings = Vec::with_capacity(session.runs.len() + 1);
        for run in &session.runs {
            let path = paths.path(run);
            if let Some(states) = &mut states {
                beginnings.push(Beginning::From(states.states().to_vec()));
                states.lead(path, run.period_s);
            } else if follows {
                beginnings.push(Beginning::After(followed.clone()));
                remember(&mut followed, path);
            } else {
                beginnings.push(Beginning::After(self.history(run)));
            }
        }
        beginnings.push(match (states, session.runs.last()) {
            (Some(states), _) => Beginning::From(states.states().to_vec()),
            (None, Some(last)) if self.past.is_carried() && !follows => {
                let (mut history, mut path) = (self.history(last), last.input.clone());
                self.slots.iter().filter(|slot| slot.form.is_static()).for_each(|slot| slot.form.input(&slot.parameters, last, &mut path));
                remember(&mut history, &path);
                Beginning::After(history)
            }
            _ => Beginning::After(followed),
        });
        beginnings
    }

    /// Puts the mean over the recordings worked with into the constant where each recording has a zero of its own: a simulation, which
    /// reads no zero, then stands at the mean.
    pub fn anchor(&mut self, session: &Session) {
        let Some(at) = self.slots.iter().position(|slot| slot.form.is_a_zero()) else { return };
        let place = self.base.len() + self.slots[..at].iter().map(|slot| slot.form.weights()).sum::<usize>();
        let (mut sum, mut count) = (0.0, 0.0_f64);
        self.walk(session, &mut Paths::default(), Run::is_worked_with, |run, columns, _| {
            let zero = columns.column(place)[0];
            let counts = (0..run.keep.len()).filter(|&sample| run.counts(sample) && run.role[sample].is_worked_with()).count();
            sum += counts as f64 * zero;
            count += counts as f64;
        });
        self.base[0] += sum / count.max(1.0);
    }

    /// Seconds of measured output that effects need to read what a recording has of its own.
    #[must_use]
    pub fn start_up_s(&self) -> f64 {
        self.slots.iter().map(|slot| slot.form.start_up_s(&slot.parameters)).fold(0.0, f64::max)
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
        self.fit_in(&mut Workspace::new(session), scope)
    }

    /// As [`Self::fit`].
    pub(super) fn fit_in(&mut self, workspace: &mut Workspace<'_>, scope: Scope) -> (f64, f64) {
        let mut sums = workspace.sums(self, scope);
        if self.settled {
            let weights = self.weigh_jumps(&sums.fit);
            return (sums.fit.mean_square(&weights), sums.select.mean_square(&weights));
        }
        let mut weights = sums.fit.solve(&sums.free, &self.weights());
        self.take(&weights);
        if self.needs_sum() {
            for _ in 0..PASSES {
                sums = workspace.sums(self, scope);
                weights = sums.fit.solve(&sums.free, &weights);
                self.take(&weights);
            }
            sums = workspace.sums(self, scope);
        }
        (sums.fit.mean_square(&weights), sums.select.mean_square(&weights))
    }

    /// One pass of a fit to the fitted samples, by what effects make of the weights so far.
    pub(super) fn fit_once(&mut self, session: &Session, scope: Scope) {
        let sums = Workspace::new(session).sums(self, scope);
        let weights = sums.fit.solve(&sums.free, &self.weights());
        self.take(&weights);
    }

    /// Fits the weight of what jumps beside all others as they are; the weights then.
    fn weigh_jumps(&mut self, sums: &Gram) -> Vec<f64> {
        let Some(slot) = self.slots.iter().position(|slot| slot.form.jumps().is_some()) else { return self.weights() };
        let before = self.slots[..slot].iter().map(|slot| slot.weights.len()).sum::<usize>();
        self.slots[slot].weights = vec![0.0];
        let others = self.weights();
        self.slots[slot].weights = vec![sums.weight_beside(self.base.len() + before, &others).max(0.0)];
        self.weights()
    }

    /// Fits the weights to fitted and selecting samples together.
    pub fn fit_all(&mut self, session: &Session) -> f64 {
        let passes = if self.needs_sum() && !self.settled { 1 + PASSES } else { 1 };
        let mut workspace = Workspace::new(session);
        let mut result = f64::MAX;
        for _ in 0..passes {
            let mut sums = workspace.sums(self, Scope::Both);
            sums.fit.add(&sums.select);
            let weights = if self.settled { self.weigh_jumps(&sums.fit) } else { sums.fit.solve(&sums.free, &self.weights()) };
            result = sums.fit.mean_square(&weights);
            self.take(&weights);
        }
        result
    }

    /// Model output for one recording, normalised.
    #[must_use]
    pub fn predict(&self, run: &Run) -> Vec<f64> {
        let mut columns = Columns::default();
        self.columns(run, &mut columns);
        let mut sum = vec![0.0; run.input.len()];
        columns.weigh(&self.weights(), 0, &mut sum);
        sum
    }

    /// Model output for all recordings that are `wanted`, nothing for the others: as [`Self::predict`], in less time.
    #[must_use]
    pub fn outputs(&self, session: &Session, wanted: impl Fn(&Run) -> bool) -> Vec<Vec<f64>> {
        self.outputs_by(session, &mut Paths::default(), wanted)
    }

    /// As [`Self::outputs`], with the paths of the last model.
    pub(super) fn outputs_by(&self, session: &Session, paths: &mut Paths, wanted: impl Fn(&Run) -> bool) -> Vec<Vec<f64>> {
        let mut outputs = vec![Vec::new(); session.runs.len()];
        self.walk(session, paths, wanted, |run, _, output| outputs[run.index] = output);
        outputs
    }

    /// Measured minus predicted for every recording.
    #[must_use]
    pub fn residuals(&self, session: &Session) -> Vec<Vec<f64>> {
        let of = |(run, output): (&Run, Vec<f64>)| run.output.iter().zip(output).map(|(y, p)| y - p).collect();
        session.runs.iter().zip(self.outputs(session, |_| true)).map(of).collect()
    }
}

/// Passes after the first where an effect acts on the model's own output.
const PASSES: usize = 2;
