//! What the parts of this room share: how a terminal is written and changed, and how their threads are called.

use std::io::{self, Write as _};

pub const THREAD_PREFIX: &str = "console-";

/// In the background, changing modes stops the process, and is interrupted when it continues.
pub fn patiently(change: impl Fn() -> io::Result<()>) -> io::Result<()> {
    loop {
        match change() {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            result => return result,
        }
    }
}

/// Bypasses stdout's buffer.
pub fn write(bytes: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    out.write_all(bytes.as_bytes())?;
    out.flush()
}
