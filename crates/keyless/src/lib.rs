//! The start of a program without keys: only the pipe stays open, memory is bounded, files and local sockets are out of
//! reach, and signals end it in order.

use std::fs::{self, File};
use std::io::{self, Write};
use std::os::fd::{AsFd, RawFd};
use std::{collections::BTreeMap, path::Path, process::ExitCode, sync::Arc, sync::atomic::AtomicBool};
use std::{os::unix::fs::FileTypeExt, os::unix::net::UnixStream};

use landlock::{
    ABI, Access, AccessFs, AccessNet, Ruleset, RulesetAttr, RulesetCreatedAttr, RulesetError, RulesetStatus, Scope,
    path_beneath_rules,
};
use nix::libc;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use seccompiler::{
    BackendError, BpfProgram, SeccompAction, SeccompCmpArgLen, SeccompCmpOp, SeccompCondition, SeccompFilter,
    SeccompRule, TargetArch, apply_filter,
};

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
    let confined = raise(network);
    Ok(Begun { from: File::from(from), to: File::from(to), stop, confined })
}

/// Reports for each path whether it opens, for a test of the walls.
pub fn attempt_all(paths: &[String], confined: bool, mut to: File) -> Result<(), &'static str> {
    let line = |path: &String| {
        let outcome = attempt(Path::new(path));
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

// Walls by Landlock and seccomp: the program opens only the files named here, starts no program and reaches no local
// socket, not even one of its own user. They need no privilege, and nothing inside can remove them.

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Network {
    /// UDP alone, by address: no TCP, no host names.
    Datagrams,
    Streams,
}

/// For its threads and processors. Secrets of other processes in it need the right to trace them, which Landlock takes.
const PROCESSES: &[&str] = &["/proc"];
/// Read by the C library to resolve a name.
const HOST_NAMES: &[&str] = &[
    "/etc/hosts",
    "/etc/host.conf",
    "/etc/nsswitch.conf",
    "/etc/resolv.conf",
    "/etc/gai.conf",
    "/etc/ld.so.cache",
    "/run/systemd/resolve",
    "/lib",
    "/lib64",
    "/usr/lib",
    "/usr/lib64",
];
/// An older kernel applies the part of it that it knows.
const INTERFACE: ABI = ABI::V6;
/// The second set of x86-64's system call numbers.
const OTHER_NUMBERS: i64 = 0x4000_0000;

/// Bits of a socket's type beside its flags.
const KIND_OF_SOCKET: u64 = 0xf;

pub fn raise(network: Network) -> bool {
    let files = raise_around_files(network).unwrap_or(false);
    let sockets = filter().is_ok_and(|filter| apply_filter(&filter).is_ok());
    files && sockets
}

/// False where the kernel has no Landlock.
fn raise_around_files(network: Network) -> Result<bool, RulesetError> {
    let ruleset = Ruleset::default().handle_access(AccessFs::from_all(INTERFACE))?;
    let (ruleset, names) = match network {
        Network::Datagrams => (ruleset.handle_access(AccessNet::from_all(INTERFACE))?, &[][..]),
        Network::Streams => (ruleset, HOST_NAMES),
    };
    let readable = PROCESSES.iter().chain(names);
    let status = ruleset
        .scope(Scope::from_all(INTERFACE))?
        .create()?
        .add_rules(path_beneath_rules(readable, AccessFs::ReadFile | AccessFs::ReadDir))?
        .restrict_self()?;
    Ok(status.ruleset != RulesetStatus::NotEnforced)
}

/// Only network sockets: Landlock of most kernels does not block local ones with a path.
fn filter() -> Result<BpfProgram, BackendError> {
    let mut rules = BTreeMap::new();
    for numbers in [0, OTHER_NUMBERS] {
        rules.insert(libc::SYS_socket | numbers, vec![of_no_network()?]);
        rules.insert(libc::SYS_socketpair | numbers, of_other_pairs()?);
        // Always refused: it makes sockets that no filter sees.
        rules.insert(libc::SYS_io_uring_setup | numbers, Vec::new());
    }
    let refused = SeccompAction::Errno(libc::EACCES.unsigned_abs());
    let machine: TargetArch = std::env::consts::ARCH.try_into()?;
    SeccompFilter::new(rules, SeccompAction::Allow, refused, machine)?.try_into()
}

/// rustdds wakes itself by a pair of streams, which stay connected; other pairs can be pointed elsewhere.
fn of_other_pairs() -> Result<Vec<SeccompRule>, BackendError> {
    let is_of = |kind: i32| {
        let masked = SeccompCmpOp::MaskedEq(KIND_OF_SOCKET);
        let condition = SeccompCondition::new(1, SeccompCmpArgLen::Dword, masked, u64::from(kind.unsigned_abs()))?;
        SeccompRule::new(vec![condition])
    };
    [libc::SOCK_DGRAM, libc::SOCK_RAW, libc::SOCK_SEQPACKET].into_iter().map(is_of).collect()
}

fn of_no_network() -> Result<SeccompRule, BackendError> {
    let mut conditions = Vec::new();
    for family in [libc::AF_INET, libc::AF_INET6, libc::AF_NETLINK] {
        let family = u64::from(family.unsigned_abs());
        conditions.push(SeccompCondition::new(0, SeccompCmpArgLen::Dword, SeccompCmpOp::Ne, family)?);
    }
    SeccompRule::new(conditions)
}

/// Opens a file or connects to a socket, as an intruder in the program would.
pub fn attempt(path: &Path) -> io::Result<()> {
    if fs::symlink_metadata(path)?.file_type().is_socket() {
        return UnixStream::connect(path).map(drop);
    }
    File::open(path).map(drop)
}
