use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use proptest::prelude::*;

use super::{Cabinet, Schedule, *};
use crate::gateway::hello::Context;
use crate::gateway::session::SessionId;
use crate::gateway::tests::{context, pair};

const DAY: Duration = Duration::from_secs(86_400);

fn day(number: u64) -> Timestamp {
    Timestamp::from_seconds(2_000_000_000 + number * 86_400)
}

fn list(identity: &SmKeyPair) -> SystemKeyList {
    let key = |byte, from| SystemKey { public: pair(byte).public, not_before: day(from), not_after: day(from + 7) };
    let keys = vec![key(0x51, 0), key(0x52, 7)];
    SystemKeyList::sign(context(), identity, 9, (day(0), day(14)), keys).expect("signs")
}

fn agreed(identity: &SmKeyPair, list: &SystemKeyList) -> Agreed {
    Agreed {
        gateway: signer_id(&identity.public),
        gateway_key: identity.public,
        client_nonce: [0; 32],
        gateway_nonce: [0; 32],
        session: SessionId([0; 16]),
        list: list.summary(context().provider),
    }
}

fn checked(list: &SystemKeyList, agreed: &Agreed, now: Timestamp) -> Result<SystemKey, GatewayError> {
    list.check(context(), agreed, now)
}

#[test]
fn the_key_in_use_follows_the_clock_and_the_list_expires() {
    let identity = pair(0x21);
    let list = list(&identity);
    let agreed = agreed(&identity, &list);
    assert_eq!(SystemKeyList::parse(&list.encode()), Ok(list.clone()));
    assert_eq!(checked(&list, &agreed, day(0)).expect("current"), list.keys[0]);
    assert_eq!(checked(&list, &agreed, day(7)).expect("next"), list.keys[1]);
    assert!(matches!(checked(&list, &agreed, day(14)), Err(GatewayError::List(why)) if why.contains("expired")));
    let before = Timestamp(day(0).0 - 1);
    assert!(matches!(checked(&list, &agreed, before), Err(GatewayError::List(why)) if why.contains("currently valid")));
}

#[test]
fn lists_of_other_gateways_networks_and_versions_are_refused() {
    let (identity, other) = (pair(0x21), pair(0x31));
    let ours = list(&identity);
    let meant = agreed(&identity, &ours);
    let refused =
        |list: &SystemKeyList, agreed: &Agreed| checked(list, agreed, day(1)).expect_err("refused").to_string();
    let theirs = list(&other);
    assert!(refused(&theirs, &meant).contains("another gateway"));
    let away = Context { domain: Domain([9; 32]), ..context() };
    assert!(ours.check(away, &meant, day(1)).is_err());
    let stale = Agreed { list: ListSummary { version: 10, ..meant.list }, ..meant };
    assert!(refused(&ours, &stale).contains("announced"));
    // Signed by another key, but announced as if it were the gateway's.
    let mut forged = theirs.clone();
    forged.gateway = meant.gateway;
    let announced = Agreed { list: forged.summary(context().provider), ..meant };
    assert!(matches!(checked(&forged, &announced, day(1)), Err(GatewayError::Crypto(_))));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn no_bit_of_a_list_can_be_changed(at: usize, bit in 0u8..8) {
        let identity = pair(0x21);
        let list = list(&identity);
        let mut bytes = list.encode();
        let at = at % bytes.len();
        prop_assert!(SystemKeyList::parse(&bytes[..at]).is_err());
        bytes[at] ^= 1 << bit;
        if let Ok(altered) = SystemKeyList::parse(&bytes) {
            // Even if the hello announced the altered one.
            prop_assert!(checked(&altered, &agreed(&identity, &altered), day(1)).is_err());
        }
    }

    #[test]
    fn garbage_never_panics(noise in proptest::collection::vec(any::<u8>(), 0..500)) {
        prop_assert!(SystemKeyList::parse(&noise).is_err());
    }
}

fn open(home: &std::path::Path, now: Timestamp) -> Cabinet {
    let schedule = Schedule { lifetime: 7 * DAY, grace: DAY };
    Cabinet::open(home, context(), pair(0x21), schedule, now).expect("opens")
}

fn key_files(home: &std::path::Path) -> Vec<std::path::PathBuf> {
    let names = fs::read_dir(home).expect("lists").map(|entry| entry.expect("entry").path());
    let mut found: Vec<_> = names.filter(|path| path.to_string_lossy().contains("system-")).collect();
    found.retain(|path| path.extension().is_some_and(|extension| extension == "key"));
    found.sort();
    found
}

