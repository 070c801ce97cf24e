//! The state before a load: the speed of the disk, and another owner's records in the store, put there by the
//! store itself and moved to verified as the pipeline does it, but with nothing sealed and no chain.

use std::fs::File;
use std::io::Write as _;
use std::path::Path;
use std::time::Instant;

use crate::progress::Progress;
use crate::spread::Spread;
use authros_chain::merkle::{Leaf, Tree};
use authros_config::paths::Home;
use authros_crypto::sm3::sm3_many;
use authros_model::{
    Address, Digest, ErrorKind, FilterId, Hash, RecordKind, RecordState, Signature, SignerId, Timestamp, TopicId,
};
use authros_service::Failure;
use authros_store::{Anchors, Ledger, NewBatch, NewRecord, NewTransaction, RootSighting, TransactionOutcome};

/// Whose records they are; the account that anchors them, too.
pub(crate) const OWNER: Address = Address([1; 20]);
/// Topics that they are of, in turn: each record of a commit touches its own pages in two indices, the worst case.
pub(crate) const TOPICS: u64 = 500;
/// When the first was captured; each is a millisecond after the one before it.
const BEGIN: u64 = 1_700_000_000_000_000_000;
/// Nanoseconds between two captures.
pub(crate) const APART: u64 = 1_000_000;
/// Records put in at a time, and in a batch.
const BULK: u64 = 5_000;
/// Bytes of a signed transaction that anchors a root.
const TRANSACTION: usize = 180;
/// Stored bytes of each: a message of 1 KiB, sealed.
const STORED: usize = 1_360;
/// How often an fsync is timed.
const TIMES: usize = 50;

/// Fills the store of a home that no site has opened yet.
///
/// # Errors
/// Errors of the store, such as a full disk.
pub(super) fn fill(home: &Home, wanted: u64) -> Result<(), Failure> {
    let ledger = Ledger::open(&home.ledger())?;
    let mut progress = Progress::new("records there before");
    let (mut there, mut block) = (0, 0);
    while there < wanted {
        let end = wanted.min(there + BULK);
        let blobs: Vec<Vec<u8>> = (there..end).map(blob).collect();
        let digests = sm3_many(&blobs.iter().map(Vec::as_slice).collect::<Vec<_>>());
        let records = (there..end).zip(digests).zip(blobs);
        let records = records.map(|((number, digest), blob)| record(number, Digest(digest), Some(blob)));
        ledger.records.append(records.collect())?;
        block += 1;
        verify(&ledger, block)?;
        there = end;
        progress.at(usize::try_from(there).unwrap_or(usize::MAX), usize::try_from(wanted).unwrap_or(usize::MAX));
    }
    Ok(ledger.close()?)
}

/// Bytes that differ for every record.
fn blob(number: u64) -> Vec<u8> {
    let mut bytes = vec![0x5a; STORED];
    bytes[..8].copy_from_slice(&number.to_be_bytes());
    bytes
}

/// When the record of that number was captured.
pub(crate) fn captured_at(number: u64) -> Timestamp {
    Timestamp(BEGIN + number * APART)
}

/// The record of that number.
pub(crate) fn record(number: u64, digest: Digest, blob: Option<Vec<u8>>) -> NewRecord {
    let topic = number % TOPICS;
    let mut topic_id = [0; 16];
    topic_id[..8].copy_from_slice(&topic.to_be_bytes());
    NewRecord {
        digest,
        owner: OWNER,
        topic_id: TopicId(topic_id),
        seq: number / TOPICS + 1,
        foreign: None,
        epoch: 1,
        kind: RecordKind::Data,
        signer: SignerId([1; 32]),
        signature: Signature([7; 64]),
        filters: vec![FilterId([2; 8])],
        topic: format!("/robot{}/sensor{}/data", topic / 20, topic % 20),
        type_name: "sensor_msgs/LaserScan".to_owned(),
        bytes: 1024,
        captured_at: captured_at(number),
        simulated: true,
        state: RecordState::Stored,
        blob,
    }
}

