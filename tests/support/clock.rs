//! Commands under another clock, if libfaketime is installed.

use std::path::PathBuf;

use super::Authros;

/// The library that shifts the clock of a program with threads.
pub fn faketime() -> Option<PathBuf> {
    let places = ["/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib"];
    places.iter().map(|place| PathBuf::from(place).join("faketime/libfaketimeMT.so.1")).find(|path| path.exists())
}

fn under(authros: &Authros, (name, value): (&str, &str)) -> Option<Authros> {
    let shifted = authros
        .with_variable("LD_PRELOAD", faketime()?.to_str().expect("UTF-8"))
        .with_variable(name, value)
        // As when a real clock is set: durations are not affected.
        .with_variable("FAKETIME_DONT_FAKE_MONOTONIC", "1")
        .with_variable("DONT_FAKE_MONOTONIC", "1");
    Some(shifted)
}

/// The same program with a clock that is off by this much, such as `-3h`; `None` if libfaketime is not installed.
pub fn shifted(authros: &Authros, by: &str) -> Option<Authros> {
    under(authros, ("FAKETIME", by))
}

/// The same with a clock that is this many days ahead.
pub fn days_ahead(authros: &Authros, days: u32) -> Option<Authros> {
    shifted(authros, &format!("+{days}d"))
}

/// The same with a clock that is off by what a file says at the moment.
pub fn shifted_by_file(authros: &Authros, file: &str) -> Option<Authros> {
    Some(under(authros, ("FAKETIME_TIMESTAMP_FILE", file))?.with_variable("FAKETIME_NO_CACHE", "1"))
}
