//! The one list of what an operator can do, and what is true of each request: its words, its need, what it changes.

#![deny(clippy::wildcard_enum_match_arm)]

use std::path::PathBuf;

use self::Given::{
    ActiveGrant, Administrator, Alerts, Always, Copyable, EnrolledRobot, Filter, HeldTopic, Here, Identity, LastAct,
    Locked, NoIdentity, Order, OwnRobot, Row, RowUnlessOn, Table, Topic, TopicOfRobot, Tour, Undoable, Unlocked,
    Unregistered, WatchedTopic,
};
use crate::app::screen::Screen::{Chain, Grants, Keys, Log, Overview, Received, Records, Robots, Topics};
use crate::app::twin::{kind_word, of_command, quoted};
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

/// What must be so for a verb to be done; `available` says why it is not.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Given {
    Always,
    /// One of its screens is in view.
    Here,
    Row,
    /// A row, except on this screen.
    RowUnlessOn(Screen),
    Topic,
    HeldTopic,
    /// Marked or selected, and watched.
    WatchedTopic,
    TopicOfRobot,
    OwnRobot,
    ActiveGrant,
    Alerts,
    Table,
    Order,
    Filter,
    Identity,
    NoIdentity,
    Locked,
    Unlocked,
    Unregistered,
    EnrolledRobot,
    Administrator(Act),
    Tour,
    LastAct,
    Undoable,
    Copyable,
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
    pub given: Given,
    /// Changes keys, grants or records; hidden when read-only.
    pub changes: bool,
    /// Listed in the palette.
    pub palette: bool,
}

type Word = &'static str;

const fn entry(verb: Verb, name: Word, label: Word, keys: &'static [Word], help: Word) -> Entry {
    Entry { verb, name, label, help, keys, on: &[], given: Always, changes: false, palette: true }
}

const fn act(verb: Verb, name: Word, label: Word, keys: &'static [Word], help: Word) -> Entry {
    Entry { changes: true, ..entry(verb, name, label, keys, help) }
}

impl Entry {
    const fn on(mut self, screens: &'static [Screen], given: Given) -> Self {
        self.on = screens;
        self.given = given;
        self
    }

