//! An account's nonces as the node counts them, held against those signed here: a transaction signed for a nonce far ahead
//! would wait for ever.

use std::time::Duration;

use tokio::task::block_in_place;

use crate::chain::{Chain, ChainError, Nonces};
use crate::model::Address;
use crate::pipeline::PipelineError;

use super::Sender;

/// Transactions that others may have sent from the account without a second question.
const JUMP: u64 = 32;
/// Between two questions.
const PAUSE: Duration = Duration::from_millis(500);

impl Sender {
    /// Both next nonces of an account. Where they are far beyond what was signed here, the node is asked twice: a site
    /// that shares the account may have sent that many.
    ///
    /// # Errors
    /// Errors of chain and ledger; [`ChainError::Answer`] if the second answer contradicts the first.
    pub(super) async fn nonces(&self, chain: &Chain, account: Address) -> Result<Nonces, PipelineError> {
        let known = block_in_place(|| self.ledger.highest_nonce(account))?.map_or(0, |nonce| nonce + 1);
        let first = chain.nonces(account).await?;
        if first.pending <= known.saturating_add(JUMP) {
            return Ok(first);
        }
        tokio::time::sleep(PAUSE).await;
        let second = chain.nonces(account).await?;
        let likely = first.mined..=first.mined.saturating_add(JUMP);
        if likely.contains(&second.mined) && second.pending <= first.pending.saturating_add(JUMP) {
            return Ok(second);
        }
        let reason = format!("{} and then {} as the mined nonce contradict each other", first.mined, second.mined);
        Err(ChainError::Answer { url: chain.url(), method: "eth_getTransactionCount".to_owned(), reason }.into())
    }
}
