//! Command lines for the console's palette, listed in the manual page; a test finds commands without one.

/// Palette name and command line, with placeholders in capitals.
pub const TWINS: &[(&str, &str)] = &[
    ("watch", "topics watch TOPIC"),
    ("provenance", "records show ID"),
    ("open", "records open ID"),
    ("check", "records check ID"),
    ("export", "records export ID --dir DIR"),
    ("browse", "received list --owner ADDRESS --topic TOPIC"),
    ("play", "received play --owner ADDRESS --topic TOPIC --prefix /shared/NAME --follow"),
    ("readers", "grant list"),
    ("publishers", "topics pins --topic TOPIC"),
    ("pin", "topics pin TOPIC"),
    ("unpin", "topics unpin TOPIC CALLER_ID"),
    ("release", "topics quarantine release --topic TOPIC"),
    ("discard", "topics quarantine discard --topic TOPIC"),
    ("limit", "topics watch TOPIC --rate 5"),
    ("grant", "grant add ADDRESS"),
    ("extend", "grant extend ADDRESS --expires 30d"),
    ("revoke", "grant end ADDRESS"),
    ("create-identity", "identity create"),
    ("unlock", "keys list --passphrase-file FILE"),
    ("register", "identity register"),
    ("load-key", "keys load --sm4 FILE"),
    ("rotate-keys", "keys rotate"),
    ("export-key", "keys export sm4 --out FILE"),
    ("back-up-keys", "keys backup --out FILE"),
    ("lock", "keys lock"),
    ("deploy", "chain deploy"),
    ("allow-account", "chain admin allow ADDRESS"),
    ("deny-account", "chain admin deny ADDRESS"),
    ("suspend", "chain admin suspend ADDRESS"),
    ("restore", "chain admin restore ADDRESS"),
    ("open-registration", "chain admin open"),
    ("close-registration", "chain admin close"),
    ("pause-changes", "chain admin pause"),
    ("resume-changes", "chain admin resume"),
    ("replace-lost-account", "chain succession propose ADDRESS ADDRESS"),
    ("hand-over", "chain admin hand-over ADDRESS"),
    ("accept-administration", "chain admin accept"),
    ("alerts", "alerts list"),
    ("undo", "topics unwatch TOPIC"),
    ("tasks", "status"),
    ("log-level", "audit list"),
    ("incident", "incident open NAME --since -10m --topics TOPIC"),
    ("incidents", "incident list"),
    ("inspect", "robot show ROBOT"),
    ("robot-policy", "robot policy ROBOT --set FILE"),
    ("contacts", "contacts list"),
    ("profile", "identity list"),
    ("filter", "records list --topic TOPIC"),
    ("sort", "records list --oldest"),
    ("copy", "records list"),
    ("write-file", "records list"),
    ("help", "help"),
    ("go-overview", "status"),
    ("go-topics", "topics list"),
    ("go-records", "records list"),
    ("go-received", "received list"),
    ("go-grants", "grant list"),
    ("go-keys", "keys list"),
    ("go-chain", "chain status"),
    ("go-robots", "robot list"),
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
