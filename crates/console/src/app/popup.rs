//! The popups over a screen. The topmost popup has the keys; `q` or Esc closes it. Questions say what an act means
//! before it is done.

use super::action::{Errand, Tag, kind_word};
use super::administration::Act;
use super::available::available;
use super::choosing::{Browse, ColumnChoice, ThemeChoice};
use super::contacts::Book;
use super::form::{Field, Form, GrantWish, KeyWish};
use super::incidents::IncidentList;
use super::key::Key;
use super::leaving::Leaving;
use super::opening::Opening;
use super::screens::grants::{day, earlier, end, scope};
use super::screens::log::LogLine;
use super::state::State;
use super::verb::{Entry, VERBS};
use super::{granting, palette};
use crate::model::TopicName;
use crate::service::command::Held;
use crate::service::reply::{GrantRow, PinsView, Provenance, RobotView, TopicRow};
use crate::service::{Command, Epochs, Failure, KeyKind};

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
            let name = palette::score(self.field.text(), entry.name);
            name.or_else(|| palette::whole_words(self.field.text(), entry.help).then_some(100))
        };
        let listed = VERBS.iter().filter(|entry| {
            entry.palette && !(state.settings.read_only && entry.changes) && super::tour::knows(state, entry.verb)
        });
        let mut found: Vec<_> = listed.filter_map(|entry| score(entry).map(|score| (score, entry))).collect();
        found.sort_by_key(|(score, entry)| (available(state, entry.verb).is_err(), *score));
        found.into_iter().map(|(_, entry)| entry).collect()
    }
}

/// A word that must be typed for a grave act.
#[derive(Debug)]
pub struct Typed {
    /// The word.
    pub wanted: String,
    /// What is typed.
    pub field: Field,
}

impl Typed {
    /// Nothing typed yet.
    pub fn new(wanted: &str) -> Self {
        Self { wanted: wanted.to_owned(), field: Field::default() }
    }

    /// Whether the word is complete.
    pub fn is_done(&self) -> bool {
        self.field.text().trim() == self.wanted
    }
}

/// Before accepting the publishers being read now.
pub fn pin(row: &TopicRow, topic: TopicName) -> Confirm {
    let lines = vec![
        format!("Topic       {topic}"),
        format!(
            "Publishers  {}",
            if row.publishers.is_empty() { "nobody".to_owned() } else { row.publishers.join(" ") }
        ),
        "Their messages are captured from now on; those of others are quarantined.".to_owned(),
        "Check host and type first: enter shows them (a name alone can be forged).".to_owned(),
    ];
    let tag = Tag::Pin(topic.to_string());
    let errand = Errand { command: Command::PinTopic { topic, publishers: Vec::new() }, tag };
    Confirm { title: "Accept these publishers?".to_owned(), lines, yes: "pin", typed: None, errand }
}

/// Before releasing or deleting quarantined messages.
pub fn decide(row: &TopicRow, topic: TopicName, discard: bool) -> Confirm {
    let held = Held { topic: Some(topic.clone()), ids: Vec::new() };
    let mut lines = vec![format!("Topic  {topic}"), format!("Held   {} messages", row.quarantined)];
    let name = topic.to_string();
    if discard {
        lines.push("Their ciphertext is deleted. Quarantine records on the chain count them, so that".to_owned());
        lines.push("nobody can pick evidence; the messages themselves cannot be restored.".to_owned());
        let errand = Errand { command: Command::DiscardHeld { held }, tag: Tag::Discard(name.clone()) };
        let typed = Some(Typed::new(&name));
        return Confirm { title: "Discard quarantined messages?".to_owned(), lines, yes: "discard", typed, errand };
    }
    lines.push("They are anchored like others and keep the tag that they were quarantined.".to_owned());
    let errand = Errand { command: Command::ReleaseHeld { held }, tag: Tag::Release(name) };
    Confirm { title: "Release quarantined messages?".to_owned(), lines, yes: "release", typed: None, errand }
}

