//! Records for a ledger, and how long a record more takes.

use std::time::Instant;

use super::life::Life;
use super::whole;
use crate::cli::bench::spread::number;
use crate::model::{Address, Digest, RecordKind, RecordState, Signature, SignerId, Timestamp, TopicId};
use crate::service::Failure;
use crate::store::{Ledger, NewRecord};

/// Whose records they are.
pub(super) const OWNER: Address = Address([1; 20]);
/// Topics that they are of; all of them are there at every level.
const TOPICS: u64 = 500;
/// Length of a message: an odometry's.
pub(super) const MESSAGE: u64 = 728;
/// When the first was captured; each is a millisecond after the one before it.
pub(super) const BEGIN: u64 = 1_700_000_000_000_000_000;
/// Records in a commit that is timed, as in the pipeline.
const COMMIT: u64 = 256;
/// Commits that are timed.
const TIMED: u64 = 40;
/// Records in a batch that is timed: a second of a busy site.
const BATCH: u64 = 1_000;
/// Records in a commit, and in a batch, that is not timed.
const BULK: u64 = 5_000;

/// The record of that number.
pub(super) fn record(number: u64) -> NewRecord {
    let topic = number % TOPICS;
    let mut digest = [0; 32];
    digest[..8].copy_from_slice(&number.wrapping_mul(0x9e37_79b9_7f4a_7c15).to_be_bytes());
    digest[24..].copy_from_slice(&number.to_be_bytes());
    let mut topic_id = [0; 16];
    topic_id[..8].copy_from_slice(&topic.to_be_bytes());
    NewRecord {
        digest: Digest(digest),
        owner: OWNER,
        topic_id: TopicId(topic_id),
        seq: number / TOPICS + 1,
        foreign: None,
        epoch: 1,
        kind: RecordKind::Data,
        signer: SignerId([1; 32]),
        signature: Signature([7; 64]),
        filters: Vec::new(),
        topic: name(topic),
        type_name: if topic.is_multiple_of(20) { "nav_msgs/Odometry" } else { "sensor_msgs/LaserScan" }.to_owned(),
        bytes: MESSAGE,
        captured_at: Timestamp(BEGIN + number * 1_000_000),
        simulated: true,
        state: if number.is_multiple_of(1_000) { RecordState::Quarantined } else { RecordState::Stored },
        local_copy: None,
    }
}

/// The name of a topic.
pub(super) fn name(topic: u64) -> String {
    format!("/robot{}/sensor{}/data", topic / 20, topic % 20)
}

/// Appends so many records to an empty ledger and verifies them; returns what one of the last ones took,
/// microseconds per record: to append, commit by commit, and to verify, batch by batch.
pub(super) fn fill(ledger: &Ledger, wanted: u64, mut done: impl FnMut(u64)) -> Result<(Vec<f64>, Vec<f64>), Failure> {
    let timed_from = wanted.saturating_sub(TIMED * COMMIT);
    let (mut life, mut there, mut times) = (Life::default(), 0, Vec::new());
    while there < wanted {
        let is_timed = there >= timed_from;
        let end = if is_timed { wanted.min(there + COMMIT) } else { timed_from.min(there + BULK) };
        let records: Vec<NewRecord> = (there..end).map(record).collect();
        let (count, begun) = (number(records.len()), Instant::now());
        ledger.append(records)?;
        if is_timed {
            times.push(begun.elapsed().as_secs_f64() * 1e6 / count);
        } else {
            life.verify(ledger, whole(BULK))?;
        }
        there = end;
        done(there);
    }
    Ok((times, life.verify(ledger, whole(BATCH))?))
}
