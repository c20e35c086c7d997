//! The inputs of a session's recordings as the operators see them, stage by stage.
//!
//! Stages lead all recordings side by side. A search changes the parameters of one effect mostly: what comes before it in the chain
//! is kept from one model to the next.

use crate::chain::form::{Form, Place};
use crate::data::session::Run;
use crate::model::structure::{Model, Slot};

/// Paths of some recordings behind the stages that change them.
#[derive(Default)]
pub struct Paths {
    /// Indices of the recordings.
    of: Vec<usize>,
    stages: Vec<Stage>,
}

/// What one effect makes of the paths before it.
struct Stage {
    form: &'static dyn Form,
    parameters: Vec<f64>,
    paths: Vec<Vec<f64>>,
}

impl Stage {
    fn is_of(&self, slot: &Slot) -> bool {
        let same = self.form.name() == slot.form.name() && self.form.form() == slot.form.form();
        same && self.parameters == slot.parameters
    }
}

impl Paths {
    /// Leads the recordings `of`, by their indices among `runs`, through the stages of a model.
    pub fn lead(&mut self, model: &Model, runs: &[Run], of: Vec<usize>) {
        if self.of != of {
            self.of = of;
            self.stages.clear();
        }
        let slots: Vec<&Slot> = model.before_operators().collect();
        let same = self.stages.iter().zip(&slots).take_while(|(stage, slot)| stage.is_of(slot)).count();
        let mut old: Vec<Stage> = self.stages.drain(same..).collect();
        let led: Vec<&Run> = self.of.iter().map(|&run| &runs[run]).collect();
        for slot in &slots[same..] {
            let mut paths = old.pop().map(|stage| stage.paths).unwrap_or_default();
            paths.resize_with(led.len(), Vec::new);
            for (at, path) in paths.iter_mut().enumerate() {
                path.clear();
                path.extend_from_slice(self.stages.last().map_or(&led[at].input, |stage| &stage.paths[at]));
            }
            slot.form.inputs(&slot.parameters, &led, &mut paths);
            self.stages.push(Stage { form: slot.form, parameters: slot.parameters.clone(), paths });
        }
    }

    /// The input of a recording behind the first `stages`; `run` is among those that were led.
    fn behind<'a>(&'a self, stages: usize, run: &'a Run) -> &'a [f64] {
        let at = self.of.binary_search(&run.index).ok();
        let stage = stages.checked_sub(1).and_then(|last| self.stages.get(last));
        at.zip(stage).map_or(&run.input, |(at, stage)| &stage.paths[at])
    }

    /// The input as the operators see it.
    pub fn path<'a>(&'a self, run: &'a Run) -> &'a [f64] {
        self.behind(self.stages.len(), run)
    }

    /// The command that the muscle is told.
    pub fn command<'a>(&'a self, run: &'a Run) -> &'a [f64] {
        let last = self.stages.iter().rposition(|stage| stage.form.place() < Place::Muscle);
        self.behind(last.map_or(0, |last| last + 1), run)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::session::Session;
    use crate::effects::{leakage, pneumatic_lag, static_nonlinearity};
    use crate::model::initial_state::InitialState;
    use virtual_rig as rig;
    use virtual_rig::CaseConfig;

    #[test]
    fn paths_are_those_of_each_stage_whatever_was_led_before() {
        let case = rig::hide(&CaseConfig { seed: 571, ..CaseConfig::default() }).expect("a case");
        let session = Session::new(&case.recordings[..9], &[]).expect("a session");
        let (lag, leak, curve) = (pneumatic_lag::FORMS[0], leakage::FORMS[3], static_nonlinearity::FORMS[0]);
        let base = Model::baseline(InitialState::SESSION, false);
        let curved = vec![0.2; curve.parameters().len()];
        let models = [
            base.with(lag, vec![0.1]),
            base.with(lag, vec![0.1]).with(leak, vec![0.1, 0.2]),
            base.with(lag, vec![0.1]).with(leak, vec![0.2, 0.2]).with(curve, curved.clone()),
            base.with(lag, vec![0.1]).with(curve, curved),
            base.clone(),
            base.with(leak, vec![0.1, 0.2]),
        ];
        let mut paths = Paths::default();
        for (number, model) in models.iter().chain(models.iter().rev()).enumerate() {
            let of: Vec<usize> = if number % 3 == 2 { vec![1, 4, 5, 8] } else { (0..9).collect() };
            paths.lead(model, &session.runs, of.clone());
            for run in of.into_iter().map(|run| &session.runs[run]) {
                let (mut path, mut command) = (run.input.clone(), run.input.clone());
                for slot in &model.slots {
                    slot.form.input(&slot.parameters, run, &mut path);
                    if slot.form.place() < Place::Muscle {
                        command.clone_from(&path);
                    }
                }
                assert_eq!(paths.path(run), path, "model {number}");
                assert_eq!(paths.command(run), command, "model {number}");
            }
        }
    }
}
