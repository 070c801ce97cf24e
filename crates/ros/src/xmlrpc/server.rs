//! An XML-RPC server for a node's slave API and the embedded master's: one request per connection, a cap on connections and on every size, a
//! deadline on each. It stops on drop.

use std::io::Write as _;
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::http::{Timed, read_message};
use super::parse::parse_call;
use super::value::{Value, write_fault, write_response};

/// The longest request body, bytes.
const LONGEST_REQUEST: usize = 1 << 20;

/// The most connections that a node serves at once; further ones are closed immediately.
pub(crate) const OF_A_NODE: usize = 32;

/// The longest a connection may take.
const LONGEST_CONNECTION: Duration = Duration::from_secs(5);

/// Answers the calls.
pub(crate) trait Answer: Send + Sync + 'static {
    /// The answer to a call; `None` if there is no such method. Must not block.
    fn answer(&self, method: &str, params: &[Value]) -> Option<Value>;

    /// Somebody else's whole response to a whole call, both as text; `None` if [`Self::answer`] is to answer.
    fn handed_on(&self, _method: &str, _call: &str) -> Option<String> {
        None
    }
}

/// A running server.
pub(crate) struct Server {
    address: SocketAddr,
    stopping: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Serves `listener` in its own thread, so many connections at once.
    pub fn start(listener: TcpListener, answer: Arc<dyn Answer>, most: usize) -> std::io::Result<Self> {
        let address = listener.local_addr()?;
        let stopping = Arc::new(AtomicBool::new(false));
        let seen = Arc::clone(&stopping);
        let thread = std::thread::Builder::new()
            .name("ros-slave".into())
            .spawn(move || accept_all(&listener, &seen, &answer, most))?;
        Ok(Self { address, stopping, thread: Some(thread) })
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stopping.store(true, Ordering::SeqCst);
        // Accepting blocks: connecting to ourselves wakes it.
        let woken = TcpStream::connect_timeout(&self.address, Duration::from_millis(500)).is_ok();
        if let Some(thread) = self.thread.take().filter(|_| woken) {
            let _ = thread.join();
        }
    }
}

fn accept_all(listener: &TcpListener, stopping: &AtomicBool, answer: &Arc<dyn Answer>, most: usize) {
    let open = Arc::new(AtomicUsize::new(0));
    while !stopping.load(Ordering::SeqCst) {
        let Ok((stream, _)) = listener.accept() else {
            // Out of descriptors, for example: not a reason to spin.
            std::thread::sleep(Duration::from_millis(20));
            continue;
        };
        if stopping.load(Ordering::SeqCst) || open.load(Ordering::SeqCst) >= most {
            continue;
        }
        let place = Place::take(&open);
        let answer = Arc::clone(answer);
        // Without a thread the peer's connection is closed, and it asks again.
        let _ = std::thread::Builder::new().name("ros-slave-call".into()).spawn(move || {
            let _place = place;
            // A peer that disconnects has only itself to blame.
            let _ = serve(&stream, &*answer);
        });
    }
}

/// One of the places for connections; returned on drop.
struct Place(Arc<AtomicUsize>);

impl Place {
    fn take(open: &Arc<AtomicUsize>) -> Self {
        open.fetch_add(1, Ordering::SeqCst);
        Self(Arc::clone(open))
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

fn serve(stream: &TcpStream, answer: &dyn Answer) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    let deadline = Instant::now() + LONGEST_CONNECTION;
    let (first, body) = read_message(Timed { stream, deadline }, LONGEST_REQUEST, false)?;
    let (status, body) = if first.starts_with("POST ") {
        ("200 OK", respond(&String::from_utf8_lossy(&body), answer))
    } else {
        ("405 Method Not Allowed", String::new())
    };
    let head = format!(
        "HTTP/1.1 {status}\r\nServer: authros\r\nConnection: close\r\nContent-Type: text/xml\r\n\
         Content-Length: {}\r\n\r\n",
        body.len()
    );
    let mut timed = Timed { stream, deadline };
    timed.write_all(head.as_bytes())?;
    timed.write_all(body.as_bytes())?;
    stream.shutdown(Shutdown::Write)
}

fn respond(text: &str, answer: &dyn Answer) -> String {
    match parse_call(text) {
        Ok((method, params)) => {
            answer.handed_on(&method, text).unwrap_or_else(|| match answer.answer(&method, &params) {
                Some(value) => write_response(&value),
                None => write_fault(-32601, "there is no such method"),
            })
        }
        Err(error) => write_fault(-32700, &error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::super::client::{CallError, call};
    use super::*;
    use crate::ros::address::Endpoint;
    use std::io::Read as _;

    struct Echo;

    impl Answer for Echo {
        fn answer(&self, method: &str, params: &[Value]) -> Option<Value> {
            match method {
                "echo" => Some(Value::Array(vec![Value::Int(1), "".into(), Value::Array(params.to_vec())])),
                "no" => Some(Value::Array(vec![Value::Int(-1), "not \u{1b}now".into(), Value::Int(0)])),
                _ => None,
            }
        }
    }

    fn soon() -> Instant {
        Instant::now() + Duration::from_secs(2)
    }

    fn serve_echo() -> (Server, Endpoint) {
        let listener = TcpListener::bind("127.0.0.1:0").expect("bind");
        let uri = format!("http://{}/", listener.local_addr().expect("address"));
        (Server::start(listener, Arc::new(Echo), OF_A_NODE).expect("start"), Endpoint::parse(&uri).expect("uri"))
    }

    #[test]
    fn calls_are_answered_refused_and_unknown() {
        let (server, peer) = serve_echo();
        let params = [Value::text("a<b>&c"), Value::Int(7)];
        assert_eq!(call(&peer, "echo", &params, soon()), Ok(Value::Array(params.to_vec())));
        assert_eq!(call(&peer, "no", &[], soon()), Err(CallError::Refused("not \u{fffd}now".into())));
        assert!(matches!(call(&peer, "other", &[], soon()), Err(CallError::Refused(_))));
        drop(server);
        assert!(matches!(call(&peer, "echo", &[], soon()), Err(CallError::Connect(_))));
    }

    #[test]
    fn a_silent_peer_does_not_hold_the_caller() {
        let listener = TcpListener::bind("127.0.0.1:0").expect("bind");
        let uri = format!("http://{}/", listener.local_addr().expect("address"));
        let peer = Endpoint::parse(&uri).expect("uri");
        let deadline = Instant::now() + Duration::from_millis(100);
        assert!(matches!(call(&peer, "echo", &[], deadline), Err(CallError::Broken(_))));
    }

    #[test]
    fn other_methods_and_noise_do_not_stop_the_server() {
        let (_server, peer) = serve_echo();
        for noise in ["GET / HTTP/1.0\r\n\r\n", "\0\0\0\0\n\n", "POST / HTTP/1.1\r\nContent-Length: 3\r\n\r\nabc"] {
            let mut stream = TcpStream::connect((peer.host.as_str(), peer.port)).expect("connect");
            stream.write_all(noise.as_bytes()).expect("write");
            let mut answer = Vec::new();
            let _ = stream.read_to_end(&mut answer);
            assert!(!answer.starts_with(b"HTTP/1.1 200") || answer.windows(5).any(|part| part == b"fault"));
        }
        assert!(call(&peer, "echo", &[], soon()).is_ok());
    }
}
