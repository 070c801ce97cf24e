//! What each verb does, and what its answer does.

#![deny(clippy::wildcard_enum_match_arm)]

use crate::app::answer::{
    Answer, checked, done, exported, fed, follow_up, incident_removed, is_done, key_file, key_loaded, locked,
    opened_console, policy_set, said, written,
};
use crate::app::{
    Contents, Effect, Errand, Feed, Need, Popup, Purpose, Screen, State, Table, Tag, Verb, answer,
    available::available, entry_of, identity_path, lock, rows, verb::Undo,
};
use crate::popups::form::{evidence, export, grant, limit, policy, profile};
use crate::popups::{
    columns, contacts, incidents, incidents::state::Deed, provenance, publishers, quit, record, robot, state::Help,
    state::Leaving, state::Palette, themes,
};
use crate::screens::grants::state::{is_active, is_given, other_side};
use crate::screens::{chain, grants, keys, log::state::LogLine, pane, records, topics};
use crate::service::Command;
use crate::service::command::{self as ask, Ask as _};

pub fn perform(state: &mut State, verb: Verb) {
    if let Err(reason) = available(state, verb) {
        return refuse(state, verb, reason);
    }
    match verb {
        Verb::Watch => topics::keys::watch(state),
        Verb::Details => records::keys::details(state),
        Verb::Open => records::keys::open_record(state),
        Verb::Check => records::keys::check(state),
        Verb::Export => export::begin(state),
        Verb::CreateIdentity | Verb::Register => identity_path::run(state, Need::Registered, Vec::new()),
        Verb::Unlock => identity_path::run(state, Need::Unlocked, Vec::new()),
        Verb::Copy => copied(state).into_iter().for_each(|text| state.copy(text)),
        Verb::WriteFile => copied(state).into_iter().for_each(|text| write_file(state, &text)),
        Verb::CopyCommand => state.last_act.clone().into_iter().for_each(|line| state.copy(line)),
        Verb::Quit if quit::asks(state) => state.popups.push(Popup::Quit(Leaving::Asked)),
        Verb::Quit => state.effects.push(Effect::Quit),
        Verb::Play => records::keys::play(state),
        Verb::Publishers => topics::keys::publishers(state),
        Verb::Inspect => robot::open(state),
        Verb::Lock => lock::lock(state),
        Verb::Undo => undo(state),
        Verb::BackUp => state.send(Errand { command: Command::BackUpKeys, tag: Tag::BackUp }),
        Verb::ChooseTheme => themes::choose(state),
        Verb::Ascii => state.effects.push(Effect::ToggleAscii),
        Verb::Mouse => toggle_mouse(state),
        Verb::Redraw => state.effects.push(Effect::Redraw),
        Verb::Suspend => state.effects.push(Effect::Suspend),
        Verb::Up | Verb::PreviousMatch => rows::step(state, -1),
        Verb::Down | Verb::NextMatch => rows::step(state, 1),
        Verb::PageUp => rows::step(state, -state.page_rows().cast_signed()),
        Verb::PageDown => rows::step(state, state.page_rows().cast_signed()),
        Verb::Go(screen) => state.go(screen),
        Verb::NextScreen => state.go(state.screen.shifted(1)),
        Verb::PreviousScreen => state.go(state.screen.shifted(-1)),
        Verb::First => rows::jump(state, false),
        Verb::Last => rows::jump(state, true),
        Verb::Mark => rows::mark(state),
        Verb::MarkAll => rows::mark_all(state),
        Verb::Filter => drop(state.table_mut().map(Table::begin_filter)),
        Verb::Sort => rows::sort(state),
        Verb::Reverse => rows::reverse(state),
        Verb::Columns => columns::keys::open(state),
        Verb::Level => state.log.next_level(),
        Verb::Source => state.log.next_source(),
        Verb::Read => state.popups.extend(state.log.selected().cloned().map(Popup::Line)),
        Verb::Tasks => tasks(state),
        Verb::Readers => topics::keys::readers(state),
        Verb::Alerts => state.popups.push(Popup::Alerts(0)),
        Verb::Contacts => contacts::open(state),
        Verb::SetPolicy => policy::begin(state),
        Verb::Incident => incidents::form::begin(state),
        Verb::Incidents => incidents::keys::open(state),
        Verb::Profile => profile::open(state),
        Verb::EndTour => state.tour = None,
        Verb::Browse => state.popups.push(Popup::Browse(0)),
        Verb::LocalTime => state.local_time = !state.local_time,
        Verb::Pin => topics::keys::ask_about(state, topics::keys::pin),
        Verb::Release => topics::keys::ask_about(state, |row, topic| topics::keys::decide(row, topic, false)),
        Verb::Discard => topics::keys::ask_about(state, |row, topic| topics::keys::decide(row, topic, true)),
        Verb::Unpin => topics::keys::unpin(state),
        Verb::Limit => limit::begin(state),
        Verb::Administer(act) => chain::keys::begin(state, act),
        Verb::Freeze => freeze(state),
        Verb::Period => state.period = state.period.next(),
        Verb::Fold => drop(state.topics.fold()),
        Verb::FoldAll => state.topics.fold_all(),
        Verb::Palette => state.popups.push(Popup::Palette(Palette::default())),
        Verb::Help => state.popups.push(Popup::Help(Help::default())),
        Verb::Dismiss => rows::dismiss(state),
        Verb::Grant => grant::begin(state),
        Verb::Extend => grant::begin_extension(state),
        Verb::Revoke => {
            let question = state.grants.selected().map(|row| Popup::Confirm(grants::keys::revoke(state, row)));
            state.popups.extend(question);
        }
        Verb::LoadKey => state.popups.push(Popup::Form(Purpose::LoadKey, keys::acts::load_key())),
        Verb::ExportKey => keys::acts::begin_key(state),
        Verb::Rotate => state.popups.push(Popup::Confirm(keys::acts::rotate())),
    }
}

