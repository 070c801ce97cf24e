//! A key as every terminal can send it.

/// Alt, function keys and terminal-specific keys do not exist here.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Key {
    /// Printable, with shift applied.
    Char(char),
    /// A lower-case letter.
    Control(char),
    Enter,
    Escape,
    Tab,
    BackTab,
    Backspace,
    Delete,
    Up,
    Down,
    Left,
    Right,
    PageUp,
    PageDown,
    Home,
    End,
}

impl Key {
    pub fn label(self) -> String {
        let named = NAMED.iter().find(|(key, _)| *key == self).map(|(_, label)| (*label).to_owned());
        named.unwrap_or_else(|| match self {
            Self::Control(letter) => format!("^{letter}"),
            Self::Char(character) => character.to_string(),
            _ => String::new(),
        })
    }

    /// `None` if not every terminal can send the key.
    pub fn from_label(label: &str) -> Option<Self> {
        let named = NAMED.iter().find(|(_, name)| *name == label).map(|(key, _)| *key);
        named.or_else(|| Self::letter(label))
    }

    fn letter(label: &str) -> Option<Self> {
        let mut characters = label.chars();
        match (characters.next(), characters.next(), characters.next()) {
            (Some(character), None, _) => {
                (!character.is_control() && character != ' ').then_some(Self::Char(character))
            }
            // Terminals send ^h, ^i, ^j and ^m as backspace, tab and enter.
            (Some('^'), Some(letter @ 'a'..='z'), None) => {
                (!matches!(letter, 'h' | 'i' | 'j' | 'm')).then_some(Self::Control(letter))
            }
            _ => None,
        }
    }
}

const NAMED: [(Key, &str); 15] = [
    (Key::Char(' '), "space"),
    (Key::Enter, "enter"),
    (Key::Escape, "esc"),
    (Key::Tab, "tab"),
    (Key::BackTab, "shift-tab"),
    (Key::Backspace, "backspace"),
    (Key::Delete, "del"),
    (Key::Up, "up"),
    (Key::Down, "down"),
    (Key::Left, "left"),
    (Key::Right, "right"),
    (Key::PageUp, "pgup"),
    (Key::PageDown, "pgdn"),
    (Key::Home, "home"),
    (Key::End, "end"),
];

/// `z t`, as in help and bottom bar.
pub fn chord_label(keys: &[Key]) -> String {
    keys.iter().map(|key| key.label()).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod key_tests {
    use super::*;

    #[test]
    fn every_label_is_read_back() {
        let letters = ('a'..='z').map(Key::Char).chain([Key::Char('?'), Key::Char('^'), Key::Control('z')]);
        for key in NAMED.map(|(key, _)| key).into_iter().chain(letters) {
            assert_eq!(Key::from_label(&key.label()), Some(key));
        }
        for wrong in ["", " ", "f5", "alt-x", "^1", "^A", "^m", "\u{1b}", "ctrl-x"] {
            assert_eq!(Key::from_label(wrong), None, "{wrong}");
        }
    }
}
