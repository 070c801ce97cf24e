//! Keys of each screen: the preset of the verb list, overridden by the operator's `keymap.toml`.

use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::ops::Range;
use toml::Spanned;

use crate::app::verb::{Entry, VERBS, Verb};
use crate::app::{key::Key, key::chord_label, screen::Screen};
use crate::model::clean;

/// The most keys of one chord.
pub const LONGEST_CHORD: usize = 3;

#[derive(Debug, Clone, PartialEq)]
pub struct Binding {
    pub on: Vec<Key>,
    pub entry: &'static Entry,
    /// The operator's own text.
    pub desc: Option<String>,
}

impl Binding {
    pub fn help(&self) -> &str {
        self.desc.as_deref().unwrap_or(self.entry.help)
    }

    fn begins_with(&self, pressed: &[Key]) -> bool {
        self.on.len() > pressed.len() && self.on.starts_with(pressed)
    }
}

#[derive(Debug, PartialEq)]
pub enum Meaning<'a> {
    Does(Verb),
    /// These chords begin with the keys.
    Begins(Vec<&'a Binding>),
    Nothing,
}

/// A more specific place takes precedence over a more general one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    Everywhere,
    /// On screens with a list.
    Lists,
    On(Screen),
}

impl Place {
    /// Most general first.
    pub fn all() -> impl Iterator<Item = Self> {
        [Self::Everywhere, Self::Lists].into_iter().chain(Screen::all().map(Self::On))
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

    fn of(entry: &Entry) -> Vec<Self> {
        let lists = || Screen::all().all(|screen| screen.has_table() == entry.on.contains(&screen));
        match entry.on {
            [] => vec![Self::Everywhere],
            _ if lists() => vec![Self::Lists],
            screens => screens.iter().copied().map(Self::On).collect(),
        }
    }
}

#[derive(Debug, Clone, PartialEq)]
pub struct Keymap(Vec<Vec<Binding>>);

impl Default for Keymap {
    fn default() -> Self {
        Self::built(&[])
    }
}

impl Keymap {
    pub fn with_file(file: &str, text: &str) -> Result<Self, FileError> {
        let source = Source { file, text };
        let lines = lines(&source)?;
        let keymap = Self::built(&lines);
        Screen::all().try_for_each(|screen| reachable(&source, &keymap, &lines, screen))?;
        Ok(keymap)
    }

    /// A more specific binding replaces a more general one of the same keys.
    fn built(lines: &[Read]) -> Self {
        let of_screen = |screen: Screen| {
            let mut bindings: Vec<Binding> = Vec::new();
            for place in Place::all().filter(|place| place.holds_on(screen)) {
                let own = lines.iter().filter(|line| line.place == place);
                let own = own.map(|line| (line.on.clone(), line.entry, line.desc.clone()));
                let preset = preset(place).map(|(on, entry)| (on, Some(entry), None));
                for (on, entry, desc) in preset.chain(own) {
                    bindings.retain(|binding| binding.on != on);
                    bindings.extend(entry.map(|entry| Binding { on, entry, desc }));
                }
            }
            bindings
        };
        Self(Screen::all().map(of_screen).collect())
    }

    pub fn bindings(&self, screen: Screen) -> &[Binding] {
        &self.0[screen.index()]
    }

    pub fn meaning(&self, pressed: &[Key], screen: Screen) -> Meaning<'_> {
        let bindings = self.bindings(screen);
        if let Some(found) = bindings.iter().find(|binding| binding.on == pressed) {
            return Meaning::Does(found.entry.verb);
        }
        let begun: Vec<&Binding> = bindings.iter().filter(|binding| binding.begins_with(pressed)).collect();
        if begun.is_empty() { Meaning::Nothing } else { Meaning::Begins(begun) }
    }

    /// The preset's keys first.
    pub fn of<'a>(&'a self, entry: &'a Entry, screen: Screen) -> impl Iterator<Item = &'a Binding> {
        self.bindings(screen).iter().filter(|binding| binding.entry.name == entry.name)
    }

    /// As written; empty if there are none.
    pub fn label(&self, entry: &Entry, screen: Screen) -> String {
        self.of(entry, screen).next().map(|binding| chord_label(&binding.on)).unwrap_or_default()
    }

