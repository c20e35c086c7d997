//! The conversation with whoever simulates what is around the board: one request, one answer, on standard input and output.
//!
//! A message is its length (32 bits, without these four bytes), its kind (8 bits) and its body; numbers are little-endian.
//!
//! | request | body | answer |
//! |---|---|---|
//! | 1, tick | laser codes of the first and second conversion, pressure codes likewise (4 x 16 bits); emergency stop (8 bits, 1 pressed); then bytes for the link | a millisecond later, see below |
//! | 2, fault | text, see [`Fault`] | empty |
//! | 3, read memory | address, length (2 x 32 bits) | the bytes |
//! | 4, report | empty | JSON: registers touched, and those without a model |
//!
//! The answer to a tick: time (64 bits, ns); code at PA4 (16 bits, ffff: not driven); compare value and period at PA6 (2 x 16 bits, period 0:
//! not driven); state (8 bits: 1 dump valve energised, 2 without power, 4 stands still for flash); groups of conversions and resets since the
//! start (2 x 32 bits); instructions since the start (64 bits); length of the bytes from the link (32 bits) and these bytes; then logs, as text.
//!
//! Kind 255 answers what cannot be done, with the reason as text. Time passes in ticks only; equal requests give equal answers.

use std::io::{self, ErrorKind, Read, Write};

/// Longest message that is taken.
const LONGEST: u32 = 1 << 24;

/// What the surroundings ask.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Request {
    /// Let a millisecond pass.
    Tick {
        /// Codes of laser and pressure, for the first and the second conversion.
        codes: [[u16; 2]; 2],
        /// Whether the emergency stop is pressed.
        stop: bool,
        /// Bytes for the link.
        line: Vec<u8>,
    },
    /// Break something.
    Fault(Fault),
    /// Tell memory.
    Read {
        /// First address.
        address: u32,
        /// Bytes.
        length: u32,
    },
    /// Tell what the image touched.
    Report,
}

/// Something that breaks, as text.
///
/// | text | what |
/// |---|---|
/// | `hse stops`, `hse swings`, `hse 12000000` | the HSE |
/// | `loop open`, `loop closed` | whether the phase-locked loop locks |
/// | `watchdog-oscillator 47000` | its frequency, Hz |
/// | `supply 2800` | mV; below 1700 the part has none |
/// | `analogue 3000`, `analogue supply` | the analogue supply alone, mV, or as the supply |
/// | `drive-pin 4095`, `drive-pin free` | the code at PA4, whatever the converter does |
/// | `dump-pin 0`, `dump-pin 1`, `dump-pin free` | the level at PB1, whatever the port does |
/// | `pulse-pin 0`, `pulse-pin 1`, `pulse-pin free` | the level at PA6, whatever the timer does |
/// | `inputs swapped` | the two analogue inputs, exchanged |
/// | `store 08000200 de00` | 16 bits of RAM or flash: address, what is there from now on (hexadecimal) |
/// | `reset` | the reset pin |
/// | `flip 20001000 3` | a bit of RAM or flash: address (hexadecimal), bit of the byte |
/// | `cut 2` | power goes in the middle of the second operation on flash from now, for 100 ms |
/// | `hang` | the core runs nothing more until a reset |
/// | `late-flash` | flash takes its longest times |
/// | `noise 1000` | words of a million that arrive damaged on the link |
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// The HSE swings or does not.
    Hse(bool),
    /// Its frequency, Hz.
    HseHz(u64),
    /// The phase-locked loop locks or does not.
    Loop(bool),
    /// The watchdog's oscillator, Hz.
    WatchdogHz(u64),
    /// The supply, mV.
    Supply(u32),
    /// The analogue supply alone, mV.
    Analogue(Option<u32>),
    /// The code at PA4.
    DrivePin(Option<u16>),
    /// The level at PB1.
    DumpPin(Option<bool>),
    /// The level at PA6.
    PulsePin(Option<bool>),
    /// The analogue inputs, exchanged.
    Swapped,
    /// 16 bits of memory.
    Store {
        /// Their address.
        address: u64,
        /// What they become.
        value: u16,
    },
    /// The reset pin.
    Reset,
    /// A bit of memory.
    Flip {
        /// Address of the byte.
        address: u64,
        /// Bit of the byte.
        bit: u32,
    },
    /// Power goes in the middle of this operation on flash.
    Cut(u32),
    /// The core stops.
    Hang,
    /// Flash is slow.
    LateFlash,
    /// Damaged words on the link, of a million.
    Noise(u32),
}