/// Moves all stored records to verified as one batch, by the pipeline's steps; the chain's answers are invented.
fn verify(ledger: &Ledger, block: u64) -> Result<(), Failure> {
    let leaves = ledger.batches.stored_leaves(OWNER, usize::try_from(BULK).unwrap_or(usize::MAX))?;
    let Some(tree) = Tree::new(Leaf::hashes(&leaves)) else { return Ok(()) };
    let (root, hash, block_hash) = (tree.root(), numbered(1, block), numbered(2, block));
    let digests: Vec<_> = leaves.iter().map(|leaf| leaf.digest).collect();
    let places = digests.iter().enumerate().map(|(index, digest)| (*digest, tree.path(index)));
    ledger.batches.close(NewBatch { owner: OWNER, root, leaves: places.collect() })?;
    ledger.lanes.submit(NewTransaction {
        hash,
        account: OWNER,
        nonce: block - 1,
        raw: vec![0; TRANSACTION],
        purpose: "anchor".to_owned(),
        anchors: Anchors::Batch(root),
    })?;
    let count = leaves.len() as u64;
    ledger.batches.anchored(&[RootSighting { account: OWNER, root, count, transaction: hash, block, block_hash }])?;
    ledger.lanes.close_transactions(vec![(hash, TransactionOutcome::Mined { block, block_hash, gas_used: None })])?;
    ledger.batches.confirm(block)?;
    ledger.records.advance(&digests, RecordState::Confirmed, RecordState::Verified)?;
    Ok(())
}

fn numbered(kind: u8, number: u64) -> Hash {
    let mut hash = [kind; Hash::LENGTH];
    hash[..8].copy_from_slice(&number.to_be_bytes());
    Hash(hash)
}

/// How long an fsync of another 4 KiB takes in a directory, milliseconds.
///
/// # Errors
/// If nothing can be written there.
pub(super) fn fsync_times(directory: &Path) -> Result<Spread, Failure> {
    let path = directory.join("fsync");
    let times = timed(&path).map_err(|error| {
        Failure::new(ErrorKind::Home, format!("{} cannot be written: {error}; set TMPDIR", directory.display()))
    });
    drop(std::fs::remove_file(&path));
    Ok(Spread::of(&times?))
}

fn timed(path: &Path) -> std::io::Result<Vec<f64>> {
    let mut file = File::create(path)?;
    let mut times = Vec::with_capacity(TIMES);
    for _ in 0..TIMES {
        file.write_all(&[0x5a; 4096])?;
        let begun = Instant::now();
        file.sync_data()?;
        times.push(begun.elapsed().as_secs_f64() * 1e3);
    }
    Ok(times)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_are_verified_and_whole_in_the_store() {
        let directory = tempfile::tempdir().expect("a directory");
        let home = Home::new(directory.path().join("home"));
        authros_store::files::private_directory(home.root()).expect("made");
        fill(&home, 5_003).expect("filled");
        let ledger = Ledger::open(&home.ledger()).expect("a ledger");
        let counts = ledger.counts.by_state(None).expect("counted");
        assert_eq!((counts.data_in(RecordState::Verified), counts.pending()), (5_003, 0));
        assert!(counts.is_conserved() && ledger.inspection.contradictions().expect("looked").is_empty());
        let store = authros_store::Ciphertext::of(&ledger);
        assert_eq!(store.usage().expect("counted").entries, 5_003);
        let row = ledger.records.in_state(None, RecordState::Verified, 1).expect("a row").remove(0);
        let bytes = store.get(row.digest).expect("read").expect("there");
        assert_eq!(authros_crypto::sm3::sm3(&[&bytes]), row.digest.0);
        let spread = fsync_times(directory.path()).expect("timed");
        assert!(spread.min > 0.0 && std::fs::read_dir(directory.path()).expect("read").count() == 1);
    }
}
