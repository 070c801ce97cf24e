//! The thief of a working robot that may record one topic reads what else its owner has.

use authros::crypto::signer_id;
use authros::gateway::{Code, Feed};
use authros::model::{Digest, RecorderId};

use crate::enrolled_robot::{Robot, Scene, session};
use crate::judge;
use crate::parts::Parts;
use crate::support::text;

#[tokio::test(flavor = "multi_thread")]
async fn read_the_owner_with_a_scoped_robot() {
    let scene = Scene::new();
    let (scoped, other) = (Robot::enrol(&scene, "scout-1", &["/robot1/odom"]), Robot::enrol(&scene, "scout-2", &[]));
    scoped.capture(2);
    other.capture(2);
    let stolen = scoped.stolen();
    let signer = stolen.device_id().to_string();
    let records = scene.alice.records(&["records", "list", "--oldest"]);
    let known: Vec<Digest> = records.iter().map(|record| text(record, "digest").parse().expect("a digest")).collect();
    let mut client = session(&stolen).await.expect("it is lent");
    let (mut parts, refused_by) = (Parts::default(), [Code::NotAuthorised]);
    assert!(known.len() >= 4, "of both robots: {known:?}");
    let list =
        client.feed(&Feed::of(stolen.owner)).await.map(|page| format!("a list of {} records", page.entries.len()));
    parts.answered("Feed", list, &refused_by);
    // What the owner numbered herself: a robot sees her recorder in the notices to it.
    let ledger = rusqlite::Connection::open(scene.home.path().join("ledger.db")).expect("opens");
    let hers = signer_id(&stolen.owner_key).0.to_vec();
    let found = ledger.query_row("SELECT id FROM recorders WHERE signer = ?1", [hers], |row| row.get::<_, Vec<u8>>(0));
    let hers = found.unwrap_or_else(|_| vec![1; RecorderId::LENGTH]);
    let hers = vec![RecorderId::from_slice(&hers).expect("an id")];
    let page = client.feed(&Feed { recorders: hers, ..Feed::of(stolen.owner) }).await.expect("it may ask for its own");
    if !page.entries.is_empty() {
        parts.reached(format!("{} records that no device of hers signed", page.entries.len()));
    }
    for digest in &known {
        let record = client.fetch(digest).await.map(|record| format!("a record of {} bytes", record.blob.len()));
        parts.answered("Records", record, &refused_by);
    }
    if stolen.index.is_some() {
        parts.reached(format!("the index key of all of alice's names, in the file of device {signer}"));
    }
    judge("read_the_owner_with_a_scoped_robot", parts.outcome());
    scene.site.stop("TERM", 20);
}
