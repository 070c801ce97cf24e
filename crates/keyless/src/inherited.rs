//! Files that whoever started the site left open: they are passed on to every program, and are none of this one's.

use std::os::fd::RawFd;

/// Input, output and errors come before it.
const FIRST: RawFd = 3;
/// How far is looked where the system does not say what is open.
const USUAL_LIMIT: RawFd = 1024;

/// Closes all but input, output and errors. Only for the very beginning, while nothing of this process is open.
pub fn close() {
    for number in open() {
        // The folder that was read is among them and no longer open.
        let _ = nix::unistd::close(number);
    }
}

fn open() -> Vec<RawFd> {
    let Ok(entries) = std::fs::read_dir("/proc/self/fd") else { return (FIRST..USUAL_LIMIT).collect() };
    let numbers = entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    numbers.filter(|number| *number >= FIRST).collect()
}