#[test]
fn keys_rotate_on_schedule_and_retired_secrets_are_erased() {
    let home = tempfile::tempdir().expect("directory");
    let path = home.path().join("gateway");
    let mut cabinet = open(&path, day(0));
    let [first, second] = [0, 1].map(|index| cabinet.kept().list.keys[index]);
    let version = cabinet.kept().list.version;
    assert_eq!(cabinet.next_rotation(), day(7));
    assert!(!cabinet.rotate(day(6)).expect("nothing to do").published);

    let rotation = cabinet.rotate(day(7)).expect("rotates");
    assert!(rotation.published && rotation.erased == 0);
    assert_eq!(cabinet.kept().list.keys[0], second, "the next one is the current one");
    assert!(cabinet.kept().list.version > version);
    assert!(cabinet.kept().secret(&first.id(), day(7), DAY).is_some(), "within its grace");
    assert_eq!((key_files(&path).len(), cabinet.next_rotation()), (3, day(8)));
    assert!(cabinet.kept().secret(&first.id(), day(8), DAY).is_none(), "after its grace, erased or not");
    assert_eq!(cabinet.rotate(day(8)).expect("erases").erased, 1);
    assert_eq!(key_files(&path).len(), 2);
    assert!(cabinet.kept().secret(&second.id(), day(8), DAY).is_some());

    // Down for a year: both keys expired, both are replaced, none survives.
    let old = key_files(&path);
    let (identity, version) = (cabinet.identity().public, cabinet.kept().list.version);
    drop(cabinet);
    let cabinet = open(&path, day(365));
    assert_eq!(cabinet.identity().public, identity, "the identity stays");
    assert!(cabinet.kept().list.version > version);
    let new = key_files(&path);
    assert!(new.len() == 2 && new.iter().all(|path| !old.contains(path)), "{new:?}");
}

#[test]
fn a_restored_gateway_is_not_taken_for_one_that_was_rolled_back() {
    let home = tempfile::tempdir().expect("directory");
    let path = home.path().join("gateway");
    drop(open(&path, day(0)));
    let backup: Vec<_> = fs::read_dir(&path)
        .expect("lists")
        .map(|entry| entry.expect("entry").path())
        .map(|file| (fs::read(&file).expect("reads"), file))
        .collect();
    // The list clients have seen.
    let mut later = open(&path, day(6));
    later.rotate(day(7)).expect("rotates");
    let seen = later.kept().list.version;
    drop(later);
    for entry in fs::read_dir(&path).expect("lists") {
        fs::remove_file(entry.expect("entry").path()).expect("removes");
    }
    for (bytes, file) in backup {
        crate::crypto::private_file::write_private(&file, &bytes).expect("restores");
    }
    assert!(open(&path, day(8)).kept().list.version > seen);
}

#[test]
fn files_are_private_and_strays_and_damage_are_noticed() {
    let home = tempfile::tempdir().expect("directory");
    let path = home.path().join("gateway");
    let cabinet = open(&path, day(0));
    let listed = cabinet.kept().list.clone();
    for entry in fs::read_dir(&path).expect("lists") {
        let mode = entry.expect("entry").metadata().expect("there").permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
    }
    let stray = path.join("system-00.key");
    crate::crypto::private_file::write_private(&stray, &[5; 32]).expect("writes");
    drop(cabinet);
    let again = open(&path, day(1));
    assert_eq!(again.kept().list.keys, listed.keys, "the same keys after a restart");
    assert_eq!(again.kept().list.version, day(1).seconds(), "under a version that no older list can have");
    drop(again);
    assert!(open(&path, day(0)).kept().list.version > day(1).seconds(), "also with a clock that was put back");
    assert!(!stray.exists(), "a key that no list names is erased");

    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).expect("chmod");
    let again = || Cabinet::open(&path, context(), pair(0x21), Schedule::default(), day(1));
    assert!(again().err().is_some_and(|error| error.to_string().contains("chmod 700")));
    fs::set_permissions(&path, fs::Permissions::from_mode(0o700)).expect("chmod");
    let file = path.join("system-keys.list");
    let mut bytes = fs::read(&file).expect("reads");
    bytes[80] ^= 1;
    fs::write(&file, bytes).expect("writes");
    assert!(again().is_err(), "a list that the identity did not sign");
    let other = Cabinet::open(&path, context(), pair(0x31), Schedule::default(), day(1));
    assert!(other.is_err(), "another identity does not take the list over");
}

