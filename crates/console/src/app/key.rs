//! Keys as the console knows them, and as `keymap.toml` writes them, independent of any terminal library.

/// One key press. Alt, function keys and terminal-specific ones do not exist here.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Key {
    /// A printable character, with shift already applied.
    Char(char),
    /// Control and a lower-case letter.
    Control(char),
    /// Return.
    Enter,
    /// Escape.
    Escape,
    /// Tab.
    Tab,
    /// Shift and tab.
    BackTab,
    /// Deletes to the left.
    Backspace,
    /// Deletes to the right.
    Delete,
    /// Cursor up.
    Up,
    /// Cursor down.
    Down,
    /// Cursor left.
    Left,
    /// Cursor right.
    Right,
    /// One page up.
    PageUp,
    /// One page down.
    PageDown,
    /// To the beginning.
    Home,
    /// To the end.
    End,
}

impl Key {
    /// As written in help and bottom bar.
    pub fn label(self) -> String {
        match self {
            Self::Char(' ') => "space".to_owned(),
            Self::Char(character) => character.to_string(),
            Self::Control(letter) => format!("^{letter}"),
            Self::Enter => "enter".to_owned(),
            Self::Escape => "esc".to_owned(),
            Self::Tab => "tab".to_owned(),
            Self::BackTab => "shift-tab".to_owned(),
            Self::Backspace => "backspace".to_owned(),
            Self::Delete => "del".to_owned(),
            Self::Up => "up".to_owned(),
            Self::Down => "down".to_owned(),
            Self::Left => "left".to_owned(),
            Self::Right => "right".to_owned(),
            Self::PageUp => "pgup".to_owned(),
            Self::PageDown => "pgdn".to_owned(),
            Self::Home => "home".to_owned(),
            Self::End => "end".to_owned(),
        }
    }

    /// Parses what [`Key::label`] writes; `None` = not a key that every terminal can send.
    pub fn from_label(label: &str) -> Option<Self> {
        let named = NAMED.iter().find(|key| key.label() == label).copied();
        named.or_else(|| Self::letter(label))
    }

    fn letter(label: &str) -> Option<Self> {
        let mut characters = label.chars();
        match (characters.next(), characters.next(), characters.next()) {
            (Some(character), None, _) => {
                (!character.is_control() && character != ' ').then_some(Self::Char(character))
            }
            // What terminals send for ^h, ^i, ^j and ^m is backspace, tab and enter.
            (Some('^'), Some(letter @ 'a'..='z'), None) => {
                (!matches!(letter, 'h' | 'i' | 'j' | 'm')).then_some(Self::Control(letter))
            }
            _ => None,
        }
    }
}

/// The keys with a name.
const NAMED: [Key; 15] = [
    Key::Char(' '),
    Key::Enter,
    Key::Escape,
    Key::Tab,
    Key::BackTab,
    Key::Backspace,
    Key::Delete,
    Key::Up,
    Key::Down,
    Key::Left,
    Key::Right,
    Key::PageUp,
    Key::PageDown,
    Key::Home,
    Key::End,
];

/// Several keys in sequence, as written in help and bottom bar: `z t`.
pub fn chord_label(keys: &[Key]) -> String {
    keys.iter().map(|key| key.label()).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_label_is_read_back() {
        let letters = ('a'..='z').map(Key::Char).chain([Key::Char('?'), Key::Char('^'), Key::Control('z')]);
        for key in NAMED.into_iter().chain(letters) {
            assert_eq!(Key::from_label(&key.label()), Some(key));
        }
        for wrong in ["", " ", "f5", "alt-x", "^1", "^A", "^m", "\u{1b}", "ctrl-x"] {
            assert_eq!(Key::from_label(wrong), None, "{wrong}");
        }
    }
}
