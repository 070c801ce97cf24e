//! Completing a path in a form as a shell does: as far as all names agree; pressed again, tab lists them. The folder
//! is read outside, because nothing here waits. Exports go where such a path says.

use std::path::PathBuf;

use super::action::{Effect, Errand, Tag};
use super::form::{self, Field, Form, LONGEST, Line};
use super::key::Key;
use super::popup::{Popup, Purpose};
use super::state::{Settings, State};
use crate::model::{clean, is_shown};
use crate::service::Command;

/// The most names in a list.
const MOST_LISTED: usize = 200;
/// The most characters of a name in a list.
const WIDEST_NAME: usize = 60;

/// What a path in a form leads to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PathKind {
    /// A file; folders are on the way to it.
    File,
    /// A folder.
    Folder,
}

/// The beginning of a path that was typed, and the folder to search for it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sought {
    /// The text as it was typed.
    pub typed: String,
    /// The folder to read, absolute.
    pub folder: PathBuf,
    /// The beginning of the names wanted; hidden names only if it begins with a dot.
    pub begun: String,
    /// What the path leads to.
    pub kind: PathKind,
}

/// A name in a folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Candidate {
    /// The name; it comes from others.
    pub name: String,
    /// Whether it is a folder.
    pub folder: bool,
}

/// The names that begin as wanted.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Found {
    /// By name.
    pub names: Vec<Candidate>,
    /// Whether the folder holds more than was read.
    pub more: bool,
}

impl Candidate {
    /// Whether it can be typed into a line: other names are listed, and never completed.
    fn is_typable(&self) -> bool {
        self.name.trim() == self.name && self.name.chars().all(is_shown)
    }

    fn shown(&self) -> String {
        let name = clean(&self.name, WIDEST_NAME);
        if self.folder { format!("{name}/") } else { name }
    }
}

/// The path meant by a text: `~` is the operator's home, and relative paths start where the console was started.
pub fn resolve(text: &str, settings: &Settings) -> PathBuf {
    match (text.strip_prefix('~'), &settings.home) {
        (Some(""), Some(home)) => home.clone(),
        (Some(rest), Some(home)) if rest.starts_with('/') => home.join(rest.trim_start_matches('/')),
        _ => settings.directory.join(text),
    }
}

/// What tab asks for in this form; `None` if the line with the focus is no path.
fn sought(form: &Form, settings: &Settings) -> Option<Sought> {
    let kind = form.lines.get(form.focus)?.path?;
    let typed = form.text(form.focus).to_owned();
    let (folder, begun) = match typed.rsplit_once('/') {
        // All that there is of the root is its slash.
        Some((folder, begun)) => (format!("{folder}/"), begun.to_owned()),
        None if typed == "~" => ("~".to_owned(), String::new()),
        None => (String::new(), typed.clone()),
    };
    Some(Sought { folder: resolve(&folder, settings), begun, kind, typed })
}

/// A key of a form: tab in a path requests its completion.
pub fn tab(state: &State, form: &Form, key: Key) -> Option<Effect> {
    if key != Key::Tab {
        return None;
    }
    sought(form, &state.settings).map(Effect::FindPaths)
}

/// Completes the path of the form on top, if it is still the one that was asked about.
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
        // What was not read might begin otherwise.
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
        several => common(several),
    };
    let line = format!("{stem}{}", whole.unwrap_or_else(|| sought.begun.clone()));
    if line.chars().count() > LONGEST {
        form.told.push(format!("the whole path is longer than the {LONGEST} characters of this line"));
    } else if line != sought.typed {
        form.set(form.focus, Field::with(&line));
        form.tabbed = (found.names.len() > 1).then_some(line);
    } else if found.names.len() == 1 && !typable.is_empty() {
        // Nothing is left to complete: on to the next line.
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

/// The longest common beginning of the names.
fn common(several: &[&Candidate]) -> Option<String> {
    let mut names = several.iter().map(|candidate| candidate.name.as_str());
    let first = names.next()?.to_owned();
    Some(names.fold(first, |common, name| {
        let same = common.chars().zip(name.chars()).take_while(|(one, other)| one == other);
        same.map(|(character, _)| character).collect()
    }))
}

/// The names, as lines below the form: each drawn as far as there is room.
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

/// The path of a line, absolute; `None` if it is empty.
pub fn of_line(form: &Form, line: usize, settings: &Settings) -> Option<PathBuf> {
    let text = form.text(line).trim();
    (!text.is_empty()).then(|| resolve(text, settings))
}

/// What is being exported, and where to.
#[derive(Debug, Default)]
pub struct Exports {
    /// The records that the form on screen is about.
    ids: Vec<String>,
    /// The folder written last, as it was typed.
    last: String,
    /// Where the answers under way are written, if not where the console was started.
    folders: Vec<(Tag, PathBuf)>,
}

/// The line that asks for a folder.
pub fn folder_line(state: &State) -> Line {
    let hint = "empty = where this console was started";
    Line::text("Folder", hint, Field::offering(&state.exports.last)).path(PathKind::Folder)
}

/// Asks which key to export, and where it goes.
pub fn begin_key(state: &mut State) {
    let form = form::export_key(folder_line(state));
    state.popups.push(Popup::Form(Purpose::ExportKey, form));
}

/// Asks where the marked records go, or the one under the cursor.
pub fn begin(state: &mut State) {
    let marked: Vec<String> = state.table().map(|table| table.marks.iter().cloned().collect()).unwrap_or_default();
    let ids = if marked.is_empty() { state.row_key().into_iter().collect() } else { marked };
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

/// Sends what the form asks for; what is on its way already is not asked for again.
pub fn submit(state: &mut State, form: &Form) -> Vec<Effect> {
    let ids = std::mem::take(&mut state.exports.ids);
    let fresh: Vec<Errand> = ids
        .into_iter()
        .map(|id| Errand { command: Command::ExportUpload { id: id.clone(), addresses: false }, tag: Tag::Export(id) })
        .filter(|errand| !state.work.contains(&errand.tag))
        .collect();
    fresh
        .into_iter()
        .map(|errand| {
            goes_to(state, &errand.tag, form, 0);
            state.send(errand)
        })
        .collect()
}

/// Notes the folder in that line of the form for the answer with that tag.
pub fn goes_to(state: &mut State, tag: &Tag, form: &Form, line: usize) {
    form.text(line).trim().clone_into(&mut state.exports.last);
    state.exports.folders.retain(|(other, _)| other != tag);
    if let Some(folder) = of_line(form, line, &state.settings) {
        state.exports.folders.push((tag.clone(), folder));
    }
}

/// Where the answer with that tag is written; `None` = where the console was started.
pub fn folder_of(state: &mut State, tag: &Tag) -> Option<PathBuf> {
    let place = state.exports.folders.iter().position(|(other, _)| other == tag)?;
    Some(state.exports.folders.remove(place).1)
}