/// Before a grant: what it opens, and who can read already.
pub fn grant(state: &State, wish: GrantWish) -> Confirm {
    let topics: Vec<String> = wish.topics.iter().map(ToString::to_string).collect();
    let epochs = match wish.epochs {
        Epochs::Current => granting::opens(state),
        Epochs::All => "all epochs, including earlier records".to_owned(),
    };
    let ends = wish.expires.map_or_else(|| "no end".to_owned(), |moment| format!("{} UTC", day(moment)));
    let mut lines = vec![
        format!("To       {}", wish.grantee),
        format!("Topics   {}", if topics.is_empty() { scope(&topics) } else { topics.join(" ") }),
        format!("Records  {epochs}"),
        format!("Ends     {ends}"),
        String::new(),
    ];
    lines.extend(readers(state, "Current readers:", None));
    lines.push("A later revoke stops new records; what was read cannot be recalled.".to_owned());
    Confirm { title: "Grant this?".to_owned(), lines, yes: "grant", typed: None, errand: wish.errand() }
}

/// Before a revoke: what it does and what it cannot do.
pub fn revoke(state: &State, row: &GrantRow) -> Confirm {
    let mut lines = vec![
        format!("From    {}", row.grantee),
        format!("Shared  {}, {}{}", scope(&row.topics), end(row.expires), earlier(row)),
        String::new(),
        "The next record is sealed under a new key that this account does not get.".to_owned(),
        "What was already read cannot be recalled, and records sealed before".to_owned(),
        "stay readable to anyone who has their key.".to_owned(),
        "This is a transaction; to share again, make a new grant.".to_owned(),
        String::new(),
    ];
    lines.extend(readers(state, "Who can read afterwards:", Some(row)));
    let errand = Errand { command: Command::Revoke { grantee: row.grantee.into() }, tag: Tag::Revoke(row.grantee) };
    Confirm { title: format!("Revoke {}?", row.grantee.short()), lines, yes: "revoke", typed: None, errand }
}

/// Before one key replaces another.
pub fn load_key(wish: KeyWish) -> Confirm {
    let KeyWish { kind, path, passphrase } = wish;
    let what = match kind {
        KeyKind::Sm4 => "A new epoch begins with it; old records stay readable with their own keys.",
        KeyKind::Sm2 => "The new key is registered on the chain; new records are signed with it.",
        KeyKind::Eoa => "Your address on the chain changes: grants and records of the old one stay with it.",
    };
    let file = format!("File  {}", path.display());
    let lines =
        vec![file, what.to_owned(), "The current key is replaced; export it first if you still need it.".to_owned()];
    let errand = Errand { command: Command::LoadKey { kind, path, passphrase }, tag: Tag::LoadKey(kind) };
    Confirm { title: format!("Replace the {} key?", kind_word(kind)), lines, yes: "replace", typed: None, errand }
}

/// Before a new epoch.
pub fn rotate() -> Confirm {
    let lines = vec![
        "The next record is encrypted under a new key.".to_owned(),
        "Current readers keep access (their keys are re-wrapped). Sends a transaction.".to_owned(),
    ];
    let errand = Errand { command: Command::RotateKeys, tag: Tag::Rotate };
    Confirm { title: "Begin a new epoch?".to_owned(), lines, yes: "rotate", typed: None, errand }
}

/// The present readers, one line each, under a title; `without` is left out.
pub fn readers(state: &State, title: &str, without: Option<&GrantRow>) -> Vec<String> {
    let readers = state.grants.readers(without.map(|row| row.grantee));
    let mut lines = vec![title.to_owned()];
    if state.awaits(super::feed::Feed::Grants) {
        lines.push("  (the list of grants has not arrived yet)".to_owned());
    } else if readers.is_empty() {
        lines.push("  nobody but you".to_owned());
    }
    let more = readers.len().saturating_sub(5);
    lines.extend(readers.into_iter().take(5).map(|reader| format!("  {reader}")));
    if more > 0 {
        lines.push(format!("  and {more} more"));
    }
    lines
}
