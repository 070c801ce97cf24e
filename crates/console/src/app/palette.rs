//! The palette, acts as command lines, and completion of paths in forms (folders are read outside: nothing here waits).
#![deny(clippy::wildcard_enum_match_arm)]

use std::path::PathBuf;

use super::available::available;
use super::form::{self, Field, Form, LONGEST, Line};
use super::keymap::Key;
use super::perform::{self, perform};
use super::popup::{Palette, Popup, Purpose};
use super::verb::{Effect, Errand, Tag, Verb, kind_word};
use super::{Settings, State, choosing, granting};
use crate::model::{Timestamp, clean, is_shown};
use crate::service::command::{Administration, EvidenceWishes, IncidentCommand, PlayWishes};
use crate::service::{Command, KeyKind};

#[allow(clippy::wildcard_enum_match_arm, reason = "any other key is typed")]
pub(super) fn key(state: &mut State, mut palette: Palette, key: Key) {
    let matches = palette.matches(state);
    let last = matches.len().saturating_sub(1);
    match key {
        Key::Escape => return,
        Key::Enter => {
            remember(state, palette.field.text());
            let words: Vec<&str> = palette.field.text().split_whitespace().collect();
            let (grants, chooses) = (available(state, Verb::Grant).is_ok(), available(state, Verb::Columns).is_ok());
            let (changes, is_pattern) = (!state.settings.read_only, |word: &&str| word.starts_with(['/', '*']));
            match with_terms(&words) {
                Some(("grant", terms)) if grants => return granting::spoken(state, terms),
                Some((word @ ("watch" | "unwatch"), topics)) if changes && topics.iter().all(is_pattern) => {
                    return perform::spoken_watch(state, topics, word == "watch");
                }
                Some(("columns", names)) if chooses => return choosing::spoken(state, names),
                Some(("profile", [name])) => {
                    if let Ok(profile) = name.parse() {
                        return perform::switch(state, profile);
                    }
                }
                _ => {}
            }
            let Some(entry) = matches.get(palette.selected.min(last)) else { return };
            return perform(state, entry.verb);
        }
        Key::Up | Key::Down if recalls(state, &mut palette, key == Key::Up) => {}
        Key::Up | Key::BackTab => palette.selected = palette.selected.min(last).saturating_sub(1),
        Key::Down | Key::Tab => palette.selected = (palette.selected + 1).min(last),
        _ => {
            palette.field.key(key);
            (palette.selected, palette.recalled) = (0, None);
        }
    }
    state.popups.push(Popup::Palette(palette));
}

const MOST_COMMANDS: usize = 50;

fn remember(state: &mut State, typed: &str) {
    let typed = typed.trim();
    if !typed.is_empty() {
        state.commands.retain(|other| other != typed);
        state.commands.push(typed.to_owned());
        drop(state.commands.drain(..state.commands.len().saturating_sub(MOST_COMMANDS)));
    }
}

/// Up in an empty palette recalls earlier commands; false if the arrow moves the cursor.
fn recalls(state: &State, palette: &mut Palette, earlier: bool) -> bool {
    let wanted = match (palette.recalled, earlier) {
        (None, true) if palette.field.text().is_empty() && palette.selected == 0 => Some(0),
        (None, _) => return false,
        (Some(back), true) => Some((back + 1).min(state.commands.len().saturating_sub(1))),
        (Some(back), false) => back.checked_sub(1),
    };
    let text = wanted.and_then(|back| state.commands.iter().rev().nth(back));
    if text.is_none() && palette.recalled.is_none() {
        return false;
    }
    palette.field = Field::with(text.map_or("", String::as_str));
    (palette.recalled, palette.selected) = (wanted, 0);
    true
}

fn with_terms<'a>(words: &'a [&'a str]) -> Option<(&'a str, &'a [&'a str])> {
    words.split_first().filter(|(_, terms)| !terms.is_empty()).map(|(name, terms)| (*name, terms))
}

/// Letters of every word must occur in order; lower is better, `None` = no match.
pub fn score(needle: &str, text: &str) -> Option<usize> {
    let text: Vec<char> = text.chars().flat_map(char::to_lowercase).collect();
    needle.split_whitespace().map(|word| word_score(word, &text)).sum()
}

/// Rows with every word as typed, or if there are none, rows with the letters in order.
pub fn narrow<T>(needle: &str, rows: Vec<T>, text: impl Fn(&T) -> String) -> Vec<T> {
    if needle.trim().is_empty() {
        return rows;
    }
    let whole: Vec<bool> = rows.iter().map(|row| whole_words(needle, &text(row))).collect();
    let any = whole.contains(&true);
    let kept = rows.into_iter().zip(whole);
    kept.filter(|(row, whole)| *whole || !any && score(needle, &text(row)).is_some()).map(|(row, _)| row).collect()
}