    /// Never true for keys that type text.
    pub fn is(&self, key: Key, verb: Verb, screen: Screen) -> bool {
        !matches!(key, Key::Char(_)) && self.meaning(&[key], screen) == Meaning::Does(verb)
    }
}

fn preset(place: Place) -> impl Iterator<Item = (Vec<Key>, &'static Entry)> {
    let here = VERBS.iter().filter(move |entry| Place::of(entry).contains(&place));
    here.flat_map(|entry| entry.chords().map(move |on| (on, entry)))
}

const OPENING: &str = "# Keys of the AuthROS console, as they are without a keymap.toml.
#
# Your own keymap.toml \
(beside config.toml) lists only what differs:
#   on    a key, or a list of up to three keys pressed one after the \
other
#   run   the command, by its name in the palette; \"none\" removes the preset's meaning
#   desc  your own help \
text (optional)
# [everywhere] applies to every screen, [lists] to screens with a list; a screen's own section takes \
precedence.
# Keys: characters as they are, space enter esc tab shift-tab backspace del up down left right pgup pgdn \
home end,
# ^x = Control and x. Terminals send ^h ^i ^j ^m as backspace, tab and enter, so these cannot be bound.
";

pub fn preset_text() -> String {
    let mut text = OPENING.to_owned();
    for place in Place::all() {
        let line = |(on, entry): (Vec<Key>, &Entry)| [keys(&on), quoted(entry.name), quoted(entry.help)];
        let lines: Vec<[String; 3]> = preset(place).map(line).collect();
        if lines.is_empty() {
            continue;
        }
        let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
        let (on_width, run_width) = (width(0), width(1));
        // Writing to a string cannot fail.
        let _ = write!(text, "\n[{}]\nkeys = [\n", place.name());
        for [on, run, desc] in &lines {
            let _ = writeln!(text, "  {{ on = {on:on_width$}, run = {run:run_width$}, desc = {desc} }},");
        }
        text.push_str("]\n");
    }
    text
}

fn keys(on: &[Key]) -> String {
    match on {
        [key] => quoted(&key.label()),
        keys => format!("[{}]", keys.iter().map(|key| quoted(&key.label())).collect::<Vec<_>>().join(", ")),
    }
}

fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

/// Unbinds a preset.
const NONE: &str = "none";

/// Characters.
const LONGEST_DESC: usize = 100;

/// An error in an operator's file: a keymap or a theme.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file} line {line}: {what}")]
pub struct FileError {
    pub file: String,
    /// From 1.
    pub line: usize,
    /// What is wrong, and what to do.
    pub what: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Part {
    keys: Vec<Line>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    on: Spanned<On>,
    run: Spanned<String>,
    desc: Option<String>,
}

#[derive(Deserialize)]
#[serde(untagged, expecting = "a key in quotes, or a list of them")]
enum On {
    One(String),
    Chord(Vec<String>),
}

/// A line of the operator's file; no entry = the keys do nothing.
struct Read {
    place: Place,
    on: Vec<Key>,
    entry: Option<&'static Entry>,
    desc: Option<String>,
    at: Range<usize>,
}

/// An operator's file.
pub struct Source<'a> {
    pub file: &'a str,
    pub text: &'a str,
}

impl Source<'_> {
    /// An error at that byte.
    pub fn wrong(&self, at: usize, what: impl Into<String>) -> FileError {
        let line = self.text.get(..at).map_or(1, |before| before.matches('\n').count() + 1);
        FileError { file: clean(self.file, 200), line, what: clean(&what.into(), 300) }
    }

    pub fn parsed<T: DeserializeOwned>(&self) -> Result<T, FileError> {
        toml::from_str(self.text).map_err(|error| {
            let at = error.span().map_or(0, |span| span.start);
            self.wrong(at, error.message().trim().replace('\n', "; "))
        })
    }
}

