//! What an operator should look at, from the data on hand.

use super::state::State;
use crate::service::NoticeLevel;
use crate::service::reply::{HealthLevel, LifeLine, PartHealth};

/// The most notices repeated as alerts.
const MOST_NOTICES: usize = 3;

/// All alerts, the worst first.
pub fn alerts(state: &State) -> Vec<(NoticeLevel, String)> {
    let mut found = Vec::new();
    if let Some(site) = &state.site {
        found.extend(site.health.iter().filter_map(health));
        found.extend(life(&site.life));
    }
    if let Some(identity) = state.identity.as_ref().filter(|identity| identity.exists) {
        if !identity.unlocked {
            found.push((NoticeLevel::Warning, "the keyring is locked: u unlocks it".to_owned()));
        } else if !identity.registered {
            found.push((NoticeLevel::Warning, "not registered on this chain: 6, then R registers".to_owned()));
        }
    }
    found.extend(state.log.urgent(MOST_NOTICES).into_iter().map(|line| {
        let at = line.at.clock();
        (line.level, format!("{at} {}", line.text))
    }));
    found.sort_by_key(|(level, _)| std::cmp::Reverse(*level));
    found
}

fn health(part: &PartHealth) -> Option<(NoticeLevel, String)> {
    let text = format!("{}: {}", part.part, part.text);
    match part.level {
        HealthLevel::Ok | HealthLevel::Absent => None,
        HealthLevel::Waiting => Some((NoticeLevel::Warning, text)),
        HealthLevel::Failed => Some((NoticeLevel::Error, text)),
    }
}

fn life(life: &LifeLine) -> Vec<(NoticeLevel, String)> {
    let counted = [
        (life.tampered, NoticeLevel::Error, "tampered: not the bytes that were anchored (3, then / tampered)"),
        (life.quarantined, NoticeLevel::Warning, "quarantined: sent by a node that is not the pinned publisher"),
        (
            life.dropped.saturating_sub(life.discarded),
            NoticeLevel::Warning,
            "dropped by the recorder before they were sealed; gap records tell of them",
        ),
        (life.lost_in_transport, NoticeLevel::Warning, "lost in transport, before they arrived here"),
    ];
    let seen = counted.into_iter().filter(|(count, ..)| *count > 0);
    seen.map(|(count, level, what)| (level, format!("{count} {what}"))).collect()
}