impl std::str::FromStr for Fault {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let words: Vec<&str> = text.split_whitespace().collect();
        let number = |word: &str| word.parse::<u64>().map_err(|_| format!("`{word}` is no number in `{text}`"));
        let small = |word: &str| number(word).and_then(|number| u32::try_from(number).map_err(|_| format!("`{word}` is too large")));
        let hexadecimal = |word: &str| u64::from_str_radix(word, 16).map_err(|_| format!("`{word}` is no hexadecimal address"));
        Ok(match words[..] {
            ["hse", "stops"] => Self::Hse(false),
            ["hse", "swings"] => Self::Hse(true),
            ["hse", hz] => Self::HseHz(number(hz)?),
            ["loop", "open"] => Self::Loop(false),
            ["loop", "closed"] => Self::Loop(true),
            ["watchdog-oscillator", hz] => match number(hz)? {
                hz @ 17_000..=47_000 => Self::WatchdogHz(hz),
                _ => return Err("the watchdog's oscillator has 17000 to 47000 Hz".to_owned()),
            },
            ["supply", millivolts] => Self::Supply(small(millivolts)?),
            ["analogue", "supply"] => Self::Analogue(None),
            ["analogue", millivolts] => Self::Analogue(Some(small(millivolts)?)),
            ["drive-pin", "free"] => Self::DrivePin(None),
            ["drive-pin", code] => Self::DrivePin(Some(u16::try_from(small(code)?.min(4095)).unwrap_or_default())),
            ["dump-pin", "free"] => Self::DumpPin(None),
            ["dump-pin", "0"] => Self::DumpPin(Some(false)),
            ["dump-pin", "1"] => Self::DumpPin(Some(true)),
            ["pulse-pin", "free"] => Self::PulsePin(None),
            ["pulse-pin", "0"] => Self::PulsePin(Some(false)),
            ["pulse-pin", "1"] => Self::PulsePin(Some(true)),
            ["inputs", "swapped"] => Self::Swapped,
            ["store", address, value] => {
                let value = u16::try_from(hexadecimal(value)?).map_err(|_| format!("`{value}` is too large"))?;
                Self::Store { address: hexadecimal(address)?, value }
            }
            ["reset"] => Self::Reset,
            ["flip", address, bit] => {
                let address = hexadecimal(address)?;
                match small(bit)? {
                    bit @ 0..=7 => Self::Flip { address, bit },
                    _ => return Err("a byte has bits 0 to 7".to_owned()),
                }
            }
            ["cut", operation] => Self::Cut(small(operation)?.max(1)),
            ["hang"] => Self::Hang,
            ["late-flash"] => Self::LateFlash,
            ["noise", words] => Self::Noise(small(words)?),
            _ => return Err(format!("`{text}` is no fault of this board")),
        })
    }
}

/// Takes a request; `None` when nobody asks any more.
///
/// # Errors
/// When the stream breaks or carries something else. What is understood and cannot be done is the inner error.
pub fn take(input: &mut impl Read) -> io::Result<Option<Result<Request, String>>> {
    let mut length = [0; 4];
    match input.read_exact(&mut length) {
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(None),
        other => other?,
    }
    let length = u32::from_le_bytes(length);
    if length == 0 || length > LONGEST {
        return Err(io::Error::new(ErrorKind::InvalidData, format!("a message of {length} bytes")));
    }
    let mut message = vec![0; length as usize];
    input.read_exact(&mut message)?;
    Ok(Some(decode(&message)))
}

fn decode(message: &[u8]) -> Result<Request, String> {
    let short = || "the message is too short".to_owned();
    let (kind, body) = message.split_first().ok_or_else(short)?;
    match kind {
        1 => {
            let (codes, rest) = body.split_first_chunk::<8>().ok_or_else(short)?;
            let (stop, line) = rest.split_first().ok_or_else(short)?;
            let code = |at: usize| u16::from_le_bytes([codes[at], codes[at + 1]]);
            Ok(Request::Tick { codes: [[code(0), code(2)], [code(4), code(6)]], stop: *stop != 0, line: line.to_vec() })
        }
        2 => std::str::from_utf8(body).map_err(|_| "the fault is no text".to_owned())?.parse().map(Request::Fault),
        3 => {
            let (address, rest) = body.split_first_chunk::<4>().ok_or_else(short)?;
            let length = rest.first_chunk::<4>().ok_or_else(short)?;
            let (address, length) = (u32::from_le_bytes(*address), u32::from_le_bytes(*length));
            if length > 1 << 20 { Err("at most a mebibyte at once".to_owned()) } else { Ok(Request::Read { address, length }) }
        }
        4 => Ok(Request::Report),
        other => Err(format!("requests of kind {other} are unknown")),
    }
}

/// Gives an answer.
///
/// # Errors
/// When the stream breaks.
pub fn give(output: &mut impl Write, kind: u8, body: &[u8]) -> io::Result<()> {
    let length = u32::try_from(body.len() + 1).map_err(|_| io::Error::from(ErrorKind::InvalidInput))?;
    let mut message = Vec::with_capacity(body.len() + 5);
    message.extend(length.to_le_bytes());
    message.push(kind);
    message.extend(body);
    output.write_all(&message)?;
    output.flush()
}

/// Kind of an answer that says why something was not done.
pub const REFUSED: u8 = 255;

#[cfg(test)]
mod tests {
    use super::*;

    fn message(kind: u8, body: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        give(&mut bytes, kind, body).unwrap();
        bytes
    }

    #[test]
    fn requests_are_read_as_documented() {
        let bytes = message(1, &[1, 0, 2, 0, 3, 0, 4, 0, 1, 0xaa, 0xbb]);
        let expected = Request::Tick { codes: [[1, 2], [3, 4]], stop: true, line: vec![0xaa, 0xbb] };
        assert_eq!(take(&mut bytes.as_slice()).unwrap(), Some(Ok(expected)));
        let bytes = message(2, b"flip 20001000 3");
        assert_eq!(take(&mut bytes.as_slice()).unwrap(), Some(Ok(Request::Fault(Fault::Flip { address: 0x2000_1000, bit: 3 }))));
        assert_eq!(take(&mut [].as_slice()).unwrap(), None);
    }

    #[test]
    fn what_is_no_request_is_refused_with_a_reason() {
        for (kind, body) in [(1, &[0; 8][..]), (2, b"hse maybe"), (2, b"flip 0 8"), (3, &[0; 7]), (9, b"")] {
            assert!(take(&mut message(kind, body).as_slice()).unwrap().unwrap().is_err(), "{kind} {body:?}");
        }
        assert!(take(&mut [0xff; 8].as_slice()).is_err());
    }
}