fn lines(source: &Source) -> Result<Vec<Read>, FileError> {
    let parts: BTreeMap<Spanned<String>, Part> = source.parsed()?;
    let mut read: Vec<Read> = Vec::new();
    for (name, part) in parts {
        let place = Place::all().find(|place| place.name() == *name.get_ref()).ok_or_else(|| {
            let known: Vec<String> = Place::all().map(Place::name).collect();
            let what = format!("there is no section '{}'; choose {}", name.get_ref(), known.join(", "));
            source.wrong(name.span().start, what)
        })?;
        for line in part.keys {
            let one = one(source, place, line)?;
            if read.iter().any(|other| other.place == place && other.on == one.on) {
                let keys = chord_label(&one.on);
                return Err(source.wrong(one.at.start, format!("'{keys}' appears twice in [{}]", place.name())));
            }
            read.push(one);
        }
    }
    Ok(read)
}

fn one(source: &Source, place: Place, line: Line) -> Result<Read, FileError> {
    let at = line.on.span();
    let on = read_keys(source, at.start, line.on.into_inner())?;
    let (run, run_at) = (line.run.get_ref().as_str(), line.run.span().start);
    let entry = VERBS.iter().find(|entry| entry.name == run);
    if entry.is_none() && run != NONE {
        let what = format!("there is no command '{run}'; authros --print-default-keymap and the palette list them all");
        return Err(source.wrong(run_at, what));
    }
    let desc = line.desc.map(|desc| clean(&desc, LONGEST_DESC));
    Ok(Read { place, on, entry, desc, at })
}

fn read_keys(source: &Source, at: usize, on: On) -> Result<Vec<Key>, FileError> {
    let labels = match on {
        On::One(label) => vec![label],
        On::Chord(labels) => labels,
    };
    if labels.is_empty() || labels.len() > LONGEST_CHORD {
        return Err(source.wrong(at, format!("give one key, or a list of up to {LONGEST_CHORD}")));
    }
    let key = |label: &String| {
        Key::from_label(label).ok_or_else(|| {
            let what = "is not a key that every terminal sends; use one like q, G, space, enter, pgup, ^x";
            source.wrong(at, format!("'{label}' {what}"))
        })
    };
    labels.iter().map(key).collect()
}

