//! One line of typed text with a cursor; masked and wiped if it is a secret.

use zeroize::Zeroizing;

use super::key::Key;

/// The most characters of a field.
pub const LONGEST: usize = 200;
/// Space for [`LONGEST`] characters, so that a secret's buffer is never moved.
const CAPACITY: usize = LONGEST * 4;

/// A line of text being typed.
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
    /// An empty field that shows a dot per character.
    pub fn masked() -> Self {
        Self { masked: true, ..Self::default() }
    }

    /// A field with an initial text.
    pub fn with(text: &str) -> Self {
        let mut field = Self::default();
        field.insert(text);
        field
    }

    /// A field with an initial text that the first character typed replaces.
    pub fn offering(text: &str) -> Self {
        Self { offered: !text.is_empty(), ..Self::with(text) }
    }

    /// Whether the first character typed replaces the text.
    pub fn is_offered(&self) -> bool {
        self.offered
    }

    /// The text.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// What may be shown.
    pub fn shown(&self) -> String {
        if self.masked { "•".repeat(self.text.chars().count()) } else { self.text.to_string() }
    }

    /// Whether it holds a secret.
    pub fn is_masked(&self) -> bool {
        self.masked
    }

    /// The position of the cursor, in characters.
    pub fn cursor(&self) -> usize {
        self.cursor
    }

    /// Inserts text at the cursor; control characters and excess text are dropped.
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

    /// Handles a key; false if it has no meaning here.
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

    /// Empties it.
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

#[cfg(test)]
mod tests {
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
