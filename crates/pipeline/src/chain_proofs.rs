//! Proofs of anchors, and of the chain's state (EIP-1186) for each batch, fetched while the node still has that state
//! and kept with the headers: a bundle made years later needs no node that keeps old states.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, PoisonError};

use authros_evidence::{BlockHeader, Nodes, Slot, Storage};
use tokio::{runtime::Handle, task::block_in_place};

use crate::chain::{AnchorProof, Chain, ChainError, Event, EventAt};
use crate::crypto::merkle::{Inclusion, KnownPaths, Leaf};
use crate::model::{Address, Hash, SignerId, Timestamp};
use crate::store::{BatchPlace, PlacedRecord, RecordRow, UnprovenBatch};
use crate::{Network, PipelineError, Plant, Result, crypto::fault};

/// Batches per round: each block costs the node two requests.
const AT_ONCE: usize = 64;
/// Requests for one block's proof: the node may just have been busy.
const ATTEMPTS: u32 = 3;

/// What is to be proven of the contract's storage for a record.
#[derive(Debug, Clone, Copy)]
pub struct Shown {
    pub owner: Address,
    pub signer: SignerId,
    /// The version of the owner's keys at the block; 0 if it was not registered then.
    pub keys: u64,
    /// Of its own digest, or of its batch's root.
    pub anchor: Slot,
}

#[derive(Debug, Default, PartialEq, Eq)]
pub struct Collected {
    pub kept: u64,
    /// Batches that will have none here.
    pub missed: u64,
    /// Why the last of those that failed did.
    pub problem: Option<String>,
}

#[derive(Debug, Default)]
pub struct Rounds {
    /// How often each block's proof was requested in vain.
    attempts: BTreeMap<u64, u32>,
    /// How many blocks after one its sealers need to confirm it; `None` before the first proof.
    further: Option<u64>,
    /// Blocks whose headers are still to be kept for that.
    awaited: BTreeSet<u64>,
}

pub fn slots(all: impl IntoIterator<Item = Shown>) -> Vec<Slot> {
    let mut slots = BTreeSet::new();
    for Shown { owner, signer, keys, anchor } in all {
        slots.extend([anchor.0, Slot::account(owner).0, Slot::loan(owner, &signer.0).0]);
        if keys != 0 {
            for version in [Slot::keys(owner, keys), Slot::keys(owner, keys + 1)] {
                slots.extend([version.0, version.next(1).0]);
            }
        }
    }
    slots.into_iter().map(Slot).collect()
}

/// The version of an account's keys in force at a block; 0 if it was not registered then.
pub fn key_version(network: &Network, owner: Address, block: u64) -> u64 {
    network.directory.with_account(owner, |account| {
        let identities = account.map(|account| account.identities.as_slice()).unwrap_or_default();
        u64::try_from(identities.iter().filter(|identity| identity.block <= block).count()).unwrap_or(0)
    })
}

/// Fetches missing proofs of confirmed batches, block by block, the newest first: the node forgets the oldest states
/// first. What the node refuses, or what does not prove the anchor, is asked for three times and then counted.
pub async fn collect(plant: &Plant, network: &Network, rounds: &mut Rounds) -> Result<Collected> {
    let head = network.chain.head().await?.number;
    let confirmed = (head + 1).saturating_sub(network.confirmations);
    let mut blocks: BTreeMap<(u64, Hash), Vec<UnprovenBatch>> = BTreeMap::new();
    for batch in plant.ledger.proofs.unproven_batches(confirmed, AT_ONCE)? {
        blocks.entry((batch.block, batch.block_hash)).or_default().push(batch);
    }
    rounds.attempts.retain(|block, _| blocks.keys().any(|(known, _)| known == block));
    let mut collected = Collected::default();
    for (at, batches) in blocks.into_iter().rev() {
        let keys: Vec<u64> = batches.iter().map(|batch| batch.key).collect();
        let count = keys.len() as u64;
        match proof(network, at, &batches).await {
            Ok(Some((header, nodes))) => {
                block_in_place(|| {
                    plant.ledger.proofs.keep_chain_proof(at, header, keys, nodes.into_hashed().collect())
                })?;
                rounds.await_after(network, at.0).await?;
                collected.kept += count;
            }
            // The chain has another block of that number now; the watcher is about to notice.
            Ok(None) => {}
            Err(Stop::Failed(error)) => return Err(error.into()),
            Err(Stop::Refused(why)) => {
                let attempt = rounds.attempts.entry(at.0).or_default();
                *attempt += 1;
                if *attempt >= ATTEMPTS {
                    plant.ledger.proofs.miss_chain_proof(keys)?;
                    collected.missed += count;
                }
                collected.problem = Some(why);
            }
        }
    }
    rounds.keep_headers(plant, network, confirmed).await?;
    Ok(collected)
}

