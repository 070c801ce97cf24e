//! The headless twin of every command in the console's palette: what a script runs for the same effect. The manual page
//! lists them; a test fails if a palette command has none.

/// The equivalent without a console.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Twin {
    /// This command line, with placeholders in capitals.
    Runs(&'static str),
    /// It only changes how the console shows things.
    OnlyLooks,
}

use Twin::{OnlyLooks, Runs};

/// The twin of each palette command, by its name there.
pub const TWINS: &[(&str, Twin)] = &[
    ("mark", OnlyLooks),
    ("mark-all", OnlyLooks),
    ("watch", Runs("topics watch TOPIC")),
    ("provenance", Runs("uploads show ID")),
    ("open", Runs("shared open ID")),
    ("check", Runs("shared check ID")),
    ("export", Runs("uploads export ID --dir DIR")),
    ("browse", Runs("shared list --owner ADDRESS --topic TOPIC")),
    ("play", Runs("shared play --owner ADDRESS --topic TOPIC --prefix /shared/NAME --follow")),
    ("readers", Runs("grants list")),
    ("publishers", Runs("topics pins --topic TOPIC")),
    ("pin", Runs("topics pin TOPIC")),
    ("unpin", Runs("topics unpin TOPIC CALLER_ID")),
    ("release", Runs("quarantine release --topic TOPIC")),
    ("discard", Runs("quarantine discard --topic TOPIC")),
    ("grant", Runs("grant ADDRESS")),
    ("extend", Runs("grants extend ADDRESS --expires 30d")),
    ("revoke", Runs("revoke ADDRESS")),
    ("create-identity", Runs("identity create")),
    ("unlock", Runs("keys list --passphrase-file FILE")),
    ("register", Runs("register")),
    ("load-key", Runs("keys load --sm4 FILE")),
    ("rotate-keys", Runs("keys rotate")),
    ("export-key", Runs("keys export sm4 --out FILE")),
    ("back-up-keys", Runs("keys backup --out FILE")),
    ("lock", Runs("identity lock")),
    ("deploy", Runs("chain deploy")),
    ("allow-account", Runs("chain admit ADDRESS")),
    ("withdraw-admission", Runs("chain dismiss ADDRESS")),
    ("suspend", Runs("chain suspend ADDRESS")),
    ("restore", Runs("chain restore ADDRESS")),
    ("open-registration", Runs("chain open")),
    ("close-registration", Runs("chain close")),
    ("pause-changes", Runs("chain pause")),
    ("resume-changes", Runs("chain resume")),
    ("replace-lost-account", Runs("chain succession propose ADDRESS ADDRESS")),
    ("hand-over", Runs("chain hand-over ADDRESS")),
    ("accept-administration", Runs("chain accept")),
    ("undo", Runs("topics unwatch TOPIC")),
    ("tasks", Runs("status")),
    ("log-level", Runs("audit list")),
    ("read-line", OnlyLooks),
    ("log-source", OnlyLooks),
    ("incident", Runs("incident open NAME --since -10m --topics TOPIC")),
    ("incidents", Runs("incident list")),
    ("inspect", Runs("robots show ROBOT")),
    ("robot-policy", Runs("robots policy ROBOT --set FILE")),
    ("contacts", Runs("contacts list")),
    ("profile", Runs("profiles")),
    ("end-tour", OnlyLooks),
    ("minutes", OnlyLooks),
    ("fold", OnlyLooks),
    ("fold-all", OnlyLooks),
    ("next-match", OnlyLooks),
    ("previous-match", OnlyLooks),
    ("filter", Runs("uploads list --topic TOPIC")),
    ("sort", Runs("uploads list --newest")),
    ("reverse", OnlyLooks),
    ("copy-command", OnlyLooks),
    ("copy", Runs("uploads list")),
    ("write-file", Runs("uploads list")),
    ("local-time", OnlyLooks),
    ("freeze", OnlyLooks),
    ("help", Runs("man")),
    ("quit", OnlyLooks),
    ("next-screen", OnlyLooks),
    ("previous-screen", OnlyLooks),
    ("go-overview", Runs("status")),
    ("go-topics", Runs("topics list")),
    ("go-uploads", Runs("uploads list")),
    ("go-shared", Runs("shared list")),
    ("go-grants", Runs("grants list")),
    ("go-keys", Runs("keys list")),
    ("go-chain", Runs("chain status")),
    ("go-gateway", Runs("gateway status")),
    ("go-log", Runs("audit list")),
    ("dismiss", OnlyLooks),
    ("columns", OnlyLooks),
    ("theme", OnlyLooks),
    ("ascii", OnlyLooks),
    ("mouse", OnlyLooks),
    ("redraw", OnlyLooks),
    ("shell", OnlyLooks),
];

#[cfg(test)]
mod acts;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::verb::VERBS;
    use crate::cli::args::Arguments;
    use clap::Parser;

    #[test]
    fn every_command_of_the_palette_has_a_twin_that_parses() {
        for entry in VERBS.iter().filter(|entry| entry.palette) {
            let twin = TWINS.iter().find(|(name, _)| *name == entry.name).map(|(_, twin)| twin);
            let twin = twin.unwrap_or_else(|| panic!("'{}' has no twin on the command line", entry.name));
            assert!(!entry.changes || *twin != OnlyLooks, "'{}' changes something", entry.name);
        }
        for (name, twin) in TWINS {
            assert!(VERBS.iter().any(|entry| entry.name == *name), "there is no command '{name}'");
            let Runs(line) = twin else { continue };
            let parsed = Arguments::try_parse_from(["authros"].into_iter().chain(line.split(' ')));
            assert!(parsed.is_ok(), "{line}: {}", parsed.expect_err("wrong"));
        }
    }
}
