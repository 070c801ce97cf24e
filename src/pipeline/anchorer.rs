//! Puts the digests of stored records on the chain, one `dataUpload` each, in the owner's lane.

use tokio::task::block_in_place;

use crate::chain::Call;
use crate::model::RecordState;
use crate::store::RecordRow;

use super::sender::Outgoing;
use super::{Network, Owner, PipelineError, Plant, Sender};

/// Records a round: one ledger commit for so many signed transactions.
const ROUND: usize = 128;

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
    let room = sender.room(owner.address)?.min(ROUND);
    if room == 0 {
        return Ok(0);
    }
    let rows = block_in_place(|| plant.ledger.in_state(Some(owner.address), RecordState::Stored, room))?;
    let Some(account) = network.directory.account(owner.address) else { return Ok(0) };
    let calls: Vec<Outgoing> =
        rows.iter().filter_map(|row| account.tokens.get(&row.epoch).map(|token| upload(row, *token))).collect();
    if calls.is_empty() {
        return Ok(0);
    }
    let eoa = owner.eoa();
    Ok(sender.submit(&network.chain, &eoa, calls).await?.len())
}

fn upload(row: &RecordRow, token: crate::model::Token) -> Outgoing {
    let call = Call::DataUpload { digest: row.digest, token, timestamp: row.captured_at };
    Outgoing { call, purpose: "dataUpload".to_owned(), digests: vec![row.digest] }
}
