//! How many keys the main jobs take, beyond the values that are typed. A job that takes more is a step back.

use super::*;
use crate::service::KeyKind;

/// Someone who counts the keys pressed.
struct Counter {
    robot: Robot,
    keys: usize,
    exists: bool,
}

impl Counter {
    fn at_work() -> Self {
        Self::with(Robot::at_work(true), true)
    }

    /// Whether an identity exists is what the site answers.
    fn with(robot: Robot, exists: bool) -> Self {
        Self { robot, keys: 0, exists }
    }

    /// Presses keys; the site answers what its screens ask for.
    fn presses(&mut self, keys: &[Key]) -> &mut Self {
        for key in keys {
            self.robot.presses(*key);
            self.robot.site_answers(self.exists);
            self.keys += 1;
        }
        self
    }

    fn letters(&mut self, keys: &str) -> &mut Self {
        let keys: Vec<Key> = keys.chars().map(Key::Char).collect();
        self.presses(&keys)
    }

    /// Types a value, which does not count.
    fn types(&mut self, value: &str) -> &mut Self {
        self.robot.types(value);
        self.robot.site_answers(self.exists);
        self
    }

    /// The number of keys after which this is under way.
    fn reaches(&self, tag: &Tag) -> usize {
        assert!(self.robot.work().contains(tag), "{tag:?} is not under way, but {:?}", self.robot.work());
        self.keys
    }
}

fn newest() -> String {
    fixtures::record(1_000, "").id
}

#[test]
fn a_topic_is_granted_till_a_date_with_six_keys_from_its_row_and_four_from_anywhere() {
    let grant = Tag::Grant("harbour-office".parse().expect("a party"));
    let mut counter = Counter::at_work();
    counter.robot.types("2");
    counter.robot.site_answers(true);
    counter.robot.types("jj");
    counter.letters("g").types("harbour-office").presses(&[Key::Enter, Key::Enter]).types("30d");
    let keys = counter.presses(&[Key::Enter, Key::Enter]).letters("y").reaches(&grant);
    assert_eq!(keys, 6);
    let mut counter = Counter::at_work();
    counter.letters(":").types("grant harbour-office /robot1/odom 30d");
    let keys = counter.presses(&[Key::Enter, Key::Enter]).letters("y").reaches(&grant);
    assert_eq!(keys, 4);
}

#[test]
fn revoking_reading_checking_and_exporting_take_three_keys_at_most() {
    let revoked = Tag::Revoke(fixtures::OTHER);
    assert_eq!(Counter::at_work().letters("5xy").reaches(&revoked), 3);
    assert_eq!(Counter::at_work().letters("3").presses(&[Key::Enter]).reaches(&Tag::Show(newest())), 2);
    assert_eq!(Counter::at_work().letters("4").presses(&[Key::Enter]).reaches(&Tag::Open(newest())), 2);
    assert_eq!(Counter::at_work().letters("3c").reaches(&Tag::Check(newest())), 2);
    assert_eq!(Counter::at_work().letters("3e").presses(&[Key::Enter]).reaches(&Tag::Export(newest())), 3);
    let mut counter = Counter::at_work();
    assert!(matches!(counter.letters("5i").robot.state.popups.last(), Some(Popup::Readers(_))));
    assert_eq!(counter.keys, 2);
}

#[test]
fn a_picture_of_a_given_topic_takes_four_keys_and_an_unlock_at_the_start_one() {
    let mut counter = Counter::at_work();
    counter.letters("4/").types("camera");
    assert_eq!(counter.presses(&[Key::Enter, Key::Enter]).reaches(&Tag::Open(newest())), 4);
    let mut robot = Robot::opens(Settings { asks_passphrase: true, ..Settings::default() });
    let tag = Tag::Feed(crate::app::Feed::Identity, 0);
    robot.is_answered(&tag, Ok(Reply::Identity(fixtures::identity(true, false, true))));
    let mut counter = Counter::with(robot, true);
    assert_eq!(counter.types("correct horse").presses(&[Key::Enter]).reaches(&Tag::Unlock), 1);
}

#[test]
fn a_key_file_is_loaded_with_six_keys_and_a_first_topic_watched_with_three() {
    let mut counter = Counter::at_work();
    counter.letters("6L").presses(&[Key::Enter]).types("k_c.hex");
    let keys = counter.presses(&[Key::Enter, Key::Enter]).letters("y").reaches(&Tag::LoadKey(KeyKind::Sm4));
    assert_eq!(keys, 6);
    let mut counter = Counter::with(Robot::at_work(false), false);
    counter.robot.types("2");
    counter.robot.site_answers(false);
    counter.robot.presses(Key::Down);
    counter.letters("w").types("correct horse").presses(&[Key::Enter]).types("correct horse");
    assert_eq!(counter.presses(&[Key::Enter]).reaches(&Tag::CreateIdentity), 3);
}
