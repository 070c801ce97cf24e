//! The thief of a working robot that may record one topic reads what else its owner has.

use authros::gateway::Selection;
use authros::model::Digest;

use crate::enrolled_robot::{Robot, Scene, all_of, session};
use crate::support::text;
use crate::{Outcome, judge};

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
    let mut reached: Vec<String> = Vec::new();
    let mut refusals: Vec<String> = Vec::new();
    match client.query(&all_of(&stolen)).await {
        Ok(page) => reached.push(format!("a list of {} records", page.entries.len())),
        Err(error) => refusals.push(format!("Query: {error}")),
    }
    for digest in &known {
        match client.fetch(digest).await {
            Ok(record) => reached.push(format!("a record of {} bytes", record.blob.len())),
            Err(error) => refusals.push(format!("Fetch: {error}")),
        }
    }
    match client.subscribe(&Selection::all(stolen.owner)).await {
        Ok(_) => reached.push("live records".to_owned()),
        Err(error) => refusals.push(format!("Subscribe: {error}")),
    }
    refusals.dedup();
    if stolen.index.is_some() {
        reached.push(format!("the index key of all of alice's names, in the file of device {signer}"));
    }
    judge(
        "read_the_owner_with_a_scoped_robot",
        if reached.is_empty() { Outcome::Refused(refusals.join("; ")) } else { Outcome::Succeeded(reached.join(", ")) },
    );
    scene.site.stop("TERM", 20);
}
