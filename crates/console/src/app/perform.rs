//! What each verb does, and how the last act is undone.
#![deny(clippy::wildcard_enum_match_arm)]

use super::available::available;
use super::choosing;
use super::form::{self, Field, Form, Line};
use super::identity_path::{self, Need};
use super::leaving::{self, Leaving};
use super::popup::{self, Confirm, Lookup, Palette, Popup, Purpose};
use super::screens::{LogLine, other_side};
use super::update::{self, Feed};
use super::verb::{Contents, Effect, Errand, Tag, Verb};
use super::{Screen, State, administration, granting, incidents, limiting, opening, palette, policies, table};
use crate::model::{Address, Party, ProfileName, TopicName, TopicPattern};
use crate::service::Command;
use crate::service::command::{Pace, PlayWishes};
use crate::service::reply::{PlayedView, TopicRow};

pub fn perform(state: &mut State, verb: Verb) {
    if let Err(reason) = available(state, verb) {
        return refuse(state, verb, reason);
    }
    match verb {
        Verb::Watch => watch(state),
        Verb::Details => details(state),
        Verb::Open => open_record(state),
        Verb::Check => check(state),
        Verb::Export => palette::begin(state),
        Verb::CreateIdentity | Verb::Register => identity_path::run(state, Need::Registered, Vec::new()),
        Verb::Unlock => identity_path::run(state, Need::Unlocked, Vec::new()),
        Verb::Copy => copied(state).into_iter().for_each(|text| copy(state, text)),
        Verb::WriteFile => copied(state).into_iter().for_each(|text| write_file(state, &text)),
        Verb::CopyCommand => state.last_act.clone().into_iter().for_each(|line| copy(state, line)),
        Verb::Quit if leaving::asks(state) => state.popups.push(Popup::Quit(Leaving::Asked)),
        Verb::Quit => state.effects.push(Effect::Quit),
        Verb::Play => toggle(state),
        Verb::Publishers => publishers(state),
        Verb::Inspect => policies::open(state),
        Verb::Lock => update::lock(state),
        Verb::Undo => undo(state),
        Verb::BackUp => state.send(Errand { command: Command::BackUpKeys, tag: Tag::BackUp }),
        Verb::ChooseTheme => choosing::choose(state),
        Verb::Ascii => state.effects.push(Effect::ToggleAscii),
        Verb::Mouse => update::toggle(state),
        Verb::Redraw => state.effects.push(Effect::Redraw),
        Verb::Suspend => state.effects.push(Effect::Suspend),
        Verb::Up | Verb::PreviousMatch => table::step(state, -1),
        Verb::Down | Verb::NextMatch => table::step(state, 1),
        Verb::PageUp => table::step(state, -state.page_rows().cast_signed()),
        Verb::PageDown => table::step(state, state.page_rows().cast_signed()),
        Verb::Go(screen) => go(state, screen),
        Verb::NextScreen => go(state, state.screen.shifted(1)),
        Verb::PreviousScreen => go(state, state.screen.shifted(-1)),
        Verb::First => table::jump(state, false),
        Verb::Last => table::jump(state, true),
        Verb::Mark => mark(state),
        Verb::MarkAll => table::mark_all(state),
        Verb::Filter => drop(state.table_mut().map(super::table::Table::begin_filter)),
        Verb::Sort => table::sort(state),
        Verb::Reverse => table::reverse(state),
        Verb::Columns => choosing::open(state),
        Verb::Level => state.log.next_level(),
        Verb::Source => state.log.next_source(),
        Verb::Read => state.popups.extend(state.log.selected().cloned().map(Popup::Line)),
        Verb::Tasks => tasks(state),
        Verb::Readers => readers(state),
        Verb::Alerts => state.popups.push(Popup::Alerts(0)),
        Verb::Contacts => granting::open_contacts(state),
        Verb::SetPolicy => policies::begin(state),
        Verb::Incident => incidents::begin(state),
        Verb::Incidents => incidents::open(state),
        Verb::Profile => open(state),
        Verb::EndTour => state.tour = None,
        Verb::Browse => state.popups.push(Popup::Browse(0)),
        Verb::LocalTime => state.local_time = !state.local_time,
        Verb::Pin => ask_about(state, popup::pin),
        Verb::Release => ask_about(state, |row, topic| popup::decide(row, topic, false)),
        Verb::Discard => ask_about(state, |row, topic| popup::decide(row, topic, true)),
        Verb::Unpin => unpin(state),
        Verb::Limit => limiting::begin(state),
        Verb::Administer(act) => administration::begin(state, act),
        Verb::Freeze => freeze(state),
        Verb::Period => state.period = state.period.next(),
        Verb::Fold => drop(state.topics.fold()),
        Verb::FoldAll => state.topics.fold_all(),
        Verb::Palette => state.popups.push(Popup::Palette(Palette::default())),
        Verb::Help => state.popups.push(Popup::Help(super::popup::Help::default())),
        Verb::Dismiss => dismiss(state),
        Verb::Grant => granting::begin(state),
        Verb::Extend => granting::begin_extension(state),
        Verb::Revoke => {
            let question = state.grants.selected().map(|row| Popup::Confirm(popup::revoke(state, row)));
            state.popups.extend(question);
        }
        Verb::LoadKey => state.popups.push(Popup::Form(Purpose::LoadKey, form::load_key())),
        Verb::ExportKey => palette::begin_key(state),
        Verb::Rotate => state.popups.push(Popup::Confirm(popup::rotate())),
    }
}

