//! Child processes that never outlive a test and never hang it.

use std::io::Read;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serde_json::Value;

/// How a process ended, and its output.
#[derive(Debug)]
pub struct Outcome {
    /// What was run.
    pub command: String,
    /// Exit code; `None` if a signal ended it.
    pub code: Option<i32>,
    /// The signal that ended it.
    pub signal: Option<i32>,
    /// Its standard output.
    pub stdout: String,
    /// Its standard error.
    pub stderr: String,
}

impl Outcome {
    /// Fails the test unless the process ended with `code`.
    pub fn expect_code(self, code: i32) -> Self {
        assert_eq!(self.code, Some(code), "{self}");
        self
    }

    /// Lines of a log in JSON: whatever was written, each line is an object, and on stderr one with these four fields.
    pub fn log(&self) -> Vec<Value> {
        let object = |line: &str| serde_json::from_str::<Value>(line).unwrap_or_else(|_| panic!("no JSON: {line}"));
        assert!(self.stdout.lines().map(object).all(|line| line.is_object()), "{self}");
        let lines: Vec<Value> = self.stderr.lines().map(object).collect();
        for line in &lines {
            let mut fields: Vec<&String> = line.as_object().expect("an object").keys().collect();
            fields.sort();
            assert_eq!(fields, ["level", "message", "source", "time"], "{line}");
            let time = line["time"].as_str().expect("a time");
            assert!(time.len() == 24 && time.ends_with('Z') && &time[19..20] == ".", "milliseconds: {time}");
            assert!(["info", "warning", "error"].iter().any(|level| line["level"] == *level), "{line}");
        }
        lines
    }

    /// The one JSON document that is all of standard output.
    pub fn document(&self) -> Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|error| panic!("not one JSON document ({error}): {self}"))
    }
}

impl std::fmt::Display for Outcome {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let end = self.code.map_or(format!("signal {:?}", self.signal), |code| format!("exit {code}"));
        let out = tail(&self.stdout);
        let error = tail(&self.stderr);
        write!(formatter, "{} -> {end}\n--- stdout\n{out}\n--- stderr\n{error}\n---", self.command)
    }
}

fn tail(text: &str) -> &str {
    const MOST: usize = 6_000;
    &text[text.ceil_char_boundary(text.len().saturating_sub(MOST))..]
}

#[derive(Debug)]
struct Pipe {
    bytes: Arc<Mutex<Vec<u8>>>,
    reader: JoinHandle<()>,
}

impl Pipe {
    fn new(mut source: impl Read + Send + 'static) -> Self {
        let bytes = Arc::new(Mutex::new(Vec::new()));
        let sink = Arc::clone(&bytes);
        let reader = std::thread::spawn(move || {
            let mut buffer = [0; 8192];
            while let Ok(length @ 1..) = source.read(&mut buffer) {
                sink.lock().unwrap_or_else(PoisonError::into_inner).extend_from_slice(&buffer[..length]);
            }
        });
        Self { bytes, reader }
    }

    fn text(&self) -> String {
        String::from_utf8_lossy(&self.bytes.lock().unwrap_or_else(PoisonError::into_inner)).into_owned()
    }

    /// A grandchild may hold the pipe open forever, so waiting for the reader has a limit.
    fn settle(&self) {
        let end = Instant::now() + Duration::from_secs(2);
        while !self.reader.is_finished() && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

/// Memory of a process that is its own, KiB: without pages of files, which the system takes back at will.
pub fn own_memory(process: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).expect("it runs");
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:")).expect("its memory");
    line.trim().trim_end_matches(" kB").parse().expect("a number")
}

/// The most memory that a process ever held, KiB; `None` once it has ended.
pub fn peak_memory(process: u32) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.trim().trim_end_matches(" kB").parse().ok()
}

/// A running process of a test; killed with its process group when dropped.
#[derive(Debug)]
pub struct Running {
    command: String,
    child: Child,
    stdout: Pipe,
    stderr: Pipe,
}

/// The parent of the tests may ignore signals (`nohup`, a shell's `&`); the program under test starts as from a login
/// shell.
#[allow(unsafe_code, reason = "between fork and exec only signal(2) is called, which is async-signal-safe")]
fn default_signals(command: &mut Command) {
    // SAFETY: the closure calls nothing but signal(2) and touches no memory of the parent.
    unsafe {
        command.pre_exec(|| {
            for number in [libc::SIGHUP, libc::SIGINT, libc::SIGQUIT, libc::SIGTERM] {
                libc::signal(number, libc::SIG_DFL);
            }
            Ok(())
        });
    }
}

