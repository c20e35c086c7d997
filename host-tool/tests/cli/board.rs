//! `catheter` with a board on a serial port: a pseudo-terminal with the firmware in this process behind it, a millisecond each millisecond.

use std::os::fd::AsRawFd as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use host_tool::link::{FlashMemory, Hardware, HardwareConfig, InProcess, Lockstep, Transport};
use host_tool::plant::{Plant, PlantConfig};
use serial2::SerialPort;

use crate::support::Bench;

/// Ticks for which the board waits for a word from its host before its time stands still: on a busy machine the host may be kept waiting for
/// longer than the rig may be without it.
const PATIENT_TICKS: u32 = 150;

/// A board on a port.
pub struct Board {
    pub port: String,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    /// Its other end must stay open between two commands.
    _kept: SerialPort,
}

impl Board {
    pub fn start() -> Self {
        Self::with_patience(PATIENT_TICKS)
    }

    /// A board whose time stands still after so many ticks without a word from its host.
    pub fn with_patience(patient_ticks: u32) -> Self {
        let (mut device, host) = SerialPort::pair().expect("a pair of pseudo-terminals");
        let link = format!("/proc/self/fd/{}", host.as_raw_fd());
        let port = std::fs::read_link(link).expect("the port's name").display().to_string();
        let ends = Arc::new(AtomicBool::new(false));
        let until = Arc::clone(&ends);
        let thread = std::thread::spawn(move || {
            let plant = Plant::new(PlantConfig::default()).expect("a plant");
            let hardware = Hardware::new(HardwareConfig::default(), Box::new(plant.start(0.0)));
            let processor = InProcess::new(FlashMemory::default());
            let mut rig = Lockstep::new(processor, hardware, (), "the board", "stm32f405-rig").expect("a rig");
            device.set_read_timeout(Duration::from_millis(1)).expect("a timeout");
            let (mut bytes, mut to_host, mut waited) = ([0; 4096], Vec::new(), 0);
            while !until.load(Ordering::Relaxed) {
                let count = device.read(&mut bytes).unwrap_or(0);
                waited = if count > 0 { 0 } else { waited + 1 };
                if waited > patient_ticks {
                    continue;
                }
                rig.send(&bytes[..count]).expect("the rig takes bytes");
                rig.receive(Duration::from_millis(1), &mut to_host).expect("the rig goes on");
                device.write_all(&to_host).expect("the host reads");
                to_host.clear();
            }
        });
        Self { port, ends, thread: Some(thread), _kept: host }
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

#[test]
fn a_boards_recordings_and_runs_leave_replay_logs_that_are_run_again_to_the_bit() {
    let bench = Bench::new();
    let board = Board::start();
    let port = &board.port;

    // Without a model.
    bench.write(
        "sine.toml",
        "sample_period_s = 0.02\n[[segments]]\nduration_s = 1.0\n\
         signal = { kind = \"descending-sine\", amplitude_bar = 1.2, frequency_hz = 0.8, decay_per_s = 0.05 }\n",
    );
    bench.works(&format!("rig --backend serial:{port} record --excitation sine.toml --out run.csv"));
    let replayed = bench.works("replay run.csv --at 0.5 --json replayed.json");
    assert!(replayed.stdout.contains("identical to the bit") && replayed.stdout.contains("`serial`"), "{}", replayed.stdout);
    let replayed = bench.json("replayed.json");
    assert_eq!((replayed["identical"].as_bool(), replayed["complete"].as_bool()), (Some(true), Some(true)));

    // Two controllers, with the model that the command puts on the board.
    crate::control::recordings(&bench);
    bench.works("tune --data recordings --out tuned");
    let points: String = (0..60).map(|point| format!("{:.2},{:.3}\n", f64::from(point) * 0.02, 3.0 + f64::from(point) * 0.02)).collect();
    bench.write("path.csv", format!("time_s,reference_mm\n{points}"));
    let tracked = bench.run(&format!(
        "track --backend serial:{port} --settings tuned/settings.toml --model tuned/control.blob --reference path.csv \
         --controllers physics-inverse,open-loop --journals journals --json tracked.json"
    ));
    // The model is that of another rig: this muscle cannot go where the reference asks it to, and the command says so.
    assert_eq!(tracked.code, 1, "{}{}", tracked.stdout, tracked.stderr);
    assert!(tracked.stdout.contains("FAILED: physics-inverse: off by"), "{}", tracked.stdout);
    assert_eq!(bench.json("tracked.json")["missed"].as_array().map(Vec::len), Some(2));
    for controller in ["physics-inverse", "open-loop"] {
        let told = bench.works(&format!("replay journals/{controller}.journal"));
        assert!(told.stdout.contains("identical to the bit") && told.stdout.contains("armed -> running"), "{}", told.stdout);
    }

    // The board gives its model to nobody.
    let line = format!("rig --backend serial:{port} record --excitation sine.toml --out other.csv");
    bench.refuses(&line, &["--model", "--no-journal"]);
    bench.works(&format!("{line} --no-journal"));
    assert!(!bench.path("other.journal").exists());
    bench.works(&format!("{line} --model tuned/control.blob"));
    assert!(bench.works("replay other.csv").stdout.contains("identical to the bit"));
}
