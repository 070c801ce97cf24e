//! Keys that the chain returns to their owner: the event that begins an epoch carries its key, wrapped for the owner's
//! own P_E, and a change of SM2 pairs hands the new ones to the keys before them. So the account's key and any d_E lead
//! to everything, however old the keyring is. A key of an epoch is believed only if the chain's token commits to it.

use crate::crypto::{
    EpochKey, GrantedKeys, IndexKey, SmKeyPair, WrappedKeys, hand_over, take_over, token, unwrap, wrap,
};
use crate::model::{GrantTerms, PublicKey, Scope};
use crate::{Network, Owner, PipelineError, Plant, Result, directory::kept, store::KeptEnvelope};

/// The terms under which an owner keeps an epoch's key for itself: those of a grant, which the contract refuses to
/// give to oneself.
fn terms(owner: &Owner, epoch: u64) -> GrantTerms {
    GrantTerms { owner: owner.address, grantee: owner.address, epoch, expiry: None, scope: Scope::All }
}

/// Wraps the key of an epoch in the keyring, and IK, for its owner.
pub fn own_envelope(plant: &Plant, network: &Network, owner: &Owner, epoch: u64) -> Result<Vec<u8>> {
    let key = owner.epoch_key(network.domain, epoch).ok_or(PipelineError::UnknownEpoch(epoch))?;
    let keys = GrantedKeys::All { epochs: vec![(epoch, key)], index_key: owner.index() };
    let wrapped = WrappedKeys { terms: terms(owner, epoch), keys };
    Ok(wrap(plant.provider, &network.domain, &wrapped, &owner.signing(), &owner.envelope().public)?)
}

/// Wraps an owner's next pairs, (d_C, P_C) and (d_E, P_E), for those that the chain has now.
pub fn handover(plant: &Plant, network: &Network, owner: &Owner, next: (&SmKeyPair, &SmKeyPair)) -> Result<Vec<u8>> {
    let registered = network.directory.identity(owner.address)?;
    Ok(hand_over(plant.provider, &network.domain, &owner.eoa(), next, &registered.envelope)?)
}

/// Oldest first. A key that the chain's token does not commit to counts as missing.
pub fn lacking(plant: &Plant, network: &Network, owner: &Owner) -> Result<Vec<u64>> {
    let mut lacking = Vec::new();
    for epoch in 1..=network.directory.epoch(owner.address) {
        let known = kept::token(&plant.ledger.rights, &network.directory, owner.address, epoch)?;
        if owner.token(network.domain, epoch) != known {
            lacking.push(epoch);
        }
    }
    Ok(lacking)
}

pub fn holds_current(network: &Network, owner: &Owner) -> bool {
    let account = network.directory.account(owner.address).unwrap_or_default();
    account.token.is_some() && owner.token(network.domain, account.epoch) == account.token
}

/// Saves in the keyring what the chain returns of the keys of these epochs; returns those that are still missing.
pub fn recover_epochs(plant: &Plant, network: &Network, owner: &Owner, lacking: &[u64]) -> Result<Vec<u64>> {
    let (Some(first), Some(last)) = (lacking.first(), lacking.last()) else { return Ok(Vec::new()) };
    let envelopes = plant.ledger.rights.own_envelopes(owner.address, *first, *last)?;
    // A keyring that knows no epoch of this network was made anew around the same keys: IK is the one of then.
    let blank = u64::try_from(lacking.len()).ok() == Some(network.directory.epoch(owner.address));
    let (mut found, mut index) = (Vec::<(u64, EpochKey)>::new(), None);
    for envelope in envelopes.iter().filter(|envelope| lacking.contains(&envelope.epoch)) {
        let Some((key, own_index)) = open_own(plant, network, owner, envelope)? else { continue };
        if own_index != owner.index() && !(blank && index.as_ref().is_none_or(|known| *known == own_index)) {
            continue;
        }
        index = Some(own_index);
        found.push((envelope.epoch, key));
    }
    let still = lacking.iter().copied().filter(|epoch| !found.iter().any(|(known, _)| known == epoch)).collect();
    if !found.is_empty() {
        owner.adopt(network.domain, found, index.filter(|index| *index != owner.index()))?;
    }
    Ok(still)
}

