//! A real redis-server for one test: free port, its own directory, stopped on drop.

use std::net::TcpListener;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use super::super::connection::Connection;
use crate::model::Digest;

pub(super) struct Server {
    child: Child,
    port: u16,
    directory: tempfile::TempDir,
    arguments: Vec<String>,
}

impl Server {
    /// Starts a server; `None` (and a message) if none is installed.
    pub(super) fn start(arguments: &[&str]) -> Option<Self> {
        let installed = Command::new("redis-server").arg("--version").stdout(Stdio::null()).status();
        if installed.is_err() {
            println!("SKIPPED a test of the cache: redis-server is not installed");
            return None;
        }
        let directory = tempfile::tempdir().expect("temporary directory");
        let arguments: Vec<String> = arguments.iter().map(|argument| (*argument).to_owned()).collect();
        // Another process may take the free port first: then tries the next one.
        for _ in 0..5 {
            let port = TcpListener::bind("127.0.0.1:0").and_then(|l| l.local_addr()).expect("a free port").port();
            let mut child = spawn(port, directory.path(), &arguments);
            if answers(port, &mut child) {
                return Some(Self { child, port, directory, arguments });
            }
        }
        panic!("redis-server does not start");
    }

    pub(super) fn url(&self) -> String {
        format!("redis://127.0.0.1:{}/0", self.port)
    }

    pub(super) fn socket_url(&self) -> String {
        format!("redis+unix://{}", self.directory.path().join("redis.sock").display())
    }

    fn ask<T: redis::FromRedisValue>(&self, words: &[&str]) -> T {
        let info = redis::IntoConnectionInfo::into_connection_info(self.url()).expect("a URL");
        let mut connection = Connection::open(&info, None).expect("connects");
        redis::cmd(words[0]).arg(&words[1..]).query(&mut connection).expect("done")
    }

    pub(super) fn command(&self, words: &[&str]) {
        let _: String = self.ask(words);
    }

    pub(super) fn has(&self, digest: Digest) -> bool {
        self.ask(&["EXISTS", &format!("authros:{digest}")])
    }

    pub(super) fn signal(&self, name: &str) {
        let sent = Command::new("kill").arg(format!("-{name}")).arg(self.child.id().to_string()).status();
        assert!(sent.is_ok_and(|status| status.success()), "the signal is sent");
    }

    pub(super) fn kill(&mut self) {
        self.child.kill().expect("killed");
        self.child.wait().expect("ended");
    }

    pub(super) fn revive(&mut self) {
        self.child = spawn(self.port, self.directory.path(), &self.arguments);
        assert!(answers(self.port, &mut self.child), "redis-server does not come back");
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn spawn(port: u16, directory: &std::path::Path, arguments: &[String]) -> Child {
    Command::new("redis-server")
        .args(["--port", &port.to_string(), "--bind", "127.0.0.1", "--save", "", "--daemonize", "no"])
        .args(["--unixsocket", "redis.sock", "--dir"])
        .arg(directory)
        .args(arguments)
        .current_dir(directory)
        .stdout(Stdio::null())
        .spawn()
        .expect("redis-server starts")
}

fn answers(port: u16, child: &mut Child) -> bool {
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(10) && child.try_wait().is_ok_and(|ended| ended.is_none()) {
        if std::net::TcpStream::connect(("127.0.0.1", port)).is_ok() {
            return true;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    false
}