impl Rounds {
    /// The headers after this block are to be kept too, as far as its sealers' quorum may need them.
    async fn await_after(&mut self, network: &Network, block: u64) -> Result<()> {
        let further = match self.further {
            Some(further) => further,
            None => u64::try_from(network.chain.sealing().await?.sealers.len() / 2).unwrap_or(0),
        };
        self.further = Some(further);
        self.awaited.extend((1..=further).map(|after| block.saturating_add(after)));
        Ok(())
    }

    async fn keep_headers(&mut self, plant: &Plant, network: &Network, confirmed: u64) -> Result<()> {
        if self.further.is_none()
            && let Some(newest) = plant.ledger.proofs.chain_proof_counts()?.newest
        {
            // A process that ended before may have left some.
            self.await_after(network, newest).await?;
        }
        while let Some(block) = self.awaited.first().copied().filter(|block| *block <= confirmed) {
            match network.chain.header_rlp(block).await {
                Ok(Some(header)) => plant.ledger.proofs.keep_chain_header(block, header)?,
                Err(error @ ChainError::Unreachable { .. }) => return Err(error.into()),
                Ok(None) | Err(_) => {}
            }
            self.awaited.remove(&block);
        }
        Ok(())
    }
}

enum Stop {
    /// Without the node nothing can be decided.
    Failed(ChainError),
    Refused(String),
}

impl From<ChainError> for Stop {
    fn from(error: ChainError) -> Self {
        match error {
            ChainError::Unreachable { .. } => Self::Failed(error),
            error => Self::Refused(error.to_string()),
        }
    }
}

/// The header of a block, and the nodes that prove the anchors; `None` if the chain has another block of that number.
async fn proof(
    network: &Network,
    (block, hash): (u64, Hash),
    batches: &[UnprovenBatch],
) -> Result<Option<(Vec<u8>, Nodes)>, Stop> {
    let mut wanted = Vec::new();
    for batch in batches {
        for (owner, signer) in &batch.signers {
            let (owner, signer, keys) = (*owner, *signer, key_version(network, *owner, block));
            wanted.push(Shown { owner, signer, keys, anchor: Slot::anchor(batch.account, batch.root) });
        }
    }
    let mut slots = slots(wanted);
    // Records that were anchored without a right leave their batch; its anchor is proven all the same.
    let left = batches.iter().filter(|batch| batch.signers.is_empty());
    slots.extend(left.map(|batch| Slot::anchor(batch.account, batch.root)));
    let bytes = network.chain.header_rlp(block).await?.unwrap_or_default();
    let header = BlockHeader::parse(&bytes).filter(|header| header.hash == hash);
    let Some(header) = header else { return Ok(None) };
    let nodes: Nodes = network.chain.storage_nodes(block, &slots).await?.into_iter().collect();
    let Some(pin) = network.chain.pin() else { return Ok(None) };
    match proven(&nodes, (header.state_root, pin.contract), &slots, batches) {
        Ok(nodes) => Ok(Some((bytes, nodes))),
        Err(why) => Err(Stop::Refused(format!("the node's proof for block {block} proves nothing: {why}"))),
    }
}

