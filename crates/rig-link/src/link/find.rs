//! Finds the board among the serial ports: the one that answers Hello.

use std::path::Path;

use super::{Client, LinkError, Serial};

/// Ports to try instead of those that the system lists, separated by commas: for boards behind a link of udev, and for tests.
const PORTS: &str = "CATHETER_PORTS";

/// The ports at which a board may be: those of USB adapters, not the machine's own lines, where anything may listen.
fn candidates() -> Vec<String> {
    if let Ok(ports) = std::env::var(PORTS) {
        return ports.split(',').filter(|port| !port.is_empty()).map(str::to_owned).collect();
    }
    let is_usb = |port: &Path| {
        let name = port.file_name().unwrap_or_default().to_string_lossy().into_owned();
        ["ttyUSB", "ttyACM", "cu.usb", "COM"].iter().any(|beginning| name.starts_with(beginning))
    };
    let mut ports: Vec<String> = serial2::SerialPort::available_ports()
        .unwrap_or_default()
        .iter()
        .filter(|port| is_usb(port))
        .map(|port| port.display().to_string())
        .collect();
    ports.sort();
    ports
}

/// Opens the port at which a board answers.
///
/// # Errors
/// [`LinkError::NotFound`] with what was tried, when none answers or more than one.
pub fn find_board() -> Result<Serial, LinkError> {
    let (mut found, mut tried) = (Vec::new(), Vec::new());
    for port in candidates() {
        match Serial::open(&port).and_then(Client::try_to_meet) {
            Ok(client) => {
                tried.push(format!("{port}: a board `{}`", client.hello().board));
                found.push(client.into_transport());
            }
            // The place stands at the beginning of the message.
            Err(error) => tried.push(error.to_string()),
        }
    }
    match found.pop() {
        Some(board) if found.is_empty() => Ok(board),
        Some(_) => {
            Err(LinkError::NotFound { problem: "more than one board answers; name one with --backend serial:PORT".to_owned(), tried })
        }
        None => {
            Err(LinkError::NotFound { problem: "no board answers on any USB serial port; plug it in, or name its port".to_owned(), tried })
        }
    }
}