fn refuse(state: &mut State, verb: Verb, reason: &str) {
    if verb == Verb::Unlock && state.identity.as_ref().is_some_and(|identity| identity.unlocked) {
        // Otherwise a typed passphrase would be taken for commands.
        return state.popups.push(Popup::Unlocked);
    }
    let name = entry_of(verb, state.screen).map_or("", |entry| entry.name);
    state.inform(format!("{name}: {reason}"));
}

fn tasks(state: &mut State) {
    state.feeds.slot_mut(Feed::Progress).stale = true;
    state.popups.push(Popup::Tasks);
}

fn freeze(state: &mut State) {
    state.frozen = if state.is_frozen() { None } else { Some(state.now) };
    state.feeds.gather();
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

pub fn undo(state: &mut State) {
    match state.undo.take() {
        Some(Undo::By(errand)) => state.send(errand),
        Some(Undo::Granted(grantee)) => {
            let row = state.grants.rows.iter().find(|row| {
                let is_it = row.grantee.to_string() == grantee || row.name.as_deref() == Some(grantee.as_str());
                is_it && is_given(row) && is_active(row)
            });
            match row.map(|row| grants::keys::revoke(state, row)) {
                Some(question) => state.popups.push(Popup::Confirm(question)),
                None => state.inform("that grant is no longer active"),
            }
        }
        Some(Undo::Never(why)) => state.inform(format!("cannot be undone: {why}")),
        None => state.inform("nothing to undo"),
    }
}

/// Each tag names its request, and with it the possible answers.
pub fn answered(state: &mut State, tag: &Tag, result: Answer) {
    if let Tag::Feed(feed, generation) = tag {
        return fed(state, *feed, *generation, result);
    }
    // Made for the previous profile: the answer belongs to nobody any more.
    let Some(place) = state.work.iter().position(|other| other == tag) else { return };
    state.work.remove(place);
    let times = state.times();
    match tag {
        Tag::Feed(..) => {}
        Tag::OpenConsole => opened_console(state, ask::OpenConsole::heard(result)),
        Tag::CreateIdentity => {
            let made = ask::CreateIdentity::heard(result);
            identity_path::opened(state, made, Purpose::CreateIdentity, "identity created");
        }
        Tag::Unlock => identity_path::opened(state, ask::Unlock::heard(result), Purpose::Unlock, "keyring unlocked"),
        Tag::Register => identity_path::registered(state, ask::Register::heard(result)),
        Tag::Open(id) => record::keys::answered(state, id, ask::OpenShared::heard(result)),
        Tag::Path(id) => record::keys::path_found(state, id, ask::ViewPath::heard(result)),
        Tag::Beside(Screen::Records, id) => pane::follow::looked_up(state, id, ask::ShowUpload::heard(result)),
        Tag::Beside(Screen::Topics, topic) => pane::follow::covered(state, topic, ask::TopicCoverage::heard(result)),
        Tag::Beside(_, id) => pane::follow::opened_beside(state, id, ask::OpenShared::heard(result)),
        Tag::Show(id) => provenance::answered(state, id, ask::ShowUpload::heard(result)),
        Tag::Publishers(topic) => publishers::answered(state, topic, ask::ListPins::heard(result)),
        // What the site knew before says nothing about what is in flight now.
        Tag::HoldCapture => {
            done(state, tag, ask::HoldCapture::heard(result), |state, ()| state.feeds.renew(Feed::Site))
        }
        Tag::Lock => locked(state, ask::Lock::heard(result)),
        Tag::Export(id) => {
            written(state, tag, ask::ExportUpload::heard(result), |_, base, files| exported(id, base, files))
        }
        Tag::ExportKey(kind) => {
            written(state, tag, ask::ExportKey::heard(result), |state, base, key| {
                answer::secret(base, key_file(state, *kind), &key)
            });
        }
        Tag::BackUp => {
            written(state, tag, ask::BackUpKeys::heard(result), |state, base, keys| {
                answer::secret(base, format!("{}.keyring", state.settings.profile), &keys)
            });
        }
        Tag::Play(_) => done(state, tag, ask::Play::heard(result), |state, view| records::keys::ended(state, &view)),
        Tag::StopPlay => done(state, tag, ask::StopPlay::heard(result), |_, ()| {}),
        Tag::Check(_) => done(state, tag, ask::CheckShared::heard(result), |state, check| checked(state, &check)),
        Tag::Contact(_) => done(state, tag, ask::ListContacts::heard(result), |state, rows| {
            state.contacts = rows;
            state.inform(is_done(tag));
        }),
        Tag::Incident(Deed::Remove, _) => incident_removed(state, tag, result),
        Tag::Incident(deed, _) => done(state, tag, ask::OpenIncident::heard(result), |state, view| {
            incidents::keys::changed(state, *deed, view);
        }),
        Tag::Evidence(_) => {
            done(state, tag, ask::ExportEvidence::heard(result), |state, view| evidence::written(state, &view))
        }
        Tag::Robot(name) => robot::answered(state, name, ask::ShowRobot::heard(result)),
        Tag::SetPolicy(robot, _) => policy_set(state, tag, robot, result),
        Tag::Watch(topic) => said(state, tag, ask::WatchTopic::heard(result), |()| format!("now watching {topic}")),
        Tag::Unwatch(topic) => {
            said(state, tag, ask::UnwatchTopic::heard(result), |()| format!("no longer watching {topic} (U: undo)"))
        }
        Tag::Limit(topic) => {
            said(state, tag, ask::WatchTopic::heard(result), |()| format!("the rule of {topic} is set"))
        }
        Tag::Foresee(_) => grant::answered(state, tag, ask::ForeseeGrant::heard(result)),
        Tag::Grant(_) => said(state, tag, ask::Grant::heard(result), |view| view.words(&times)),
        Tag::Extend(_) => said(state, tag, ask::ExtendGrant::heard(result), |view| view.words(&times)),
        Tag::Revoke(_) => said(state, tag, ask::Revoke::heard(result), |view| view.text),
        Tag::Rotate => said(state, tag, ask::RotateKeys::heard(result), |view| view.text),
        Tag::Administer(_) => said(state, tag, ask::Administer::heard(result), |view| view.text),
        Tag::Deploy => said(state, tag, ask::DeployContract::heard(result), |deployed| {
            format!("contract {} deployed", deployed.pin.contract)
        }),
        Tag::Pin(_) => said(state, tag, ask::PinTopic::heard(result), |_| is_done(tag)),
        Tag::Unpin(_) => said(state, tag, ask::UnpinTopic::heard(result), |_| is_done(tag)),
        Tag::Release(_) => said(state, tag, ask::ReleaseHeld::heard(result), |decided| decided.text),
        Tag::Discard(_) => said(state, tag, ask::DiscardHeld::heard(result), |decided| decided.text),
        Tag::LoadKey(kind) => key_loaded(state, tag, *kind, result),
    }
    follow_up(state, tag);
}

fn toggle_mouse(state: &mut State) {
    state.mouse = !state.mouse;
    let on = "mouse on; hold shift to select text in most terminals";
    let off = "mouse off; the terminal handles text selection again";
    state.inform(if state.mouse { on } else { off });
    state.effects.push(Effect::Mouse(state.mouse));
}
