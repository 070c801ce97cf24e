//! The start of a program without keys: only the pipe stays open, memory is bounded, files and local sockets are out of
//! reach, and signals end it in order.

mod walls;

use std::fs::File;
use std::io::Write;
use std::os::fd::{AsFd, RawFd};
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

pub use walls::Network;

/// First argument for a trial: see [`attempt_all`].
pub const ATTEMPT: &str = "--attempt";

/// Bound of the memory that peers can make a program take, bytes; the site restarts a program that ends there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Memory {
    AddressSpace(u64),
    /// Writable memory, for many threads: their allocator reserves address space that it does not use.
    Data(u64),
}

#[derive(Debug)]
pub struct Begun {
    pub from: File,
    pub to: File,
    pub stop: Arc<AtomicBool>,
    /// Whether it can open no file and no local socket, whatever misleads it.
    pub confined: bool,
}

/// Input, output and errors come before it.
const FIRST: RawFd = 3;
/// Numbers closed where the system does not list the open ones.
const USUAL_LIMIT: RawFd = 1024;
const MOST_ARGUMENTS: usize = 16;

/// The program's arguments. Closes the files that the site's own starter left open: every child inherits them. Only for
/// the very beginning, while nothing of this process is open.
pub fn arguments() -> Vec<String> {
    let open: Vec<RawFd> = match std::fs::read_dir("/proc/self/fd") {
        Ok(entries) => entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse().ok()).collect(),
        Err(_) => (FIRST..USUAL_LIMIT).collect(),
    };
    for number in open.into_iter().filter(|number| *number >= FIRST) {
        // The folder just read is among them and no longer open.
        let _ = nix::unistd::close(number);
    }
    std::env::args().skip(1).take(MOST_ARGUMENTS).collect()
}

/// Reports why the program `name` failed, if it did.
pub fn finish(name: &str, done: Result<(), String>) -> ExitCode {
    let Err(reason) = done else { return ExitCode::SUCCESS };
    drop(writeln!(std::io::stderr(), "{name}: {reason}"));
    ExitCode::FAILURE
}

/// Bounds the memory, takes pipe and signals, and raises the walls. Only while this is the only thread.
pub fn begin(memory: Memory, network: Network) -> Result<Begun, &'static str> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT, signal_hook::consts::SIGHUP] {
        let registered = signal_hook::flag::register(signal, Arc::clone(&stop));
        registered.map_err(|_| "cannot listen for signals; start it again")?;
    }
    bound(memory);
    let pipes = (std::io::stdin().as_fd().try_clone_to_owned(), std::io::stdout().as_fd().try_clone_to_owned());
    let (Ok(from), Ok(to)) = pipes else { return Err("its input or output is closed; authros has to start it") };
    let confined = walls::raise(network);
    Ok(Begun { from: File::from(from), to: File::from(to), stop, confined })
}

/// Reports for each path whether it opens, for a test of the walls.
pub fn attempt_all(paths: &[String], confined: bool, mut to: File) -> Result<(), &'static str> {
    let line = |path: &String| {
        let outcome = walls::attempt(Path::new(path));
        let word = outcome.map_or_else(|error| format!("{:?}", error.kind()), |()| "reached".to_owned());
        format!("{word} {path}\n")
    };
    let lines: String = paths.iter().map(line).collect();
    write!(to, "confined {confined}\n{lines}").map_err(|_| "its output is closed; authros has to start it")
}

/// A limit that cannot be set does not stop the program.
fn bound(memory: Memory) {
    let (resource, wanted) = match memory {
        Memory::AddressSpace(most) => (Resource::As, most),
        Memory::Data(most) => (Resource::Data, most),
    };
    let most = getrlimit(resource).maximum.map_or(wanted, |maximum| maximum.min(wanted));
    let _ = setrlimit(resource, Rlimit { current: Some(most), maximum: Some(most) });
    let _ = setrlimit(Resource::Core, Rlimit { current: Some(0), maximum: Some(0) });
}
