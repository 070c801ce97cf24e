//! The one list of what an operator can do, and the input and output of `update`.

use std::path::PathBuf;

use super::Screen::{self, Chain, Grants, Keys, Log, Overview, Received, Records, Robots, Topics};
use super::administration::Act;
use super::incidents::Deed;
use super::keymap::Key;
use super::palette::{Found, Sought};
use super::update::Feed;
use crate::model::{Address, IncidentName, Party, ProfileName, Timestamp};
use crate::service::{Command, Event, Failure, KeyKind, Reply};
use zeroize::Zeroizing;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Verb {
    Go(Screen),
    NextScreen,
    PreviousScreen,
    Up,
    Down,
    PageUp,
    PageDown,
    First,
    Last,
    Mark,
    MarkAll,
    Filter,
    NextMatch,
    PreviousMatch,
    Sort,
    Reverse,
    Columns,
    Watch,
    Details,
    Open,
    Check,
    Export,
    CreateIdentity,
    Unlock,
    Register,
    LoadKey,
    ExportKey,
    Rotate,
    Grant,
    Extend,
    Revoke,
    Publishers,
    Pin,
    Unpin,
    Release,
    Discard,
    Limit,
    Readers,
    Contacts,
    Inspect,
    SetPolicy,
    Incident,
    Incidents,
    Profile,
    EndTour,
    Browse,
    Play,
    BackUp,
    Lock,
    Tasks,
    Alerts,
    Undo,
    LocalTime,
    Administer(Act),
    Copy,
    WriteFile,
    CopyCommand,
    Level,
    Source,
    Read,
    Freeze,
    Period,
    Fold,
    FoldAll,
    Palette,
    Help,
    Dismiss,
    ChooseTheme,
    Ascii,
    Mouse,
    Redraw,
    Suspend,
    Quit,
}

#[derive(Debug, PartialEq, Eq)]
pub struct Entry {
    pub verb: Verb,
    /// Its name in the palette.
    pub name: &'static str,
    /// For the bottom bar; empty = not shown there.
    pub label: &'static str,
    pub help: &'static str,
    /// As in `keymap.toml`; several in one text are pressed in sequence.
    pub keys: &'static [&'static str],
    /// Empty = all.
    pub on: &'static [Screen],
    /// Changes keys, grants or records; hidden when read-only.
    pub changes: bool,
    /// Listed in the palette.
    pub palette: bool,
}

type Word = &'static str;

const fn entry(verb: Verb, name: Word, label: Word, keys: &'static [Word], help: Word) -> Entry {
    Entry { verb, name, label, help, keys, on: &[], changes: false, palette: true }
}

const fn act(verb: Verb, name: Word, label: Word, keys: &'static [Word], help: Word) -> Entry {
    Entry { changes: true, ..entry(verb, name, label, keys, help) }
}

impl Entry {
    const fn on(mut self, screens: &'static [Screen]) -> Self {
        self.on = screens;
        self
    }

    const fn unlisted(mut self) -> Self {
        self.palette = false;
        self
    }

    pub fn chords(&self) -> impl Iterator<Item = Vec<Key>> {
        self.keys.iter().map(|chord| chord.split(' ').filter_map(Key::from_label).collect())
    }

    pub fn works_on(&self, screen: Screen) -> bool {
        self.on.is_empty() || self.on.contains(&screen)
    }
}

/// This screen's entry first.
pub fn entry_of(verb: Verb, screen: Screen) -> Option<&'static Entry> {
    let mut same = VERBS.iter().filter(|entry| entry.verb == verb);
    same.clone().find(|entry| entry.works_on(screen)).or_else(|| same.next())
}

const TABLES: &[Screen] = &[Topics, Records, Received, Grants, Robots, Log];
const SORTED: &[Screen] = &[Topics, Records, Received, Grants, Robots];
const MARKED: &[Screen] = &[Topics, Records, Received];
const COPIED: &[Screen] = &[Topics, Records, Received, Grants, Keys, Chain, Robots, Log];

/// In the palette, on no key.
const fn administers(deed: Act, name: &'static str, help: &'static str) -> Entry {
    act(Verb::Administer(deed), name, "", &[], help).on(&[Chain])
}