/// The key of the epoch, and IK, if the owner's keys open the envelope, it was signed by the owner's key of its time, and
/// the chain's token commits to the key.
fn open_own(
    plant: &Plant,
    network: &Network,
    owner: &Owner,
    envelope: &KeptEnvelope,
) -> Result<Option<(EpochKey, IndexKey)>> {
    let (epoch, domain) = (envelope.epoch, &network.domain);
    let expected = terms(owner, epoch);
    let signers = network.directory.identities_at(owner.address, envelope.block);
    let secrets = owner.envelopes();
    let pairs = signers.iter().flat_map(|signer| secrets.iter().map(move |secret| (signer, secret)));
    let mut opened = pairs.filter_map(|(signer, pair)| {
        unwrap(plant.provider, domain, &envelope.bytes, &expected, &signer.signing, &pair.secret).ok()
    });
    let Some(WrappedKeys { keys: GrantedKeys::All { epochs, index_key }, .. }) = opened.next() else {
        return Ok(None);
    };
    let Some((_, key)) = epochs.into_iter().find(|(number, _)| *number == epoch) else { return Ok(None) };
    let committed = kept::token(&plant.ledger.rights, &network.directory, owner.address, epoch)?;
    let good = committed == Some(token(domain, &owner.address, epoch, &key));
    Ok(good.then_some((key, index_key)))
}

/// Notes the SM2 pairs that the chain has and the keyring lacks as the next ones, and those between as former ones;
/// returns whether there were any. The caller puts them into use. `NoHandover` if no key here leads to the registered
/// pairs.
pub fn recover_pairs(plant: &Plant, network: &Network, owner: &Owner) -> Result<bool> {
    let registered = network.directory.identity(owner.address)?;
    let goal = (registered.signing, registered.envelope);
    if holds_pairs(owner, goal) {
        return Ok(false);
    }
    let (eoa, mut known) = (owner.eoa(), owner.envelopes());
    let mut opened: Vec<(SmKeyPair, SmKeyPair)> = Vec::new();
    for (identity, envelope) in kept::handed_over(&plant.ledger.rights, owner.address)? {
        let open = |pair: &SmKeyPair| {
            take_over(plant.provider, &network.domain, &eoa, &identity, &envelope, &pair.secret).ok()
        };
        if let Some(pairs) = known.iter().rev().find_map(open) {
            known.push(pairs.1.clone());
            opened.push(pairs);
        }
    }
    let newest = opened.iter().rposition(|(signing, pair)| (signing.public, pair.public) == goal);
    let Some(newest) = newest else {
        return if is_ahead(network, owner)? { Ok(false) } else { Err(PipelineError::NoHandover(owner.address)) };
    };
    opened.truncate(newest + 1);
    let Some((signing, envelope)) = opened.pop() else { return Ok(false) };
    owner.note_pairs(signing, envelope, opened)?;
    Ok(true)
}

/// Whether the keyring went past the pairs that the chain has now: the chain is an older copy, or its node is behind.
/// What leads from the registered pairs to newer ones must have been tried before ([`recover_pairs`]).
pub fn is_ahead(network: &Network, owner: &Owner) -> Result<bool> {
    let registered = network.directory.identity(owner.address)?;
    let holds = holds_pairs(owner, (registered.signing, registered.envelope));
    Ok(!holds && owner.envelopes().iter().any(|pair| pair.public == registered.envelope))
}

/// Whether the keyring has these as its pairs, or as the next ones.
fn holds_pairs(owner: &Owner, pairs: (PublicKey, PublicKey)) -> bool {
    owner.public_keys() == pairs || owner.next_public_keys() == pairs
}
