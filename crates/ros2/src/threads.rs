//! Whether the network threads run. They end when one of their waits is interrupted, as after a suspend, and nothing
//! else reports it.

use std::fs;

/// Prefix of their names, cut by the system.
const NAME: &str = "RustDDS";
const EXPECTED: usize = 2;

/// `true` if the system lists no threads.
pub fn run(participants: usize) -> bool {
    let Ok(tasks) = fs::read_dir("/proc/self/task") else { return true };
    let named = tasks
        .flatten()
        .filter(|task| fs::read_to_string(task.path().join("comm")).is_ok_and(|name| name.starts_with(NAME)));
    named.count() >= EXPECTED * participants
}
