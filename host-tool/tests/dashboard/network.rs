//! A network between browser and server that can fail.

use std::io::{Read, Write};
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Instant;

/// How a network fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Failure {
    /// Nothing arrives any more, and no end learns of it: the cable is pulled.
    Silent = 1,
    /// Both ends see the connection closed.
    Closed = 2,
}

const WORKS: u8 = 0;

/// Passes the bytes of every connection on to a server on this machine, until it fails.
pub struct Network {
    state: Arc<AtomicU8>,
    streams: Arc<Mutex<Vec<TcpStream>>>,
}

impl Network {
    /// At this address of the machine's own network, with the server's port.
    pub fn before(port: u16, address: Ipv4Addr) -> Self {
        let listener = TcpListener::bind((address, port)).expect("the server listens at another address");
        let network = Self { state: Arc::new(AtomicU8::new(WORKS)), streams: Arc::default() };
        let (state, streams) = (Arc::clone(&network.state), Arc::clone(&network.streams));
        thread::spawn(move || {
            for client in listener.incoming().flatten() {
                // A client that comes while the network is down waits for ever.
                let server = TcpStream::connect(("127.0.0.1", port)).expect("the server listens");
                for (from, to) in [(&client, &server), (&server, &client)] {
                    let (from, to) = (from.try_clone().expect("a socket"), to.try_clone().expect("a socket"));
                    let state = Arc::clone(&state);
                    thread::spawn(move || pass(from, to, &state));
                }
                streams.lock().unwrap_or_else(PoisonError::into_inner).extend([client, server]);
            }
        });
        network
    }

    /// Fails from now on, and tells since when.
    pub fn fail(&self, failure: Failure) -> Instant {
        let died = Instant::now();
        self.state.store(failure as u8, Ordering::SeqCst);
        if failure == Failure::Closed {
            let streams = self.streams.lock().unwrap_or_else(PoisonError::into_inner);
            // One that has ended already cannot be closed.
            streams.iter().for_each(|stream| _ = stream.shutdown(Shutdown::Both));
        }
        died
    }
}

/// Passes on what arrives while the network works; afterwards it is lost.
fn pass(mut from: TcpStream, mut to: TcpStream, state: &AtomicU8) {
    let mut bytes = [0; 16 << 10];
    while let Ok(count @ 1..) = from.read(&mut bytes) {
        if state.load(Ordering::SeqCst) == WORKS && to.write_all(&bytes[..count]).is_err() {
            break;
        }
    }
    if state.load(Ordering::SeqCst) == WORKS {
        let _ = to.shutdown(Shutdown::Write);
    }
}
