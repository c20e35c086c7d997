//! `catheter rig arm|disarm|start|stop|hold|move|jog|monitor` and settings files, on the rig in this process.

use crate::support::{Bench, Said};

fn number(text: &str, name: &str) -> f64 {
    let rest = text.split(name).nth(1).unwrap_or_else(|| panic!("`{name}` is missing from {text}"));
    rest.split_whitespace().next().and_then(|word| word.parse().ok()).unwrap_or_else(|| panic!("no number behind `{name}` in {text}"))
}

/// Runs with lines on standard input.
fn with_input(bench: &Bench, line: &str, input: &str) -> Said {
    let output = assert_cmd::Command::new(env!("CARGO_BIN_EXE_catheter"))
        .args(line.split_whitespace())
        .current_dir(bench.path(""))
        .write_stdin(input)
        .timeout(std::time::Duration::from_secs(120))
        .output()
        .expect("the built command starts");
    Said {
        code: output.status.code().unwrap_or(-1),
        stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
        stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        line: line.to_owned(),
    }
}

#[test]
fn status_tells_what_the_sensors_read() {
    let bench = Bench::new();
    let said = bench.works("rig status --json status.json").stdout;
    for word in ["pressure ", "laser ", "estimate ", "set-point ", "board ", "PB1 0.00 V", "code "] {
        assert!(said.contains(word), "`{word}` is missing from\n{said}");
    }
    let status = bench.json("status.json");
    let reading = &status["reading"];
    assert!(reading["pressure_bar"].as_f64().expect("a pressure").abs() < 0.01, "{reading}");
    assert!(reading["displacement_mm"].as_f64().expect("a displacement").abs() < 0.05, "{reading}");
    // 4 mA through 150 ohm, and two codes of noise.
    for code in ["pressure_code", "laser_code"] {
        assert!((reading[code].as_f64().expect("a code") - 1489.0).abs() <= 10.0, "{reading}");
    }
    assert!(reading["estimate_mm"].is_null() && reading["supply_v"].is_null(), "{reading}");
    assert_eq!(status["set_point_unit"], "bar");
}

#[test]
fn arming_is_refused_with_every_blocker_and_expires_by_itself() {
    let bench = Bench::new();
    assert!(bench.works("rig arm").stdout.contains("Armed"));
    let refused = bench.refuses("rig arm --inject emergency-stop,laser-unplugged", &["emergency-stop-pressed", "laser-not-plausible"]);
    assert!(!refused.stderr.contains("pressure-not-plausible"), "{}", refused.stderr);
    let said = bench.works("rig arm --seconds 61 --json armed.json").stdout;
    assert!(said.contains("Disarmed itself after 60 s"), "{said}");
    assert_eq!(bench.json("armed.json")["state"], "idle");
    let said = bench.run("rig arm --seconds 1 --inject emergency-stop@0.8 --json stopped.json");
    assert_eq!(said.code, 1, "{}{}", said.stdout, said.stderr);
    assert!(said.stdout.contains("emergency-stop"), "{}", said.stdout);
    assert_eq!(bench.json("stopped.json")["state"], "fault");
}

#[test]
fn a_pressure_is_held_and_vented_at_the_end() {
    let bench = Bench::new();
    let said = bench.works("rig hold --arm --pressure-bar 0.5 --seconds 1.5 --json hold.json").stdout;
    assert!(said.contains("Vented"), "{said}");
    let hold = bench.json("hold.json");
    assert_eq!((hold["ended"].as_str(), hold["vented"].as_bool()), (Some("done"), Some(true)));
    let reading = &hold["reading"];
    // The sensor's noise is two codes, 0.004 bar.
    assert!((reading["pressure_bar"].as_f64().expect("a pressure") - 0.5).abs() < 0.01, "{reading}");
    assert!((reading["output_bar"].as_f64().expect("an output") - 0.5).abs() < 1e-6, "{reading}");
    // A valve with 5 bar at full scale is driven by 0.33 V for half a bar.
    assert!((reading["pins"]["valve_v"].as_f64().expect("a voltage") - 0.33).abs() < 0.001, "{reading}");
    bench.refuses("rig hold --pressure-bar 0.5", &["`idle`", "--arm"]);
    bench.refuses("rig hold --arm --pressure-bar 3.5", &["0 to 3 bar", "limits.ceiling_bar"]);
    bench.refuses("rig hold --arm --pressure-bar 0.5 --seconds 0", &["--seconds"]);
}

