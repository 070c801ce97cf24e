//! Moving to another chain: which chains a home has used before, and the owner's signed statement about it, which is
//! the first of the owner's records on the new one.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use tokio::task::block_in_place;

use crate::chain::{Call, Chain, Pin};
use crate::crypto::domain;
use crate::model::adoption::Adoption;
use crate::model::{Digest, Domain, Header, RecordKind, RecordState, Timestamp, Token};
use crate::store::{Anchors, Ledger, RecordRow, StoreError};

use super::directory::{Account, Told, kept};
use super::sender::Outgoing;
use super::statement::{self, Statement};
use super::{Directory, Former, Network, Owner, PipelineError, Plant, Sender, authority};

/// Where the steps are stored in the ledger.
pub const STEPS: &str = "adoptions";
/// The name that adoption records are filed under; no ROS name begins like this.
const TOPIC: &str = "authros/adoption";

/// A move from one chain to another.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Step {
    /// The old chain and contract.
    pub from: Pin,
    /// Those used from then on.
    pub to: Pin,
    /// When the operator decided.
    pub at: Timestamp,
    /// On the same chain: the last block in which the old contract was in use. `None` = another chain.
    pub until: Option<u64>,
}

impl Step {
    /// The old domain.
    pub fn left(&self) -> Domain {
        domain_of(&self.from)
    }

    /// The domain used from then on.
    pub fn taken(&self) -> Domain {
        domain_of(&self.to)
    }
}

/// What binds records to a pinned chain and contract.
pub fn domain_of(pin: &Pin) -> Domain {
    domain(pin.chain_id, &pin.genesis, &pin.contract)
}

/// All steps of this home, oldest first.
///
/// # Errors
/// Errors of the ledger; `StoreError::Corrupt` if the stored list is not a list of steps.
pub fn steps(ledger: &Ledger) -> Result<Vec<Step>, StoreError> {
    let Some(text) = ledger.setting(STEPS)? else { return Ok(Vec::new()) };
    let detail = "its list of adopted chains cannot be read".to_owned();
    serde_json::from_str(&text).map_err(|_| StoreError::Corrupt { file: ledger.path().to_owned(), detail })
}

/// The domains that this home used before `current`.
///
/// # Errors
/// See [`steps`].
pub fn earlier(ledger: &Ledger, current: Domain) -> Result<Vec<Domain>, StoreError> {
    let mut found: Vec<Domain> = steps(ledger)?.iter().map(Step::left).filter(|left| *left != current).collect();
    found.sort();
    found.dedup();
    Ok(found)
}

/// Contracts that this home used before on this very chain, and that can still be queried. What they knew of accounts
/// is stored once it has been read.
///
/// # Errors
/// Errors of chain and ledger.
pub async fn former(plant: &Plant, chain: &Chain) -> Result<Vec<Former>, PipelineError> {
    let mut found = Vec::new();
    for step in block_in_place(|| steps(&plant.ledger))? {
        let here = (step.from.chain_id, step.from.genesis) == (chain.chain_id(), chain.genesis());
        let Some(until) = step.until.filter(|_| here) else { continue };
        let (domain, bound) = (step.left(), chain.bound_to(step.from.clone()));
        let directory = Directory::new(domain, plant.provider);
        let known = block_in_place(|| kept::read_back(&plant.ledger, &directory))?;
        // The contract in use was stored up to some block; the rest of its time is read again.
        let whole = format!("rights-whole:{domain}:{until}");
        if !known || block_in_place(|| plant.ledger.setting(&whole))?.is_none() {
            let told = bound.events(step.from.deployed_at, until).await?;
            let told: Vec<Told> = told.iter().filter_map(|event| directory.judge(event)).collect();
            for told in &told {
                directory.take(told);
            }
            block_in_place(|| kept::keep(&plant.ledger, &directory, &told))?;
            block_in_place(|| plant.ledger.put_setting(&whole, "yes"))?;
        }
        found.push(Former { chain: bound, domain, directory: Arc::new(directory), until });
    }
    Ok(found)
}

/// The progress of an owner's statement about the last adoption.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Word {
    /// No statement is needed, or it is in a block.
    Given,
    /// It is on its way; nothing else of this owner is anchored before it.
    OnItsWay,
}