fn refuse(state: &mut State, verb: Verb, reason: &str) {
    if verb == Verb::Unlock && state.identity.as_ref().is_some_and(|identity| identity.unlocked) {
        // Otherwise a typed passphrase would be taken for commands.
        return state.popups.push(Popup::Unlocked);
    }
    let name = super::verb::entry_of(verb, state.screen).map_or("", |entry| entry.name);
    state.inform(format!("{name}: {reason}"));
}

pub(super) fn go(state: &mut State, screen: Screen) {
    if state.screen != screen {
        screen.feeds().iter().for_each(|feed| state.feeds.look(*feed));
    }
    state.screen = screen;
}

fn tasks(state: &mut State) {
    state.feeds.slot_mut(Feed::Progress).stale = true;
    state.popups.push(Popup::Tasks);
}

fn freeze(state: &mut State) {
    state.frozen = if state.is_frozen() { None } else { Some(state.now) };
    state.feeds.gather();
}

fn mark(state: &mut State) {
    let (key, keys) = (state.row_key(), state.row_keys());
    let Some(table) = state.table_mut() else { return };
    if let Some(key) = key.filter(|key| !table.marks.remove(key)) {
        table.marks.insert(key);
    }
    table.step(&keys, 1);
}

fn dismiss(state: &mut State) {
    if let Some(toast) = state.toasts.dismiss() {
        return state.log.saw(&toast.text);
    }
    let Some(table) = state.table_mut() else { return };
    if table.filter.text().is_empty() {
        return table.marks.clear();
    }
    table.filter.clear();
    table::restart_records(state);
}

fn watch(state: &mut State) {
    if state.screen == Screen::Overview {
        go(state, Screen::Topics);
        return state.inform("select a topic (arrows, or space to mark several), then press w");
    }
    let targets: Vec<(String, bool)> =
        state.topics.targets().into_iter().map(|row| (row.topic.clone(), row.watched)).collect();
    let watches = targets.iter().any(|(_, watched)| !watched);
    let mut errands = Vec::new();
    for (topic, _) in targets.into_iter().filter(|(_, watched)| *watched != watches) {
        match topic.parse::<TopicName>() {
            Ok(topic) => errands.push(watch_errand(topic.into(), watches)),
            Err(error) => state.complain(error.to_string()),
        }
    }
    send_watches(state, watches, errands);
}

fn send_watches(state: &mut State, watches: bool, errands: Vec<Errand>) {
    if watches {
        return identity_path::run(state, Need::Registered, errands);
    }
    errands.into_iter().for_each(|errand| state.send(errand));
}

/// `watch /robot*/camera/**` of the palette: also what appears later.
pub(super) fn spoken_watch(state: &mut State, topics: &[&str], watches: bool) {
    let read: Result<Vec<TopicPattern>, _> = topics.iter().map(|topic| topic.parse()).collect();
    match read {
        Ok(topics) => {
            let errands = topics.into_iter().map(|topic| watch_errand(topic, watches)).collect();
            send_watches(state, watches, errands);
        }
        Err(error) => state.complain(error.to_string()),
    }
}

fn watch_errand(topic: TopicPattern, watch: bool) -> Errand {
    let name = topic.to_string();
    if watch {
        Errand { command: Command::WatchTopic { topic, type_name: None, sampling: None }, tag: Tag::Watch(name) }
    } else {
        Errand { command: Command::UnwatchTopic { topic }, tag: Tag::Unwatch(name) }
    }
}

fn details(state: &mut State) {
    let Some(id) = state.row_key() else { return };
    state.popups.push(Popup::Provenance(Lookup::new(&id)));
    state.send(Errand { command: Command::ShowUpload { id: id.clone() }, tag: Tag::Show(id) });
}

fn open_record(state: &mut State) {
    let Some(id) = state.row_key() else { return };
    let errand = Errand { command: Command::OpenShared { id: id.clone() }, tag: Tag::Open(id) };
    identity_path::run(state, Need::Unlocked, vec![errand]);
}

