//! A file simulates as the model that it was written from.

use super::*;
use crate::chain::form::Place;
use crate::model::structure::Scope;
use virtual_rig::{self as rig, CaseConfig};

#[test]
fn a_file_simulates_the_session_as_the_model_does_whatever_effect_is_in_it() {
    let case = rig::hide(&CaseConfig { seed: 574, ..CaseConfig::default() }).expect("a case");
    let recordings = &case.recordings[..6];
    let session = Session::new(recordings, &[]).expect("a session");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("model.toml");
    let mut simulated = 0;
    for initial_state in [InitialState::Fresh, InitialState::carrying(true)] {
        let mut base = Model::baseline(initial_state, false);
        base.fit(&session, Scope::Both);
        let residual = base.residuals(&session);
        for form in catalogue::forms().into_iter().filter(|form| form.place() != Place::Reading) {
            let Some(start) = form.starts(&session, &residual).pop() else { continue };
            if form.start_up_s(&start) > 0.0 || form.spec().reads_output {
                continue;
            }
            let mut model = base.with(form, start);
            model.fit(&session, Scope::Both);
            std::fs::write(&path, DiscoveredModel::bare(&model, &session, &recordings[0]).encode().expect("TOML")).expect("a file");
            let read = DiscoveredModel::read(&path).expect("a model");
            for (recording, wanted) in recordings.iter().zip(model.outputs(&session, |_| true)) {
                let found = read.simulate_recording(recording, 0.0).expect("a simulation");
                let off = found.iter().zip(&wanted).map(|(found, wanted)| (found / session.output_scale - wanted).abs());
                let off = off.fold(0.0, f64::max);
                assert!(off < 1e-9, "{} {}: {off} spans off", form.name(), form.key());
            }
            simulated += 1;
        }
    }
    assert!(simulated > 120, "{simulated} models");
}
