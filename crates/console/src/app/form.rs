//! Forms of a few lines, their editable fields, and every form that the console asks with.

use std::fmt::Display;
use std::str::FromStr;

use zeroize::Zeroizing;

use super::keymap::Key;
use super::palette::{self, PathKind};
use super::popup::Confirm;
use super::verb::{Errand, Tag, kind_word};
use super::{Settings, State, when};
use crate::model::grant::MOST_TOPICS;
use crate::model::topic_rule::PatternError;
use crate::model::{Direction, Party, Timestamp, TopicName, TopicPattern};
use crate::service::reply::TopicRow;
use crate::service::{Command, GrantFrom, KeyKind, SecretText};

#[derive(Debug)]
pub enum Input {
    Text(Field),
    Choice { options: Vec<String>, chosen: usize },
}

/// Which line is wrong, and why.
pub type Wrong = (usize, String);

#[derive(Debug)]
pub struct Line {
    pub label: &'static str,
    /// The meaning of an empty field, or an example.
    pub hint: &'static str,
    pub input: Input,
    /// Tab completes a path of this kind.
    pub path: Option<PathKind>,
    /// A time, whose meaning is shown below it.
    pub time: Option<Direction>,
}

impl Line {
    pub fn text(label: &'static str, hint: &'static str, field: Field) -> Self {
        Self { label, hint, input: Input::Text(field), path: None, time: None }
    }

    pub fn choice(label: &'static str, options: &[&str]) -> Self {
        let options = options.iter().map(|option| (*option).to_owned()).collect();
        Self { label, hint: "", input: Input::Choice { options, chosen: 0 }, path: None, time: None }
    }

    pub fn path(mut self, kind: PathKind) -> Self {
        self.path = Some(kind);
        self
    }

    pub fn time(mut self, direction: Direction) -> Self {
        self.time = Some(direction);
        self
    }
}

#[derive(Debug)]
pub struct Form {
    pub title: String,
    /// Lines above the fields.
    pub notes: Vec<String>,
    pub lines: Vec<Line>,
    pub focus: usize,
    pub error: Option<String>,
    /// Lines below the fields: what Tab found.
    pub told: Vec<String>,
    /// Text that Tab could not extend; Tab again lists the names.
    pub tabbed: Option<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FormStep {
    Stay,
    Submit,
    Cancel,
}

impl Form {
    pub fn new(title: impl Into<String>, notes: Vec<String>, lines: Vec<Line>) -> Self {
        Self { title: title.into(), notes, lines, focus: 0, error: None, told: Vec::new(), tabbed: None }
    }

    /// Empty for a choice.
    pub fn text(&self, line: usize) -> &str {
        self.field(line).map_or("", Field::text)
    }

    /// Trimmed text; `None` if empty.
    pub fn typed(&self, line: usize) -> Option<&str> {
        Some(self.text(line).trim()).filter(|text| !text.is_empty())
    }

    pub fn parsed<T: FromStr<Err: Display>>(&self, line: usize) -> Result<T, Wrong> {
        self.text(line).trim().parse().map_err(|error: T::Err| (line, error.to_string()))
    }

    fn words(&self, line: usize) -> impl Iterator<Item = &str> {
        self.text(line).split([' ', ',']).filter(|word| !word.is_empty())
    }

    /// Names and patterns, without the words for all topics and for robots.
    pub fn patterns(&self, line: usize) -> Result<Vec<TopicPattern>, Wrong> {
        let topics = self.words(line).filter(|word| *word != ALL_TOPICS && !word.starts_with(OF_ROBOT));
        topics.map(|word| word.parse().map_err(|error: PatternError| (line, error.to_string()))).collect()
    }

    /// The topics named, and those known that match a pattern.
    fn topics(&self, line: usize, known: &[TopicRow]) -> Result<Vec<TopicName>, Wrong> {
        let mut topics: Vec<TopicName> = Vec::new();
        for pattern in self.patterns(line)? {
            let matching = known.iter().filter(|row| pattern.matches(&row.topic));
            let found = match pattern.name() {
                Some(name) => vec![name],
                None => matching.filter_map(|row| row.topic.parse().ok()).collect(),
            };
            if found.is_empty() {
                return Err((line, format!("no topic matches {pattern} now")));
            }
            topics.extend(found.into_iter().filter(|name| !topics.contains(name)).collect::<Vec<_>>());
        }
        Ok(topics)
    }

    pub fn field(&self, line: usize) -> Option<&Field> {
        match self.lines.get(line).map(|line| &line.input) {
            Some(Input::Text(field)) => Some(field),
            _ => None,
        }
    }

