//! The embedded ROS master, for when no other is given: on a free loopback port, in its own thread, ended on drop.
//! The library's master gives its address and process id in a form that no other does. So a front answers these two and
//! passes every other call on as text.

use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::time::{Duration, Instant};
use std::{sync::Arc, thread::JoinHandle};

use tokio::sync::oneshot;

use crate::tcpros::{failure, success};
use crate::xmlrpc::{Answer, Server, Value, call, forward};
use crate::{Result, RosError, tcpros::Endpoint};

/// Left free for a real roscore.
const USUAL_PORT: u16 = 11311;

const ATTEMPTS: usize = 8;

/// Limit of one attempt, and of one passed-on call.
const PATIENCE: Duration = Duration::from_secs(3);

/// All nodes of a graph call it.
const MOST_CALLS: usize = 512;

pub struct EmbeddedMaster {
    uri: String,
    front: Option<Server>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl EmbeddedMaster {
    /// On a free port of 127.0.0.1; waits until it answers.
    pub fn start() -> Result<Self> {
        let mut failure = String::new();
        for _ in 0..ATTEMPTS {
            match listener().map(|(port, _)| port).and_then(Self::start_on) {
                Ok(master) => return Ok(master),
                Err(reason) => failure = reason,
            }
        }
        Err(RosError::EmbeddedMaster(failure))
    }

    pub fn uri(&self) -> &str {
        &self.uri
    }

    /// An internal fault may have ended it.
    pub fn is_running(&self) -> bool {
        self.thread.as_ref().is_some_and(|thread| !thread.is_finished())
    }

    fn start_on(port: u16) -> Result<Self, String> {
        let runtime =
            tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(|error| error.to_string())?;
        let (stop, stopped) = oneshot::channel();
        let serve = move || {
            runtime.block_on(async {
                let master = ros_core_rs::core::Master::new(&SocketAddr::from((Ipv4Addr::LOCALHOST, port)));
                // Ends if the port was taken meanwhile; the caller notices that nothing answers.
                tokio::select! { _ = master.serve() => {} _ = stopped => {} }
            });
            runtime.shutdown_timeout(Duration::from_millis(200));
        };
        let thread =
            std::thread::Builder::new().name("ros-master".into()).spawn(serve).map_err(|error| error.to_string())?;
        let uri = format!("http://127.0.0.1:{port}/");
        let mut master = Self { uri, front: None, stop: Some(stop), thread: Some(thread) };
        let inside = master.wait()?;
        let (port, listener) = listener()?;
        master.uri = format!("http://127.0.0.1:{port}/");
        let front = Front { uri: master.uri.clone(), inside };
        let server = Server::start(listener, Arc::new(front), MOST_CALLS).map_err(|error| error.to_string())?;
        master.front = Some(server);
        Ok(master)
    }

    /// Waits until this very process answers at the port; returns where.
    fn wait(&self) -> Result<Endpoint, String> {
        let endpoint = Endpoint::parse(&self.uri).ok_or("its address is malformed")?;
        let deadline = Instant::now() + PATIENCE;
        let ours = i64::from(std::process::id());
        let mut reason = String::from("it did not answer in time");
        while Instant::now() < deadline && self.thread.as_ref().is_some_and(|thread| !thread.is_finished()) {
            match call(&endpoint, "getPid", &["/authros".into()], deadline) {
                Ok(pid) if process_id(&pid) == Some(ours) => return Ok(endpoint),
                Ok(_) => return Err(String::from("another program took its port")),
                Err(error) => reason = error.to_string(),
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        Err(reason)
    }
}

struct Front {
    uri: String,
    inside: Endpoint,
}

impl Answer for Front {
    fn answer(&self, method: &str, _params: &[Value]) -> Option<Value> {
        Some(match method {
            "getUri" => success(self.uri.as_str().into()),
            "getPid" => success(Value::Int(i64::from(std::process::id()))),
            _ => failure(-1, "the master did not answer in time"),
        })
    }

    fn handed_on(&self, method: &str, call: &str) -> Option<String> {
        let is_own = matches!(method, "getUri" | "getPid");
        (!is_own).then(|| forward(&self.inside, call, Instant::now() + PATIENCE).ok()).flatten()
    }
}

impl Drop for EmbeddedMaster {
    fn drop(&mut self) {
        self.front.take();
        if let Some(stop) = self.stop.take() {
            // The thread may have ended already.
            let _ = stop.send(());
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// This master wraps the number in an array.
fn process_id(answer: &Value) -> Option<i64> {
    answer.as_array().and_then(<[Value]>::first).unwrap_or(answer).as_int()
}

fn listener() -> Result<(u16, TcpListener), String> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).map_err(|error| error.to_string())?;
    let port = listener.local_addr().map_err(|error| error.to_string())?.port();
    if port == USUAL_PORT { Err(String::from("the default port is left free")) } else { Ok((port, listener)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros::Graph;

    #[test]
    fn it_answers_on_loopback_and_is_gone_after_drop() {
        let first = EmbeddedMaster::start().expect("start");
        let second = EmbeddedMaster::start().expect("a second beside it");
        assert!(first.uri().starts_with("http://127.0.0.1:"));
        assert_ne!(first.uri(), second.uri());
        let graph = Graph::new(first.uri(), "/test").expect("uri");
        graph.ping().expect("answers");
        assert_eq!(graph.topics().expect("empty"), Vec::new());
        let ask = |method: &str, params: &[Value]| {
            let endpoint = Endpoint::parse(first.uri()).expect("an address");
            call(&endpoint, method, params, Instant::now() + PATIENCE)
        };
        assert_eq!(ask("getUri", &["/test".into()]), Ok(first.uri().into()), "as every master says it");
        assert_eq!(ask("getPid", &["/test".into()]), Ok(Value::Int(i64::from(std::process::id()))));
        assert!(
            ask("lookupNode", &["/test".into(), "/nobody".into()])
                .is_err_and(|error| error.to_string().contains("nobody"))
        );
        assert!(ask("noSuchMethod", &[]).is_err());
        drop(first);
        assert!(matches!(graph.ping(), Err(RosError::Unreachable { .. })));
    }
}
