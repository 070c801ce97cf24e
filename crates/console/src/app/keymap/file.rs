//! The operator's `keymap.toml`: only what differs. Anything unknown, duplicated or unreachable is refused with file
//! and line, before the console opens.

use std::collections::BTreeMap;
use std::ops::Range;

use serde::Deserialize;
use toml::Spanned;

use super::{Binding, Change, Keymap, LONGEST_CHORD, Place};
use crate::app::key::{Key, chord_label};
use crate::app::screen::Screen;
use crate::app::verb::{VERBS, Verb};
use crate::model::clean;

/// The word that unbinds a preset.
const NONE: &str = "none";
/// The most characters of a description.
const LONGEST_DESC: usize = 100;

/// What is wrong with a keymap file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file} line {line}: {what}")]
pub struct KeymapError {
    /// The file.
    pub file: String,
    /// The line, from 1.
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

/// A parsed line.
struct Read {
    place: Place,
    change: Change,
    at: Range<usize>,
}

struct Source<'a> {
    file: &'a str,
    text: &'a str,
}

impl Source<'_> {
    fn wrong(&self, at: usize, what: impl Into<String>) -> KeymapError {
        let line = self.text.get(..at).map_or(1, |before| before.matches('\n').count() + 1);
        KeymapError { file: clean(self.file, 200), line, what: clean(&what.into(), 300) }
    }
}

/// The preset, overridden by the file.
pub fn read(file: &str, text: &str) -> Result<Keymap, KeymapError> {
    let source = Source { file, text };
    let lines = lines(&source)?;
    let changes = |place: Place| -> Vec<Change> {
        lines.iter().filter(|line| line.place == place).map(|line| line.change.clone()).collect()
    };
    let keymap = Keymap::built(&changes);
    for screen in Screen::ALL {
        reachable(&source, &keymap, &lines, screen)?;
    }
    Ok(keymap)
}

fn lines(source: &Source) -> Result<Vec<Read>, KeymapError> {
    let parts: BTreeMap<Spanned<String>, Part> = toml::from_str(source.text).map_err(|error| {
        let at = error.span().map_or(0, |span| span.start);
        source.wrong(at, error.message().trim().replace('\n', "; "))
    })?;
    let mut read: Vec<Read> = Vec::new();
    for (name, part) in parts {
        let place = Place::all().find(|place| place.name() == *name.get_ref()).ok_or_else(|| {
            let known: Vec<String> = Place::all().map(Place::name).collect();
            source.wrong(
                name.span().start,
                format!(
                    "there is no section '{}'; choose \
                                                   {}",
                    name.get_ref(),
                    known.join(", ")
                ),
            )
        })?;
        for line in part.keys {
            let one = one(source, place, line)?;
            if read.iter().any(|other| other.place == place && other.change.on == one.change.on) {
                let keys = chord_label(&one.change.on);
                return Err(source.wrong(one.at.start, format!("'{keys}' appears twice in [{}]", place.name())));
            }
            read.push(one);
        }
    }
    Ok(read)
}

fn one(source: &Source, place: Place, line: Line) -> Result<Read, KeymapError> {
    let at = line.on.span();
    let on = keys(source, at.start, line.on.into_inner())?;
    let (run, run_at) = (line.run.get_ref().as_str(), line.run.span().start);
    let entry = VERBS.iter().find(|entry| entry.name == run);
    if entry.is_none() && run != NONE {
        let what = format!("there is no command '{run}'; authros --print-default-keymap and the palette list them all");
        return Err(source.wrong(run_at, what));
    }
    let desc = line.desc.map(|desc| clean(&desc, LONGEST_DESC));
    Ok(Read { place, change: Change { on, entry, desc }, at })
}

fn keys(source: &Source, at: usize, on: On) -> Result<Vec<Key>, KeymapError> {
    let labels = match on {
        On::One(label) => vec![label],
        On::Chord(labels) => labels,
    };
    if labels.is_empty() || labels.len() > LONGEST_CHORD {
        return Err(source.wrong(at, format!("give one key, or a list of up to {LONGEST_CHORD}")));
    }
    let key = |label: &String| {
        Key::from_label(label).ok_or_else(|| {
            let what = format!(
                "'{label}' is not a key that every terminal sends; use one like q, G, space, enter, \
                                pgup, ^x"
            );
            source.wrong(at, what)
        })
    };
    labels.iter().map(key).collect()
}

/// No chord hides behind a shorter one, and there is a way to the palette and out.
fn reachable(source: &Source, keymap: &Keymap, lines: &[Read], screen: Screen) -> Result<(), KeymapError> {
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
        let concerned = |line: &&Read| line.change.on.starts_with(&long.on) || long.on.starts_with(&line.change.on);
        return Err(source.wrong(lines.iter().find(concerned).map_or(0, |line| line.at.start), what));
    }
    for verb in [Verb::Palette, Verb::Quit] {
        if !bindings.iter().any(|binding| binding.entry.verb == verb) {
            let taken = |line: &&Read| {
                VERBS.iter().any(|entry| entry.verb == verb && entry.chords().any(|on| on == line.change.on))
            };
            let at = lines.iter().rfind(taken).map_or(0, |line| line.at.start);
            let what = format!("on the {} screen no key is left for '{}'", screen.title(), name_of(verb));
            return Err(source.wrong(at, what));
        }
    }
    Ok(())
}

fn name_of(verb: Verb) -> &'static str {
    VERBS.iter().find(|entry| entry.verb == verb).map_or("", |entry| entry.name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::keymap::Meaning;

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
