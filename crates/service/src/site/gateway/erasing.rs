//! What another gateway of the fleet, or its owner, says was erased: each record is held against the chain that is known here,
//! and its owner must have stated it with both keys. Then the bytes here are named to be overwritten, or the record is listed without.

use std::time::Duration;

use tokio::task::block_in_place;

use super::GatewayDesk;
use super::round::{Here as _, Round, is_of_here};
use super::round_erased::TookErased;
use super::taking::Taking;
use crate::crypto::{ErasedStatement, SealedRecord, signer_id};
use crate::gateway::{Caller, Code, ErasureOutcome, Refusal, ToldErasure};
use crate::model::{Address, Digest, Header, RecordState};
use crate::pipeline::columns::header_difference;
use crate::pipeline::mirror::{prove_erased, taken_erased};
use crate::pipeline::retention::told::is_owners;
use crate::pipeline::{Network, PipelineError};
use crate::service::event::{NoticeLevel, Part};
use crate::store::{KeptErasure, NewRecord, RootSighting, StoreError, ToldErased};

/// How long the watcher here may lag behind the block of a proof.
const BEHIND: Duration = Duration::from_secs(3);

/// What is found of a record.
enum Judged {
    /// This owner's record is gone here too, or named.
    Taken(Address),
    /// Nothing is new.
    Known,
    /// It may be taken another time.
    Left,
    /// The chain here does not have the block of its anchor yet.
    Later,
}

impl GatewayDesk {
    /// Erases here what the caller had erased at home: what becomes of each, in order.
    pub(super) async fn erase_for(
        &self,
        caller: &Caller,
        told: Vec<ToldErasure>,
    ) -> Result<Vec<ErasureOutcome>, Refusal> {
        let network = self.known_network()?;
        if let Some(other) = told.iter().find(|one| !one.is_of(caller.account)) {
            let text = format_args!("record {} is not {}'s", other.digest, caller.account);
            return Err(Refusal::new(Code::NotAuthorised, text));
        }
        let here = Taking { desk: self, anchors: &self.gateway.anchors, copies: self.gateway.copies(self) };
        let (mut outcomes, mut count, mut ended) = (Vec::with_capacity(told.len()), 0, Ok(()));
        for one in told {
            match here.outcome(&network, one).await {
                Ok((outcome, is_new)) => {
                    count += u64::from(is_new);
                    outcomes.push(outcome);
                }
                Err(refusal) => {
                    ended = Err(refusal);
                    break;
                }
            }
        }
        if count > 0 {
            let subject = format!("{count} records of {}", caller.account);
            let written = self.gateway.log.write(&self.keeper.profile, "fleet erase", &subject, "told by their owner");
            if let Err(failure) = written.await {
                self.gateway.hub.notice(NoticeLevel::Warning, &failure.message);
            }
        }
        ended.map(|()| outcomes)
    }
}

