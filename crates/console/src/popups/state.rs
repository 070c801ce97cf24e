//! The popups over a screen; the topmost has the keys.

use crate::app::{feeds::Feed, form::Form, key::Key};
use crate::popups::{
    columns::state::ColumnChoice, confirm::state::Confirm, form::state::Purpose, help::state::Help,
    incidents::state::IncidentList, lookup::Lookup, palette::state::Palette, quit::state::Leaving,
    record::state::Opening,
};
use crate::screens::log::state::LogLine;
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
            Self::Form(Purpose::OpenIncident, _) | Self::Incidents(_) => &[Feed::Incidents, Feed::Topics],
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
