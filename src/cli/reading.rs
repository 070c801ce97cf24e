//! Commands about what a home has make none: a path that is mistyped would seem well, and what was made there would stop a
//! restore.

use super::args::{AgentVerb, ChainVerb, GatewayVerb, Global, IdentityVerb, KeysVerb, TopicsVerb, UploadsVerb, Verb};
use super::parties::ContactsVerb;
use crate::model::ErrorKind;
use crate::paths::Home;
use crate::service::Failure;

/// Refuses such a command where there is no home.
///
/// # Errors
/// If there is no home, or the standard places cannot be used.
pub fn needs_a_home(global: &Global, verb: Option<&Verb>) -> Result<(), Failure> {
    // An operator works at the home of somebody else.
    if global.site_socket.is_some() || verb.is_none_or(makes_a_home) {
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

/// Whether a verb has something to do where there is no home yet, and makes one if it needs one.
#[deny(clippy::wildcard_enum_match_arm)]
fn makes_a_home(verb: &Verb) -> bool {
    match verb {
        // Whether this machine is as it should be is asked before there is a home, too.
        Verb::Doctor
        | Verb::Register
        | Verb::Capture(_)
        | Verb::Bag(_)
        | Verb::Verify { .. }
        | Verb::Restore { .. }
        | Verb::Serve(_)
        | Verb::Demo(_)
        | Verb::Tour(_)
        | Verb::Console(_)
        // Settings are shown and checked without touching a home.
        | Verb::Config(_)
        | Verb::Completions { .. }
        | Verb::Complete { .. }
        | Verb::Man => true,
        Verb::Status { .. }
        | Verb::Audit(_)
        | Verb::Shared(_)
        | Verb::Grant(_)
        | Verb::Revoke { .. }
        | Verb::Grants(_)
        | Verb::Quarantine(_)
        | Verb::Robots(_)
        | Verb::Incident(_)
        | Verb::Retention(_)
        | Verb::Devices(_)
        | Verb::Alerts(_)
        | Verb::Evidence(_)
        | Verb::Profiles
        | Verb::Backup(_) => false,
        Verb::Uploads(verb) => matches!(verb, UploadsVerb::Import { .. }),
        Verb::Identity(verb) => matches!(verb, IdentityVerb::Create),
        Verb::Keys(verb) => matches!(verb, KeysVerb::Load { dry_run: false, .. }),
        Verb::Topics(verb) => matches!(verb, TopicsVerb::Watch { .. } | TopicsVerb::Pin(_)),
        Verb::Contacts(verb) => matches!(verb, ContactsVerb::Add { .. }),
        Verb::Agent(verb) => matches!(verb, AgentVerb::Run(_)),
        Verb::Gateway(verb) => matches!(verb, GatewayVerb::Serve { .. } | GatewayVerb::Admit { .. }),
        Verb::Chain(verb) => matches!(verb, ChainVerb::Deploy { .. } | ChainVerb::Serve { .. } | ChainVerb::Genesis(_)),
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
        let refusal = |words: &str| {
            let line = ["authros", "--home", missing.as_str()].into_iter().chain(words.split(' '));
            let arguments = Arguments::try_parse_from(line).unwrap_or_else(|error| panic!("{words}: {error}"));
            needs_a_home(&arguments.global, arguments.verb.as_ref()).err()
        };
        for words in [
            "status",
            "profiles",
            "uploads list",
            "shared list",
            "grants list",
            "revoke bob",
            "devices list",
            "identity show",
            "identity list",
            "identity lock",
            "keys list",
            "keys backup --out FILE",
            "keys load --sm2 FILE --dry-run",
            "keys rotate",
            "topics list",
            "topics pins",
            "topics policy",
            "topics coverage /odom",
            "topics unwatch /odom",
            "contacts list",
            "contacts remove bob",
            "alerts list",
            "alerts test",
            "gateway status",
            "gateway admitted",
            "chain status",
            "chain succession list",
            "chain suspend bob",
        ] {
            let failure = refusal(words).unwrap_or_else(|| panic!("{words} is not refused"));
            assert!(failure.kind == ErrorKind::Input && failure.message.contains(&missing), "{words}: {failure:?}");
            assert!(failure.message.contains("identity create"), "{words}: {failure:?}");
        }
        for words in [
            "serve",
            "identity create",
            "keys load --sm2 FILE",
            "topics watch /odom",
            "contacts add bob 0xBOB",
            "gateway serve",
            "chain genesis --guide",
            "uploads import OLD",
            "config show",
            "doctor",
        ] {
            assert!(refusal(words).is_none(), "{words}");
        }
    }
}