/// Refuses chords hidden behind shorter ones, and screens without a way to the palette or out.
fn reachable(source: &Source, keymap: &Keymap, lines: &[Read], screen: Screen) -> Result<(), FileError> {
    let bindings = keymap.bindings(screen);
    let hidden = |long: &&Binding| bindings.iter().any(|short| long.begins_with(&short.on));
    if let Some(long) = bindings.iter().find(hidden) {
        let by = bindings.iter().find(|short| long.begins_with(&short.on)).map_or("", |short| short.entry.name);
        let what = format!(
            "on the {} screen '{}' cannot be reached because '{by}' already has a meaning; remove it with run = \
             \"none\"",
            screen.title(),
            chord_label(&long.on)
        );
        let concerned = |line: &&Read| line.on.starts_with(&long.on) || long.on.starts_with(&line.on);
        return Err(source.wrong(lines.iter().find(concerned).map_or(0, |line| line.at.start), what));
    }
    for verb in [Verb::Palette, Verb::Quit] {
        if !bindings.iter().any(|binding| binding.entry.verb == verb) {
            let taken =
                |line: &&Read| VERBS.iter().any(|entry| entry.verb == verb && entry.chords().any(|on| on == line.on));
            let at = lines.iter().rfind(taken).map_or(0, |line| line.at.start);
            let name = VERBS.iter().find(|entry| entry.verb == verb).map_or("", |entry| entry.name);
            let what = format!("on the {} screen no key is left for '{name}'", screen.title());
            return Err(source.wrong(at, what));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_keys_mean_two_things_on_one_screen() {
        for screen in Screen::all() {
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

#[cfg(test)]
mod preset_tests {
    use super::*;

    #[test]
    fn the_text_read_as_a_file_is_the_preset() {
        let read = Keymap::with_file("keymap.toml", &preset_text()).expect("reads");
        let preset = Keymap::default();
        for screen in Screen::all() {
            let on = |keymap: &Keymap| -> Vec<(String, &'static str)> {
                let lines = keymap.bindings(screen).iter();
                let mut lines: Vec<_> = lines.map(|binding| (chord_label(&binding.on), binding.entry.name)).collect();
                lines.sort();
                lines
            };
            assert_eq!(on(&read), on(&preset));
        }
    }
}

#[cfg(test)]
mod file_tests {
    use super::*;

    fn refused(text: &str) -> (usize, String) {
        let error = Keymap::with_file("keymap.toml", text).expect_err(text);
        assert_eq!(error.file, "keymap.toml");
        (error.line, error.what)
    }

    #[test]
    fn only_what_differs_is_named() {
        let text = "[topics]\nkeys = [\n  { on = \"v\", run = \"watch\", desc = \"Look\" },\n  { on = \"w\", run = \"none\" },\n\
                    ]\n[everywhere]\nkeys = [{ on = [\"z\", \"q\"], run = \"quit\" }]\n";
        let keymap = Keymap::with_file("keymap.toml", text).expect("reads");
        assert_eq!(keymap.meaning(&[Key::Char('v')], Screen::Topics), Meaning::Does(Verb::Watch));
        assert_eq!(keymap.meaning(&[Key::Char('w')], Screen::Topics), Meaning::Nothing);
        assert_eq!(keymap.meaning(&[Key::Char('w')], Screen::Overview), Meaning::Does(Verb::Watch));
        assert_eq!(keymap.meaning(&[Key::Char('z'), Key::Char('q')], Screen::Log), Meaning::Does(Verb::Quit));
        assert_eq!(keymap.meaning(&[Key::Char('q')], Screen::Log), Meaning::Does(Verb::Quit));
        let words: Vec<&str> = keymap.bindings(Screen::Topics).iter().map(Binding::help).collect();
        assert!(words.contains(&"Look"));
        assert_eq!(Keymap::with_file("keymap.toml", "").expect("nothing differs"), Keymap::default());
    }

    #[test]
    fn unknown_and_doubled_entries_name_file_and_line() {
        let (line, what) = refused("[topics]\nkeys = [\n  { on = \"v\", run = \"wacth\" },\n]\n");
        assert!(line == 3 && what.contains("wacth"), "{line} {what}");
        let (line, what) = refused("# mine\n[topic]\nkeys = []\n");
        assert!(line == 2 && what.contains("'topic'") && what.contains("topics"), "{line} {what}");
        let (line, what) =
            refused("[log]\nkeys = [\n { on = \"v\", run = \"sort\" },\n { on = \"v\", run = \"filter\" }]\n");
        assert!(line == 4 && what.contains("twice"), "{line} {what}");
        let (line, what) = refused("[log]\nkeys = [\n { on = \"v\", rum = \"sort\" }]\n");
        assert!(line == 3 && what.contains("rum"), "{line} {what}");
        let (line, what) = refused("[log]\nkeys = []\n\n[log]\nkeys = []\n");
        assert!(line >= 4 && !what.is_empty(), "{line} {what}");
        for bad in ["f5", "alt-x", "^m", ""] {
            let (line, what) = refused(&format!("[log]\nkeys = [\n{{ on = \"{bad}\", run = \"sort\" }}]\n"));
            assert!(line == 3 && what.contains("not a key"), "{line} {what}");
        }
        assert_eq!(refused("[log]\nkeys = [\n{ on = [], run = \"sort\" }]").0, 3);
        assert_eq!(refused("[log]\nkeys = [\n{ on = 7, run = \"sort\" }]").0, 3);
        assert_eq!(refused("\n\n[log\n").0, 3);
    }

    #[test]
    fn nothing_hides_behind_another_and_a_way_out_is_left() {
        let (line, what) = refused("[topics]\nkeys = [\n{ on = [\"w\", \"x\"], run = \"sort\" }]\n");
        assert!(line == 3 && what.contains("'w x'") && what.contains("watch"), "{line} {what}");
        let (line, what) = refused("[everywhere]\nkeys = [\n{ on = \"z\", run = \"sort\" }]\n");
        assert!(line == 3 && what.contains("cannot be reached"), "{line} {what}");
        let (line, what) =
            refused("[everywhere]\nkeys = [{ on = \"q\", run = \"none\" },\n{ on = \"^c\", run = \"none\" }]\n");
        assert!(line == 3 && what.contains("quit"), "{line} {what}");
        refused("[everywhere]\nkeys = [{ on = \":\", run = \"none\" }]\n");
    }
}
