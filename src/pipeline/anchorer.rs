//! Puts the digests of stored records on the chain, one `dataUpload` each, in the owner's lane.

use tokio::task::block_in_place;

use crate::chain::Call;
use crate::model::{Digest, RecordState};
use crate::store::RecordRow;

use super::{Network, Owner, PipelineError, Plant, Sender};

/// Records a round: one ledger commit for so many signed transactions.
const ROUND: usize = 128;
/// Transactions of one account that may wait for a block.
const MOST_OPEN: usize = 1024;

/// Anchors up to [`ROUND`] stored records of `owner`; returns how many were submitted.
///
/// Records sealed under an epoch that the chain does not know yet wait for it.
///
/// # Errors
/// Of chain and ledger; nothing is lost, the records stay `stored`.
pub async fn anchor_round(
    plant: &Plant,
    network: &Network,
    sender: &Sender,
    owner: &Owner,
) -> Result<usize, PipelineError> {
    let open = block_in_place(|| plant.ledger.open_transactions(owner.address))?.len();
    if open >= MOST_OPEN {
        return Ok(0);
    }
    let rows = block_in_place(|| plant.ledger.in_state(Some(owner.address), RecordState::Stored, ROUND))?;
    let Some(account) = network.directory.account(owner.address) else { return Ok(0) };
    let calls: Vec<(Call, String, Vec<Digest>)> =
        rows.iter().filter_map(|row| account.tokens.get(&row.epoch).map(|token| upload(row, *token))).collect();
    if calls.is_empty() {
        return Ok(0);
    }
    let eoa = owner.eoa();
    Ok(sender.submit(&network.chain, &eoa, calls).await?.len())
}

fn upload(row: &RecordRow, token: crate::model::Token) -> (Call, String, Vec<Digest>) {
    let call = Call::DataUpload { digest: row.digest, token, timestamp: row.captured_at };
    (call, "dataUpload".to_owned(), vec![row.digest])
}
