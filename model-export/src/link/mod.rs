//! The link between host and board: what the bytes on the serial line mean.
//!
//! Terms. A **frame** is a payload of up to [`frame::MAX_PAYLOAD`] bytes with its CRC-32 behind it, COBS-encoded, ended by one zero
//! byte. The first payload byte is the [`Kind`]. **Hello** frames have a frozen layout ([`hello`]) so that every version of the host
//! understands every version of the firmware well enough to say what is wrong; all other payloads are [postcard] and belong to one
//! [`PROTOCOL`] version ([`message`]).
//!
//! What never changes: the frame format, the kinds [`Kind::HelloRequest`] and [`Kind::HelloAnswer`], the meaning of every byte of a
//! Hello, and the numbers of faults, blockers, notices and settings. What may change with [`PROTOCOL`]: everything else, and only by
//! appending variants and settings. [`SCHEMA_HASH`] tells two builds apart that carry the same protocol number by mistake.
//!
//! [postcard]: https://postcard.jamesmunns.com/wire-format
//!
//! # Example
//! ```
//! use model_export::link::frame::{Decoder, encode};
//! use model_export::link::message::{Message, Request, RequestFrame};
//! use model_export::link::{Kind, LINE_BAUD, PROTOCOL, SCHEMA_HASH, parse_anything};
//!
//! // A request on its way: encoded, found again in a stream of bytes, and understood.
//! let request = RequestFrame { token: 1, session: 7, request: Request::Vent };
//! let wire = request.to_wire()?;
//! let mut decoder = Decoder::new();
//! let read = wire.iter().find_map(|byte| decoder.push(*byte).map(|payload| RequestFrame::from_payload(payload.expect("sound"))));
//! assert_eq!(read, Some(Ok(request)));
//! assert_eq!(parse_anything(&wire), 1);
//!
//! // Of what it means there are versions; ten bits a byte make a request of less than 20 bytes pass in a fifth of a millisecond.
//! assert!(PROTOCOL >= 3 && SCHEMA_HASH != 0 && wire.len() < 20);
//! assert!(10.0 * wire.len() as f64 / f64::from(LINE_BAUD) < 0.000_22);
//! assert_eq!(encode(&[Kind::HelloRequest.byte()]).map(|wire| wire.len()), Ok(7));
//! # Ok::<(), model_export::link::message::MessageError>(())
//! ```

pub mod adaptation;
mod codec;
pub mod fault;
pub mod frame;
#[cfg(not(target_os = "none"))]
pub mod fuzzing;
pub mod hello;
pub mod history;
mod kind;
pub mod message;
pub mod profiles;
pub mod settings;
pub mod state;
pub mod telemetry;
pub mod trace;

pub use kind::Kind;

/// Version of all postcard messages; raised whenever an existing message changes its bytes.
pub const PROTOCOL: u16 = 3;

/// Speed of a board's serial line, bit/s, with 8 data bits, no parity and one stop bit: a rate that cheap adapters and the board's clock both
/// meet exactly enough.
pub const LINE_BAUD: u32 = 921_600;

/// CRC-32 over one example frame of every message, in the order of `tests/link/examples.rs`, which recomputes it.
pub const SCHEMA_HASH: u32 = 0x93bb_2f5b;

/// Feeds bytes to the frame decoder and every payload to every message decoder: the body of the fuzz target. Gives the number of messages
/// that were understood.
pub fn parse_anything(bytes: &[u8]) -> usize {
    use message::Message;
    let mut decoder = frame::Decoder::new();
    let mut understood = 0;
    for byte in bytes.iter().chain(&[0]) {
        if let Some(Ok(payload)) = decoder.push(*byte) {
            understood += usize::from(hello::Hello::decode(payload).is_ok());
            understood += usize::from(message::RequestFrame::from_payload(payload).is_ok());
            understood += usize::from(message::ReplyFrame::from_payload(payload).is_ok());
            understood += usize::from(message::Telemetry::from_payload(payload).is_ok());
            understood += usize::from(trace::TracePiece::from_payload(payload).is_ok());
        }
    }
    understood
}