/// What several workers have, and one worker's view of it.
#[derive(Clone, Default)]
struct Together {
    all: Arc<Mutex<Option<Kept>>>,
    seen: Option<Kept>,
}

impl Shelf for Together {
    fn read(&mut self) -> Result<Option<Kept>, GatewayError> {
        self.seen = self.all.lock().expect("not poisoned").clone();
        Ok(self.seen.clone())
    }

    fn write(&mut self, kept: &Kept) -> Result<bool, GatewayError> {
        let mut all = self.all.lock().expect("not poisoned");
        let is_first = *all == self.seen;
        if is_first {
            *all = Some(kept.clone());
            self.seen.clone_from(&all);
        }
        Ok(is_first)
    }

    fn is_shared(&self) -> bool {
        true
    }
}

fn worker(together: &Together, now: Timestamp) -> Cabinet {
    let (schedule, shelf) = (Schedule { lifetime: 7 * DAY, grace: DAY }, Box::new(together.clone()));
    Cabinet::on(shelf, context(), pair(0x21), schedule, now).expect("opens")
}

#[test]
fn workers_show_the_newest_list_and_open_what_each_of_them_offered() {
    let together = Together::default();
    let mut first = worker(&together, day(0));
    let mut second = worker(&together, day(1));
    assert_eq!(first.kept().list.keys, second.kept().list.keys, "the same keys");
    assert!(second.kept().list.version > first.kept().list.version);
    assert_eq!(first.rotate(day(1)).expect("reads"), Rotation::default());
    assert_eq!(first.kept(), second.kept(), "before it shows a list, it has the newest");

    assert!(second.rotate(day(7)).expect("rotates").published);
    assert!(!first.rotate(day(7)).expect("reads").published, "one worker makes the list");
    assert_eq!(first.kept(), second.kept());
    assert!(first.kept().keys.len() == 3, "a retired key, too, opens at each of them");
    assert_eq!(first.rotate(day(8)).expect("erases").erased, 1);
    assert_eq!(together.all.lock().expect("not poisoned").as_ref().map(|kept| kept.keys.len()), Some(2));
}

#[test]
fn of_two_workers_that_rotate_at_once_one_makes_the_list() {
    let together = Together::default();
    let (mut first, mut second) = (worker(&together, day(0)), worker(&together, day(0)));
    first.load().expect("reads");
    second.load().expect("reads");
    assert!(second.settle(day(7), false).expect("rotates").published);
    assert!(!first.settle(day(7), false).expect("reads again").published, "what it read is not there any more");
    assert_eq!(first.kept(), second.kept());
}

#[test]
fn after_a_database_was_restored_no_older_list_is_shown() {
    let together = Together::default();
    let mut first = worker(&together, day(0));
    let before = together.all.lock().expect("not poisoned").clone();
    first.rotate(day(7)).expect("rotates");
    let shown = first.kept().list.version;
    *together.all.lock().expect("not poisoned") = before;
    assert!(first.rotate(day(7)).expect("publishes").published);
    assert!(first.kept().list.version > shown, "{shown}");
    let list = together.all.lock().expect("not poisoned").clone().expect("a list").list;
    assert_eq!(list, first.kept().list);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]
    #[test]
    fn what_workers_share_has_one_encoding(noise in proptest::collection::vec(any::<u8>(), 0..200), at: usize, bit in 0u8..8) {
        let kept = worker(&Together::default(), day(0)).kept().clone();
        let (list, secrets) = (kept.list.encode(), kept.secrets());
        prop_assert_eq!(Kept::parse(&list, &secrets), Ok(kept));
        prop_assert!(Kept::parse(&list, &noise).is_err(), "without the listed keys");
        let mut altered = secrets.to_vec();
        let at = at % altered.len();
        altered[at] ^= 1 << bit;
        if let Ok(parsed) = Kept::parse(&list, &altered) {
            prop_assert_eq!(&parsed.secrets()[..], &altered[..]);
        }
    }
}

impl Cabinet {
    /// When [`Self::rotate`] next has something to do.
    fn next_rotation(&self) -> Timestamp {
        let Kept { list, keys } = &self.kept;
        let current = list.keys.first().map_or(Timestamp(0), |key| key.not_after);
        let retired = keys.iter().filter(|(key, _)| !list.keys.contains(key));
        let erase = retired.map(|(key, _)| after(key.not_after, self.schedule.grace)).min();
        erase.map_or(current, |erase| erase.min(current))
    }
}
