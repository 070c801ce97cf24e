//! What is left of a record that its owner had erased, for a reader who never had it.

use super::GatewayDesk;
use crate::crypto::ErasedStatement;
use crate::gateway::{Caller, Code, ErasedRecord, Refusal};
use crate::model::Digest;
use crate::pipeline::Network;
use crate::pipeline::retention;
use crate::pipeline::retention::{is_owners, left_of};
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
        let unknown = || Refusal::new(Code::Tampered, format_args!("the signer of record {} is unknown", row.id));
        let record = left_of(plant, &network, &row, retained.header).map_err(Refusal::because(Code::Internal))?;
        Ok(ErasedRecord { record: record.ok_or_else(unknown)?, statement })
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
        let kept = plant.ledger.kept_erasure(row.digest).map_err(&internal)?;
        let kept = kept.and_then(|kept| ErasedStatement::parse(&kept.statement).ok());
        if let Some(kept) = kept.filter(|kept| is_owners(network, row.owner, &kept.signer)) {
            return Ok(Some(kept));
        }
        let Some(owner) = self.gateway.owners.all().into_iter().find(|owner| owner.address == row.owner) else {
            return Ok(None);
        };
        let keys = owner.sealing().filter(|keys| is_owners(network, row.owner, &keys.signing.public));
        let (Some(keys), true) = (keys, retained.anchored) else { return Ok(None) };
        let about = (&row.digest, retained.header.as_slice());
        let Some(erasure) = &retained.erased else {
            // What a rule deleted may be millions, and its statement goes to readers alone: it is not kept.
            let when = (retained.report, retained.deleted_at.unwrap_or_default());
            let stated = ErasedStatement::sign(plant.provider, &keys.signing, about, when);
            return stated.map(Some).map_err(Refusal::because(Code::Internal));
        };
        let keys = (&*keys.signing, &owner.eoa());
        let when = (retained.report, erasure.at);
        let stated = retention::stated(plant, keys, about, when).map_err(Refusal::because(Code::Internal))?;
        let statement = ErasedStatement::parse(&stated.statement).map_err(Refusal::because(Code::Internal))?;
        plant.ledger.keep_erasures(vec![stated]).map_err(&internal)?;
        Ok(Some(statement))
    }
}

#[cfg(test)]
#[path = "erased_tests.rs"]
mod tests;
