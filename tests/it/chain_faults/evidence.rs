//! What the chain itself holds of the contract's anchors, and whether the ledger agrees with it.

use std::collections::BTreeMap;

use serde_json::Value;
use sha3::{Digest as _, Keccak256};

use crate::support::anvil::{number, word};
use crate::support::{Anvil, hex, text};

/// One event of the contract that anchors records.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Anchor {
    /// Its transaction, with 0x.
    pub transaction: String,
    /// Its block's number.
    pub block: u64,
    /// The anchoring account, 40 hex digits.
    pub account: String,
    /// What it anchors.
    pub what: Anchored,
}

/// What an event anchors.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Anchored {
    /// One digest, hex.
    Digest(String),
    /// A Merkle root over this many leaves, and the account's previous root, hex.
    Root { root: String, count: u64, previous: String },
}

/// First topic of an event.
fn signature(event: &str) -> String {
    format!("0x{}", hex(&Keccak256::digest(event)))
}

fn quantity(word: &[u8]) -> u64 {
    assert!(word[..24].iter().all(|&byte| byte == 0), "a uint64");
    u64::from_be_bytes(word[24..].try_into().expect("8 bytes"))
}

/// Every anchor on the chain as it is now, oldest first.
pub fn anchors(node: &Anvil, contract: &str) -> Vec<Anchor> {
    let uploaded = signature("DataUploaded(address,bytes32,bytes32,uint64,uint64,bytes)");
    let anchored = signature("Anchored(address,bytes32,uint64,bytes32)");
    let read = |log: Value| {
        let topics: Vec<&str> = log["topics"].as_array()?.iter().filter_map(Value::as_str).collect();
        let hash = topics.get(2).map(|topic| topic.trim_start_matches("0x").to_owned());
        let what = match topics.first() {
            Some(&topic) if topic == uploaded => Anchored::Digest(hash?),
            Some(&topic) if topic == anchored => {
                Anchored::Root { root: hash?, count: quantity(&word(&log, 0)), previous: hex(&word(&log, 1)) }
            }
            _ => return None,
        };
        let account = topics[1][26..].to_owned();
        Some(Anchor { transaction: text(&log, "transactionHash"), block: number(&log["blockNumber"]), account, what })
    };
    node.raw_logs(contract).into_iter().filter_map(read).collect()
}

/// States that claim the anchor is in a block.
pub fn says_mined(record: &Value) -> bool {
    matches!(record["state"].as_str(), Some("mined" | "confirmed" | "verified"))
}

/// Records whose state claims that they are in a block, but are not where they claim; each in words.
pub fn lies(records: &[Value], anchors: &[Anchor]) -> Vec<String> {
    let by_transaction: BTreeMap<&str, &Anchor> =
        anchors.iter().map(|anchor| (anchor.transaction.as_str(), anchor)).collect();
    let lie = |record: &&Value| {
        let anchor = record["transaction"].as_str().and_then(|hash| by_transaction.get(hash));
        !anchor.is_some_and(|anchor| {
            let covers = match &anchor.what {
                Anchored::Digest(digest) => *digest == text(record, "digest"),
                Anchored::Root { .. } => true,
            };
            covers && record["block"].as_u64() == Some(anchor.block)
        })
    };
    let mined = records.iter().filter(|record| says_mined(record));
    let mut found: Vec<String> =
        mined.filter(lie).map(|record| format!("not on the chain: {}", brief(record))).collect();
    found.extend(overfull(records, anchors));
    found
}

/// A description of a record for a failed test.
fn brief(record: &Value) -> String {
    format!(
        "{} seq {} {} block {} {}",
        record["kind"], record["seq"], record["state"], record["block"], record["transaction"]
    )
}

/// Batches named by more records than they have leaves.
fn overfull(records: &[Value], anchors: &[Anchor]) -> Vec<String> {
    let members = |anchor: &Anchor| {
        records
            .iter()
            .filter(|record| says_mined(record) && record["transaction"] == anchor.transaction.as_str())
            .count()
    };
    let too_many = |anchor: &&Anchor| match &anchor.what {
        Anchored::Root { count, .. } => members(anchor) as u64 > *count,
        Anchored::Digest(_) => members(anchor) > 1,
    };
    anchors.iter().filter(too_many).map(|anchor| format!("more records than leaves: {anchor:?}")).collect()
}

/// Fails unless every record is in a block by exactly one anchor, and no anchor holds anything else.
pub fn expect_once(records: &[Value], anchors: &[Anchor]) {
    let missing: Vec<&Value> = records.iter().filter(|record| !says_mined(record)).collect();
    assert!(missing.is_empty(), "not anchored: {missing:?}");
    assert_eq!(lies(records, anchors), Vec::<String>::new(), "states and chain differ");
    let mut names = BTreeMap::new();
    let mut leaves = 0;
    for anchor in anchors {
        let (name, count) = match &anchor.what {
            Anchored::Digest(digest) => (digest, 1),
            Anchored::Root { root, count, .. } => (root, *count),
        };
        let before = names.insert(name, anchor);
        assert!(before.is_none(), "anchored twice: {before:?} and {anchor:?}");
        let members = records.iter().filter(|record| record["transaction"] == anchor.transaction.as_str()).count();
        assert_eq!(members as u64, count, "records of {anchor:?}");
        leaves += count;
    }
    assert_eq!(leaves, records.len() as u64, "as many leaves as records");
}

/// Fails unless every account's roots are chained, each to the one before it.
pub fn expect_chained(anchors: &[Anchor]) {
    let mut heads: BTreeMap<&str, String> = BTreeMap::new();
    for anchor in anchors {
        let Anchored::Root { root, previous, .. } = &anchor.what else { continue };
        let head = heads.insert(&anchor.account, root.clone()).unwrap_or_else(|| "0".repeat(64));
        assert_eq!(*previous, head, "{anchor:?}");
    }
}