fn check(state: &mut State) {
    for id in state.marked_keys() {
        state.send_new(Errand { command: Command::CheckShared { id: id.clone() }, tag: Tag::Check(id) });
    }
}

fn selected_topic(state: &mut State) -> Option<(TopicRow, TopicName)> {
    let row = state.topics.selected()?.clone();
    match row.topic.parse() {
        Ok(topic) => Some((row, topic)),
        Err(error) => {
            state.complain(format!("{error}"));
            None
        }
    }
}

fn publishers(state: &mut State) {
    let Some((_, topic)) = selected_topic(state) else { return };
    let name = topic.to_string();
    state.popups.push(Popup::Publishers(Lookup::new(&name)));
    let coverage = opening::coverage_of(&topic);
    state.send(Errand { command: Command::ListPins { topic: Some(topic.into()) }, tag: Tag::Publishers(name) });
    state.send_new(coverage);
}

fn ask_about(state: &mut State, question: fn(&TopicRow, TopicName) -> Confirm) {
    let Some((row, topic)) = selected_topic(state) else { return };
    state.popups.push(Popup::Confirm(question(&row, topic)));
}

fn unpin(state: &mut State) {
    let Some((row, topic)) = selected_topic(state) else { return };
    let publisher = row.unpinned.first().or(row.publishers.first()).cloned().unwrap_or_default();
    state.popups.push(Popup::Form(Purpose::Unpin, form::unpin(topic.as_str(), &publisher)));
}

fn readers(state: &mut State) {
    let topics = match state.screen {
        Screen::Topics => state.topics.targets().into_iter().map(|row| row.topic.clone()).collect(),
        Screen::Records => {
            let key = state.row_key();
            let rows = state.records.rows.iter();
            rows.filter(|row| Some(&row.id) == key.as_ref()).map(|row| row.topic.clone()).collect()
        }
        Screen::Grants => state.grants.selected().map(|row| row.topics.clone()).unwrap_or_default(),
        Screen::Overview | Screen::Received | Screen::Keys | Screen::Chain | Screen::Robots | Screen::Log => Vec::new(),
    };
    state.popups.push(Popup::Readers(topics));
}

/// Only the terminal knows whether it takes the text.
pub fn copy(state: &mut State, text: String) {
    state.inform(format!("sent to the terminal's clipboard (W writes a file): {text}"));
    state.effects.push(Effect::CopyText(text));
}

/// For terminals that accept no clipboard text.
fn write_file(state: &mut State, text: &str) {
    let name = format!("{}.txt", state.screen.title().to_lowercase());
    let file = Contents { name, bytes: format!("{text}\n").into_bytes().into() };
    state.effects.push(Effect::WriteFiles { base: None, directory: None, files: vec![file] });
}