/// Entries of a single screen come first.
pub static VERBS: &[Entry] = &[
    entry(Verb::Mark, "mark", "mark", &["space"], "Mark the row; commands then act on the marked rows").on(MARKED),
    entry(Verb::MarkAll, "mark-all", "mark all", &["a"], "Mark every row shown, or clear all marks").on(MARKED),
    act(Verb::Watch, "watch", "watch", &["w"], "Watch or unwatch the marked topics, or the selected one")
        .on(&[Overview, Topics]),
    entry(Verb::Details, "provenance", "provenance", &["enter"], "Every step from message to verified").on(&[Records]),
    entry(Verb::Open, "open", "open", &["enter", "o"], "Check, decrypt and show the record").on(&[Received]),
    entry(Verb::Open, "open-own", "open", &["o"], "Check, decrypt and show one of your records")
        .on(&[Records])
        .unlisted(),
    entry(Verb::Check, "check", "check", &["c"], "Compare the stored bytes with the chain and the signature")
        .on(&[Received, Records]),
    entry(Verb::Export, "export", "export", &["e"], "Export the record as files that others can check").on(&[Records]),
    entry(Verb::Browse, "browse", "browse", &["b"], "By owner, topic, type or time").on(&[Received, Records]),
    act(Verb::Play, "play", "", &["p"], "Play this topic live into your own ROS; again: stop").on(&[Received]),
    entry(Verb::Readers, "readers", "readers", &["i"], "Who can read this now?").on(&[Topics, Records, Grants]),
    act(Verb::Incident, "incident", "incident", &["I"], "Incident: keep records around this row")
        .on(&[Topics, Records]),
    entry(Verb::Publishers, "publishers", "publishers", &["enter"], "Publishers: pinned, suspect, quarantined")
        .on(&[Topics]),
    act(Verb::Pin, "pin", "pin", &["p"], "Pin the publishers present now").on(&[Topics]),
    act(Verb::Unpin, "unpin", "", &["P"], "Unpin one of the topic's publishers").on(&[Topics]),
    act(Verb::Release, "release", "", &["r"], "Release quarantined messages of the topic").on(&[Topics]),
    act(Verb::Discard, "discard", "", &["D"], "Discard quarantined messages; the chain counts them").on(&[Topics]),
    act(Verb::Limit, "limit", "", &["l"], "Rate, or one message in n, of the marked topics that are watched")
        .on(&[Topics]),
    act(Verb::Grant, "grant", "grant", &["g"], "Let another account read your records")
        .on(&[Overview, Topics, Grants, Robots]),
    act(Verb::Extend, "extend", "extend", &["e"], "Change the end of the grant; sooner = revoke and new grant")
        .on(&[Grants]),
    act(Verb::Revoke, "revoke", "revoke", &["x"], "Stop sharing: the next record is encrypted under a new key")
        .on(&[Grants]),
    entry(Verb::Contacts, "contacts", "contacts", &["c"], "Address book: names for accounts").on(&[Grants]),
    entry(Verb::Alerts, "alerts", "alerts", &["enter"], "Every alert in full, with what to do about it")
        .on(&[Overview]),
    entry(Verb::Period, "minutes", "minutes", &["m"], "Graphs over 1, 15 or 60 minutes").on(&[Overview]),
    entry(Verb::Fold, "fold", "fold", &["h"], "Fold the robot's topics into one row, or unfold them").on(&[Topics]),
    entry(Verb::FoldAll, "fold-all", "", &["H"], "Fold all robots, or unfold all").on(&[Topics]),
    act(Verb::CreateIdentity, "create-identity", "new identity", &["n"], "Create keys and register them")
        .on(&[Overview, Keys]),
    entry(Verb::Unlock, "unlock", "unlock", &["u"], "Open the keyring with its passphrase"),
    act(Verb::Register, "register", "register", &["R"], "Register the identity on the chain").on(&[Overview, Keys]),
    act(Verb::LoadKey, "load-key", "load key", &["L"], "Replace the current key with one from a file")
        .on(&[Overview, Keys]),
    act(Verb::Rotate, "rotate-keys", "rotate", &["r"], "Begin a new epoch under a new key").on(&[Keys]),
    act(Verb::ExportKey, "export-key", "export", &["e"], "Write a secret key to a file").on(&[Keys]),
    entry(Verb::BackUp, "back-up-keys", "back up", &["b"], "Write the keyring, protected by its passphrase, to a file")
        .on(&[Keys]),
    act(Verb::Administer(Act::Deploy), "deploy", "deploy", &["d"], "Deploy the contract").on(&[Chain]),
    administers(Act::Admit, "allow-account", "Administrator: let an account register"),
    administers(Act::Dismiss, "deny-account", "Administrator: no longer let an account register"),
    administers(Act::Suspend, "suspend", "Administrator: suspend an account"),
    administers(Act::Restore, "restore", "Administrator: lift an account's suspension"),
    administers(Act::Open, "open-registration", "Administrator: anyone can register"),
    administers(Act::Close, "close-registration", "Administrator: only allowed accounts can register"),
    administers(Act::Pause, "pause-changes", "Administrator: pause all changes except revokes"),
    administers(Act::Continue, "resume-changes", "Administrator: end the pause"),
    administers(Act::Propose, "replace-lost-account", "Administrator: propose a lost account's successor"),
    administers(Act::HandOver, "hand-over", "Administrator: nominate the next administrator"),
    administers(Act::Accept, "accept-administration", "Take over as administrator, if nominated"),
    entry(Verb::Inspect, "inspect", "details", &["enter"], "A robot: its topics, losses and policy").on(&[Robots]),
    act(Verb::SetPolicy, "robot-policy", "policy", &["p"], "Set a robot's policy from a file, or clear it")
        .on(&[Robots]),
    entry(Verb::Level, "log-level", "level", &["l"], "All lines, warnings and errors, or errors only").on(&[Log]),
    entry(Verb::Read, "read-line", "full line", &["enter"], "Show the full line").on(&[Log]),
    entry(Verb::Source, "log-source", "source", &["o"], "Lines of this console, the site, the audit log, or all")
        .on(&[Log]),
    entry(Verb::Filter, "filter", "filter", &["/"], "Filter rows; Records, Received: whole ledger").on(TABLES),
    entry(Verb::NextMatch, "next-match", "", &["n"], "Next matching row").on(TABLES),
    entry(Verb::PreviousMatch, "previous-match", "", &["N"], "Previous matching row").on(TABLES),
    entry(Verb::Sort, "sort", "sort", &["s"], "Sort by the next column").on(SORTED),
    entry(Verb::Reverse, "reverse", "", &["S"], "Reverse the order").on(SORTED),
    entry(Verb::Columns, "columns", "columns", &["C"], "Choose the columns of this list").on(MARKED),
    entry(Verb::Copy, "copy", "copy", &["y"], "Copy name, digest or address to clipboard").on(COPIED),
    entry(Verb::WriteFile, "write-file", "", &["W"], "Save to a file what y would copy").on(COPIED),
    entry(Verb::CopyCommand, "copy-command", "", &["z y"], "Copy your last act as a command line"),
    entry(Verb::Tasks, "tasks", "", &["t"], "Running tasks and queues"),
    entry(Verb::Undo, "undo", "", &["U", "z u"], "Undo the last action, where possible"),
    entry(Verb::Lock, "lock", "", &["z x"], "Wipe the keys for reading, granting and revoking"),
    entry(Verb::LocalTime, "local-time", "", &["z l"], "Show local time beside UTC, or UTC only"),
    entry(Verb::Freeze, "freeze", "freeze", &["f"], "Freeze the view (capture continues)"),
    entry(Verb::Incidents, "incidents", "", &["z i"], "Incidents: contents, notes, closing, export"),
    entry(Verb::Profile, "profile", "", &[], "Switch to another profile of this home"),
    entry(Verb::EndTour, "end-tour", "", &["E"], "Close the tour's strip"),
    entry(Verb::Palette, "palette", "commands", &[":"], "Every command by name").unlisted(),
    entry(Verb::Help, "help", "help", &["?"], "Keys of this screen"),
    entry(Verb::Quit, "quit", "quit", &["q", "^c"], "Quit (asks, and says what stops)"),
    entry(Verb::Up, "up", "", &["up", "k"], "Cursor up").on(TABLES).unlisted(),
    entry(Verb::Down, "down", "", &["down", "j"], "Cursor down").on(TABLES).unlisted(),
    entry(Verb::PageUp, "page-up", "", &["pgup", "^u"], "Page up").on(TABLES).unlisted(),
    entry(Verb::PageDown, "page-down", "", &["pgdn", "^d"], "Page down").on(TABLES).unlisted(),
    entry(Verb::First, "first", "", &["home"], "First row").on(TABLES).unlisted(),
    entry(Verb::Last, "last", "", &["end", "G"], "Last row").on(TABLES).unlisted(),
    entry(Verb::NextScreen, "next-screen", "", &["tab"], "Next screen"),
    entry(Verb::PreviousScreen, "previous-screen", "", &["shift-tab"], "Previous screen"),
    entry(Verb::Go(Screen::Overview), "go-overview", "", &["1"], "Health, life line, alerts, busiest topics"),
    entry(Verb::Go(Screen::Topics), "go-topics", "", &["2"], "Topics of the ROS graph"),
    entry(Verb::Go(Screen::Records), "go-records", "", &["3"], "Your records and their states"),
    entry(Verb::Go(Screen::Received), "go-received", "", &["4"], "Records others share with you"),
    entry(Verb::Go(Screen::Grants), "go-grants", "", &["5"], "Grants given and received"),
    entry(Verb::Go(Screen::Keys), "go-keys", "", &["6"], "Your identity and keys"),
    entry(Verb::Go(Screen::Chain), "go-chain", "", &["7"], "The chain"),
    entry(Verb::Go(Screen::Robots), "go-robots", "", &["8"], "Robots and the gateway"),
    entry(Verb::Go(Screen::Log), "go-log", "", &["9"], "Notices and audit lines"),
    entry(Verb::Dismiss, "dismiss", "", &["esc"], "Hide the message; clear filter and marks"),
    entry(Verb::ChooseTheme, "theme", "", &["T", "z t"], "Choose a theme (live preview)"),
    entry(Verb::Ascii, "ascii", "", &["z a"], "ASCII characters only, or all"),
    entry(Verb::Mouse, "mouse", "", &["z m"], "Mouse on, or off to select text in the terminal"),
    entry(Verb::Redraw, "redraw", "", &["^l"], "Redraw the screen"),
    entry(Verb::Suspend, "shell", "", &["^z"], "Back to the shell; `fg` returns"),
];

