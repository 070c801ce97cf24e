//! `authros-ros2 --domain N [--publish]`: started by a site of AuthROS, with a pipe as its input and output. It reads the
//! domain, or publishes in it. It has no keys, and is of no use alone.

use std::process::ExitCode;

use authros_keyless::{Begun, Memory, begin, close_inherited};

/// The largest address space: memory that the network makes this process take is bounded here; the site restarts it.
const MOST_MEMORY: u64 = 2 << 30;

/// The highest domain with valid ports.
const HIGHEST_DOMAIN: u16 = 232;

fn main() -> ExitCode {
    close_inherited();
    let Some((domain, publishes)) = purpose() else {
        return fail(
            "usage: authros-ros2 --domain N (0 to 232); authros --ros2 starts this program, do not run it by hand",
        );
    };
    let Begun { from, to, stop } = match begin(Memory::AddressSpace(MOST_MEMORY)) {
        Ok(begun) => begun,
        Err(reason) => return fail(reason),
    };
    let done = if publishes {
        authros_ros2::publish(domain, from, to, &stop)
    } else {
        authros_ros2::run(domain, from, to, &stop)
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => fail(&error.to_string()),
    }
}

/// The domain, and whether to publish in it.
fn purpose() -> Option<(u16, bool)> {
    let arguments: Vec<String> = std::env::args().skip(1).take(4).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let (value, publishes) = match arguments[..] {
        ["--domain", value] => (value, false),
        ["--domain", value, "--publish"] => (value, true),
        _ => return None,
    };
    let domain = value.parse().ok().filter(|domain| *domain <= HIGHEST_DOMAIN)?;
    Some((domain, publishes))
}

fn fail(reason: &str) -> ExitCode {
    use std::io::Write;
    drop(writeln!(std::io::stderr(), "authros-ros2: {reason}"));
    ExitCode::FAILURE
}
