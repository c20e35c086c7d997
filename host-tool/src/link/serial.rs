//! A board on a serial port.

use std::io::ErrorKind;
use std::time::{Duration, Instant};

use super::{LinkError, Transport};

/// Speed of the board's line; a rate that cheap adapters and the board's clock both meet exactly enough.
pub const BAUD: u32 = 921_600;

/// A serial port.
pub struct Serial {
    port: serial2::SerialPort,
    place: String,
    opened: Instant,
}

impl Serial {
    /// Opens a port by name, for example `/dev/ttyUSB0` or `COM3`, with eight bits, no parity, one stop bit, no flow control.
    ///
    /// # Errors
    /// [`LinkError::CannotOpen`], with the ports there are.
    pub fn open(port: &str) -> Result<Self, LinkError> {
        let opened = serial2::SerialPort::open(port, BAUD).map_err(|error| LinkError::CannotOpen {
            place: port.to_owned(),
            problem: error.to_string(),
            remedy: remedy(&error),
        })?;
        Ok(Self { port: opened, place: port.to_owned(), opened: Instant::now() })
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
}
