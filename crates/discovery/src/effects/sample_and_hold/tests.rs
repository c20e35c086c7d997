use std::f64::consts::TAU;

use super::*;
use recording::{Recording, Signal};
use std::path::Path;

fn session(input_hz: &[f64]) -> Session {
    session_of(1000, input_hz)
}

fn session_of(samples: i32, input_hz: &[f64]) -> Session {
    let of = |hz: &f64| {
        let time_s: Vec<f64> = (0..samples).map(|sample| f64::from(sample) * 0.02).collect();
        let input: Vec<f64> = time_s.iter().map(|time| 0.5 - 0.5 * (TAU * hz * time).cos()).collect();
        Recording::new(Path::new("run.csv"), Signal::pressure_bar(), Signal::displacement_mm(), time_s, input.clone(), input)
    };
    let recordings: Vec<Recording> = input_hz.iter().map(|hz| of(hz).expect("a recording")).collect();
    Session::new(&recordings, &[]).expect("a session")
}

#[test]
fn what_was_looked_at_last_is_held() {
    let session = session(&[0.3]);
    let run = &session.runs[0];
    let (period_s, first) = (0.137, 0.3);
    let mut path = run.input.clone();
    OF_EACH_RECORDING.input(&[period_s, first, FOLLOWS.low, AGE.low], run, &mut path);
    // The last of all looks before each sample, found by counting them.
    let looks: Vec<f64> = (0..150).map(|look| (f64::from(look) + first) * period_s).collect();
    for (time_s, value) in run.time_s.iter().zip(path) {
        let look_s = looks.iter().copied().take_while(|look| look <= time_s).last().unwrap_or(0.0);
        let exact = 0.5 - 0.5 * (TAU * 0.3 * look_s).cos();
        // Straight lines between samples miss a sine by (omega dt)^2 / 16.
        assert!((value - exact).abs() < 1e-4, "at {time_s} s: {value} instead of {exact}");
    }
}

#[test]
fn an_output_that_is_held_is_what_a_held_command_would_be() {
    let session = session(&[0.3]);
    let run = &session.runs[0];
    for (form, parameters) in
        [(&OUTPUT_OF_EACH_RECORDING, [0.137, 0.3]), (&OUTPUT_RUNNING_ON, [0.06, 0.0]), (&OUTPUT_RUNNING_ON, [0.5, 0.9])]
    {
        let mut columns = Columns::of(run.input.len());
        columns.push(true, |sample| run.input[sample]);
        form.output(&parameters, run, &[], &mut columns);
        let mut wanted = run.input.clone();
        hold(&mut wanted, parameters[0], form.first_look(&parameters, run, &[]), FOLLOWS.low, run.period_s);
        let found = columns.column(0);
        assert!(found.iter().zip(&wanted).all(|(found, wanted)| (found - wanted).abs() < 1e-9), "{parameters:?}");
    }
}

#[test]
fn what_follows_a_held_command_comes_up_to_it_exponentially() {
    let session = session(&[0.3]);
    let run = &session.runs[0];
    let (period_s, first, follows_s) = (0.137, 0.3, 0.05);
    let through = |follows_s: f64| {
        let mut path = run.input.clone();
        OF_EACH_RECORDING.input(&[period_s, first, follows_s, AGE.low], run, &mut path);
        path
    };
    let mut state = run.input[0];
    for (sample, value) in through(follows_s).iter().enumerate().skip(1) {
        for look in 0..1000 {
            let time_s = run.time_s[sample - 1] + (f64::from(look) + 0.5) * 1e-3 * run.period_s;
            let look_s = (((time_s / period_s - first).floor() + first) * period_s).max(0.0);
            let held = 0.5 - 0.5 * (TAU * 0.3 * look_s).cos();
            state += 1e-3 * run.period_s / follows_s * (held - state);
        }
        assert!((value - state).abs() < 1e-3, "sample {sample}: {value} instead of {state}");
    }
}

#[test]
fn period_and_first_look_are_found_in_what_a_smooth_model_misses() {
    for (period_s, first) in [(0.0712, 0.9), (0.21, 0.4), (0.43, 0.2)] {
        let input_hz = [0.2, 0.37, 0.61, 0.8, 0.2, 0.37];
        let session = session(&input_hz);
        // A delay of half a period is what a smooth model makes of it.
        let of = |(run, hz): (&Run, f64)| -> Vec<f64> {
            let u = |time_s: f64| 0.5 - 0.5 * (TAU * hz * time_s).cos();
            let look_s = |time_s: f64| (((time_s / period_s - first).floor() + first) * period_s).max(0.0);
            run.time_s.iter().map(|&time_s| u(look_s(time_s)) - u(time_s - 0.5 * period_s)).collect()
        };
        let residual: Vec<Vec<f64>> = session.runs.iter().zip(input_hz).map(of).collect();
        let starts = OF_EACH_RECORDING.starts(&session, &residual);
        let near = |start: &&Vec<f64>| (start[0] / period_s - 1.0).abs() < 1e-3 && (start[1] - first).abs() < 0.05;
        assert!(starts.iter().any(|start| near(&start)), "{period_s} s, {first}: {starts:?}");
    }
}

