//! Shell completion: read beside a running site and without one, and nothing is left beside the file.

use super::*;
use crate::ledger::query::Glance;
use crate::notes::AddressBook;

fn files(home: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(home).expect("a folder").flatten();
    let mut names: Vec<String> = entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn names_and_ids_are_found_with_a_site_at_work_and_without() {
    let home = tempfile::tempdir().expect("temporary directory");
    let path = home.path().join("led ger?#%.db");
    let ledger = Ledger::open(&path).expect("opens");
    let records: Vec<NewRecord> = (1..=3).map(|topic| record(1, topic, 7)).collect();
    ledger.records.append(records.clone()).expect("acknowledged");
    ledger.notes.write(&AddressBook {}, &Vec::new()).expect("kept");
    let look = || {
        let glance = Glance::at(&path).expect("opens");
        let id: String = records[1].digest.to_hex().chars().take(16).collect();
        assert_eq!(
            glance.topics("/robot", 9),
            Ok(["/robot1/odom", "/robot2/odom", "/robot3/odom"].map(str::to_owned).to_vec())
        );
        assert_eq!(glance.topics("/robot2", 9), Ok(vec!["/robot2/odom".to_owned()]));
        assert_eq!(glance.topics("", 1).expect("read").len(), 1);
        assert_eq!(glance.ids(&id[..6].to_ascii_uppercase(), 9), Ok(vec![id]));
        assert_eq!(glance.ids("", 2).expect("read").len(), 2);
        assert_eq!((glance.ids("zz", 9), glance.ids(&"0".repeat(65), 9)), (Ok(Vec::new()), Ok(Vec::new())));
        assert_eq!(glance.note(&AddressBook {}), Ok(Some(Vec::new())));
    };
    look();
    ledger.close().expect("closed");
    let before = files(home.path());
    look();
    assert_eq!(files(home.path()), before, "nothing is made by looking");
    assert!(Glance::at(&home.path().join("none.db")).is_err());
    assert_eq!(files(home.path()), before);
}
