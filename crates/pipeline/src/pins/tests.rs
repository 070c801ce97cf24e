//! Who is pinned, who is doubted, and what is reported about it.

use std::path::Path;
use std::time::Duration;

use super::super::fixture::Notes;
use super::*;
use crate::ros::Rival;
use crate::store::AuditQuery;
use proptest::prelude::*;

const OWNER: Address = Address([1; 20]);
const MD5: &str = "992ce8a1687cec8c8bd883ec73ca41d1";

struct Desk {
    pins: Pins,
    notes: Arc<Notes>,
    ledger: Ledger,
    numbers: std::cell::Cell<u64>,
}

impl Desk {
    fn open(home: &Path, mode: PinMode, listed: &str) -> Self {
        let ledger = Ledger::open(&home.join("ledger.db")).expect("opens");
        let notes = Arc::new(Notes::default());
        let rules = PinRules { mode, listed: listed.parse().expect("a list") };
        let pins = Pins::new(&ledger, Arc::clone(&notes) as _, rules);
        pins.introduce(OWNER, "alice");
        Self { pins, notes, ledger, numbers: std::cell::Cell::new(0) }
    }

    /// A publisher that the master has just listed.
    fn origin(&self, caller_id: &str, host: &str) -> Origin {
        self.numbers.set(self.numbers.get() + 1);
        Origin {
            number: self.numbers.get(),
            caller_id: caller_id.into(),
            host: host.into(),
            uri: format!("http://{host}:{}/", self.numbers.get()),
            type_name: "std_msgs/String".into(),
            md5sum: MD5.into(),
            listed_at: Instant::now(),
            rival: None,
            unnamed: false,
        }
    }

    fn judge(&self, topic: &str, origin: &Origin) -> Option<Doubt> {
        let first = self.pins.judge(OWNER, topic, &Arc::new(origin.clone()));
        assert_eq!(self.pins.judge(OWNER, topic, &Arc::new(origin.clone())), first, "the same again");
        first
    }

    fn alarms(&self) -> usize {
        self.notes.all().iter().filter(|(urgent, text)| *urgent && text.contains("NODE FORGING?")).count()
    }

    fn audited(&self, action: &str) -> usize {
        let all = AuditQuery { limit: 1000, ..AuditQuery::default() };
        let lines = self.pins.audit.list(&all).expect("lines");
        lines.iter().filter(|line| line.entry.action == action && line.entry.profile == "alice").count()
    }
}

fn after(origin: Origin, rival: &Origin) -> Origin {
    Origin { rival: Some(Rival { number: rival.number, uri: rival.uri.clone() }), ..origin }
}

#[test]
fn the_first_set_is_pinned_and_told_and_others_are_doubted_once() {
    let home = tempfile::tempdir().expect("folder");
    let desk = Desk::open(home.path(), PinMode::First, "");
    let (left, right) = (desk.origin("/left", "h"), desk.origin("/right", "h"));
    assert_eq!(desk.judge("/t", &left), None);
    assert_eq!(desk.judge("/t", &right), None, "it was listed before the first one was pinned");
    assert_eq!((desk.notes.with("(first seen): messages from others are quarantined"), desk.alarms()), (2, 0));
    std::thread::sleep(Duration::from_millis(2));
    let late = desk.origin("/late", "h");
    assert_eq!(desk.judge("/t", &late), Some(Doubt::New));
    assert_eq!(desk.judge("/t", &desk.origin("/left", "elsewhere")), Some(Doubt::Host));
    assert_eq!(desk.judge("/t", &Origin { type_name: "a/B".into(), ..desk.origin("/left", "h") }), Some(Doubt::Type));
    assert_eq!(
        desk.judge("/t", &Origin { md5sum: "0".repeat(32).into(), ..desk.origin("/left", "h") }),
        Some(Doubt::Type)
    );
    assert_eq!((desk.alarms(), desk.audited("node forging"), desk.audited("pin on first use")), (4, 4, 2));
    // Gone and back: no second alarm, and the pinned one continues.
    assert_eq!(desk.judge("/t", &desk.origin("/late", "h")), Some(Doubt::New));
    assert_eq!(desk.judge("/t", &desk.origin("/left", "h")), None);
    assert_eq!((desk.alarms(), desk.audited("node forging")), (4, 4));
    assert_eq!(desk.judge("/other", &desk.origin("/late", "h")), None, "each topic by itself");
}

