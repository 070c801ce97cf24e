//! Ciphertext altered in the store behind the program's back: all of it is found, and none of it is shown.

use rusqlite::{Connection, params};
use serde_json::Value;

use super::field::{Load, ODOM};
use crate::support::{text, unhex};

/// Bytes before, those of another record, and what becomes of them; nothing = deleted.
type Way = fn(Vec<u8>, &[u8]) -> Option<Vec<u8>>;

const WAYS: [(&str, Way); 6] = [
    ("flipped", |mut bytes, _| {
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        Some(bytes)
    }),
    ("swapped", |_, other| Some(other.to_vec())),
    ("truncated", |mut bytes, _| {
        bytes.truncate(bytes.len() - 17);
        Some(bytes)
    }),
    ("emptied", |_, _| Some(Vec::new())),
    ("lengthened", |bytes, _| Some([&bytes[..], b"x"].concat())),
    ("deleted", |_, _| None),
];

#[test]
fn every_alteration_is_found_and_no_plaintext_is_shown() {
    let load = Load::start(&[], &[], &[]);
    load.authros.capture(&[ODOM], 2 * WAYS.len() as u64);
    let records = load.authros.records(&["records", "list", "--oldest"]);
    let store = Connection::open(load.home.path().join("ledger.db")).expect("opens");
    store.busy_timeout(std::time::Duration::from_secs(30)).expect("set");
    let bytes_of = |record: &Value| -> Vec<u8> {
        let sql = "SELECT ciphertext.bytes FROM ciphertext JOIN records ON n = record WHERE digest = ?1";
        store.query_row(sql, [unhex(&text(record, "digest"))], |row| row.get(0)).expect("stored")
    };
    for (pair, (way, alter)) in records.chunks(2).zip(WAYS) {
        let [one, other] = pair else { panic!("two records each") };
        let place = "WHERE record = (SELECT n FROM records WHERE digest = ?1)";
        let digest = unhex(&text(one, "digest"));
        let changed = match alter(bytes_of(one), &bytes_of(other)) {
            Some(bytes) => store.execute(&format!("UPDATE ciphertext SET bytes = ?2 {place}"), params![digest, bytes]),
            None => store.execute(&format!("DELETE FROM ciphertext {place}"), [digest]),
        };
        assert_eq!(changed, Ok(1), "{way}");
        let id = text(one, "id");
        let check = load.authros.with(&["--json"]).run(&["records", "check", &id]).expect_code(6);
        let expected = if way == "deleted" { "missing" } else { "tampered" };
        assert_eq!(check.document()["verdict"], expected, "{way}: {check}");
        let open = load.authros.with(&["--json"]).run(&["records", "open", &id]).expect_code(6);
        let document = open.document();
        assert!(document["message"].is_null() && document["fields"].is_null(), "{way}: {open}");
        assert!(!open.stdout.contains("position"), "{way}: {open}");
        load.authros.run(&["records", "check", &text(other, "id")]).expect_code(0);
    }
    load.end();
}
