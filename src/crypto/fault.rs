//! Switches that turn single checks off, for one purpose: to prove that `authros demo` notices.
//!
//! They exist only in the binary `authros-faulty`, built with the feature `fault`, where the
//! environment variable `AUTHROS_FAULT` names the check. In every other build each is constantly on.

/// The checks that can be named.
pub const CHECKS: [&str; 9] =
    ["digest", "signature", "commit", "tag", "anchor", "proof", "revoke", "restore", "authorise"];

/// Whether the check is switched off: never, in a build without the feature.
#[cfg(not(feature = "fault"))]
pub const fn is_off(_check: &str) -> bool {
    false
}

/// Whether the check is switched off by `AUTHROS_FAULT`.
#[cfg(feature = "fault")]
pub fn is_off(check: &str) -> bool {
    std::env::var("AUTHROS_FAULT").is_ok_and(|name| name == check)
}
