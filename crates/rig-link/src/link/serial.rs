//! A board on a serial port.

use std::hash::BuildHasher as _;
use std::io::ErrorKind;
use std::time::{Duration, Instant};

use model_export::link::LINE_BAUD;

use super::reserved::{Reserved, reserve};
use super::{LinkError, Transport};

/// Speed of the line to the bootloader in the chip's ROM, 8 bits, even parity: the fastest that AN3155 promises.
const BOOTLOADER_BAUD: u32 = 115_200;

/// A serial port, which nobody else may use meanwhile.
pub struct Serial {
    port: serial2::SerialPort,
    _reserved: Reserved,
    place: String,
    opened: Instant,
}

impl Serial {
    /// Opens a port by name, for example `/dev/ttyUSB0` or `COM3`, with eight bits, no parity, one stop bit, no flow control.
    ///
    /// # Errors
    /// [`LinkError::CannotOpen`], with the ports there are, or with who uses this one.
    pub fn open(port: &str) -> Result<Self, LinkError> {
        Self::open_with(port, LINE_BAUD)
    }

    fn open_with(port: &str, settings: impl serial2::IntoSettings) -> Result<Self, LinkError> {
        let cannot =
            |error: std::io::Error| LinkError::CannotOpen { place: port.to_owned(), problem: error.to_string(), remedy: remedy(&error) };
        // First: opening sets the line up, which whoever uses it must not notice.
        let reserved = reserve(port)?.map_err(cannot)?;
        let opened = serial2::SerialPort::open(port, settings).map_err(cannot)?;
        Ok(Self { port: opened, _reserved: reserved, place: port.to_owned(), opened: Instant::now() })
    }

    /// Opens a port as the bootloader in the chip's ROM wants it: slower, with even parity.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_bootloader(port: &str) -> Result<Self, LinkError> {
        let settings = |mut settings: serial2::Settings| {
            settings.set_raw();
            settings.set_baud_rate(BOOTLOADER_BAUD)?;
            settings.set_parity(serial2::Parity::Even);
            Ok(settings)
        };
        Self::open_with(port, settings)
    }

    fn gone(&self, error: &std::io::Error) -> LinkError {
        LinkError::Unplugged { place: self.place.clone(), problem: error.to_string() }
    }
}

/// What to do when a port cannot be opened.
fn remedy(error: &std::io::Error) -> String {
    if error.kind() == ErrorKind::PermissionDenied {
        return "your user may not use serial ports: on most Linux systems the group `dialout` may".to_owned();
    }
    let ports: Vec<String> =
        serial2::SerialPort::available_ports().unwrap_or_default().iter().map(|path| path.display().to_string()).collect();
    if ports.is_empty() {
        "this machine has no serial ports now: plug in the board".to_owned()
    } else {
        format!("there are: {}", ports.join(", "))
    }
}

impl Transport for Serial {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.port.write_all(bytes).map_err(|error| self.gone(&error))
    }

    fn receive(&mut self, limit: Duration, into: &mut Vec<u8>) -> Result<(), LinkError> {
        let mut buffer = [0; 4096];
        // A timeout of zero would wait for ever on some systems.
        self.port.set_read_timeout(limit.max(Duration::from_millis(1))).map_err(|error| self.gone(&error))?;
        match self.port.read(&mut buffer) {
            // The end of a stream that has none: the adapter was pulled out.
            Ok(0) => Err(self.gone(&std::io::Error::from(ErrorKind::UnexpectedEof))),
            Ok(count) => {
                into.extend_from_slice(&buffer[..count]);
                Ok(())
            }
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(()),
            Err(error) => Err(self.gone(&error)),
        }
    }

    fn elapsed(&self) -> Duration {
        self.opened.elapsed()
    }

    fn place(&self) -> &str {
        &self.place
    }

    fn token_before_the_first(&self) -> u32 {
        // The upper half is left for the requests of a session, however long.
        let random = std::hash::RandomState::new().hash_one(self.place.as_str()) as u32;
        random >> 1
    }
}

#[cfg(all(test, unix))]
mod tests {
    use std::thread;

    use model_export::link::frame::{self, Decoder};
    use model_export::link::hello::{Build, Hello};
    use model_export::link::message::{Message as _, Refusal, Reply, ReplyFrame, Request, RequestFrame};
    use model_export::link::state::ResetCause;
    use model_export::link::{Kind, PROTOCOL, SCHEMA_HASH};

    use super::super::client::Client;
    use super::*;

    /// A port, and what is at its other end.
    fn pair() -> (Serial, serial2::SerialPort) {
        let (port, mut device) = serial2::SerialPort::pair().expect("a pair of pseudo-terminals");
        device.set_read_timeout(Duration::from_secs(5)).expect("a timeout");
        (Serial { port, _reserved: Reserved::default(), place: "pair".to_owned(), opened: Instant::now() }, device)
    }

