//! What a reader gets of a record that its owner had erased: header, signature, proof, and the owner's statement.

use super::GatewayDesk;
use super::standing::proof;
use crate::crypto::{ErasedStatement, signer_id};
use crate::gateway::command::ErasedRecord;
use crate::gateway::{Caller, Code, Fetched, Refusal};
use crate::model::{Address, Digest, PublicKey};
use crate::pipeline::Network;
use crate::pipeline::authority::{self, Moment, SigningRight, may_sign};
use crate::store::{RecordRow, Retained};

impl GatewayDesk {
    /// What is left of a record that the caller may read now and that its owner had erased.
    pub(super) fn erased(&self, caller: &Caller, digest: &Digest) -> Result<ErasedRecord, Refusal> {
        let (plant, internal) = (&self.gateway.plant, Refusal::because(Code::Internal));
        let network = self.fresh_network()?;
        let row = self.readable(&network, caller, digest)?;
        let retained = plant.ledger.retained(row.digest).map_err(&internal)?;
        let retained = retained.filter(|retained| retained.deleted_at.is_some());
        let none = || Refusal::new(Code::NotFound, format_args!("record {} was not erased by its owner", row.id));
        let retained = retained.ok_or_else(none)?;
        let statement = self.stated(&network, &row, &retained)?.ok_or_else(none)?;
        let signer = authority::key_of(plant, &network, &row).map_err(Refusal::because(Code::Internal))?;
        let unknown = || Refusal::new(Code::Tampered, format_args!("the signer of record {} is unknown", row.id));
        let place = plant.ledger.batch_place(row.digest).map_err(&internal)?;
        let proof = proof(&row, place).map(|proof| proof.encode()).unwrap_or_default();
        let (signer, signature) = (signer.ok_or_else(unknown)?, row.signature);
        Ok(ErasedRecord { record: Fetched { signer, signature, proof, blob: retained.header }, statement })
    }

    /// The owner's statement; signed now if it was erased before there were statements, or if the owner has another key
    /// since, and the owner's keys are here.
    fn stated(
        &self,
        network: &Network,
        row: &RecordRow,
        retained: &Retained,
    ) -> Result<Option<ErasedStatement>, Refusal> {
        let (plant, internal) = (&self.gateway.plant, Refusal::because(Code::Internal));
        let kept = plant.ledger.erasure_statement(row.digest).map_err(&internal)?;
        let kept = kept.and_then(|bytes| ErasedStatement::parse(&bytes).ok());
        if let Some(kept) = kept.filter(|kept| is_owners(network, row.owner, &kept.signer)) {
            return Ok(Some(kept));
        }
        let owner = self.gateway.owners.all().into_iter().find(|owner| owner.address == row.owner);
        let keys = owner.and_then(|owner| owner.sealing());
        let keys = keys.filter(|keys| is_owners(network, row.owner, &keys.signing.public));
        let (Some(keys), Some(erasure)) = (keys, retained.erased.as_ref().filter(|_| retained.anchored)) else {
            return Ok(None);
        };
        let (about, when) = ((&row.digest, retained.header.as_slice()), (retained.report, erasure.at));
        let stated = ErasedStatement::sign(plant.provider, &keys.signing, about, when);
        let stated = stated.map_err(Refusal::because(Code::Internal))?;
        plant.ledger.keep_erasure_statements(vec![(row.digest, stated.encode())]).map_err(&internal)?;
        Ok(Some(stated))
    }
}

/// Whether this is the key that an owner has now.
fn is_owners(network: &Network, owner: Address, key: &PublicKey) -> bool {
    let now = Moment::newest(network.directory.now());
    matches!(may_sign(&network.directory, owner, signer_id(key), now), Ok(SigningRight::Owner(_)))
}
