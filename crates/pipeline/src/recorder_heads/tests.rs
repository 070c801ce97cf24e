//! A recorder states its birth and its numbers while they change, and names its predecessor.

use std::path::Path;

use super::*;
use crate::crypto::merkle::root_of;
use crate::model::TopicId;
use crate::pipeline::Owner;
use crate::pipeline::tests::{body_of, owner_with_keys, plant};
use crate::store::RecordQuery;

const NOW: Duration = Duration::ZERO;

struct Home {
    plant: Plant,
    owner: Owner,
}

impl Home {
    fn at(home: &Path) -> Self {
        let plant = plant(home);
        let (owner, _) = owner_with_keys(plant.provider, home);
        Self { plant, owner }
    }

    fn keys(&self) -> std::sync::Arc<EpochKeys> {
        self.owner.sealing().expect("keys")
    }

    fn state(&self, every: Duration) -> Option<Digest> {
        state(&self.plant, self.owner.address, &self.keys(), every, &mut None).expect("stated")
    }

    fn say(&self, topic: &str) {
        let said = Statement { kind: RecordKind::Data, topic, type_name: "std_msgs/String", body: b"said" };
        statement::state(&self.plant, self.owner.address, &self.keys(), said).expect("kept").expect("covered");
    }

    /// Types and bodies of the recorder's statements, oldest first.
    fn told(&self) -> Vec<(String, Vec<u8>, Digest)> {
        let query = RecordQuery { topic: Some(TOPIC.to_owned()), ..RecordQuery::default() };
        let rows = self.plant.ledger.records.list(&query).expect("listed").rows;
        let read = |row: &crate::store::RecordRow| {
            let blob = self.plant.ciphertext.get(row.digest).expect("read").expect("stored");
            (row.type_name.clone(), body_of(self.plant.provider, &self.keys(), row, &blob), row.digest)
        };
        let mut rows: Vec<_> = rows;
        rows.sort_by_key(|row| row.seq);
        rows.iter().map(read).collect()
    }
}

#[test]
fn numbers_are_stated_when_they_changed_and_it_is_time_and_the_birth_comes_first() {
    let folder = tempfile::tempdir().expect("a folder");
    let home = Home::at(folder.path());
    assert_eq!(home.state(NOW), None, "nothing was recorded");
    (0..3).for_each(|_| home.say("/odom"));
    home.say("/scan");
    assert_eq!(home.state(NOW), None, "the first look only begins the time");
    assert_eq!(home.state(Duration::from_secs(3600)), None, "it is not time");
    let first = home.state(NOW).expect("stated");
    assert_eq!(home.state(NOW), None, "nothing has changed: its own records do not count");
    home.say("/odom");
    let second = home.state(NOW).expect("stated again");
    let told = home.told();
    let types: Vec<&str> = told.iter().map(|(type_name, ..)| type_name.as_str()).collect();
    assert_eq!(types, [Birth::TYPE, Heights::TYPE, Heads::TYPE, Heights::TYPE, Heads::TYPE]);
    assert_eq!(Birth::parse(&told[0].1), Ok(Birth { predecessor: None }));
    let (heights, heads) = (Heights::parse(&told[3].1).expect("a list"), Heads::parse(&told[4].1).expect("a head"));
    assert_eq!((told[2].2, told[4].2), (first, second));
    assert_eq!((heads.count, heads.heights, heads.previous), (2, told[3].2, first));
    let keys = home.keys();
    let id = |name: &str| keys.topic(name).expect("covered").id;
    let mut expected: Vec<(TopicId, u64)> = vec![(id("/odom"), 4), (id("/scan"), 1)];
    expected.sort_unstable();
    assert_eq!(heights.topics, expected);
    for (at, (topic, number)) in expected.iter().enumerate() {
        let path = tree(&heights).expect("a tree").path(at);
        assert_eq!(root_of(height_hash(topic, *number), at as u64, 2, &path), Some(heads.root));
        assert_ne!(root_of(height_hash(topic, number + 1), at as u64, 2, &path), Some(heads.root));
    }
}

#[test]
fn what_was_just_looked_at_waits_and_a_note_from_the_future_does_not() {
    let folder = tempfile::tempdir().expect("a folder");
    let home = Home::at(folder.path());
    home.say("/odom");
    let ledger = &home.plant.ledger;
    let note = noted(&home.plant, home.owner.address, &home.keys());
    let hour = Duration::from_secs(3600);
    let ahead = Timestamp(Timestamp::now().0 + 1_000_000 * 3_600_000_000);
    let before = StatedRoot { looked: ahead, root: Hash([0; 32]), heads: None };
    ledger.notes.write(&note, &before).expect("noted");
    let mut seen = None;
    let mut look = || state(&home.plant, home.owner.address, &home.keys(), hour, &mut seen).expect("stated");
    assert!(look().is_some(), "the clock ran ahead when the note was written");
    home.say("/odom");
    ledger.notes.write(&note, &before).expect("noted");
    assert_eq!(look(), None, "it was looked at just now");
    let unchanged = home.state(NOW).expect("the second number");
    let noted = ledger.notes.read(&note).expect("read");
    assert_eq!(home.state(NOW), None, "nothing has changed after {unchanged}");
    assert_eq!(ledger.notes.read(&note).expect("read"), noted, "and nothing is written");
}

#[test]
fn a_restored_ledger_has_a_recorder_that_names_the_one_it_follows() {
    let folder = tempfile::tempdir().expect("a folder");
    let home = Home::at(folder.path());
    let before = home.plant.ledger.records.recorder().of_signer(&home.keys().signer);
    home.say("/odom");
    home.state(NOW);
    home.state(NOW).expect("stated");
    let Home { plant: copied, owner } = home;
    copied.ledger.close().expect("closed");
    crate::store::snapshot::renew_ledger(&folder.path().join("ledger.db")).expect("a copy's ledger");
    let home = Home { plant: plant(folder.path()), owner };
    assert_ne!(home.plant.ledger.records.recorder().of_signer(&home.keys().signer), before);
    assert_eq!(home.state(NOW), None, "it recorded nothing yet");
    home.say("/odom");
    home.state(NOW);
    home.state(NOW).expect("stated by the new one");
    let births: Vec<_> = home.told().into_iter().filter(|(type_name, ..)| type_name == Birth::TYPE).collect();
    let named: Vec<_> = births.iter().map(|(_, body, _)| Birth::parse(body).expect("a birth").predecessor).collect();
    assert!(named.contains(&None) && named.contains(&Some(before)), "{named:?}");
}
