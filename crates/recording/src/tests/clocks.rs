//! Clocks as loggers leave them: glitches, repeated stamps, swapped rows, events, lost samples; and even clocks made of them.

use proptest::prelude::*;

use super::*;
use crate::resample::{common_period_s, uniform};

/// A file of our own with these stamps; the input is a triangle of 4 s, the output the row's number.
fn file(stamps_s: &[f64]) -> String {
    let mut text = HEADER.to_owned();
    for (row, stamp_s) in stamps_s.iter().enumerate() {
        let phase = (row as f64 * 0.02 / 4.0).fract();
        text += &format!("{stamp_s},{},{row}\n", (2.0 * phase - 1.0).abs());
    }
    text
}

/// Stamps of an even 50 Hz clock.
fn even(rows: usize) -> Vec<f64> {
    (0..rows).map(|row| row as f64 / 50.0).collect()
}

fn same(one: &[f64], other: &[f64]) -> bool {
    one.len() == other.len() && one.iter().zip(other).all(|(one, other)| (one - other).abs() < 1e-9)
}

proptest! {
    #[test]
    fn a_glitch_of_a_stamp_is_repaired_exactly(row in 1_usize..198, offset_s in prop_oneof![Just(1.0), Just(-1.0), -3.0..-0.5, 0.5..3.0]) {
        let mut stamps_s = even(200);
        stamps_s[row] += offset_s;
        let recording = own(&file(&stamps_s)).expect("repaired");
        prop_assert!(same(&recording.time_s, &even(200)), "row {row} by {offset_s}");
        prop_assert_eq!(&recording.output, &(0..200).map(f64::from).collect::<Vec<_>>());
        prop_assert!(recording.gaps.is_empty());
    }

    #[test]
    fn an_even_recording_on_its_own_period_is_the_same_recording(rows in 10_usize..300, period_s in 0.001..2.0_f64) {
        let mut text = HEADER.to_owned();
        for row in 0..rows {
            text += &format!("{},{},{}\n", row as f64 * period_s, (row as f64 * 0.3).sin(), row % 7);
        }
        let recording = own(&text).expect("read");
        let again = uniform(&recording, recording.sample_period_s);
        prop_assert_eq!(&again, &recording);
        prop_assert!((common_period_s(std::slice::from_ref(&recording)) - period_s).abs() < 1e-8 * period_s);
    }
}

#[test]
fn repairs_are_counted_with_the_first_line() {
    let mut stamps_s = even(300);
    stamps_s[50] = stamps_s[49];
    stamps_s[120] += 1.0;
    stamps_s[180] -= 1.0;
    stamps_s.swap(200, 201);
    let recording = own(&file(&stamps_s)).expect("repaired");
    assert!(same(&recording.time_s, &even(300)));
    // The rows of swapped stamps are put in the order of their times.
    assert_eq!(recording.output[199..203], [199.0, 201.0, 200.0, 202.0]);
    let said: Vec<(usize, Option<u64>)> =
        recording.notes.iter().filter(|note| note.subject == Subject::ClockRepaired).map(|note| (note.count, note.line)).collect();
    // One of the two swapped rows moves.
    assert_eq!(said[..2], [(1, Some(52)), (2, Some(122))]);
    assert!(said.len() == 3 && said[2].0 == 1 && (202..=203).contains(&said[2].1.expect("a line")), "{said:?}");
}

#[test]
fn stamps_of_a_coarse_clock_share_their_time() {
    // 100 Hz with stamps in tenths of a second.
    let stamps_s: Vec<f64> = (0..200).map(|row| f64::from(row / 10) / 10.0).collect();
    let recording = own(&file(&stamps_s)).expect("repaired");
    let even: Vec<f64> = (0..200).map(|row| f64::from(row) / 100.0).collect();
    assert!(same(&recording.time_s, &even), "{:?}", &recording.time_s[..12]);
    assert!(recording.gaps.is_empty() && recording.notes[0].count == 180);
}

