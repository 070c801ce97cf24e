//! Records that their owner had erased before this reader fetched them: what is left of them is taken in if the owner states
//! it, the chain has their anchor, and the signer had the right. A gateway that only withholds a record cannot say so.

use tokio::task::block_in_place;

use crate::chain::AnchorProof;
use crate::crypto::{SealedRecord, check_deleted, signer_id};
use crate::gateway::ErasedRecord;
use crate::model::{Address, Digest, Header, RecordKind, RecordState};
use crate::pipeline::PipelineError;
use crate::pipeline::authority::{Moment, SigningRight, may_sign};
use crate::store::{NewRecord, StoreError, TakenErased};

use super::{Mirror, row_of};

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
        let ErasedRecord { record, statement } = erased;
        let (_, length) = Header::parse(&record.blob).map_err(|_| refused("its header is none"))?;
        let provider = self.plant.provider;
        let header = check_deleted(provider, &record.blob, digest, &record.signature, &record.signer)?;
        if length != record.blob.len() || header.kind != RecordKind::Data {
            return Err(refused("what is left of it is not the header of a message"));
        }
        if header.owner != owner || !self.network.accepts(&header.domain) {
            return Err(refused("it does not belong to the requested owner or network"));
        }
        let asked = row_of(&header, digest, &record);
        block_in_place(|| self.opener().topic_key(&asked))?;
        statement.check(provider, &digest, &record.blob)?;
        let now = Moment::newest(self.network.directory.now());
        let right = may_sign(&self.network.directory, owner, signer_id(&statement.signer), now);
        if !matches!(right, Ok(SigningRight::Owner(_))) {
            return Err(refused("that it was erased is not stated with its owner's key"));
        }
        let proof = AnchorProof::parse(&record.proof).map_err(|_| refused("it has no proof"))?;
        let proof = match self.anchors.confirm(self.network, &header, digest, proof).await {
            Err(PipelineError::NotSeen { .. }) => return Ok(false),
            confirmed => confirmed?,
        };
        if !self.check_signer(&header, digest, &record, Some(&proof)).await? {
            return Ok(false);
        }
        let taken = TakenErased {
            header: record.blob,
            report: statement.report,
            at: statement.at,
            statement: statement.encode(),
        };
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
