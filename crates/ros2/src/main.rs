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

const USAGE: &str =
    "usage: authros-ros2 --domain N (0 to 232); authros --ros2 starts this program, do not run it by hand";

fn run(arguments: &[String]) -> Result<(), String> {
    let begin = || begin(Memory::AddressSpace(MOST_MEMORY), Network::Datagrams);
    let domain = |value: &str| value.parse::<u16>().ok().filter(|domain| *domain <= HIGHEST_DOMAIN).ok_or(USAGE);
    let read = |domain, renew_after| {
        let Begun { from, to, stop, confined } = begin()?;
        authros_ros2::run((domain, confined), renew_after, from, to, &stop).map_err(|error| error.to_string())
    };
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        [ATTEMPT, ..] => {
            let Begun { to, confined, .. } = begin()?;
            Ok(attempt_all(&arguments[1..], confined, to)?)
        }
        ["--domain", value] => read(domain(value)?, None),
        ["--domain", value, "--renew-after", number] => read(domain(value)?, Some(number.parse().map_err(|_| USAGE)?)),
        ["--domain", value, "--publish"] => {
            let domain = domain(value)?;
            let Begun { from, to, stop, confined } = begin()?;
            authros_ros2::publish((domain, confined), from, to, &stop).map_err(|error| error.to_string())
        }
        ["--domain", value, "--bury", whom] => {
            let (domain, participant) = (domain(value)?, prefix(whom).ok_or(USAGE)?);
            let _begun = begin()?;
            authros_ros2::bury(domain, &participant);
            Ok(())
        }
        _ => Err(USAGE.to_owned()),
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
