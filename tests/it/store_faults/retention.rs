//! Ciphertext that no rule keeps any longer: named on the chain, then deleted; digest, signature and proof stay.

use authros::model::Digest;
use authros::store::{Ciphertext, Ledger};
use serde_json::Value;

use super::field::{CAMERA, Load, ODOM};
use crate::support::{count, text, wait_until};

/// Bytes of pictures that are kept.
const BUDGET: u64 = 300 * 1024;

fn kept_bytes(records: &[Value]) -> u64 {
    records.iter().filter(|record| record["state"] != "deleted").map(|record| count(record, "bytes")).sum()
}

#[test]
fn what_no_rule_keeps_is_named_on_the_chain_and_deleted_and_what_is_missing_besides_is_an_alarm() {
    let rules = [("AUTHROS_RETENTION", "/robot1/odom=1d, /robot1/camera/**=300KiB")];
    let own = "[[topic]]\nmatch = \"/robot?/odom\"\nretention = \"2s\"\n";
    let load = Load::start_with(own, &[], &rules, &[ODOM, CAMERA]);
    load.until("ciphertext is deleted", 90, |life| count(life, "deleted") >= 30);
    let life = load.settle(&[ODOM, CAMERA]);
    assert_eq!(count(&life, "dropped"), 0, "{life}");
    let of = |topic| load.authros.records(&["records", "list", "--oldest", "--topic", topic]);
    let odometry = wait_until(60, "all odometry is deleted", || {
        let records = of(ODOM);
        records.iter().all(|record| record["state"] == "deleted").then_some(records)
    });
    let pictures = wait_until(60, "the budget of pictures is kept", || {
        let records = of(CAMERA);
        (kept_bytes(&records) <= BUDGET).then_some(records)
    });
    assert!(kept_bytes(&pictures) > BUDGET / 2, "no more than that is deleted");

    let id = text(&odometry[odometry.len() / 2], "id");
    assert_eq!(load.authros.json(&["records", "check", &id])["verdict"], "deleted");
    let refused = load.authros.run(&["records", "open", &id]).expect_code(5);
    assert!(refused.stderr.contains("deleted by retention"), "{refused}");
    let steps = load.authros.json(&["records", "show", &id])["steps"].to_string();
    assert!(steps.contains("named in retention record") && steps.contains("signature"), "{steps}");
    let told: Vec<Value> = load
        .authros
        .records(&["records", "list", "--oldest", "--kind", "retention", "--state", "verified"])
        .iter()
        .map(|report| load.authros.json(&["records", "open", &text(report, "id")])["message"].clone())
        .collect();
    let named: u64 = told.iter().filter(|report| report["topic"] == ODOM).map(|report| count(report, "records")).sum();
    assert_eq!(named, odometry.len() as u64, "every deleted record is named once: {told:?}");

    let kept = pictures.iter().rfind(|record| record["state"] != "deleted").expect("a picture is kept");
    let digest: Digest = text(kept, "digest").parse().expect("a digest");
    let store = Ciphertext::of(&Ledger::open(&load.home.path().join("ledger.db")).expect("the site's own file"));
    assert_eq!(store.discard(&[digest]), Ok(()));
    load.authros.run(&["records", "check", &text(kept, "id")]).expect_code(6);
    let alarmed = || load.told().contains("no retention record names it").then_some(());
    wait_until(30, "what is missing without a retention record is an alarm", alarmed);
    load.end();
}
