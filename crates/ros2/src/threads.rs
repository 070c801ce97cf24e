//! Whether the threads that read the network are running. They end for good when one of their waits is interrupted, as
//! happens after the process was stopped or the machine slept, and nothing else reports it.

use std::fs;

/// The names of one participant's threads, cut to the length that the system keeps.
const NAME: &str = "RustDDS";
/// Their number for one participant.
const EXPECTED: usize = 2;

/// Whether those of so many participants run. If the system does not list threads, `true`.
pub fn run(participants: usize) -> bool {
    let Ok(tasks) = fs::read_dir("/proc/self/task") else { return true };
    let named = tasks
        .flatten()
        .filter(|task| fs::read_to_string(task.path().join("comm")).is_ok_and(|name| name.starts_with(NAME)));
    named.count() >= EXPECTED * participants
}
