//! A real Redis server on a free port.

use std::process::Command;

use tempfile::TempDir;

use super::process::Running;
use super::{free_port, system_program};

/// A server that keeps nothing unless a test asks for it.
#[derive(Debug)]
pub struct Redis {
    server: Option<Running>,
    port: u16,
    directory: TempDir,
    arguments: Vec<String>,
}

impl Redis {
    /// Starts one with more arguments of `redis-server`; `None` where it is not installed.
    pub fn start(arguments: &[&str]) -> Option<Self> {
        system_program("redis-server")?;
        system_program("redis-cli")?;
        let directory = tempfile::Builder::new().prefix("redis").tempdir().expect("a temporary directory");
        let port = free_port();
        let arguments = arguments.iter().map(|&argument| argument.to_owned()).collect();
        let mut redis = Self { server: None, port, directory, arguments };
        redis.start_again();
        Some(redis)
    }

    /// Kills it; what it holds is what it has written down.
    pub fn kill(&mut self) {
        if let Some(server) = self.server.take() {
            server.stop("KILL", 10);
        }
    }

    /// Starts it again at the same place, over the same files.
    pub fn start_again(&mut self) {
        let mut command = Command::new(system_program("redis-server").expect("it was there before"));
        command.args(["--bind", "127.0.0.1", "--port", &self.port.to_string(), "--save", "", "--rdbcompression", "no"]);
        command.arg("--dir").arg(self.directory.path()).args(&self.arguments);
        let mut server = Running::start(command);
        server.wait_for_text("Ready to accept connections", 30);
        self.server = Some(server);
    }

    /// Its URL for `--vault`.
    pub fn url(&self) -> String {
        format!("redis://127.0.0.1:{}", self.port)
    }

    /// One command through Redis's own client.
    pub fn cli(&self, arguments: &[&str]) -> String {
        let port = self.port.to_string();
        super::process::output_of("redis-cli", &[&["-h", "127.0.0.1", "-p", &port], arguments].concat())
    }

    /// Everything it holds, as the bytes of its own uncompressed dump file.
    pub fn dump(&self) -> Vec<u8> {
        assert_eq!(self.cli(&["SAVE"]).trim(), "OK");
        std::fs::read(self.directory.path().join("dump.rdb")).expect("the dump is there")
    }
}