pub fn copied(state: &State) -> Option<String> {
    let digest = |rows: Vec<&crate::service::reply::RecordView>| {
        let key = state.row_key()?;
        rows.iter().find(|row| row.id == key).map(|row| row.digest.to_hex())
    };
    match state.screen {
        Screen::Topics => state.row_key(),
        Screen::Records => digest(state.records.visible(&state.topics.rows)),
        Screen::Received => digest(state.received.visible(&state.topics.rows)),
        Screen::Robots => state.gateway.view.as_ref()?.served.as_ref().map(|served| served.gateway.to_string()),
        Screen::Grants => state.grants.selected().map(|row| other_side(row).to_string()),
        Screen::Keys => state.address().map(|address| address.to_string()),
        Screen::Chain => state.chain.as_ref()?.contract.map(|contract| contract.to_string()),
        Screen::Log => state.log.selected().map(LogLine::whole),
        Screen::Overview => None,
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

pub fn note(state: &mut State, tag: &Tag) {
    let watching = |name: &String, watch| name.parse().ok().map(|topic| Undo::By(watch_errand(topic, watch)));
    let undo = match tag {
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
        Tag::Incident(deed, name) => {
            Some(deed.stays().map_or_else(|| Undo::By(incidents::taken_back(name)), Undo::Never))
        }
        Tag::Evidence(_) => {
            Some(Undo::Never("what a file discloses cannot be taken back; delete the file if nobody has it"))
        }
        Tag::SetPolicy(..) => Some(Undo::Never("a policy's version only rises; set the earlier one again (8, then p)")),
        Tag::Play(_) | Tag::StopPlay | Tag::Contact(_) | Tag::Robot(_) => None,
        Tag::Publishers(_) | Tag::Show(_) | Tag::Beside(..) | Tag::Open(_) | Tag::Path(_) | Tag::Check(_) => None,
        Tag::Foresee(_) | Tag::Limit(_) => None,
    };
    if undo.is_some() {
        state.undo = undo;
    }
}

pub fn undo(state: &mut State) {
    match state.undo.take() {
        Some(Undo::By(errand)) => state.send(errand),
        Some(Undo::Granted(grantee)) => {
            let row = state.grants.rows.iter().find(|row| {
                let is_it = row.grantee.to_string() == grantee || row.name.as_deref() == Some(grantee.as_str());
                is_it && super::screens::is_given(row) && super::screens::is_active(row)
            });
            match row.map(|row| popup::revoke(state, row)) {
                Some(question) => state.popups.push(Popup::Confirm(question)),
                None => state.inform("that grant is no longer active"),
            }
        }
        Some(Undo::Never(why)) => state.inform(format!("cannot be undone: {why}")),
        None => state.inform("nothing to undo"),
    }
}

/// Plays the topic under `/shared/NAME`, or ends the playback.
pub fn toggle(state: &mut State) {
    if state.work.iter().any(|tag| matches!(tag, Tag::Play(_))) {
        return state.send(Errand { command: Command::StopPlay, tag: Tag::StopPlay });
    }
    let key = state.row_key();
    let row = state.received.rows.iter().find(|row| Some(&row.id) == key.as_ref());
    let found = row.and_then(|row| Some((row.owner?, row.owner_name.clone(), row.topic.clone())));
    let Some((owner, name, topic)) = found else { return };
    let (Ok(pattern), Some(prefix)) = (topic.parse(), prefix(owner, name.as_deref())) else {
        return state.complain(format!("{topic} cannot be played: its name is still a pseudonym"));
    };
    let played = format!("{prefix}{topic}");
    let wishes = PlayWishes {
        owner: Some(Party::Address(owner)),
        topics: vec![pattern],
        pace: Pace::Follow,
        prefix: Some(prefix),
        ..PlayWishes::default()
    };
    identity_path::run(state, Need::Unlocked, vec![Errand { command: Command::Play(wishes), tag: Tag::Play(played) }]);
}

/// `/shared/` and the owner's name as a graph allows it, or else the beginning of the address.
fn prefix(owner: Address, name: Option<&str>) -> Option<TopicName> {
    let plain = |name: &str| name.replace(|letter: char| !letter.is_ascii_alphanumeric(), "_");
    let of_name = name.and_then(|name| format!("/shared/{}", plain(name)).parse().ok());
    of_name.or_else(|| {
        let digits: String = owner.to_string().chars().skip(2).take(8).collect();
        format!("/shared/x{digits}").parse().ok()
    })
}

pub fn ended(state: &mut State, view: &PlayedView) {
    let published = view.published;
    let not = view.refused + view.missing;
    let rest = if not > 0 { format!(", {not} records NOT published") } else { String::new() };
    let text = |why: &str| format!("playback ended ({why}): {published} messages published{rest}");
    match view.ended_by.cut_short() {
        Some(why) => state.complain(text(why)),
        None => state.inform(text(view.ended_by.word())),
    }
}

pub fn open(state: &mut State) {
    let lines = vec![Line::text("Profile", "name of a profile in this home", Field::default())];
    let known: Vec<String> = state.settings.profiles.iter().map(ToString::to_string).collect();
    let mut notes = vec![format!("Now: {}. A keyring opened here stays open until you quit.", state.settings.profile)];
    if !known.is_empty() {
        notes.push(format!("Profiles: {}", known.join(" ")));
    }
    state.popups.push(Popup::Form(Purpose::Profile, Form::new("Switch to another profile", notes, lines)));
}

/// Everything known belongs to the previous profile and is requested anew.
pub fn switch(state: &mut State, profile: ProfileName) {
    if profile == state.settings.profile {
        return state.inform(format!("this console already uses profile {profile}"));
    }
    if let Some(work) = state.work.iter().find(|tag| tag.is_work()) {
        let text = format!("{} is still running; wait until it ends, then switch to {profile}", work.words());
        return state.inform(text);
    }
    let mut settings = state.settings.clone();
    settings.profile.clone_from(&profile);
    // The successor would start with this console's flags, but for another profile.
    settings.leaves_site = false;
    let mut next = State::new(settings);
    (next.now, next.touched, next.size) = (state.now, state.now, state.size);
    (next.mouse, next.local_time, next.period) = (state.mouse, state.local_time, state.period);
    next.theme = std::mem::take(&mut state.theme);
    next.tour = state.tour.take();
    next.log = std::mem::take(&mut state.log);
    next.screen = Screen::Overview;
    next.former = Some(state.settings.profile.clone());
    // Answers to requests of the previous profile must not match this one's.
    next.feeds.follow(&state.feeds);
    next.effects = std::mem::take(&mut state.effects);
    *state = next;
    state.inform(format!("this console now uses profile {profile}"));
    state.effects.push(Effect::SpeakFor(profile));
    update::claim(state);
}
