//! Commands that only look at a home make none: a path that is mistyped would seem well, and what was made there would stop a
//! restore.

use super::args::{Global, Verb};
use super::fleet::FleetVerb;
use super::operators::OperatorsVerb;
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
        | Verb::Devices(_)
        | Verb::Witness(_)
        | Verb::Operators(OperatorsVerb::Add { .. } | OperatorsVerb::List | OperatorsVerb::Remove { .. })
        | Verb::Fleet(FleetVerb::List | FleetVerb::Status | FleetVerb::Remove { .. })
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
        | Verb::Agent(_)
        | Verb::Chain(_)
        | Verb::Contacts(_)
        | Verb::Fleet(FleetVerb::Add { .. })
        | Verb::Alerts(_)
        | Verb::Verify { .. }
        | Verb::Restore { .. }
        | Verb::Config(_)
        | Verb::Serve(_)
        // Whoever is to be an operator has no home here.
        | Verb::Operators(OperatorsVerb::Key { .. })
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

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::super::args::Arguments;
    use super::*;

    #[test]
    fn what_only_looks_is_refused_where_there_is_no_home() {
        let folder = tempfile::tempdir().expect("a folder");
        let missing = folder.path().join("mistyped").display().to_string();
        let refused = |words: &str| {
            let line = ["authros", "--home", missing.as_str()].into_iter().chain(words.split(' '));
            let arguments = Arguments::try_parse_from(line).expect(words);
            needs_a_home(&arguments.global, arguments.verb.as_ref()).is_err()
        };
        for words in ["fleet status", "operators list", "operators remove bob", "witness list", "devices list"] {
            assert!(refused(words), "{words}");
        }
        for words in
            ["operators key bob", "serve", "topics list", "identity create", "fleet add b:7420 --gateway-key HEX"]
        {
            assert!(!refused(words), "{words}");
        }
    }
}
