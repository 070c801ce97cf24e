//! The block of a proof's transaction, asked of a node that is a moment behind.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use async_trait::async_trait;
use serde_json::Value;

use super::*;
use crate::chain::{Chain, ChainOptions, Endpoint, Relay, RelayError, RelayLine};
use crate::crypto::EoaSecret;
use crate::pipeline::fixture::{by_hand, embedded, identity, network};

/// A node that has no receipt yet the first few times.
struct Late {
    chain: Chain,
    withheld: AtomicUsize,
}

#[async_trait]
impl Relay for Late {
    async fn ask(&self, method: &str, parameters: Value) -> Result<Value, RelayError> {
        let less = |left: usize| left.checked_sub(1);
        if method == "eth_getTransactionReceipt"
            && self.withheld.fetch_update(Ordering::AcqRel, Ordering::Acquire, less).is_ok()
        {
            return Ok(Value::Null);
        }
        self.chain.relay(method, &parameters).await
    }

    fn place(&self) -> String {
        "a node that is late".to_owned()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_block_that_comes_between_two_questions_is_found_and_none_that_never_comes() {
    let folder = tempfile::tempdir().expect("folder");
    let chain = embedded(folder.path(), None).await;
    let eoa = EoaSecret::generate().expect("key");
    chain.deploy(&eoa).await.expect("deploys");
    let transaction = by_hand(&chain, &eoa, &identity(&chain, &eoa)).await;
    let receipt = chain.receipt(transaction).await.expect("asked").expect("mined");
    // Blocks on top of it: it is as deep as it has to be.
    let other = EoaSecret::generate().expect("key");
    by_hand(&chain, &other, &identity(&chain, &other)).await;
    let (account, block, block_hash) = (eoa.address(), receipt.block, receipt.block_hash);
    let proof = AnchorProof { account, transaction, block, block_hash, inclusion: None };
    for (withheld, found) in [(0, true), (1, true), (2, false)] {
        let pinned = chain.pin();
        let contract = pinned.as_ref().map(|pin| pin.contract);
        let late = Arc::new(Late { chain: chain.clone(), withheld: AtomicUsize::new(0) });
        let endpoint = Endpoint::Relay(RelayLine(Arc::clone(&late) as Arc<dyn Relay>));
        let options = ChainOptions { endpoint, contract, pinned };
        let network = network(Chain::connect(options).await.expect("connects"));
        late.withheld.store(withheld, Ordering::Release);
        let answer = block_of(&network, &proof).await;
        match answer {
            Ok(place) => assert!(found && place == (block, block_hash), "{withheld}: {place:?}"),
            Err(Stop::Refused(Reason::NotAnchored(_))) => assert!(!found, "{withheld}"),
            Err(Stop::Later | Stop::Refused(_) | Stop::Failed(_)) => panic!("{withheld}: neither found nor refused"),
        }
    }
}
