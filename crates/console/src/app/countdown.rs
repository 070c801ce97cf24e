//! Seconds until the next attempt at a part of the site that is not well: the site says them once, time takes them away.

use super::state::State;
use crate::model::Timestamp;
use crate::service::reply::PartHealth;

/// Nanoseconds.
const SECOND: u64 = 1_000_000_000;
/// The words before the seconds.
const BEGINS: &str = "retry in ";

/// When a countdown on screen goes on; `None` = there is none.
pub fn moves_at(state: &State) -> Option<Timestamp> {
    let parts = state.site.iter().flat_map(|site| &site.health);
    let gone = gone(state);
    let goes_on = parts.filter_map(|part| part.retry).any(|seconds| seconds > gone + 1);
    (goes_on && !state.is_frozen()).then(|| Timestamp(state.site_at.0.saturating_add((gone + 1) * SECOND)))
}

/// Says the seconds that are left now. The last one stays until the site says what came of the attempt.
pub fn tick(state: &mut State) {
    let gone = gone(state);
    if state.is_frozen() {
        return;
    }
    for part in state.site.iter_mut().flat_map(|site| &mut site.health) {
        if let Some(text) = said(part, gone) {
            part.text = text;
        }
    }
}

fn said(part: &PartHealth, gone: u64) -> Option<String> {
    let (seconds, after) = (part.retry?, part.text.strip_prefix(BEGINS)?.split_once(' ')?.1);
    Some(format!("{BEGINS}{} {after}", seconds.saturating_sub(gone).max(1)))
}

/// Whole seconds since the site said it.
fn gone(state: &State) -> u64 {
    state.now.0.saturating_sub(state.site_at.0) / SECOND
}
