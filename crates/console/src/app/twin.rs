//! Requests as command lines.

#![deny(clippy::wildcard_enum_match_arm)]

use crate::model::Timestamp;
use crate::service::command::{Administration, EvidenceWishes, IncidentCommand, PlayWishes};
use crate::service::{Command, KeyKind};

pub fn kind_word(kind: KeyKind) -> &'static str {
    match kind {
        KeyKind::Sm4 => "SM4",
        KeyKind::Sm2 => "SM2",
        KeyKind::Eoa => "EOA",
    }
}

#[allow(clippy::wildcard_enum_match_arm, reason = "other requests have no line of their own, or their tag has it")]
pub fn of_command(command: &Command) -> Option<String> {
    let until = |end: Timestamp| format!(" --expires {end}");
    let keystore = |secret: bool| if secret { " --keystore-passphrase-file FILE" } else { "" };
    let with = |fingerprint: &Option<String>| {
        fingerprint.as_ref().map_or_else(String::new, |value| format!(" --fingerprint {}", quoted(value)))
    };
    Some(match command {
        Command::Grant { grantee, topics, robots, from, expires } => {
            let topics = topics.iter().map(|topic| format!(" --topic {}", quoted(topic.as_str()))).collect::<String>();
            let robots = robots.iter().map(|robot| format!(" --robot {}", quoted(robot))).collect::<String>();
            format!("grant add {grantee}{topics}{robots} --from {from}{}", expires.map_or_else(String::new, until))
        }
        Command::ExtendGrant { grantee, expires } => {
            format!("grant extend {grantee}{}", expires.map_or_else(|| " --endless".to_owned(), until))
        }
        Command::Revoke { grantee } => format!("grant end {grantee}"),
        Command::ExportEvidence(wishes) => of_evidence(wishes),
        Command::LoadKey { kind, path, passphrase } => {
            let path = quoted(&path.to_string_lossy());
            format!("keys load --{} {path}{}", flag(*kind), keystore(passphrase.is_some()))
        }
        Command::ExportKey { kind, passphrase } => {
            format!("keys export {} --out FILE{}", flag(*kind), keystore(passphrase.is_some()))
        }
        Command::WatchTopic { topic, type_name, sampling } => {
            let sampling = sampling.unwrap_or_default();
            let mut words = format!("topics watch {}", quoted(topic.as_str()));
            words.extend(type_name.iter().map(|name| format!(" --type {name}")));
            words.extend(sampling.rate_text().map(|rate| format!(" --rate {rate}")));
            words.extend(sampling.every.map(|every| format!(" --every {every}")));
            words
        }
        Command::UnpinTopic { topic, caller_id } => {
            format!("topics unpin {} {}", quoted(topic.as_str()), quoted(caller_id))
        }
        Command::AddContact { name, address, fingerprint } => {
            format!("contacts add {name} {address}{}", with(fingerprint))
        }
        Command::ConfirmContact { name, fingerprint } => format!("contacts confirm {name}{}", with(fingerprint)),
        Command::RemoveContact { name } => format!("contacts remove {name}"),
        Command::Administer(administration) => of_administrator(administration),
        Command::OfIncident(command) => of_incident(command),
        Command::Play(wishes) => of_playback(wishes),
        _ => return None,
    })
}

fn flag(kind: KeyKind) -> String {
    kind_word(kind).to_lowercase()
}

fn of_administrator(administration: &Administration) -> String {
    match administration {
        Administration::Admit { account } => format!("chain admin allow {account}"),
        Administration::Dismiss { account } => format!("chain admin deny {account}"),
        Administration::Suspend { account } => format!("chain admin suspend {account}"),
        Administration::Restore { account } => format!("chain admin restore {account}"),
        Administration::Open { open: true } => "chain admin open".to_owned(),
        Administration::Open { open: false } => "chain admin close".to_owned(),
        Administration::Pause { paused: true, seconds } => {
            format!("chain admin pause{}", seconds.map_or_else(String::new, |seconds| format!(" --for {seconds}s")))
        }
        Administration::Pause { paused: false, .. } => "chain admin resume".to_owned(),
        Administration::Propose { lost, successor } => format!("chain succession propose {lost} {successor}"),
        Administration::Cancel { lost } => format!("chain succession cancel {lost}"),
        Administration::Complete { lost } => format!("chain succession complete {lost}"),
        Administration::HandOver { account } => format!("chain admin hand-over {account}"),
        Administration::Accept => "chain admin accept".to_owned(),
    }
}

fn of_incident(command: &IncidentCommand) -> String {
    match command {
        IncidentCommand::OpenIncident { name, since, until, topics, note, robots } => {
            let mut words = format!("incident open {name} --since {since}");
            words.extend(until.map(|until| format!(" --until {until}")));
            words.extend(topics.iter().map(|topic| format!(" --topic {}", quoted(topic.as_str()))));
            words.extend(note.iter().map(|note| format!(" --note={}", quoted(note))));
            words.extend(robots.iter().map(|robot| format!(" --robot {}", quoted(robot))));
            words
        }
        IncidentCommand::NoteIncident { name, text } => format!("incident note {name} -- {}", quoted(text)),
        IncidentCommand::CloseIncident { name } => format!("incident close {name}"),
        IncidentCommand::RemoveIncident { name } => format!("incident remove {name} --yes"),
        IncidentCommand::ListIncidents => "incident list".to_owned(),
        IncidentCommand::ShowIncident { name } => format!("incident show {name}"),
    }
}

fn of_evidence(wishes: &EvidenceWishes) -> String {
    let mut words = format!("evidence export {}", quoted(&wishes.file.to_string_lossy()));
    words.extend(wishes.incident.as_ref().map(|name| format!(" --incident {name}")));
    words.extend(wishes.reveal_all.then_some(" --reveal all"));
    words.extend(wishes.reveal_topics.iter().map(|topic| format!(" --reveal-topic {}", quoted(topic.as_str()))));
    format!("{words} --yes")
}

fn of_playback(wishes: &PlayWishes) -> String {
    let mut words = "received play".to_owned();
    words.extend(wishes.owner.as_ref().map(|owner| format!(" --owner {owner}")));
    words.extend(wishes.topics.iter().map(|topic| format!(" --topic {}", quoted(&topic.to_string()))));
    words.extend(wishes.prefix.as_ref().map(|prefix| format!(" --prefix {prefix}")));
    format!("{words} --follow")
}

/// Quotes one word for a POSIX shell.
pub fn quoted(text: &str) -> String {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "/._-:@,+".contains(letter);
    if !text.is_empty() && text.chars().all(plain) {
        return text.to_owned();
    }
    format!("'{}'", text.replace('\'', "'\\''"))
}

#[cfg(test)]
mod command_line_tests {
    use super::quoted;

    #[test]
    fn a_word_of_a_shell_stays_one() {
        assert_eq!(quoted("/home/a/key.hex"), "/home/a/key.hex");
        assert_eq!(quoted("a key's $HOME"), "'a key'\\''s $HOME'");
        assert_eq!(quoted(""), "''");
    }
}
