//! `authros-ros2 --domain N [--publish | --bury PARTICIPANT | --renew-after N]`: started by a site of AuthROS, with a
//! pipe as input and output, to read the domain, publish there, or announce that a killed program is gone.
//! `--renew-after` is for tests.

use std::process::ExitCode;

use authros_keyless::{ATTEMPT, Begun, Memory, Network, attempt_all, begin, close_inherited};

/// Bounds the memory that the network makes this process take; the site restarts it.
const MOST_MEMORY: u64 = 2 << 30;

const MOST_ARGUMENTS: usize = 16;
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

enum Purpose<'a> {
    /// The number replaces its participant after meeting this many endpoints.
    Read(u16, Option<usize>),
    Publish(u16),
    Bury(u16, [u8; 12]),
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
