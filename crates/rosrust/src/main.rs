//! `authros-rosrust --node NAME`: started by a site of AuthROS with a pipe as input and output, and ROS_MASTER_URI and
//! ROS_HOSTNAME as environment.

use std::process::ExitCode;

use authros_keyless::{ATTEMPT, Begun, Memory, Network, arguments, attempt_all, begin, finish};

/// Writable memory. Each topic has three threads, each with a stack.
const MEMORY: Memory = Memory::Data(4 << 30);
const LONGEST: usize = 200;

fn main() -> ExitCode {
    finish("authros-rosrust", run(&arguments()))
}

fn run(arguments: &[String]) -> Result<(), String> {
    if let [first, paths @ ..] = arguments
        && first == ATTEMPT
    {
        let Begun { to, confined, .. } = begin(MEMORY, Network::Streams)?;
        return Ok(attempt_all(paths, confined, to)?);
    }
    let (Some(node), Some(_)) = (node(arguments), std::env::var_os("ROS_MASTER_URI")) else {
        return Err("usage: ROS_MASTER_URI=URI authros-rosrust --node NAME; authros starts this program where \
            ros.publisher or --robots-by is rosrust, do not run it by hand"
            .to_owned());
    };
    let Begun { from, to, stop, confined } = begin(MEMORY, Network::Streams)?;
    authros_rosrust::run((node, confined), from, to, &stop).map_err(|error| error.to_string())
}

/// rosrust reads the arguments too, and would take one with `:=` for a remapping.
fn node(arguments: &[String]) -> Option<&str> {
    let [flag, name] = arguments else { return None };
    let is_name = name.len() <= LONGEST
        && name.starts_with(|first: char| first.is_ascii_alphabetic())
        && name.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_');
    (flag == "--node" && is_name).then_some(name.as_str())
}
