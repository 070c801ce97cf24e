//! Which keys do what on each screen: the preset of the verb list, overridden by the operator's own `keymap.toml`. Key
//! presses, help, bar and palette all ask here.

mod file;
mod preset;

pub use file::KeymapError;
pub use preset::text as preset_text;

use super::key::{Key, chord_label};
use super::screen::Screen;
use super::verb::{Entry, VERBS, Verb};

/// The most keys of one chord.
pub const LONGEST_CHORD: usize = 3;

/// Keys that do something when pressed in sequence.
#[derive(Debug, Clone, PartialEq)]
pub struct Binding {
    /// The keys.
    pub on: Vec<Key>,
    /// What they do.
    pub entry: &'static Entry,
    /// The operator's own description.
    pub desc: Option<String>,
}

impl Binding {
    /// A line of help.
    pub fn help(&self) -> &str {
        self.desc.as_deref().unwrap_or(self.entry.help)
    }

    fn begins_with(&self, pressed: &[Key]) -> bool {
        self.on.len() > pressed.len() && self.on.starts_with(pressed)
    }
}

/// The meaning of keys pressed in sequence.
#[derive(Debug, PartialEq)]
pub enum Meaning<'a> {
    /// They do this.
    Does(Verb),
    /// More keys must follow: these chords begin this way.
    Begins(Vec<&'a Binding>),
    /// Nothing.
    Nothing,
}

/// Where bindings apply; a more specific place takes precedence over a more general one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// On every screen.
    Everywhere,
    /// On screens with a list.
    Lists,
    /// On one screen.
    On(Screen),
}

impl Place {
    /// All, most general first.
    pub fn all() -> impl Iterator<Item = Self> {
        [Self::Everywhere, Self::Lists].into_iter().chain(Screen::ALL.map(Self::On))
    }

    /// Its name in `keymap.toml`.
    pub fn name(self) -> String {
        match self {
            Self::Everywhere => "everywhere".to_owned(),
            Self::Lists => "lists".to_owned(),
            Self::On(screen) => screen.title().to_lowercase(),
        }
    }

    fn holds_on(self, screen: Screen) -> bool {
        match self {
            Self::Everywhere => true,
            Self::Lists => screen.has_table(),
            Self::On(own) => own == screen,
        }
    }

    /// Where the preset binds an entry.
    fn of(entry: &Entry) -> Vec<Self> {
        let lists = || Screen::ALL.into_iter().all(|screen| screen.has_table() == entry.on.contains(&screen));
        match entry.on {
            [] => vec![Self::Everywhere],
            _ if lists() => vec![Self::Lists],
            screens => screens.iter().copied().map(Self::On).collect(),
        }
    }
}

/// The bindings of every screen.
#[derive(Debug, Clone, PartialEq)]
pub struct Keymap {
    screens: [Vec<Binding>; Screen::ALL.len()],
}

impl Default for Keymap {
    fn default() -> Self {
        Self::built(&|_| Vec::new())
    }
}

/// A line of the operator's file: keys, and what they do or that they do nothing.
#[derive(Debug, Clone)]
struct Change {
    on: Vec<Key>,
    entry: Option<&'static Entry>,
    desc: Option<String>,
}

impl Keymap {
    /// The preset, overridden by an operator's file.
    ///
    /// # Errors
    /// [`KeymapError`] naming `file`, the line, and what is wrong with it.
    pub fn with_file(file: &str, text: &str) -> Result<Self, KeymapError> {
        file::read(file, text)
    }

    fn built(changes: &dyn Fn(Place) -> Vec<Change>) -> Self {
        let of_screen = |screen: Screen| {
            let mut bindings = Vec::new();
            for place in Place::all().filter(|place| place.holds_on(screen)) {
                preset(place).chain(changes(place)).for_each(|change| apply(&mut bindings, change));
            }
            bindings
        };
        Self { screens: Screen::ALL.map(of_screen) }
    }

    /// All bindings of a screen.
    pub fn bindings(&self, screen: Screen) -> &[Binding] {
        &self.screens[screen.index()]
    }

    /// The meaning of these keys on a screen.
    pub fn meaning(&self, pressed: &[Key], screen: Screen) -> Meaning<'_> {
        let bindings = self.bindings(screen);
        if let Some(found) = bindings.iter().find(|binding| binding.on == pressed) {
            return Meaning::Does(found.entry.verb);
        }
        let begun: Vec<&Binding> = bindings.iter().filter(|binding| binding.begins_with(pressed)).collect();
        if begun.is_empty() { Meaning::Nothing } else { Meaning::Begins(begun) }
    }

    /// The bindings of an entry on a screen, the preset's keys first.
    pub fn of<'a>(&'a self, entry: &'a Entry, screen: Screen) -> impl Iterator<Item = &'a Binding> {
        self.bindings(screen).iter().filter(|binding| binding.entry.name == entry.name)
    }

    /// The first keys of an entry on a screen, as written; empty if it has none there.
    pub fn label(&self, entry: &Entry, screen: Screen) -> String {
        self.of(entry, screen).next().map(|binding| chord_label(&binding.on)).unwrap_or_default()
    }

    /// Whether a key does `verb` and nothing else; never true for keys that type text.
    pub fn is(&self, key: Key, verb: Verb, screen: Screen) -> bool {
        !matches!(key, Key::Char(_)) && self.meaning(&[key], screen) == Meaning::Does(verb)
    }
}

fn preset(place: Place) -> impl Iterator<Item = Change> {
    let here = VERBS.iter().filter(move |entry| Place::of(entry).contains(&place));
    here.flat_map(|entry| entry.chords().map(move |on| Change { on, entry: Some(entry), desc: None }))
}

/// A more specific binding replaces a more general one with the same keys.
fn apply(bindings: &mut Vec<Binding>, Change { on, entry, desc }: Change) {
    bindings.retain(|binding| binding.on != on);
    if let Some(entry) = entry {
        bindings.push(Binding { on, entry, desc });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_keys_mean_two_things_on_one_screen() {
        for screen in Screen::ALL {
            let here = VERBS.iter().filter(|entry| entry.works_on(screen));
            let mut seen: Vec<Vec<Key>> = Vec::new();
            for on in here.flat_map(Entry::chords) {
                assert!(!seen.iter().any(|other| other.starts_with(&on) || on.starts_with(other)), "{on:?} {screen:?}");
                assert!(on.len() <= LONGEST_CHORD);
                seen.push(on);
            }
            assert_eq!(seen.len(), Keymap::default().bindings(screen).len());
        }
    }

    #[test]
    fn no_key_is_stolen_by_tmux_or_screen() {
        let stolen = |on: &Vec<Key>| on.iter().any(|key| matches!(key, Key::Control('a' | 'b')));
        assert!(!VERBS.iter().flat_map(Entry::chords).any(|on| stolen(&on)));
    }

    #[test]
    fn a_chord_is_begun_and_done() {
        let keymap = Keymap::default();
        let Meaning::Begins(begun) = keymap.meaning(&[Key::Char('z')], Screen::Chain) else { panic!("no chord") };
        assert!(begun.len() > 1);
        assert_eq!(keymap.meaning(&begun[0].on, Screen::Chain), Meaning::Does(begun[0].entry.verb));
        assert_eq!(keymap.meaning(&[Key::Char('z'), Key::Escape], Screen::Chain), Meaning::Nothing);
    }
}