#[test]
fn a_row_that_stands_twice_stands_once() {
    let mut text = file(&even(100));
    let line = text.lines().nth(40).expect("a row").to_owned();
    text = text.replacen(&line, &format!("{line}\n{line}"), 1);
    let recording = own(&text).expect("repaired");
    assert!(same(&recording.time_s, &even(100)), "{} rows", recording.len());
}

#[test]
fn a_clock_that_runs_backwards_for_good_stays_an_error() {
    let mut joined = even(100);
    joined.extend(even(80));
    let error = own(&file(&joined)).expect_err("two files").to_string();
    assert!(error.starts_with("run.csv:102:") && error.contains("recording="), "{error}");
    let mut stuck = even(100);
    stuck.extend([1.98; 60]);
    assert!(own(&file(&stuck)).expect_err("a clock that stopped").to_string().starts_with("run.csv:102:"));
}

#[test]
fn a_long_hole_in_a_short_recording_is_a_gap_whatever_stands_around_it() {
    let text = format!("{HEADER}0,0,0\n0.02,2,0\n0.04,1.5,0\n100.06,1.5,0\n100.08,1,0\n");
    assert_eq!(own(&text).expect("read").gaps, [3]);
}

/// A logger that writes at most every 50 ms while something moves and rests for seconds while nothing does.
fn events() -> String {
    let mut text = HEADER.to_owned();
    let mut time_s = 0.0;
    for stroke in 0..30_u32 {
        for row in 0..60_u32 {
            let value = if stroke % 2 == 0 { f64::from(row) / 60.0 } else { 1.0 - f64::from(row) / 60.0 };
            text += &format!("{time_s},{value},{}\n", value * value);
            time_s += 0.05 + 0.03 * f64::from((row * 7 + stroke) % 5);
        }
        time_s += 2.0 + f64::from(stroke * 13 % 9);
    }
    text
}

#[test]
fn a_clock_of_events_is_not_cut() {
    let recording = own(&events()).expect("read");
    let timing = recording.timing();
    assert!(timing.longest_step_s > 20.0 * timing.median_step_s, "{timing:?}");
    assert!(recording.gaps.is_empty(), "{} gaps", recording.gaps.len());
    assert!(recording.notes.iter().any(|note| note.subject == Subject::EventClock), "{:?}", recording.notes);
    let even = uniform(&recording, common_period_s(std::slice::from_ref(&recording)));
    assert!(even.len() > recording.len() && even.time_s.windows(2).all(|pair| (pair[1] - pair[0] - even.sample_period_s).abs() < 1e-9));
    assert!(even.notes.iter().any(|note| note.subject == Subject::Resampled && note.text.contains("straight lines")));
}

#[test]
fn stretches_between_gaps_stay_apart_and_staircases_stay_stairs() {
    let mut text = HEADER.to_owned();
    for row in (0..1000_u32).filter(|row| !(400..500).contains(row)) {
        let time_s = f64::from(row) * 0.01 + if row % 2 == 0 { 0.0 } else { 0.002 };
        // A command that is refreshed every 0.1 s.
        let step = f64::from(row / 10 * 37 % 11);
        text += &format!("{time_s},{step},{}\n", (time_s * 3.0).sin());
    }
    let recording = own(&text).expect("read");
    assert_eq!(recording.gaps, [400]);
    let hold = held::hold(&recording.time_s, &recording.input).expect("a staircase");
    assert!((hold.period_s.expect("a fixed period") - 0.1).abs() < 0.002, "{hold:?}");
    let even = uniform(&recording, 0.01);
    assert_eq!(even.segments().len(), 2);
    assert!(even.time_s[even.gaps[0]] - even.time_s[even.gaps[0] - 1] > 0.9);
    assert!(even.input.iter().all(|value| value.fract() == 0.0), "levels between the stairs");
    let worst = even.time_s.iter().zip(&even.output).map(|(time_s, output)| ((time_s * 3.0).sin() - output).abs()).fold(0.0, f64::max);
    assert!(worst < 2e-4, "{worst}");
}
