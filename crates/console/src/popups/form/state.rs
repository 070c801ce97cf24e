//! What a form is for.

use std::path::PathBuf;

use crate::app::verb::Tag;
use crate::screens::chain::state::Act;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    CreateIdentity,
    Unlock,
    Grant,
    Extend,
    LoadKey,
    ExportKey,
    Export,
    Administer(Act),
    AddContact,
    OpenIncident,
    NoteIncident,
    SetPolicy,
    Profile,
    Unpin,
}

#[derive(Debug, Default)]
pub struct Exports {
    /// Records of the form on screen.
    pub ids: Vec<String>,
    /// The last folder, as typed.
    pub last: String,
    /// Target folders of running exports; missing = the working directory.
    pub folders: Vec<(Tag, PathBuf)>,
}