pub fn whole_words(needle: &str, text: &str) -> bool {
    let text = text.to_lowercase();
    needle.split_whitespace().all(|word| text.contains(&word.to_lowercase()))
}

/// Distances between the letters, and of the first from the beginning.
fn word_score(word: &str, text: &[char]) -> Option<usize> {
    let word: Vec<char> = word.chars().flat_map(char::to_lowercase).collect();
    let whole = text.windows(word.len().max(1)).position(|part| part == word.as_slice());
    whole.map(|at| usize::from(at > 0)).or_else(|| scattered(&word, text))
}

fn scattered(word: &[char], text: &[char]) -> Option<usize> {
    let mut from = 0;
    let mut gaps = 10;
    for letter in word {
        let found = text.get(from..)?.iter().position(|other| other == letter)?;
        gaps += found;
        from += found + 1;
    }
    Some(gaps)
}

/// `None` for acts that have no command line.
pub fn twin(state: &State, errand: &Errand) -> Option<String> {
    let line = of_words(state, &act(errand)?);
    // What follows a revoke is part of the same question.
    let follows = matches!(errand.tag, Tag::Revoke(_)).then_some(state.follow_up.as_ref()).flatten();
    let after = follows.and_then(|(_, errand)| twin(state, errand));
    Some(after.map_or_else(|| line.clone(), |after| format!("{line} && {after}")))
}

pub fn of_words(state: &State, words: &str) -> String {
    match state.settings.profile.as_str() {
        "default" => format!("authros {words}"),
        profile => format!("authros --profile {profile} {words}"),
    }
}

fn act(errand: &Errand) -> Option<String> {
    let Errand { tag, command } = errand;
    Some(match tag {
        // Screens' own requests, and what only leaving or ending a playback sends.
        Tag::Feed(..)
        | Tag::OpenConsole
        | Tag::Beside(..)
        | Tag::Path(_)
        | Tag::HoldCapture
        | Tag::StopPlay
        | Tag::Foresee(_) => {
            return None;
        }
        Tag::CreateIdentity => "identity create".to_owned(),
        Tag::Unlock => "keys list --passphrase-file FILE".to_owned(),
        Tag::Register => "identity register".to_owned(),
        Tag::Watch(topic) => format!("topics watch {}", quoted(topic)),
        Tag::Unwatch(topic) => format!("topics unwatch {}", quoted(topic)),
        Tag::Grant(_) | Tag::Extend(_) | Tag::Revoke(_) | Tag::LoadKey(_) | Tag::ExportKey(_) => of_command(command)?,
        Tag::Limit(_) => of_command(command)?,
        Tag::Unpin(_) | Tag::Contact(_) | Tag::Incident(..) | Tag::Administer(_) | Tag::Play(_) => of_command(command)?,
        Tag::Evidence(_) => of_command(command)?,
        Tag::Rotate => "keys rotate".to_owned(),
        Tag::Lock => "keys lock".to_owned(),
        Tag::BackUp => "keys backup --out FILE".to_owned(),
        Tag::Deploy => "chain deploy".to_owned(),
        Tag::Pin(topic) => format!("topics pin {}", quoted(topic)),
        Tag::Release(topic) => format!("topics quarantine release --topic {}", quoted(topic)),
        Tag::Discard(topic) => format!("topics quarantine discard --topic {} --yes", quoted(topic)),
        Tag::Publishers(topic) => format!("topics pins --topic {}", quoted(topic)),
        Tag::Show(id) => format!("records show {id}"),
        Tag::Open(id) => format!("records open {id}"),
        Tag::Check(id) => format!("records check {id}"),
        Tag::Export(id) => format!("records export {id} --dir DIR"),
        Tag::Robot(name) => format!("robot show {}", quoted(name)),
        Tag::SetPolicy(robot, Some(file)) => {
            format!("robot policy {} --set {}", quoted(robot), quoted(&file.to_string_lossy()))
        }
        Tag::SetPolicy(robot, None) => format!("robot policy {} --clear", quoted(robot)),
    })
}

