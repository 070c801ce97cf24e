//! `authros-ros2 --domain N [--publish | --bury PARTICIPANT | --renew-after N]`: started by a site of AuthROS, with a pipe as
//! its input and output. It reads the domain, publishes in it, or says there that one of its kind was killed. Tests have it
//! replace its participant sooner. It has no keys, and is of no use alone.

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
        Purpose::Read(domain, renew_after) => read(domain, renew_after, begun),
        Purpose::Publish(domain) => publish(domain, begun),
        Purpose::Bury(domain, participant) => {
            authros_ros2::bury(domain, &participant);
            Ok(())
        }
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(reason) => fail(&reason),
    }
}

fn read(domain: u16, renew_after: Option<usize>, begun: Begun) -> Result<(), String> {
    let Begun { from, to, stop, confined } = begun;
    authros_ros2::run((domain, confined), renew_after, from, to, &stop).map_err(|error| error.to_string())
}

fn publish(domain: u16, begun: Begun) -> Result<(), String> {
    let Begun { from, to, stop, confined } = begun;
    authros_ros2::publish((domain, confined), from, to, &stop).map_err(|error| error.to_string())
}

/// What it was started for.
enum Purpose<'a> {
    /// To read a domain, and to replace its participant after meeting so many endpoints.
    Read(u16, Option<usize>),
    Publish(u16),
    /// To say in a domain that a participant, by the prefix of its ids, is gone.
    Bury(u16, [u8; 12]),
    /// To try to open what it should not.
    Attempt(&'a [String]),
}

fn purpose(arguments: &[String]) -> Option<Purpose<'_>> {
    let domain = |value: &str| value.parse::<u16>().ok().filter(|domain| *domain <= HIGHEST_DOMAIN);
    match arguments {
        [first, paths @ ..] if first == ATTEMPT => Some(Purpose::Attempt(paths)),
        [first, value] if first == "--domain" => Some(Purpose::Read(domain(value)?, None)),
        [first, value, last, number] if first == "--domain" && last == "--renew-after" => {
            Some(Purpose::Read(domain(value)?, Some(number.parse().ok()?)))
        }
        [first, value, last] if first == "--domain" && last == "--publish" => Some(Purpose::Publish(domain(value)?)),
        [first, value, last, whom] if first == "--domain" && last == "--bury" => {
            Some(Purpose::Bury(domain(value)?, prefix(whom)?))
        }
        _ => None,
    }
}

/// 12 bytes from hex.
fn prefix(hex: &str) -> Option<[u8; 12]> {
    let mut prefix = [0; 12];
    if hex.len() != 2 * prefix.len() {
        return None;
    }
    for (place, byte) in prefix.iter_mut().enumerate() {
        *byte = u8::from_str_radix(hex.get(2 * place..2 * place + 2)?, 16).ok()?;
    }
    Some(prefix)
}

fn fail(reason: &str) -> ExitCode {
    use std::io::Write;
    drop(writeln!(std::io::stderr(), "authros-ros2: {reason}"));
    ExitCode::FAILURE
}