#[test]
fn a_long_recording_is_looked_at_in_stretches_and_tells_the_period_as_finely_as_it_is_long() {
    let (period_s, first, hz) = (0.1873, 0.4, 0.37);
    let mut session = session_of(11_000, &[hz]);
    let u = |time_s: f64| 0.5 - 0.5 * (TAU * hz * time_s).cos();
    let look_s = |time_s: f64| (((time_s / period_s - first).floor() + first) * period_s).max(0.0);
    let residual: Vec<f64> = session.runs[0].time_s.iter().map(|&time_s| u(look_s(time_s)) - u(time_s - 0.5 * period_s)).collect();
    for form in [&OF_EACH_RECORDING, &RUNNING_ON] {
        session.has_session_time = form.clock == Clock::RunsOn;
        let starts = form.starts(&session, std::slice::from_ref(&residual));
        // As near as a tenth of a period at either end, 220 s apart.
        let near = |start: &&Vec<f64>| {
            [0.0, 220.0].iter().all(|&at| {
                let early = (at / start[0] - start[1]) - (at / period_s - first);
                (early - early.round()).abs() < 0.1
            })
        };
        assert!(starts.iter().any(|start| near(&start)), "{starts:?}");
    }
}

#[test]
fn a_clock_that_nothing_ties_to_the_recordings_is_found_with_a_phase_in_each() {
    let (period_s, firsts) = (0.1873, [0.4, 0.1, 0.85, 0.62, 0.3, 0.97]);
    let mut session = session(&[0.2, 0.37, 0.61, 0.8, 0.2, 0.37]);
    for (run, first) in session.runs.iter_mut().zip(firsts) {
        let mut held = run.input.clone();
        hold(&mut held, period_s, first, FOLLOWS.low, run.period_s);
        run.output = held;
    }
    let residual: Vec<Vec<f64>> =
        session.runs.iter().map(|run| run.output.iter().zip(&run.input).map(|(output, input)| output - input).collect()).collect();
    for form in [&UNTIED, &OUTPUT_UNTIED] {
        let starts = form.starts(&session, &residual);
        assert!(starts.iter().any(|start| (start[0] / period_s - 1.0).abs() < 1e-3), "{starts:?}");
    }
    let parameters = [period_s, FOLLOWS.low, AGE.low];
    // What is kept out shows nothing.
    let shown: Vec<(&Run, f64)> = session.runs.iter().zip(firsts).filter(|(run, _)| run.keep[0]).collect();
    assert_eq!(shown.len(), 5);
    for (run, first) in shown {
        let found = UNTIED.first_look(&parameters, run, &run.input);
        assert!(((found - first + 0.5).rem_euclid(1.0) - 0.5).abs() < 0.05, "{found} for {first}");
    }
    // A clock that the session's time ties to them is no matter for each recording.
    session.has_session_time = true;
    assert!(UNTIED.starts(&session, &residual).is_empty());
    session.has_session_time = false;
    assert!(RUNNING_ON.starts(&session, &residual).is_empty());
}

#[test]
fn a_clock_that_runs_on_is_found_through_the_whole_session() {
    let (period_s, first) = (0.1873, 0.4);
    let input_hz = [0.2, 0.37, 0.61, 0.8, 0.2, 0.37];
    let mut session = session(&input_hz);
    session.has_session_time = true;
    for (index, run) in session.runs.iter_mut().enumerate() {
        let begun_s = 27.31 * index as f64;
        run.session_s = run.time_s.iter().map(|time_s| begun_s + time_s).collect();
        session.length_s = begun_s + run.time_s[run.time_s.len() - 1];
    }
    let of = |(run, hz): (&Run, f64)| -> Vec<f64> {
        let u = |time_s: f64| 0.5 - 0.5 * (TAU * hz * time_s).cos();
        let look_s = |time_s: f64| (((time_s + run.session_s[0]) / period_s - first).floor() + first) * period_s - run.session_s[0];
        run.time_s.iter().map(|&time_s| u(look_s(time_s).max(0.0)) - u(time_s - 0.5 * period_s)).collect()
    };
    let residual: Vec<Vec<f64>> = session.runs.iter().zip(input_hz).map(of).collect();
    let starts = RUNNING_ON.starts(&session, &residual);
    // As near as a tenth of a period at either end of the session.
    let near = |start: &&Vec<f64>| {
        [0.0, 150.0].iter().all(|&at| {
            let early = (at / start[0] - start[1]) - (at / period_s - first);
            (early - early.round()).abs() < 0.1
        })
    };
    assert!(starts.iter().any(|start| near(&start)), "{starts:?}");
}

#[test]
fn what_is_held_may_be_older_than_the_look() {
    let session = session(&[0.3]);
    let run = &session.runs[0];
    let through = |first: f64, age_s: f64| {
        let mut path = run.input.clone();
        OF_EACH_RECORDING.input(&[0.2, first, FOLLOWS.low, age_s], run, &mut path);
        path
    };
    let (fresh, old) = (through(0.0, AGE.low), through(0.0, 0.06));
    // Held for ten samples as before, and worth what the command was three samples earlier.
    for sample in 50..1000 {
        assert!((old[sample] - run.input[sample / 10 * 10 - 3]).abs() < 1e-4, "sample {sample}");
        assert!((fresh[sample] - run.input[sample / 10 * 10]).abs() < 1e-4, "sample {sample}");
    }
    // The middle of a whole period is as old as it gets: what is later than that has a dead time.
    assert!(through(0.0, 0.3) == through(0.0, 0.1) && through(0.0, 0.1) != old);
}
