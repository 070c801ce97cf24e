//! What is left of a record that its owner had erased: for a reader who never had it, and for the other gateways of the fleet,
//! which erase their copies.

use std::sync::PoisonError;

use super::GatewayDesk;
use super::standing::proof;
use crate::crypto::{AccountSignature, ErasedStatement, signer_id};
use crate::gateway::command::erasures::MOST_ERASURES;
use crate::gateway::{Caller, Code, ErasedRecord, ErasurePlace, Erasures, Fetched, Refusal, ToldErasure};
use crate::model::{Address, Digest, Header, PublicKey};
use crate::pipeline::authority::{self, Moment, SigningRight, may_sign};
use crate::pipeline::retention::erasing;
use crate::pipeline::{Network, Owner};
use crate::service::event::NoticeLevel;
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
        let record = self.left_of(&network, &row, retained.header)?;
        Ok(ErasedRecord { record, statement })
    }

    /// A record without its message: the header in place of its bytes.
    fn left_of(&self, network: &Network, row: &RecordRow, header: Vec<u8>) -> Result<Fetched, Refusal> {
        let (plant, internal) = (&self.gateway.plant, Refusal::because(Code::Internal));
        let signer = authority::key_of(plant, network, row).map_err(Refusal::because(Code::Internal))?;
        let unknown = || Refusal::new(Code::Tampered, format_args!("the signer of record {} is unknown", row.id));
        let place = plant.ledger.batch_place(row.digest).map_err(&internal)?;
        let proof = proof(row, place).map(|proof| proof.encode()).unwrap_or_default();
        Ok(Fetched { signer: signer.ok_or_else(unknown)?, signature: row.signature, proof, blob: header })
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
        let stated = erasing::stated(plant, keys, about, when).map_err(Refusal::because(Code::Internal))?;
        let statement = ErasedStatement::parse(&stated.statement).map_err(Refusal::because(Code::Internal))?;
        plant.ledger.keep_erasures(vec![stated]).map_err(&internal)?;
        Ok(Some(statement))
    }

    /// What was erased here behind a place, as far as its owners have stated it with both keys.
    pub(super) fn told_erasures(&self, caller: &Caller, after: ErasurePlace) -> Result<Erasures, Refusal> {
        let network = self.among_fellows(caller)?;
        for owner in self.gateway.owners.all() {
            self.restate(&network, &owner);
        }
        let ledger = &self.gateway.plant.ledger;
        let here = ledger.recorder();
        let after = if after.ledger == here { after.number } else { 0 };
        let page = ledger.erasures(after, MOST_ERASURES).map_err(Refusal::because(Code::Internal))?;
        let mut told = Vec::with_capacity(page.erasures.len());
        for (digest, statement, account) in page.erasures {
            told.extend(self.told(&network, digest, (&statement, &account))?);
        }
        Ok(Erasures { told, next: ErasurePlace { ledger: here, number: page.last.unwrap_or(after) }, more: page.more })
    }

    /// `None` if nobody would take it now: its owner has another key, or its anchor is in no batch of a block.
    fn told(
        &self,
        network: &Network,
        digest: Digest,
        (statement, account): (&[u8], &[u8]),
    ) -> Result<Option<ToldErasure>, Refusal> {
        let (ledger, internal) = (&self.gateway.plant.ledger, Refusal::because(Code::Internal));
        let (Ok(statement), Ok(account)) = (ErasedStatement::parse(statement), account.try_into()) else {
            return Ok(None);
        };
        let Some(row) = ledger.record(digest).map_err(&internal)? else { return Ok(None) };
        let is_batched = ledger.batch_place(digest).map_err(&internal)?.is_some() && row.block.is_some();
        let retained = ledger.retained(digest).map_err(&internal)?;
        let is_of_here = |retained: &Retained| {
            Header::parse(&retained.header).is_ok_and(|(header, _)| header.domain == network.domain)
        };
        let is_told = is_batched && is_owners(network, row.owner, &statement.signer);
        let Some(retained) = retained.filter(|retained| is_told && is_of_here(retained)) else { return Ok(None) };
        match self.left_of(network, &row, retained.header) {
            Ok(record) => {
                let left = ErasedRecord { record, statement };
                Ok(Some(ToldErasure { digest, account_signature: AccountSignature(account), left }))
            }
            // What is not right here is nothing to tell; the audit of records speaks of it.
            Err(refusal) if refusal.code == Code::Tampered => Ok(None),
            Err(refusal) => Err(refusal),
        }
    }

    /// Once for each key of an owner: what was erased under an earlier one, or before accounts signed, is stated anew.
    fn restate(&self, network: &Network, owner: &Owner) {
        let keys = owner.sealing().filter(|keys| is_owners(network, owner.address, &keys.signing.public));
        let Some(keys) = keys else { return };
        let mut under = self.gateway.stated_under.lock().unwrap_or_else(PoisonError::into_inner);
        if under.get(&owner.address) == Some(&keys.signing.public) {
            return;
        }
        let done = erasing::restate(&self.gateway.plant, owner, &keys.signing).unwrap_or_else(|error| {
            let text =
                format!("what {} had erased is not stated anew, so other gateways may keep it: {error}", owner.profile);
            self.gateway.hub.notice(NoticeLevel::Warning, &text);
            true
        });
        if done {
            under.insert(owner.address, keys.signing.public);
        }
    }
}

/// Whether this is the key that an owner has now.
pub(super) fn is_owners(network: &Network, owner: Address, key: &PublicKey) -> bool {
    let now = Moment::newest(network.directory.now());
    matches!(may_sign(&network.directory, owner, signer_id(key), now), Ok(SigningRight::Owner(_)))
}

#[cfg(test)]
#[path = "erased_tests.rs"]
mod tests;