#[test]
fn a_fault_and_a_cut_line_end_a_hold_with_exit_code_1_and_the_reason() {
    let bench = Bench::new();
    for (injected, fault) in [
        ("emergency-stop@0.8", "emergency-stop"),
        ("line-cut@0.9..1.4", "host-lost"),
        ("supply-fails@0.8", "pressure-mismatch"),
        ("laser-unplugged@0.8", "laser"),
    ] {
        let said = bench.run(&format!("rig hold --arm --pressure-bar 0.8 --seconds 3 --inject {injected} --json ended.json"));
        assert_eq!(said.code, 1, "{injected}: {}{}", said.stdout, said.stderr);
        let ended = bench.json("ended.json");
        assert_eq!((ended["ended"].as_str(), ended["vented"].as_bool()), (Some("fault"), Some(true)), "{injected}: {ended}");
        let first = ended["fault"]["first"].as_str().expect("a fault");
        assert!(first.contains(fault), "{injected} struck as {first}");
    }
    bench.refuses("rig status --inject nonsense", &["emergency-stop", "line-cut"]);
    bench.refuses("rig status --inject help", &["laser-unplugged", "dump-valve-closed"]);
    bench.refuses("rig --backend serial:nowhere status --inject emergency-stop", &["--inject", "simulated"]);
}

#[test]
fn starting_wants_a_law_for_set_points_and_stopping_a_rig_that_runs() {
    let bench = Bench::new();
    bench.refuses("rig start --arm", &["playback", "rig ... record"]);
    bench.works("rig --flash rig.flash settings set control.law=pressure --save");
    let said = bench.works("rig --flash rig.flash start --arm --seconds 0.5 --json start.json").stdout;
    assert!(said.contains("running"), "{said}");
    assert!(bench.json("start.json")["reading"]["output_bar"].as_f64().expect("an output").abs() < 1e-6);
    bench.refuses("rig stop", &["wrong-state"]);
    assert!(bench.works("rig disarm").stdout.contains("`idle`"));
}

#[test]
fn the_tip_moves_to_a_displacement_by_the_controller_of_the_settings() {
    let bench = Bench::new();
    // A linear map that is right on average, and the laser's feedback for the rest.
    bench.works(
        "rig --flash rig.flash settings set control.feed_forward=linear-map control.linear_mm_per_bar=1 control.sensor=laser \
         pid.integral_per_s=2 --save",
    );
    bench.works("rig --flash rig.flash move --arm --displacement-mm 1.2 --speed-mm-per-s 1 --seconds 6 --json move.json");
    let moved = bench.json("move.json");
    let tip_mm = moved["reading"]["displacement_mm"].as_f64().expect("a displacement");
    assert!((tip_mm - 1.2).abs() < 0.05, "{moved}");
    assert_eq!(moved["vented"], true);
    // Nothing was saved, and nothing stays changed.
    assert!(bench.works("rig --flash rig.flash settings get control.law").stdout.contains("playback"));
    bench.refuses("rig move --arm --displacement-mm 1 --inject laser-unplugged", &["laser"]);
}

#[test]
fn jogging_takes_steps_from_a_script_and_never_more_than_the_ceiling() {
    let bench = Bench::new();
    let said = with_input(&bench, "rig jog --arm --step-bar 0.1 --json jog.json", "+\n+\n0.5\nwait 1\n-\n");
    assert_eq!(said.code, 0, "{}{}", said.stdout, said.stderr);
    let set_points: Vec<f64> =
        said.stdout.lines().filter(|line| line.starts_with("set-point")).map(|line| number(line, "set-point")).collect();
    assert_eq!(set_points, [0.1, 0.2, 0.5, 0.4]);
    let jog = bench.json("jog.json");
    assert!((jog["reading"]["pressure_bar"].as_f64().expect("a pressure") - 0.4).abs() < 0.02, "{jog}");
    assert_eq!(jog["vented"], true);
    let said = with_input(&bench, "rig jog --arm", "0.5\n9\n");
    assert_eq!(said.code, 2, "{}{}", said.stdout, said.stderr);
    assert!(said.stderr.contains("0 to 3 bar"), "{}", said.stderr);
    assert!(said.stdout.contains("Vented"), "a wrong line vents: {}", said.stdout);
}