/// Seals the owner's adoption record if one is due, and puts it on the chain individually, before anything else. A
/// function of the ledger: called again, it does what is left.
///
/// # Errors
/// Errors of chain and ledger; nothing is lost.
pub async fn give_word(
    plant: &Plant,
    network: &Network,
    sender: &Sender,
    owner: &Owner,
) -> Result<Word, PipelineError> {
    // A record waiting for its owner's right would never be anchored: no other record goes before it.
    block_in_place(|| authority::settle_waiting(plant, network, owner.address))?;
    let row = match block_in_place(|| word_of(plant, network, owner))? {
        Due::Nothing => return Ok(Word::Given),
        Due::Later => return Ok(Word::OnItsWay),
        // If it is in a batch, it goes with the batch.
        Due::Sealed(row) if row.state == RecordState::Batched || !row.state.is_before_block() => {
            return Ok(Word::Given);
        }
        Due::Sealed(row) => row,
    };
    let token = block_in_place(|| kept::token(&plant.ledger, &network.directory, owner.address, row.epoch))?;
    if let Some(token) = token.filter(|_| row.state == RecordState::Stored)
        && sender.room(owner.address)? > 0
    {
        let digest = row.digest;
        let call = Call::DataUpload { digest, token, timestamp: row.captured_at };
        let outgoing = Outgoing { call, purpose: "adoption".to_owned(), anchors: Anchors::Digests(vec![digest]) };
        sender.submit(&network.chain, &owner.eoa(), vec![outgoing]).await?;
    }
    Ok(Word::OnItsWay)
}

/// What an owner has to state about the last adoption.
enum Due {
    /// Nothing.
    Nothing,
    /// A statement, as soon as there are keys to seal it with.
    Later,
    /// This record.
    Sealed(Box<RecordRow>),
}

fn word_of(plant: &Plant, network: &Network, owner: &Owner) -> Result<Due, PipelineError> {
    let Some((key, step)) = due(plant, network, owner)? else { return Ok(Due::Nothing) };
    let known = plant.ledger.setting(&key)?.and_then(|text| text.parse::<Digest>().ok());
    let digest = match known {
        Some(digest) => digest,
        None => {
            let Some(digest) = seal_word(plant, network, owner, &step)? else { return Ok(Due::Later) };
            plant.ledger.put_setting(&key, &digest.to_hex())?;
            digest
        }
    };
    let row = plant.ledger.record(digest)?.ok_or_else(|| PipelineError::NoRecord(digest.to_hex()))?;
    Ok(Due::Sealed(Box::new(row)))
}

/// Whether the owner's statement about the last adoption is in a block, or none is due.
///
/// # Errors
/// Errors of the ledger.
pub fn is_given(plant: &Plant, network: &Network, owner: &Owner) -> Result<bool, PipelineError> {
    let Some((key, _)) = due(plant, network, owner)? else { return Ok(true) };
    let digest = plant.ledger.setting(&key)?.and_then(|text| text.parse::<Digest>().ok());
    let row = digest.map(|digest| plant.ledger.record(digest)).transpose()?.flatten();
    Ok(row.is_some_and(|row| !row.state.is_before_block()))
}

/// The token under which a record is uploaded individually: that of its own epoch, or, if it was sealed for an earlier
/// domain, the current one.
///
/// # Errors
/// Errors of ledger and vault.
pub fn token_of(
    plant: &Plant,
    network: &Network,
    account: &Account,
    row: &RecordRow,
) -> Result<Option<Token>, PipelineError> {
    let own = kept::token(&plant.ledger, &network.directory, row.owner, row.epoch)?;
    if own.is_some() || network.earlier.is_empty() {
        return Ok(own);
    }
    let sealed_for =
        plant.vault.get(row.digest)?.and_then(|blob| Header::parse(&blob).ok()).map(|(header, _)| header.domain);
    let earlier = sealed_for.is_some_and(|domain| network.earlier.contains(&domain));
    Ok(account.token.filter(|_| earlier))
}

/// Where the owner's statement about the last step is stored, if one is due: the owner had an epoch on the old chain.
fn due(plant: &Plant, network: &Network, owner: &Owner) -> Result<Option<(String, Step)>, PipelineError> {
    if network.earlier.is_empty() {
        return Ok(None);
    }
    let steps = steps(&plant.ledger)?;
    let number = steps.len();
    let last = steps.into_iter().last().filter(|step| step.taken() == network.domain);
    let last = last.filter(|step| !owner.epochs(step.left()).is_empty());
    Ok(last.map(|step| (format!("adoption:{number}:{}", owner.address), step)))
}

fn seal_word(plant: &Plant, network: &Network, owner: &Owner, step: &Step) -> Result<Option<Digest>, PipelineError> {
    let Some(keys) = owner.sealing().filter(|keys| keys.domain == network.domain) else { return Ok(None) };
    let counts = plant.ledger.counts(Some(owner.address))?;
    let verified = counts.data_in(RecordState::Verified);
    let adoption = Adoption {
        from: step.left(),
        to: network.domain,
        last_epoch: owner.epochs(step.left()).last().copied().unwrap_or(0),
        verified,
        others: counts.pending(),
    };
    let body = adoption.encode();
    let type_name = "authros/Adoption";
    let statement = Statement { kind: RecordKind::Adoption, topic: TOPIC, type_name, body: &body };
    statement::state(plant, owner.address, &keys, statement)
}
