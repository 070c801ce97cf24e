//! A real Redis server on a free port.

use std::process::Command;

use tempfile::TempDir;

use super::process::Running;
use super::{free_port, system_program};

/// The slots of a cluster's nodes.
const SLOTS: [(&str, &str); 3] = [("0", "5460"), ("5461", "10922"), ("10923", "16383")];

/// A server that persists nothing unless a test asks for it.
#[derive(Debug)]
pub struct Redis {
    server: Option<Running>,
    port: u16,
    /// Where the nodes of a cluster communicate.
    bus: u16,
    directory: TempDir,
    arguments: Vec<String>,
}

impl Redis {
    /// Starts one with more arguments of `redis-server`; `None` if it is not installed.
    pub fn start(arguments: &[&str]) -> Option<Self> {
        system_program("redis-server")?;
        system_program("redis-cli")?;
        let directory = tempfile::Builder::new().prefix("redis").tempdir().expect("a temporary directory");
        let arguments: Vec<String> = arguments.iter().map(|&argument| argument.to_owned()).collect();
        let mut redis = Self { server: None, port: 0, bus: 0, directory, arguments };
        // Another process may take a free port first: then others are tried.
        for _ in 0..5 {
            (redis.port, redis.bus) = (free_port(), free_port());
            if redis.spawn() {
                return Some(redis);
            }
        }
        panic!("redis-server finds no port to listen on");
    }

    /// A cluster of three, which goes on if one of them stops; `None` if Redis is not installed.
    pub fn cluster() -> Option<Vec<Self>> {
        let arguments =
            ["--cluster-enabled", "yes", "--cluster-node-timeout", "1500", "--cluster-require-full-coverage", "no"];
        let nodes = SLOTS.iter().map(|_| Self::start(&arguments)).collect::<Option<Vec<_>>>()?;
        for (redis, (first, last)) in nodes.iter().zip(SLOTS) {
            redis.cli(&["CLUSTER", "ADDSLOTSRANGE", first, last]);
            for other in &nodes {
                redis.cli(&["CLUSTER", "MEET", "127.0.0.1", &other.port().to_string(), &other.bus().to_string()]);
            }
        }
        for redis in &nodes {
            super::wait_until(60, "the cluster is one", || {
                let about = redis.cli(&["CLUSTER", "INFO"]);
                (about.contains("cluster_state:ok") && about.contains("cluster_slots_ok:16384")).then_some(())
            });
        }
        Some(nodes)
    }

    /// The URL of the cluster that this is a node of; the others are learnt.
    pub fn cluster_url(&self) -> String {
        format!("redis+cluster://127.0.0.1:{}", self.port)
    }

    fn spawn(&mut self) -> bool {
        let port = self.port.to_string();
        let mut command = Command::new("redis-server");
        command.args(["--bind", "127.0.0.1", "--port", &port, "--save", "", "--rdbcompression", "no"]);
        if self.arguments.iter().any(|argument| argument == "--cluster-enabled") {
            command.args(["--cluster-port", &self.bus.to_string()]);
        }
        command.arg("--dir").arg(self.directory.path()).args(&self.arguments);
        let mut server = Running::start(command);
        let ready = super::wait_until(30, "redis-server is up or has ended", || {
            let ready = server.stdout().contains("Ready to accept connections");
            (ready || !server.is_running()).then_some(ready)
        });
        self.server = ready.then_some(server);
        ready
    }

    /// Starts it again on the same ports, with its data.
    pub fn revive(&mut self) {
        super::wait_until(30, "redis-server is up again", || self.spawn().then_some(()));
    }

    /// Ends it like a crash.
    pub fn kill(&mut self) {
        if let Some(server) = self.server.take() {
            server.stop("KILL", 20);
        }
    }

    /// Sends it a signal by name: `STOP`, `CONT`.
    pub fn signal(&self, name: &str) {
        self.server.as_ref().expect("it runs").signal(name);
    }

    /// Its port on 127.0.0.1.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// The port of its cluster bus.
    pub fn bus(&self) -> u16 {
        self.bus
    }

    /// Its URL for `--cache`.
    pub fn url(&self) -> String {
        format!("redis://127.0.0.1:{}", self.port)
    }

    /// How many keys it holds.
    pub fn keys(&self) -> u64 {
        self.cli(&["DBSIZE"]).trim().parse().expect("a number of keys")
    }

    /// One command through Redis's own client.
    pub fn cli(&self, arguments: &[&str]) -> String {
        let port = self.port.to_string();
        super::process::output_of("redis-cli", &[&["-h", "127.0.0.1", "-p", &port], arguments].concat())
    }

    /// All its contents, as the bytes of its own uncompressed dump file.
    pub fn dump(&self) -> Vec<u8> {
        assert_eq!(self.cli(&["SAVE"]).trim(), "OK");
        std::fs::read(self.directory.path().join("dump.rdb")).expect("the dump is there")
    }
}