#[test]
fn pins_outlive_the_process_and_an_emptied_topic_has_no_second_first_use() {
    let home = tempfile::tempdir().expect("folder");
    let desk = Desk::open(home.path(), PinMode::First, "");
    assert_eq!(desk.judge("/t", &desk.origin("/a", "h")), None);
    drop(desk);
    let desk = Desk::open(home.path(), PinMode::First, "");
    assert_eq!(desk.judge("/t", &desk.origin("/b", "h")), Some(Doubt::New));
    let kept = desk.origin("/a", "h");
    assert_eq!(desk.judge("/t", &kept), None);
    assert_eq!(desk.pins.unpin(OWNER, "/t", "/a"), Ok(1));
    assert_eq!(desk.judge("/t", &kept), Some(Doubt::New));
    let b = publisher_of(&desk.origin("/b", "h"));
    desk.pins.pin(OWNER, "/t", &[b]).expect("pinned");
    assert_eq!((desk.judge("/t", &desk.origin("/b", "h")), desk.judge("/t", &kept)), (None, Some(Doubt::New)));
}

#[test]
fn a_restart_is_accepted_and_a_replacement_is_not_until_the_operator_says_so() {
    let home = tempfile::tempdir().expect("folder");
    let desk = Desk::open(home.path(), PinMode::First, "");
    let first = desk.origin("/a", "h");
    assert_eq!(desk.judge("/t", &first), None);
    let restarted = desk.origin("/a", "h");
    assert_eq!(desk.judge("/t", &restarted), None);
    let forged = after(desk.origin("/a", "h"), &restarted);
    assert_eq!(desk.judge("/t", &forged), Some(Doubt::Replaced));
    assert_eq!((desk.alarms(), desk.judge("/t", &restarted)), (1, None));
    // Nobody can tell the next one from either, in this process or a later one.
    assert_eq!(desk.judge("/t", &desk.origin("/a", "h")), Some(Doubt::Undecided));
    desk.ledger.pins.close_alarms(OWNER, "/t").expect("closed");
    drop(desk);
    let desk = Desk::open(home.path(), PinMode::First, "");
    let next = desk.origin("/a", "h");
    assert_eq!(desk.judge("/t", &next), Some(Doubt::Undecided));
    let forged = after(desk.origin("/a", "h"), &desk.origin("/a", "h"));
    assert_eq!(desk.judge("/t", &forged), Some(Doubt::Replaced));
    desk.pins.pin(OWNER, "/t", &[publisher_of(&next)]).expect("accepted");
    assert_eq!((desk.judge("/t", &next), desk.judge("/t", &forged)), (None, None));
    let again = after(desk.origin("/a", "h"), &next);
    assert_eq!(desk.judge("/t", &again), Some(Doubt::Replaced), "accepting is about what was there");
}

#[test]
fn a_doubted_one_cannot_taint_the_pinned_one() {
    let home = tempfile::tempdir().expect("folder");
    let desk = Desk::open(home.path(), PinMode::First, "");
    assert_eq!(desk.judge("/t", &desk.origin("/a", "h")), None);
    let elsewhere = desk.origin("/a", "evil");
    assert_eq!(desk.judge("/t", &elsewhere), Some(Doubt::Host));
    // The robot's own node comes back while the other one is still there.
    assert_eq!(desk.judge("/t", &after(desk.origin("/a", "h"), &elsewhere)), None);
}

