//! The flashable image, byte for byte, in the emulator, with a host on its serial port.

use std::io::{Read, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use model_export::link::Kind;
use model_export::link::frame::{self, Decoder};
use model_export::link::hello::Hello;
use model_export::link::message::{Baseline, Message, PlaybackChunk, Reply, ReplyFrame, Request, RequestFrame, Status};
use model_export::link::settings::SettingValue;

/// Wall clock for one answer; the emulator shares the machine with other tests.
const PATIENCE: Duration = Duration::from_secs(60);

/// The image as it runs; ends when it is dropped.
pub struct Emulator {
    child: Child,
    line: ChildStdin,
    payloads: Receiver<Vec<u8>>,
    token: u32,
    session: u32,
}

impl Drop for Emulator {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Emulator {
    /// Starts the image.
    ///
    /// # Panics
    /// Without QEMU.
    #[must_use]
    pub fn start(image: &Path) -> Self {
        let mut child = Command::new("qemu-system-arm")
            .args(["-M", "netduinoplus2", "-display", "none", "-monitor", "none", "-serial", "stdio", "-kernel"])
            .arg(image)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("qemu-system-arm");
        let line = child.stdin.take().unwrap();
        let mut output = child.stdout.take().unwrap();
        let (sender, payloads) = channel();
        std::thread::spawn(move || {
            let mut decoder = Decoder::new();
            let mut bytes = [0; 4096];
            while let Ok(length @ 1..) = output.read(&mut bytes) {
                for byte in &bytes[..length] {
                    let Some(payload) = decoder.push(*byte) else { continue };
                    if sender.send(payload.expect("every frame is sound").to_vec()).is_err() {
                        return;
                    }
                }
            }
        });
        Self { child, line, payloads, token: 0, session: 0 }
    }

    /// Sends bytes.
    ///
    /// # Panics
    /// When the emulator has gone.
    pub fn send(&mut self, bytes: &[u8]) {
        self.line.write_all(bytes).unwrap();
        self.line.flush().unwrap();
    }

    /// Waits for a payload that `take` takes.
    ///
    /// # Panics
    /// When none comes.
    pub fn wait_for<T>(&mut self, what: &str, mut take: impl FnMut(&[u8]) -> Option<T>) -> T {
        let end = Instant::now() + PATIENCE;
        loop {
            let left = end.checked_duration_since(Instant::now()).unwrap_or_else(|| panic!("no {what}"));
            let payload = self.payloads.recv_timeout(left).unwrap_or_else(|error| panic!("no {what}: {error}"));
            if let Some(found) = take(&payload) {
                return found;
            }
        }
    }

    /// Asks until there is an answer: what comes before the line is set up is lost, as on the real one.
    ///
    /// # Panics
    /// When there is none.
    pub fn hello(&mut self) -> Hello {
        let end = Instant::now() + PATIENCE;
        while Instant::now() < end {
            self.send(&frame::encode(&[Kind::HelloRequest.byte()]).unwrap());
            let next = Instant::now() + Duration::from_millis(500);
            while let Ok(payload) = self.payloads.recv_timeout(next.saturating_duration_since(Instant::now())) {
                if let Ok(hello) = Hello::decode(&payload) {
                    self.session = hello.session;
                    return hello;
                }
            }
        }
        panic!("no hello");
    }

    /// Sends a request and waits for its reply.
    ///
    /// # Panics
    /// When none comes.
    pub fn ask(&mut self, request: Request) -> Reply {
        self.token += 1;
        let (token, session) = (self.token, self.session);
        self.send(&RequestFrame { token, session, request }.to_wire().unwrap());
        self.wait_for("reply", |payload| {
            let frame = ReplyFrame::from_payload(payload).ok()?;
            (frame.token == token).then_some(frame.reply)
        })
    }

    /// The status.
    ///
    /// # Panics
    /// When something else is answered.
    pub fn status(&mut self) -> Status {
        match self.ask(Request::Status) {
            Reply::Status(status) => status,
            other => panic!("{other:?}"),
        }
    }
}

/// The most stack that the image has used, of `reserved_bytes`, after its start and a session with every kind of request.
///
/// The emulated chip has no HSE and no flash that could be written, so no model is ever checked there.
///
/// # Panics
/// As [`Emulator`].
#[must_use]
pub fn stack_used_bytes(image: &Path, reserved_bytes: u32) -> u32 {
    let mut device = Emulator::start(image);
    device.hello();
    let values_bar = heapless::Vec::from_slice(&[1.0; 32]).unwrap_or_default();
    let bytes = heapless::Vec::from_slice(&[7; 256]).unwrap_or_default();
    for request in [
        Request::SettingSet { number: 1, value: SettingValue::Float(2.5) },
        Request::SettingsDifference { baseline: Baseline::Defaults, from_number: 0 },
        Request::SettingsSave,
        Request::SettingsRevert(Baseline::Saved),
        Request::Playback(PlaybackChunk { first_index: 0, last: false, values_bar }),
        Request::ModelBegin { length: 512, crc32: 0 },
        Request::ModelChunk { offset: 0, bytes },
        Request::ModelFinish,
        Request::ModelActivate { id: [7; 8] },
        Request::Models,
        Request::Arm,
        Request::Acknowledge,
        Request::FaultRecord,
        Request::PreviousFaultRecord,
        Request::Vent,
    ] {
        device.ask(request);
    }
    // The device looks at its stack now and then only.
    let end = Instant::now() + Duration::from_secs(1);
    while Instant::now() < end {
        device.status();
    }
    reserved_bytes.saturating_sub(device.status().stack_unused_bytes)
}
