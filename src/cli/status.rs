//! `status`: the Overview screen for people and scripts.

use super::output::table;
use crate::service::reply::{HealthLevel, SiteView};

/// The site as lines.
pub fn text(view: &SiteView) -> String {
    let word = |level| match level {
        HealthLevel::Ok => "ok",
        HealthLevel::Waiting => "waiting",
        HealthLevel::Failed => "failed",
        HealthLevel::Absent => "absent",
    };
    let parts: Vec<Vec<String>> = view
        .health
        .iter()
        .map(|part| vec![part.part.clone(), word(part.level).to_owned(), part.text.clone()])
        .collect();
    let life = &view.life;
    let stations = [
        ("captured", life.captured),
        ("sealed", life.sealed),
        ("stored", life.stored),
        ("anchored", life.anchored),
        ("confirmed", life.confirmed),
        ("verified", life.verified),
        ("pending", life.pending),
        ("quarantined", life.quarantined),
        ("dropped", life.dropped),
        ("tampered", life.tampered),
        ("lost in transport", life.lost_in_transport),
    ];
    let counts: Vec<String> = stations.iter().map(|(name, count)| format!("{name} {count}")).collect();
    format!("{}\n\n{}", table(&["PART", "STATE", "ABOUT"], &parts), counts.join(", "))
}
