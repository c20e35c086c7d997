//! A simulation model under discovery: a bank of play operators and the effects added so far; its fit and its residual.

use std::sync::Arc;

use crate::chain::columns::{AHEAD, Bank, Columns};
use crate::chain::form::{Drive, FOLLOWING, Form, OperatorLaw, Place};
use crate::chain::operators;
use crate::chain::operators::{Begin, Lead, States};
use crate::data::session::{Beginning, Run, Session};
use crate::data::turning::remember;
use crate::effects::other_input;
use crate::model::grid;
use crate::model::initial_state::InitialState;

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
    pub initial_state: InitialState,
    /// Whether the operators are stops (what a play lacks to its input: forces of friction) instead of plays (displacements).
    pub stops: bool,
    /// Effects in the order of the signal.
    pub slots: Vec<Slot>,
    /// Constant and weights of the operators as of the last fit.
    pub base: Vec<f64>,
    /// Further columns of free weight for each recording, which belong to no effect and have no say in predictions; none outside a search.
    pub sensitivities: Arc<Vec<Vec<Vec<f64>>>>,
    /// Whether a fit leaves the weights as they are, but for that of what jumps: its slips have told them. Another effect unsettles them.
    pub fixed_weights: bool,
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

/// Parameters of a form brought into their ranges.
fn in_ranges(form: &dyn Form, mut parameters: Vec<f64>) -> Vec<f64> {
    parameters.iter_mut().zip(form.parameters()).for_each(|(value, range)| *value = value.clamp(range.low, range.high));
    parameters
}

impl Model {
    /// The Prandtl-Ishlinskii model alone, on the coarse grid.
    #[must_use]
    pub fn baseline(initial_state: InitialState, stops: bool) -> Self {
        let thresholds = grid::coarse();
        Self {
            base: vec![0.0; thresholds.len() + 1],
            thresholds,
            initial_state,
            stops,
            slots: Vec::new(),
            sensitivities: Arc::default(),
            fixed_weights: false,
        }
    }

    /// This model with the operators of a session's further inputs.
    #[must_use]
    pub fn with_others(&self, session: &Session) -> Self {
        let lacking =
            other_input::FORMS[..session.others.len()].iter().filter(|form| self.slots.iter().all(|slot| slot.form.key() != form.key()));
        lacking.fold(self.clone(), |model, form| model.with(*form, Vec::new()))
    }

    /// This model with one more effect, in its place in the chain.
    #[must_use]
    pub fn with(&self, form: &'static dyn Form, parameters: Vec<f64>) -> Self {
        self.with_in(Order::Usual, form, parameters)
    }

    /// This model with one more effect, in its place in the chain or, turned, on the other side of its neighbour there. Parameters are brought into
    /// their ranges: no file holds others.
    #[must_use]
    pub fn with_in(&self, order: Order, form: &'static dyn Form, parameters: Vec<f64>) -> Self {
        let (mut model, at) = (self.with_free_weights(), self.place_in(order, form));
        model.slots.insert(at, Slot { form, parameters: in_ranges(form, parameters), weights: Vec::new() });
        model
    }

    /// Whether the effect has a neighbour in the chain that changes the same side, input or output: then their order matters.
    #[must_use]
    pub fn turns_with(&self, form: &'static dyn Form) -> bool {
        self.neighbour_of(form).is_some()
    }

    /// At which place [`Self::with_in`] puts an effect.
    pub fn place_in(&self, order: Order, form: &'static dyn Form) -> usize {
        let usual = self.place_of(form);
        match self.neighbour_of(form) {
            Some(neighbour) if order == Order::Turned && neighbour < usual => usual - 1,
            Some(_) if order == Order::Turned => usual + 1,
            _ => usual,
        }
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
        let mut model = self.with_free_weights();
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
        let mut model = self.with_free_weights();
        model.slots[slot] = Slot { form, parameters: in_ranges(form, parameters), weights: Vec::new() };
        model
    }

