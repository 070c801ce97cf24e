//! `authros-ros2 --domain N [--publish]`: started by a site of AuthROS, with a pipe as its input and output. It reads the
//! domain, or publishes in it. It has no keys, and is of no use alone.

mod inherited;

use std::fs::File;
use std::os::fd::AsFd;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// The largest address space: memory that the network makes this process take is bounded here; the site restarts it.
const MOST_MEMORY: u64 = 2 << 30;

/// The highest domain with valid ports.
const HIGHEST_DOMAIN: u16 = 232;

fn main() -> ExitCode {
    inherited::close();
    let Some((domain, publishes)) = purpose() else {
        return fail(
            "usage: authros-ros2 --domain N (0 to 232); authros --ros2 starts this program, do not run it by hand",
        );
    };
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT, signal_hook::consts::SIGHUP] {
        if signal_hook::flag::register(signal, Arc::clone(&stop)).is_err() {
            return fail("cannot listen for signals; start it again");
        }
    }
    bound_memory();
    let pipes = (std::io::stdin().as_fd().try_clone_to_owned(), std::io::stdout().as_fd().try_clone_to_owned());
    let (Ok(from), Ok(to)) = pipes else { return fail("its input or output is closed; start it with authros --ros2") };
    let (from, to) = (File::from(from), File::from(to));
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

/// A limit that cannot be set is no reason not to work.
fn bound_memory() {
    let maximum = getrlimit(Resource::As).maximum;
    let most = maximum.map_or(MOST_MEMORY, |maximum| maximum.min(MOST_MEMORY));
    let _ = setrlimit(Resource::As, Rlimit { current: Some(most), maximum: Some(most) });
    let _ = setrlimit(Resource::Core, Rlimit { current: Some(0), maximum: Some(0) });
}

fn fail(reason: &str) -> ExitCode {
    use std::io::Write;
    drop(writeln!(std::io::stderr(), "authros-ros2: {reason}"));
    ExitCode::FAILURE
}
