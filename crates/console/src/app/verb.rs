//! The one list of what an operator can do, and what is true of each request: its words, its need, what it changes.

#![deny(clippy::wildcard_enum_match_arm)]

use std::path::PathBuf;

use crate::app::screen::Screen::{Chain, Grants, Keys, Log, Overview, Robots, Shared, Topics, Uploads};
use crate::app::{feeds::Feed, key::Key, screen::Screen};
use crate::model::{Address, IncidentName, Party, TopicPattern};
use crate::popups::incidents::state::Deed;
use crate::screens::chain::state::Act;
use crate::service::{Command, KeyKind, command::RemoveIncident};

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

const TABLES: &[Screen] = &[Topics, Uploads, Shared, Grants, Robots, Log];
const SORTED: &[Screen] = &[Topics, Uploads, Shared, Grants, Robots];
const MARKED: &[Screen] = &[Topics, Uploads, Shared];
const COPIED: &[Screen] = &[Topics, Uploads, Shared, Grants, Keys, Chain, Robots, Log];

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
    entry(Verb::Details, "provenance", "provenance", &["enter"], "Every step from message to verified").on(&[Uploads]),
    entry(Verb::Open, "open", "open", &["enter", "o"], "Check, decrypt and show the record").on(&[Shared]),
    entry(Verb::Open, "open-own", "open", &["o"], "Check, decrypt and show one of your records")
        .on(&[Uploads])
        .unlisted(),
    entry(Verb::Check, "check", "check", &["c"], "Compare the stored bytes with the chain and the signature")
        .on(&[Shared, Uploads]),
    entry(Verb::Export, "export", "export", &["e"], "Export the record as files that others can check").on(&[Uploads]),
    entry(Verb::Browse, "browse", "browse", &["b"], "By owner, topic, type or time").on(&[Shared, Uploads]),
    act(Verb::Play, "play", "", &["p"], "Play this topic live into your own ROS; again: stop").on(&[Shared]),
    entry(Verb::Readers, "readers", "readers", &["i"], "Who can read this now?").on(&[Topics, Uploads, Grants]),
    act(Verb::Incident, "incident", "incident", &["I"], "Incident: keep records around this row")
        .on(&[Topics, Uploads]),
    entry(Verb::Publishers, "publishers", "publishers", &["enter"], "Publishers: pinned, suspect, quarantined")
        .on(&[Topics]),
    act(Verb::Pin, "pin", "pin", &["p"], "Pin the publishers present now").on(&[Topics]),
    act(Verb::Unpin, "unpin", "", &["P"], "Unpin one of the topic's publishers").on(&[Topics]),
    act(Verb::Release, "release", "", &["r"], "Release quarantined messages of the topic").on(&[Topics]),
    act(Verb::Discard, "discard", "", &["D"], "Discard quarantined messages; the chain counts them").on(&[Topics]),
    act(Verb::Grant, "grant", "grant", &["g"], "Let another account read your records").on(&[Overview, Topics, Grants]),
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
    administers(Act::Dismiss, "withdraw-admission", "Administrator: no longer let an account register"),
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
    entry(Verb::Filter, "filter", "filter", &["/"], "Filter rows; Uploads, Shared: whole ledger").on(TABLES),
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
    entry(Verb::Go(Screen::Uploads), "go-uploads", "", &["3"], "Your records and their states"),
    entry(Verb::Go(Screen::Shared), "go-shared", "", &["4"], "Records others share with you"),
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

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Need {
    Unlocked,
    /// Unlocked, and registered on the chain.
    Registered,
}

/// Pins do not need an open keyring.
pub fn need_of(tag: &Tag) -> Option<Need> {
    match tag {
        Tag::Feed(..) | Tag::OpenConsole | Tag::CreateIdentity | Tag::Unlock | Tag::Lock | Tag::BackUp => None,
        Tag::HoldCapture | Tag::StopPlay | Tag::Contact(_) | Tag::Incident(..) => None,
        Tag::Robot(_) | Tag::Publishers(_) | Tag::Show(_) | Tag::Beside(..) | Tag::Pin(_) | Tag::Unpin(_) => None,
        Tag::Foresee(_) => None,
        Tag::LoadKey(_) | Tag::Release(_) | Tag::Discard(_) | Tag::Deploy => Some(Need::Unlocked),
        Tag::Open(_) | Tag::Path(_) | Tag::Check(_) | Tag::Export(_) | Tag::ExportKey(_) => Some(Need::Unlocked),
        Tag::Play(_) | Tag::SetPolicy(..) => Some(Need::Unlocked),
        Tag::Extend(_) | Tag::Administer(_) => Some(Need::Registered),
        Tag::Register | Tag::Watch(_) | Tag::Unwatch(_) | Tag::Grant(_) | Tag::Revoke(_) | Tag::Rotate => {
            Some(Need::Registered)
        }
    }
}

