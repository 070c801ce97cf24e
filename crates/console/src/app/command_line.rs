//! The same act as a command line, for a script: of every act that the console sends. No secret is part of it: a
//! passphrase is a file's name there, in capitals, to be replaced.

#![deny(clippy::wildcard_enum_match_arm)]

use super::action::{Effect, Errand, Tag};
use super::perform;
use super::state::State;
use crate::model::Timestamp;
use crate::service::command::{Administration, IncidentCommand, PlayWishes};
use crate::service::{Command, Epochs, KeyKind};

/// The act as a command line; `None` = it is no act, or one of the console alone.
pub fn twin(state: &State, errand: &Errand) -> Option<String> {
    let line = of_words(state, &act(errand)?);
    // What follows a revoke is part of the same question.
    let follows = matches!(errand.tag, Tag::Revoke(_)).then_some(state.follow_up.as_ref()).flatten();
    let after = follows.and_then(|(_, errand)| twin(state, errand));
    Some(after.map_or_else(|| line.clone(), |after| format!("{line} && {after}")))
}

/// These words as a command line of the console's profile.
pub fn of_words(state: &State, words: &str) -> String {
    match state.settings.profile.as_str() {
        "default" => format!("authros {words}"),
        profile => format!("authros --profile {profile} {words}"),
    }
}

/// Copies the act of a question.
pub fn copy(state: &mut State, errand: &Errand) -> Vec<Effect> {
    twin(state, errand).map_or_else(Vec::new, |line| vec![perform::copy(state, line)])
}

/// Copies the act that was sent last.
pub fn copy_last(state: &mut State) -> Vec<Effect> {
    state.last_act.clone().map_or_else(Vec::new, |line| vec![perform::copy(state, line)])
}

/// The words behind `authros`.
fn act(errand: &Errand) -> Option<String> {
    let Errand { tag, command } = errand;
    Some(match tag {
        // Requests of the screens, and what only leaving or stopping a playback needs.
        Tag::Feed(..) | Tag::OpenConsole | Tag::Beside(..) | Tag::Path(_) | Tag::HoldCapture | Tag::StopPlay => {
            return None;
        }
        Tag::CreateIdentity => "identity create".to_owned(),
        Tag::Unlock => "keys list --passphrase-file FILE".to_owned(),
        Tag::Register => "register".to_owned(),
        Tag::Watch(topic) => format!("topics watch {}", quoted(topic)),
        Tag::Unwatch(topic) => format!("topics unwatch {}", quoted(topic)),
        Tag::Grant(_) | Tag::Extend(_) | Tag::Revoke(_) => of_right(command)?,
        Tag::LoadKey(_) | Tag::ExportKey(_) => of_key(command)?,
        Tag::Rotate => "keys rotate".to_owned(),
        Tag::Lock => "identity lock".to_owned(),
        Tag::BackUp => "keys backup --out FILE".to_owned(),
        Tag::Administer(_) => of_administrator(command)?,
        Tag::Deploy => "chain deploy".to_owned(),
        Tag::Pin(topic) => format!("topics pin {}", quoted(topic)),
        Tag::Unpin(topic) => {
            let Command::UnpinTopic { caller_id, .. } = command else { return None };
            format!("topics unpin {} {}", quoted(topic), quoted(caller_id))
        }
        Tag::Release(topic) => format!("quarantine release --topic {}", quoted(topic)),
        Tag::Discard(topic) => format!("quarantine discard --topic {} --yes", quoted(topic)),
        Tag::Publishers(topic) => format!("topics pins --topic {}", quoted(topic)),
        Tag::Show(id) => format!("uploads show {id}"),
        Tag::Open(id) => format!("shared open {id}"),
        Tag::Check(id) => format!("shared check {id}"),
        Tag::Export(id) => format!("uploads export {id} --dir DIR"),
        Tag::Contact(_) => of_contact(command)?,
        Tag::Incident(..) => of_incident(command)?,
        Tag::Robot(name) => format!("robots show {}", quoted(name)),
        Tag::SetPolicy(robot, Some(file)) => {
            format!("robots policy {} --set {}", quoted(robot), quoted(&file.to_string_lossy()))
        }
        Tag::SetPolicy(robot, None) => format!("robots policy {} --clear", quoted(robot)),
        Tag::Play(_) => {
            let Command::Play(wishes) = command else { return None };
            of_playback(wishes)
        }
    })
}

fn of_right(command: &Command) -> Option<String> {
    if let Command::Grant { grantee, topics, epochs, expires } = command {
        let topics = topics.iter().map(|topic| format!(" --topic {topic}")).collect::<String>();
        let epochs = if *epochs == Epochs::All { " --epochs all" } else { "" };
        return Some(format!("grant {grantee}{topics}{epochs}{}", expires.map_or_else(String::new, until)));
    }
    if let Command::ExtendGrant { grantee, expires } = command {
        let end = expires.map_or_else(|| " --endless".to_owned(), until);
        return Some(format!("grants extend {grantee}{end}"));
    }
    let Command::Revoke { grantee } = command else { return None };
    Some(format!("revoke {grantee}"))
}