    /// This model, to be fitted anew.
    fn with_free_weights(&self) -> Self {
        Self { fixed_weights: false, ..self.clone() }
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

    /// Number of parameters that the effects add, without those that they do without.
    #[must_use]
    pub fn cost(&self) -> usize {
        let of = |slot: &Slot| {
            let idle = |(at, &value): (usize, &f64)| slot.form.does_without(at, [value; 2]);
            slot.form.cost() - slot.parameters.iter().enumerate().filter(|one| idle(*one)).count()
        };
        self.slots.iter().map(of).sum()
    }

    /// Whether some effect needs the model's own output.
    #[must_use]
    pub fn needs_sum(&self) -> bool {
        self.slots.iter().any(|slot| slot.form.spec().needs_sum)
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
    pub(crate) fn before_operators(&self) -> impl Iterator<Item = &Slot> {
        self.slots.iter().filter(|slot| slot.form.leads_operators())
    }

    /// How the operators deviate from plain ones.
    pub(crate) fn operator_law(&self) -> OperatorLaw {
        let mut operator_law = OperatorLaw::default();
        self.before_operators().for_each(|slot| slot.form.operator_law(&slot.parameters, &mut operator_law));
        operator_law
    }

    /// Begins the columns with the operators, led along `path`.
    pub(crate) fn operators(&self, run: &Run, begin: Begin<'_>, path: &[f64], columns: &mut Columns) {
        let operator_law = self.operator_law();
        columns.bank = match begin {
            Begin::After(history) if self.is_a_bank() => Some(Bank { history: history.to_vec(), ..Bank::default() }),
            _ => None,
        };
        columns.begin(self.thresholds.len(), &run.output, |rows| {
            operators::write(&self.thresholds, &Lead { begin, path, operator_law: &operator_law, period_s: run.period_s }, rows);
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
        let is_a_valve = |slot: &Slot| slot.form.jumps() == Some(Drive::Command) || slot.form.key() == FOLLOWING.0;
        !self.stops && self.slots.iter().all(is_a_valve)
    }

    /// What the effects make of the operators' columns, and those that they add.
    pub(crate) fn add_effects(&self, run: &Run, columns: &mut Columns) {
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
            if slot.form.spec().needs_sum {
                sum.clear();
                sum.resize(samples, 0.0);
                let first = usize::from(slot.form.jumps().is_none() && !slot.form.spec().is_a_zero);
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
        for column in self.sensitivities.get(run.index).into_iter().flatten() {
            columns.push(true, |sample| column[sample]);
        }
    }

    /// States of the operators before the session, where each recording begins with what the one before has left, and turning points do not
    /// tell what that is.
    pub(crate) fn states(&self) -> Option<States<'_>> {
        let operator_law = self.operator_law();
        let carries = self.initial_state.is_carried() && !self.stops && operator_law.hangs_on_rates();
        carries.then(|| States::new(&self.thresholds, &self.initial_state.before_the_session(), operator_law))
    }

    /// Weights of the last fit: the constant, the operators, what effects add.
    pub(crate) fn weights(&self) -> Vec<f64> {
        self.base.iter().chain(self.slots.iter().flat_map(|slot| &slot.weights)).copied().collect()
    }

    /// Whether the operators remember what stages with a memory of their own made of earlier recordings.
    pub(crate) fn follows_history(&self) -> bool {
        self.initial_state.is_carried() && self.slots.iter().any(|slot| slot.form.follows_history())
    }

    /// Turning points, before this recording, of the input as the operators see it.
    pub(crate) fn history(&self, run: &Run) -> Vec<f64> {
        let mut history = self.initial_state.before_the_session();
        // A model from a file has its memory in turning points alone.
        if self.follows_history() && !run.session.is_empty() {
            for earlier in run.session.iter().take(run.index) {
                let mut path = earlier.input.clone();
                self.before_operators().for_each(|slot| slot.form.input(&slot.parameters, earlier, &mut path));
                remember(&mut history, &path);
            }
        } else if self.initial_state.is_carried() {
            let mut since = run.history.clone();
            for slot in self.slots.iter().filter(|slot| slot.form.spec().is_static) {
                slot.form.input(&slot.parameters, run, &mut since);
            }
            history.append(&mut since);
        }
        history
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
            let count = slot.form.spec().weights;
            slot.weights = weights[at..at + count].to_vec();
            at += count;
        }
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
}

/// By which lag a model's operators follow a valve's command, s.
pub fn follows_s(model: &Model) -> f64 {
    model.slots.iter().find(|slot| slot.form.key() == FOLLOWING.0).map_or(0.0, |slot| slot.parameters[0])
}
