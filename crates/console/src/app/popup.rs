//! The popups over a screen and their keys: the topmost has the keys, `q` or Esc closes it.

use super::administration::{self, Act};
use super::available::available;
use super::choosing::{self, ColumnChoice, ThemeChoice};
use super::form::{self, Field, Form, FormStep, GrantWish, Wrong};
use super::granting;
use super::identity_path::{self, Need};
use super::incidents::{self, IncidentList};
use super::keymap::{Key, Meaning, chord_label};
use super::leaving::{self, Leaving};
use super::opening::{self, Opening};
use super::perform::{self, copy, perform};
use super::screens::{LogLine, earlier, end, is_active, is_given, scope};
use super::update::Feed;
use super::verb::{Entry, Errand, Tag, VERBS, Verb};
use super::{State, evidence, limiting, palette, policies};
use crate::model::TopicName;
use crate::service::command::Held;
use crate::service::reply::{GrantForesight, GrantRow, NOTHING_OLDER, PinsView, Provenance, RobotView, TopicRow};
use crate::service::{Command, Failure, GrantFrom};

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
pub struct Lookup<T> {
    pub id: String,
    /// `None` until it arrives.
    pub answer: Option<Result<Box<T>, Failure>>,
    pub scroll: usize,
}

impl<T> Lookup<T> {
    pub fn new(id: &str) -> Self {
        Self { id: id.to_owned(), answer: None, scroll: 0 }
    }

    pub fn found(&self) -> Option<&T> {
        self.answer.as_ref()?.as_ref().ok().map(Box::as_ref)
    }

    /// Scrolls an answer of about that many lines; false = the key closes it.
    pub(super) fn scrolls(&mut self, key: Key, page: usize, lines: impl FnOnce(&T) -> usize) -> bool {
        let Some(scroll) = scrolled(self.scroll, key, page) else { return false };
        self.scroll = scroll.min(self.found().map_or(0, lines));
        true
    }
}

