//! Commands for a rig under pressure, on a board behind a pseudo-terminal: states stay from command to command, Ctrl-C vents, a port is one
//! process' alone.

use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::board::Board;
use crate::support::Bench;

/// Starts `catheter` and does not wait for it.
fn start(bench: &Bench, line: &str) -> Child {
    Command::new(env!("CARGO_BIN_EXE_catheter"))
        .args(line.split_whitespace())
        .current_dir(bench.path(""))
        .stdin(Stdio::null())
        .stdout(std::fs::File::create(bench.path("said.txt")).expect("a file"))
        .stderr(Stdio::piped())
        .spawn()
        .expect("the built command starts")
}

/// Waits until a running command has said this.
fn wait_for(bench: &Bench, word: &str) {
    let begun = Instant::now();
    while !String::from_utf8_lossy(&bench.read("said.txt")).contains(word) {
        assert!(begun.elapsed() < Duration::from_secs(240), "`{word}` is not said: {}", String::from_utf8_lossy(&bench.read("said.txt")));
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn signal(child: &Child, name: &str) {
    let sent = Command::new("kill").args([name, &child.id().to_string()]).status().expect("kill");
    assert!(sent.success());
}

#[test]
fn a_board_stays_armed_from_command_to_command() {
    let bench = Bench::new();
    let board = Board::start();
    let rig = format!("rig --backend serial:{}", board.port);
    bench.works(&format!("{rig} settings set control.law=pressure"));
    bench.works(&format!("{rig} arm"));
    bench.works(&format!("{rig} status --json status.json"));
    assert_eq!(bench.json("status.json")["state"], "armed");
    // Armed already, with the law that a hold needs.
    bench.works(&format!("{rig} hold --pressure-bar 0.4 --seconds 1 --json hold.json"));
    let held = &bench.json("hold.json")["reading"];
    assert!((held["pressure_bar"].as_f64().expect("a pressure") - 0.4).abs() < 0.02, "{held}");
    bench.works(&format!("{rig} arm"));
    bench.works(&format!("{rig} stop"));
    bench.works(&format!("{rig} disarm"));
    bench.works(&format!("{rig} status --json status.json"));
    assert_eq!(bench.json("status.json")["state"], "idle");
    bench.works(&format!("{rig} monitor --seconds 0.5 --csv watched.csv"));
    let said = bench.works(&format!("{rig} vent")).stdout;
    assert!(said.contains("below 0.1 bar"), "{said}");
}

#[test]
fn ctrl_c_and_termination_vent_before_the_command_ends() {
    for (name, settings) in [("-INT", "0.6"), ("-TERM", "0.3")] {
        let bench = Bench::new();
        let board = Board::start();
        let child = start(&bench, &format!("rig --backend serial:{} hold --arm --pressure-bar {settings} --json hold.json", board.port));
        wait_for(&bench, "running");
        signal(&child, name);
        let ended = child.wait_with_output().expect("it ends");
        assert_eq!(ended.status.code(), Some(0), "{}", String::from_utf8_lossy(&ended.stderr));
        let hold = bench.json("hold.json");
        assert_eq!(
            (hold["ended"].as_str(), hold["vented"].as_bool(), hold["state"].as_str()),
            (Some("interrupted"), Some(true), Some("idle"))
        );
    }
}

#[test]
fn a_host_that_dies_leaves_a_rig_that_vents_by_itself() {
    let bench = Bench::new();
    // Its time goes on without a host.
    let board = Board::with_patience(u32::MAX);
    let mut child = start(&bench, &format!("rig --backend serial:{} hold --arm --pressure-bar 0.6", board.port));
    wait_for(&bench, "running");
    child.kill().expect("it can be killed");
    let _ = child.wait();
    std::thread::sleep(Duration::from_millis(1500));
    let said = bench.works(&format!("rig --backend serial:{} explain --json explain.json", board.port)).stdout;
    assert!(said.contains("host-lost"), "{said}");
    let status = &bench.json("explain.json")["status"];
    assert_eq!(status["state"], "fault");
}

#[test]
fn a_second_process_is_told_who_holds_the_port() {
    let bench = Bench::new();
    let board = Board::start();
    let child = start(&bench, &format!("rig --backend serial:{} hold --arm --pressure-bar 0.5", board.port));
    wait_for(&bench, "running");
    let number = child.id().to_string();
    let refused = bench.run(&format!("rig --backend serial:{} status", board.port));
    assert_eq!(refused.code, 2, "{}", refused.stdout);
    for word in ["in use by process", number.as_str(), "hold --arm --pressure-bar 0.5"] {
        assert!(refused.stderr.contains(word), "`{word}` is missing from {}", refused.stderr);
    }
    // The one who holds it did not notice.
    signal(&child, "-INT");
    let ended = child.wait_with_output().expect("it ends");
    assert_eq!(ended.status.code(), Some(0), "{}", String::from_utf8_lossy(&ended.stderr));
    bench.works(&format!("rig --backend serial:{} status", board.port));
}

#[test]
fn serial_alone_finds_the_one_board_that_answers() {
    let bench = Bench::new();
    let (one, other) = (Board::start(), Board::start());
    let quiet = serial2::SerialPort::pair().expect("a pair of pseudo-terminals");
    let quiet_port = std::fs::read_link(format!("/proc/self/fd/{}", std::os::fd::AsRawFd::as_raw_fd(&quiet.1))).expect("its name");
    let run = |ports: &str| {
        let output = assert_cmd::Command::new(env!("CARGO_BIN_EXE_catheter"))
            .args(["rig", "--backend", "serial", "hello", "--force", "--json", "hello.json"])
            .env("CATHETER_PORTS", ports)
            .current_dir(bench.path(""))
            .output()
            .expect("the built command starts");
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (code, stderr) = run(&format!("{},{}", quiet_port.display(), one.port));
    assert_eq!(code, Some(0), "{stderr}");
    assert_eq!(bench.json("hello.json")["board"], "stm32f405-rig");
    let (code, stderr) = run(&format!("{},{}", one.port, other.port));
    assert_eq!(code, Some(2));
    assert!(stderr.contains("more than one") && stderr.contains(&one.port) && stderr.contains(&other.port), "{stderr}");
    let (code, stderr) = run(&quiet_port.display().to_string());
    assert_eq!(code, Some(2));
    assert!(stderr.contains("no board answers") && stderr.contains("tried"), "{stderr}");
    let (code, stderr) = run("");
    assert_eq!(code, Some(2));
    assert!(stderr.contains("no board answers"), "{stderr}");
}
