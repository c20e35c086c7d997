//! The outputs of recordings, or of blocks, that take no part in any choice.
//!
//! A [`Session`] does not have them: where a sample is kept out, its output reads zero (in a block of a recording that is worked with, the last
//! value before it) and the sample counts in nothing. Whoever holds the test view can put them back; that is the report, when all is decided.

use crate::data::session::{Role, Run, Session};

/// See the module.
pub struct TestView {
    /// Outputs of each run as they were measured, normalised.
    outputs: Vec<Vec<f64>>,
}

impl TestView {
    /// Takes the outputs of all samples that are kept out from runs.
    pub(crate) fn withhold(runs: &mut [Run]) -> Self {
        let outputs = runs.iter().map(|run| run.output.clone()).collect();
        for run in runs {
            let worked_with = run.is_worked_with();
            let first = run.output.iter().zip(&run.role).find(|(_, role)| worked_with && **role != Role::Test);
            let mut last = first.map_or(0.0, |(output, _)| *output);
            for sample in 0..run.output.len() {
                if run.role[sample] == Role::Test {
                    run.output[sample] = last;
                    run.keep[sample] = false;
                } else if worked_with {
                    last = run.output[sample];
                }
            }
        }
        Self { outputs }
    }

    /// Puts them back. From here on nothing may be decided.
    pub fn reveal(self, session: &mut Session) {
        for (run, output) in session.runs.iter_mut().zip(self.outputs) {
            run.output = output;
            for (keep, role) in run.keep.iter_mut().zip(&run.role) {
                *keep |= *role == Role::Test;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use virtual_rig::{self as rig, CaseConfig};

    #[test]
    fn a_session_does_not_have_the_outputs_that_are_kept_out_and_the_test_view_puts_them_back() {
        let case = rig::hide(&CaseConfig { seed: 580, ..CaseConfig::default() }).expect("a case");
        for recordings in [&case.recordings[..8], &case.recordings[..1]] {
            let (mut session, test) = Session::split(recordings, &[]).expect("a session");
            let mut withheld = 0;
            for run in &session.runs {
                let measured = &recordings[run.source.0].output[run.source.1..];
                for (sample, role) in run.role.iter().enumerate() {
                    if *role == Role::Test {
                        withheld += 1;
                        assert!(!run.keep[sample]);
                        let before = (0..sample).rev().find(|&at| run.role[at] != Role::Test);
                        assert_eq!(run.output[sample], before.map_or(0.0, |at| run.output[at]));
                    } else {
                        assert!((run.output[sample] * session.output_scale - measured[sample]).abs() < 1e-12);
                    }
                }
            }
            assert!(withheld > 100, "{withheld}");
            test.reveal(&mut session);
            for run in &session.runs {
                let measured = &recordings[run.source.0].output[run.source.1..];
                assert!(run.output.iter().zip(measured).all(|(own, value)| (own * session.output_scale - value).abs() < 1e-12));
                assert!(run.keep.iter().all(|keep| *keep));
            }
        }
    }

    #[test]
    fn what_is_kept_out_changes_nothing_that_is_found() {
        let effects = vec!["dead-time".to_owned()];
        let case = rig::hide(&CaseConfig { effects, seed: 581, ..CaseConfig::default() }).expect("a case");
        let config = crate::DiscoverConfig { most_effects: 1, threads: 2, ..crate::DiscoverConfig::default() };
        let mut other = case.kept_out.clone();
        for recording in &mut other {
            recording.output.iter_mut().for_each(|value| *value = 3.0 - 2.0 * *value);
        }
        let [one, two] = [&case.kept_out, &other].map(|kept| crate::discover(&case.recordings, kept, &config).expect("a finding"));
        assert_eq!(one.after.weights(), two.after.weights());
        assert_eq!(one.after.forms(), two.after.forms());
        assert_eq!(one.discovery.noise_floor, two.discovery.noise_floor);
        assert_eq!(one.discovery.unexplained, two.discovery.unexplained);
        assert_eq!(one.discovery.criterion, two.discovery.criterion);
        assert!(one.discovery.rmse_after < 0.1 * two.discovery.rmse_after);
    }
}
