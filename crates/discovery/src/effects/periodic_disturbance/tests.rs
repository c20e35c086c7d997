//! Tests of the periodic disturbance.

use super::*;
use recording::{Recording, Signal};
use std::path::Path;

fn session(input_hz: &[f64], beat_hz: f64) -> (Session, Vec<Vec<f64>>) {
    let recordings: Vec<Recording> = input_hz
        .iter()
        .map(|hz| {
            let time_s: Vec<f64> = (0..1000).map(|sample| f64::from(sample) * 0.02).collect();
            let input: Vec<f64> = time_s.iter().map(|time| 1.0 - (2.0 * PI * hz * time).cos()).collect();
            Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input)
                .expect("a recording")
        })
        .collect();
    let session = Session::new(&recordings, &[]).expect("a session");
    let residual =
        session.runs.iter().map(|run| run.session_s.iter().map(|time| 0.1 * (2.0 * PI * beat_hz * time).sin()).collect()).collect();
    (session, residual)
}

#[test]
fn a_rhythm_of_the_input_itself_is_no_disturbance_unless_other_recordings_tell_them_apart() {
    let begins_near = |input_hz: &[f64], beat_hz: f64| {
        let (session, residual) = session(input_hz, beat_hz);
        RUNNING_ON.starts(&session, &residual).iter().any(|start| (start[0] - beat_hz).abs() < 0.01)
    };
    assert!(!begins_near(&[1.0], 3.0), "the third harmonic of the only input");
    assert!(begins_near(&[1.0], 3.37));
    assert!(begins_near(&[1.0, 0.7], 3.0), "the second recording tells");
}

#[test]
fn the_base_of_a_beat_is_found_whichever_of_its_harmonics_is_strongest() {
    let (session, _) = session(&[0.3, 0.7], 1.0);
    let base_hz = 1.17;
    for sizes in [[1.0, 0.4, 0.2], [0.3, 1.0, 0.4], [0.4, 0.5, 1.0], [1.0, 0.0, 0.0], [0.6, 1.0, 0.0]] {
        let beat = |time_s: &f64| -> f64 {
            (1..).zip(sizes).map(|(harmonic, size)| size * (2.0 * PI * base_hz * f64::from(harmonic) * time_s + size).sin()).sum()
        };
        // A little of everything else, or a line would stand over nothing.
        let residual: Vec<Vec<f64>> = session
            .runs
            .iter()
            .map(|run| {
                run.session_s
                    .iter()
                    .zip(0_u32..)
                    .map(|(time_s, at)| beat(time_s) + 0.3 * f64::from(at % 1009 * (at % 1009) * 31 % 101) / 101.0)
                    .collect()
            })
            .collect();
        let bases = Spectrum::new(&session, &residual).bases();
        assert!(bases.first().is_some_and(|base| (base - base_hz).abs() < 0.02), "{sizes:?}: {bases:?}");
    }
}