#[allow(clippy::wildcard_enum_match_arm, reason = "the tags above name the commands that come here")]
fn of_command(command: &Command) -> Option<String> {
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
fn quoted(text: &str) -> String {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "/._-:@,+".contains(letter);
    if !text.is_empty() && text.chars().all(plain) {
        return text.to_owned();
    }
    format!("'{}'", text.replace('\'', "'\\''"))
}

const MOST_LISTED: usize = 200;
/// Characters of a listed name.
const WIDEST_NAME: usize = 60;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PathKind {
    /// A file; folders lead to it.
    File,
    Folder,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sought {
    pub typed: String,
    /// Absolute.
    pub folder: PathBuf,
    /// Names must begin with this; hidden names only match a leading dot.
    pub begun: String,
    pub kind: PathKind,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Candidate {
    /// Foreign text.
    pub name: String,
    pub folder: bool,
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Found {
    pub names: Vec<Candidate>,
    /// Whether the folder holds more than was read.
    pub more: bool,
}

impl Candidate {
    /// Names that cannot be typed are listed, and never completed.
    fn is_typable(&self) -> bool {
        self.name.trim() == self.name && self.name.chars().all(is_shown)
    }

    fn shown(&self) -> String {
        let name = clean(&self.name, WIDEST_NAME);
        if self.folder { format!("{name}/") } else { name }
    }
}

/// `~` is the operator's home; relative paths start at the working directory.
pub fn resolve(text: &str, settings: &Settings) -> PathBuf {
    match (text.strip_prefix('~'), &settings.home) {
        (Some(""), Some(home)) => home.clone(),
        (Some(rest), Some(home)) if rest.starts_with('/') => home.join(rest.trim_start_matches('/')),
        _ => settings.directory.join(text),
    }
}

/// `None` if the focused line is no path.
fn sought(form: &Form, settings: &Settings) -> Option<Sought> {
    let kind = form.lines.get(form.focus)?.path?;
    let typed = form.text(form.focus).to_owned();
    let (folder, begun) = match typed.rsplit_once('/') {
        // The root is only its slash.
        Some((folder, begun)) => (format!("{folder}/"), begun.to_owned()),
        None if typed == "~" => ("~".to_owned(), String::new()),
        None => (String::new(), typed.clone()),
    };
    Some(Sought { folder: resolve(&folder, settings), begun, kind, typed })
}

pub fn tab(state: &State, form: &Form, key: Key) -> Option<Effect> {
    sought(form, &state.settings).filter(|_| key == Key::Tab).map(Effect::FindPaths)
}

/// Ignores an answer to a form that changed meanwhile.
pub fn found(state: &mut State, sought: &Sought, found: Result<Found, String>) {
    let Some(Popup::Form(_, form)) = state.popups.last_mut() else { return };
    let here = form.lines.get(form.focus).is_some_and(|line| line.path == Some(sought.kind));
    if !here || form.text(form.focus) != sought.typed {
        return;
    }
    let listed = form.tabbed.take().is_some_and(|text| text == sought.typed);
    form.told.clear();
    match found {
        Err(error) => form.told.push(error),
        Ok(found) => complete(form, sought, &found, listed),
    }
}

fn complete(form: &mut Form, sought: &Sought, found: &Found, listed: bool) {
    if found.more {
        // Unread names might begin otherwise.
        return form.told = list(found);
    }
    let typable: Vec<&Candidate> = found.names.iter().filter(|candidate| candidate.is_typable()).collect();
    let stem = match sought.typed.rsplit_once('/') {
        Some((folder, _)) => format!("{folder}/"),
        None if sought.typed == "~" => "~/".to_owned(),
        None => String::new(),
    };
    let whole = match typable.as_slice() {
        [] if found.names.is_empty() => return form.told.push(nothing(sought)),
        [] => None,
        [only] if found.names.len() == 1 => Some(format!("{}{}", only.name, if only.folder { "/" } else { "" })),
        several => common(several.iter().map(|candidate| candidate.name.as_str())),
    };
    let line = format!("{stem}{}", whole.unwrap_or_else(|| sought.begun.clone()));
    if line.chars().count() > LONGEST {
        form.told.push(format!("the whole path is longer than the {LONGEST} characters of this line"));
    } else if line != sought.typed {
        form.set(form.focus, Field::with(&line));
        form.tabbed = (found.names.len() > 1).then_some(line);
    } else if found.names.len() == 1 && !typable.is_empty() {
        // Nothing left to complete: on to the next line.
        form.focus = (form.focus + 1) % form.lines.len().max(1);
    } else if listed {
        form.told = list(found);
    } else {
        form.tabbed = Some(line);
    }
}

fn nothing(sought: &Sought) -> String {
    let folder = clean(&sought.folder.display().to_string(), 200);
    match (sought.kind, sought.begun.as_str()) {
        (PathKind::Folder, "") => format!("{folder} holds no folder"),
        (PathKind::File, "") => format!("{folder} holds no file that is not hidden"),
        (_, begun) => format!("nothing in {folder} begins with '{}'", clean(begun, WIDEST_NAME)),
    }
}

/// Longest common beginning.
pub(super) fn common<'a>(mut names: impl Iterator<Item = &'a str>) -> Option<String> {
    let first = names.next()?.to_owned();
    Some(names.fold(first, |common, name| {
        let same = common.chars().zip(name.chars()).take_while(|(one, other)| one == other);
        same.map(|(character, _)| character).collect()
    }))
}

fn list(found: &Found) -> Vec<String> {
    let names: Vec<String> = found.names.iter().take(MOST_LISTED).map(Candidate::shown).collect();
    let mut lines = vec![names.join("  ")];
    let left = found.names.len().saturating_sub(MOST_LISTED);
    if left > 0 {
        lines.push(format!("… {left} more"));
    }
    if found.names.iter().any(|candidate| !candidate.is_typable()) {
        lines.push("a name with � holds characters that cannot be typed here".to_owned());
    }
    if found.more {
        lines.push("the folder holds more than was read; type further letters".to_owned());
    }
    lines
}

/// Absolute path; `None` if the line is empty.
pub fn of_line(form: &Form, line: usize, settings: &Settings) -> Option<PathBuf> {
    let text = form.text(line).trim();
    (!text.is_empty()).then(|| resolve(text, settings))
}

#[derive(Debug, Default)]
pub struct Exports {
    /// Records of the form on screen.
    ids: Vec<String>,
    /// The last folder, as typed.
    last: String,
    /// Target folders of running exports; missing = the working directory.
    folders: Vec<(Tag, PathBuf)>,
}

pub fn folder_line(state: &State) -> Line {
    let hint = "empty = where this console was started";
    Line::text("Folder", hint, Field::offering(&state.exports.last)).path(PathKind::Folder)
}

pub fn begin_key(state: &mut State) {
    let form = form::export_key(folder_line(state));
    state.popups.push(Popup::Form(Purpose::ExportKey, form));
}

pub fn begin(state: &mut State) {
    let ids = state.marked_keys();
    let title = match ids.len() {
        1 => "Export 1 record".to_owned(),
        count => format!("Export {count} records"),
    };
    let notes = vec![
        "Writes the files for others to check: ciphertext, header, proof.".to_owned(),
        "Each record gets a new folder; nothing is overwritten.".to_owned(),
    ];
    let form = Form::new(title, notes, vec![folder_line(state)]);
    state.exports.ids = ids;
    state.popups.push(Popup::Form(Purpose::Export, form));
}

pub fn submit(state: &mut State, form: &Form) {
    let ids = std::mem::take(&mut state.exports.ids);
    let errand = |id: String| Errand {
        command: Command::ExportUpload { id: id.clone(), addresses: false },
        tag: Tag::Export(id),
    };
    let fresh: Vec<Errand> = ids.into_iter().map(errand).filter(|errand| !state.work.contains(&errand.tag)).collect();
    for errand in fresh {
        goes_to(state, &errand.tag, form, 0);
        state.send(errand);
    }
}

pub fn goes_to(state: &mut State, tag: &Tag, form: &Form, line: usize) {
    form.text(line).trim().clone_into(&mut state.exports.last);
    state.exports.folders.retain(|(other, _)| other != tag);
    if let Some(folder) = of_line(form, line, &state.settings) {
        state.exports.folders.push((tag.clone(), folder));
    }
}

/// `None` = the working directory.
pub fn folder_of(state: &mut State, tag: &Tag) -> Option<PathBuf> {
    let place = state.exports.folders.iter().position(|(other, _)| other == tag)?;
    Some(state.exports.folders.remove(place).1)
}

#[cfg(test)]
mod fuzzy_tests {
    use super::*;

    #[test]
    fn words_match_in_any_order_and_letters_in_their_own() {
        assert_eq!(score("", "anything"), Some(0));
        assert_eq!(score("odom", "/robot1/odom"), Some(1));
        assert!(score("r1odm", "/robot1/odom").is_some());
        assert!(score("odom robot1", "/robot1/odom").is_some());
        assert_eq!(score("mdo", "/robot1/odom"), None);
        assert!(score("gr", "grant") < score("gr", "go-overview first"));
        assert_eq!(score("X", ""), None);
    }

    #[test]
    fn scattered_letters_count_only_where_no_whole_word_does() {
        let narrowed = |needle| narrow(needle, vec!["/robot1/camera/odometer", "/robot1/odom"], ToString::to_string);
        assert_eq!(narrowed("robot1/odom"), ["/robot1/odom"]);
        assert_eq!(narrowed("rbtcmr"), ["/robot1/camera/odometer"]);
        assert_eq!(narrowed("").len(), 2);
    }
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