#[derive(Debug)]
pub enum Action {
    Do(Verb),
    Key(Key),
    Paste(Zeroizing<String>),
    /// In cells.
    Resize {
        columns: u16,
        rows: u16,
    },
    Tick(Timestamp),
    Answered {
        tag: Tag,
        result: Box<Result<Reply, Failure>>,
    },
    Told(Event),
    /// Events were lost; everything is requested again.
    Missed,
    /// Where, or why not.
    FilesWritten(Result<String, String>),
    PathsFound(Sought, Result<Found, String>),
    TextRead(PathBuf, Result<String, String>),
    ThemeIs(String),
    Wheel {
        up: bool,
    },
    /// Left button on a cell, from 0.
    Click {
        column: u16,
        row: u16,
    },
    Resumed,
    Fault(String),
}

/// Work for the caller; nothing of it may block `update`.
#[derive(Debug)]
#[allow(clippy::large_enum_variant, reason = "a handful at a time, and gone at once")]
pub enum Effect {
    Send(Command, Tag),
    Quit,
    /// A site continues after the console.
    LeaveSite,
    /// The site refuses this console.
    Leave(Failure),
    /// Stops the process as Ctrl-Z does.
    Suspend,
    Redraw,
    ShowTheme(String),
    ToggleAscii,
    Mouse(bool),
    /// OSC 52.
    CopyText(String),
    SpeakFor(ProfileName),
    FindPaths(Sought),
    /// Reads no further than a robot's policy may be long.
    ReadText(PathBuf),
    /// Into a new place below `base`, 0600, never overwriting.
    WriteFiles {
        /// An existing folder; `None` = the working directory.
        base: Option<PathBuf>,
        /// Created, if named.
        directory: Option<String>,
        files: Vec<Contents>,
    },
}

