//! `authros-ros2 --domain N [--publish]`: started by a site of AuthROS, with a pipe as its input and output. It reads the
//! domain, or publishes in it. It has no keys, and is of no use alone.

use std::process::ExitCode;

use authros_keyless::{ATTEMPT, Begun, Memory, Network, attempt_all, begin, close_inherited};

/// The largest address space: memory that the network makes this process take is bounded here; the site restarts it.
const MOST_MEMORY: u64 = 2 << 30;

/// More are not looked at.
const MOST_ARGUMENTS: usize = 16;
/// The highest domain with valid ports.
const HIGHEST_DOMAIN: u16 = 232;

fn main() -> ExitCode {
    close_inherited();
    let arguments: Vec<String> = std::env::args().skip(1).take(MOST_ARGUMENTS).collect();
    let Some(purpose) = purpose(&arguments) else {
        return fail(
            "usage: authros-ros2 --domain N (0 to 232); authros --ros2 starts this program, do not run it by hand",
        );
    };
    let begun = match begin(Memory::AddressSpace(MOST_MEMORY), Network::Datagrams) {
        Ok(begun) => begun,
        Err(reason) => return fail(reason),
    };
    let done = match purpose {
        Purpose::Attempt(paths) => attempt_all(paths, begun).map_err(str::to_owned),
        Purpose::Read(domain) => read(domain, begun),
        Purpose::Publish(domain) => publish(domain, begun),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(reason) => fail(&reason),
    }
}

fn read(domain: u16, begun: Begun) -> Result<(), String> {
    let Begun { from, to, stop, confined } = begun;
    authros_ros2::run((domain, confined), from, to, &stop).map_err(|error| error.to_string())
}

fn publish(domain: u16, begun: Begun) -> Result<(), String> {
    let Begun { from, to, stop, confined } = begun;
    authros_ros2::publish((domain, confined), from, to, &stop).map_err(|error| error.to_string())
}

/// What it was started for.
enum Purpose<'a> {
    /// To read a domain.
    Read(u16),
    /// To publish in one.
    Publish(u16),
    /// To try to open what it should not.
    Attempt(&'a [String]),
}

fn purpose(arguments: &[String]) -> Option<Purpose<'_>> {
    let domain = |value: &str| value.parse::<u16>().ok().filter(|domain| *domain <= HIGHEST_DOMAIN);
    match arguments {
        [first, paths @ ..] if first == ATTEMPT => Some(Purpose::Attempt(paths)),
        [first, value] if first == "--domain" => Some(Purpose::Read(domain(value)?)),
        [first, value, last] if first == "--domain" && last == "--publish" => Some(Purpose::Publish(domain(value)?)),
        _ => None,
    }
}

fn fail(reason: &str) -> ExitCode {
    use std::io::Write;
    drop(writeln!(std::io::stderr(), "authros-ros2: {reason}"));
    ExitCode::FAILURE
}
