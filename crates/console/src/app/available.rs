//! Whether a verb can be done now, and if not, why, in a few words.

#![deny(clippy::wildcard_enum_match_arm)]

use crate::app::{Feed, Screen, State, Tag, Verb, entry_of, verb::Given};
use crate::screens::{chain::state::Act, grants::state::is_active, grants::state::is_given, topics::state::robot_of};
use crate::service::reply::{IdentityView, TopicRow};

pub fn available(state: &State, verb: Verb) -> Result<(), &'static str> {
    let entry = entry_of(verb, state.screen).ok_or("unknown")?;
    if entry.changes && state.settings.read_only {
        return Err("read-only");
    }
    let asks_passphrase = matches!(verb, Verb::CreateIdentity | Verb::Unlock | Verb::LoadKey | Verb::ExportKey);
    if asks_passphrase && state.settings.operator.is_some() {
        return Err("only for the owner");
    }
    given(!is_bound(entry.given) || entry.works_on(state.screen), "other screen")?;
    match entry.given {
        Given::Always | Given::Here => Ok(()),
        Given::RowUnlessOn(screen) if screen == state.screen => Ok(()),
        Given::Row | Given::RowUnlessOn(_) => given(state.has_rows(), "nothing selected"),
        Given::Topic => one_topic(state).map(drop),
        Given::HeldTopic => given(one_topic(state)?.quarantined > 0, "nothing quarantined"),
        Given::WatchedTopic => given(!state.topics.watched_targets().is_empty(), "not watched: w watches it"),
        Given::TopicOfRobot => {
            let row = state.topics.selected().ok_or("nothing selected")?;
            given(robot_of(&row.topic).is_some(), "not a robot's topic")
        }
        Given::OwnRobot => own_robot(state),
        Given::EnrolledRobot => {
            identity(state)?;
            let none = state.feeds.slot(Feed::Robots).loaded && state.gateway.robots.is_empty();
            given(!none, "no robot is enrolled")
        }
        Given::ActiveGrant => {
            let row = state.grants.selected().ok_or("no grant selected")?;
            given(is_given(row), "not given by you")?;
            given(is_active(row), "not active")
        }
        Given::Alerts => given(!state.alerts.shown().is_empty(), "no alerts"),
        Given::Table => given(state.screen.has_table(), "no table here"),
        Given::Order => given(state.screen.sorts(), "nothing to sort here"),
        Given::Filter => {
            given(state.table().is_some_and(|table| !table.filter.text().is_empty()), "no filter; / sets one")
        }
        Given::Identity => identity(state).map(drop),
        Given::NoIdentity => {
            let identity = state.identity.as_ref().ok_or("site is starting")?;
            once(state, &Tag::CreateIdentity, identity.exists, "already exists")
        }
        Given::Locked => once(state, &Tag::Unlock, identity(state)?.unlocked, "already unlocked"),
        Given::Unlocked => once(state, &Tag::Lock, !identity(state)?.unlocked, "already locked"),
        Given::Unregistered => once(state, &Tag::Register, identity(state)?.registered, "already registered"),
        Given::Administrator(act) => administer(state, act),
        Given::Tour => given(state.tour.is_some(), "no tour: `authros tour` begins one"),
        Given::LastAct => given(state.last_act.is_some(), "nothing was done yet"),
        Given::Undoable => given(state.undo.is_some(), "nothing to undo"),
        Given::Copyable => given(copyable(state), "nothing to copy"),
    }
}

/// About rows of their own screens; such verbs work nowhere else.
fn is_bound(given: Given) -> bool {
    use Given::{ActiveGrant, Alerts, HeldTopic, Here, OwnRobot, Row, RowUnlessOn, Topic, TopicOfRobot, WatchedTopic};
    let of_rows = matches!(given, Row | RowUnlessOn(_) | ActiveGrant | OwnRobot);
    of_rows || matches!(given, Here | Alerts | Topic | HeldTopic | TopicOfRobot | WatchedTopic)
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
fn own_robot(state: &State) -> Result<(), &'static str> {
    let member = state.gateway.selected().ok_or("nothing selected")?;
    if member.robot.is_some() {
        return Ok(());
    }
    given(!state.is_locked(), "locked: u unlocks")?;
    Err("not a robot of this profile")
}

/// Refuses a folded robot's row.
fn one_topic(state: &State) -> Result<&TopicRow, &'static str> {
    let row = state.topics.selected().ok_or("nothing selected")?;
    given(state.topics.robot(&row.topic).is_none(), "a robot, not a topic: h unfolds it").map(|()| row)
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
