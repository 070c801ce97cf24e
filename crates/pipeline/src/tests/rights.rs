//! Records nobody here anchors, records anchored without a right all the same, and how both continue.

use super::*;
use crate::crypto::{EoaSecret, SmKeyPair};
use crate::pipeline::authority::{NoRight, right_of};
use crate::pipeline::chain_proofs::{Collected, Rounds, collect};
use crate::pipeline::verifier::verify_round;

impl Line {
    async fn call(&self, call: Call) {
        self.sender.send(&self.network.chain, &self.owner.eoa(), call, "rights").await.expect("mined");
    }

    async fn round(&self, mode: AnchorMode, lanes: &[EoaSecret]) -> usize {
        let round =
            Anchorer::new(mode).round(&self.plant, &self.network, &self.sender, self.owner.address, lanes).await;
        round.expect("a round").submitted
    }

    /// Anchors what is stored, based on what was read of the chain so far.
    async fn send_one(&self, lanes: &[EoaSecret]) {
        while self.round(AnchorMode::Batch, lanes).await == 0 {
            tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        }
    }

    async fn tend(&self, lanes: &[EoaSecret]) {
        for key in lanes {
            self.sender.tend(&self.network.chain, key).await.expect("closed");
        }
    }

    /// Watches until this many records are confirmed; `anchors` says whether more is anchored meanwhile.
    async fn until_confirmed(&self, wanted: u64, anchors: bool, lanes: &[EoaSecret]) {
        while self.count(RecordState::Confirmed) < wanted {
            if anchors {
                self.round(AnchorMode::Batch, lanes).await;
            }
            self.watch().await;
            self.tend(lanes).await;
            tokio::time::sleep(std::time::Duration::from_millis(20)).await;
        }
        assert_eq!(self.count(RecordState::Confirmed), wanted);
    }

    async fn extra_account(&self) -> EoaSecret {
        let key = anchorer::extra(&self.owner.eoa(), &self.network.domain, 2).expect("keys").remove(0);
        anchorer::ensure_ready(&self.plant, &self.network, &self.sender, &self.owner, &key).await.expect("registers");
        self.watch().await;
        self.tend(std::slice::from_ref(&key)).await;
        key
    }

    fn signs(&self, block: u64) -> Result<(), NoRight> {
        let signer = signer_id(&self.owner.signing().public);
        right_of(&self.network, self.owner.address, signer, block).expect("known").map(drop)
    }