    fn hello(protocol: u16, schema_hash: u32) -> Hello {
        Hello {
            firmware: [0, 0, 9],
            protocol,
            schema_hash,
            model_id: [0; 8],
            reset_cause: ResetCause::Pin,
            board: heapless::String::try_from("test").unwrap_or_default(),
            session: 0,
            build: Build::default(),
        }
    }

    #[test]
    fn a_device_that_is_pulled_out_is_named() {
        let (mut port, device) = pair();
        drop(device);
        let gone = port.receive(Duration::from_secs(1), &mut Vec::new());
        assert!(matches!(gone, Err(LinkError::Unplugged { .. })), "{gone:?}");
    }

    #[test]
    fn another_device_on_the_port_is_named_and_an_old_firmware_too() {
        let (port, device) = pair();
        // It comes back at the end: a device that leaves is another error.
        let chatter = thread::spawn(move || (0..100).all(|_| device.write_all(b"login: \0\r\n").is_ok()).then_some(device));
        let met = Client::connect(port);
        assert!(matches!(met, Err(LinkError::Garbage { .. })), "{:?}", met.err());
        drop(met);
        let _ = chatter.join();

        let (port, device) = pair();
        let old = thread::spawn(move || {
            let mut byte = [0; 64];
            while device.read(&mut byte).is_ok_and(|count| count == 0) {}
            device.write_all(&frame::encode(&hello(0, 1).encode()).expect("a frame")).expect("the host listens");
            device
        });
        let met = Client::connect(port);
        assert!(matches!(&met, Err(LinkError::OldFirmware { firmware, .. }) if firmware == "0.0.9"), "{:?}", met.err());
        let _ = old.join();
    }

    /// A device that gives each request the answers of `script`, each with its token's distance from the request's own.
    fn scripted(device: serial2::SerialPort, script: &'static [(u32, Reply)]) -> thread::JoinHandle<serial2::SerialPort> {
        thread::spawn(move || {
            let say = |wire: &[u8]| device.write_all(wire).expect("the host listens");
            let (mut decoder, mut bytes, mut answered) = (Decoder::default(), [0; 256], false);
            while !answered {
                let count = device.read(&mut bytes).expect("a host");
                for byte in &bytes[..count] {
                    let Some(Ok(payload)) = decoder.push(*byte) else { continue };
                    if payload.first() == Some(&Kind::HelloRequest.byte()) {
                        say(&frame::encode(&hello(PROTOCOL, SCHEMA_HASH).encode()).expect("a frame"));
                    } else if let Ok(request) = RequestFrame::from_payload(payload) {
                        for (distance, reply) in script {
                            let frame = ReplyFrame { token: request.token.wrapping_sub(*distance), reply: reply.clone() };
                            say(&frame.to_wire().expect("a frame"));
                        }
                        answered = true;
                    }
                }
            }
            device
        })
    }

    #[test]
    fn a_reply_to_an_older_request_is_no_answer() {
        const OLD: Reply = Reply::Refused(Refusal::Busy);
        let (port, device) = pair();
        let answers = scripted(device, &[(1, OLD), (5, OLD), (0, Reply::Done)]);
        let mut client = Client::connect(port).expect("a device");
        assert_eq!(client.ask(&Request::Vent).expect("the answer to this request"), Reply::Done);
        drop(answers.join());

        let (port, device) = pair();
        let answers = scripted(device, &[(1, OLD), (5, OLD)]);
        let mut client = Client::connect(port).expect("a device");
        let met = client.ask(&Request::Vent);
        assert!(matches!(met, Err(LinkError::NoAnswer { .. })), "{met:?}");
        drop(answers.join());
    }

    #[test]
    fn the_next_process_on_a_port_begins_with_other_tokens_so_that_it_takes_no_reply_to_the_one_before() {
        let firsts: Vec<u32> = (0..8).map(|_| pair().0.token_before_the_first()).collect();
        // Two of eight within a million of each other, as far as a session gets in hours, are a chance of one in forty: three pairs are not.
        let near = |one: u32, other: u32| one.abs_diff(other) < 1_000_000;
        let pairs = (0..8).flat_map(|one| (0..one).map(move |other| (one, other)));
        assert!(pairs.filter(|(one, other)| near(firsts[*one], firsts[*other])).count() < 3, "{firsts:?}");
        assert!(firsts.iter().all(|first| *first < 1 << 31), "half of the range is left for the session: {firsts:?}");
    }

    #[test]
    fn a_silent_port_is_no_answer() {
        let (port, _device) = pair();
        assert!(matches!(Client::connect(port), Err(LinkError::NoAnswer { .. })));
    }
}
