//! Erasures announced by owners: each is checked against the chain and both of the owner's keys; then the bytes here
//! are named to be overwritten, or the record is listed without bytes.

use std::fmt;
use std::time::Duration;

use super::GatewayDesk;
use super::desk::Result;
use crate::crypto::{ErasedStatement, SealedRecord, signer_id};
use crate::gateway::{Caller, Code, ErasedRecord, ErasureNotice, ErasureOutcome, Refusal};
use crate::model::{Digest, Header, counted};
use crate::pipeline::Network;
use crate::pipeline::columns::header_difference;
use crate::pipeline::intake::{Accepted, Intake, Reason, taken_erased};
use crate::pipeline::retention::{self, is_owners, left_of};
use crate::reply::Part;
use crate::store::{KeptErasure, NewRecord, RecordRow, Retained, RootSighting, StoreError, ToldErased};

/// Longest lag of the watcher here behind the block of a proof.
const BEHIND: Duration = Duration::from_secs(3);

enum Judged {
    /// Gone here too, or named.
    Taken,
    Known,
    /// May be taken later.
    Left,
}

impl GatewayDesk {
    /// Erases here what the caller had erased at home; returns the outcomes in order.
    pub async fn erase_for(&self, caller: &Caller, notices: Vec<ErasureNotice>) -> Result<Vec<ErasureOutcome>> {
        let network = self.known_network()?;
        if let Some(other) = notices.iter().find(|notice| !notice.is_of(caller.account)) {
            let text = format_args!("record {} is not {}'s", other.digest, caller.account);
            return Err(Refusal::new(Code::NotAuthorised, text));
        }
        let (mut outcomes, mut count, mut ended) = (Vec::with_capacity(notices.len()), 0, Ok(()));
        for notice in notices {
            let outcome = match self.erase_one(&network, notice).await {
                Ok(Judged::Taken) => {
                    count += 1;
                    ErasureOutcome::Taken
                }
                Ok(Judged::Known) => ErasureOutcome::Taken,
                Ok(Judged::Left) => ErasureOutcome::Left,
                // Nothing can be erased here now.
                Err(refusal) if matches!(refusal.code, Code::Stale | Code::Internal | Code::Closing) => {
                    ended = Err(refusal);
                    break;
                }
                Err(_) => ErasureOutcome::Refused,
            };
            outcomes.push(outcome);
        }
        if count > 0 {
            let subject = format!("{} of {}", counted(count, "record"), caller.account);
            let (log, profile) = (&self.gateway.parts.log, &self.place.keeper.profile);
            if let Err(failure) = log.write(profile, "gateway erase", &subject, "as their owner requested").await {
                self.gateway.parts.hub.warn(&failure.message);
            }
        }
        ended.map(|()| outcomes)
    }

    /// Decides without checking any signature, if possible.
    fn known(&self, network: &Network, header: &Header, digest: Digest) -> Result<Option<Judged>> {
        let ledger = &self.gateway.parts.plant.ledger;
        let Some(row) = ledger.records.find(digest).map_err(Refusal::internal)? else {
            return Ok(None);
        };
        if let Some(field) = header_difference(&row, header) {
            let text = format_args!("the statement about record {} differs from it in its {field}", row.id);
            return Err(Refusal::new(Code::Tampered, text));
        }
        let stands = |kept: &KeptErasure| {
            let statement = ErasedStatement::parse(&kept.statement);
            let current = statement.is_ok_and(|stated| is_owners(network, header.owner, &stated.signer));
            kept.account.is_some() && current
        };
        let is_known = match ledger.erasures.kept(digest).map_err(Refusal::internal)? {
            // Decided by this home.
            None => row.deleted_at.is_some(),
            Some(kept) => !kept.taken || stands(&kept),
        };
        Ok(is_known.then_some(Judged::Known))
    }

