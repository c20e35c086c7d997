//! `catheter rig`, `replay` and `explain` on the rig in this process; the emulator has its tests in `rig-tests`.

use host_tool::replay_log::{Event, ReplayLog};
use model_export::link::fault::Fault;

use crate::support::Bench;

const EXCITATION: &str = "\
sample_period_s = 0.02
[[segments]]
duration_s = 2.0
signal = { kind = \"descending-sine\", amplitude_bar = 1.2, frequency_hz = 0.8, decay_per_s = 0.05 }
";

fn recorded() -> Bench {
    let bench = Bench::new();
    bench.write("sine.toml", EXCITATION);
    bench.works("rig record --excitation sine.toml --out run.csv --json run.json");
    bench
}

#[test]
fn the_device_says_who_it_is_and_how_it_is() {
    let bench = Bench::new();
    bench.works("rig hello --json hello.json");
    let hello = bench.json("hello.json");
    assert_eq!((hello["board"].as_str(), hello["understood"].as_bool()), (Some("virtual"), Some(true)));
    assert_eq!(hello["reset_cause"], "power-on");
    assert!(hello["model_id"].is_null());
    bench.works("rig --json status.json status");
    let status = bench.json("status.json");
    assert_eq!(status["state"], "idle");
    assert_eq!(status["blockers"].as_array().map(Vec::len), Some(0));
    assert!(bench.works("rig explain").stdout.contains("Nothing") || bench.works("rig explain").stdout.contains("N010"));
    assert!(bench.works("rig vent").stdout.contains("below 0.1 bar"));
}

#[test]
fn settings_are_changed_saved_compared_and_refused_by_name_and_bounds() {
    let bench = Bench::new();
    bench.works("rig --flash rig.flash settings set limits.ceiling_bar=2.5 laser.required=false --save");
    bench.works("rig --flash rig.flash settings set limits.host_timeout_ms=100");
    bench.works("rig --flash rig.flash settings get --json all.json");
    let all = bench.json("all.json");
    assert_eq!(all["limits.ceiling_bar"], 2.5);
    assert_eq!(all["laser.required"], false);
    assert_eq!(all["limits.host_timeout_ms"], 250, "what is not saved ends with the device");
    // Every setting, and where the file came from.
    assert_eq!(all.as_object().map(serde_json::Map::len), Some(model_export::link::settings::INFO.len() + 1));
    assert!(all["provenance"].is_object() || all["provenance"].is_string(), "{all}");
    bench.works("rig --flash rig.flash settings diff --defaults --json difference.json");
    let difference = bench.json("difference.json");
    let names: Vec<&str> = difference.as_array().into_iter().flatten().filter_map(|entry| entry["name"].as_str()).collect();
    assert_eq!(names, ["limits.ceiling_bar", "laser.required"]);
    assert!(bench.works("rig --flash rig.flash settings diff").stdout.contains("No setting differs"));

    bench.refuses("rig settings set limits.ceiling_bar=25", &["limits.ceiling_bar", "0 to 4 bar"]);
    bench.refuses("rig settings set limits.ceiling_bar=high", &["0 to 4 bar"]);
    bench.refuses("rig settings set limits.ceiling=2", &["no setting", "limits.ceiling_bar"]);
    bench.refuses("rig settings set limits.ceiling_bar", &["NAME=VALUE"]);
    bench.refuses("rig settings set laser.high_v=0.1", &["contradict", "laser"]);
    bench.write("foreign", "not a flash");
    bench.refuses("rig --flash foreign settings get", &["foreign", "no flash memory"]);
}

#[test]
fn a_recording_has_every_point_and_reads_back_as_one() {
    let bench = recorded();
    let run = bench.json("run.json");
    assert_eq!((run["samples"].as_u64(), run["points"].as_u64(), run["gaps"].as_u64()), (Some(100), Some(100), Some(0)));
    assert_eq!(run["account"]["lost_on_the_line"], 0);
    assert!(run["fault"].is_null());
    let text = String::from_utf8(bench.read("run.csv")).expect("a CSV is text");
    assert_eq!(text.lines().next(), Some("time_s,pressure_bar,displacement_mm,sequence,pressure_measured_bar"));
    let rows: Vec<Vec<f64>> =
        text.lines().skip(1).map(|line| line.split(',').map(|cell| cell.parse().expect("a number")).collect()).collect();
    assert_eq!(rows.len(), 100);
    let largest = |column: usize| rows.iter().map(|row| row[column]).fold(f64::MIN, f64::max);
    // Eq. (1) peaks just below twice the amplitude; the muscle has a gain of 1 mm/bar less what its thresholds hold back.
    assert!((2.2..2.4).contains(&largest(1)), "{}", largest(1));
    assert!((1.7..2.3).contains(&largest(2)), "{}", largest(2));
    assert!((2.2..2.4).contains(&largest(4)), "{}", largest(4));
    bench.works("identify --data run.csv --out physics.toml");
}

#[test]
fn recording_refuses_what_the_rig_cannot_or_must_not_do_before_it_moves() {
    let bench = Bench::new();
    bench.write("high.toml", EXCITATION.replace("1.2", "1.7"));
    bench.refuses("rig record --excitation high.toml --out run.csv", &["high.toml", "3 bar"]);
    bench.write("odd.toml", EXCITATION.replace("0.02", "0.0125"));
    bench.refuses("rig record --excitation odd.toml --out run.csv", &["whole milliseconds"]);
    bench.write("sine.toml", EXCITATION);
    bench.works("rig --flash low.flash settings set limits.ceiling_bar=1 --save");
    // The device's own ceiling is lower than the host's limit.
    bench.refuses("rig --flash low.flash record --excitation sine.toml --out run.csv", &["1 bar"]);
    bench.refuses("rig record --excitation missing.toml --out run.csv", &["missing.toml"]);
    bench.refuses("rig record --excitation sine.toml --out run.txt", &[".csv"]);
    bench.refuses("rig --backend serial:no-such-port status", &["no-such-port", "cannot be opened"]);
    bench.refuses("rig --backend parallel status", &["virtual, qemu, board-model or serial:PORT"]);
}

#[test]
fn a_replay_is_identical_and_tells_why_the_rig_moved() {
    let bench = recorded();
    let said = bench.works("replay run.csv --at 1.5 --json replay.json");
    assert!(said.stdout.contains("identical to the bit"), "{}", said.stdout);
    let replay = bench.json("replay.json");
    assert_eq!(replay["identical"], true);
    assert!(replay["replay"]["ticks"].as_u64() > Some(2000));
    let moment = &replay["moment"];
    assert_eq!((moment["state"].as_str(), moment["energised"].as_bool()), (Some("running"), Some(true)));
    let source = moment["set_point_source"].as_str().expect("a source");
    assert!(source.starts_with("point ") && source.contains("of the playback"), "{source}");
    // The set-point in force is the output, and the plant's pressure is near it: eq. (1) moves less than 0.1 bar in its lag.
    let output_bar = moment["output_bar"].as_f64().expect("an output");
    assert!((moment["set_point"].as_f64().expect("a set-point") - output_bar).abs() < 1e-6);
    assert!((moment["pressure_bar"].as_f64().expect("a pressure") - output_bar).abs() < 0.2);
    let states: Vec<&str> = replay["turnings"].as_array().into_iter().flatten().filter_map(|turning| turning["to"].as_str()).collect();
    assert_eq!(states, ["self-test", "idle", "armed", "running", "armed", "idle"]);
    bench.refuses("replay run.csv --at 99", &["--at", "no longer"]);
}

#[test]
fn a_replay_log_that_was_changed_is_found_out() {
    let bench = recorded();
    // Any flipped byte fails the checksum.
    let mut bytes = bench.read("run.journal");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    bench.write("flipped.journal", &bytes);
    bench.refuses("replay flipped.journal", &["flipped.journal", "checksum"]);
    bench.write("short.journal", b"CATH");
    bench.refuses("replay short.journal", &["no replay log"]);
    bench.refuses("replay sine.toml", &["no replay log"]);

    // A replay log with the right checksum and another code in one tick does not come out as recorded.
    let mut replay_log = ReplayLog::read(&bench.path("run.journal")).expect("a replay log");
    let mut ticks = 0;
    for event in &mut replay_log.events {
        if let Event::Tick(tick) = event {
            if ticks == 1500 {
                tick.pressure_code = 0;
            }
            ticks += 1;
        }
    }
    replay_log.write(&bench.path("forged.journal")).expect("a file");
    let said = bench.run("replay forged.journal --json forged.json");
    assert_eq!(said.code, 1, "{}", said.stdout);
    let first = bench.json("forged.json")["replay"]["first_difference"]["tick"].as_u64();
    // The wrong code shows with the next telemetry sample, at most 20 ticks later.
    assert!(first >= Some(1500) && first <= Some(1520), "{first:?}");
}

#[test]
fn a_model_is_uploaded_activated_and_rolled_back() {
    let bench = Bench::with_models();
    bench.works("rig --flash rig.flash model upload model.blob --activate --json upload.json");
    let first = bench.json("upload.json")["model_id"].as_str().expect("a model").to_owned();
    bench.works("rig --flash rig.flash hello --json hello.json");
    assert_eq!(bench.json("hello.json")["model_id"].as_str(), Some(first.as_str()));
    assert_eq!(first[..16], sha256_of_blob(&bench.read("model.blob"))[..16]);
    bench.refuses("rig --flash rig.flash model rollback", &["no other whole model"]);
    let mut damaged = bench.read("model.blob");
    let last = damaged.len() - 1;
    damaged[last] ^= 1;
    bench.write("damaged.blob", damaged);
    bench.refuses("rig --flash rig.flash model upload damaged.blob", &["damaged.blob"]);
    bench.works("rig --flash rig.flash model upload model.blob");
    bench.works("rig --flash rig.flash model rollback");
    bench.write("sine.toml", EXCITATION);
    bench.works("rig --flash rig.flash settings set mismatch.displacement_mm=0 --save");
    bench.works("rig --flash rig.flash record --excitation sine.toml --out run.csv");
    bench.works("replay run.journal --at 1.5 --json replay.json");
    let replay = bench.json("replay.json");
    assert!(replay["moment"]["estimate_mm"].is_f64(), "the model runs in the tick: {replay}");
    assert_eq!(replay["blob_sha256"].as_str().map(|hash| &hash[..16]), Some(&first[..16]));
}

/// The content hash as the blob's frame carries it.
fn sha256_of_blob(bytes: &[u8]) -> String {
    bytes[20..52].iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn every_number_is_explained_and_an_unknown_one_names_the_list() {
    let bench = Bench::new();
    for fault in Fault::ALL {
        let said = bench.works(&format!("explain E{:03}", fault.number()));
        assert!(said.stdout.contains(fault.explanation().name) && said.stdout.contains(fault.explanation().remedy), "{}", said.stdout);
    }
    assert!(bench.works("explain Laser-Stuck").stdout.contains("E017 laser-stuck"));
    assert!(bench.works("explain b4 --json blocker.json").stdout.contains("B004 laser-not-plausible"));
    assert_eq!(bench.json("blocker.json")["identifier"], "B004");
    let list = bench.works("explain --json all.json").stdout;
    assert!(list.lines().count() >= 50 && list.contains("E037") && list.contains("N011"));
    for wrong in ["E0", "E64", "E999", "17", "X1", "E"] {
        bench.refuses(&format!("explain {wrong}"), &["E001 to E0", "catheter explain"]);
    }
}

#[test]
fn processor_in_the_loop_says_what_it_lacks() {
    let bench = Bench::with_models();
    bench.refuses("pil --blob model.blob --image nowhere", &["nowhere", "cargo build --release --target thumbv7em-none-eabihf"]);
    bench.refuses("pil --blob physics.toml --image nowhere", &["physics.toml", "no blob"]);
    bench.refuses("pil --blob model.blob --seconds 0", &["--seconds"]);
}

#[test]
fn a_recording_and_a_replay_log_of_another_run_are_no_pair() {
    let bench = recorded();
    bench.works("rig record --excitation sine.toml --out other.csv --seed 2");
    let other = bench.read("other.journal");
    bench.write("other.journal", bench.read("run.journal"));
    bench.write("run.journal", other);
    for swapped in ["run.csv", "other.csv"] {
        bench.refuses(&format!("replay {swapped} --json pair.json"), &[swapped, "belongs to another recording"]);
    }
    assert!(!bench.path("pair.json").exists(), "nothing is written of a pair that is none");
    // Each log for itself is whole.
    assert!(bench.works("replay run.journal").stdout.contains("identical to the bit"));
    // The recording itself, changed in one digit, is another one too.
    bench.write("run.journal", bench.read("other.journal"));
    bench.works("replay run.csv");
    let text = String::from_utf8(bench.read("run.csv")).expect("text");
    let at = text.rfind(|letter: char| letter.is_ascii_digit()).expect("a digit");
    let digit = if text[at..].starts_with('1') { "2" } else { "1" };
    bench.write("run.csv", format!("{}{digit}{}", &text[..at], &text[at + 1..]));
    bench.refuses("replay run.csv", &["run.csv", "belongs to another recording"]);
}

#[test]
fn commands_at_the_same_time_on_one_flash_file_keep_what_each_of_them_saved() {
    let bench = Bench::new();
    let changes =
        [("limits.ceiling_bar", "2.5"), ("laser.required", "false"), ("limits.host_timeout_ms", "300"), ("telemetry.period_ms", "7")];
    // One after the other they save one setting more each time; at the same time they must, too. Before any file, and with one.
    for round in 0..2 {
        let changes = &changes[2 * round..][..2];
        let children: Vec<_> = changes
            .iter()
            .map(|(name, value)| {
                std::process::Command::new(env!("CARGO_BIN_EXE_catheter"))
                    .args(["rig", "--flash", "rig.flash", "settings", "set", &format!("{name}={value}"), "--save"])
                    .current_dir(bench.path(""))
                    .stdout(std::process::Stdio::null())
                    .spawn()
                    .expect("the built command starts")
            })
            .collect();
        for mut child in children {
            assert!(child.wait().expect("it ends").success());
        }
    }
    bench.works("rig --flash rig.flash settings get --json all.json");
    let all = bench.json("all.json");
    for (name, value) in changes {
        assert_eq!(all[name].to_string().trim_end_matches(".0"), value, "{name} was lost");
    }
}

#[test]
fn a_rig_without_a_readable_log_says_where_it_is() {
    let bench = Bench::new();
    bench.refuses("rig log", &["debug probe", "cargo xtask flash", "--backend board-model"]);
    bench.refuses("rig log --seconds 3601", &["--seconds", "0 to 3600"]);
}

#[test]
#[ignore = "needs the board's model and the image: `cargo xtask test`"]
fn the_log_of_the_image_tells_its_start_and_its_states() {
    let bench = Bench::new();
    let said = bench.works("rig --backend board-model log --seconds 0.5 --json log.json");
    let lines = bench.json("log.json")["lines"].as_array().expect("lines").clone();
    let shown: Vec<&str> = said.stdout.lines().collect();
    assert!(!lines.is_empty() && lines.iter().all(|line| shown.contains(&line.as_str().expect("text"))), "{}", said.stdout);
    for wanted in ["firmware", "started by PowerOn", "state SelfTest", "state Idle"] {
        assert!(said.stdout.contains(wanted), "{wanted} in {}", said.stdout);
    }
}