pub(super) fn tell<T>(
    state: &mut State,
    id: &str,
    answer: Result<T, Failure>,
    of: fn(&mut Popup) -> Option<&mut Lookup<T>>,
) {
    if let Some(lookup) = state.popups.iter_mut().filter_map(of).find(|lookup| lookup.id == id) {
        lookup.answer = Some(answer.map(Box::new));
    }
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

impl Palette {
    /// Available ones first, best match first.
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

pub fn pin(row: &TopicRow, topic: TopicName) -> Confirm {
    let publishers = if row.publishers.is_empty() { "nobody".to_owned() } else { row.publishers.join(" ") };
    let lines = vec![
        format!("Topic       {topic}"),
        format!("Publishers  {publishers}"),
        "Accepted are those who publish when you confirm; messages of others are quarantined.".to_owned(),
        "Check host and type first: enter shows them (a name alone can be forged).".to_owned(),
    ];
    let tag = Tag::Pin(topic.to_string());
    let errand = Errand { command: Command::PinTopic { topic: topic.into(), publishers: Vec::new() }, tag };
    Confirm { title: "Accept these publishers?".to_owned(), lines, yes: "pin", typed: None, errand }
}

pub fn decide(row: &TopicRow, topic: TopicName, discard: bool) -> Confirm {
    let held = Held { topic: Some(topic.clone().into()), ids: Vec::new() };
    let held_now = format!("Held   {} messages, and what comes until you confirm", row.quarantined);
    let mut lines = vec![format!("Topic  {topic}"), held_now];
    let name = topic.to_string();
    if discard {
        lines.push("Their ciphertext is deleted. Quarantine records on the chain count them, so that".to_owned());
        lines.push("nobody can cherry-pick evidence; the messages themselves cannot be restored.".to_owned());
        let errand = Errand { command: Command::DiscardHeld { held }, tag: Tag::Discard(name.clone()) };
        let typed = Some(Typed::new(&name));
        return Confirm { title: "Discard quarantined messages?".to_owned(), lines, yes: "discard", typed, errand };
    }
    lines.push("They are anchored like others and keep a tag saying that they were quarantined.".to_owned());
    let errand = Errand { command: Command::ReleaseHeld { held }, tag: Tag::Release(name) };
    Confirm { title: "Release quarantined messages?".to_owned(), lines, yes: "release", typed: None, errand }
}

/// `None` = what it opens and costs is not told yet.
pub fn grant(state: &State, wish: GrantWish, foreseen: Option<Result<GrantForesight, Failure>>) -> Confirm {
    // What robots have is known once it is foreseen.
    let topics: Vec<String> = match &foreseen {
        Some(Ok(foreseen)) if !wish.robots.is_empty() => foreseen.topics.iter().map(ToString::to_string).collect(),
        _ => granting::covered(&wish),
    };
    let (records, cost) = match &foreseen {
        Some(Ok(foreseen)) => (foreseen.moment(|moment| state.times().meaning(moment)), Some(foreseen.cost())),
        Some(Err(failure)) => (before(wish.from).to_owned(), Some(format!("not known: {}", failure.message))),
        None => (before(wish.from).to_owned(), None),
    };
    let ends = wish.expires.map_or_else(|| "no end".to_owned(), |moment| state.times().meaning(moment));
    let mut lines = vec![
        format!("To       {}", wish.grantee),
        format!("Topics   {}", if topics.is_empty() { scope(&topics) } else { topics.join(" ") }),
        format!("Records  {records}"),
        format!("Ends     {ends}"),
    ];
    lines.extend(cost.map(|cost| format!("Cost     {cost}")));
    lines.push(String::new());
    lines.extend(readers(state, "Current readers:", None));
    lines.push("A later revoke stops new records; what was read cannot be taken back.".to_owned());
    let GrantWish { grantee, topics, robots, from, expires } = wish;
    let topics = topics.into_iter().map(Into::into).collect();
    let tag = Tag::Grant(grantee.clone());
    let errand = Errand { command: Command::Grant { grantee, topics, robots, from, expires }, tag };
    Confirm { title: "Grant this?".to_owned(), lines, yes: "grant", typed: None, errand }
}

/// What is certain before the site has counted.
fn before(from: GrantFrom) -> &'static str {
    match from {
        GrantFrom::Now => NOTHING_OLDER,
        GrantFrom::Current => "since the current epoch began",
        GrantFrom::Epoch(1) => "all, from the first epoch on",
        GrantFrom::Epoch(_) => "since an earlier epoch began",
        GrantFrom::Time(_) => "since the epoch of that time began",
    }
}

pub fn revoke(state: &State, row: &GrantRow) -> Confirm {
    let mut lines = vec![
        format!("From    {}", row.grantee),
        format!("Shared  {}, {}{}", scope(&row.topics), end(row.expires), earlier(row)),
        String::new(),
        "The next record is sealed under a new key that this account does not get.".to_owned(),
        "What was already read cannot be taken back, and records sealed before".to_owned(),
        "stay readable to anyone who has their key. A robot out of reach continues".to_owned(),
        "under the old key until it connects. To share again, make a new grant.".to_owned(),
        String::new(),
    ];
    lines.extend(readers(state, "Who can read afterwards:", Some(row)));
    let errand = Errand { command: Command::Revoke { grantee: row.grantee.into() }, tag: Tag::Revoke(row.grantee) };
    Confirm { title: format!("Revoke {}?", row.grantee.short()), lines, yes: "revoke", typed: None, errand }
}

pub fn rotate() -> Confirm {
    let lines = vec![
        "The next record is encrypted under a new key.".to_owned(),
        "Current readers keep access and robots are told. Sends one transaction,".to_owned(),
        "and one more for every eight readers.".to_owned(),
    ];
    let errand = Errand { command: Command::RotateKeys, tag: Tag::Rotate };
    Confirm { title: "Begin a new epoch?".to_owned(), lines, yes: "rotate", typed: None, errand }
}

/// One line each under a title; `without` is left out.
pub fn readers(state: &State, title: &str, without: Option<&GrantRow>) -> Vec<String> {
    let without = without.map(|row| row.grantee);
    let active = state.grants.rows.iter().filter(|row| is_given(row) && is_active(row) && Some(row.grantee) != without);
    let line = |row: &GrantRow| (row.grantee, scope(&row.topics), end(row.expires), earlier(row));
    let readers: Vec<_> = active.map(line).collect();
    let mut lines = vec![title.to_owned()];
    if state.awaits(Feed::Grants) {
        lines.push("  (the list of grants has not arrived yet)".to_owned());
    } else if readers.is_empty() {
        lines.push("  nobody but you".to_owned());
    }
    let more = readers.len().saturating_sub(5);
    lines.extend(readers.into_iter().take(5).map(|(who, what, end, too)| format!("  {who}  {what}  {end}{too}")));
    if more > 0 {
        lines.push(format!("  and {more} more"));
    }
    lines
}

pub fn hints(state: &State, popup: &Popup) -> Vec<(&'static str, &'static str)> {
    match popup {
        Popup::Palette(_) => vec![("enter", "run"), ("up down", "choose, earlier"), ("esc", "close")],
        Popup::Browse(_) => vec![("enter", "show these"), ("up down", "choose"), ("q", "close")],
        Popup::Contacts(_) => granting::hints(state),
        Popup::Incidents(list) => incidents::hints(state, list),
        Popup::Robot(_) => policies::hints(state),
        Popup::Publishers(_) => vec![("up down", "scroll"), ("p", "pin"), ("P", "unpin"), ("q", "close")],
        Popup::Tasks | Popup::Readers(_) => vec![("q", "close")],
        Popup::Alerts(_) => vec![("up down", "scroll"), ("q", "close")],
        Popup::Unlocked => vec![("enter", "close"), ("esc", "close")],
        Popup::Line(_) => vec![("y", "copy"), ("q", "close")],
        Popup::Provenance(_) => vec![("n p", "next/prev"), ("up down", "scroll"), ("q", "close")],
        Popup::Help(Help { filtering: true, .. }) => vec![("enter", "apply"), ("esc", "clear")],
        Popup::Help(_) => vec![("up down", "scroll"), ("/", "filter"), ("q", "close")],
        Popup::Chord(_) => vec![("esc", "close")],
        Popup::Themes(_) => vec![("up down", "preview"), ("enter", "keep"), ("esc", "cancel")],
        Popup::Columns(_) => {
            let moves = [("space", "show/hide"), ("<", "left"), (">", "right")];
            moves.into_iter().chain([("r", "usual"), ("enter", "keep"), ("esc", "cancel")]).collect()
        }
        Popup::Confirm(confirm) => {
            let [yes, copy, no, cancel] = match &confirm.typed {
                Some(_) => ["enter", "ctrl-y", "esc", "cancel"],
                None => ["y", "Y", "any other key", "cancels"],
            };
            let twin = palette::twin(state, &confirm.errand).map(|_| (copy, "copy as command"));
            [(yes, confirm.yes)].into_iter().chain(twin).chain([(no, cancel)]).collect()
        }
        Popup::Form(_, form) => {
            let path = form.lines.get(form.focus).is_some_and(|line| line.path.is_some());
            let tab = path.then_some(("tab", "complete"));
            let all = [("enter", "next field / submit"), ("up down", "move"), ("esc", "cancel")];
            tab.into_iter().chain(all).collect()
        }
        Popup::Record(opening) => opening.hints(),
        Popup::Quit(leaving) => leaving.hints(state),
    }
}

pub fn popup_key(state: &mut State, key: Key) {
    if key == Key::Char('?') && !takes_text(state) {
        let window = state.popups.last().map(|popup| match popup {
            Popup::Incidents(list) => incidents::explained(state, list),
            other => hints(state, other),
        });
        state.popups.push(Popup::Help(Help { window, ..Help::default() }));
        return;
    }
    let Some(popup) = state.popups.pop() else { return };
    let quitting = matches!(popup, Popup::Quit(_));
    let key = if key == Key::Control('c') && !quitting { Key::Escape } else { key };
    match popup {
        Popup::Palette(palette) => palette::key(state, palette, key),
        Popup::Form(purpose, form) => form_key(state, purpose, form, key),
        Popup::Confirm(confirm) => confirm_key(state, confirm, key),
        Popup::Quit(leaving) => leaving::key(state, leaving, key),
        Popup::Chord(begun) => chord_key(state, begun, key),
        Popup::Themes(choice) => choosing::theme_key(state, choice, key),
        Popup::Columns(choice) => choosing::column_key(state, choice, key),
        Popup::Record(opening) => opening::key(state, opening, key),
        Popup::Browse(selected) => choosing::browse_key(state, selected, key),
        Popup::Contacts(selected) => granting::key(state, selected, key),
        Popup::Incidents(list) => incidents::key(state, list, key),
        Popup::Publishers(lookup) => publishers_key(state, lookup, key),
        Popup::Robot(lookup) => policies::key(state, lookup, key),
        Popup::Tasks | Popup::Readers(_) if matches!(key, Key::Char('q' | 't' | 'i')) => {}
        Popup::Line(_) if key == Key::Char('q') => {}
        Popup::Alerts(_) if key == Key::Enter => {}
        Popup::Alerts(scroll) => {
            let most = state.alerts.shown().len() * 8;
            let scroll = scrolled(scroll, key, state.page_rows()).map(|scroll| scroll.min(most));
            state.popups.extend(scroll.map(Popup::Alerts));
        }
        Popup::Tasks | Popup::Readers(_) | Popup::Line(_) | Popup::Unlocked
            if matches!(key, Key::Escape | Key::Enter) => {}
        Popup::Tasks | Popup::Readers(_) | Popup::Unlocked => state.popups.push(popup),
        Popup::Line(line) => {
            if key == Key::Char('y') {
                copy(state, line.whole());
            }
            state.popups.push(Popup::Line(line));
        }
        Popup::Provenance(_) if key == Key::Char('n') => opening::neighbour(state, popup, 1),
        Popup::Provenance(_) if key == Key::Char('p') => opening::neighbour(state, popup, -1),
        Popup::Provenance(mut lookup) => {
            if lookup.scrolls(key, state.page_rows(), |found| found.steps.len() * 3 + 8) {
                state.popups.push(Popup::Provenance(lookup));
            }
        }
        Popup::Help(help) => help_key(state, help, key),
    }
}

/// Whether the topmost popup takes `?` as text or handles it.
fn takes_text(state: &State) -> bool {
    match state.popups.last() {
        Some(Popup::Form(_, form)) => {
            form.field(form.focus).is_some_and(|field| field.is_masked() || !field.text().is_empty())
        }
        Some(Popup::Palette(palette)) => !palette.field.text().is_empty(),
        Some(Popup::Confirm(confirm)) => confirm.typed.is_some(),
        Some(Popup::Help(_) | Popup::Chord(_)) => true,
        _ => false,
    }
}

fn help_key(state: &mut State, mut help: Help, key: Key) {
    match key {
        Key::Escape if help.filtering || !help.filter.text().is_empty() => {
            (help.filtering, help.filter) = Default::default()
        }
        Key::Enter if help.filtering => help.filtering = false,
        Key::Up | Key::Down | Key::PageUp | Key::PageDown | Key::Home if help.filtering => {}
        _ if help.filtering => drop(help.filter.key(key)),
        Key::Char('/') => help.filtering = true,
        Key::Char('?') => return,
        _ => match scrolled(help.scroll, key, state.page_rows()) {
            Some(scroll) => help.scroll = scroll.min(super::verb::VERBS.len() * 2),
            None => return,
        },
    }
    state.popups.push(Popup::Help(help));
}

pub fn popup_paste(state: &mut State, text: &str) {
    match state.popups.last_mut() {
        Some(Popup::Form(_, form)) => form.paste(text),
        Some(Popup::Palette(palette)) => palette.field.insert(text),
        Some(Popup::Confirm(Confirm { typed: Some(typed), .. })) => typed.field.insert(text),
        _ => {}
    }
}

/// `None` = the key closes it.
pub(super) fn scrolled(scroll: usize, key: Key, page: usize) -> Option<usize> {
    Some(match key {
        Key::Escape | Key::Char('q') => return None,
        Key::Up | Key::Char('k') => scroll.saturating_sub(1),
        Key::Down | Key::Char('j') => scroll + 1,
        Key::PageUp => scroll.saturating_sub(page),
        Key::PageDown | Key::Char(' ') => scroll + page,
        Key::Home => 0,
        _ => scroll,
    })
}

pub(super) fn moved(selected: usize, count: usize, key: Key) -> usize {
    let last = count.saturating_sub(1);
    let selected = selected.min(last);
    match key {
        Key::Up | Key::BackTab | Key::Char('k') => selected.saturating_sub(1),
        Key::Down | Key::Tab | Key::Char('j') => (selected + 1).min(last),
        Key::Home => 0,
        Key::End | Key::Char('G') => last,
        _ => selected,
    }
}

fn chord_key(state: &mut State, mut pressed: Vec<Key>, key: Key) {
    if key == Key::Escape {
        return;
    }
    pressed.push(key);
    let meaning = state.settings.keymap.meaning(&pressed, state.screen);
    match meaning {
        Meaning::Does(verb) => perform(state, verb),
        Meaning::Begins(_) => state.popups.push(Popup::Chord(pressed)),
        Meaning::Nothing => state.inform(format!("'{}' does nothing here", chord_label(&pressed))),
    }
}

fn publishers_key(state: &mut State, mut lookup: Lookup<PinsView>, key: Key) {
    match key {
        Key::Char('p') => return perform(state, Verb::Pin),
        Key::Char('P') => return perform(state, Verb::Unpin),
        _ => {}
    }
    if lookup.scrolls(key, state.page_rows(), |found| found.pins.len() * 3 + found.alarms.len() * 3 + 4) {
        state.popups.push(Popup::Publishers(lookup));
    }
}

fn confirm_key(state: &mut State, mut confirm: Confirm, key: Key) {
    // Where a word is typed, letters belong to it.
    let copies = if confirm.typed.is_some() { Key::Control('y') } else { Key::Char('Y') };
    if key == copies {
        palette::twin(state, &confirm.errand).into_iter().for_each(|line| copy(state, line));
        return state.popups.push(Popup::Confirm(confirm));
    }
    let said = match &mut confirm.typed {
        Some(_) if key == Key::Escape => return unasked(state),
        Some(typed) if key == Key::Enter => typed.is_done(),
        Some(typed) => {
            typed.field.key(key);
            false
        }
        None if key != Key::Char('y') => return unasked(state),
        None => true,
    };
    if !said {
        return state.popups.push(Popup::Confirm(confirm));
    }
    // The form that led here is done.
    let led_here = |purpose: &Purpose| {
        use Purpose::{Administer, ExportEvidence, Extend, Grant, LoadKey, SetPolicy};
        matches!(purpose, Grant | Extend | LoadKey | Administer(_) | SetPolicy | ExportEvidence)
    };
    let form = state.popups.iter().position(|popup| matches!(popup, Popup::Form(purpose, _) if led_here(purpose)));
    if let Some(Popup::Form(purpose, form)) = form.map(|place| state.popups.remove(place)) {
        state.filled = Some((confirm.errand.tag.clone(), purpose, form));
    }
    match need_of(&confirm) {
        Some(need) => identity_path::run(state, need, vec![confirm.errand]),
        None => state.send(confirm.errand),
    }
}

/// Neither the act nor what was to follow it happens.
fn unasked(state: &mut State) {
    state.follow_up = None;
}

/// Pins do not need an open keyring.
#[deny(clippy::wildcard_enum_match_arm)]
fn need_of(confirm: &Confirm) -> Option<Need> {
    match confirm.errand.tag {
        Tag::Feed(..) | Tag::OpenConsole | Tag::CreateIdentity | Tag::Unlock | Tag::Lock | Tag::BackUp => None,
        Tag::HoldCapture | Tag::StopPlay | Tag::Contact(_) | Tag::Incident(..) => None,
        Tag::Robot(_) | Tag::Publishers(_) | Tag::Show(_) | Tag::Beside(..) | Tag::Pin(_) | Tag::Unpin(_) => None,
        Tag::Foresee(_) => None,
        Tag::LoadKey(_) | Tag::Release(_) | Tag::Discard(_) | Tag::Deploy => Some(Need::Unlocked),
        Tag::Open(_) | Tag::Path(_) | Tag::Check(_) | Tag::Export(_) | Tag::ExportKey(_) => Some(Need::Unlocked),
        Tag::Play(_) | Tag::SetPolicy(..) | Tag::Evidence(_) => Some(Need::Unlocked),
        Tag::Extend(_) | Tag::Administer(_) => Some(Need::Registered),
        Tag::Register | Tag::Watch(_) | Tag::Unwatch(_) | Tag::Limit(_) => Some(Need::Registered),
        Tag::Grant(_) | Tag::Revoke(_) | Tag::Rotate => Some(Need::Registered),
    }
}

fn form_key(state: &mut State, purpose: Purpose, mut form: Form, key: Key) {
    let completes: fn(&State, &mut Form) -> bool = match purpose {
        Purpose::Grant => granting::complete,
        Purpose::OpenIncident => incidents::complete,
        Purpose::ExportEvidence => evidence::complete,
        Purpose::SetPolicy => policies::complete,
        _ => |_, _| false,
    };
    if key == Key::Tab && completes(state, &mut form) {
        return state.popups.push(Popup::Form(purpose, form));
    }
    if let Some(asked) = palette::tab(state, &form, key) {
        state.effects.push(asked);
        return state.popups.push(Popup::Form(purpose, form));
    }
    match form.key(key) {
        FormStep::Stay => state.popups.push(Popup::Form(purpose, form)),
        FormStep::Cancel if matches!(purpose, Purpose::CreateIdentity | Purpose::Unlock) => {
            identity_path::abandon(state);
        }
        FormStep::Cancel => {}
        FormStep::Submit => match submit(state, purpose, &form) {
            // The form stays below its question, so that a "no" returns to it.
            Ok(()) if matches!(state.popups.last(), Some(Popup::Confirm(_))) => {
                state.popups.insert(state.popups.len() - 1, Popup::Form(purpose, form));
            }
            // The form also stays while its file is read.
            Ok(()) if purpose == Purpose::SetPolicy => state.popups.push(Popup::Form(purpose, form)),
            Ok(()) => {
                // A refused contact or incident returns to its form.
                let kept = matches!(purpose, Purpose::AddContact | Purpose::OpenIncident | Purpose::NoteIncident);
                if let Some(tag) = state.work.last().filter(|_| kept).cloned() {
                    state.filled = Some((tag, purpose, form));
                }
            }
            Err((line, error)) => {
                form.refuse(line, error);
                state.popups.push(Popup::Form(purpose, form));
            }
        },
    }
}

fn submit(state: &mut State, purpose: Purpose, form: &Form) -> Result<(), Wrong> {
    match purpose {
        Purpose::CreateIdentity => state.send(form::read_create(form)?),
        Purpose::Unlock => state.send(form::read_unlock(form)?),
        Purpose::Unpin => state.send(form::read_unpin(form)?),
        Purpose::AddContact => state.send(granting::read(form)?),
        Purpose::OpenIncident => state.send(incidents::read(state, form)?),
        Purpose::NoteIncident => state.send(incidents::read_note(form)?),
        Purpose::ExportEvidence => {
            let question = evidence::read(state, form)?;
            state.popups.push(Popup::Confirm(question));
        }
        Purpose::Export => palette::submit(state, form),
        Purpose::SetPolicy => policies::submit(state, form)?,
        Purpose::Limit => limiting::submit(state, form)?,
        Purpose::Profile => perform::switch(state, form.parsed(0)?),
        Purpose::ExportKey => {
            let errand = form::read_export(form)?;
            palette::goes_to(state, &errand.tag, form, 3);
            identity_path::run(state, Need::Unlocked, vec![errand]);
        }
        Purpose::Grant => {
            let wish = form::read_grant(form, state)?;
            granting::check(state, &wish)?;
            granting::ask(state, wish);
        }
        Purpose::Extend => granting::extend(state, form)?,
        Purpose::Administer(act) => state.popups.push(Popup::Confirm(administration::read(act, form)?)),
        Purpose::LoadKey => state.popups.push(Popup::Confirm(form::read_load(form, &state.settings)?)),
    }
    Ok(())
}
