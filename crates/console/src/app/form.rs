//! A form of a few lines: text or a choice, focus, an error, submit and cancel.

use super::field::Field;
use super::key::Key;
use super::paths::PathKind;

/// The input of a line.
#[derive(Debug)]
pub enum Input {
    /// Typed text.
    Text(Field),
    /// One of a few words.
    Choice {
        /// The words.
        options: Vec<String>,
        /// The chosen one.
        chosen: usize,
    },
}

/// One line of a form.
#[derive(Debug)]
pub struct Line {
    /// Its label.
    pub label: &'static str,
    /// The meaning of an empty field, or an example.
    pub hint: &'static str,
    /// Its input.
    pub input: Input,
    /// What its text leads to, if it is a path: tab completes it.
    pub path: Option<PathKind>,
}

impl Line {
    /// A line of text.
    pub fn text(label: &'static str, hint: &'static str, field: Field) -> Self {
        Self { label, hint, input: Input::Text(field), path: None }
    }

    /// A choice, the first word chosen.
    pub fn choice(label: &'static str, options: &[&str]) -> Self {
        let options = options.iter().map(|option| (*option).to_owned()).collect();
        Self { label, hint: "", input: Input::Choice { options, chosen: 0 }, path: None }
    }

    /// The same as a path.
    pub fn path(mut self, kind: PathKind) -> Self {
        self.path = Some(kind);
        self
    }
}

/// A form on screen.
#[derive(Debug)]
pub struct Form {
    /// Its title.
    pub title: String,
    /// Lines above the fields.
    pub notes: Vec<String>,
    /// The fields.
    pub lines: Vec<Line>,
    /// Which field has the focus.
    pub focus: usize,
    /// What is wrong with the submitted input.
    pub error: Option<String>,
    /// What tab found, as lines below the fields.
    pub told: Vec<String>,
    /// The text that tab could not lengthen; pressed again, it lists the names.
    pub tabbed: Option<String>,
}

/// The effect of a key on a form.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FormStep {
    /// Nothing outside the form.
    Stay,
    /// The operator is done.
    Submit,
    /// The operator cancelled.
    Cancel,
}

impl Form {
    /// A form with the first field in focus.
    pub fn new(title: impl Into<String>, notes: Vec<String>, lines: Vec<Line>) -> Self {
        Self { title: title.into(), notes, lines, focus: 0, error: None, told: Vec::new(), tabbed: None }
    }

    /// The text of a field; empty for a choice.
    pub fn text(&self, line: usize) -> &str {
        self.field(line).map_or("", Field::text)
    }

    /// The field of a line, if it is one.
    pub fn field(&self, line: usize) -> Option<&Field> {
        match self.lines.get(line).map(|line| &line.input) {
            Some(Input::Text(field)) => Some(field),
            _ => None,
        }
    }

    /// Replaces the text of a line.
    pub fn set(&mut self, line: usize, field: Field) {
        if let Some(Line { input: Input::Text(text), .. }) = self.lines.get_mut(line) {
            *text = field;
        }
    }

    /// The number of the word chosen; 0 for a text.
    pub fn chosen(&self, line: usize) -> usize {
        match self.lines.get(line).map(|line| &line.input) {
            Some(Input::Choice { chosen, .. }) => *chosen,
            _ => 0,
        }
    }

    /// Sets the error, leaving the focus where it is.
    pub fn refuse(&mut self, line: usize, error: impl Into<String>) {
        self.focus = line;
        self.error = Some(error.into());
    }

    /// Takes a key.
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

    /// Takes pasted text.
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
                // What is typed here would vanish without a word.
                Key::Char(_) => self.error = Some("space changes this line; enter goes on to the next".to_owned()),
                _ => {}
            },
            None => {}
        }
    }
}
