//! `authros-rosrust --node NAME`: started by a site of AuthROS with a pipe as input and output, and ROS_MASTER_URI and
//! ROS_HOSTNAME as environment.

use std::process::ExitCode;

use authros_keyless::{ATTEMPT, Begun, Memory, Network, attempt_all, begin, close_inherited};

/// Writable memory. Each topic has three threads, each with a stack.
const MEMORY: Memory = Memory::Data(4 << 30);
const MOST_ARGUMENTS: usize = 16;
const LONGEST: usize = 200;

fn main() -> ExitCode {
    close_inherited();
    let arguments: Vec<String> = std::env::args().skip(1).take(MOST_ARGUMENTS).collect();
    if let [first, paths @ ..] = &arguments[..]
        && first == ATTEMPT
    {
        let done = begin(MEMORY, Network::Streams).and_then(|begun| attempt_all(paths, begun));
        return done.map_or_else(fail, |()| ExitCode::SUCCESS);
    }
    let given = (node(&arguments), std::env::var_os("ROS_MASTER_URI"));
    let (Some(node), Some(_)) = given else {
        return fail(
            "usage: ROS_MASTER_URI=URI authros-rosrust --node NAME; authros starts this program where ros.publisher or \
             --robots-by is rosrust, do not run it by hand",
        );
    };
    let Begun { from, to, stop, confined } = match begin(MEMORY, Network::Streams) {
        Ok(begun) => begun,
        Err(reason) => return fail(reason),
    };
    match authros_rosrust::run((node, confined), from, to, &stop) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => fail(&error.to_string()),
    }
}

/// rosrust reads the arguments too, and would take one with `:=` for a remapping.
fn node(arguments: &[String]) -> Option<&str> {
    let [flag, name] = arguments else { return None };
    let is_name = name.len() <= LONGEST
        && name.starts_with(|first: char| first.is_ascii_alphabetic())
        && name.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_');
    (flag == "--node" && is_name).then_some(name.as_str())
}

fn fail(reason: &str) -> ExitCode {
    use std::io::Write;
    drop(writeln!(std::io::stderr(), "authros-rosrust: {reason}"));
    ExitCode::FAILURE
}
