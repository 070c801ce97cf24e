//! `authros-rosrust --node NAME`: started by a site of AuthROS, with a pipe as its input and output and with
//! ROS_MASTER_URI and ROS_HOSTNAME as its environment. It publishes in that graph. It has no keys, and is of no use alone.

use std::process::ExitCode;

use authros_keyless::{Begun, Memory, begin, close_inherited};

/// The most memory that can be written to. Each topic has three threads, and each thread a stack.
const MOST_MEMORY: u64 = 4 << 30;
/// The longest name.
const LONGEST: usize = 200;

fn main() -> ExitCode {
    close_inherited();
    let given = (node(), std::env::var_os("ROS_MASTER_URI"));
    let (Some(node), Some(_)) = given else {
        return fail(
            "usage: ROS_MASTER_URI=URI authros-rosrust --node NAME; authros starts this program where ros.publisher or \
             --robots-by is rosrust, do not run it by hand",
        );
    };
    let Begun { from, to, stop } = match begin(Memory::Data(MOST_MEMORY)) {
        Ok(begun) => begun,
        Err(reason) => return fail(reason),
    };
    match authros_rosrust::run(&node, from, to, &stop) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => fail(&error.to_string()),
    }
}

/// The node's name. rosrust reads the arguments too, and would take one with `:=` for a remapping.
fn node() -> Option<String> {
    let mut arguments = std::env::args().skip(1);
    let (flag, name) = (arguments.next()?, arguments.next()?);
    let is_name = name.len() <= LONGEST
        && name.starts_with(|first: char| first.is_ascii_alphabetic())
        && name.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '_');
    (flag == "--node" && is_name && arguments.next().is_none()).then_some(name)
}

fn fail(reason: &str) -> ExitCode {
    use std::io::Write;
    drop(writeln!(std::io::stderr(), "authros-rosrust: {reason}"));
    ExitCode::FAILURE
}
