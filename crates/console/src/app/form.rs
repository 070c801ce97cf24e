//! Forms of a few lines, and their editable fields.

use std::fmt::Display;
use std::str::FromStr;
use zeroize::Zeroizing;

use crate::app::key::Key;
use crate::model::{Direction, TopicName, TopicPattern, topic_rule::PatternError};
use crate::service::reply::TopicRow;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PathKind {
    /// A file; folders lead to it.
    File,
    Folder,
}

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

    pub fn words(&self, line: usize) -> impl Iterator<Item = &str> {
        self.text(line).split([' ', ',']).filter(|word| !word.is_empty())
    }

    /// Names and patterns, without the words for all topics and for robots.
    pub fn patterns(&self, line: usize) -> Result<Vec<TopicPattern>, Wrong> {
        let topics = self.words(line).filter(|word| *word != ALL_TOPICS && !word.starts_with(OF_ROBOT));
        topics.map(|word| word.parse().map_err(|error: PatternError| (line, error.to_string()))).collect()
    }

    /// The topics named, and those known that match a pattern.
    pub fn topics(&self, line: usize, known: &[TopicRow]) -> Result<Vec<TopicName>, Wrong> {
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

pub const ALL_TOPICS: &str = "all";

/// Before the name of a robot whose topics are meant.
pub const OF_ROBOT: &str = "robot:";

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