impl Taking<'_> {
    /// What becomes of one record at its owner's word, and whether that is new.
    async fn outcome(&self, network: &Network, told: ToldErasure) -> Result<(ErasureOutcome, bool), Refusal> {
        match self.erase_one(network, told).await {
            Ok(Judged::Taken(_)) => Ok((ErasureOutcome::Taken, true)),
            Ok(Judged::Known) => Ok((ErasureOutcome::Taken, false)),
            Ok(Judged::Left | Judged::Later) => Ok((ErasureOutcome::Left, false)),
            Err(refusal) if is_of_here(refusal.code) => Err(refusal),
            Err(_) => Ok((ErasureOutcome::Refused, false)),
        }
    }

    /// Takes what holds, one after the other; with patience, only until an anchor that the chain here does not have yet.
    pub(super) async fn erase_told(
        &self,
        told: Vec<ToldErasure>,
        patient: bool,
        round: &mut Round,
    ) -> Result<TookErased, Refusal> {
        let network = self.desk.known_network()?;
        let mut took = TookErased::default();
        for one in told {
            match self.erase_one(&network, one).await {
                Ok(Judged::Taken(owner)) => *round.erased.entry(owner).or_default() += 1,
                Ok(Judged::Known) => {}
                Ok(Judged::Later) if patient => {
                    took.waits = true;
                    break;
                }
                Ok(Judged::Left | Judged::Later) => took.left += 1,
                Err(refusal) if is_of_here(refusal.code) => return Err(refusal),
                Err(refusal) => took.refused.push(refusal),
            }
        }
        Ok(took)
    }

    /// What can be said of it without a look at any signature.
    fn known(&self, network: &Network, header: &Header, digest: Digest) -> Result<Option<Judged>, Refusal> {
        let (ledger, internal) = (&self.desk.gateway.plant.ledger, Refusal::because(Code::Internal));
        let Some(row) = block_in_place(|| ledger.record(digest)).map_err(&internal)? else {
            return match self.welcomes(&header.owner) {
                Ok(()) => Ok(None),
                Err(refusal) if is_of_here(refusal.code) => Err(refusal),
                Err(_) => Ok(Some(Judged::Left)),
            };
        };
        if let Some(field) = header_difference(&row, header) {
            let text = format_args!("what is told of record {} differs from it in its {field}", row.id);
            return Err(Refusal::new(Code::Tampered, text));
        }
        let stands = |kept: &KeptErasure| {
            let statement = ErasedStatement::parse(&kept.statement);
            let current = statement.is_ok_and(|stated| is_owners(network, header.owner, &stated.signer));
            kept.account.is_some() && current
        };
        let is_known = match block_in_place(|| ledger.kept_erasure(digest)).map_err(&internal)? {
            // This home decided about it.
            None => row.deleted_at.is_some(),
            Some(kept) => !kept.taken || stands(&kept),
        };
        Ok(is_known.then_some(Judged::Known))
    }

    async fn erase_one(&self, network: &Network, told: ToldErasure) -> Result<Judged, Refusal> {
        let ToldErasure { digest, account_signature, left } = told;
        let (header, _) = Header::parse(&left.record.blob)?;
        // What was anchored in a contract or chain that was left stays where it is, as the records themselves do.
        if header.domain != network.domain {
            return Err(Refusal::new(Code::NotYours, format_args!("record {digest} is of another network")));
        }
        if let Some(judged) = self.known(network, &header, digest)? {
            return Ok(judged);
        }
        let (plant, statement) = (&self.desk.gateway.plant, &left.statement);
        statement
            .check_account(plant.provider, &account_signature, (&digest, &left.record.blob))
            .map_err(Refusal::because(Code::Signature))?;
        let owners = network.directory.registered_as(signer_id(&statement.signer)) == Some(header.owner);
        if owners && !is_owners(network, header.owner, &statement.signer) {
            // An earlier key of the owner, or one that is suspended: stated anew, it is told anew.
            return Ok(Judged::Left);
        }
        let proven = prove_erased(plant, network, self.anchors, (digest, &left), BEHIND).await;
        let Some((header, proof)) = proven.map_err(|error| failed(&error))? else { return Ok(Judged::Later) };
        let inclusion =
            proof.inclusion.ok_or_else(|| Refusal::new(Code::Malformed, "a gateway's anchors are batches"))?;
        let (account, transaction) = (proof.account, proof.transaction);
        let (block, block_hash) = (proof.block, proof.block_hash);
        let anchor =
            RootSighting { account, root: inclusion.root, count: inclusion.count, transaction, block, block_hash };
        let taken = taken_erased(left.record.blob, &left.statement);
        let (owner, signature) = (header.owner, left.record.signature);
        let sealed = SealedRecord { header, blob: Vec::new(), digest, signature };
        let row = NewRecord::foreign(sealed, self.desk.keeper.address);
        let row = NewRecord { local_copy: None, state: RecordState::Stored, ..row };
        let stated = (taken, account_signature.0.to_vec());
        match block_in_place(|| plant.ledger.take_told(row, stated, (inclusion, anchor))) {
            Ok(ToldErased::Listed | ToldErased::Named) => {
                self.desk.gateway.hub.confirmed.notify_one();
                self.desk.gateway.hub.changed(Part::Uploads);
                Ok(Judged::Taken(owner))
            }
            Ok(ToldErased::Restated) => Ok(Judged::Known),
            Ok(ToldErased::Unchanged) => Ok(Judged::Left),
            Err(StoreError::Replaced { .. }) => {
                self.anchors.forget();
                Ok(Judged::Later)
            }
            Err(error @ StoreError::Conflict { .. }) => Err(Refusal::new(Code::Malformed, error)),
            Err(error) => Err(Refusal::new(Code::Internal, error)),
        }
    }
}

/// A claim that does not hold is the other gateway's fault, everything else is the chain's.
fn failed(error: &PipelineError) -> Refusal {
    let code = match error {
        PipelineError::NotTakenIn { .. } => Code::Tampered,
        PipelineError::Crypto(_) => Code::Signature,
        _ => Code::Stale,
    };
    Refusal::new(code, error)
}

#[cfg(test)]
#[path = "erasing_tests.rs"]
pub(super) mod tests;
