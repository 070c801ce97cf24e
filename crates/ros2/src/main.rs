//! `authros-ros2 --domain N [--publish | --bury PARTICIPANT | --renew-after N]`: started by a site of AuthROS, with a
//! pipe as input and output, to read the domain, publish there, or announce that a killed program is gone.
//! `--renew-after` is for tests.

use std::process::ExitCode;

use authros_keyless::{ATTEMPT, Begun, Memory, Network, arguments, attempt_all, begin, finish};

/// Bounds the memory that the network makes this process take; the site restarts it.
const MOST_MEMORY: u64 = 2 << 30;

const HIGHEST_DOMAIN: u16 = 232;

fn main() -> ExitCode {
    finish("authros-ros2", run(&arguments()))
}

fn run(arguments: &[String]) -> Result<(), String> {
    let usage = "usage: authros-ros2 --domain N (0 to 232); authros --ros2 starts this program, do not run it by hand";
    let purpose = purpose(arguments).ok_or(usage)?;
    let Begun { from, to, stop, confined } = begin(Memory::AddressSpace(MOST_MEMORY), Network::Datagrams)?;
    let done = match purpose {
        Purpose::Attempt(paths) => return Ok(attempt_all(paths, confined, to)?),
        Purpose::Read(domain, renew_after) => authros_ros2::run((domain, confined), renew_after, from, to, &stop),
        Purpose::Publish(domain) => authros_ros2::publish((domain, confined), from, to, &stop),
        Purpose::Bury(domain, participant) => {
            authros_ros2::bury(domain, &participant);
            Ok(())
        }
    };
    done.map_err(|error| error.to_string())
}

/// What it was started for.
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
