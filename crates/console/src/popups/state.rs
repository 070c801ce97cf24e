//! The popups over a screen, and what the smaller ones know; the topmost has the keys.

use std::path::PathBuf;

use crate::app::{feeds::Feed, form::Field, form::Form, key::Key, verb::Errand, verb::Tag};
use crate::popups::{
    columns::state::ColumnChoice, incidents::state::IncidentList, lookup::Lookup, record::state::Opening,
};
use crate::screens::{chain::state::Act, log::state::LogLine};
use crate::service::reply::{PinsView, Provenance, RobotView};

#[derive(Debug)]
#[allow(clippy::large_enum_variant, reason = "a handful at a time, and rarely moved")]
pub enum Popup {
    Palette(Palette),
    Help(Help),
    /// Yes or no, default no.
    Confirm(Confirm),
    Form(Purpose, Form),
    Provenance(Lookup<Provenance>),
    Record(Opening),
    /// A chord's first keys; shows the possible next ones.
    Chord(Vec<Key>),
    Themes(ThemeChoice),
    Columns(ColumnChoice),
    Publishers(Lookup<PinsView>),
    /// Who can read these topics now; empty = all.
    Readers(Vec<String>),
    Tasks,
    /// In full; the first line shown.
    Alerts(usize),
    /// The keyring to unlock is open already.
    Unlocked,
    Line(LogLine),
    /// The selected line.
    Browse(usize),
    /// The selected line.
    Contacts(usize),
    Incidents(IncidentList),
    Robot(Lookup<RobotView>),
    Quit(Leaving),
}

impl Popup {
    /// Besides those of the screen: a grant needs the address book, confirmations need the grants.
    pub fn feeds(&self) -> &'static [Feed] {
        match self {
            Self::Form(Purpose::Grant, _) => &[Feed::Grants, Feed::Contacts, Feed::Topics],
            Self::Form(Purpose::OpenIncident | Purpose::ExportEvidence, _) | Self::Incidents(_) => {
                &[Feed::Incidents, Feed::Topics]
            }
            Self::Confirm(_) | Self::Readers(_) => &[Feed::Grants],
            Self::Contacts(_) => &[Feed::Contacts, Feed::Topics],
            Self::Tasks => &[Feed::Chain, Feed::Progress],
            _ => &[],
        }
    }

    /// Whether it takes `?` as text or handles it.
    pub fn takes_text(&self) -> bool {
        match self {
            Self::Form(_, form) => {
                form.field(form.focus).is_some_and(|field| field.is_masked() || !field.text().is_empty())
            }
            Self::Palette(palette) => !palette.field.text().is_empty(),
            Self::Confirm(confirm) => confirm.typed.is_some(),
            Self::Help(_) | Self::Chord(_) => true,
            _ => false,
        }
    }

    pub fn paste(&mut self, text: &str) {
        match self {
            Self::Form(_, form) => form.paste(text),
            Self::Palette(palette) => palette.field.insert(text),
            Self::Confirm(Confirm { typed: Some(typed), .. }) => typed.field.insert(text),
            _ => {}
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ThemeChoice {
    pub selected: usize,
    /// The previous theme, which Esc restores.
    pub before: String,
}

/// Answered by `y`; anything else means no.
#[derive(Debug)]
pub struct Confirm {
    pub title: String,
    pub lines: Vec<String>,
    /// The word beside `y`.
    pub yes: &'static str,
    /// Typed instead of `y` for a grave act.
    pub typed: Option<Typed>,
    pub errand: Errand,
}

#[derive(Debug)]
pub struct Typed {
    pub wanted: String,
    pub field: Field,
}

impl Typed {
    pub fn new(wanted: &str) -> Self {
        Self { wanted: wanted.to_owned(), field: Field::default() }
    }

    pub fn is_done(&self) -> bool {
        self.field.text().trim() == self.wanted
    }
}

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
    ExportEvidence,
    SetPolicy,
    Limit,
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

#[derive(Debug, Default)]
pub struct Help {
    pub scroll: usize,
    /// Typed after `/`.
    pub filter: Field,
    pub filtering: bool,
    /// Keys of the window below; `None` = those of the screen.
    pub window: Option<Vec<(&'static str, &'static str)>>,
}

#[derive(Debug, Default)]
pub struct Palette {
    pub field: Field,
    pub selected: usize,
    /// Recalled command, counted from the newest.
    pub recalled: Option<usize>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Leaving {
    Asked,
    /// Quits when everything is verified.
    WhenVerified,
    /// Capture is paused; quits when everything is verified.
    Held,
}
