//! `catheter fit`: the ladder, what it leaves behind, and what it refuses.

use std::fmt::Write;

use crate::support::{Bench, recording_csv};

/// A play operator behind a lag, moved by sines of these frequencies and amplitudes; a little noise that does not repeat.
fn rig(frequency_hz: f64, amplitude: f64, offset: f64) -> String {
    let mut text = "time_s,pressure_bar,displacement_mm\n".to_owned();
    let (mut lagged, mut play) = (0.0, 0.0_f64);
    for row in 0..900 {
        let time = f64::from(row) * 0.02;
        let pressure = amplitude * (1.0 - (std::f64::consts::TAU * frequency_hz * time).cos()) * (-0.05 * time).exp();
        lagged += 0.2 * (pressure - lagged);
        play = play.max(lagged - 0.15).min(lagged + 0.15);
        let noise = 0.002 * (1e4 * (f64::from(row) * 1.7 + frequency_hz).sin()).fract();
        writeln!(text, "{time},{pressure},{}", 0.6 * play + 0.3 * lagged + offset + noise).expect("a String takes any text");
    }
    text
}

fn recordings(bench: &Bench, folder: &str) {
    for (index, (frequency_hz, amplitude)) in [(0.3, 1.0), (0.5, 0.8), (0.7, 0.6), (0.4, 0.9), (0.6, 0.5)].into_iter().enumerate() {
        bench.write(&format!("{folder}/run{index}_f{frequency_hz}.csv"), rig(frequency_hz, amplitude, 0.0));
    }
}

#[test]
fn one_command_leaves_a_model_that_keeps_its_promise_on_the_next_recording() {
    let bench = Bench::new();
    recordings(&bench, "data");
    bench.write("next/next.csv", rig(0.45, 0.7, 0.0));
    let said = bench.works("fit --data data --out result --no-networks --json fit.json").stdout;
    assert!(said.contains("<- chosen") && said.contains("expect"), "{said}");
    let fit = bench.json("fit.json");
    let chosen = fit["chosen"].as_str().expect("a name");
    let ladder = fit["ladder"].as_array().expect("a list");
    let rung = ladder.iter().find(|rung| rung["name"] == chosen).expect("the chosen rung is on the ladder");
    for key in ["cv_rmse", "parameters", "step_instructions"] {
        assert!(rung[key].as_f64().is_some_and(|value| value > 0.0), "{key}: {rung}");
    }
    let interval = rung["cv_interval"].as_array().expect("two numbers");
    let (low, high) = (interval[0].as_f64().expect("a number"), interval[1].as_f64().expect("a number"));
    assert_eq!((fit["splits"]["kind"].as_str(), fit["splits"]["folds"].as_u64()), (Some("recordings"), Some(5)), "{}", fit["splits"]);
    assert!(fit["noise"].as_f64().is_some_and(|noise| noise < 0.01) && fit.get("repeatability").is_some());
    bench.works("evaluate --model result/model --data next --json next.json");
    let next = bench.json("next.json");
    let rmse = next["mean_rmse"].as_f64().expect("a number");
    assert!(low <= rmse && rmse <= high, "{rmse} outside {low} .. {high}");
    // Static curves are wrong by the loop's width; the sums are not.
    let curve = ladder.iter().find(|rung| rung["name"] == "curve").expect("the first rung")["cv_rmse"].as_f64().expect("a number");
    assert!(rmse < 0.1 * curve, "{rmse} {curve}");
    // Every rung can be judged, and the blob is one that the chip's code runs.
    for rung in std::fs::read_dir(bench.path("result/rungs")).expect("a folder") {
        let path = rung.expect("an entry").path();
        bench.works(&format!("evaluate --model {} --data next", path.display()));
    }
    bench.works("inspect result/model.blob");
    bench.works("evaluate --model result/model.blob --data next");
    let page = String::from_utf8(bench.read("result/report.html")).expect("HTML is text");
    assert!(page.starts_with("<!DOCTYPE html>") && page.contains("The ladder") && !page.contains("NaN"));
}

#[test]
fn equal_seeds_give_equal_models_whatever_the_number_of_threads() {
    let bench = Bench::new();
    recordings(&bench, "data");
    bench.works("fit --data data --out one --no-networks --threads 1");
    bench.works("fit --data data --out two --no-networks --threads 2");
    assert_eq!(bench.read("one/model"), bench.read("two/model"));
    assert_eq!(bench.read("one/model.blob"), bench.read("two/model.blob"));
}