/// Checks proofs before they are kept: in some years nobody can fetch them again.
fn proven(
    nodes: &Nodes,
    (state, contract): (Hash, Address),
    slots: &[Slot],
    batches: &[UnprovenBatch],
) -> Result<Nodes, String> {
    let told = |error: authros_evidence::Unproven| error.to_string();
    let proving = nodes.proving(state, contract, slots).map_err(told)?;
    let storage = Storage::of(&proving, state, contract).map_err(told)?;
    for batch in batches {
        let anchor = storage.anchor(batch.account, batch.root).map_err(told)?;
        if anchor.is_none_or(|anchor| anchor.block != batch.block) {
            return Err(format!("it does not show the anchor of batch {}", batch.root));
        }
    }
    Ok(proving)
}

/// A block's header, RLP: from the chain, or as it was kept where that cannot be asked.
pub(crate) async fn header(plant: &Plant, network: &Network, block: u64) -> Result<Option<Vec<u8>>> {
    match network.absent {
        None => Ok(network.chain.header_rlp(block).await?),
        Some(_) => Ok(plant.ledger.proofs.chain_header(block)?),
    }
}

/// The kept nodes that show these slots in the state after a block, as the chain has it now; `None` if not all are kept.
pub(crate) async fn kept(plant: &Plant, network: &Network, block: u64, slots: &[Slot]) -> Result<Option<Nodes>> {
    let Some(kept) = plant.ledger.proofs.chain_proof(block)? else { return Ok(None) };
    let header = header(plant, network, block).await?.and_then(|bytes| BlockHeader::parse(&bytes));
    let Some(header) = header.filter(|header| header.hash == kept.hash) else { return Ok(None) };
    let Some(pin) = network.chain.pin() else { return Ok(None) };
    let nodes: Nodes = kept.nodes.into_iter().collect();
    Ok(nodes.proving(header.state_root, pin.contract, slots).ok())
}

/// The record's place on the chain; `None` before it is in a block.
pub fn anchor_proof(placed: PlacedRecord) -> Option<AnchorProof> {
    let (row, place) = placed.anchor();
    let (transaction, block, block_hash) = (row.transaction?, row.block?, row.block_hash?);
    let (account, inclusion) = match place {
        Some(place) => (place.account?, Some(place.inclusion)),
        None => (row.owner, None),
    };
    Some(AnchorProof { account, transaction, block, block_hash, inclusion })
}

pub fn is_included(place: &BatchPlace, row: &RecordRow) -> bool {
    place.inclusion.proves(&row.leaf()) || fault::is_off("proof")
}

/// Asks the chain whether the record's block has the root of its batch over the number of leaves its path was made for,
/// and otherwise whether the owner uploaded the digest itself there.
pub async fn is_anchored(plant: &Plant, network: &Network, row: &RecordRow) -> Result<bool> {
    if fault::is_off("anchor") {
        return Ok(true);
    }
    let chain = &network.chain;
    let placed = plant.ledger.records.placed(row.digest)?;
    // Its row may have moved since it was read: its block is the one of the place's own moment.
    let (anchored, place) = placed.map_or((row.block, None), |placed| (placed.row.block, placed.place));
    if let Some(place) = place
        && let (Some(account), Some(block)) = (place.account, place.block)
        && anchored.is_none_or(|anchored| anchored == block)
    {
        let (root, count) = (place.inclusion.root, place.inclusion.count);
        return Ok(is_root_in(chain, account, root, count, block).await? && is_included(&place, row));
    }
    let uploaded = chain.uploaded_at(row.owner, row.digest).await?;
    Ok(uploaded.is_some_and(|uploaded| anchored.is_none_or(|block| block == uploaded)))
}

