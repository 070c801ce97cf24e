//! Command lines for the console's palette, listed in the manual page; a test finds commands without one.

/// Palette name and command line, with placeholders in capitals.
pub const TWINS: &[(&str, &str)] = &[
    ("watch", "topics watch TOPIC"),
    ("provenance", "uploads show ID"),
    ("open", "shared open ID"),
    ("check", "shared check ID"),
    ("export", "uploads export ID --dir DIR"),
    ("browse", "shared list --owner ADDRESS --topic TOPIC"),
    ("play", "shared play --owner ADDRESS --topic TOPIC --prefix /shared/NAME --follow"),
    ("readers", "grants list"),
    ("publishers", "topics pins --topic TOPIC"),
    ("pin", "topics pin TOPIC"),
    ("unpin", "topics unpin TOPIC CALLER_ID"),
    ("release", "quarantine release --topic TOPIC"),
    ("discard", "quarantine discard --topic TOPIC"),
    ("grant", "grant ADDRESS"),
    ("extend", "grants extend ADDRESS --expires 30d"),
    ("revoke", "revoke ADDRESS"),
    ("create-identity", "identity create"),
    ("unlock", "keys list --passphrase-file FILE"),
    ("register", "register"),
    ("load-key", "keys load --sm4 FILE"),
    ("rotate-keys", "keys rotate"),
    ("export-key", "keys export sm4 --out FILE"),
    ("back-up-keys", "keys backup --out FILE"),
    ("lock", "identity lock"),
    ("deploy", "chain deploy"),
    ("allow-account", "chain admit ADDRESS"),
    ("withdraw-admission", "chain dismiss ADDRESS"),
    ("suspend", "chain suspend ADDRESS"),
    ("restore", "chain restore ADDRESS"),
    ("open-registration", "chain open"),
    ("close-registration", "chain close"),
    ("pause-changes", "chain pause"),
    ("resume-changes", "chain resume"),
    ("replace-lost-account", "chain succession propose ADDRESS ADDRESS"),
    ("hand-over", "chain hand-over ADDRESS"),
    ("accept-administration", "chain accept"),
    ("alerts", "alerts list"),
    ("undo", "topics unwatch TOPIC"),
    ("tasks", "status"),
    ("log-level", "audit list"),
    ("incident", "incident open NAME --since -10m --topics TOPIC"),
    ("incidents", "incident list"),
    ("inspect", "robots show ROBOT"),
    ("robot-policy", "robots policy ROBOT --set FILE"),
    ("contacts", "contacts list"),
    ("profile", "profiles"),
    ("filter", "uploads list --topic TOPIC"),
    ("sort", "uploads list --newest"),
    ("copy", "uploads list"),
    ("write-file", "uploads list"),
    ("help", "man"),
    ("go-overview", "status"),
    ("go-topics", "topics list"),
    ("go-uploads", "uploads list"),
    ("go-shared", "shared list"),
    ("go-grants", "grants list"),
    ("go-keys", "keys list"),
    ("go-chain", "chain status"),
    ("go-robots", "robots list"),
    ("go-log", "audit list"),
];

#[cfg(test)]
mod acts;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::VERBS;
    use crate::cli::args::Arguments;
    use clap::Parser;

    /// They only change how the console shows things.
    const ONLY_LOOKS: &[&str] = &[
        "mark",
        "mark-all",
        "read-line",
        "log-source",
        "end-tour",
        "minutes",
        "fold",
        "fold-all",
        "next-match",
        "previous-match",
        "reverse",
        "copy-command",
        "local-time",
        "freeze",
        "quit",
        "next-screen",
        "previous-screen",
        "dismiss",
        "columns",
        "theme",
        "ascii",
        "mouse",
        "redraw",
        "shell",
    ];

    #[test]
    fn every_command_of_the_palette_has_a_twin_that_parses() {
        for entry in VERBS.iter().filter(|entry| entry.palette) {
            let runs = TWINS.iter().any(|(name, _)| *name == entry.name);
            let looks = ONLY_LOOKS.contains(&entry.name);
            assert!(runs != looks, "'{}' has no twin on the command line", entry.name);
            assert!(!entry.changes || runs, "'{}' changes something", entry.name);
        }
        let named = |name: &str| VERBS.iter().any(|entry| entry.name == name);
        assert!(ONLY_LOOKS.iter().all(|name| named(name)));
        for (name, line) in TWINS {
            assert!(named(name), "there is no command '{name}'");
            let parsed = Arguments::try_parse_from(["authros"].into_iter().chain(line.split(' ')));
            assert!(parsed.is_ok(), "{line}: {}", parsed.expect_err("wrong"));
        }
    }
}
