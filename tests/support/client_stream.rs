//! A connection to a gateway that records what the client sends, so that it can be replayed.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex, PoisonError};

/// Forwards bytes and records what the client sent.
pub struct Recorder {
    pub address: String,
    streams: Arc<Mutex<Vec<Vec<u8>>>>,
}

impl Recorder {
    /// One in front of a gateway.
    pub fn before(upstream: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = listener.local_addr().expect("an address").to_string();
        let streams: Arc<Mutex<Vec<Vec<u8>>>> = Arc::default();
        let (kept, upstream) = (Arc::clone(&streams), upstream.to_owned());
        std::thread::spawn(move || {
            for client in listener.incoming().flatten() {
                let Ok(gateway) = TcpStream::connect(&upstream) else { continue };
                let number = {
                    let mut streams = kept.lock().unwrap_or_else(PoisonError::into_inner);
                    streams.push(Vec::new());
                    streams.len() - 1
                };
                let (mut from, mut to) = (client.try_clone().expect("clones"), gateway.try_clone().expect("clones"));
                let kept = Arc::clone(&kept);
                std::thread::spawn(move || {
                    let mut buffer = [0; 8192];
                    while let Ok(length @ 1..) = from.read(&mut buffer) {
                        kept.lock().unwrap_or_else(PoisonError::into_inner)[number].extend(&buffer[..length]);
                        if to.write_all(&buffer[..length]).is_err() {
                            return;
                        }
                    }
                    drop(to.shutdown(std::net::Shutdown::Write));
                });
                let (mut from, mut to) = (gateway, client);
                std::thread::spawn(move || std::io::copy(&mut from, &mut to));
            }
        });
        Self { address, streams }
    }

    /// What was sent, connection by connection.
    pub fn recorded(&self) -> Vec<Vec<u8>> {
        self.streams.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}
