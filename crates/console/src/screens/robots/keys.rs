//! Which robots are asked for when, and the one under the cursor.

use crate::app::{Feed, Popup, Purpose, Screen, State};
use crate::model::{Timestamp, counted};
use crate::screens::{robots, robots::state::MOST_NAMES};
use crate::service::reply::RobotRow;

/// Nanoseconds between requests on the screen of robots, and elsewhere; only when records came meanwhile.
const ASKED_EVERY: u64 = 5_000_000_000;

const DRIFT_EVERY: u64 = 30_000_000_000;

/// The site knows robots' reports only with an open keyring.
pub fn is_open(state: &State) -> bool {
    state.identity.as_ref().is_some_and(|identity| identity.exists && identity.unlocked)
}

pub fn wanted(state: &State) -> Option<Feed> {
    let asks = |popup: &Popup| matches!(popup, Popup::Robot(_) | Popup::Form(Purpose::SetPolicy, _));
    let seen = matches!(state.screen, Screen::Overview | Screen::Robots) || state.popups.iter().any(asks);
    (is_open(state) && seen).then_some(Feed::Robots)
}

/// `None` = not before an event.
pub fn asked_at(state: &State) -> Option<Timestamp> {
    let slot = state.feeds.slot(Feed::Robots);
    let waits = slot.loaded && !slot.outstanding && !slot.stale && slot.failure.is_none();
    let moved = state.gateway.robots_told && !state.gateway.robots.is_empty() && !state.is_frozen();
    let every = if state.screen == Screen::Robots { ASKED_EVERY } else { DRIFT_EVERY };
    let due = Timestamp(state.gateway.robots_at.0.saturating_add(every));
    wanted(state).filter(|_| waits && moved).map(|_| due)
}

/// Forgets the robots of a locked keyring: they would grow old unnoticed.
pub fn forget_if_locked(state: &mut State) {
    if state.is_locked() && !state.is_frozen() && state.feeds.slot(Feed::Robots).loaded {
        state.feeds.renew(Feed::Robots);
        state.feeds.slot_mut(Feed::Robots).loaded = false;
        state.gateway.set_robots(Vec::new(), None, state.now);
    }
}

/// Drifting robots as an alert: since when, and in words.
pub fn drift(state: &State) -> Option<(Timestamp, String)> {
    let drifting: Vec<&RobotRow> = state.gateway.robots.iter().filter(|row| row.drift).collect();
    let since = drifting.iter().filter_map(|row| row.drift_since).min().unwrap_or(state.now);
    match drifting.as_slice() {
        [] => None,
        [one] => {
            Some((since, format!("robot {} is out of date: {} (8, then enter)", one.name, robots::state::words(one))))
        }
        several => {
            let names: Vec<String> = several.iter().take(MOST_NAMES).map(|row| row.name.to_string()).collect();
            let more = several.len().saturating_sub(MOST_NAMES);
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            let robots = counted(several.len() as u64, "robot");
            Some((since, format!("{robots} do not run their policies: {}{more} (8)", names.join(", "))))
        }
    }
}

pub fn under_cursor(state: &State) -> Option<&RobotRow> {
    state.gateway.selected().filter(|_| state.screen == Screen::Robots)?.robot
}

/// The name, or the device id if another robot has the name too.
pub fn called(state: &State, row: &RobotRow) -> String {
    let alone = state.gateway.robots.iter().filter(|other| other.name == row.name).count() <= 1;
    if alone { row.name.to_string() } else { row.device.to_hex() }
}
