//! `catheter tune` and `catheter track` as a lab uses them.

use std::fmt::Write;

use crate::support::Bench;

/// Recordings of a plain actuator: 3 mm/bar behind 40 ms of dead time and a lag of 100 ms, no hysteresis, 50 Hz.
pub fn recordings(bench: &Bench) {
    let mut level = 0.0;
    let pressures: Vec<f64> = (0..1500)
        .map(|sample| {
            let time = f64::from(sample) * 0.02;
            (1.3 - 1.2 * (2.0 * std::f64::consts::PI * (0.2 + 0.02 * time) * time).cos()).clamp(0.0, 2.6)
        })
        .collect();
    let mut text = "time_s,pressure_bar,displacement_mm\n".to_owned();
    let mut path = Vec::new();
    for tick in 0..30_000_usize {
        let late = tick.saturating_sub(40) / 20;
        level += (pressures[late] - level) * 0.01;
        path.push(level);
    }
    for (sample, pressure) in pressures.iter().enumerate() {
        let mean: f64 = path[sample * 20..(sample + 1) * 20].iter().sum::<f64>() / 20.0;
        writeln!(text, "{:.2},{pressure:.6},{:.6}", sample as f64 * 0.02, 2.0 + 3.0 * mean).expect("a line");
    }
    bench.write("recordings/run.csv", text);
}

#[test]
fn tune_finds_the_actuator_and_its_gains_keep_their_margins_and_track_takes_its_files() {
    let bench = Bench::new();
    recordings(&bench);
    bench.works("tune --data recordings --out tuned --controller pid --json tuned.json");
    let tuned = bench.json("tuned.json");
    let value = |name: &str| tuned["parameters"][name]["value"].as_f64().expect("a number");
    let lag_s = value("fill_time_constant_s") + value("second_time_constant_s");
    // The two lags and the dead time can stand in for one another a little; their sum is the delay of slow motion.
    assert!((value("dead_time_s") + lag_s - 0.14).abs() < 0.01, "{tuned}");
    assert!(tuned["rmse_mm"].as_f64().expect("a number") < 0.02, "{tuned}");
    let worst = &tuned["feedback_alone"]["worst_margins"];
    assert!(worst["gain"].as_f64().expect("a number") >= 2.0 && worst["phase_deg"].as_f64().expect("a number") >= 45.0, "{worst}");
    let settings = String::from_utf8(bench.read("tuned/settings.toml")).expect("text");
    assert!(settings.contains("\"control.law\" = \"tracking\"") && settings.contains("\"control.feed_forward\" = \"none\""), "{settings}");

    let said = bench.works(
        "track --settings tuned/settings.toml --model tuned/control.blob --reach-mm 3,8 --reference point-to-point --controllers open-loop,physics-inverse --json out.json --report out.html --csv runs",
    );
    assert!(said.stdout.contains("physics-inverse"), "{}", said.stdout);
    let tracked = bench.json("out.json");
    let controllers = tracked["controllers"].as_array().expect("an array");
    assert_eq!(controllers.len(), 2);
    for controller in controllers {
        for key in ["name", "rmse_mm", "max_mm", "settling_s", "overshoot_mm", "limited_share"] {
            assert!(controller.get(key).is_some(), "the key {key} is missing from {controller}");
        }
    }
    let page = String::from_utf8(bench.read("out.html")).expect("text");
    assert!(page.contains("open-loop") && page.contains("<svg"), "a table and plots");

    // A run is a recording, and its reference a reference.
    let run = host_tool::recording::load(&[bench.path("runs/physics-inverse.csv")], None).expect("a recording").remove(0);
    let names: Vec<&str> = run.extra.iter().map(|extra| extra.name.as_str()).collect();
    assert_eq!(names, ["reference_mm", "pressure_measured_bar", "estimate_mm", "limited"]);
    let error_mm = |index: usize| run.output[index] - run.extra[0].values[index];
    let after = run.time_s.iter().position(|time_s| *time_s >= 1.0).expect("a run of more than a second");
    let rmse_mm = ((after..run.len()).map(|index| error_mm(index).powi(2)).sum::<f64>() / (run.len() - after) as f64).sqrt();
    let told_mm = controllers[1]["rmse_mm"].as_f64().expect("a number");
    assert!((rmse_mm - told_mm).abs() < 1e-9, "{rmse_mm} mm in the file, {told_mm} mm told");
    bench.works(
        "track --settings tuned/settings.toml --model tuned/control.blob --reference runs/physics-inverse.csv --controllers open-loop --json again.json",
    );
    let again = bench.json("again.json");
    // The reference's points lie 20 ms apart in what was recorded each 10 ms: the same path, and the same error but for a tick's difference.
    let (first, second) = (&controllers[0]["rmse_mm"], &again["controllers"][0]["rmse_mm"]);
    let (first, second) = (first.as_f64().expect("a number"), second.as_f64().expect("a number"));
    assert!((first / second - 1.0).abs() < 0.02, "{first} and {second} mm");

    // A plant's name is one rig, whatever the option that names it was called.
    bench.write("short.csv", "time_s,reference_mm\n0,0.4\n2,1.2\n4,0.6\n");
    let on = |option: &str| {
        let run = bench.run(&format!(
            "track {option} --settings tuned/settings.toml --model tuned/control.blob --reference short.csv --controllers open-loop --json plant.json --force"
        ));
        assert!(matches!(run.code, 0 | 1), "{}", run.stderr);
        bench.json("plant.json")["controllers"].clone()
    };
    let of_the_plant = on("--plant all-effects");
    assert_eq!(of_the_plant, on("--preset all-effects"));
    assert_ne!(of_the_plant, on("--plant realistic"));
    assert_eq!(on(""), on("--plant realistic"), "the rig of the published figures");

    // An inverse that has hardly learned anything still runs, and has the physics to fall back to.
    bench.works("train --inverse --look-ahead-ms 100 --data recordings --preset stream-1x32 --epochs 2 --out inverse.safetensors");
    bench.works("export inverse.safetensors --calibration recordings --compensation tuned/control.blob --out inverse.blob");
    bench.refuses("export inverse.safetensors --calibration recordings --compensation nowhere.blob --out other.blob", &["nowhere.blob"]);
    let inspected = bench.works("inspect inverse.blob");
    assert!(inspected.stdout.contains("play operators; 95 %"), "{}", inspected.stdout);
    // A second of training makes no inverse that follows, and the command says so.
    let followed = bench.run(
        "track --settings tuned/settings.toml --model tuned/control.blob --inverse-model inverse.blob --look-ahead-ms 110 --reach-mm 3,8 --reference a --controllers physics-inverse,learned-inverse --json learned.json --journals journals",
    );
    assert!(matches!(followed.code, 0 | 1), "{}", followed.stderr);
    assert_eq!(followed.code == 1, followed.stdout.contains("FAILED: learned-inverse"), "{}", followed.stdout);
    let replayed = bench.works("replay journals/learned-inverse.journal --at 12");
    for wanted in ["identical to the bit", "point 5", "of the playback", "to bring the tip there"] {
        assert!(replayed.stdout.contains(wanted), "{wanted} in {}", replayed.stdout);
    }
    let tracked = bench.json("learned.json");
    assert_eq!(tracked["controllers"][1]["name"], "learned-inverse");
    let errors: Vec<f64> = (0..2).map(|index| tracked["controllers"][index]["rmse_mm"].as_f64().expect("a number")).collect();
    assert!(errors[1].is_finite() && errors[0] != errors[1], "the inverse model is in charge: {errors:?}");
}