fn until(end: Timestamp) -> String {
    format!(" --expires {end}")
}

fn of_key(command: &Command) -> Option<String> {
    let keystore = |secret: bool| if secret { " --keystore-passphrase-file FILE" } else { "" };
    if let Command::LoadKey { kind, path, passphrase } = command {
        let path = quoted(&path.to_string_lossy());
        return Some(format!("keys load --{} {path}{}", flag(*kind), keystore(passphrase.is_some())));
    }
    let Command::ExportKey { kind, passphrase } = command else { return None };
    Some(format!("keys export {} --out FILE{}", flag(*kind), keystore(passphrase.is_some())))
}

fn flag(kind: KeyKind) -> &'static str {
    match kind {
        KeyKind::Sm4 => "sm4",
        KeyKind::Sm2 => "sm2",
        KeyKind::Eoa => "eoa",
    }
}

fn of_administrator(command: &Command) -> Option<String> {
    let Command::Administer(administration) = command else { return None };
    Some(match administration {
        Administration::Admit { account } => format!("chain admit {account}"),
        Administration::Dismiss { account } => format!("chain dismiss {account}"),
        Administration::Suspend { account } => format!("chain suspend {account}"),
        Administration::Restore { account } => format!("chain restore {account}"),
        Administration::Open { open: true } => "chain open".to_owned(),
        Administration::Open { open: false } => "chain close".to_owned(),
        Administration::Pause { paused: true, seconds } => {
            format!("chain pause{}", seconds.map_or_else(String::new, |seconds| format!(" --for {seconds}s")))
        }
        Administration::Pause { paused: false, .. } => "chain resume".to_owned(),
        Administration::Propose { lost, successor } => format!("chain succession propose {lost} {successor}"),
        Administration::Cancel { lost } => format!("chain succession cancel {lost}"),
        Administration::Complete { lost } => format!("chain succession complete {lost}"),
        Administration::HandOver { account } => format!("chain hand-over {account}"),
        Administration::Accept => "chain accept".to_owned(),
    })
}

fn of_contact(command: &Command) -> Option<String> {
    let with = |fingerprint: &Option<String>| {
        fingerprint.as_ref().map_or_else(String::new, |value| format!(" --fingerprint {}", quoted(value)))
    };
    if let Command::AddContact { name, address, fingerprint } = command {
        return Some(format!("contacts add {name} {address}{}", with(fingerprint)));
    }
    if let Command::ConfirmContact { name, fingerprint } = command {
        return Some(format!("contacts confirm {name}{}", with(fingerprint)));
    }
    let Command::RemoveContact { name } = command else { return None };
    Some(format!("contacts remove {name}"))
}

fn of_incident(command: &Command) -> Option<String> {
    let Command::OfIncident(command) = command else { return None };
    Some(match command {
        IncidentCommand::OpenIncident { name, since, until, topics, note, robots } => {
            let mut words = format!("incident open {name} --since {since}");
            words.extend(until.map(|until| format!(" --until {until}")));
            words.extend(topics.iter().map(|topic| format!(" --topic {topic}")));
            words.extend(note.iter().map(|note| format!(" --note={}", quoted(note))));
            words.extend(robots.iter().map(|robot| format!(" --robot {}", quoted(robot))));
            words
        }
        IncidentCommand::NoteIncident { name, text } => format!("incident note {name} -- {}", quoted(text)),
        IncidentCommand::CloseIncident { name } => format!("incident close {name}"),
        IncidentCommand::RemoveIncident { name } => format!("incident remove {name} --yes"),
        IncidentCommand::ListIncidents => "incident list".to_owned(),
        IncidentCommand::ShowIncident { name } => format!("incident show {name}"),
    })
}

fn of_playback(wishes: &PlayWishes) -> String {
    let mut words = "shared play".to_owned();
    words.extend(wishes.owner.as_ref().map(|owner| format!(" --owner {owner}")));
    words.extend(wishes.topics.iter().map(|topic| format!(" --topic {}", quoted(&topic.to_string()))));
    words.extend(wishes.prefix.as_ref().map(|prefix| format!(" --prefix {prefix}")));
    format!("{words} --follow")
}

/// One word for a POSIX shell.
fn quoted(text: &str) -> String {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "/._-:@,+".contains(letter);
    if !text.is_empty() && text.chars().all(plain) {
        return text.to_owned();
    }
    format!("'{}'", text.replace('\'', "'\\''"))
}

#[cfg(test)]
mod tests {
    use super::quoted;

    #[test]
    fn a_word_of_a_shell_stays_one() {
        assert_eq!(quoted("/home/a/key.hex"), "/home/a/key.hex");
        assert_eq!(quoted("a key's $HOME"), "'a key'\\''s $HOME'");
        assert_eq!(quoted(""), "''");
    }
}
