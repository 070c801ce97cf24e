//! Whether a verb can be done now, and if not, why, in a few words.

#![deny(clippy::wildcard_enum_match_arm)]

use super::administration::Act;
use super::screens::{is_active, is_given, robot_of};
use super::update::Feed;
use super::verb::{Tag, Verb, entry_of};
use super::{Screen, State, limiting};
use crate::service::reply::IdentityView;

pub fn available(state: &State, verb: Verb) -> Result<(), &'static str> {
    let entry = entry_of(verb, state.screen).ok_or("unknown")?;
    if entry.changes && state.settings.read_only {
        return Err("read-only");
    }
    let asks_passphrase = matches!(verb, Verb::CreateIdentity | Verb::Unlock | Verb::LoadKey | Verb::ExportKey);
    if asks_passphrase && state.settings.operator.is_some() {
        return Err("only for the owner");
    }
    given(!is_bound(verb) || entry.works_on(state.screen), "other screen")?;
    match verb {
        Verb::Watch if state.screen == Screen::Overview => Ok(()),
        Verb::CreateIdentity => {
            let identity = state.identity.as_ref().ok_or("site is starting")?;
            once(state, &Tag::CreateIdentity, identity.exists, "already exists")
        }
        Verb::Unlock => once(state, &Tag::Unlock, identity(state)?.unlocked, "already unlocked"),
        Verb::Register => once(state, &Tag::Register, identity(state)?.registered, "already registered"),
        Verb::LoadKey | Verb::ExportKey | Verb::Rotate => identity(state).map(drop),
        Verb::Revoke | Verb::Extend => revoke(state),
        Verb::Filter | Verb::Up | Verb::Down | Verb::PageUp | Verb::PageDown | Verb::First | Verb::Last => {
            given(state.screen.has_table(), "no table here")
        }
        Verb::NextMatch | Verb::PreviousMatch => {
            given(state.table().is_some_and(|table| !table.filter.text().is_empty()), "no filter; / sets one")
        }
        Verb::Sort | Verb::Reverse => given(state.screen.sorts(), "nothing to sort here"),
        Verb::Mark | Verb::MarkAll | Verb::Watch | Verb::Details | Verb::Open | Verb::Check | Verb::Export => {
            given(state.has_rows(), "nothing selected")
        }
        // Without any grant the answer is: nobody else.
        Verb::Readers if state.screen == Screen::Grants => Ok(()),
        Verb::Read | Verb::Readers | Verb::Play => given(state.has_rows(), "nothing selected"),
        Verb::Publishers | Verb::Pin | Verb::Unpin => one_topic(state),
        Verb::Limit => given(!limiting::targets(state).is_empty(), "not watched: w watches it"),
        Verb::Fold => {
            let row = state.topics.selected().ok_or("nothing selected")?;
            given(robot_of(&row.topic).is_some(), "not a robot's topic")
        }
        Verb::Inspect => inspect(state),
        Verb::SetPolicy => policy(state),
        Verb::EndTour => given(state.tour.is_some(), "no tour: `authros tour` begins one"),
        Verb::Release | Verb::Discard => held(state),
        Verb::BackUp | Verb::Incident | Verb::Incidents => identity(state).map(drop),
        Verb::Lock => once(state, &Tag::Lock, !identity(state)?.unlocked, "already locked"),
        Verb::CopyCommand => given(state.last_act.is_some(), "nothing was done yet"),
        Verb::Alerts => given(!state.alerts.shown().is_empty(), "no alerts"),
        Verb::Undo => given(state.undo.is_some(), "nothing to undo"),
        Verb::Administer(act) => administer(state, act),
        Verb::Copy | Verb::WriteFile => given(copyable(state), "nothing to copy"),
        Verb::Go(_) | Verb::NextScreen | Verb::PreviousScreen | Verb::Grant | Verb::Tasks | Verb::LocalTime => Ok(()),
        Verb::Freeze | Verb::Palette | Verb::Help | Verb::Dismiss | Verb::ChooseTheme | Verb::Ascii => Ok(()),
        Verb::Mouse | Verb::Redraw | Verb::Suspend | Verb::Quit | Verb::Contacts | Verb::Profile => Ok(()),
        Verb::Browse | Verb::Period | Verb::FoldAll | Verb::Columns | Verb::Level | Verb::Source => Ok(()),
    }
}

