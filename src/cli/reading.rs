//! Commands that only look at a home make none: a path that is mistyped would seem well, and what was made there would stop a
//! restore.

use super::args::{Global, Verb};
use crate::model::ErrorKind;
use crate::paths::Home;
use crate::service::Failure;

/// Refuses such a command where there is no home.
///
/// # Errors
/// If there is no home, or the standard places cannot be used.
pub fn needs_a_home(global: &Global, verb: Option<&Verb>) -> Result<(), Failure> {
    if !verb.is_some_and(only_looks) {
        return Ok(());
    }
    let home = match &global.home {
        Some(root) => Home::new(root.clone()),
        None => Home::standard().map_err(|error| Failure::new(error.kind(), error.to_string()))?,
    };
    if home.is_there() {
        return Ok(());
    }
    let root = home.root().display();
    let text = format!(
        "no home at {root}; give its path with --home, or make one there with `authros identity create` or `authros serve`"
    );
    Err(Failure::new(ErrorKind::Input, text))
}

/// Whether a verb is about what a home has.
#[deny(clippy::wildcard_enum_match_arm)]
fn only_looks(verb: &Verb) -> bool {
    match verb {
        Verb::Status { .. }
        | Verb::Audit(_)
        | Verb::Uploads(_)
        | Verb::Shared(_)
        | Verb::Grants(_)
        | Verb::Quarantine(_)
        | Verb::Robots(_)
        | Verb::Incident(_)
        | Verb::Retention(_)
        | Verb::Unattended(_)
        | Verb::Evidence(_)
        | Verb::Profiles
        | Verb::Backup(_) => true,
        // Whether this machine is as it should be is asked before there is a home, too.
        Verb::Doctor
        | Verb::Identity(_)
        | Verb::Keys(_)
        | Verb::Register
        | Verb::Topics(_)
        | Verb::Capture(_)
        | Verb::Bag(_)
        | Verb::Grant(_)
        | Verb::Revoke { .. }
        | Verb::Devices(_)
        | Verb::Agent(_)
        | Verb::Chain(_)
        | Verb::Contacts(_)
        | Verb::Fleet(_)
        | Verb::Witness(_)
        | Verb::Alerts(_)
        | Verb::Verify { .. }
        | Verb::Restore { .. }
        | Verb::Config(_)
        | Verb::Serve(_)
        | Verb::Operators(_)
        | Verb::Gateway(_)
        | Verb::Demo(_)
        | Verb::Tour(_)
        | Verb::Bench(_)
        | Verb::Console(_)
        | Verb::Completions { .. }
        | Verb::Complete { .. }
        | Verb::Man => false,
    }
}