#[test]
fn what_happened_before_anybody_watched_does_not_spoil_the_first_use() {
    let home = tempfile::tempdir().expect("folder");
    let desk = Desk::open(home.path(), PinMode::First, "");
    let gone = desk.origin("/a", "h");
    assert_eq!(desk.judge("/t", &after(desk.origin("/a", "h"), &gone)), None);
    // But of two that are there now, the one that came second is not pinned.
    let elder = desk.origin("/b", "h");
    let (name, live) = (Arc::<str>::from("/u"), Arc::new(elder.clone()));
    desk.pins.connected(&name, &live);
    let younger = after(desk.origin("/b", "h"), &elder);
    assert_eq!((desk.judge("/u", &younger), desk.judge("/u", &elder)), (Some(Doubt::New), None));
    assert_eq!(desk.pins.live("/u"), [publisher_of(&elder)]);
    desk.pins.lost(elder.number);
    assert_eq!(desk.pins.live("/u"), []);
}

#[test]
fn a_publisher_without_a_name_is_not_pinned_and_its_name_is_no_other_publisher() {
    let home = tempfile::tempdir().expect("folder");
    let desk = Desk::open(home.path(), PinMode::First, "");
    let pinned = || {
        let rows = desk.ledger.pins.list(OWNER, Some("/t")).expect("read").into_iter();
        rows.map(|row| row.publisher.caller_id).collect::<Vec<_>>()
    };
    let unnamed = Origin { unnamed: true, ..desk.origin("/unnamed_fastdds", "h") };
    assert_eq!((desk.judge("/t", &unnamed), pinned().len()), (None, 0));
    let named = Origin { caller_id: "/talker".into(), unnamed: false, ..unnamed.clone() };
    assert_eq!((desk.judge("/t", &named), pinned()), (None, vec!["/talker".to_owned()]));
    assert_eq!(desk.judge("/t", &Origin { unnamed: true, ..desk.origin("/unnamed_fastdds", "h") }), Some(Doubt::New));
    // One that was pinned under no name, because nothing announced names: the pin goes with the name.
    let plain = desk.origin("/unnamed_fastdds", "h");
    assert_eq!(desk.judge("/u", &plain), None);
    let named = Origin { caller_id: "/talker".into(), ..plain.clone() };
    assert_eq!(desk.judge("/u", &named), None);
    let rows = desk.ledger.pins.list(OWNER, Some("/u")).expect("read");
    assert_eq!(rows.iter().map(|row| row.publisher.caller_id.as_str()).collect::<Vec<_>>(), ["/talker"]);
    assert_eq!(desk.judge("/u", &desk.origin("/unnamed_fastdds", "h")), Some(Doubt::New), "another writer");
    assert_eq!(desk.alarms(), 2);
}

#[test]
fn every_run_of_an_anonymous_node_is_the_pinned_one() {
    let home = tempfile::tempdir().expect("folder");
    let desk = Desk::open(home.path(), PinMode::First, "");
    assert_eq!(desk.judge("/t", &desk.origin("/talker_1609459200123456789", "h")), None);
    assert_eq!(desk.notes.with("/talker_# on h (# is any number: it draws one at each start)"), 1);
    std::thread::sleep(Duration::from_millis(2));
    let again = desk.origin("/talker_1609459300123456789", "h");
    assert_eq!((desk.judge("/t", &again), desk.alarms()), (None, 0));
    let beside = after(desk.origin("/talker_1609459400123456789", "h"), &again);
    assert_eq!(desk.judge("/t", &beside), Some(Doubt::Replaced));
    assert_eq!(desk.judge("/t", &desk.origin("/other_1609459400123456789", "h")), Some(Doubt::New));
    assert_eq!(desk.judge("/t", &desk.origin("/talker_1609459500123456789", "elsewhere")), Some(Doubt::Host));
    assert_eq!(desk.pins.unpin(OWNER, "/t", "/talker_1609459300123456789"), Ok(1));
}

