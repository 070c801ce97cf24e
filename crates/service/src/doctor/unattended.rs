//! Credentials of unattended capture: which stand, how long, and whether the home gives away more than they do.

use super::Sheet;
use crate::model::Timestamp;
use crate::paths::Home;
use crate::service::site::{NOTED, Noted};
use crate::store::snapshot;

/// How long before its end a loan is worth a word, nanoseconds.
const FAREWELL: u64 = 3 * 86_400 * 1_000_000_000;

/// The credentials that this home prepared and did not end.
pub(super) fn look(home: &Home, sheet: &mut Sheet) {
    if !home.ledger().exists() {
        return;
    }
    // An unreadable ledger is reported elsewhere.
    let Ok(lists) = snapshot::settings_beginning(&home.ledger(), NOTED) else { return };
    let lists = lists.iter().filter_map(|text| serde_json::from_str::<Vec<Noted>>(text).ok());
    let standing: Vec<Noted> = lists.filter_map(|list| list.into_iter().rfind(|noted| !noted.ended)).collect();
    for noted in &standing {
        let text = format!(
            "device {} captures {} topics unattended until {}, and account {} anchors them",
            noted.device,
            noted.topics.len(),
            noted.until,
            noted.account
        );
        if noted.until.0 < Timestamp::now().0.saturating_add(FAREWELL) {
            let advice = "lend to that device for longer with authros devices lend, or write another credential with authros \
                          unattended prepare";
            sheet.warn("unattended", &text, advice);
        } else {
            sheet.ok("unattended", &format!("{text}; authros unattended end recalls it"));
        }
    }
    let beside = home.profiles().into_iter().find(|profile| home.passphrase(profile).exists());
    if let Some(profile) = beside.filter(|_| !standing.is_empty()) {
        let text = format!(
            "the passphrase of '{profile}' is stored beside its keyring: anyone who reads the home has all its keys"
        );
        sheet.warn("unattended passphrase", &text, "move it to a safe place and give it with --passphrase-file");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Address, Domain, SignerId};
    use crate::service::reply::CheckStatus;
    use crate::store::Ledger;

    #[test]
    fn what_stands_is_listed_and_what_ends_soon_is_warned_of() {
        let folder = tempfile::tempdir().expect("a folder");
        let home = Home::new(folder.path().to_owned());
        let noted = |device: u8, days: u64, ended| Noted {
            device: SignerId([device; 32]),
            account: Address([device; 20]),
            domain: Domain([1; 32]),
            topics: vec!["/odom".to_owned()],
            until: Timestamp(Timestamp::now().0 + days * 86_400 * 1_000_000_000),
            ended,
        };
        let ledger = Ledger::open(&home.ledger()).expect("a ledger");
        for (account, list) in
            [("0xa1", [noted(1, 30, true), noted(2, 30, false)]), ("0xa2", [noted(3, 30, true), noted(4, 1, false)])]
        {
            let text = serde_json::to_string(&list).expect("JSON");
            ledger.put_setting(&format!("{NOTED}{account}"), &text).expect("written");
        }
        ledger.close().expect("closed");
        let mut sheet = Sheet::default();
        look(&home, &mut sheet);
        let mut found: Vec<_> = sheet.checks.iter().map(|check| (check.status, &check.detail)).collect();
        found.sort_by_key(|(_, detail)| detail.as_str().to_owned());
        let [(long, first), (short, second)] = &found[..] else { panic!("{:?}", sheet.checks) };
        assert!(*long == CheckStatus::Ok && first.contains("device 0202"), "{first}");
        assert!(*short == CheckStatus::Warn && second.contains("device 0404"), "{second}");
    }
}
