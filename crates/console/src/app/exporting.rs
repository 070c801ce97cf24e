//! Exporting: into which folder the files of records and keys go.

use std::path::PathBuf;

use super::action::{Effect, Errand, Tag};
use super::field::Field;
use super::form::{Form, Line};
use super::forms;
use super::paths::{self, PathKind};
use super::popup::{Popup, Purpose};
use super::state::State;
use crate::service::Command;

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
    let form = forms::export_key(folder_line(state));
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
    if let Some(folder) = paths::of_line(form, line, &state.settings) {
        state.exports.folders.push((tag.clone(), folder));
    }
}

/// Where the answer with that tag is written; `None` = where the console was started.
pub fn folder_of(state: &mut State, tag: &Tag) -> Option<PathBuf> {
    let place = state.exports.folders.iter().position(|(other, _)| other == tag)?;
    Some(state.exports.folders.remove(place).1)
}