#[test]
fn tuning_tells_which_parameters_the_recordings_do_not_tell_and_tracking_what_it_cannot_follow() {
    let bench = Bench::new();
    recordings(&bench);
    let said = bench.works("tune --data recordings --out tuned --controller pid --json tuned.json --html tuned.html");
    let warnings = bench.json("tuned.json")["warnings"].clone();
    let warnings = warnings.as_array().expect("an array");
    // The actuator has no hysteresis and no creep: their parameters lie within their intervals of zero.
    assert!(
        !warnings.is_empty() && warnings.iter().all(|text| text.as_str().is_some_and(|text| text.contains("do not tell it"))),
        "{warnings:?}"
    );
    assert_eq!(said.stdout.matches("warning: ").count(), warnings.len(), "{}", said.stdout);
    let page = String::from_utf8(bench.read("tuned.html")).expect("text");
    assert!(page.contains("<strong>Warning:</strong>") && page.contains("<svg"));
    // A reference far outside of what the rig can do: the command says so and its exit code is 1.
    let mut path = "time_s,reference_mm\n".to_owned();
    (0..300)
        .for_each(|point| path.push_str(&format!("{:.2},{}\n", f64::from(point) * 0.02, 60.0 + 20.0 * (f64::from(point) * 0.05).sin())));
    bench.write("far.csv", path);
    let missed = bench.run(
        "track --settings tuned/settings.toml --model tuned/control.blob --reference far.csv --controllers open-loop --json far.json --html far.html",
    );
    assert_eq!(missed.code, 1, "{}\n{}", missed.stdout, missed.stderr);
    assert!(missed.stdout.contains("FAILED: open-loop") && missed.stdout.contains("warning: "), "{}", missed.stdout);
    assert_eq!(bench.json("far.json")["missed"].as_array().map(Vec::len), Some(1));
}

#[test]
fn what_cannot_be_tracked_or_tuned_is_refused_by_name() {
    let bench = Bench::new();
    bench.refuses("track --reference a --controllers nonsense", &["nonsense"]);
    bench.refuses("track --reference a --controllers open-loop --settings s.toml --model m.blob", &["s.toml"]);
    // Before any tuning, which takes a while.
    bench.refuses("track --reference point-2-point --controllers open-loop", &["point-2-point", "point-to-point", "neither a file"]);
    bench.refuses("track --reference a --controllers learned-inverse", &["inverse model"]);
    bench.refuses("track --plant nowhere.toml --reference a --controllers open-loop", &["nowhere.toml", "all-effects", "realistic"]);
    bench.refuses("track --backend serial --reference a --controllers open-loop", &["--settings"]);
    bench.refuses("track --port nowhere --reference a --controllers open-loop", &["serial:PORT"]);
    bench.write("still/run.csv", "time_s,pressure_bar,displacement_mm\n0,1,2\n0.02,1,2\n0.04,1,2\n");
    bench.refuses("tune --data still --out tuned", &["never moves"]);
}
