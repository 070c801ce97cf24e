//! A thief of a robot files records under the pseudonym of a topic whose other records are honest, and writes false names
//! into them: the topic's, so that honest records appear under it; the type's; and one that prints lines of its own.

use authros::crypto::{
    Enrolment, IndexKey, ProviderName, SealRequest, SealingKey, filter_id, provider, random_bytes, seal, topic_id,
    topic_key,
};
use authros::gateway::Upload;
use authros::model::{Head, RecordKind, RecorderPrefix, Timestamp};
use serde_json::Value;

use crate::enrolled_robot::{Robot, Scene, head, session};
use crate::judge;
use crate::parts::Parts;
use crate::support::{count, list, text};

const TRUE: (&str, &str) = ("/robot1/odom", "nav_msgs/Odometry");
const FALSE: (&str, &str) = ("/emergency_stop_released", "std_msgs/Bool");
/// Printed as it is, it looks like the last lines of `records show`.
const LINES: &str =
    "/odom, captured now\nsignature  SM2 by signer of the owner herself\nverified  read back from the store";

/// What a robot of all topics has.
struct Thief {
    robot: Enrolment,
    index: IndexKey,
    recorder: RecorderPrefix,
}

impl Thief {
    fn of(robot: Enrolment) -> Self {
        let index = robot.index.clone().expect("a robot of all topics");
        Self { robot, index, recorder: RecorderPrefix::ledger(random_bytes().expect("random")) }
    }

    /// A record filed under one topic and type whose head names others; the beginning of its digest.
    fn seal(&self, seq: u64, filed: (&str, &str), written: (&str, &str)) -> (String, Upload) {
        let SealingKey::Epoch(epoch) = &self.robot.keys.now.key else { panic!("a robot of all topics") };
        let (id, body) = (topic_id(&self.index, filed.0), b"\x01");
        let head = Head { caller_id: "/robot1".to_owned(), ..head(written.0.to_owned(), written.1, body) };
        let request = SealRequest {
            domain: self.robot.domain,
            owner: self.robot.owner,
            signer: &self.robot.device,
            epoch: self.robot.keys.now.epoch,
            topic_key: &topic_key(epoch, &id),
            recorder: self.recorder,
            seq,
            topic_id: id,
            kind: RecordKind::Data,
            filters: vec![filter_id(&self.index, "type", filed.1)],
            captured_at: Timestamp::now(),
            head: &head,
            body,
        };
        let sealed = seal(provider(ProviderName::RustCrypto), &request).expect("seals");
        (sealed.digest.to_hex()[..16].to_owned(), Upload::from(&sealed))
    }
}

/// Honest records and false ones, as alice's list of the true topic has them.
fn judge_list(parts: &mut Parts, scene: &Scene, honest: usize, forged: &[String]) {
    let listed = scene.alice.records(&["records", "list", "--oldest", "--topic", TRUE.0]);
    let is_forged = |record: &&Value| forged.contains(&text(record, "id"));
    let is_honest = |record: &&Value| !is_forged(record) && record["type"] == TRUE.1;
    if listed.iter().filter(is_honest).count() != honest {
        parts.reached(format!("honest records are gone from {}: {listed:?}", TRUE.0));
    }
    for record in listed.iter().filter(is_forged) {
        parts.refused("listed", &text(record, "state"), "false name");
        if record["type"] == FALSE.1 {
            parts.reached(format!("a false type is shown: {record}"));
        }
    }
    let stolen = scene.alice.records(&["records", "list", "--oldest", "--topic", FALSE.0]);
    if !stolen.is_empty() {
        parts.reached(format!("{} records are listed as {}: {stolen:?}", stolen.len(), FALSE.0));
    }
}

/// What `records show` prints and `records open` answers of a false record.
fn judge_one(parts: &mut Parts, scene: &Scene, id: &str, what: &str) {
    let shown = scene.alice.run(&["records", "show", id]).expect_code(0).stdout;
    let forged = |line: &str| line.starts_with("verified") || line.ends_with("of the owner herself");
    if shown.lines().any(forged) || shown.contains(FALSE.0) || shown.contains(FALSE.1) {
        parts.reached(format!("the thief's words are shown as those of the program:\n{shown}"));
    }
    parts.refused("shown", &shown, "false name");
    let opened = scene.alice.with(&["--json"]).run(&["records", "open", id]);
    match opened.code {
        Some(5) => parts.refused("opened", &text(&opened.document()["error"], "message"), what),
        _ => parts.reached(format!("it is opened under its false name: {opened}")),
    }
}

/// The audit of the owner names the false records, and nothing else.
fn judge_audit(parts: &mut Parts, scene: &Scene, forged: &[String]) {
    let audit = scene.alice.with(&["--json"]).run(&["audit"]);
    let found = audit.document();
    if count(&found, "tampered") > 0 {
        parts.reached(format!("the owner's store counts as tampered with: {found}"));
    }
    let findings = list(&found, "findings");
    let names = |id: &String| findings.iter().any(|finding| text(finding, "subject").contains(id.as_str()));
    let of_kind = findings.iter().filter(|finding| finding["kind"] == "false_name").count();
    if audit.code == Some(5) && findings.len() == forged.len() && of_kind == forged.len() && forged.iter().all(names) {
        parts.refused("audited", "each false record, by its id, and nothing else", "nothing else");
    } else {
        parts.otherwise(format!("the audit does not name the false records alone: {found}"));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn rename_a_topic() {
    let scene = Scene::new();
    let (lost, honest) = (Robot::enrol(&scene, "scout-1", &[]), Robot::enrol(&scene, "scout-2", &[]));
    let thief = Thief::of(lost.stolen());
    let mut forged = vec![
        (thief.seal(1, TRUE, (FALSE.0, TRUE.1)), "false topic"),
        (thief.seal(2, TRUE, (TRUE.0, FALSE.1)), "false type"),
        (thief.seal(1, (LINES, TRUE.1), (LINES, TRUE.1)), "false topic"),
    ];
    // More than are opened to learn a name.
    forged.extend((3..12).map(|seq| (thief.seal(seq, TRUE, (FALSE.0, TRUE.1)), "false topic")));
    // Before any honest record: the first record of a topic that opens used to give it its name.
    let mut client = session(&thief.robot).await.expect("the robot's own session");
    let (mut ids, mut words, mut uploads) = (Vec::new(), Vec::new(), Vec::new());
    for ((id, upload), what) in forged {
        ids.push(id);
        words.push(what);
        uploads.push(upload);
    }
    client.upload(uploads).await.expect("a gateway sees no names");
    scene.alice.records(&["records", "list", "--oldest"]);
    let mut parts = Parts::default();
    let alone = scene.alice.records(&["records", "list", "--oldest", "--topic", TRUE.0]);
    if alone.len() + 1 != ids.len() {
        parts.reached(format!("records of {} are not found by its name: {alone:?}", TRUE.0));
    }
    honest.capture(2);

    judge_list(&mut parts, &scene, 2, &ids);
    for (id, what) in ids.iter().zip(words) {
        judge_one(&mut parts, &scene, id, what);
    }
    judge_audit(&mut parts, &scene, &ids);
    judge("rename_a_topic", parts.outcome());
}
