//! Sums of products of a model's columns over a session, and what can be kept from one model to the next.
//!
//! A search asks for one model after the other. As long as nothing changes before the operators, their columns and the products of these
//! with each other stay: what effects add costs no more than its own columns then.

use std::cell::RefCell;
use std::ops::Range;

use crate::chain::columns::{Columns, OUTPUT, place};
use crate::chain::operators::Begin;
use crate::data::session::{Role, Run, Session};
use crate::data::turning::remember;
use crate::model::initial_state::InitialState;
use crate::model::least_squares::{Gram, add_products, add_squares};
use crate::model::paths::Paths;
use crate::model::structure::{Model, Scope};

/// Sums for the roles that are looked at.
#[derive(Clone)]
pub struct Sums {
    /// Samples that are fitted.
    pub fit: Gram,
    /// Samples that select.
    pub select: Gram,
    /// Which weights may be negative.
    pub free: Vec<bool>,
}

/// Where the sums of one model after the other are made.
pub struct Workspace<'a> {
    /// The session of its models.
    pub session: &'a Session,
    /// What the operators of the last model were made by.
    last: Option<Operators>,
    /// The operators of each recording, once they have been asked for twice.
    kept: Vec<Option<Recycled>>,
    /// Columns that nobody has asked for again so far.
    passing: Recycled,
    paths: Paths,
}

/// All that the operators' columns hang on.
#[derive(PartialEq)]
struct Operators {
    thresholds: Vec<f64>,
    initial_state: InitialState,
    stops: bool,
    /// Name, form and parameters of the effects before them.
    effects: Vec<(&'static str, &'static str, Vec<f64>)>,
}

impl Operators {
    fn of(model: &Model) -> Self {
        let before = model.slots.iter().filter(|slot| slot.form.leads_operators());
        let effects = before.map(|slot| (slot.form.name(), slot.form.form(), slot.parameters.clone())).collect();
        Self { thresholds: model.thresholds.clone(), initial_state: model.initial_state, stops: model.stops, effects }
    }
}

/// One recording's columns, and the products of the operators with each other where they have been wanted.
#[derive(Default)]
struct Prepared {
    columns: Columns,
    fit: Vec<f64>,
    select: Vec<f64>,
}

thread_local! {
    /// What workspaces of this thread have left behind. Memory that comes fresh from the system costs more than what is written to it.
    static LEFT: RefCell<Vec<Prepared>> = const { RefCell::new(Vec::new()) };
}

/// Columns in memory that an earlier workspace has used.
struct Recycled(Prepared);

impl Default for Recycled {
    fn default() -> Self {
        let mut prepared = LEFT.with_borrow_mut(Vec::pop).unwrap_or_default();
        prepared.columns.clear();
        prepared.fit.clear();
        prepared.select.clear();
        Self(prepared)
    }
}

impl Drop for Recycled {
    fn drop(&mut self) {
        let left = std::mem::take(&mut self.0);
        // Where the thread is about to end nobody takes it.
        let _ = LEFT.try_with(|all| all.borrow_mut().push(left));
    }
}

impl<'a> Workspace<'a> {
    /// For models of this session.
    #[must_use]
    pub fn new(session: &'a Session) -> Self {
        Self {
            session,
            last: None,
            kept: session.runs.iter().map(|_| None).collect(),
            passing: Recycled::default(),
            paths: Paths::default(),
        }
    }

    /// A model's output for the recordings that are `wanted`, as [`Model::outputs`] has it.
    #[must_use]
    pub fn outputs(&mut self, model: &Model, wanted: impl Fn(&Run) -> bool) -> Vec<Vec<f64>> {
        model.outputs_by(self.session, &mut self.paths, wanted)
    }