pub struct Contents {
    /// No path.
    pub name: String,
    pub bytes: Zeroizing<Vec<u8>>,
}

impl std::fmt::Debug for Contents {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "Contents({}, {} bytes)", self.name, self.bytes.len())
    }
}

#[derive(Debug, Clone)]
pub struct Errand {
    pub command: Command,
    pub tag: Tag,
}

/// The request that an answer belongs to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Tag {
    /// With its generation.
    Feed(Feed, u64),
    OpenConsole,
    CreateIdentity,
    Unlock,
    Register,
    Watch(String),
    Unwatch(String),
    Limit(String),
    Grant(Party),
    /// What a grant would do, by its terms.
    Foresee(String),
    Extend(Address),
    Revoke(Address),
    LoadKey(KeyKind),
    ExportKey(KeyKind),
    Rotate,
    /// Pauses the capture before leaving, or resumes it.
    HoldCapture,
    Lock,
    BackUp,
    Administer(&'static str),
    Deploy,
    Pin(String),
    Unpin(String),
    Release(String),
    Discard(String),
    Publishers(String),
    Show(String),
    /// For the pane beside a list.
    Beside(Screen, String),
    Open(String),
    Path(String),
    Check(String),
    Export(String),
    Contact(String),
    Incident(Deed, IncidentName),
    /// An incident's bundle.
    Evidence(IncidentName),
    Robot(String),
    /// From this file; `None` = cleared.
    SetPolicy(String, Option<PathBuf>),
    /// Under this name.
    Play(String),
    StopPlay,
}

