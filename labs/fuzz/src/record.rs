//! Records: header and head, checking and opening, sealing; envelopes.

use std::collections::BTreeMap;

use authros::crypto::{
    Anchor, EpochKey, Expected, GrantedKeys, IndexKey, Names, SealRequest, SealedRecord, TopicKey, WrappedKeys, check,
    open, record, seal, unwrap, wrap,
};
use authros::gateway::{Command, Request, Upload};
use authros::model::head::Compression;
use authros::model::wire::Reader;
use authros::model::{
    Address, Digest, FilterId, GrantTerms, Head, Header, RecordKind, RecorderPrefix, Scope, Signature, Timestamp,
    TopicId, Verdict,
};

use crate::cast::{CAST, DOMAIN, provider};
use crate::{Sample, masked, sample, way};

const WAYS: u8 = 7;
/// The topic of the valid upload.
const TOPIC: &str = "/robot1/odom";
/// A valid upload and a valid envelope: salts and signatures differ each time, so they are stored.
const UPLOAD: &[u8] = include_bytes!("../corpus/record/upload");
const ENVELOPE: &[u8] = include_bytes!("../corpus/record/envelope");

/// Without its first byte, which selects the test.
fn genuine(file: &'static [u8]) -> &'static [u8] {
    &file[1..]
}

/// Any claimed record.
pub fn run(data: &[u8]) -> bool {
    match way(data, WAYS) {
        Some((0, body)) => upload(body),
        Some((1, mask)) => upload(&masked(genuine(UPLOAD), mask).0),
        Some((2, mask)) => signed_anew(mask),
        Some((3, bytes)) => head(bytes),
        Some((4, bytes)) => sealed(bytes),
        Some((5, bytes)) => envelope(bytes),
        Some((6, mask)) => envelope(&masked(genuine(ENVELOPE), mask).0),
        _ => false,
    }
}

fn topic_key() -> TopicKey {
    TopicKey::new([6; 32])
}

fn expected(topic: &str) -> Expected {
    Expected::any_of(DOMAIN, CAST.address(), Names::Given(topic.to_owned()))
}

/// Signature and blob: checked and opened only if they are the valid ones.
fn upload(body: &[u8]) -> bool {
    let Ok(Request::Upload(upload)) = Request::parse(Command::Upload, body) else { return false };
    if let Ok((header, length)) = Header::parse(&upload.blob) {
        assert_eq!(header.encode(), &upload.blob[..length], "one encoding for one header");
    }
    let (signer, blob) = (&CAST.owner.public, &upload.blob);
    let is_genuine = body == genuine(UPLOAD);
    let checked = check(provider(), blob, &upload.signature, signer, Anchor::Unanchored);
    assert_eq!(checked.is_ok(), is_genuine, "took what nobody signed, or refused what was signed");
    let digest = Digest(provider().sm3(&[&genuine(UPLOAD)[Signature::LENGTH..]]));
    for (anchor, verdict) in [(Anchor::Unanchored, Verdict::Unanchored), (Anchor::Chain(digest), Verdict::Verified)] {
        let opened = open(provider(), blob, &upload.signature, signer, anchor, &topic_key(), &expected(TOPIC));
        assert_eq!(opened.is_ok(), is_genuine, "opened what nobody sealed");
        assert!(opened.is_err() || opened.is_ok_and(|opened| opened.verdict == verdict));
    }
    is_genuine
}

/// An altered record signed by its own owner: the signature is valid, the tags must not be.
fn signed_anew(mask: &[u8]) -> bool {
    let (blob, changed) = masked(&genuine(UPLOAD)[Signature::LENGTH..], mask);
    let digest = Digest(provider().sm3(&[&blob]));
    let signature = provider().sign(&CAST.owner.secret, &record::signed_bytes(&DOMAIN, &digest)).expect("signs");
    let (signer, key) = (&CAST.owner.public, topic_key());
    let opened = open(provider(), &blob, &signature, signer, Anchor::Chain(digest), &key, &expected(TOPIC));
    assert_eq!(opened.is_ok(), !changed, "opened what was not sealed");
    !changed
}

fn head(bytes: &[u8]) -> bool {
    let Ok(head) = Head::parse(bytes) else { return false };
    assert_eq!(head.encode(), bytes, "one encoding for one head");
    true
}

/// Sealed as the bytes say, opened unchanged, and under no other topic key.
fn sealed(bytes: &[u8]) -> bool {
    let Some((record, head, body)) = made(bytes) else { return false };
    let signer = &CAST.owner.public;
    let anchor = Anchor::Chain(record.digest);
    let with = |key: &TopicKey, expected: &Expected| {
        open(provider(), &record.blob, &record.signature, signer, anchor, key, expected)
    };
    let opened = with(&topic_key(), &expected(&head.topic)).expect("the very record");
    assert_eq!((opened.verdict, &opened.head, &opened.body[..]), (Verdict::Verified, &head, body));
    assert_eq!(opened.header.encode(), record.blob[..opened.header.encode().len()]);
    assert!(with(&TopicKey::new([7; 32]), &expected(&head.topic)).is_err(), "under another key");
    let other = Expected { seq: Some(opened.header.seq ^ 1), ..expected(&head.topic) };
    assert!(with(&topic_key(), &other).is_err(), "as another number");
    let other = expected(&format!("{}x", head.topic));
    assert!(with(&topic_key(), &other).is_err(), "under another name");
    true
}

/// Epoch (8), seq (8), time (8), kind (1), number of filters (1), topic, tag, its value, body.
fn made(bytes: &[u8]) -> Option<(SealedRecord, Head, &[u8])> {
    let mut reader = Reader::new(bytes);
    let (epoch, seq) = (reader.u64("epoch").ok()?, reader.u64("seq").ok()?);
    let captured_at = Timestamp(reader.u64("time").ok()?);
    let kind = RecordKind::from_code(reader.u8("kind").ok()? % 8 + 1)?;
    let filters = vec![FilterId([3; 8]); usize::from(reader.u8("filters").ok()? % 5)];
    let (topic, tag, value) = (reader.text("topic").ok()?, reader.text("tag").ok()?, reader.text("value").ok()?);
    let body = reader.rest();
    let head = Head {
        topic,
        type_name: "nav_msgs/Odometry".into(),
        md5sum: "cd5e73d190d741a2f92e81eda573aca7".into(),
        definition: Digest([4; 32]),
        caller_id: "/robot1".into(),
        boot_id: [5; 16],
        compression: Compression::None,
        plain_length: body.len() as u64,
        tags: BTreeMap::from([(tag, value)]),
    };
    let request = SealRequest {
        domain: DOMAIN,
        owner: CAST.address(),
        signer: &CAST.owner,
        epoch,
        topic_key: &topic_key(),
        recorder: RecorderPrefix::ledger([4; 7]),
        seq,
        topic_id: TopicId([8; 16]),
        kind,
        filters,
        captured_at,
        head: &head,
        body,
    };
    let sealed = seal(provider(), &request).ok()?;
    Some((sealed, head, body))
}

fn terms() -> GrantTerms {
    GrantTerms {
        owner: CAST.address(),
        grantee: Address([3; 20]),
        epoch: 4,
        expiry: Some(Timestamp(5_000_000_000)),
        scope: Scope::All,
    }
}

fn envelope(bytes: &[u8]) -> bool {
    let opened = unwrap(provider(), &DOMAIN, bytes, &terms(), &CAST.owner.public, &CAST.reader.secret);
    assert_eq!(opened.is_ok(), bytes == genuine(ENVELOPE), "opened what nobody wrapped, or refused what was wrapped");
    opened.is_ok()
}

/// Valid encodings of every kind.
pub fn samples() -> Vec<Sample> {
    let text = |text: &str| [&[0, u8::try_from(text.len()).expect("short")], text.as_bytes()].concat();
    let fields = [
        &1u64.to_be_bytes()[..],
        &2u64.to_be_bytes(),
        &3u64.to_be_bytes(),
        &[0, 2],
        &text(TOPIC),
        &text("mission"),
        &text("survey"),
        b"the message",
    ];
    let (record, first, _) = made(&fields.concat()).expect("sealed");
    let upload = Request::Upload(Upload::from(&record)).encode();
    let keys = GrantedKeys::All { epochs: vec![(4, EpochKey::new([8; 32]))], index_key: IndexKey::new([9; 32]) };
    let wrapped = WrappedKeys { terms: terms(), keys };
    let envelope = wrap(provider(), &DOMAIN, &wrapped, &CAST.owner, &CAST.reader.public).expect("wraps");
    let tags = [("a", "1"), ("b", "2"), ("c", "3")].map(|(key, value)| (key.to_owned(), value.to_owned()));
    let head = Head { tags: BTreeMap::from(tags), ..first };
    vec![
        sample("upload", 0, &upload),
        sample("upload_masked", 1, &[0; 4]),
        sample("signed_anew", 2, &[0; 4]),
        sample("head", 3, &head.encode()),
        sample("sealed", 4, &fields.concat()),
        sample("envelope", 5, &envelope),
        sample("envelope_masked", 6, &[0; 4]),
    ]
}