    /// Sums of products of a model's columns over the samples of `scope`.
    #[must_use]
    pub fn sums(&mut self, model: &Model, scope: Scope) -> Sums {
        let wanted = |role: Role| role == Role::Fit || (scope == Scope::Both && role == Role::Select);
        let looked_at = |run: &Run| (scope != Scope::Screen || run.screens) && run.role.iter().any(|&role| wanted(role));
        let operators = Operators::of(model);
        let again = self.last.as_ref() == Some(&operators);
        if !again {
            self.kept.iter_mut().for_each(|kept| *kept = None);
            self.last = Some(operators);
        }
        let runs = &self.session.runs;
        let end = runs.iter().rposition(looked_at).map_or(0, |last| last + 1);
        let missing = runs[..end].iter().zip(&self.kept).any(|(run, kept)| looked_at(run) && kept.is_none());
        // Operators that remember are led through the recordings between those that are looked at as well.
        let mut states = model.states().filter(|_| missing);
        let follows = (model.follows_history() && missing) || states.is_some();
        if missing {
            self.paths.lead(model, runs, (0..end).filter(|&run| follows || looked_at(&runs[run])).collect());
        }
        let jumps = model.slots.iter().any(|slot| slot.form.jumps().is_some());
        let mut history = model.initial_state.before_the_session();
        let (mut fit, mut select) = (Parts::default(), Parts::default());
        let mut free = Vec::new();
        for (run, kept) in runs[..end].iter().zip(&mut self.kept) {
            let is_new = looked_at(run) && kept.is_none();
            let Recycled(prepared) = if again && looked_at(run) { kept.get_or_insert_default() } else { &mut self.passing };
            if is_new || follows {
                let path = self.paths.path(run);
                if is_new {
                    if jumps {
                        prepared.columns.command.clear();
                        prepared.columns.command.extend_from_slice(self.paths.command(run));
                    }
                    let own;
                    let begin = match &states {
                        Some(states) => states.begin(),
                        None if follows => Begin::After(&history),
                        None => {
                            own = model.history(run);
                            Begin::After(&own)
                        }
                    };
                    model.operators(run, begin, path, &mut prepared.columns);
                    prepared.fit.clear();
                    prepared.select.clear();
                }
                if let Some(states) = &mut states {
                    states.lead(path, run.period_s);
                } else if follows {
                    remember(&mut history, path);
                }
            }
            if looked_at(run) {
                model.add_effects(run, &mut prepared.columns);
                fit.add(run, Role::Fit, &prepared.columns, &mut prepared.fit);
                if scope == Scope::Both {
                    select.add(run, Role::Select, &prepared.columns, &mut prepared.select);
                }
                free.clone_from(&prepared.columns.free);
            }
        }
        let operators = model.thresholds.len();
        Sums { fit: fit.gram(operators, free.len()), select: select.gram(operators, free.len()), free }
    }
}

/// Products of a session's columns: the operators (before them the constant and the measured output) and what effects add.
#[derive(Default)]
struct Parts {
    operators: Vec<f64>,
    across: Vec<f64>,
    added: Vec<f64>,
    samples: usize,
}

impl Parts {
    /// Adds one recording's samples of this role; `own` are its operators' products with each other, or empty if they are not yet known.
    fn add(&mut self, run: &Run, role: Role, columns: &Columns, own: &mut Vec<f64>) {
        let ranges = ranges(run, role);
        let ((operators, is_filtered), added) = (columns.operators(), columns.added());
        if is_filtered {
            for range in &ranges {
                add_squares(operators, range.clone(), &mut self.operators);
            }
        } else {
            if own.is_empty() {
                for range in &ranges {
                    add_squares(operators, range.clone(), own);
                }
            }
            self.operators.resize(own.len().max(self.operators.len()), 0.0);
            self.operators.iter_mut().zip(&*own).for_each(|(sum, value)| *sum += value);
        }
        for range in ranges {
            self.samples += range.len();
            add_products(operators, added, range.clone(), &mut self.across);
            add_squares(added, range, &mut self.added);
        }
    }

    /// The sums in the order of the weights, for so many operators and so many columns in all.
    fn gram(&self, operators: usize, columns: usize) -> Gram {
        let mut gram = Gram::new(columns);
        if self.samples == 0 {
            return gram;
        }
        let stride = self.operators.len().isqrt();
        let added = self.added.len().isqrt();
        // Weights of the constant and the operators.
        let own = operators + 1;
        for row in 0..columns {
            for column in row..columns {
                let product = match (row.checked_sub(own), column.checked_sub(own)) {
                    (Some(row), Some(column)) => self.added[row * added + column],
                    (None, Some(column)) => self.across[place(row) * added + column],
                    _ => {
                        let (one, other) = (place(row), place(column));
                        self.operators[one.min(other) * stride + one.max(other)]
                    }
                };
                gram.products[row * columns + column] = product;
                gram.products[column * columns + row] = product;
            }
            gram.target[row] = match row.checked_sub(own) {
                Some(row) => self.across[OUTPUT * added + row],
                None => self.operators[OUTPUT.min(place(row)) * stride + OUTPUT.max(place(row))],
            };
        }
        gram.energy = self.operators[OUTPUT * stride + OUTPUT];
        gram.samples = self.samples as f64;
        gram
    }
}

