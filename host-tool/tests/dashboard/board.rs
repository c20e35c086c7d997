//! A board at a pseudo-terminal that lives on when its host dies, and keeps a log of its outputs by its own time.

use std::os::fd::AsRawFd as _;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use host_tool::link::{FlashMemory, Hardware, HardwareConfig, InProcess, Lockstep, Transport};
use host_tool::plant::{Plant, PlantConfig};
use serial2::SerialPort;

/// One millisecond of it.
#[derive(Clone, Copy, Debug)]
pub struct Tick {
    pub at: Instant,
    /// Whether the dump valve is closed or the valve is driven.
    pub energised: bool,
    pub pressure_bar: f64,
}

pub struct Board {
    pub port: String,
    log: Arc<Mutex<Vec<Tick>>>,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    _kept: SerialPort,
}

impl Board {
    pub fn start() -> Self {
        let (mut device, host) = SerialPort::pair().expect("a pair of pseudo-terminals");
        let port = std::fs::read_link(format!("/proc/self/fd/{}", host.as_raw_fd())).expect("the port's name").display().to_string();
        let (log, ends) = (Arc::<Mutex<Vec<Tick>>>::default(), Arc::new(AtomicBool::new(false)));
        let (kept, until) = (Arc::clone(&log), Arc::clone(&ends));
        let thread = std::thread::spawn(move || {
            let plant = Plant::new(PlantConfig::default()).expect("a plant");
            let hardware = Hardware::new(HardwareConfig::default(), Box::new(plant.start(0.0)));
            let mut rig = Lockstep::new(InProcess::new(FlashMemory::default()), hardware, (), "the board", "stm32f405-rig").expect("a rig");
            device.set_read_timeout(Duration::from_millis(1)).expect("a timeout");
            let (begun, mut bytes, mut to_host) = (Instant::now(), [0; 4096], Vec::new());
            while !until.load(Ordering::Relaxed) {
                let count = device.read(&mut bytes).unwrap_or(0);
                rig.send(&bytes[..count]).expect("the rig takes bytes");
                // As many ticks as there were milliseconds: a board does not wait for its host.
                while rig.elapsed() < begun.elapsed() {
                    rig.advance().expect("the rig goes on");
                    let outputs = *rig.outputs();
                    let tick = Tick {
                        at: begun + rig.elapsed(),
                        energised: outputs.energised || outputs.valve_share > 0,
                        pressure_bar: rig.hardware().pressure_bar(),
                    };
                    kept.lock().expect("the log").push(tick);
                }
                rig.receive(Duration::ZERO, &mut to_host).expect("the rig goes on");
                // Nobody may be reading any more.
                let _ = device.write_all(&to_host);
                to_host.clear();
            }
        });
        Self { port, log, ends, thread: Some(thread), _kept: host }
    }

    pub fn last(&self) -> Tick {
        *self.log.lock().expect("the log").last().expect("a tick")
    }

    /// The first tick since then for which this holds.
    pub fn first_since(&self, since: Instant, holds: impl Fn(&Tick) -> bool) -> Tick {
        let begun = Instant::now();
        loop {
            if let Some(tick) = self.log.lock().expect("the log").iter().find(|tick| tick.at >= since && holds(tick)) {
                return *tick;
            }
            assert!(begun.elapsed() < Duration::from_secs(5), "it does not come: {:?}", self.last());
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Whether it was energised at any time between two moments.
    pub fn was_energised(&self, from: Instant, to: Instant) -> bool {
        let log = self.log.lock().expect("the log");
        log.iter().any(|tick| tick.at >= from && tick.at <= to && tick.energised)
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}