impl Running {
    /// Starts it, without a terminal and with nothing to read.
    pub fn start(mut command: Command) -> Self {
        let name = format!("{command:?}");
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).process_group(0);
        default_signals(&mut command);
        let mut child = command.spawn().unwrap_or_else(|error| panic!("{name}: {error}"));
        let stdout = Pipe::new(child.stdout.take().expect("stdout is piped"));
        let stderr = Pipe::new(child.stderr.take().expect("stderr is piped"));
        Self { command: name, child, stdout, stderr }
    }

    /// Its process id.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Its standard output so far.
    pub fn stdout(&self) -> String {
        self.stdout.text()
    }

    /// Its standard error so far.
    pub fn stderr(&self) -> String {
        self.stderr.text()
    }

    /// Whether it still runs.
    pub fn is_running(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// Sends it a signal by name: `INT`, `TERM`, `KILL`.
    pub fn signal(&self, name: &str) {
        signal(name, &self.child.id().to_string());
    }

    /// Fails the test if it has ended.
    pub fn expect_running(&mut self) {
        if let Ok(Some(status)) = self.child.try_wait() {
            panic!("ended too early: {}", self.outcome(status));
        }
    }

    /// Waits until one of its outputs contains `text`; fails the test if it ends or takes too long.
    pub fn wait_for_text(&mut self, text: &str, seconds: u64) -> String {
        let end = Instant::now() + Duration::from_secs(seconds);
        loop {
            let said = self.stdout() + &self.stderr();
            if said.contains(text) {
                return said;
            }
            self.expect_running();
            assert!(Instant::now() < end, "{}: no '{text}' within {seconds} s, only\n{said}", self.command);
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Waits for its end; after `seconds` it is killed and the test fails with its output.
    pub fn wait(mut self, seconds: u64) -> Outcome {
        let end = Instant::now() + Duration::from_secs(seconds);
        loop {
            match self.child.try_wait() {
                Ok(Some(status)) => return self.outcome(status),
                Ok(None) if Instant::now() < end => std::thread::sleep(Duration::from_millis(10)),
                result => {
                    self.kill();
                    let said = (self.stdout(), self.stderr());
                    panic!("{}: not done within {seconds} s ({result:?})\n{}\n{}", self.command, said.0, said.1);
                }
            }
        }
    }

    /// Sends a signal and waits for the end.
    pub fn stop(self, name: &str, seconds: u64) -> Outcome {
        self.signal(name);
        self.wait(seconds)
    }

    fn outcome(&self, status: ExitStatus) -> Outcome {
        self.stdout.settle();
        self.stderr.settle();
        Outcome {
            command: self.command.clone(),
            code: status.code(),
            signal: status.signal(),
            stdout: self.stdout(),
            stderr: self.stderr(),
        }
    }

    /// What a test that fails is to say of each process that it began.
    #[allow(clippy::print_stdout, reason = "the output of a test")]
    fn tell_last_words(&mut self) {
        const LINES: usize = 8;
        let (running, said) = (self.is_running(), self.stderr());
        let lines: Vec<&str> = said.lines().collect();
        let last = lines[lines.len().saturating_sub(LINES)..].join("\n");
        println!("last words of {} ({}):\n{last}", self.command, if running { "running" } else { "ended" });
    }

    fn kill(&mut self) {
        signal("KILL", &format!("-{}", self.child.id()));
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.tell_last_words();
        }
        self.kill();
    }
}

/// Sends a signal to a process, or with a leading `-` to a process group.
pub fn signal(name: &str, target: &str) {
    let mut shell = Command::new("sh");
    shell.args(["-c", "kill -s \"$0\" -- \"$1\"", name, target]).stderr(Stdio::null());
    drop(shell.status());
}

/// Runs a program to its end and returns its standard output; fails the test unless it succeeds.
pub fn output_of(program: &str, arguments: &[&str]) -> String {
    let mut command = Command::new(program);
    command.args(arguments);
    Running::start(command).wait(60).expect_code(0).stdout
}