impl Tag {
    /// Whether the command changes something, so that quitting should wait or ask.
    pub fn is_work(&self) -> bool {
        let looks = matches!(self, Self::Show(_) | Self::Beside(..) | Self::Open(_) | Self::Path(_) | Self::Check(_));
        let asks = matches!(self, Self::Feed(..) | Self::OpenConsole | Self::Robot(_) | Self::Publishers(_));
        !looks && !asks && !matches!(self, Self::Foresee(_))
    }

    pub fn words(&self) -> String {
        match self {
            Self::Feed(..) => "asking the site".to_owned(),
            Self::OpenConsole => "claiming the profile".to_owned(),
            Self::CreateIdentity => "creating the identity".to_owned(),
            Self::Unlock => "unlocking the keyring".to_owned(),
            Self::Register => "registering on the chain".to_owned(),
            Self::Watch(topic) => format!("watching {topic}"),
            Self::Unwatch(topic) => format!("unwatching {topic}"),
            Self::Limit(topic) => format!("limiting {topic}"),
            Self::Foresee(terms) => format!("counting for a grant to {terms}"),
            Self::Grant(grantee) => format!("granting to {}", grantee.short()),
            Self::Extend(grantee) => format!("extending the grant to {}", grantee.short()),
            Self::Revoke(grantee) => format!("revoking {}", grantee.short()),
            Self::LoadKey(kind) => format!("loading the {} key", kind_word(*kind)),
            Self::ExportKey(kind) => format!("exporting the {} key", kind_word(*kind)),
            Self::Rotate => "rotating the keys".to_owned(),
            Self::HoldCapture => "stopping capture".to_owned(),
            Self::Lock => "locking the keyring".to_owned(),
            Self::BackUp => "backing up the keyring".to_owned(),
            Self::Administer(act) => format!("administrator: {act}"),
            Self::Deploy => "deploying the contract".to_owned(),
            Self::Pin(topic) => format!("pinning publishers of {topic}"),
            Self::Unpin(topic) => format!("unpinning a publisher of {topic}"),
            Self::Release(topic) => format!("releasing quarantined messages of {topic}"),
            Self::Discard(topic) => format!("discarding quarantined messages of {topic}"),
            Self::Publishers(topic) => format!("looking up publishers of {topic}"),
            Self::Show(id) => format!("looking up {id}"),
            Self::Beside(_, id) => format!("reading {id}"),
            Self::Open(id) => format!("opening {id}"),
            Self::Path(id) => format!("reading the path to {id}"),
            Self::Check(id) => format!("checking {id}"),
            Self::Export(id) => format!("exporting {id}"),
            Self::Incident(deed, name) => deed.words(name),
            Self::Evidence(name) => format!("exporting incident {name} as evidence"),
            Self::Contact(name) => format!("changing contact {name}"),
            Self::Robot(name) => format!("looking up robot {name}"),
            Self::SetPolicy(robot, Some(_)) => format!("setting the policy of {robot}"),
            Self::SetPolicy(robot, None) => format!("clearing the policy of {robot}"),
            Self::Play(topic) => format!("playing {topic} into ROS, live (4, then p: stop)"),
            Self::StopPlay => "stopping playback".to_owned(),
        }
    }
}

pub fn kind_word(kind: KeyKind) -> &'static str {
    match kind {
        KeyKind::Sm4 => "SM4",
        KeyKind::Sm2 => "SM2",
        KeyKind::Eoa => "EOA",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_its_own() {
        for (index, entry) in VERBS.iter().enumerate() {
            assert!(VERBS[..index].iter().all(|other| other.name != entry.name), "{}", entry.name);
            let known = |chord: &&str| chord.split(' ').all(|label| Key::from_label(label).is_some());
            assert!(entry.keys.iter().all(known), "{:?}", entry.keys);
        }
    }
}
