//! Robots enrolled by an earlier version: they hold the index key, which a thief could keep.

use super::Sheet;
use crate::crypto::SealedEnrolment;
use crate::crypto::enrolment::version_of;
use crate::paths::Home;
use crate::service::site::Enrolled;
use crate::store::snapshot;

/// Robots enrolled by this home's profiles, and the one that works here.
pub(super) fn look(home: &Home, sheet: &mut Sheet) {
    if home.ledger().exists() {
        enrolled(home, sheet);
    }
    let kept = SealedEnrolment::kept_in(home.root());
    if version_of(&kept) == Some(1) {
        let text = "this home's robot was enrolled by an earlier version: its enrolment contains its owner's index key";
        sheet.warn("enrolment", text, "ask its owner to enrol it again with --topic, then use a new --home for it");
    }
}

fn enrolled(home: &Home, sheet: &mut Sheet) {
    // An unreadable ledger is reported elsewhere.
    let Ok(lists) = snapshot::settings_beginning(&home.ledger(), "enrolled:") else { return };
    let robots: Vec<Enrolled> =
        lists.iter().filter_map(|text| serde_json::from_str::<Vec<_>>(text).ok()).flatten().collect();
    let elder: Vec<&str> =
        robots.iter().filter(|robot| robot.version == 1 && !robot.ended).map(|robot| robot.name.as_str()).collect();
    if elder.is_empty() {
        return;
    }
    let text = format!(
        "enrolled by an earlier version, with the index key in their files: {}; they keep working, but anyone who \
         steals one can keep recognising your topics, types and tags",
        elder.join(", ")
    );
    sheet.warn(
        "robots",
        &text,
        "enrol them again with authros agent enrol --topic ..., then recall the old ones with authros devices recall",
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::SignerId;
    use crate::service::reply::CheckStatus;
    use crate::store::{Ledger, atomic_write};

    fn robot(name: &str, version: u8, ended: bool) -> Enrolled {
        let (name, device) = (name.parse().expect("a name"), SignerId([version; 32]));
        Enrolled { name, device, topics: Vec::new(), version, ended, key: None, gateway: None }
    }

    #[test]
    fn enrolments_of_an_earlier_version_are_named_until_they_are_recalled() {
        let folder = tempfile::tempdir().expect("a folder");
        let home = Home::new(folder.path().to_owned());
        let robots = [robot("scout-1", 1, false), robot("scout-2", 2, false), robot("scout-3", 1, true)];
        let ledger = Ledger::open(&home.ledger()).expect("a ledger");
        let text = serde_json::to_string(&robots).expect("JSON");
        ledger.put_setting("enrolled:0xa1", &text).expect("written");
        ledger.close().expect("closed");
        let mut sheet = Sheet::default();
        look(&home, &mut sheet);
        let [found] = &sheet.checks[..] else { panic!("one line: {:?}", sheet.checks) };
        assert_eq!((found.name.as_str(), found.status), ("robots", CheckStatus::Warn));
        assert!(found.detail.contains("in their files: scout-1; they keep working"), "{}", found.detail);
        assert!(found.advice.contains("agent enrol") && found.advice.contains("devices recall"), "{}", found.advice);

        // On the robot itself: its enrolment states its version in clear.
        for (version, told) in [(2, 0), (1, 1)] {
            let kept = [&b"\x89AuthEnr"[..], &[version], &[0; 200]].concat();
            atomic_write(&SealedEnrolment::kept_in(home.root()), &kept).expect("written");
            let mut sheet = Sheet::default();
            look(&home, &mut sheet);
            let of_this: Vec<_> = sheet.checks.iter().filter(|check| check.name == "enrolment").collect();
            assert_eq!(of_this.len(), told, "version {version}: {:?}", sheet.checks);
        }
    }
}