/// Stretches of samples of this role that count.
fn ranges(run: &Run, role: Role) -> Vec<Range<usize>> {
    let counts = |sample: usize| run.keep[sample] && run.role[sample] == role;
    let mut found = Vec::new();
    let mut start = 0;
    while let Some(from) = (start..run.input.len()).find(|&sample| counts(sample)) {
        let to = (from..run.input.len()).find(|&sample| !counts(sample)).unwrap_or(run.input.len());
        found.push(from..to);
        start = to;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{creep, pneumatic_lag, resonance, setup_change};
    use virtual_rig as rig;
    use virtual_rig::CaseConfig;

    /// Sums made sample by sample from the columns of the model.
    fn plain(model: &Model, session: &Session, role: Role) -> Gram {
        let mut gram = Gram::new(model.weights().len());
        for run in &session.runs {
            let mut columns = Columns::default();
            model.columns(run, &mut columns);
            let values: Vec<Vec<f64>> = (0..gram.columns).map(|weight| columns.column(weight)).collect();
            for sample in (0..run.input.len()).filter(|&sample| run.keep[sample] && run.role[sample] == role) {
                for (row, one) in values.iter().enumerate() {
                    for (column, other) in values.iter().enumerate() {
                        gram.products[row * gram.columns + column] += one[sample] * other[sample];
                    }
                    gram.target[row] += one[sample] * run.output[sample];
                }
                gram.energy += run.output[sample].powi(2);
                gram.samples += 1.0;
            }
        }
        gram
    }

    #[test]
    fn sums_are_those_of_the_columns_whatever_was_kept_from_other_models() {
        let case = rig::hide(&CaseConfig { seed: 570, ..CaseConfig::default() }).expect("a case");
        let mut session = Session::new(&case.recordings[..7], &[]).expect("a session");
        for run in &mut session.runs {
            // Neighbours masked, and single samples.
            (0..run.keep.len()).filter(|sample| sample % 97 < 2 || sample % 61 == 5).for_each(|sample| run.keep[sample] = false);
        }
        let mut base = Model::baseline(InitialState::SESSION, false);
        base.fit(&session, Scope::Both);
        let with = |form, parameters: &[f64]| {
            let mut model = base.with(form, parameters.to_vec());
            let count = model.slots[0].form.spec().weights;
            model.slots[0].weights = vec![0.1; count];
            model
        };
        let pressed = |model: Model| Model { initial_state: InitialState::Carried { peak: 1.7 }, ..model };
        let (lag, swing, creeping, mount) = (pneumatic_lag::FORMS[0], resonance::FORMS[0], creep::FORMS[0], setup_change::FORMS[0]);
        let models = [
            base.clone(),
            with(creeping, &[]),
            with(creeping, &[]).with(swing, vec![2.0, 0.2]),
            with(mount, &[2.5]),
            with(lag, &[0.1]),
            with(lag, &[0.1]),
            with(lag, &[0.1]),
            pressed(base.clone()),
            pressed(with(lag, &[0.1])),
            base.refined(),
            base.clone(),
            base.clone(),
        ];
        let mut workspace = Workspace::new(&session);
        for (number, model) in models.iter().enumerate() {
            let sums = workspace.sums(model, Scope::Both);
            for (got, role) in [(&sums.fit, Role::Fit), (&sums.select, Role::Select)] {
                let wanted = plain(model, &session, role);
                assert_eq!(got.samples, wanted.samples);
                let all = |gram: &Gram| [&gram.products[..], &gram.target, &[gram.energy]].concat();
                for (got, wanted) in all(got).into_iter().zip(all(&wanted)) {
                    assert!((got - wanted).abs() < 1e-9 * (1.0 + wanted.abs()), "model {number}: {got} instead of {wanted}");
                }
            }
            // The same bits as from a workspace that has seen nothing.
            let fresh = Workspace::new(&session).sums(model, Scope::Both);
            assert_eq!(fresh.fit.products, sums.fit.products, "model {number}");
        }
    }
}
