//! Exports of records: where their files go.

use std::path::PathBuf;

use crate::app::{Errand, Field, Form, Line, PathKind, Popup, Purpose, State, Tag, completion};
use crate::model::counted;
use crate::service::Command;

pub fn folder_line(state: &State) -> Line {
    let hint = "empty = where this console was started";
    Line::text("Folder", hint, Field::offering(&state.exports.last)).path(PathKind::Folder)
}

pub fn begin(state: &mut State) {
    let ids = state.marked_keys();
    let title = format!("Export {}", counted(ids.len() as u64, "record"));
    let notes = vec![
        "Writes the files for others to check: ciphertext, header, proof.".to_owned(),
        "Each record gets a new folder; nothing is overwritten.".to_owned(),
    ];
    let form = Form::new(title, notes, vec![folder_line(state)]);
    state.exports.ids = ids;
    state.popups.push(Popup::Form(Purpose::Export, form));
}

pub fn submit(state: &mut State, form: &Form) {
    let ids = std::mem::take(&mut state.exports.ids);
    let errand = |id: String| Errand {
        command: Command::ExportUpload { id: id.clone(), addresses: false },
        tag: Tag::Export(id),
    };
    let fresh: Vec<Errand> = ids.into_iter().map(errand).filter(|errand| !state.work.contains(&errand.tag)).collect();
    for errand in fresh {
        goes_to(state, &errand.tag, form, 0);
        state.send(errand);
    }
}

pub fn goes_to(state: &mut State, tag: &Tag, form: &Form, line: usize) {
    form.text(line).trim().clone_into(&mut state.exports.last);
    state.exports.folders.retain(|(other, _)| other != tag);
    if let Some(folder) = completion::of_line(form, line, &state.settings) {
        state.exports.folders.push((tag.clone(), folder));
    }
}

/// `None` = the working directory.
pub fn folder_of(state: &mut State, tag: &Tag) -> Option<PathBuf> {
    let place = state.exports.folders.iter().position(|(other, _)| other == tag)?;
    Some(state.exports.folders.remove(place).1)
}
