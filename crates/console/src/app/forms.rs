//! The console's forms, and the commands made from their input.

use std::path::PathBuf;

use super::action::{Errand, Tag};
use super::field::Field;
use super::form::{Form, Line};
use super::paths::{self, PathKind};
use super::state::Settings;
use super::when;
use crate::model::grant::MOST_TOPICS;
use crate::model::{Address, Party, Timestamp, TopicName};
use crate::service::{Command, Epochs, KeyKind, SecretText};

/// The shortest passphrase accepted for a new keyring, characters.
pub const SHORTEST_PASSPHRASE: usize = 8;

/// The kinds of key, in the order of the choice.
const KINDS: [KeyKind; 3] = [KeyKind::Sm4, KeyKind::Sm2, KeyKind::Eoa];
const KIND_WORDS: &[&str] = &["SM4 (32 hex or 16 raw bytes)", "SM2 (d_C, PEM)", "EOA (V3 keystore or hex)"];
/// The second choice of which records a grant opens.
const ALL_RECORDS: &str = "all, including earlier records";

/// Asks for the passphrase of a new identity, twice.
pub fn create_identity(profile: &str, notes: Vec<String>) -> Form {
    let lines = vec![
        Line::text("Passphrase", "at least 8 characters", Field::masked()),
        Line::text("Repeat", "", Field::masked()),
    ];
    Form::new(format!("New identity for profile {profile}"), notes, lines)
}

/// The command of a completed [`create_identity`].
///
/// # Errors
/// The field in error, and why.
pub fn read_create(form: &Form) -> Result<Errand, (usize, String)> {
    if form.text(0).chars().count() < SHORTEST_PASSPHRASE {
        return Err((0, format!("use at least {SHORTEST_PASSPHRASE} characters")));
    }
    if form.text(0) != form.text(1) {
        return Err((1, "the passphrases do not match; type it again".to_owned()));
    }
    Ok(Errand { command: Command::CreateIdentity { passphrase: secret(form, 0) }, tag: Tag::CreateIdentity })
}

/// Asks for the passphrase of a locked keyring.
pub fn unlock(profile: &str, notes: Vec<String>) -> Form {
    let lines = vec![Line::text("Passphrase", "", Field::masked())];
    Form::new(format!("Unlock the keyring of profile {profile}"), notes, lines)
}

/// The command of a completed [`unlock`].
///
/// # Errors
/// The field in error, and why.
pub fn read_unlock(form: &Form) -> Result<Errand, (usize, String)> {
    if form.text(0).is_empty() {
        return Err((0, "type the passphrase, or leave with esc".to_owned()));
    }
    Ok(Errand { command: Command::Unlock { passphrase: secret(form, 0) }, tag: Tag::Unlock })
}

/// The word for all topics, which must be typed.
pub const ALL_TOPICS: &str = "all";

/// Asks whom to grant what; known values are filled in, and the first empty line has the focus.
/// `opens` says from when on the grant opens records.
pub fn grant(grantee: &str, topics: &[String], ends: &str, opens: &str) -> Form {
    let lines = vec![
        Line::text("Address", "0x and 40 hex, or a contact's name", Field::offering(grantee)),
        Line::text("Topics", "topic names; all", Field::offering(&topics.join(" "))),
        Line::text("Ends", "empty = never; 45m, 12h, 30d, 2036-12-31", Field::offering(ends)),
        Line::choice("Records", &[opens, ALL_RECORDS]),
    ];
    let notes = vec!["Lets another account read your records. Tab completes names.".to_owned()];
    let mut form = Form::new("Grant", notes, lines);
    form.focus = usize::from(!grantee.is_empty() && topics.is_empty());
    form
}

/// Asks for the new end of a grant.
pub fn extend(grantee: &str, ends: &str) -> Form {
    let lines = vec![Line::text("Ends", "empty = never; 45m, 12h, 30d, 2036-12-31", Field::default())];
    let notes = vec![
        format!("{grantee} can read until: {ends}"),
        "Later: keys and epoch stay the same. Sooner: a revoke and a new grant.".to_owned(),
    ];
    Form::new("Change the end of the grant", notes, lines)
}

/// The terms of a grant, as typed.
#[derive(Debug, Clone)]
pub struct GrantWish {
    /// The reader.
    pub grantee: Party,
    /// Only these; empty = all.
    pub topics: Vec<TopicName>,
    /// Which epochs.
    pub epochs: Epochs,
    /// When it ends.
    pub expires: Option<Timestamp>,
}

impl GrantWish {
    /// The command with these terms.
    pub fn errand(self) -> Errand {
        let Self { grantee, topics, epochs, expires } = self;
        let tag = Tag::Grant(grantee.clone());
        Errand { command: Command::Grant { grantee, topics, epochs, expires }, tag }
    }
}

