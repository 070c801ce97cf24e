//! Robots that were enrolled by an earlier version: they hold the index key, which a thief keeps.

use super::Sheet;
use crate::crypto::SealedEnrolment;
use crate::crypto::enrolment::version_of;
use crate::paths::Home;
use crate::service::site::Enrolled;
use crate::store::snapshot;

/// Those that this home's profiles have enrolled, and the one that works here.
pub(super) fn look(home: &Home, sheet: &mut Sheet) {
    if home.ledger().exists() {
        enrolled(home, sheet);
    }
    let kept = SealedEnrolment::kept_in(home.root());
    if version_of(&kept) == Some(1) {
        let text =
            "the robot of this home was enrolled by an earlier version: its enrolment holds the index key of its owner";
        sheet.warn("enrolment", text, "have its owner enrol it again with --topic, then use a new --home for it");
    }
}

fn enrolled(home: &Home, sheet: &mut Sheet) {
    // A ledger that cannot be read is told of elsewhere.
    let Ok(lists) = snapshot::settings_beginning(&home.ledger(), "enrolled:") else { return };
    let robots: Vec<Enrolled> =
        lists.iter().filter_map(|text| serde_json::from_str::<Vec<_>>(text).ok()).flatten().collect();
    let elder: Vec<&str> =
        robots.iter().filter(|robot| robot.version == 1 && !robot.ended).map(|robot| robot.name.as_str()).collect();
    if elder.is_empty() {
        return;
    }
    let text = format!(
        "enrolled by an earlier version, with the index key in their files: {}; they go on, but who steals one goes on \
         recognising your topics, types and tags",
        elder.join(", ")
    );
    sheet.warn(
        "robots",
        &text,
        "enrol them again: authros agent enrol --topic ..., then authros devices recall the old one",
    );
}
