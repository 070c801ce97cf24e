//! Completion of names and paths in forms; folders are read outside: nothing here waits.

use std::path::PathBuf;

use crate::app::form::{Field, Form, LONGEST, PathKind};
use crate::app::{matching::common, settings::Settings};
use crate::model::{clean, is_shown};

const MOST_LISTED: usize = 200;

/// Characters of a listed name.
const WIDEST_NAME: usize = 60;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sought {
    pub typed: String,
    /// Absolute.
    pub folder: PathBuf,
    /// Names must begin with this; hidden names only match a leading dot.
    pub begun: String,
    pub kind: PathKind,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Candidate {
    /// Foreign text.
    pub name: String,
    pub folder: bool,
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Found {
    pub names: Vec<Candidate>,
    /// Whether the folder holds more than was read.
    pub more: bool,
}

impl Candidate {
    /// Names that cannot be typed are listed, and never completed.
    fn is_typable(&self) -> bool {
        self.name.trim() == self.name && self.name.chars().all(is_shown)
    }

    fn shown(&self) -> String {
        let name = clean(&self.name, WIDEST_NAME);
        if self.folder { format!("{name}/") } else { name }
    }
}

/// `~` is the operator's home; relative paths start at the working directory.
pub fn resolve(text: &str, settings: &Settings) -> PathBuf {
    match (text.strip_prefix('~'), &settings.home) {
        (Some(""), Some(home)) => home.clone(),
        (Some(rest), Some(home)) if rest.starts_with('/') => home.join(rest.trim_start_matches('/')),
        _ => settings.directory.join(text),
    }
}

/// `None` if the focused line is no path.
pub fn sought(form: &Form, settings: &Settings) -> Option<Sought> {
    let kind = form.lines.get(form.focus)?.path?;
    let typed = form.text(form.focus).to_owned();
    let (folder, begun) = match typed.rsplit_once('/') {
        // The root is only its slash.
        Some((folder, begun)) => (format!("{folder}/"), begun.to_owned()),
        None if typed == "~" => ("~".to_owned(), String::new()),
        None => (String::new(), typed.clone()),
    };
    Some(Sought { folder: resolve(&folder, settings), begun, kind, typed })
}

pub fn complete(form: &mut Form, sought: &Sought, found: &Found, listed: bool) {
    if found.more {
        // Unread names might begin otherwise.
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
        several => common(several.iter().map(|candidate| candidate.name.as_str())),
    };
    let line = format!("{stem}{}", whole.unwrap_or_else(|| sought.begun.clone()));
    if line.chars().count() > LONGEST {
        form.told.push(format!("the whole path is longer than the {LONGEST} characters of this line"));
    } else if line != sought.typed {
        form.set(form.focus, Field::with(&line));
        form.tabbed = (found.names.len() > 1).then_some(line);
    } else if found.names.len() == 1 && !typable.is_empty() {
        // Nothing left to complete: on to the next line.
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

/// Absolute path; `None` if the line is empty.
pub fn of_line(form: &Form, line: usize, settings: &Settings) -> Option<PathBuf> {
    let text = form.text(line).trim();
    (!text.is_empty()).then(|| resolve(text, settings))
}

pub fn complete_from(form: &mut Form, names: &[String]) -> bool {
    let text = form.text(form.focus).to_owned();
    let (before, begun) = text.rsplit_once([' ', ',']).map_or(("", text.as_str()), |(before, begun)| (before, begun));
    let fitting = names.iter().map(String::as_str).filter(|name| name.starts_with(begun));
    let Some(whole) = common(fitting).filter(|whole| !begun.is_empty() && whole != begun) else { return false };
    let line = if before.is_empty() { whole } else { format!("{before} {whole}") };
    form.set(form.focus, Field::with(&line));
    true
}
