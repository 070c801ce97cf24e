//! An exported record and its Merkle proof are checked with OpenSSL and the chain's own log, without the program.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::NO_NODE;
use super::evidence::{Anchor, Anchored};
use super::field::{Field, Mode};
use crate::support::process::output_of;
use crate::support::{Anvil, count, hex, skipped, system_program, text, unhex};

/// `openssl dgst -sm3` of a file.
fn sm3_of_file(path: &Path) -> Vec<u8> {
    let output = output_of("openssl", &["dgst", "-sm3", "-r", path.to_str().expect("UTF-8")]);
    unhex(output.split_whitespace().next().expect("a digest"))
}

/// `openssl dgst -sm3` of bytes.
fn sm3(directory: &Path, parts: &[&[u8]]) -> Vec<u8> {
    let path = directory.join("hashed");
    fs::write(&path, parts.concat()).expect("written");
    sm3_of_file(&path)
}

/// The root that a leaf's path leads to (RFC 9162, section 2.1.3.2); `None` if the path's length is wrong.
fn root_of(directory: &Path, leaf: &[u8], index: u64, count: u64, path: &[Vec<u8>]) -> Option<Vec<u8>> {
    let (mut place, mut last, mut hash) = (index, count.checked_sub(1)?, leaf.to_vec());
    for sibling in path {
        if last == 0 {
            return None;
        }
        if place % 2 == 1 || place == last {
            hash = sm3(directory, &[&[1], sibling, &hash]);
            while place % 2 == 0 && place != 0 {
                (place, last) = (place / 2, last / 2);
            }
        } else {
            hash = sm3(directory, &[&[1], &hash, sibling]);
        }
        (place, last) = (place / 2, last / 2);
    }
    (last == 0).then_some(hash)
}

struct Exported {
    directory: PathBuf,
    proof: Value,
}

fn export(field: &Field, record: &Value) -> Exported {
    let id = text(record, "id");
    let directory = field.home.root().join(format!("export-{id}"));
    let place = directory.to_str().expect("UTF-8");
    field.authros.run(&["records", "export", &id, "--dir", place, "--addresses"]).expect_code(0);
    let proof = fs::read(directory.join("proof.json")).expect("a proof");
    Exported { directory, proof: serde_json::from_slice(&proof).expect("JSON") }
}

/// The leaf that binds a blob's digest to owner, signer, recorder, topic and number.
fn leaf_of(exported: &Exported) -> Vec<u8> {
    let Exported { directory, proof } = exported;
    let digest = sm3_of_file(&directory.join("record.bin"));
    let part = |name: &str| unhex(&text(proof, name));
    let parts = [part("owner"), part("signer"), part("recorder"), part("topic_id")];
    assert_eq!(parts.each_ref().map(Vec::len), [20, 32, 16, 16], "{proof}");
    let seq = count(proof, "seq").to_be_bytes();
    sm3(directory, &[&[0], &parts[0], &parts[1], &parts[2], &parts[3], &seq, &digest])
}

fn expect_proven(field: &Field, record: &Value, anchors: &[Anchor]) {
    let exported = export(field, record);
    let Exported { directory, proof } = &exported;
    let digest = hex(&sm3_of_file(&directory.join("record.bin")));
    assert_eq!((&digest, &digest), (&text(proof, "digest"), &text(record, "digest")), "the blob's digest");
    assert_eq!(text(proof, "owner").to_lowercase(), field.address.to_lowercase());

    let place = &proof["anchor"];
    let on_chain = anchors.iter().find(|anchor| anchor.transaction == text(place, "transaction")).expect("its event");
    let Anchored::Root { root, count: leaves, .. } = &on_chain.what else { panic!("no root: {on_chain:?}") };
    assert_eq!(on_chain.block, count(place, "block"));
    assert_eq!(on_chain.account, text(place, "account").trim_start_matches("0x").to_lowercase());
    assert_eq!((text(place, "root").trim_start_matches("0x"), count(place, "count")), (root.as_str(), *leaves));

    let path: Vec<Vec<u8>> =
        crate::support::list(place, "path").iter().map(|step| unhex(step.as_str().expect("hex"))).collect();
    let (leaf, index) = (leaf_of(&exported), count(place, "index"));
    let led_to =
        |leaf: &[u8], index, path: &[Vec<u8>]| root_of(directory, leaf, index, *leaves, path).map(|it| hex(&it));
    assert_eq!(led_to(&leaf, index, &path).as_ref(), Some(root), "the path leads to the chain's root");

    let mut changed = leaf.clone();
    changed[0] ^= 1;
    assert_ne!(led_to(&changed, index, &path).as_ref(), Some(root), "another leaf");
    assert_ne!(led_to(&leaf, index ^ 1, &path).as_ref(), Some(root), "another place");
    assert_ne!(led_to(&leaf, index, &path[1..]).as_ref(), Some(root), "a shorter path");
}

#[test]
fn openssl_and_the_chains_log_confirm_exported_records_of_batches() {
    if system_program("openssl").is_none() {
        skipped!("no openssl");
    }
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let field = Field::open(&node.http(), Mode::Batch, &[]);
    node.set_interval(1);
    field.grow(40);
    let records = field.expect_settled(&node, 60);
    let anchors = field.anchors(&node);
    assert!(anchors.len() < records.len(), "records share transactions");
    // Every leaf of the widest batch, whatever its shape, up to a limit.
    let widest = anchors.iter().max_by_key(|anchor| match &anchor.what {
        Anchored::Root { count, .. } => *count,
        Anchored::Digest(_) => 0,
    });
    let widest = widest.expect("a batch");
    let members: Vec<&Value> =
        records.iter().filter(|record| record["transaction"] == widest.transaction.as_str()).collect();
    assert!(members.len() >= 2, "a tree with a path: {widest:?}");
    for record in members.into_iter().take(24) {
        expect_proven(&field, record, &anchors);
    }
}

#[test]
fn openssl_and_the_chains_log_confirm_an_exported_single_upload() {
    if system_program("openssl").is_none() {
        skipped!("no openssl");
    }
    let Some(node) = Anvil::start(&[]) else { skipped!(NO_NODE) };
    let field = Field::open(&node.http(), Mode::Each, &[]);
    field.grow(3);
    let records = field.expect_settled(&node, 60);
    let anchors = field.anchors(&node);
    for record in &records {
        let exported = export(&field, record);
        let digest = hex(&sm3_of_file(&exported.directory.join("record.bin")));
        let place = &exported.proof["anchor"];
        let found = anchors.iter().find(|anchor| anchor.what == Anchored::Digest(digest.clone())).expect("on chain");
        assert_eq!((&found.transaction, found.block), (&text(place, "transaction"), count(place, "block")));
        assert_eq!(found.account, field.address.trim_start_matches("0x").to_lowercase());
    }
}
