//! Someone who can write to a home's files wants a record to appear as captured on another day, and to be shown as
//! verified: the ledger's column is edited while the site is down, the record and its signature are untouched.

use serde_json::Value;

use crate::Outcome;
use crate::support::{Home, is_verified, list, text};

const DAY: u64 = 86_400_000_000_000;

/// The capture time that a document shows as verified, if it does.
fn verified_time(document: &Value) -> Option<String> {
    let verified = is_verified(document) && (document["verdict"].is_null() || document["verdict"] == "verified");
    verified.then(|| document["captured_at"].to_string())
}

#[test]
fn show_an_edited_time() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]);
    authros.enrol();
    authros.capture(&["/robot1/odom"], 1);
    let record = authros.records(&["records", "list", "--oldest"]).remove(0);
    let (id, real) = (text(&record, "id"), record["captured_at"].to_string());
    let ledger = rusqlite::Connection::open(home.path().join("ledger.db")).expect("the ledger opens");
    let changed = ledger
        .execute(
            "UPDATE records SET captured_at = captured_at - ?1 WHERE lower(hex(digest)) LIKE ?2",
            rusqlite::params![i64::try_from(DAY).expect("fits"), format!("{id}%")],
        )
        .expect("edited");
    assert_eq!(changed, 1, "one row is edited");
    drop(ledger);

    let json = authros.with(&["--json"]);
    let opened = json.run(&["records", "open", &id]);
    let shown = json.run(&["records", "show", &id]).document();
    let listed = list(&json.run(&["records", "list", "--oldest"]).document(), "records").remove(0);
    let recording = home.root().join("out.mcap");
    let exported = json.run(&["bag", "export", "--mcap", recording.to_str().expect("UTF-8")]).document();
    let audited = authros.run(&["audit"]);
    let mut false_faces = Vec::new();
    let opened_document = opened.document();
    for (face, document) in [("records open", &opened_document), ("records show", &shown), ("records list", &listed)] {
        if verified_time(document).is_some_and(|time| time != real) {
            false_faces.push(face);
        }
    }
    if exported["messages"].as_u64().is_some_and(|messages| messages > 0) {
        false_faces.push("bag export");
    }
    if audited.code == Some(0) {
        false_faces.push("audit");
    }
    let outcome = match false_faces.as_slice() {
        [] if opened.code == Some(6) && audited.code == Some(6) => {
            Outcome::Refused(opened_document["error"]["message"].to_string())
        }
        [] => Outcome::Otherwise(format!("{opened}\n{audited}")),
        faces => Outcome::Succeeded(format!("the edited time passes {}", faces.join(", "))),
    };
    crate::judge("show_an_edited_time", outcome);
}
