//! What readers, and the gateway that the owner's home joins, learn of a record that its owner had erased: what is left of
//! it, and only what they would accept now.

use crate::crypto::{AccountSignature, ErasedStatement, signer_id};
use crate::gateway::{ErasedRecord, ErasureNotice, Fetched};
use crate::model::{Address, Digest, Header, PublicKey};
use crate::pipeline::authority::{Moment, SigningRight, key_of, may_sign};
use crate::pipeline::proof::anchor_proof;
use crate::pipeline::{Network, PipelineError, Plant};
use crate::store::{PlacedRecord, RecordRow, Retained};

/// A record without its message: the header in place of its bytes. `None` if its signer is unknown.
///
/// # Errors
/// Errors of the ledger.
pub fn left_of(
    plant: &Plant,
    network: &Network,
    row: &RecordRow,
    header: Vec<u8>,
) -> Result<Option<Fetched>, PipelineError> {
    let Some(signer) = key_of(plant, network, row)? else { return Ok(None) };
    let placed = plant.ledger.placed(row.digest)?;
    let proof = placed.and_then(anchor_proof).map(|proof| proof.encode()).unwrap_or_default();
    Ok(Some(Fetched { signer, signature: row.signature, proof, blob: header }))
}

/// The notice of an erased record, with the statement and the account's signature that the ledger has. `None` if nobody would
/// accept it now: its owner has another key, its anchor is in no batch of a block, or its signer is unknown.
///
/// # Errors
/// Errors of the ledger.
pub fn notice_of(
    plant: &Plant,
    network: &Network,
    (digest, statement, account): (Digest, &[u8], &[u8]),
) -> Result<Option<ErasureNotice>, PipelineError> {
    let ledger = &plant.ledger;
    let (Ok(statement), Ok(account)) = (ErasedStatement::parse(statement), account.try_into()) else {
        return Ok(None);
    };
    let Some(PlacedRecord { row, place }) = ledger.placed(digest)? else { return Ok(None) };
    let is_batched = place.is_some() && row.block.is_some();
    if !is_batched || !is_owners(network, row.owner, &statement.signer) {
        return Ok(None);
    }
    let is_of_here =
        |retained: &Retained| Header::parse(&retained.header).is_ok_and(|(header, _)| header.domain == network.domain);
    let Some(retained) = ledger.retained(digest)?.filter(is_of_here) else { return Ok(None) };
    let left = left_of(plant, network, &row, retained.header)?.map(|record| ErasedRecord { record, statement });
    Ok(left.map(|left| ErasureNotice { digest, account_signature: AccountSignature(account), left }))
}

/// Whether this is the key that an owner has now.
pub fn is_owners(network: &Network, owner: Address, key: &PublicKey) -> bool {
    let now = Moment::newest(network.directory.now());
    matches!(may_sign(&network.directory, owner, signer_id(key), now), Ok(SigningRight::Owner(_)))
}