/// Feeds that an own command makes stale before the site's event arrives.
pub fn touched_by(tag: &Tag) -> &'static [Feed] {
    match tag {
        Tag::Watch(_) | Tag::Unwatch(_) | Tag::HoldCapture => &[Feed::Topics],
        Tag::SetPolicy(..) => &[Feed::Robots],
        Tag::Incident(..) => &[Feed::Incidents, Feed::Uploads],
        Tag::Contact(_) => &[Feed::Contacts, Feed::Grants, Feed::Shared],
        Tag::Grant(_) | Tag::Extend(_) | Tag::Revoke(_) => &[Feed::Grants, Feed::Identity, Feed::Keys],
        Tag::LoadKey(_) | Tag::Rotate => &[Feed::Keys, Feed::Identity],
        Tag::Pin(_) | Tag::Unpin(_) | Tag::Release(_) | Tag::Discard(_) => &[Feed::Topics],
        Tag::Administer(_) | Tag::Deploy => &[Feed::Chain],
        Tag::Feed(..) | Tag::OpenConsole | Tag::CreateIdentity | Tag::Unlock | Tag::Register | Tag::Lock => &[],
        Tag::ExportKey(_) | Tag::BackUp | Tag::Export(_) | Tag::Play(_) | Tag::StopPlay => &[],
        Tag::Publishers(_) | Tag::Show(_) | Tag::Beside(..) | Tag::Open(_) | Tag::Path(_) | Tag::Check(_) => &[],
        Tag::Robot(_) | Tag::Foresee(_) => &[],
    }
}

#[expect(clippy::large_enum_variant, reason = "there is one at a time")]
#[derive(Debug, Clone)]
pub enum Undo {
    By(Errand),
    /// A grant: revoking it is another transaction, and does not undo what was read meanwhile.
    Granted(String),
    /// Why nothing undoes it.
    Never(&'static str),
}

/// `None` = it is nothing to be undone, and what was done before can still be.
pub fn undone_by(tag: &Tag) -> Option<Undo> {
    let watching = |name: &String, watch| name.parse().ok().map(|topic| Undo::By(watch_errand(topic, watch)));
    match tag {
        Tag::Watch(name) => watching(name, false),
        Tag::Unwatch(name) => watching(name, true),
        Tag::Grant(grantee) => Some(Undo::Granted(grantee.to_string())),
        Tag::Extend(_) => Some(Undo::Never("it was a transaction; e changes the end of the grant (5)")),
        Tag::Revoke(_) => Some(Undo::Never("a revoke is a transaction: to share again, make a new grant (5, then g)")),
        Tag::Rotate => Some(Undo::Never("a new epoch cannot be undone")),
        Tag::LoadKey(_) => Some(Undo::Never("the replaced key is no longer in the keyring; load its file again")),
        Tag::Release(_) => Some(Undo::Never("released messages are already being anchored; they keep their tag")),
        Tag::Discard(_) => Some(Undo::Never("discarded messages are deleted; their count is on the chain")),
        Tag::Administer(_) | Tag::Deploy => {
            Some(Undo::Never("it was a transaction; send the opposite one instead (7, then :)"))
        }
        Tag::Feed(..) | Tag::OpenConsole | Tag::CreateIdentity | Tag::Unlock | Tag::Register | Tag::Lock => None,
        Tag::HoldCapture | Tag::ExportKey(_) | Tag::BackUp | Tag::Export(_) | Tag::Pin(_) | Tag::Unpin(_) => None,
        Tag::Incident(deed, name) => Some(deed.stays().map_or_else(|| Undo::By(taken_back(name)), Undo::Never)),
        Tag::SetPolicy(..) => Some(Undo::Never("a policy's version only rises; set the earlier one again (8, then p)")),
        Tag::Play(_) | Tag::StopPlay | Tag::Contact(_) | Tag::Robot(_) => None,
        Tag::Publishers(_) | Tag::Show(_) | Tag::Beside(..) | Tag::Open(_) | Tag::Path(_) | Tag::Check(_) => None,
        Tag::Foresee(_) => None,
    }
}

pub fn watch_errand(topic: TopicPattern, watch: bool) -> Errand {
    let name = topic.to_string();
    if watch {
        Errand { command: Command::WatchTopic { topic, type_name: None }, tag: Tag::Watch(name) }
    } else {
        Errand { command: Command::UnwatchTopic { topic }, tag: Tag::Unwatch(name) }
    }
}

pub fn taken_back(name: &IncidentName) -> Errand {
    let tag = Tag::Incident(Deed::Remove, name.clone());
    Errand { command: RemoveIncident { name: name.clone() }.into(), tag }
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
