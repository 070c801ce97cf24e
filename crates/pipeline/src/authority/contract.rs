//! The contract's own answer about a right to read (the paper's `dataQuery`), compared with what its events say.

use tokio::task::block_in_place;

use super::{Policy, ReadingRight, may_read};
use crate::chain::QueryAnswer;
use crate::model::Address;
use crate::pipeline::directory::kept;
use crate::pipeline::{Network, PipelineError, Plant};

/// Asks the contract whether `reader` may read what `owner` sealed in an epoch. `None` if the chain's events name no token
/// of that epoch, or there is no chain to ask.
///
/// # Errors
/// [`PipelineError::Contradicted`] if the answer differs from what the events say; errors of chain and ledger.
pub async fn ask_contract(
    plant: &Plant,
    network: &Network,
    reader: Address,
    owner: Address,
    epoch: u64,
) -> Result<Option<QueryAnswer>, PipelineError> {
    if network.absent.is_some() {
        return Ok(None);
    }
    let token = block_in_place(|| kept::token(&plant.ledger, &network.directory, owner, epoch))?;
    let Some(token) = token else { return Ok(None) };
    let answer = network.chain.data_query(reader, token, owner).await?;
    let expected = block_in_place(|| is_covered(plant, network, reader, owner, epoch))?;
    let claim = match answer {
        QueryAnswer { epoch: found, .. } if found != epoch => {
            format!("names epoch {found} for the token that {owner} registered for epoch {epoch}")
        }
        QueryAnswer { authorised: true, .. } if !expected => format!("lets {reader} read epoch {epoch} of {owner}"),
        QueryAnswer { authorised: false, .. } if expected => {
            format!("does not let {reader} read epoch {epoch} of {owner}")
        }
        QueryAnswer { .. } => return Ok(Some(answer)),
    };
    Err(PipelineError::Contradicted { claim, block: network.directory.newest() })
}

/// The contract's rule, applied to the events: a grant covers the epochs from its own on, and earlier ones that have an
/// envelope of their own. Keys of earlier epochs may also be inside a later envelope, which the contract cannot know.
fn is_covered(
    plant: &Plant,
    network: &Network,
    reader: Address,
    owner: Address,
    epoch: u64,
) -> Result<bool, PipelineError> {
    let directory = &network.directory;
    match may_read(directory, reader, owner, None, Policy::OwnSite) {
        Ok(ReadingRight::Own) => Ok(true),
        Ok(ReadingRight::Granted(grant)) => Ok(epoch >= grant.terms.epoch
            || kept::envelopes(&plant.ledger, &grant)?.iter().any(|envelope| envelope.epoch == epoch)),
        Err(_) => Ok(false),
    }
}
