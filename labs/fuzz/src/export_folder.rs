//! Export folders: `proof.json`, and all five files as a stranger receives them.

use authros::chain::merkle::{Leaf, Tree};
use authros::crypto::{SealRequest, TopicKey, keyfile, record, seal, signature_der};
use authros::model::head::Compression;
use authros::model::wire::Reader;
use authros::model::{Digest, Hash, Head, RecordKind, RecorderPrefix, SignerId, Timestamp, TopicId};
use authros::pipeline::export_folder::{AnchorWord, ClaimedAnchor, ClaimedProof, ExportFolder};

use crate::cast::{CAST, DOMAIN, provider};
use crate::{Sample, masked, sample, way};

const WAYS: u8 = 3;
/// A valid folder: salt and signature differ each time, so it is stored.
const FOLDER: &[u8] = include_bytes!("../corpus/export_folder/folder");

/// Any claimed exported record.
pub fn run(data: &[u8]) -> bool {
    match way(data, WAYS) {
        Some((0, text)) => proof(text),
        Some((1, bytes)) => folder(bytes),
        Some((2, mask)) => folder(&masked(FOLDER.get(1..).unwrap_or_default(), mask).0),
        _ => false,
    }
}

/// Whatever is read from `proof.json` would be written the same way.
fn proof(text: &[u8]) -> bool {
    let Ok(parsed) = ClaimedProof::parse(text) else { return false };
    let written = serde_json::to_vec(&parsed).expect("words and numbers");
    assert_eq!(ClaimedProof::parse(&written), Ok(parsed));
    true
}

/// The five files, each preceded by its length (4).
fn split(bytes: &[u8]) -> Option<ExportFolder> {
    let mut reader = Reader::new(bytes);
    let mut file = || {
        let length = usize::try_from(reader.u32("length").ok()?).ok()?;
        reader.take(length, "file").ok().map(<[u8]>::to_vec)
    };
    let (record, message, signature, signer, proof) = (file()?, file()?, file()?, file()?, file()?);
    ExportFolder::parse(record, message, &signature, &signer, &proof).ok()
}

/// Whatever is changed: with the owner's key, only the genuine record is accepted.
fn folder(bytes: &[u8]) -> bool {
    let Some(found) = split(bytes) else { return false };
    let holds = found.check(provider()).iter().all(|step| step.ok == Some(true));
    if holds && found.signer == CAST.owner.public {
        let genuine = split(FOLDER.get(1..).unwrap_or_default()).expect("the kept one");
        assert!(found.record == genuine.record, "a record that nobody signed holds");
    }
    holds
}

fn claimed(digest: Digest, signer: SignerId, leaf: &Leaf, anchor: ClaimedAnchor) -> ClaimedProof {
    ClaimedProof {
        format: "authros-proof/1".to_owned(),
        digest,
        signer,
        epoch: 1,
        recorder: leaf.recorder,
        topic_id: leaf.topic_id,
        seq: leaf.seq,
        domain: DOMAIN,
        chain_id: 7,
        genesis: Hash([8; 32]),
        contract: Some(CAST.address()),
        anchor,
    }
}

/// Valid encodings of every kind.
pub fn samples() -> Vec<Sample> {
    let (recorder, topic_id, body) = (RecorderPrefix::ledger([2; 7]), TopicId([3; 16]), b"message".to_vec());
    let head = Head {
        topic: "/a".to_owned(),
        type_name: "std_msgs/String".to_owned(),
        md5sum: "0".repeat(32),
        definition: Digest([4; 32]),
        caller_id: "/node".to_owned(),
        boot_id: [5; 16],
        compression: Compression::None,
        plain_length: body.len() as u64,
        tags: std::collections::BTreeMap::new(),
    };
    let request = SealRequest {
        domain: DOMAIN,
        owner: CAST.address(),
        signer: &CAST.owner,
        epoch: 1,
        topic_key: &TopicKey::new([6; 32]),
        recorder,
        seq: 9,
        topic_id,
        kind: RecordKind::Data,
        filters: Vec::new(),
        captured_at: Timestamp(5),
        head: &head,
        body: &body,
    };
    let sealed = seal(provider(), &request).expect("sealed");
    let leaf = Leaf::of(&sealed.header, sealed.digest);
    let tree = Tree::new(vec![Hash([1; 32]), leaf.hash(), Hash([2; 32])]).expect("a tree");
    let anchor = ClaimedAnchor {
        mode: AnchorWord::Batch,
        leaf: Some(leaf.hash()),
        index: Some(1),
        count: Some(3),
        path: Some(tree.path(1)),
        root: Some(tree.root()),
        transaction: Some(Hash([5; 32])),
        block: Some(4),
        block_hash: Some(Hash([6; 32])),
        block_time: None,
    };
    let signer = authros::crypto::signer_id(&CAST.owner.public);
    let proof = serde_json::to_vec(&claimed(sealed.digest, signer, &leaf, anchor)).expect("JSON");
    let message = record::signed_bytes(&DOMAIN, &sealed.digest);
    let pem = keyfile::sm2_public_pem(&CAST.owner.public).expect("PEM").into_bytes();
    let files = [&sealed.blob, &message, &signature_der(&sealed.signature), &pem, &proof];
    let one = |file: &&Vec<u8>| [&u32::try_from(file.len()).expect("short").to_be_bytes()[..], &file[..]].concat();
    let folder: Vec<u8> = files.iter().flat_map(one).collect();
    vec![sample("folder", 1, &folder), sample("proof", 0, &proof), sample("masked", 2, &[0; 4])]
}
