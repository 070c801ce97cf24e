//! Before the device is recalled: what it sealed comes into blocks, because afterwards nothing of it can be anchored.

use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use super::Unattended;
use crate::model::{Address, ErrorKind, SignerId};
use crate::service::failure::refused;
use crate::service::reply::Failure;

/// How long an end waits for the records of its device.
pub(super) const WAIT: Duration = Duration::from_secs(60);
/// How often it looks.
const LOOK: Duration = Duration::from_millis(200);
/// How many looks in a row find nothing: what is being sealed at the moment is in no ledger yet.
const CLEAR: u32 = 5;

impl Unattended {
    /// Waits until all that the device sealed for its owner is in a block. Its owner is here, so the device seals no more.
    ///
    /// # Errors
    /// How many records are not anchored, if some are not after `wait`, or how many wait for a decision before that.
    pub(super) async fn anchored_all(&self, owner: Address, device: SignerId, wait: Duration) -> Result<(), Failure> {
        let (begun, mut clear) = (Instant::now(), 0);
        loop {
            let left = block_in_place(|| self.plant.ledger.on_their_way(owner, device))?;
            clear = if left == 0 { clear + 1 } else { 0 };
            if clear >= CLEAR {
                let held = block_in_place(|| self.plant.ledger.quarantined_of(owner, device))?;
                return if held == 0 { Ok(()) } else { Err(undecided(held)) };
            }
            if left > 0 && (begun.elapsed() >= wait || self.life.is_stopping()) {
                return Err(not_yet(left, wait));
            }
            tokio::time::sleep(LOOK).await;
        }
    }
}

fn not_yet(left: u64, wait: Duration) -> Failure {
    let text = format!(
        "nothing was recalled: {left} records that the device signed are in no block after {} s, and its end would strand \
         them; look at `authros chain status` and try again, or strand them with `authros unattended end --force`",
        wait.as_secs()
    );
    Failure::new(ErrorKind::Unreachable, text)
}

/// Released after the recall, they could not be anchored any more.
fn undecided(held: u64) -> Failure {
    refused(format!(
        "nothing was recalled: {held} messages that the device signed are in quarantine, and its end would strand those that \
         are released later; decide about them with `authros quarantine`, or strand them with `authros unattended end --force`"
    ))
}

/// What a forced end leaves behind, in words.
pub(super) fn stranded(count: u64) -> String {
    format!(
        "{count} records that it signed were in no block yet: those that are in none before the recall stay stored and wait \
         for its right"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Digest, RecordKind, RecordState, Signature, Timestamp, TopicId};
    use crate::site::testing::site_with_chain;
    use crate::store::NewRecord;

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn records_in_no_block_hold_up_the_end_and_are_counted() {
        let (site, _folder) = site_with_chain();
        // Nobody here anchors for this account.
        let (owner, device) = (Address([9; 20]), SignerId([8; 32]));
        let part = &site.unattended;
        part.anchored_all(owner, device, Duration::ZERO).await.expect("there is nothing");
        let record = |seq: u8, signer| NewRecord {
            digest: Digest([seq; 32]),
            owner,
            topic_id: TopicId([seq; 16]),
            seq: 1,
            foreign: None,
            epoch: 1,
            kind: RecordKind::Data,
            signer,
            signature: Signature([7; 64]),
            filters: Vec::new(),
            topic: "/odom".to_owned(),
            type_name: "a/B".to_owned(),
            bytes: 9,
            captured_at: Timestamp::from_seconds(1),
            simulated: false,
            state: RecordState::Stored,
            local_copy: None,
        };
        let strict = SignerId([6; 32]);
        let held = |record| NewRecord { state: RecordState::Quarantined, ..record };
        let definition = NewRecord { kind: RecordKind::Definition, ..held(record(5, SignerId([5; 32]))) };
        let records = vec![
            record(1, device),
            record(2, device),
            record(3, SignerId([7; 32])),
            held(record(4, strict)),
            definition,
        ];
        site.parts.plant.ledger.append(records).expect("acknowledged");
        let undecided = part.anchored_all(owner, strict, Duration::ZERO).await.expect_err("one may be released yet");
        let discarded = part.anchored_all(owner, SignerId([5; 32]), Duration::ZERO).await;
        discarded.expect("a definition stays when its messages are discarded");
        assert_eq!(undecided.kind, ErrorKind::Refused);
        assert!(
            undecided.message.contains(" 1 messages") && undecided.message.contains("quarantine"),
            "{}",
            undecided.message
        );
        let held = part.anchored_all(owner, device, Duration::ZERO).await.expect_err("two are on their way");
        assert_eq!(held.kind, ErrorKind::Unreachable);
        assert!(held.message.contains(" 2 records") && held.message.contains("--force"), "{}", held.message);
        site.stop().await;
    }
}
