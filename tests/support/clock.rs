//! Commands under another clock, if libfaketime is installed.

use std::path::PathBuf;

use super::Authros;

/// The library that shifts the clock of a program with threads.
pub fn faketime() -> Option<PathBuf> {
    let places = ["/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib"];
    places.iter().map(|place| PathBuf::from(place).join("faketime/libfaketimeMT.so.1")).find(|path| path.exists())
}

/// The same program with a clock that is this many days ahead; `None` if libfaketime is not installed.
pub fn days_ahead(authros: &Authros, days: u32) -> Option<Authros> {
    ahead(authros, &format!("+{days}d"))
}

/// The same program with its clock moved, as libfaketime writes it: `+1h`, `-2d`.
pub fn ahead(authros: &Authros, by: &str) -> Option<Authros> {
    let library = faketime()?;
    let shifted = authros
        .with_variable("LD_PRELOAD", library.to_str().expect("UTF-8"))
        .with_variable("FAKETIME", by)
        // As when a real clock is set: durations are not affected.
        .with_variable("FAKETIME_DONT_FAKE_MONOTONIC", "1")
        .with_variable("DONT_FAKE_MONOTONIC", "1");
    Some(shifted)
}
