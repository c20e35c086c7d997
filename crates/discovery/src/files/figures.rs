//! The figures of a finding: what `evaluate` makes of the models, as they are written, on recordings that took no part in any choice.
//!
//! A model is simulated freely as `catheter evaluate` does it, with the same figures. Where it reads something that each recording has of its own
//! (a zero, a gain, a phase), both models have the zero set over the start-up stretch that the model states, and that stretch does not
//! count: a zero that a recording was given closes no gap.

use recording::Recording;
use recording::simulation::{first_behind, set_zero};

use crate::data::session::{Role, Session, SessionError};
use crate::files::file::DiscoveredModel;
use crate::model::changes;
use crate::model::structure::Model;
use crate::search::parallel::in_parallel;

/// What a simulation made of the recordings that count.
pub struct Simulated {
    /// Root mean square of what it is off by there, output units.
    pub rmse: f64,
    /// Its output for each recording given and then each kept one; nothing for those that do not count.
    pub outputs: Vec<Option<Vec<f64>>>,
}

/// Recordings to simulate, and which of their samples count.
pub struct Counted<'a> {
    all: Vec<&'a Recording>,
    /// Whether each sample of each recording counts; nothing counts where there is nothing.
    samples: Vec<Vec<bool>>,
    threads: usize,
}

impl<'a> Counted<'a> {
    /// The samples that were kept out, or all where none were. Recordings in the gap of a change of set-up do not count.
    pub fn new(session: &Session, after: &Model, recordings: &'a [Recording], kept: &'a [Recording], threads: usize) -> Self {
        let all: Vec<&Recording> = recordings.iter().chain(kept).collect();
        let in_a_gap = changes::in_a_gap(session, after);
        let reported = |at: usize| session.runs[at].role.contains(&Role::Test) && !in_a_gap[at];
        let any = (0..session.runs.len()).any(reported);
        let mut samples = vec![Vec::new(); all.len()];
        for at in (0..session.runs.len()).filter(|&at| !any || reported(at)) {
            let run = &session.runs[at];
            let (recording, first) = run.source;
            let counts = &mut samples[recording];
            // A recording that was kept out whole counts whole, as it does to `evaluate`.
            counts.resize(all[recording].len(), !run.is_worked_with());
            if any && run.is_worked_with() {
                run.role.iter().enumerate().for_each(|(sample, role)| counts[first + sample] = *role == Role::Test);
            } else if !any {
                counts.fill(true);
            }
        }
        Self { all, samples, threads }
    }

    fn counting(&self) -> impl Iterator<Item = usize> {
        (0..self.all.len()).filter(|&at| !self.samples[at].is_empty())
    }

    /// Simulates a model as it is written; with `calibrate_s` the zero is set over so many seconds, which do not count.
    ///
    /// # Errors
    /// When it cannot be simulated.
    pub fn simulate(&self, model: &DiscoveredModel, calibrate_s: f64) -> Result<Simulated, SessionError> {
        let counting: Vec<usize> = self.counting().collect();
        let simulated = in_parallel(&counting, self.threads, |&at| {
            let recording = self.all[at];
            let problem = |problem: String| SessionError::Simulation { problem: format!("{}: {problem}", recording.path.display()) };
            let mut output = model.simulate_recording(recording, calibrate_s).map_err(problem)?;
            if first_behind(recording, calibrate_s) >= output.len() {
                return Err(problem(format!("nothing is left after a start-up of {calibrate_s} s")));
            }
            if output.iter().any(|value| !value.is_finite()) {
                return Err(problem("the simulation is not finite".to_owned()));
            }
            if calibrate_s > 0.0 {
                set_zero(&mut output, recording, calibrate_s);
            }
            Ok(output)
        });
        let mut outputs = vec![None; self.all.len()];
        for (at, output) in counting.into_iter().zip(simulated) {
            outputs[at] = Some(output?);
        }
        Ok(self.figures(outputs, calibrate_s))
    }

    /// The same of predictions that somebody has made, for each recording.
    pub fn given(&self, predictions: &[Vec<f64>], calibrate_s: f64) -> Simulated {
        let mut outputs = vec![None; self.all.len()];
        for at in self.counting() {
            let mut output = predictions[at].clone();
            if calibrate_s > 0.0 {
                set_zero(&mut output, self.all[at], calibrate_s);
            }
            outputs[at] = Some(output);
        }
        self.figures(outputs, calibrate_s)
    }

    fn figures(&self, outputs: Vec<Option<Vec<f64>>>, calibrate_s: f64) -> Simulated {
        let (mut sum, mut count) = (0.0, 0.0_f64);
        for at in self.counting() {
            let first = first_behind(self.all[at], calibrate_s);
            let output = outputs[at].as_deref().unwrap_or_default();
            for sample in (first..output.len()).filter(|&sample| self.samples[at][sample]) {
                sum += (output[sample] - self.all[at].output[sample]).powi(2);
                count += 1.0;
            }
        }
        Simulated { rmse: (sum / count.max(1.0)).sqrt(), outputs }
    }
}
