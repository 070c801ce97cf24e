//! Records for a ledger, and how long another record takes.

use std::time::{Duration, Instant};

use super::life::Life;
use super::whole;
use crate::spread::number;
use authros_model::{Address, Digest, FilterId, RecordKind, RecordState, Signature, SignerId, Timestamp, TopicId};
use authros_service::Failure;
use authros_store::{Ledger, NewRecord};

/// Whose records they are.
pub(crate) const OWNER: Address = Address([1; 20]);
/// The filter id of records of one topic in twenty.
pub(crate) const RARE: FilterId = FilterId([1; 8]);
/// Topics that they are of; all of them are there at every level.
const TOPICS: u64 = 500;
/// Length of a message: an odometry's.
pub(crate) const MESSAGE: u64 = 728;
/// When the first was captured; each is a millisecond after the one before it.
pub(crate) const BEGIN: u64 = 1_700_000_000_000_000_000;
/// Records in a commit that is timed, as in the pipeline.
const COMMIT: u64 = 256;
/// Records appended before they are verified in one batch: a second of a busy site.
const BATCH: u64 = 1_024;
/// Batches per figure: enough for each to have its share of checkpoints.
const WINDOW: u64 = 4;
/// Figures taken of one ledger, at most.
pub(crate) const FIGURES: u64 = 5;
/// Records in a commit, and in a batch, that is not timed.
const BULK: u64 = 5_000;

/// Microseconds per record, figure by figure.
#[derive(Debug, Default)]
pub(crate) struct Costs {
    /// Of acknowledging it.
    pub append: Vec<f64>,
    /// Its steps to verified.
    pub life: Vec<f64>,
}

/// The record of that number.
pub(crate) fn record(number: u64) -> NewRecord {
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
        filters: vec![if topic.is_multiple_of(20) { RARE } else { FilterId([2; 8]) }],
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
pub(crate) fn name(topic: u64) -> String {
    format!("/robot{}/sensor{}/data", topic / 20, topic % 20)
}

/// Appends so many records to an empty ledger and verifies them; adds what one of the last ones took to `costs`. The
/// first of each topic is not timed.
pub(crate) fn fill(ledger: &Ledger, wanted: u64, costs: &mut Costs, mut done: impl FnMut(u64)) -> Result<(), Failure> {
    let timed_from = wanted.saturating_sub(FIGURES * WINDOW * BATCH).max(TOPICS.min(wanted));
    let (mut life, mut there) = (Life::default(), 0);
    while there < timed_from {
        let end = timed_from.min(there + BULK);
        ledger.append((there..end).map(record).collect())?;
        life.verify(ledger, whole(BULK))?;
        there = end;
        done(there);
    }
    while there < wanted {
        let end = wanted.min(there + WINDOW * BATCH);
        let (append, verify) = window(ledger, &mut life, there, end)?;
        let records = number(whole(end - there));
        costs.append.push(append.as_secs_f64() * 1e6 / records);
        costs.life.push(verify.as_secs_f64() * 1e6 / records);
        there = end;
        done(there);
    }
    Ok(())
}

/// How long it takes to append the records from `there` to `end`, and to verify them.
fn window(ledger: &Ledger, life: &mut Life, mut there: u64, end: u64) -> Result<(Duration, Duration), Failure> {
    let (mut appending, mut verifying) = (Duration::ZERO, Duration::ZERO);
    while there < end {
        let batch = end.min(there + BATCH);
        while there < batch {
            let commit = batch.min(there + COMMIT);
            let records: Vec<NewRecord> = (there..commit).map(record).collect();
            let begun = Instant::now();
            ledger.append(records)?;
            appending += begun.elapsed();
            there = commit;
        }
        let begun = Instant::now();
        life.verify(ledger, whole(BULK))?;
        verifying += begun.elapsed();
    }
    Ok((appending, verifying))
}
