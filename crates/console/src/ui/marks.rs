//! Marks and colours of levels and states.

use crate::model::RecordState;
use crate::service::NoticeLevel;
use crate::service::reply::{Caveat, HealthLevel, PartHealth, ShownState};
use crate::ui::theme::Role;

pub fn level(part: &PartHealth) -> (&'static str, Role, &str) {
    match part.level {
        HealthLevel::Ok => ("●", Role::Good, "ok"),
        HealthLevel::Waiting => ("◐", Role::Warning, &part.text),
        // `retry in 4 s: why`: the header has room for the first half.
        HealthLevel::Failed if part.text.starts_with("retry in") => {
            ("✖", Role::Bad, part.text.split(':').next().unwrap_or("failed"))
        }
        HealthLevel::Failed => ("✖", Role::Bad, "failed"),
        HealthLevel::Absent => ("○", Role::Dim, "absent"),
    }
}

pub fn notice_level(level: NoticeLevel) -> (&'static str, Role) {
    match level {
        NoticeLevel::Info => ("› ", Role::Accent),
        NoticeLevel::Warning => ("◐ ", Role::Warning),
        NoticeLevel::Error => ("✖ ", Role::Bad),
    }
}

pub fn state_role(state: ShownState) -> Role {
    match state {
        ShownState::Kept(RecordState::Verified) | ShownState::Verified(Caveat::NamesUnchecked) => Role::Good,
        ShownState::Kept(RecordState::Tampered) | ShownState::Refused(_) => Role::Bad,
        ShownState::Kept(RecordState::Quarantined | RecordState::Dropped | RecordState::RightEnded) => Role::Warning,
        ShownState::Kept(_) | ShownState::Verified(Caveat::Deleted | Caveat::Unread) => Role::Accent,
    }
}

/// A mark without colour: the colour of warnings is for what is wrong.
pub fn simulated(simulated: bool) -> (String, Role) {
    (if simulated { "SIMULATED".to_owned() } else { String::new() }, Role::Dim)
}