#[test]
fn lists_and_off() {
    let home = tempfile::tempdir().expect("folder");
    let listed = format!("/t=/a@h:std_msgs/String:{MD5}");
    let desk = Desk::open(home.path(), PinMode::List, &listed);
    assert_eq!(desk.judge("/t", &desk.origin("/a", "h")), None);
    assert_eq!(desk.judge("/t", &desk.origin("/b", "h")), Some(Doubt::New));
    assert_eq!(desk.judge("/unlisted", &desk.origin("/a", "h")), Some(Doubt::New));
    drop(desk);
    let desk = Desk::open(home.path(), PinMode::First, &listed);
    assert_eq!(desk.judge("/t", &desk.origin("/b", "h")), Some(Doubt::New), "the list comes before the first use");
    drop(desk);
    let desk = Desk::open(home.path(), PinMode::Off, &listed);
    assert_eq!(desk.judge("/t", &desk.origin("/c", "h")), None);
    desk.pins.unconfirmed(OWNER, "/t", "http://evil:1/");
    assert_eq!((desk.alarms(), desk.ledger.pins.list(OWNER, None)), (0, Ok(Vec::new())));
}

#[test]
fn a_name_that_the_master_does_not_list_is_an_alarm() {
    let home = tempfile::tempdir().expect("folder");
    let desk = Desk::open(home.path(), PinMode::First, "");
    for _ in 0..3 {
        desk.pins.unconfirmed(OWNER, "/t", "http://evil:1/\u{1b}[2J");
    }
    assert_eq!((desk.alarms(), desk.audited("node forging")), (1, 1));
    assert_eq!(desk.notes.with("\u{1b}"), 0);
    assert_eq!(desk.judge("/t", &desk.origin("/a", "h")), None, "it does not use up the first use");
}

#[test]
fn a_flood_of_names_is_neither_a_flood_of_words_nor_of_rows() {
    let home = tempfile::tempdir().expect("folder");
    let desk = Desk::open(home.path(), PinMode::First, "");
    assert_eq!(desk.judge("/t", &desk.origin("/a", "h")), None);
    for number in 0..200 {
        assert_eq!(desk.judge("/t", &desk.origin(&format!("/n{number}"), "h")), Some(Doubt::New));
    }
    assert_eq!(desk.alarms(), MOST_ALARMS + 1);
    assert_eq!(desk.ledger.pins.alarms(OWNER, None).expect("read").len(), MOST_ALARMS + 1);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// Whatever comes, only publishers that were there at first, or were pinned, are ever trusted.
    #[test]
    fn nobody_unpinned_is_trusted(claims in prop::collection::vec((0u8..4, 0u8..3, any::<bool>(), any::<bool>()), 1..40)) {
        let home = tempfile::tempdir().expect("folder");
        let desk = Desk::open(home.path(), PinMode::First, "");
        let pinned = desk.origin("/n0", "h0");
        prop_assert_eq!(desk.judge("/t", &pinned), None);
        std::thread::sleep(Duration::from_millis(2));
        let mut replaced = false;
        let mut last = pinned;
        for (name, host, same_type, overlaps) in claims {
            let mut origin = desk.origin(&format!("/n{name}"), &format!("h{host}"));
            if !same_type {
                origin.type_name = "a/B".into();
            }
            let overlaps = overlaps && *origin.caller_id == *last.caller_id;
            let origin = if overlaps { after(origin, &last) } else { origin };
            let same = (name, host, same_type) == (0, 0, true);
            let doubt = desk.judge("/t", &origin);
            prop_assert_eq!(doubt.is_none(), same && !overlaps && !replaced, "{:?} {:?}", origin, doubt);
            replaced |= doubt == Some(Doubt::Replaced);
            if doubt.is_none() {
                last = origin;
            }
        }
    }
}