    const fn given(mut self, given: Given) -> Self {
        self.given = given;
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
    act(Verb::Administer(deed), name, "", &[], help).on(&[Chain], Administrator(deed))
}

/// Entries of a single screen come first.
pub static VERBS: &[Entry] = &[
    entry(Verb::Mark, "mark", "mark", &["space"], "Mark the row; commands then act on the marked rows").on(MARKED, Row),
    entry(Verb::MarkAll, "mark-all", "mark all", &["a"], "Mark every row shown, or clear all marks").on(MARKED, Row),
    act(Verb::Watch, "watch", "watch", &["w"], "Watch or unwatch the marked topics, or the selected one")
        .on(&[Overview, Topics], RowUnlessOn(Overview)),
    entry(Verb::Details, "provenance", "provenance", &["enter"], "Every step from message to verified")
        .on(&[Records], Row),
    entry(Verb::Open, "open", "open", &["enter", "o"], "Check, decrypt and show the record").on(&[Received], Row),
    entry(Verb::Open, "open-own", "open", &["o"], "Check, decrypt and show one of your records")
        .on(&[Records], Row)
        .unlisted(),
    entry(Verb::Check, "check", "check", &["c"], "Compare the stored bytes with the chain and the signature")
        .on(&[Received, Records], Row),
    entry(Verb::Export, "export", "export", &["e"], "Export the record as files that others can check")
        .on(&[Records], Row),
    entry(Verb::Browse, "browse", "browse", &["b"], "By owner, topic, type or time").on(&[Received, Records], Here),
    act(Verb::Play, "play", "", &["p"], "Play this topic live into your own ROS; again: stop").on(&[Received], Row),
    entry(Verb::Readers, "readers", "readers", &["i"], "Who can read this now?")
        .on(&[Topics, Records, Grants], RowUnlessOn(Grants)),
    act(Verb::Incident, "incident", "incident", &["I"], "Incident: keep records around this row")
        .on(&[Topics, Records], Identity),
    entry(Verb::Publishers, "publishers", "publishers", &["enter"], "Publishers: pinned, suspect, quarantined")
        .on(&[Topics], Topic),
    act(Verb::Pin, "pin", "pin", &["p"], "Pin the publishers present now").on(&[Topics], Topic),
    act(Verb::Unpin, "unpin", "", &["P"], "Unpin one of the topic's publishers").on(&[Topics], Topic),
    act(Verb::Release, "release", "", &["r"], "Release quarantined messages of the topic").on(&[Topics], HeldTopic),
    act(Verb::Discard, "discard", "", &["D"], "Discard quarantined messages; the chain counts them")
        .on(&[Topics], HeldTopic),
    act(Verb::Limit, "limit", "", &["l"], "Rate, or one message in n, of the marked topics that are watched")
        .on(&[Topics], WatchedTopic),
    act(Verb::Grant, "grant", "grant", &["g"], "Let another account read your records")
        .on(&[Overview, Topics, Grants, Robots], Always),
    act(Verb::Extend, "extend", "extend", &["e"], "Change the end of the grant; sooner = revoke and new grant")
        .on(&[Grants], ActiveGrant),
    act(Verb::Revoke, "revoke", "revoke", &["x"], "Stop sharing: the next record is encrypted under a new key")
        .on(&[Grants], ActiveGrant),
    entry(Verb::Contacts, "contacts", "contacts", &["c"], "Address book: names for accounts").on(&[Grants], Always),
    entry(Verb::Alerts, "alerts", "alerts", &["enter"], "Every alert in full, with what to do about it")
        .on(&[Overview], Alerts),
    entry(Verb::Period, "minutes", "minutes", &["m"], "Graphs over 1, 15 or 60 minutes").on(&[Overview], Here),
    entry(Verb::Fold, "fold", "fold", &["h"], "Fold the robot's topics into one row, or unfold them")
        .on(&[Topics], TopicOfRobot),
    entry(Verb::FoldAll, "fold-all", "", &["H"], "Fold all robots, or unfold all").on(&[Topics], Here),
    act(Verb::CreateIdentity, "create-identity", "new identity", &["n"], "Create keys and register them")
        .on(&[Overview, Keys], NoIdentity),
    entry(Verb::Unlock, "unlock", "unlock", &["u"], "Open the keyring with its passphrase").given(Locked),
    act(Verb::Register, "register", "register", &["R"], "Register the identity on the chain")
        .on(&[Overview, Keys], Unregistered),
    act(Verb::LoadKey, "load-key", "load key", &["L"], "Replace the current key with one from a file")
        .on(&[Overview, Keys], Identity),
    act(Verb::Rotate, "rotate-keys", "rotate", &["r"], "Begin a new epoch under a new key").on(&[Keys], Identity),
    act(Verb::ExportKey, "export-key", "export", &["e"], "Write a secret key to a file").on(&[Keys], Identity),
    entry(Verb::BackUp, "back-up-keys", "back up", &["b"], "Write the keyring, protected by its passphrase, to a file")
        .on(&[Keys], Identity),
    act(Verb::Administer(Act::Deploy), "deploy", "deploy", &["d"], "Deploy the contract")
        .on(&[Chain], Administrator(Act::Deploy)),
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
    entry(Verb::Inspect, "inspect", "details", &["enter"], "A robot: its topics, losses and policy")
        .on(&[Robots], OwnRobot),
    act(Verb::SetPolicy, "robot-policy", "policy", &["p"], "Set a robot's policy from a file, or clear it")
        .on(&[Robots], EnrolledRobot),
    entry(Verb::Level, "log-level", "level", &["l"], "All lines, warnings and errors, or errors only").on(&[Log], Here),
    entry(Verb::Read, "read-line", "full line", &["enter"], "Show the full line").on(&[Log], Row),
    entry(Verb::Source, "log-source", "source", &["o"], "Lines of this console, the site, the audit log, or all")
        .on(&[Log], Here),
    entry(Verb::Filter, "filter", "filter", &["/"], "Filter rows; Records, Received: whole ledger").on(TABLES, Table),
    entry(Verb::NextMatch, "next-match", "", &["n"], "Next matching row").on(TABLES, Filter),
    entry(Verb::PreviousMatch, "previous-match", "", &["N"], "Previous matching row").on(TABLES, Filter),
    entry(Verb::Sort, "sort", "sort", &["s"], "Sort by the next column").on(SORTED, Order),
    entry(Verb::Reverse, "reverse", "", &["S"], "Reverse the order").on(SORTED, Order),
    entry(Verb::Columns, "columns", "columns", &["C"], "Choose the columns of this list").on(MARKED, Here),
    entry(Verb::Copy, "copy", "copy", &["y"], "Copy name, digest or address to clipboard").on(COPIED, Copyable),
    entry(Verb::WriteFile, "write-file", "", &["W"], "Save to a file what y would copy").on(COPIED, Copyable),
    entry(Verb::CopyCommand, "copy-command", "", &["z y"], "Copy your last act as a command line").given(LastAct),
    entry(Verb::Tasks, "tasks", "", &["t"], "Running tasks and queues"),
    entry(Verb::Undo, "undo", "", &["U", "z u"], "Undo the last action, where possible").given(Undoable),
    entry(Verb::Lock, "lock", "", &["z x"], "Wipe the keys for reading, granting and revoking").given(Unlocked),
    entry(Verb::LocalTime, "local-time", "", &["z l"], "Show local time beside UTC, or UTC only"),
    entry(Verb::Freeze, "freeze", "freeze", &["f"], "Freeze the view (capture continues)"),
    entry(Verb::Incidents, "incidents", "", &["z i"], "Incidents: contents, notes, closing, export").given(Identity),
    entry(Verb::Profile, "profile", "", &[], "Switch to another profile of this home"),
    entry(Verb::EndTour, "end-tour", "", &["E"], "Close the tour's strip").given(Tour),
    entry(Verb::Palette, "palette", "commands", &[":"], "Every command by name").unlisted(),
    entry(Verb::Help, "help", "help", &["?"], "Keys of this screen"),
    entry(Verb::Quit, "quit", "quit", &["q", "^c"], "Quit (asks, and says what stops)"),
    entry(Verb::Up, "up", "", &["up", "k"], "Cursor up").on(TABLES, Table).unlisted(),
    entry(Verb::Down, "down", "", &["down", "j"], "Cursor down").on(TABLES, Table).unlisted(),
    entry(Verb::PageUp, "page-up", "", &["pgup", "^u"], "Page up").on(TABLES, Table).unlisted(),
    entry(Verb::PageDown, "page-down", "", &["pgdn", "^d"], "Page down").on(TABLES, Table).unlisted(),
    entry(Verb::First, "first", "", &["home"], "First row").on(TABLES, Table).unlisted(),
    entry(Verb::Last, "last", "", &["end", "G"], "Last row").on(TABLES, Table).unlisted(),
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

#[derive(Debug, Clone)]
pub struct Errand {
    pub command: Command,
    pub tag: Tag,
}

impl Errand {
    /// The command line that does the same; `None` = there is none.
    pub fn line(&self) -> Option<String> {
        let Self { tag, command } = self;
        Some(match tag {
            // Screens' own requests, and what only leaving or ending a playback sends.
            Tag::Feed(..) | Tag::OpenConsole | Tag::Beside(..) | Tag::Path(_) | Tag::Foresee(_) => return None,
            Tag::HoldCapture | Tag::StopPlay => return None,
            Tag::CreateIdentity => "identity create".to_owned(),
            Tag::Unlock => "keys list --passphrase-file FILE".to_owned(),
            Tag::Register => "identity register".to_owned(),
            Tag::Watch(topic) => format!("topics watch {}", quoted(topic)),
            Tag::Unwatch(topic) => format!("topics unwatch {}", quoted(topic)),
            Tag::Grant(_) | Tag::Extend(_) | Tag::Revoke(_) | Tag::Administer(_) => of_command(command)?,
            Tag::LoadKey(_) | Tag::ExportKey(_) | Tag::Unpin(_) | Tag::Contact(_) => of_command(command)?,
            Tag::Incident(..) | Tag::Play(_) | Tag::Limit(_) | Tag::Evidence(_) => of_command(command)?,
            Tag::Rotate => "keys rotate".to_owned(),
            Tag::Lock => "keys lock".to_owned(),
            Tag::BackUp => "keys backup --out FILE".to_owned(),
            Tag::Deploy => "chain deploy".to_owned(),
            Tag::Pin(topic) => format!("topics pin {}", quoted(topic)),
            Tag::Release(topic) => format!("topics quarantine release --topic {}", quoted(topic)),
            Tag::Discard(topic) => format!("topics quarantine discard --topic {} --yes", quoted(topic)),
            Tag::Publishers(topic) => format!("topics pins --topic {}", quoted(topic)),
            Tag::Show(id) => format!("records show {id}"),
            Tag::Open(id) => format!("records open {id}"),
            Tag::Check(id) => format!("records check {id}"),
            Tag::Export(id) => format!("records export {id} --dir DIR"),
            Tag::Robot(name) => format!("robot show {}", quoted(name)),
            Tag::SetPolicy(robot, Some(file)) => {
                format!("robot policy {} --set {}", quoted(robot), quoted(&file.to_string_lossy()))
            }
            Tag::SetPolicy(robot, None) => format!("robot policy {} --clear", quoted(robot)),
        })
    }
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

    /// What must be open before it is sent, and the feeds that it makes stale before the site's event arrives.
    pub fn needs_and_touches(&self) -> (Option<Need>, &'static [Feed]) {
        use Need::{Registered, Unlocked};
        match self {
            Self::Watch(_) | Self::Unwatch(_) | Self::Limit(_) => (Some(Registered), &[Feed::Topics]),
            Self::Release(_) | Self::Discard(_) => (Some(Unlocked), &[Feed::Topics]),
            // Pins do not need an open keyring.
            Self::Pin(_) | Self::Unpin(_) | Self::HoldCapture => (None, &[Feed::Topics]),
            Self::SetPolicy(..) => (Some(Unlocked), &[Feed::Robots]),
            Self::Incident(..) => (None, &[Feed::Incidents, Feed::Records]),
            Self::Contact(_) => (None, &[Feed::Contacts, Feed::Grants, Feed::Received]),
            Self::Grant(_) | Self::Extend(_) | Self::Revoke(_) => {
                (Some(Registered), &[Feed::Grants, Feed::Identity, Feed::Keys])
            }
            Self::LoadKey(_) => (Some(Unlocked), &[Feed::Keys, Feed::Identity]),
            Self::Rotate => (Some(Registered), &[Feed::Keys, Feed::Identity]),
            Self::Administer(_) => (Some(Registered), &[Feed::Chain]),
            Self::Deploy => (Some(Unlocked), &[Feed::Chain]),
            Self::Register => (Some(Registered), &[]),
            Self::Open(_) | Self::Path(_) | Self::Check(_) | Self::Play(_) => (Some(Unlocked), &[]),
            Self::Export(_) | Self::ExportKey(_) | Self::Evidence(_) => (Some(Unlocked), &[]),
            Self::Feed(..) | Self::OpenConsole | Self::CreateIdentity | Self::Unlock | Self::Lock => (None, &[]),
            Self::BackUp | Self::StopPlay | Self::Robot(_) | Self::Publishers(_) | Self::Show(_) => (None, &[]),
            Self::Beside(..) | Self::Foresee(_) => (None, &[]),
        }
    }

    /// `None` = it is nothing to be undone, and what was done before can still be.
    pub fn undo(&self) -> Option<Undo> {
        let watching = |name: &String, watch| name.parse().ok().map(|topic| Undo::By(watch_errand(topic, watch)));
        let never = |why| Some(Undo::Never(why));
        match self {
            Self::Watch(name) => watching(name, false),
            Self::Unwatch(name) => watching(name, true),
            Self::Grant(grantee) => Some(Undo::Granted(grantee.to_string())),
            Self::Extend(_) => never("it was a transaction; e changes the end of the grant (5)"),
            Self::Revoke(_) => never("a revoke is a transaction: to share again, make a new grant (5, then g)"),
            Self::Rotate => never("a new epoch cannot be undone"),
            Self::LoadKey(_) => never("the replaced key is no longer in the keyring; load its file again"),
            Self::Release(_) => never("released messages are already being anchored; they keep their tag"),
            Self::Discard(_) => never("discarded messages are deleted; their count is on the chain"),
            Self::Administer(_) | Self::Deploy => {
                never("it was a transaction; send the opposite one instead (7, then :)")
            }
            Self::Incident(deed, name) => Some(deed.stays().map_or_else(|| Undo::By(taken_back(name)), Undo::Never)),
            Self::Evidence(_) => never("what a file discloses cannot be taken back; delete the file if nobody has it"),
            Self::SetPolicy(..) => never("a policy's version only rises; set the earlier one again (8, then p)"),
            Self::Feed(..) | Self::OpenConsole | Self::CreateIdentity | Self::Unlock | Self::Register => None,
            Self::Lock | Self::HoldCapture | Self::ExportKey(_) | Self::BackUp | Self::Export(_) => None,
            Self::Pin(_) | Self::Unpin(_) | Self::Play(_) | Self::StopPlay | Self::Contact(_) => None,
            Self::Robot(_) | Self::Publishers(_) | Self::Show(_) | Self::Beside(..) | Self::Open(_) => None,
            Self::Path(_) | Self::Check(_) | Self::Foresee(_) | Self::Limit(_) => None,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Need {
    Unlocked,
    /// Unlocked, and registered on the chain.
    Registered,
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

pub fn watch_errand(topic: TopicPattern, watch: bool) -> Errand {
    let name = topic.to_string();
    if watch {
        Errand { command: Command::WatchTopic { topic, type_name: None, sampling: None }, tag: Tag::Watch(name) }
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
