//! What an operator should look at, from the data on hand.

use super::screens::grants::{is_active, is_given};
use super::standing::not_captured;
use super::state::State;
use crate::model::Timestamp;
use crate::service::NoticeLevel;
use crate::service::reply::{GrantRow, HealthLevel, LifeLine, PartHealth};

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
            let off = not_captured(state).map_or_else(String::new, |what| format!(": {what}"));
            found.push((NoticeLevel::Warning, format!("locked{off}; u unlocks")));
        } else if let Some(what) = not_captured(state) {
            found.push((NoticeLevel::Warning, what));
        } else if !identity.registered {
            found.push((NoticeLevel::Warning, "not registered on this chain: 6, then R registers".to_owned()));
        }
    }
    found.extend(state.grants.rows.iter().filter_map(|row| expiring(row, state.now)));
    found.extend(state.log.urgent(MOST_NOTICES).into_iter().map(|line| {
        let at = line.at.clock();
        (line.level, format!("{at} {}", line.text))
    }));
    found.sort_by_key(|(level, _)| std::cmp::Reverse(*level));
    found
}

/// A grant given that ends within three days.
fn expiring(row: &GrantRow, now: Timestamp) -> Option<(NoticeLevel, String)> {
    const SOON: u64 = 3 * 86_400 * 1_000_000_000;
    let ends = row.expires.filter(|_| is_given(row) && is_active(row))?;
    let left = ends.0.checked_sub(now.0).filter(|left| *left < SOON)? / 1_000_000_000;
    let who = row.name.clone().unwrap_or_else(|| row.grantee.short());
    let when = match left {
        0..3_600 => format!("{} min", left / 60),
        3_600..86_400 => format!("{} h", left / 3_600),
        _ => format!("{} d", left / 86_400),
    };
    Some((NoticeLevel::Info, format!("the grant to {who} ends in {when}: a new epoch begins then (5)")))
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
        (life.right_ended, NoticeLevel::Warning, "right ended: restore the account or renew the loan and they resume"),
        (life.quarantined, NoticeLevel::Warning, "quarantined: sent by a node that is not the pinned publisher"),
        (
            life.dropped.saturating_sub(life.discarded),
            NoticeLevel::Warning,
            "dropped by the recorder before they were sealed; gap records count them",
        ),
        (life.lost_in_transport, NoticeLevel::Warning, "lost in transport, before they were captured"),
    ];
    let seen = counted.into_iter().filter(|(count, ..)| *count > 0);
    seen.map(|(count, level, what)| (level, format!("{count} {what}"))).collect()
}