    pub fn set(&mut self, line: usize, field: Field) {
        if let Some(Line { input: Input::Text(text), .. }) = self.lines.get_mut(line) {
            *text = field;
        }
    }

    /// 0 for a text.
    pub fn chosen(&self, line: usize) -> usize {
        match self.lines.get(line).map(|line| &line.input) {
            Some(Input::Choice { chosen, .. }) => *chosen,
            _ => 0,
        }
    }

    pub fn refuse(&mut self, line: usize, error: impl Into<String>) {
        self.focus = line;
        self.error = Some(error.into());
    }

    pub fn key(&mut self, key: Key) -> FormStep {
        self.told.clear();
        self.tabbed = None;
        match key {
            Key::Escape => return FormStep::Cancel,
            Key::Enter if self.focus + 1 >= self.lines.len() => return FormStep::Submit,
            Key::Enter | Key::Tab | Key::Down => self.focus = (self.focus + 1) % self.lines.len().max(1),
            Key::BackTab | Key::Up => {
                self.focus = self.focus.checked_sub(1).unwrap_or(self.lines.len().saturating_sub(1))
            }
            _ => self.edit(key),
        }
        FormStep::Stay
    }

    pub fn paste(&mut self, text: &str) {
        if let Some(Line { input: Input::Text(field), .. }) = self.lines.get_mut(self.focus) {
            field.insert(text.trim());
            self.error = None;
            self.told.clear();
        }
    }

    fn edit(&mut self, key: Key) {
        self.error = None;
        match self.lines.get_mut(self.focus).map(|line| &mut line.input) {
            Some(Input::Text(field)) => drop(field.key(key)),
            Some(Input::Choice { options, chosen }) => match key {
                Key::Left => *chosen = chosen.checked_sub(1).unwrap_or(options.len().saturating_sub(1)),
                Key::Right | Key::Char(' ') => *chosen = (*chosen + 1) % options.len().max(1),
                // Typed text would vanish without a word.
                Key::Char(_) => self.error = Some("space changes this line; enter moves to the next".to_owned()),
                _ => {}
            },
            None => {}
        }
    }
}

/// The most characters of a field.
pub const LONGEST: usize = 200;
/// Space for [`LONGEST`] characters, so that a secret's buffer is never moved.
const CAPACITY: usize = LONGEST * 4;

pub struct Field {
    text: Zeroizing<String>,
    cursor: usize,
    masked: bool,
    offered: bool,
}

impl Default for Field {
    fn default() -> Self {
        Self { text: Zeroizing::new(String::with_capacity(CAPACITY)), cursor: 0, masked: false, offered: false }
    }
}

impl Field {
    pub fn masked() -> Self {
        Self { masked: true, ..Self::default() }
    }

    pub fn with(text: &str) -> Self {
        let mut field = Self::default();
        field.insert(text);
        field
    }

    /// The first character typed replaces the text.
    pub fn offering(text: &str) -> Self {
        Self { offered: !text.is_empty(), ..Self::with(text) }
    }

    pub fn is_offered(&self) -> bool {
        self.offered
    }

    pub fn text(&self) -> &str {
        &self.text
    }

    /// Dots for a secret.
    pub fn shown(&self) -> String {
        if self.masked { "•".repeat(self.text.chars().count()) } else { self.text.to_string() }
    }

    pub fn is_masked(&self) -> bool {
        self.masked
    }

    /// In characters.
    pub fn cursor(&self) -> usize {
        self.cursor
    }

    /// Drops control characters and excess text.
    pub fn insert(&mut self, text: &str) {
        if std::mem::take(&mut self.offered) {
            self.clear();
        }
        let room = LONGEST.saturating_sub(self.text.chars().count());
        for character in text.chars().filter(|character| !character.is_control()).take(room) {
            let at = self.offset(self.cursor);
            self.text.insert(at, character);
            self.cursor += 1;
        }
    }

    /// False if the key has no meaning here.
    pub fn key(&mut self, key: Key) -> bool {
        self.offered &= matches!(key, Key::Char(_));
        match key {
            Key::Char(character) => self.insert(character.encode_utf8(&mut [0; 4])),
            Key::Backspace if self.cursor > 0 => {
                self.cursor -= 1;
                self.remove();
            }
            Key::Delete => self.remove(),
            Key::Control('u') => self.clear(),
            Key::Left => self.cursor = self.cursor.saturating_sub(1),
            Key::Right => self.cursor = (self.cursor + 1).min(self.text.chars().count()),
            Key::Home => self.cursor = 0,
            Key::End => self.cursor = self.text.chars().count(),
            _ => return false,
        }
        true
    }

