//! Closes the files that the site's own starter left open: every child inherits them.

use std::os::fd::RawFd;

const FIRST: RawFd = 3;
/// Numbers closed where the system does not list the open ones.
const USUAL_LIMIT: RawFd = 1024;

/// Only for the very beginning, while nothing of this process is open.
pub fn close() {
    for number in open() {
        // The folder just read is among them and no longer open.
        let _ = nix::unistd::close(number);
    }
}

fn open() -> Vec<RawFd> {
    let Ok(entries) = std::fs::read_dir("/proc/self/fd") else { return (FIRST..USUAL_LIMIT).collect() };
    let numbers = entries.flatten().filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    numbers.filter(|number| *number >= FIRST).collect()
}
