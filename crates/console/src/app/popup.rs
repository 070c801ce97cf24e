//! The popups over a screen. The topmost popup has the keys; `q` or Esc closes it.

use super::action::Errand;
use super::administration::Act;
use super::available::available;
use super::browse::Browse;
use super::columns::ColumnChoice;
use super::confirm::Typed;
use super::contacts::Book;
use super::field::Field;
use super::form::Form;
use super::fuzzy;
use super::incidents::IncidentList;
use super::key::Key;
use super::leaving::Leaving;
use super::opening::Opening;
use super::screens::log::LogLine;
use super::state::State;
use super::themes::ThemeChoice;
use super::verb::{Entry, VERBS};
use crate::service::Failure;
use crate::service::reply::{PinsView, Provenance, RobotView};

/// A popup over the screen.
#[derive(Debug)]
#[allow(clippy::large_enum_variant, reason = "a handful at a time, and rarely moved")]
pub enum Popup {
    /// Every command by name.
    Palette(Palette),
    /// What each key does here.
    Help(Help),
    /// Yes or no, default no.
    Confirm(Confirm),
    /// A form.
    Form(Purpose, Form),
    /// A record's provenance and state.
    Provenance(Lookup<Provenance>),
    /// An opened record.
    Record(Opening),
    /// The first keys of a chord; the possible next keys are shown.
    Chord(Vec<Key>),
    /// Choosing of a theme.
    Themes(ThemeChoice),
    /// Choosing of a list's columns.
    Columns(ColumnChoice),
    /// Publishers of a topic: pinned, suspect, quarantined.
    Publishers(Lookup<PinsView>),
    /// Who can read these topics now; empty = all.
    Readers(Vec<String>),
    /// Running commands and what waits.
    Tasks,
    /// The keyring to be unlocked is open already.
    Unlocked,
    /// A line of the log, whole.
    Line(LogLine),
    /// Choosing among what others share.
    Browse(Browse),
    /// The address book.
    Contacts(Book),
    /// The incidents.
    Incidents(IncidentList),
    /// A robot: its policy, topics, losses.
    Robot(Lookup<RobotView>),
    /// Leaving while something would stop, or is not done.
    Quit(Leaving),
}

/// The purpose of a form.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// Passphrase of a new identity.
    CreateIdentity,
    /// Passphrase of a locked keyring.
    Unlock,
    /// Terms of a grant.
    Grant,
    /// A new end for a grant.
    Extend,
    /// A key file.
    LoadKey,
    /// Which key to export.
    ExportKey,
    /// Where records are exported to.
    Export,
    /// The account of an administrator's act.
    Administer(Act),
    /// A name for an account.
    AddContact,
    /// A span to keep.
    OpenIncident,
    /// Words about an incident.
    NoteIncident,
    /// A robot and the file of its policy.
    SetPolicy,
    /// Which profile to speak for.
    Profile,
    /// A publisher of this kind of topic that is no longer accepted.
    Unpin,
}

/// A question answered by `y`; anything else means no.
#[derive(Debug)]
pub struct Confirm {
    /// The question.
    pub title: String,
    /// What it means.
    pub lines: Vec<String>,
    /// The word beside `y`.
    pub yes: &'static str,
    /// What must be typed instead of `y`, if the act is grave.
    pub typed: Option<Typed>,
    /// What `y` sends.
    pub errand: Errand,
}

/// Something requested by id, shown when it arrives.
#[derive(Debug)]
pub struct Lookup<T> {
    /// The request.
    pub id: String,
    /// The answer, once it has arrived.
    pub answer: Option<Result<Box<T>, Failure>>,
    /// First line shown.
    pub scroll: usize,
}

impl<T> Lookup<T> {
    /// Requested, not here yet.
    pub fn new(id: &str) -> Self {
        Self { id: id.to_owned(), answer: None, scroll: 0 }
    }

    /// The answer, if it has arrived and is not a failure.
    pub fn found(&self) -> Option<&T> {
        self.answer.as_ref()?.as_ref().ok().map(Box::as_ref)
    }
}

/// What each key does, narrowed by what is typed.
#[derive(Debug, Default)]
pub struct Help {
    /// First line shown.
    pub scroll: usize,
    /// What is typed after `/`.
    pub filter: Field,
    /// Whether it is being typed.
    pub filtering: bool,
    /// The keys of the window below; `None` = those of the screen.
    pub window: Option<Vec<(&'static str, &'static str)>>,
}

/// Every command by name, narrowed by what is typed.
#[derive(Debug, Default)]
pub struct Palette {
    /// What is typed.
    pub field: Field,
    /// The selected match.
    pub selected: usize,
    /// Which of the commands before is in the field, counted from the newest.
    pub recalled: Option<usize>,
}

impl Palette {
    /// The matching commands: available ones first, best match first.
    pub fn matches(&self, state: &State) -> Vec<&'static Entry> {
        let score = |entry: &'static Entry| {
            let name = fuzzy::score(self.field.text(), entry.name);
            name.or_else(|| fuzzy::whole_words(self.field.text(), entry.help).then_some(100))
        };
        let listed = VERBS.iter().filter(|entry| {
            entry.palette && !(state.settings.read_only && entry.changes) && super::tour::knows(state, entry.verb)
        });
        let mut found: Vec<_> = listed.filter_map(|entry| score(entry).map(|score| (score, entry))).collect();
        found.sort_by_key(|(score, entry)| (available(state, entry.verb).is_err(), *score));
        found.into_iter().map(|(_, entry)| entry).collect()
    }
}
