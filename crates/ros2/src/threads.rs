//! Whether the threads that read the network are there. They end for good when a wait of theirs is interrupted, as it is
//! after the process was stopped or the machine slept, and nothing else tells of it.

use std::fs;

/// How the threads of one participant are called, cut to what the system keeps.
const NAME: &str = "RustDDS";
/// How many one participant has.
const EXPECTED: usize = 2;

/// Whether they run. Where the system does not list threads, `true`.
pub fn run() -> bool {
    let Ok(tasks) = fs::read_dir("/proc/self/task") else { return true };
    let named = tasks
        .flatten()
        .filter(|task| fs::read_to_string(task.path().join("comm")).is_ok_and(|name| name.starts_with(NAME)));
    named.count() >= EXPECTED
}