    pub fn clear(&mut self) {
        *self = Self { masked: self.masked, ..Self::default() };
    }

    fn remove(&mut self) {
        let at = self.offset(self.cursor);
        if at < self.text.len() {
            self.text.remove(at);
        }
    }

    fn offset(&self, characters: usize) -> usize {
        self.text.char_indices().nth(characters).map_or(self.text.len(), |(offset, _)| offset)
    }
}

impl std::fmt::Debug for Field {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.masked { formatter.write_str("Field(…)") } else { write!(formatter, "Field({:?})", self.text()) }
    }
}

/// Characters.
pub const SHORTEST_PASSPHRASE: usize = 8;

/// In the order of the choice.
const KINDS: [KeyKind; 3] = [KeyKind::Sm4, KeyKind::Sm2, KeyKind::Eoa];
const KIND_WORDS: &[&str] = &["SM4 (32 hex or 16 raw bytes)", "SM2 (d_C, PEM)", "EOA (V3 keystore or hex)"];

pub fn create_identity(profile: &str, notes: Vec<String>) -> Form {
    let lines = vec![
        Line::text("Passphrase", "at least 8 characters", Field::masked()),
        Line::text("Repeat", "", Field::masked()),
    ];
    Form::new(format!("New identity for profile {profile}"), notes, lines)
}

pub fn read_create(form: &Form) -> Result<Errand, Wrong> {
    if form.text(0).chars().count() < SHORTEST_PASSPHRASE {
        return Err((0, format!("use at least {SHORTEST_PASSPHRASE} characters")));
    }
    if form.text(0) != form.text(1) {
        return Err((1, "the passphrases do not match; type it again".to_owned()));
    }
    Ok(Errand { command: Command::CreateIdentity { passphrase: secret(form, 0) }, tag: Tag::CreateIdentity })
}

pub fn unlock(profile: &str, notes: Vec<String>) -> Form {
    let lines = vec![Line::text("Passphrase", "", Field::masked())];
    Form::new(format!("Unlock the keyring of profile {profile}"), notes, lines)
}

pub fn read_unlock(form: &Form) -> Result<Errand, Wrong> {
    if form.text(0).is_empty() {
        return Err((0, "type the passphrase, or leave with esc".to_owned()));
    }
    Ok(Errand { command: Command::Unlock { passphrase: secret(form, 0) }, tag: Tag::Unlock })
}

pub const ALL_TOPICS: &str = "all";
/// Before the name of a robot whose topics are meant.
pub const OF_ROBOT: &str = "robot:";
const ENDS: &str = "empty = never; 30d, 18:00, tomorrow 18:00";

/// Focuses the first empty line; `moments` says what the words of the line `From` mean now.
pub fn grant(grantee: &str, topics: &[String], ends: &str, moments: Vec<String>) -> Form {
    let lines = vec![
        Line::text("Address", "0x and 40 hex, or a contact's name", Field::offering(grantee)),
        Line::text("Topics", "topic names; robot:scout-1; all", Field::offering(&topics.join(" "))),
        Line::text("Ends", ENDS, Field::offering(ends)).time(Direction::Ahead),
        Line::text("From", "now, epoch, start; 1h, yesterday 18:00", Field::offering("now")).time(Direction::Back),
    ];
    let mut notes = vec!["Lets another account read your records. Tab completes names.".to_owned()];
    notes.extend(moments);
    let mut form = Form::new("Grant", notes, lines);
    form.focus = usize::from(!grantee.is_empty() && topics.is_empty());
    form
}

pub fn extend(grantee: &str, ends: &str) -> Form {
    let lines = vec![Line::text("Ends", ENDS, Field::default()).time(Direction::Ahead)];
    let notes = vec![
        format!("{grantee} can read until: {ends}"),
        "Later: one transaction. Sooner: a revoke and a new grant of the same records.".to_owned(),
    ];
    Form::new("Change the end of the grant", notes, lines)
}

#[derive(Debug, Clone)]
pub struct GrantWish {
    pub grantee: Party,
    /// Both empty = all.
    pub topics: Vec<TopicName>,
    pub robots: Vec<String>,
    pub from: GrantFrom,
    pub expires: Option<Timestamp>,
}

