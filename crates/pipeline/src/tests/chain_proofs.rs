//! The chain forgets old states; what was kept of them proves the same.

use authros_evidence::{Nodes, Slot};

use super::*;
use crate::pipeline::chain_proofs::{Collected, Rounds, Shown, collect, kept, slots};

/// So many states the embedded chain keeps, as many as geth.
const STATES: u64 = 128;

impl Line {
    /// Puts this many further batches on the chain, each in a block of its own.
    async fn go_on(&self, from: u64, blocks: u64) {
        for seq in from..from + blocks {
            self.append(1, seq, 1);
            self.drain(AnchorMode::Batch, seq, || false).await;
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_kept_of_a_block_proves_its_anchor_when_the_chain_has_forgotten_its_state() {
    let line = Line::new().await;
    let (chain, mut rounds) = (&line.network.chain, Rounds::default());
    assert_eq!(collect(&line.plant, &line.network, &mut rounds).await.expect("a round"), Collected::default());
    line.go_on(1, 2).await;
    let waiting = line.plant.ledger.proofs.unproven_batches(1 << 40, 9).expect("read");
    let [second, first] = waiting.as_slice() else { panic!("{waiting:?}") };
    let asked = slots(first.signers.iter().map(|(owner, signer)| Shown {
        owner: *owner,
        signer: *signer,
        keys: 1,
        anchor: Slot::anchor(first.account, first.root),
    }));
    assert_eq!((first.signers.len(), asked.len()), (1, 7), "anchor, account, loan and two versions of keys");
    let fetched: Nodes =
        chain.storage_nodes(first.block, &asked).await.expect("the state is there").into_iter().collect();
    let round = collect(&line.plant, &line.network, &mut rounds).await.expect("a round");
    assert_eq!(round, Collected { kept: 2, missed: 0, problem: None });
    let blocks = if std::env::var_os("AUTHROS_LONG").is_some() { STATES } else { 1 };
    line.go_on(3, blocks).await;
    assert_eq!(chain.storage_nodes(first.block, &asked).await.is_err(), blocks == STATES, "the chain has forgotten it");
    let found = kept(&line.plant, &line.network, first.block, &asked).await.expect("read").expect("kept");
    assert_eq!(found, fetched, "exactly what the chain gave for it");
    // Without the chain, what was kept of it says the same, and nothing is called verified.
    let absent = Network::kept(&line.plant, chain.pin().expect("pinned"), "it was wiped").expect("read");
    let found = kept(&line.plant, &absent, first.block, &asked).await.expect("read").expect("kept");
    assert_eq!(found, fetched);
    let known = |network: &Network| network.directory.account(line.owner.address).expect("registered").identities;
    assert_eq!(known(&absent), known(&line.network));
    let error = absent.chain.head().await.expect_err("nobody is asked").to_string();
    assert!(error.contains("the chain cannot be queried: it was wiped"), "{error}");
    // Nothing is said for another block's batch, or for what was not asked then.
    let other = slots([Shown {
        owner: crate::model::Address([9; 20]),
        signer: second.signers[0].1,
        keys: 1,
        anchor: Slot::anchor(second.account, second.root),
    }]);
    assert_eq!(kept(&line.plant, &line.network, first.block, &other).await.expect("read"), None);
    // Those of a long pause are gone already: asked for three times, then counted.
    if blocks == STATES {
        line.go_on(3 + blocks, 2).await;
        let mut results = Vec::new();
        for _ in 0..6 {
            let Collected { kept, missed, problem } =
                collect(&line.plant, &line.network, &mut rounds).await.expect("a round");
            results.push((kept, missed, problem.is_some()));
        }
        let refused = [(0, 0, true), (0, 0, true), (0, 2, true), (0, 0, false)];
        assert_eq!((&results[..2], &results[2..]), ([(64, 0, false); 2].as_slice(), refused.as_slice()));
        assert_eq!(line.plant.ledger.proofs.chain_proof_counts().expect("read").missed, 2);
    }
}