    fn is_whole(&self) {
        let counts = self.plant.ledger.counts.by_state(None).expect("counts");
        assert!(counts.is_conserved(), "{counts:?}");
        assert_eq!(self.plant.ledger.inspection.contradictions(), Ok(Vec::new()));
        for batch in self.plant.ledger.inspection.audit_batches(0, 100).expect("batches") {
            assert_eq!(batch.held, batch.count, "each place of a batch is accounted for");
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_was_anchored_inside_a_suspension_is_passed_over_waits_and_is_anchored_again() {
    let line = Line::new().await;
    let (account, lanes) = (line.owner.address, [line.extra_account().await]);
    line.append(1, 1, 20);
    line.call(Call::Suspend { account }).await;
    // The suspension is in a block that was not read yet: an account that is not suspended anchors the batch.
    line.send_one(&lanes).await;
    line.until_confirmed(20, false, &lanes).await;
    let first = line.rows(1)[0].block.expect("anchored");
    assert!(matches!(line.signs(first), Err(NoRight::Suspended { .. })));
    assert_eq!(verify_round(&line.plant, &line.network).expect("a round"), 20);
    assert_eq!((line.count(RecordState::Stored), line.count(RecordState::Tampered)), (20, 0));
    line.is_whole();
    let proofs = collect(&line.plant, &line.network, &mut Rounds::default()).await.expect("a round");
    assert_eq!(proofs, Collected { kept: 1, missed: 0, problem: None }, "of a batch that its records have left");

    line.append(2, 1, 5);
    assert_eq!(line.round(AnchorMode::Batch, &lanes).await, 0, "nobody anchors for a suspended owner");
    assert_eq!((line.count(RecordState::RightEnded), line.count(RecordState::Stored)), (25, 0));
    line.is_whole();

    line.call(Call::Restore { account }).await;
    line.watch().await;
    line.until_confirmed(25, true, &lanes).await;
    for row in line.rows(25) {
        let block = row.block.expect("anchored");
        assert!(block > first && line.signs(block).is_ok() && line.is_anchored(&row).await, "{row:?}");
    }
    line.is_whole();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_batch_that_was_passed_over_is_anchored_again_under_another_root() {
    let line = Line::new().await;
    let (account, lanes) = (line.owner.address, [line.extra_account().await]);
    line.append(1, 1, 7);
    line.call(Call::Suspend { account }).await;
    line.send_one(&lanes).await;
    line.until_confirmed(7, false, &lanes).await;
    let before = line.rows(7);
    verify_round(&line.plant, &line.network).expect("a round");
    line.call(Call::Restore { account }).await;
    line.watch().await;
    line.until_confirmed(7, true, &lanes).await;
    for (old, row) in before.iter().zip(line.rows(7)) {
        let place = line
            .plant
            .ledger
            .records
            .placed(row.digest)
            .expect("read")
            .and_then(|placed| placed.place)
            .expect("batched");
        assert!(row.block > old.block && place.block == row.block, "{row:?}");
        let other = RecordRow { seq: row.seq + 1, ..row.clone() };
        assert!(line.is_anchored(&row).await && !line.is_anchored(&other).await);
    }
    // The contract shows only a root's first block, so each has its own.
    let batches = line.plant.ledger.inspection.audit_batches(0, 9).expect("batches");
    assert!(batches.len() == 2 && batches[0].root != batches[1].root, "{batches:?}");
    line.is_whole();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn records_of_a_recalled_device_wait_and_go_on_when_it_is_lent_again() {
    let line = Line::new().await;
    let lanes = [line.owner.eoa()];
    let device = signer_id(&SmKeyPair::generate(line.plant.provider).expect("a pair").public);
    let of_device = |seq| NewRecord { signer: device, ..record(&line.owner, 3, seq) };
    line.call(Call::Lend { device, until: None }).await;
    line.watch().await;
    // In a closed batch with others, not sent yet.
    line.append(1, 1, 4);
    line.plant.ledger.records.append((1..=6).map(of_device).collect()).expect("acknowledged");
    let leaves = line.plant.ledger.batches.stored_leaves(line.owner.address, 100).expect("leaves");
    crate::pipeline::anchorer::close_batch(&line.plant, line.owner.address, leaves).expect("closed");
    line.call(Call::Recall { device }).await;
    line.watch().await;
    line.tend(&lanes).await;
    line.drain(AnchorMode::Batch, 4, || false).await;
    assert_eq!((line.count(RecordState::RightEnded), line.count(RecordState::Confirmed)), (6, 4));
    line.is_whole();
    line.call(Call::Lend { device, until: None }).await;
    line.watch().await;
    line.tend(&lanes).await;
    line.drain(AnchorMode::Batch, 10, || false).await;
    for row in line.rows(10) {
        assert!(line.is_anchored(&row).await, "{row:?}");
    }
    line.is_whole();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_digest_whose_own_upload_was_passed_over_goes_in_a_batch() {
    let line = Line::new().await;
    line.append(1, 1, 3);
    line.drain(AnchorMode::Each, 3, || false).await;
    let digests: Vec<Digest> = line.rows(3).iter().map(|row| row.digest).collect();
    assert_eq!(line.plant.ledger.batches.pass_over(&digests[..2]), Ok(2));
    assert_eq!(line.plant.ledger.batches.pass_over(&digests[..2]), Ok(0), "once");
    let left = line.plant.ledger.batches.passed_over_leaves(line.owner.address, 9).expect("read");
    assert!(left.len() == 2 && left.iter().all(|leaf| leaf.digest != digests[2]), "{left:?}");
    line.append(1, 4, 2);
    line.drain(AnchorMode::Each, 5, || false).await;
    for row in line.rows(5) {
        let batched =
            line.plant.ledger.records.placed(row.digest).expect("read").is_some_and(|placed| placed.place.is_some());
        assert_eq!(batched, digests[..2].contains(&row.digest), "the contract takes a digest once");
        assert!(line.is_anchored(&row).await, "{row:?}");
    }
    line.is_whole();
}
