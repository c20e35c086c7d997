//! Running a model over the recordings of a session: columns, outputs, residuals.

use crate::chain::columns::Columns;
use crate::chain::operators::Begin;
use crate::data::session::{Beginning, Run, Session};
use crate::data::turning::remember;
use crate::model::paths::Paths;
use crate::model::structure::Model;

impl Model {
    /// Shows `each` the columns of those recordings that are `wanted`, and what they come to with the weights of the last fit. `paths` are those
    /// of the last model, or none.
    pub(crate) fn walk(
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
        let mut followed = self.initial_state.before_the_session();
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

    /// What the operators know when each recording begins, and behind the last.
    #[must_use]
    pub fn beginnings(&self, session: &Session) -> Vec<Beginning> {
        let mut paths = Paths::default();
        paths.lead(self, &session.runs, (0..session.runs.len()).collect());
        let mut states = self.states();
        let follows = self.follows_history();
        let mut followed = self.initial_state.before_the_session();
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
            (None, Some(last)) if self.initial_state.is_carried() && !follows => {
                let (mut history, mut path) = (self.history(last), last.input.clone());
                self.slots
                    .iter()
                    .filter(|slot| slot.form.spec().is_static)
                    .for_each(|slot| slot.form.input(&slot.parameters, last, &mut path));
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
        let Some(at) = self.slots.iter().position(|slot| slot.form.spec().is_a_zero) else { return };
        let place = self.base.len() + self.slots[..at].iter().map(|slot| slot.form.spec().weights).sum::<usize>();
        let (mut sum, mut count) = (0.0, 0.0_f64);
        self.walk(session, &mut Paths::default(), Run::is_worked_with, |run, columns, _| {
            let zero = columns.column(place)[0];
            let counts = (0..run.keep.len()).filter(|&sample| run.counts(sample) && run.role[sample].is_worked_with()).count();
            sum += counts as f64 * zero;
            count += counts as f64;
        });
        self.base[0] += sum / count.max(1.0);
    }

    /// Model output for all recordings that are `wanted`, nothing for the others: as [`Self::predict`], in less time.
    #[must_use]
    pub fn outputs(&self, session: &Session, wanted: impl Fn(&Run) -> bool) -> Vec<Vec<f64>> {
        self.outputs_by(session, &mut Paths::default(), wanted)
    }

    /// As [`Self::outputs`], with the paths of the last model.
    pub(crate) fn outputs_by(&self, session: &Session, paths: &mut Paths, wanted: impl Fn(&Run) -> bool) -> Vec<Vec<f64>> {
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
