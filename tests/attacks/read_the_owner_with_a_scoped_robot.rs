//! The thief of a working robot that may record one topic reads what else its owner has.

use authros::crypto::signer_id;
use authros::gateway::{Code, Feed};
use authros::model::Digest;

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
    let records = scene.alice.records(&["uploads", "list"]);
    let known: Vec<Digest> = records.iter().map(|record| text(record, "digest").parse().expect("a digest")).collect();
    let mut client = session(&stolen).await.expect("it is lent");
    let (mut parts, refused_by) = (Parts::default(), [Code::NotAuthorised]);
    assert!(known.len() >= 4, "of both robots: {known:?}");
    let owners = Feed { signers: vec![signer_id(&stolen.owner_key)], ..Feed::of(stolen.owner) };
    for (what, feed) in [("everything", Feed::of(stolen.owner)), ("what she signed herself", owners)] {
        let list = client.feed(&feed).await.map(|page| format!("a list of {} records", page.entries.len()));
        parts.answered(what, list, &refused_by);
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