/// Whether an account anchored a root over this many leaves in this very block: for the first time, according to the
/// contract's state, or again, according to the block's events.
pub async fn is_root_in(
    chain: &Chain,
    account: Address,
    root: Hash,
    count: u64,
    block: u64,
) -> Result<bool, ChainError> {
    match chain.root_anchored(account, root).await? {
        None => return Ok(false),
        Some((first, counted)) if first == block => return Ok(counted == count),
        Some(_) => {}
    }
    let found = chain.anchors_of(root, block, block).await?;
    let same = |event: &Event| matches!(event, Event::Anchored { account: by, count: over, .. } if (*by, *over) == (account, count));
    Ok(found.iter().any(|at| at.block == block && same(&at.event)))
}

/// What the ledger itself knows: the watcher saw the record's anchor, and if that is a root the path leads to it.
pub fn was_sighted(plant: &Plant, row: &RecordRow) -> Result<bool> {
    Ok(were_sighted(plant, &[row])?.contains(&true))
}

/// In order, all of one moment.
pub fn were_sighted(plant: &Plant, rows: &[&RecordRow]) -> Result<Vec<bool>> {
    let digests: Vec<_> = rows.iter().map(|row| row.digest).collect();
    let places = plant.ledger.records.places(&digests)?;
    let leaves: Vec<Leaf> = rows.iter().map(|row| row.leaf()).collect();
    let (known, mut sighted) = (KnownPaths::default(), Vec::with_capacity(rows.len()));
    for ((row, place), leaf) in rows.iter().zip(&places).zip(Leaf::hashes(&leaves)) {
        let leads = match place.as_ref().filter(|place| place.block.is_some()).map(|place| &place.inclusion) {
            None => true,
            Some(Inclusion { index, count, path, root }) => {
                known.lead(leaf, (*index, *count), path, *root) || fault::is_off("proof")
            }
        };
        sighted.push(row.block.is_some() && leads);
    }
    Ok(sighted)
}

// Times of blocks: included with the events if the node does so, otherwise requested from the chain, and cached.

/// The most times cached.
const MOST: usize = 16_384;

pub struct BlockTimes {
    known: Mutex<BTreeMap<u64, Timestamp>>,
    /// The runtime on which threads outside it can query the chain.
    runtime: Option<Handle>,
}

impl Default for BlockTimes {
    fn default() -> Self {
        Self { known: Mutex::default(), runtime: Handle::try_current().ok() }
    }
}

impl BlockTimes {
    pub(super) fn note(&self, at: &EventAt) {
        if let Some(time) = at.timestamp {
            self.keep(at.block, Timestamp::from_seconds(time));
        }
    }

    fn keep(&self, block: u64, time: Timestamp) {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if known.len() >= MOST && !known.contains_key(&block) {
            known.pop_first();
        }
        known.insert(block, time);
    }

    /// Blocks from this one on were replaced.
    pub(super) fn forget_from(&self, block: u64) {
        drop(self.known.lock().unwrap_or_else(PoisonError::into_inner).split_off(&block));
    }

    fn of(&self, block: u64) -> Option<Timestamp> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner).get(&block).copied()
    }
}

impl Network {
    /// As stated by the block's maker. Asks the chain if unknown; `Unsteady` if there is no such block (any more).
    pub fn time_of(&self, block: u64) -> Result<Timestamp> {
        if let Some(time) = self.times.of(block) {
            return Ok(time);
        }
        let runtime = self.times.runtime.as_ref().ok_or(PipelineError::Unsteady)?;
        block_in_place(|| runtime.block_on(self.ask_time(block)))
    }

    /// Same, for tasks.
    pub async fn ask_time(&self, block: u64) -> Result<Timestamp> {
        if let Some(time) = self.times.of(block) {
            return Ok(time);
        }
        let found = self.chain.block(block).await?.ok_or(PipelineError::Unsteady)?;
        let time = Timestamp::from_seconds(found.timestamp);
        self.times.keep(block, time);
        Ok(time)
    }
}
