//! The figures of a finding: what `evaluate` makes of the models, as they are written, on recordings that took no part in any choice.
//!
//! A model is simulated freely through the very code that `catheter evaluate` runs. Where it reads something that each recording has of its own
//! (a zero, a gain, a phase), both models have the zero set over the start-up stretch that the model states, and that stretch does not
//! count: a zero that a recording was given closes no gap.

use super::file::DiscoveredModel;
use super::model::Model;
use super::session::{Role, Session, SessionError};
use super::verdict;
use crate::evaluate::{self, Judging};
use crate::model::DiscoveredPredictor;
use crate::recording::Recording;

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
        let in_a_gap = verdict::in_a_gap(session, after);
        let reported = |at: usize| session.runs[at].role.contains(&Role::Kept) && !in_a_gap[at];
        let any = (0..session.runs.len()).any(reported);
        let mut samples = vec![Vec::new(); all.len()];
        for at in (0..session.runs.len()).filter(|&at| !any || reported(at)) {
            let run = &session.runs[at];
            let (recording, first) = run.source;
            let counts = &mut samples[recording];
            // A recording that was kept out whole counts whole, as it does to `evaluate`.
            counts.resize(all[recording].len(), !run.is_worked_with());
            if any && run.is_worked_with() {
                run.role.iter().enumerate().for_each(|(sample, role)| counts[first + sample] = *role == Role::Kept);
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
    pub fn simulate(&self, model: DiscoveredModel, calibrate_s: f64) -> Result<Simulated, SessionError> {
        let predictor = DiscoveredPredictor::new(model, "model.toml".as_ref());
        let recordings: Vec<Recording> = self.counting().map(|at| self.all[at].clone()).collect();
        let judging = Judging { calibrate_s, ..Judging::default() };
        let judged = evaluate::judge(&predictor, &recordings, judging, self.threads)
            .map_err(|problem| SessionError::Simulation { problem: format!("{problem:#}") })?;
        let mut outputs = vec![None; self.all.len()];
        self.counting().zip(judged).for_each(|(at, judged)| outputs[at] = Some(judged.predicted));
        Ok(self.figures(outputs, calibrate_s))
    }

    /// The same of predictions that somebody has made, for each recording.
    pub fn given(&self, predictions: &[Vec<f64>], calibrate_s: f64) -> Simulated {
        let mut outputs = vec![None; self.all.len()];
        for at in self.counting() {
            let mut output = predictions[at].clone();
            if calibrate_s > 0.0 {
                evaluate::set_zero(&mut output, self.all[at], calibrate_s);
            }
            outputs[at] = Some(output);
        }
        self.figures(outputs, calibrate_s)
    }

    fn figures(&self, outputs: Vec<Option<Vec<f64>>>, calibrate_s: f64) -> Simulated {
        let (mut sum, mut count) = (0.0, 0.0_f64);
        for at in self.counting() {
            let first = evaluate::first_behind(self.all[at], calibrate_s);
            let output = outputs[at].as_deref().unwrap_or_default();
            for sample in (first..output.len()).filter(|&sample| self.samples[at][sample]) {
                sum += (output[sample] - self.all[at].output[sample]).powi(2);
                count += 1.0;
            }
        }
        Simulated { rmse: (sum / count.max(1.0)).sqrt(), outputs }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use crate::discover::{DiscoverConfig, Finding, catalogue, discover, folder};
    use crate::evaluate::{self, Judging};
    use crate::recording::Recording;
    use crate::rig::{self, CaseConfig, Generator};

    /// Least share of the gap that a simulation by the model with a single hidden effect closes.
    const LEAST_CLOSED: f64 = 0.85;

    /// What `evaluate` makes of the model in a folder on kept-out recordings: pooled root mean square.
    fn evaluated(finding: &Finding, recordings: &[Recording], kept: &[Recording]) -> f64 {
        let folder = tempfile::tempdir().expect("a folder");
        folder::write(finding, recordings, folder.path()).expect("a folder with a model");
        let model = crate::model::load(&folder.path().join("model.toml")).expect("a model");
        let name = |recording: &Recording| recording.path.file_name().expect("a name").to_string_lossy().into_owned();
        let counted: Vec<Recording> =
            kept.iter().filter(|recording| !finding.discovery.side_unknown.contains(&name(recording))).cloned().collect();
        let judging = Judging { calibrate_s: finding.discovery.calibrate_s.unwrap_or(0.0), ..Judging::default() };
        let judged = evaluate::judge(&*model, &counted, judging, 1).expect("figures");
        let errors = || judged.iter().map(|judged| &judged.errors.errors);
        let samples: f64 = errors().map(|errors| errors.n as f64).sum();
        (errors().map(|errors| errors.rmse.powi(2) * errors.n as f64).sum::<f64>() / samples).sqrt()
    }

    fn reproduces(generator: Generator, names: &[&str], seed: u64) {
        for name in names {
            let config = CaseConfig { effects: vec![(*name).to_owned()], seed, generator, ..CaseConfig::default() };
            let mut case = rig::hide(&config).expect("a case");
            // Names of its own tell a kept-out recording from the others.
            for (index, recording) in case.kept_out.iter_mut().enumerate() {
                recording.path = Path::new(&format!("kept{index}.csv")).into();
            }
            let config = DiscoverConfig { most_effects: 1, threads: 2, ..DiscoverConfig::default() };
            let finding = discover(&case.recordings, &case.kept_out, &config).expect("a finding");
            let (claimed, met) = (finding.discovery.rmse_after, evaluated(&finding, &case.recordings, &case.kept_out));
            assert!((claimed / met - 1.0).abs() < 1e-9, "{generator:?} {name}: {claimed} claimed, {met} met");
            // Where a tip or a valve stands when a recording begins no simulation knows, and none foretells a bad reading.
            if !["stick-slip", "valve-dead-band", "outliers"].contains(name) {
                let closed = finding.discovery.gap_closed;
                assert!(closed > LEAST_CLOSED, "{generator:?} {name}: {closed} of the gap closed");
            }
        }
    }

    #[test]
    fn evaluate_reproduces_the_figures_of_the_first_half_of_the_catalogue() {
        reproduces(Generator::Physics, &catalogue::NAMES[..11], 530);
    }

    #[test]
    fn evaluate_reproduces_the_figures_of_the_second_half_of_the_catalogue() {
        reproduces(Generator::Physics, &catalogue::NAMES[11..], 530);
    }

    #[test]
    fn evaluate_reproduces_the_figures_of_a_rig_without_a_session_clock() {
        reproduces(Generator::Rival, &["offset-drift", "gain-drift", "setup-change", "periodic-disturbance", "pneumatic-lag"], 531);
    }
}