pub fn read_grant(form: &Form, state: &State) -> Result<GrantWish, Wrong> {
    let grantee: Party = form.parsed(0)?;
    if grantee.address().is_some_and(|address| Some(address) == state.address()) {
        return Err((0, "that is your own address; enter the reader's".to_owned()));
    }
    let topics = form.topics(1, &state.topics.rows)?;
    let robots: Vec<String> = form.words(1).filter_map(|word| word.strip_prefix(OF_ROBOT)).map(str::to_owned).collect();
    let (all, none) = (form.words(1).any(|word| word == ALL_TOPICS), topics.is_empty() && robots.is_empty());
    if robots.iter().any(String::is_empty) {
        return Err((1, format!("write the robot's name after {OF_ROBOT} without a space; tab completes it")));
    }
    if none && !all {
        return Err((1, format!("enter topics, or '{ALL_TOPICS}' for every topic")));
    }
    if topics.len() > MOST_TOPICS {
        return Err((1, format!("a grant covers at most {MOST_TOPICS} topics, or all")));
    }
    if !none && all {
        return Err((1, format!("use either '{ALL_TOPICS}' or topic names, not both")));
    }
    let expires = when::expiry(form.text(2), &state.times()).map_err(|error| (2, error))?;
    let from =
        GrantFrom::read(form.text(3), |text| state.times().back(text)).map_err(|failure| (3, failure.message))?;
    Ok(GrantWish { grantee, topics, robots, from, expires })
}

pub fn unpin(topic: &str, publisher: &str) -> Form {
    let lines = vec![
        Line::text("Topic", "such as /robot1/odom, /robot*/odom", Field::with(topic)),
        Line::text("Node", "caller id, such as /driver", Field::with(publisher)),
    ];
    Form::new("Unpin a publisher", vec!["Its messages are quarantined from then on.".to_owned()], lines)
}

pub fn read_unpin(form: &Form) -> Result<Errand, Wrong> {
    let topic: TopicPattern = form.parsed(0)?;
    let missing = || (1, "enter the node's name; enter on the topic lists pinned publishers".to_owned());
    let caller_id = form.typed(1).ok_or_else(missing)?.to_owned();
    let tag = Tag::Unpin(topic.to_string());
    Ok(Errand { command: Command::UnpinTopic { topic, caller_id }, tag })
}

pub fn load_key() -> Form {
    let lines = vec![
        Line::choice("Key", KIND_WORDS),
        Line::text("File", "path to the key file (must be mode 0600)", Field::default()).path(PathKind::File),
        Line::text("Passphrase", "only for a V3 keystore", Field::masked()),
    ];
    Form::new("Load a key file", vec!["Replaces the current key with one of yours.".to_owned()], lines)
}

pub fn read_load(form: &Form, settings: &Settings) -> Result<Confirm, Wrong> {
    let path = palette::of_line(form, 1, settings).ok_or((1, "enter the path of the key file".to_owned()))?;
    let passphrase = (!form.text(2).is_empty()).then(|| secret(form, 2));
    let kind = kind(form);
    let what = match kind {
        KeyKind::Sm4 => "New records are sealed under keys made from it, in a new epoch; old ones keep theirs.",
        KeyKind::Sm2 => "New records are signed with it; if you are registered, the chain gets it first.",
        KeyKind::Eoa => "Your address on the chain changes: grants and records of the old one stay with it.",
    };
    let file = format!("File  {}", path.display());
    let lines =
        vec![file, what.to_owned(), "The current key is replaced; export it first if you still need it.".to_owned()];
    let errand = Errand { command: Command::LoadKey { kind, path, passphrase }, tag: Tag::LoadKey(kind) };
    Ok(Confirm { title: format!("Replace the {} key?", kind_word(kind)), lines, yes: "replace", typed: None, errand })
}

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

pub fn read_export(form: &Form) -> Result<Errand, Wrong> {
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

#[cfg(test)]
mod field_tests {
    use super::*;

    #[test]
    fn edits_in_the_middle_of_wide_text() {
        let mut field = Field::with("机人");
        field.key(Key::Left);
        field.key(Key::Char('器'));
        assert_eq!(field.text(), "机器人");
        field.key(Key::Backspace);
        field.key(Key::Delete);
        assert_eq!(field.text(), "机");
        field.key(Key::Delete);
        assert_eq!(field.text(), "机");
    }

    #[test]
    fn a_secret_is_never_shown_and_a_paste_never_too_long() {
        let mut field = Field::masked();
        field.insert(&format!("pa\u{1b}ss{}", "x".repeat(500)));
        assert_eq!(field.text().chars().count(), LONGEST);
        assert!(field.text().starts_with("passx"));
        assert!(field.shown().chars().all(|character| character == '•'));
        assert_eq!(format!("{field:?}"), "Field(…)");
        assert!(field.text.capacity() <= CAPACITY);
    }
}
