//! Records that their owner had erased before this reader fetched them: what is left of them is taken in if the owner states
//! it, the chain has their anchor, and the signer had the right. A gateway that only withholds a record cannot say so.

use std::time::Duration;

use tokio::task::block_in_place;

use crate::chain::AnchorProof;
use crate::crypto::{ErasedStatement, SealedRecord, check_deleted, signer_id};
use crate::gateway::ErasedRecord;
use crate::model::{Address, Digest, Header, RecordState};
use crate::pipeline::authority::{Moment, SigningRight, may_sign};
use crate::pipeline::{Network, PipelineError, Plant};
use crate::store::{NewRecord, StoreError, TakenErased};

use super::{Anchors, BEHIND, Mirror, check_right, row_of};

impl Mirror<'_> {
    /// Takes in what is left of a record that its owner had erased. Returns whether anything changed.
    ///
    /// # Errors
    /// [`PipelineError::NotTakenIn`] or an error of the signature if a claim is invalid, otherwise errors of chain and ledger.
    pub async fn take_erased(
        &self,
        owner: Address,
        digest: Digest,
        erased: ErasedRecord,
    ) -> Result<bool, PipelineError> {
        let refused = |why: &str| PipelineError::NotTakenIn { digest, why: why.to_owned() };
        let (header, _) = Header::parse(&erased.record.blob).map_err(|_| refused("its header is none"))?;
        if header.owner != owner {
            return Err(refused("it does not belong to the requested owner"));
        }
        let asked = row_of(&header, digest, &erased.record);
        block_in_place(|| self.opener().topic_key(&asked))?;
        let proven = prove_erased(self.plant, self.network, &self.anchors, (digest, &erased), BEHIND).await?;
        let Some((header, proof)) = proven else { return Ok(false) };
        let ErasedRecord { record, statement } = erased;
        let taken = taken_erased(record.blob, &statement);
        let sealed = SealedRecord { header, blob: Vec::new(), digest, signature: record.signature };
        block_in_place(|| Ok(self.note(sealed, taken)? && self.prove(owner, digest, proof)?))
    }

    fn note(&self, sealed: SealedRecord, taken: TakenErased) -> Result<bool, PipelineError> {
        let digest = sealed.digest;
        let row = NewRecord { local_copy: None, state: RecordState::Stored, ..NewRecord::foreign(sealed, self.keeper) };
        self.plant.ledger.take_erased(row, taken).map_err(|error| match error {
            StoreError::Conflict { .. } => {
                PipelineError::NotTakenIn { digest, why: "its number belongs to another record".to_owned() }
            }
            error => error.into(),
        })
    }
}

/// What the ledger notes of an erased record.
pub fn taken_erased(header: Vec<u8>, statement: &ErasedStatement) -> TakenErased {
    TakenErased { header, report: statement.report, at: statement.at, statement: statement.encode() }
}

/// Holds what is left of an erased record against the chain: the record's signature, its owner's statement by the key of
/// now, the anchor, and the signer's right at that block, which the watcher has `patience` to read. `None` if the chain may have
/// the anchor's block later.
///
/// # Errors
/// [`PipelineError::NotTakenIn`] or [`PipelineError::Crypto`] if a claim is invalid, otherwise errors of chain and ledger.
pub async fn prove_erased(
    plant: &Plant,
    network: &Network,
    anchors: &Anchors,
    (digest, erased): (Digest, &ErasedRecord),
    patience: Duration,
) -> Result<Option<(Header, AnchorProof)>, PipelineError> {
    let refused = |why: &str| PipelineError::NotTakenIn { digest, why: why.to_owned() };
    let ErasedRecord { record, statement } = erased;
    let (_, length) = Header::parse(&record.blob).map_err(|_| refused("its header is none"))?;
    let header = check_deleted(plant.provider, &record.blob, digest, &record.signature, &record.signer)?;
    if length != record.blob.len() || !header.kind.is_content() {
        return Err(refused("what is left of it is not the header of a message or an attachment"));
    }
    if header.domain != network.domain {
        return Err(refused("it does not belong to the network"));
    }
    statement.check(plant.provider, &digest, &record.blob)?;
    let now = Moment::newest(network.directory.now());
    let right = may_sign(&network.directory, header.owner, signer_id(&statement.signer), now);
    if !matches!(right, Ok(SigningRight::Owner(_))) {
        return Err(refused("that it was erased is not stated with its owner's key"));
    }
    let proof = AnchorProof::parse(&record.proof).map_err(|_| refused("it has no proof"))?;
    let proof = match anchors.confirm(network, &header, digest, proof).await {
        Err(PipelineError::NotSeen { .. }) => return Ok(None),
        confirmed => confirmed?,
    };
    check_right(plant, network, (&header, digest, record), (proof.block, patience)).await?;
    Ok(Some((header, proof)))
}
