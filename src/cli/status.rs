//! `authros status`: health of the site's parts and where the profile's records stand.

use crate::service::reply::{HealthLevel, LifeLine, SiteView};

/// The site at a glance.
pub fn text(view: &SiteView) -> String {
    let mut lines: Vec<String> = view
        .health
        .iter()
        .map(|part| {
            let word = match part.level {
                HealthLevel::Ok => "ok",
                HealthLevel::Waiting => "waiting",
                HealthLevel::Failed => "failed",
                HealthLevel::Absent => "absent",
            };
            format!("{:<9} {word:<8} {}", part.part, part.text)
        })
        .collect();
    lines.extend(life(&view.life));
    lines.join("\n")
}

fn life(life: &LifeLine) -> Vec<String> {
    let LifeLine { captured, verified, pending, quarantined, dropped, tampered, .. } = *life;
    let sum = format!(
        "captured {captured} = verified {verified} + pending {pending} + quarantined {quarantined} + dropped {dropped} \
         + tampered {tampered}"
    );
    let verdict = if life.conserved { "it adds up" } else { "IT DOES NOT ADD UP: run `authros audit verify`" };
    let lost = format!(
        "lost in transport {}, in the recorder {}, discarded {}; waiting in memory {}; deleted by retention {}",
        life.lost_in_transport, life.lost_in_recorder, life.discarded, life.waiting, life.deleted
    );
    vec![format!("{sum}: {verdict}"), lost]
}