#[test]
fn a_copy_of_a_recording_does_not_make_the_promise_better() {
    let bench = Bench::new();
    recordings(&bench, "data");
    recordings(&bench, "twice/a");
    recordings(&bench, "twice/b");
    bench.works("fit --data data --out one --no-networks --json one.json");
    let said = bench.works("fit --data twice --out two --no-networks --json two.json").stdout;
    assert!(said.contains("is a copy of"), "{said}");
    let error = |name: &str| {
        let fit = bench.json(name);
        let chosen = fit["chosen"].clone();
        fit["ladder"].as_array().expect("a list").iter().find(|rung| rung["name"] == chosen).expect("a rung")["cv_rmse"].clone()
    };
    assert_eq!(error("one.json"), error("two.json"));
}

#[test]
fn one_recording_is_cut_into_blocks_and_the_report_says_so() {
    let bench = Bench::new();
    bench.write("data/only.csv", rig(0.4, 0.8, 0.0));
    let said = bench.works("fit --data data --out result --json fit.json").stdout;
    assert!(said.contains("6 blocks of 1 recording(s)") && said.contains("no network was trained"), "{said}");
    let fit = bench.json("fit.json");
    assert_eq!((fit["splits"]["kind"].as_str(), fit["splits"]["evidence"].as_str()), (Some("blocks"), Some("little")));
    let page = String::from_utf8(bench.read("result/report.html")).expect("HTML is text");
    assert!(page.contains("blocks of 1 recording(s)"));
}

#[test]
fn a_stated_calibration_sets_the_zero_of_a_new_session_and_is_not_scored() {
    let bench = Bench::new();
    recordings(&bench, "data");
    bench.write("moved/next.csv", rig(0.45, 0.7, 0.25));
    bench.works("fit --data data --out result --no-networks");
    let said = bench.works("evaluate --model result/model --data moved --calibrate-s 3 --json moved.json").stdout;
    assert!(said.contains("with the zero set over the first 3 s"), "{said}");
    let moved = bench.json("moved.json");
    let (as_is, calibrated) =
        (moved["mean_rmse"].as_f64().expect("a number"), moved["calibrated"]["mean_rmse"].as_f64().expect("a number"));
    assert!((as_is - 0.25).abs() < 0.02 && calibrated < 0.02, "{as_is} {calibrated}");
    assert_eq!(moved["files"][0]["n"], moved["calibrated"]["files"][0]["n"], "both are judged on the same samples");
    assert_eq!(moved["files"][0]["n"], 750);
}

#[test]
fn what_cannot_be_fitted_is_refused_before_anything_is_written() {
    let bench = Bench::new();
    let still = "time_s,pressure_bar,displacement_mm\n".to_owned()
        + &(0..200).map(|k| format!("{},1,{}\n", f64::from(k) * 0.02, k % 7)).collect::<String>();
    bench.write("still/a.csv", still);
    bench.refuses("fit --data still --out result", &["never changes"]);
    bench.write("short/a.csv", recording_csv(0.3).lines().take(30).collect::<Vec<_>>().join("\n"));
    bench.refuses("fit --data short --out result", &["at least 60"]);
    bench.refuses("fit --data nowhere --out result", &["nowhere"]);
    assert!(!bench.path("result").exists(), "nothing is written");
    bench.write("model", "kind = \"fitted\"\nformat_version = 9\n");
    bench.refuses("evaluate --model model --data short", &["model"]);
}

#[test]
fn nothing_of_an_earlier_fit_stays_and_nothing_that_is_read_is_replaced() {
    let bench = Bench::new();
    recordings(&bench, "data");
    bench.write("result/rungs/hybrid", "of an earlier fit");
    bench.write("result/rungs/mine.txt", "not of a fit");
    bench.works("fit --data data --out result --no-networks");
    assert!(!bench.path("result/rungs/hybrid").exists() && bench.path("result/rungs/mine.txt").exists());
    bench.refuses("fit --data data --out result --no-networks --json result/model", &["--json", "choose another"]);
    bench.write("own/rungs/pi", rig(0.3, 1.0, 0.0));
    bench.refuses("fit --data own/rungs/pi --out own --no-networks", &["own/rungs/pi", "overwritten"]);
}

#[test]
fn outputs_that_no_sensor_gives_are_refused_by_line() {
    let bench = Bench::new();
    for (index, frequency_hz) in [0.3, 0.5, 0.7].into_iter().enumerate() {
        let mut lines = rig(frequency_hz, 0.8, 0.0).lines().map(str::to_owned).collect::<Vec<_>>();
        for line in &mut lines[1..] {
            line.push_str("e40");
        }
        bench.write(&format!("data/run{index}.csv"), lines.join("\n"));
    }
    bench.refuses("fit --data data --out result --no-networks", &["run0.csv:2", "displacement_mm", "no sensor gives"]);
    assert!(!bench.path("result").exists());
}