    async fn erase_one(&self, network: &Network, notice: ErasureNotice) -> Result<Judged> {
        let ErasureNotice { digest, account_signature, left } = notice;
        let (header, _) = Header::parse(&left.record.blob)?;
        if header.domain != network.domain {
            return Err(Refusal::new(Code::NotYours, format_args!("record {digest} is of another network")));
        }
        if let Some(judged) = self.known(network, &header, digest)? {
            return Ok(judged);
        }
        let (plant, statement) = (&self.gateway.parts.plant, &left.statement);
        statement
            .check_account(plant.provider, &account_signature, (&digest, &left.record.blob))
            .map_err(Refusal::because(Code::Signature))?;
        let owners = network.directory.registered_as(signer_id(&statement.signer)) == Some(header.owner);
        if owners && !is_owners(network, header.owner, &statement.signer) {
            // An earlier or suspended key of the owner: a new statement will be passed on.
            return Ok(Judged::Left);
        }
        let anchors = &self.gateway.anchors;
        let intake = Intake { plant, network, anchors, keeper: self.place.keeper.address, patience: BEHIND };
        let judged = intake.judge_erased(digest, &left).await.map_err(Refusal::because(Code::Stale))?;
        let (header, proof) = match judged {
            Ok(proven) => proven,
            Err(Accepted::Refused(refused)) => return Err(not_taken(&refused.reason, &refused)),
            Err(Accepted::Held(_) | Accepted::Later) => return Ok(Judged::Left),
        };
        let inclusion =
            proof.inclusion.ok_or_else(|| Refusal::new(Code::Malformed, "a gateway's anchors are batches"))?;
        let (account, transaction) = (proof.account, proof.transaction);
        let (block, block_hash) = (proof.block, proof.block_hash);
        let anchor =
            RootSighting { account, root: inclusion.root, count: inclusion.count, transaction, block, block_hash };
        let taken = taken_erased(left.record.blob, &left.statement);
        let sealed = SealedRecord { header, blob: Vec::new(), digest, signature: left.record.signature };
        let row = NewRecord { blob: None, ..NewRecord::foreign(sealed, self.place.keeper.address) };
        let stated = (taken, account_signature.0.to_vec());
        match plant.ledger.erasures.take_told(row, stated, (inclusion, anchor)) {
            Ok(ToldErased::Listed | ToldErased::Named) => {
                self.gateway.parts.hub.confirmed.notify_one();
                self.gateway.parts.hub.changed(Part::Uploads);
                Ok(Judged::Taken)
            }
            Ok(ToldErased::Restated) => Ok(Judged::Known),
            Ok(ToldErased::Unchanged) => Ok(Judged::Left),
            Err(StoreError::Replaced { .. }) => {
                anchors.forget();
                Ok(Judged::Left)
            }
            Err(error @ StoreError::Conflict { .. }) => Err(Refusal::new(Code::Malformed, error)),
            Err(error) => Err(Refusal::new(Code::Internal, error)),
        }
    }

    /// The remains of a readable record that its owner had erased.
    pub fn erased(&self, caller: &Caller, digest: &Digest) -> Result<ErasedRecord> {
        let plant = &self.gateway.parts.plant;
        let network = self.fresh_network()?;
        let row = self.readable(&network, caller, digest)?;
        let retained = plant.ledger.retention.find(row.digest).map_err(Refusal::internal)?;
        let retained = retained.filter(|retained| retained.deleted_at.is_some());
        let none = || Refusal::new(Code::NotFound, format_args!("record {} was not erased by its owner", row.id));
        let retained = retained.ok_or_else(none)?;
        let statement = self.stated(&network, &row, &retained)?.ok_or_else(none)?;
        let unknown = || Refusal::new(Code::Tampered, format_args!("the signer of record {} is unknown", row.id));
        let record = left_of(plant, &network, &row, retained.header).map_err(Refusal::internal)?;
        Ok(ErasedRecord { record: record.ok_or_else(unknown)?, statement })
    }

    /// The owner's statement; signed now if it predates statements or the owner's current key, and the keys are here.
    fn stated(&self, network: &Network, row: &RecordRow, retained: &Retained) -> Result<Option<ErasedStatement>> {
        let plant = &self.gateway.parts.plant;
        let kept = plant.ledger.erasures.kept(row.digest).map_err(Refusal::internal)?;
        let kept = kept.and_then(|kept| ErasedStatement::parse(&kept.statement).ok());
        if let Some(kept) = kept.filter(|kept| is_owners(network, row.owner, &kept.signer)) {
            return Ok(Some(kept));
        }
        let Some(owner) = self.gateway.parts.owners.all().into_iter().find(|owner| owner.address == row.owner) else {
            return Ok(None);
        };
        let keys = owner.sealing().filter(|keys| is_owners(network, row.owner, &keys.signing.public));
        let (Some(keys), true) = (keys, retained.anchored) else { return Ok(None) };
        let about = (&row.digest, retained.header.as_slice());
        let Some(erasure) = &retained.erased else {
            // Not kept: a rule may delete millions, and only readers get the statement.
            let when = (retained.report, retained.deleted_at.unwrap_or_default());
            let stated = ErasedStatement::sign(plant.provider, &keys.signing, about, when);
            return stated.map(Some).map_err(Refusal::internal);
        };
        let keys = (&*keys.signing, &owner.eoa());
        let when = (retained.report, erasure.at);
        let stated = retention::stated(plant, keys, about, when).map_err(Refusal::internal)?;
        let statement = ErasedStatement::parse(&stated.statement).map_err(Refusal::internal)?;
        plant.ledger.erasures.keep(vec![stated]).map_err(Refusal::internal)?;
        Ok(Some(statement))
    }
}

/// Refusals of the intake are the owner's fault.
pub fn not_taken(reason: &Reason, detail: impl fmt::Display) -> Refusal {
    let code = match reason {
        Reason::Crypto(_) => Code::Signature,
        Reason::Number => Code::Malformed,
        Reason::NotARecord
        | Reason::AnotherOwner
        | Reason::AnotherSigner
        | Reason::NoProof
        | Reason::NotAnchored(_)
        | Reason::NoRight(_)
        | Reason::FalseName(_)
        | Reason::NotErasable
        | Reason::NotStated
        | Reason::NumberedHere
        | Reason::Unopened(_) => Code::Tampered,
    };
    Refusal::new(code, detail)
}

#[cfg(test)]
#[path = "erasing_tests.rs"]
pub(super) mod tests;

#[cfg(test)]
#[path = "erased_tests.rs"]
mod erased_tests;
