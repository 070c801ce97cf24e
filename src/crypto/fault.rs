//! Faults that tests build in: `RUSTFLAGS='--cfg authros_fault="digest"'` compiles the program
//! with that one check taken out, so that a test can show that the check matters. Nothing at run
//! time reads or sets this; a normal build compiles every answer to `false`.

/// Whether `check` was taken out of this build.
///
/// Known checks: digest, signature, commit, tag, anchor, revoke, restore, authorise.
#[inline]
pub fn is_off(check: &str) -> bool {
    match check {
        "digest" => cfg!(authros_fault = "digest"),
        "signature" => cfg!(authros_fault = "signature"),
        "commit" => cfg!(authros_fault = "commit"),
        "tag" => cfg!(authros_fault = "tag"),
        "anchor" => cfg!(authros_fault = "anchor"),
        "revoke" => cfg!(authros_fault = "revoke"),
        "restore" => cfg!(authros_fault = "restore"),
        "authorise" => cfg!(authros_fault = "authorise"),
        _ => false,
    }
}
