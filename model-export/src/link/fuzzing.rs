//! A line that does its worst: the body of the fuzz target and of a test with fixed seeds.
//!
//! A script of bytes says what happens to sound frames on their way: they come whole, with flipped bits, cut short, without their end, behind noise,
//! or with another payload under a right checksum. Whatever it says, three things must hold: nothing panics, every payload that the
//! decoder gives out is one that was sent, and behind all of it a sound frame gets through.
//!
//! # Example
//! ```
//! use model_export::link::fuzzing::{Account, MAX_STEPS, carry_out};
//!
//! // Nothing happens to the line: the last sound frame comes through alone.
//! assert_eq!(carry_out(&[]), Account { accepted: 1, refused: 0, understood: 1 });
//! // Whatever happens, it holds.
//! let account = carry_out(&[0xa5; 3 * MAX_STEPS]);
//! assert!(account.accepted >= 1);
//! ```

use heapless::Vec;

use super::frame::{self, Decoder, MAX_PAYLOAD, Wire};
use super::hello::Hello;
use super::kind::Kind;
use super::message::{Message, PlaybackChunk, Reply, ReplyFrame, Request, RequestFrame, Status, Telemetry};
use super::trace::TracePiece;

/// Steps of a script that are carried out; more are ignored.
pub const MAX_STEPS: usize = 64;

type Payload = Vec<u8, MAX_PAYLOAD>;

/// What came of a script.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Account {
    /// Payloads that came through, the last sound frame included.
    pub accepted: u32,
    /// Frames that were refused.
    pub refused: u32,
    /// Messages that were understood.
    pub understood: u32,
}

/// Carries out a script of three bytes a step: what to do, to which frame, and how.
///
/// # Panics
/// When one of the three things does not hold.
#[must_use]
pub fn carry_out(script: &[u8]) -> Account {
    let mut line = Line { decoder: Decoder::new(), sent: Vec::new(), account: Account::default() };
    for [act, which, how] in script.as_chunks::<3>().0.iter().take(MAX_STEPS) {
        line.act(*act, example(*which), *how);
    }
    // The zero ends what is under way.
    line.feed(&[0]);
    let before = line.account;
    let last = example(0);
    line.send(&last, &|_: &mut Wire| {});
    assert_eq!(line.account, Account { accepted: before.accepted + 1, understood: before.understood + 1, ..before }, "a frame is lost");
    line.account
}

/// One of the sound payloads.
fn example(which: u8) -> Payload {
    let request = |request| RequestFrame { token: u32::from(which), session: 7, request }.to_wire();
    let wire = match which % 7 {
        0 => request(Request::Vent),
        1 => request(Request::ModelChunk { offset: 512, bytes: (0..=u8::MAX).collect() }),
        2 => {
            let values_bar = (0..32u8).map(f32::from).collect();
            request(Request::Playback(PlaybackChunk { first_index: u32::from(which), last: which > 99, values_bar }))
        }
        3 => {
            let status = Status { time_ms: u64::MAX, damaged_frames: u32::from(which), ..Status::default() };
            ReplyFrame { token: 300, reply: Reply::Status(status) }.to_wire()
        }
        4 => Telemetry { time_ms: 1 << 40, estimate_mm: Some(f32::from(which)), output_ubar: -1, ..Telemetry::default() }.to_wire(),
        5 => TracePiece { offset: u32::MAX, bytes: (0..which).collect() }.to_wire(),
        _ => Ok(frame::encode(&[Kind::HelloRequest.byte(), which]).unwrap_or_default()),
    };
    let mut decoder = Decoder::new();
    let mut payload = Payload::new();
    for byte in wire.unwrap_or_default() {
        if let Some(Ok(sound)) = decoder.push(byte) {
            let _ = payload.extend_from_slice(sound);
        }
    }
    payload
}

struct Line {
    decoder: Decoder,
    sent: Vec<Payload, { MAX_STEPS + 1 }>,
    account: Account,
}

impl Line {
    fn act(&mut self, act: u8, mut payload: Payload, how: u8) {
        let place = usize::from(how);
        match act % 8 {
            0 | 1 => self.send(&payload, &|_| {}),
            2 => self.send(&payload, &|wire| flip(wire, place)),
            // A burst: up to four bytes in a row.
            3 => self.send(&payload, &|wire| (0..=place % 4).for_each(|byte| flip(wire, place + 8 * byte))),
            4 => self.send(&payload, &|wire| wire.truncate(1 + place % wire.len())),
            // The zero that ends it is lost, and with the next frame it is one.
            5 => self.send(&payload, &|wire| wire.truncate(wire.len() - 1)),
            6 => {
                let mut noise = u32::from(how) + 1;
                for _ in 0..=place {
                    noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    self.feed(&noise.to_be_bytes()[..1]);
                }
            }
            // Behind the checksum as well: what else could come from a host of another version.
            _ => {
                flip(&mut payload, place);
                payload.truncate(1 + usize::from(how.rotate_left(3)) % payload.len());
                self.send(&payload, &|_| {});
            }
        }
    }

    /// Sends a payload as a frame that something happens to on its way.
    fn send(&mut self, payload: &Payload, happens: &dyn Fn(&mut Wire)) {
        let Ok(mut wire) = frame::encode(payload) else { return };
        assert!(self.sent.push(payload.clone()).is_ok(), "there is room for all");
        happens(&mut wire);
        self.feed(&wire);
    }

    fn feed(&mut self, bytes: &[u8]) {
        let Self { decoder, sent, account } = self;
        for byte in bytes {
            match decoder.push(*byte) {
                None => {}
                Some(Err(_)) => account.refused += 1,
                Some(Ok(payload)) => {
                    assert!(sent.iter().any(|sent| sent == payload), "nobody sent {payload:02x?}");
                    account.accepted += 1;
                    let hello = payload.first() == Some(&Kind::HelloRequest.byte()) || Hello::decode(payload).is_ok();
                    let understood = understand::<RequestFrame>(payload)
                        | understand::<ReplyFrame>(payload)
                        | understand::<Telemetry>(payload)
                        | understand::<TracePiece>(payload);
                    account.understood += u32::from(hello | understood);
                }
            }
        }
    }
}

/// Whether a payload is a message; one that is says the same when it is written and read again.
fn understand<T: Message>(payload: &[u8]) -> bool {
    let Ok(message) = T::from_payload(payload) else { return false };
    let again = message.to_wire();
    let mut decoder = Decoder::new();
    for byte in again.as_deref().unwrap_or(&[]) {
        if let Some(Ok(payload)) = decoder.push(*byte) {
            // By their bytes, since a number that is none equals nothing.
            let twice = T::from_payload(payload).and_then(|message| message.to_wire());
            assert_eq!(twice, again, "a message changed on its way");
            return true;
        }
    }
    panic!("a message that was read fits no frame");
}

fn flip(bytes: &mut [u8], bit: usize) {
    let length = bytes.len();
    if let Some(byte) = bytes.get_mut(bit / 8 % length.max(1)) {
        *byte ^= 1 << (bit % 8);
    }
}
