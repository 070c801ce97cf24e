//! Walls by Landlock and seccomp: the program opens only the files named here, starts no program and reaches no local
//! socket, not even one of its own user. They need no privilege, and nothing inside can remove them.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io;
use std::os::unix::fs::FileTypeExt;
use std::os::unix::net::UnixStream;
use std::path::Path;

use landlock::{
    ABI, Access, AccessFs, AccessNet, Ruleset, RulesetAttr, RulesetCreatedAttr, RulesetError, RulesetStatus, Scope,
    path_beneath_rules,
};
use nix::libc;
use seccompiler::{
    BackendError, BpfProgram, SeccompAction, SeccompCmpArgLen, SeccompCmpOp, SeccompCondition, SeccompFilter,
    SeccompRule, TargetArch, apply_filter,
};

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
