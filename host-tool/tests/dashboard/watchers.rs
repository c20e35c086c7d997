//! Watchers without a browser: what they get, and what it costs the server.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::browser::Served;

/// What a watcher saw.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Seen {
    pub frames: u32,
    pub samples: u32,
    pub missing_frames: u32,
    pub missing_samples: u32,
}

/// Watches until then.
pub fn watch(served: &Served, until: Instant) -> JoinHandle<Seen> {
    let (port, token) = (served.port(), served.token().to_owned());
    std::thread::spawn(move || {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("the server listens");
        write!(
            stream,
            "GET /live HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n\
             Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Protocol: catheter.1, token.{token}\r\n\r\n"
        )
        .expect("it takes a request");
        let mut head = Vec::new();
        while !head.ends_with(b"\r\n\r\n") {
            let mut byte = [0];
            stream.read_exact(&mut byte).expect("it answers");
            head.push(byte[0]);
        }
        assert!(head.starts_with(b"HTTP/1.1 101"), "{}", String::from_utf8_lossy(&head));
        let (mut seen, mut frame, mut sequence) = (Seen::default(), None::<u32>, None::<u32>);
        let mut spoke = Instant::now();
        while Instant::now() < until {
            if spoke.elapsed() > Duration::from_secs(2) {
                spoke = Instant::now();
                // `here`, masked with zeros.
                stream.write_all(&[0x81, 0x84, 0, 0, 0, 0, b'h', b'e', b'r', b'e']).expect("it hears");
            }
            let (kind, payload) = message(&mut stream);
            if kind != 2 {
                continue;
            }
            let whole = |at: usize| u32::from_le_bytes(payload[at..at + 4].try_into().expect("four bytes"));
            let (number, count) = (whole(4), whole(8));
            seen.frames += 1;
            seen.missing_frames += frame.map_or(0, |last| number.saturating_sub(last + 1));
            frame = Some(number);
            for nth in 0..count as usize {
                let own = whole(16 + 56 * nth + 8);
                seen.missing_samples += sequence.map_or(0, |last| own.wrapping_sub(last + 1));
                sequence = Some(own);
                seen.samples += 1;
            }
        }
        seen
    })
}

/// A whole message of the server: these are never in pieces.
fn message(stream: &mut TcpStream) -> (u8, Vec<u8>) {
    let mut head = [0; 2];
    stream.read_exact(&mut head).expect("a message");
    let length = match head[1] {
        126 => {
            let mut long = [0; 2];
            stream.read_exact(&mut long).expect("its length");
            u16::from_be_bytes(long).into()
        }
        127 => {
            let mut long = [0; 8];
            stream.read_exact(&mut long).expect("its length");
            u64::from_be_bytes(long) as usize
        }
        short => short.into(),
    };
    let mut payload = vec![0; length];
    stream.read_exact(&mut payload).expect("its payload");
    (head[0] & 15, payload)
}

/// Seconds of processor time that a process has taken; a tick of the clock is 10 ms on every Linux.
pub fn processor_s(process: u32) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).expect("the process is there");
    let fields: Vec<&str> = stat.rsplit(')').next().expect("its fields").split_whitespace().collect();
    let ticks = |at: usize| fields[at].parse::<f64>().expect("a number");
    (ticks(11) + ticks(12)) / 100.0
}