/// The terms of a completed [`grant`].
///
/// # Errors
/// The field in error, and why.
pub fn read_grant(form: &Form, own: Option<Address>, now: Timestamp) -> Result<GrantWish, (usize, String)> {
    let grantee: Party = form.text(0).trim().parse().map_err(|error| (0, format!("{error}")))?;
    if grantee.address().is_some_and(|address| Some(address) == own) {
        return Err((0, "that is your own address; enter the reader's".to_owned()));
    }
    let written: Vec<&str> = form.text(1).split([' ', ',']).filter(|name| !name.is_empty()).collect();
    if written.is_empty() {
        return Err((1, format!("enter topics, or '{ALL_TOPICS}' for every topic")));
    }
    let names = written.into_iter().filter(|name| *name != ALL_TOPICS);
    let topics: Vec<TopicName> =
        names.map(str::parse).collect::<Result<_, _>>().map_err(|error| (1, format!("{error}")))?;
    if topics.len() > MOST_TOPICS {
        return Err((1, format!("a grant covers at most {MOST_TOPICS} topics, or all")));
    }
    if !topics.is_empty() && form.text(1).split([' ', ',']).any(|name| name == ALL_TOPICS) {
        return Err((1, format!("use either '{ALL_TOPICS}' or topic names, not both")));
    }
    let expires = when::expiry(form.text(2), now).map_err(|error| (2, error))?;
    let epochs = if form.chosen(3) == 0 { Epochs::Current } else { Epochs::All };
    Ok(GrantWish { grantee, topics, epochs, expires })
}

/// Asks which publisher of a topic is no longer accepted.
pub fn unpin(topic: &str, publisher: &str) -> Form {
    let lines = vec![
        Line::text("Topic", "such as /robot1/odom", Field::with(topic)),
        Line::text("Node", "caller id, such as /driver", Field::with(publisher)),
    ];
    Form::new("Unpin a publisher", vec!["Its messages are quarantined from then on.".to_owned()], lines)
}

/// The command of a completed [`unpin`].
///
/// # Errors
/// The field in error, and why.
pub fn read_unpin(form: &Form) -> Result<Errand, (usize, String)> {
    let topic: TopicName = form.text(0).trim().parse().map_err(|error| (0, format!("{error}")))?;
    let caller_id = form.text(1).trim().to_owned();
    if caller_id.is_empty() {
        return Err((1, "enter the node's name; enter on the topic lists pinned publishers".to_owned()));
    }
    let tag = Tag::Unpin(topic.to_string());
    Ok(Errand { command: Command::UnpinTopic { topic, caller_id }, tag })
}

/// Asks for a key file.
pub fn load_key() -> Form {
    let lines = vec![
        Line::choice("Key", KIND_WORDS),
        Line::text("File", "path to the key file (must be mode 0600)", Field::default()).path(PathKind::File),
        Line::text("Passphrase", "only for a V3 keystore", Field::masked()),
    ];
    Form::new("Load a key file", vec!["Replaces the current key with one of yours.".to_owned()], lines)
}

/// The key file to load, as typed.
#[derive(Debug, Clone)]
pub struct KeyWish {
    /// Which key it holds.
    pub kind: KeyKind,
    /// Its path, absolute.
    pub path: PathBuf,
    /// Passphrase of a V3 keystore, if one was given.
    pub passphrase: Option<SecretText>,
}

/// The key file of a completed [`load_key`].
///
/// # Errors
/// The field in error, and why.
pub fn read_load(form: &Form, settings: &Settings) -> Result<KeyWish, (usize, String)> {
    let path = paths::of_line(form, 1, settings).ok_or((1, "enter the path of the key file".to_owned()))?;
    let passphrase = (!form.text(2).is_empty()).then(|| secret(form, 2));
    Ok(KeyWish { kind: kind(form), path, passphrase })
}

/// Asks which key to export.
pub fn export_key(folder: Line) -> Form {
    let lines = vec![
        Line::choice("Key", KIND_WORDS),
        Line::text("Passphrase", "EOA: protects the V3 keystore", Field::masked()),
        Line::text("Repeat", "", Field::masked()),
        folder,
    ];
    let notes = vec!["Writes a secret key to a file. Anyone who has it can act or read as you.".to_owned()];
    Form::new("Export a key", notes, lines)
}

/// The command of a completed [`export_key`].
///
/// # Errors
/// The field in error, and why.
pub fn read_export(form: &Form) -> Result<Errand, (usize, String)> {
    let kind = kind(form);
    if kind == KeyKind::Eoa && form.text(1).chars().count() < SHORTEST_PASSPHRASE {
        return Err((1, format!("an EOA is exported as a keystore; use at least {SHORTEST_PASSPHRASE} characters")));
    }
    if form.text(1) != form.text(2) {
        return Err((2, "the passphrases do not match; type it again".to_owned()));
    }
    let passphrase = (kind == KeyKind::Eoa).then(|| secret(form, 1));
    Ok(Errand { command: Command::ExportKey { kind, passphrase }, tag: Tag::ExportKey(kind) })
}

fn kind(form: &Form) -> KeyKind {
    KINDS.get(form.chosen(0)).copied().unwrap_or(KeyKind::Sm4)
}

fn secret(form: &Form, line: usize) -> SecretText {
    SecretText::new(form.text(line).to_owned())
}
