//! Extra accounts of one owner that anchor batches in parallel, so that throughput is not limited by one nonce lane.
//! They are derived from the owner's EOA key; authorship stays with the SM2 signature in each record.

use tokio::task::block_in_place;

use crate::chain::Call;
use crate::crypto::{CryptoError, EoaSecret, anchoring_secret, prove, random_bytes};
use crate::model::{Domain, Token};

use super::{Network, Owner, PipelineError, Plant, Sender};

/// The most accounts that anchor for one owner, including the owner's own.
pub const MOST_LANES: u8 = 8;
/// The number of anchors an account gets ether for at a time.
const PROVISION: u128 = 500;
/// The gas assumed for one anchor and its share of the registration.
const ANCHOR_GAS: u128 = 120_000;
/// The purpose of a transfer that funds an extra account.
const PROVISION_PURPOSE: &str = "fund anchoring account";

/// The extra anchoring accounts of an owner on one network, for `lanes` accounts in total.
///
/// # Errors
/// [`CryptoError::SecretRange`] if a derived number is not a valid key, which does not happen in practice.
pub fn extra(owner: &EoaSecret, domain: &Domain, lanes: u8) -> Result<Vec<EoaSecret>, CryptoError> {
    (1..lanes.min(MOST_LANES)).map(|index| anchoring_secret(owner, domain, index)).collect()
}

/// Makes an extra account ready to anchor: with ether if the chain requires it, and registered. Returns whether it is ready
/// now; what is missing is done when this is called again.
///
/// # Errors
/// Errors of chain and ledger, and `NoEther` if the owner cannot pay.
pub async fn ensure_ready(
    plant: &Plant,
    network: &Network,
    sender: &Sender,
    owner: &Owner,
    key: &EoaSecret,
) -> Result<bool, PipelineError> {
    let account = key.address();
    let state = sender.state_of(account)?;
    if network.directory.identity(account).is_ok() {
        if state.paused.is_some() {
            provide(plant, network, sender, owner, key).await?;
        }
        return Ok(true);
    }
    if state.open > 0 {
        // Its registration is on the way, perhaps since before a restart.
        return Ok(false);
    }
    provide(plant, network, sender, owner, key).await?;
    let (signing, (_, envelope)) = (owner.signing(), owner.public_keys());
    // A token of its own that belongs to no key: these accounts seal nothing.
    let token = Token(random_bytes()?);
    let identity = prove(plant.provider, &network.domain, &account, &signing, &envelope, token)?;
    sender
        .send(&network.chain, key, Call::Register { identity, envelope: Vec::new() }, "register anchoring account")
        .await?;
    Ok(false)
}

/// Gives an extra account ether for its next anchors if it has too little: from a development node, otherwise from the
/// owner.
async fn provide(
    plant: &Plant,
    network: &Network,
    sender: &Sender,
    owner: &Owner,
    key: &EoaSecret,
) -> Result<(), PipelineError> {
    let (chain, account) = (&network.chain, key.address());
    // A transfer still waiting for its block is not in the balance yet.
    if block_in_place(|| plant.ledger.open_lane(owner.address))?.iter().any(|row| row.purpose == PROVISION_PURPOSE) {
        return Ok(());
    }
    let provision = chain.market().await?.offer().saturating_mul(ANCHOR_GAS * PROVISION);
    let held = chain.wealth(account).await?;
    if held >= provision / 4 || chain.fund_from_node(account).await? {
        return Ok(());
    }
    if chain.wealth(owner.address).await? < provision.saturating_mul(2) {
        return Err(PipelineError::NoEther(owner.address));
    }
    sender.transfer(chain, &owner.eoa(), account, provision - held, PROVISION_PURPOSE).await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn extra_accounts_are_distinct_and_follow_from_the_owner_and_the_network() {
        let owner = EoaSecret::from_slice(&[7; 32]).expect("key");
        let domain = Domain([1; 32]);
        let seven = extra(&owner, &domain, 200).expect("keys");
        assert_eq!(seven.len(), 7);
        let mut addresses: Vec<_> = seven.iter().map(EoaSecret::address).chain([owner.address()]).collect();
        addresses.sort();
        addresses.dedup();
        assert_eq!(addresses.len(), 8);
        assert_eq!(extra(&owner, &domain, 3).expect("keys"), seven[..2]);
        assert_ne!(extra(&owner, &Domain([2; 32]), 2).expect("keys"), seven[..1]);
        let other = EoaSecret::from_slice(&[8; 32]).expect("key");
        assert_ne!(extra(&other, &domain, 2).expect("keys"), seven[..1]);
        assert!(extra(&owner, &domain, 1).expect("none").is_empty());
    }
}
