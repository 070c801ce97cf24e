//! A line of any protocol to a port of this machine, which can be cut, made to swallow everything, and mended.

use std::collections::HashMap;
use std::io::{Read, Write};
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// How the line is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    Whole,
    /// Connections are taken and nothing is passed on, in neither direction.
    Mute,
    /// Connections are closed.
    Cut,
}

#[derive(Debug)]
struct Shared {
    state: Mutex<State>,
    upstream: Mutex<u16>,
    open: Mutex<HashMap<u64, [TcpStream; 2]>>,
    ending: AtomicBool,
}

/// A running line; every connection through it ends on drop.
#[derive(Debug)]
pub struct Cable {
    port: u16,
    shared: Arc<Shared>,
    acceptor: Option<JoinHandle<()>>,
}

impl Cable {
    /// A whole one.
    pub fn to(upstream: u16) -> Self {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a free port");
        let port = listener.local_addr().expect("its address").port();
        let (state, upstream) = (Mutex::new(State::Whole), Mutex::new(upstream));
        let shared = Arc::new(Shared { state, upstream, open: Mutex::default(), ending: AtomicBool::new(false) });
        let known = Arc::clone(&shared);
        let acceptor = Some(std::thread::spawn(move || accept(&listener, &known)));
        Self { port, shared, acceptor }
    }

    /// Its own port.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Host and port of its near end.
    pub fn address(&self) -> String {
        format!("127.0.0.1:{}", self.port)
    }

    /// Its far end is another port from now on, for new connections.
    pub fn lead_to(&self, upstream: u16) {
        *lock(&self.shared.upstream) = upstream;
    }

    /// Ends all connections, and each new one at once.
    pub fn cut(&self) {
        self.become_like(State::Cut);
        self.shared.close();
    }

    /// Ends all connections; new ones go on.
    pub fn end_connections(&self) {
        self.shared.close();
    }

    /// Takes everything and passes on nothing.
    pub fn mute(&self) {
        self.become_like(State::Mute);
    }

    /// Passes on everything; what was lost meanwhile stays lost, with its connections.
    pub fn mend(&self) {
        self.shared.close();
        self.become_like(State::Whole);
    }

    fn become_like(&self, state: State) {
        *lock(&self.shared.state) = state;
    }
}

fn lock<Kept>(mutex: &Mutex<Kept>) -> std::sync::MutexGuard<'_, Kept> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    fn is(&self, state: State) -> bool {
        *lock(&self.state) == state
    }

    fn close(&self) {
        for (_, streams) in lock(&self.open).drain() {
            streams.iter().for_each(|stream| drop(stream.shutdown(Shutdown::Both)));
        }
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        self.shared.ending.store(true, Ordering::SeqCst);
        // Wakes the thread that accepts.
        drop(TcpStream::connect((Ipv4Addr::LOCALHOST, self.port)));
        self.shared.close();
        if let Some(acceptor) = self.acceptor.take() {
            drop(acceptor.join());
        }
    }
}

fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    for number in 0.. {
        let Ok((near, _)) = listener.accept() else { return };
        if shared.ending.load(Ordering::SeqCst) {
            return;
        }
        if shared.is(State::Cut) {
            continue;
        }
        let upstream = *lock(&shared.upstream);
        let Ok(far) = TcpStream::connect((Ipv4Addr::LOCALHOST, upstream)) else { continue };
        let twins = [near.try_clone(), far.try_clone()].map(|twin| twin.expect("a second handle"));
        lock(&shared.open).insert(number, twins);
        for (from, to) in [(&near, &far), (&far, &near)] {
            drop(from.set_nodelay(true));
            let (from, to) = (from.try_clone().expect("a handle"), to.try_clone().expect("a handle"));
            let shared = Arc::clone(shared);
            std::thread::spawn(move || {
                pass_on(from, to, &shared);
                if let Some(streams) = lock(&shared.open).remove(&number) {
                    streams.iter().for_each(|stream| drop(stream.shutdown(Shutdown::Both)));
                }
            });
        }
    }
}

/// Until one side closes. What is read while the line is mute is lost, and the connection with it.
fn pass_on(mut from: TcpStream, mut to: TcpStream, shared: &Shared) {
    let (mut buffer, mut lost) = (vec![0; 16 * 1024], false);
    while let Ok(length @ 1..) = from.read(&mut buffer) {
        lost |= shared.is(State::Mute);
        if !lost && to.write_all(&buffer[..length]).is_err() {
            return;
        }
    }
    // A mute line says nothing of the end either.
    while lost && shared.is(State::Mute) && !shared.ending.load(Ordering::SeqCst) {
        std::thread::sleep(Duration::from_millis(20));
    }
}