#[test]
fn a_monitor_writes_every_sample_at_the_rate_that_was_asked_for() {
    let bench = Bench::new();
    let said = bench.works("rig monitor --seconds 2 --rate-hz 100 --csv watched.csv --json watched.json");
    assert!(said.stdout.contains("pressure"), "{}", said.stdout);
    let text = String::from_utf8(bench.read("watched.csv")).expect("a CSV is text");
    assert!(text.starts_with("time_s,pressure_bar,displacement_mm,sequence,"), "{text}");
    let rows = text.lines().count() - 1;
    assert!((195..=201).contains(&rows), "{rows} rows of 200");
    assert_eq!(bench.json("watched.json")["samples"].as_u64(), Some(rows as u64));
    assert_eq!(bench.json("watched.json")["account"]["lost_on_the_line"], 0);
    // Without a model there is no column of estimates.
    assert!(!text.contains("estimate_mm"), "{text}");
    // What is not plausible is an empty cell, not a number.
    bench.works("rig monitor --seconds 0.5 --csv blind.csv --inject laser-unplugged");
    let text = String::from_utf8(bench.read("blind.csv")).expect("a CSV is text");
    let last = text.lines().last().expect("a row");
    assert_eq!(last.split(',').nth(2), Some(""), "{last}");
}

#[test]
fn settings_go_to_a_file_and_back_by_names_or_not_at_all() {
    let bench = Bench::new();
    bench.works("rig --flash rig.flash settings set limits.ceiling_bar=2 control.feed_forward=physics-inverse control.law=tracking --save");
    let said = bench.works("rig --flash rig.flash settings get control.feed_forward control.law").stdout;
    assert!(said.contains("physics-inverse") && said.contains("tracking"), "{said}");
    bench.works("rig --flash rig.flash settings export rig.toml");
    let text = String::from_utf8(bench.read("rig.toml")).expect("text");
    assert!(text.contains("\"control.feed_forward\" = \"physics-inverse\"") && text.contains("\"limits.ceiling_bar\" = 2.0"), "{text}");

    // Another device; two settings that contradict the others until both are in.
    let moved = text.replace("\"laser.low_v\" = 0.6", "\"laser.low_v\" = 3.2").replace("\"laser.high_v\" = 3.0", "\"laser.high_v\" = 3.3");
    assert_ne!(moved, text);
    let moved = moved.replace("\"laser.fault_above_v\" = 3.12", "\"laser.fault_above_v\" = 3.3");
    bench.write("moved.toml", moved);
    let said = bench.works("rig --flash other.flash settings import moved.toml --save").stdout;
    assert!(said.contains("laser.low_v = 3.2 V, was 0.6"), "{said}");
    bench.works("rig --flash other.flash settings get --json other.json");
    let other = bench.json("other.json");
    assert_eq!((other["limits.ceiling_bar"].as_f64(), other["control.law"].as_u64()), (Some(2.0), Some(2)));

    // One that the device refuses leaves all of them as they were.
    bench.write("wrong.toml", "\"limits.ceiling_bar\" = 1.5\n\"laser.high_v\" = 0.1\n");
    let said = bench.run("rig --flash third.flash settings import wrong.toml --save");
    assert_eq!(said.code, 2, "{}", said.stdout);
    assert!(said.stderr.contains("nothing was changed") && said.stderr.contains("laser"), "{}", said.stderr);
    bench.write("unknown.toml", "\"limits.roof\" = 1\n");
    bench.refuses("rig settings import unknown.toml", &["unknown.toml", "limits.roof", "limits.ceiling_bar"]);
    bench.write("text.toml", "\"control.law\" = \"fast\"\n");
    bench.refuses("rig settings import text.toml", &["control.law", "playback, pressure, tracking"]);
    bench.refuses("rig settings set control.law=fast", &["playback, pressure, tracking"]);
}

#[test]
fn models_are_listed() {
    let bench = Bench::with_models();
    assert!(bench.works("rig model list").stdout.contains("none"));
    bench.works("rig --flash rig.flash model upload model.blob --activate --json upload.json");
    bench.works("rig --flash rig.flash model list --json list.json");
    assert_eq!(bench.json("list.json")["active"], bench.json("upload.json")["model_id"]);
    assert!(bench.json("list.json")["other"].is_null());
}