/// Verbs about rows of their own screens, which work nowhere else.
fn is_bound(verb: Verb) -> bool {
    use Verb::{
        Browse, Check, Columns, Details, Discard, Export, Extend, Fold, FoldAll, Inspect, Level, Limit, Mark, MarkAll,
    };
    use Verb::{Open, Period, Pin, Play, Publishers, Read, Readers, Release, Revoke, Source, Unpin, Watch};
    let of_rows = matches!(verb, Mark | MarkAll | Watch | Details | Open | Check | Export | Readers | Browse | Play);
    let of_topics = matches!(verb, Publishers | Pin | Unpin | Limit | Release | Discard | Fold | FoldAll | Columns);
    of_rows || of_topics || matches!(verb, Verb::Alerts | Inspect | Period | Level | Source | Read | Revoke | Extend)
}

fn given(condition: bool, reason: &'static str) -> Result<(), &'static str> {
    if condition { Ok(()) } else { Err(reason) }
}

fn copyable(state: &State) -> bool {
    match state.screen {
        Screen::Keys => state.address().is_some(),
        Screen::Chain => state.chain.as_ref().is_some_and(|chain| chain.contract.is_some()),
        Screen::Robots => state.gateway.view.as_ref().is_some_and(|view| view.served.is_some()),
        Screen::Overview | Screen::Topics | Screen::Records | Screen::Received | Screen::Grants => state.has_rows(),
        Screen::Log => state.has_rows(),
    }
}

fn identity(state: &State) -> Result<&IdentityView, &'static str> {
    let identity = state.identity.as_ref().ok_or("site is starting")?;
    given(identity.exists, "no identity yet").map(|()| identity)
}

fn once(state: &State, tag: &Tag, done: bool, already: &'static str) -> Result<(), &'static str> {
    given(!done, already)?;
    given(!state.work.contains(tag), "under way")
}

/// Only the profile's own robots have a window.
fn inspect(state: &State) -> Result<(), &'static str> {
    let member = state.gateway.selected().ok_or("nothing selected")?;
    if member.robot.is_some() {
        return Ok(());
    }
    given(!state.is_locked(), "locked: u unlocks")?;
    Err("not a robot of this profile")
}

fn policy(state: &State) -> Result<(), &'static str> {
    identity(state)?;
    let none = state.feeds.slot(Feed::Robots).loaded && state.gateway.robots.is_empty();
    given(!none, "no robot is enrolled")
}

/// Refuses a folded robot's row.
fn one_topic(state: &State) -> Result<(), &'static str> {
    let row = state.topics.selected().ok_or("nothing selected")?;
    given(state.topics.robot(&row.topic).is_none(), "a robot, not a topic: h unfolds it")
}

fn held(state: &State) -> Result<(), &'static str> {
    one_topic(state)?;
    let row = state.topics.selected().ok_or("nothing selected")?;
    given(row.quarantined > 0, "nothing quarantined")
}

fn administer(state: &State, act: Act) -> Result<(), &'static str> {
    let chain = state.chain.as_ref().ok_or("open the Chain screen first (7)")?;
    let own = state.address();
    if act == Act::Deploy {
        return given(chain.contract.is_none(), "already deployed");
    }
    if act == Act::Accept {
        return given(own.is_some() && chain.administration.nominee == own, "you are not nominated");
    }
    given(own.is_some() && chain.administration.administrator == own, "you are not the administrator")
}

fn revoke(state: &State) -> Result<(), &'static str> {
    let row = state.grants.selected().ok_or("no grant selected")?;
    given(is_given(row), "not given by you")?;
    given(is_active(row), "not active")
}
