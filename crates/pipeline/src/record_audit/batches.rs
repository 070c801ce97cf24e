//! Batches against the chain, in both directions: each of the ledger's must be there, and those that this home's
//! accounts anchored there must be in the ledger, chained root to root.

use std::collections::{HashMap, HashSet};

use tokio::{runtime::Handle, task::JoinSet};

use super::{FindingKind, Tally};
use super::{Network, Plant, Scope, Stop};
use crate::chain::{Chain, ChainError, Event, EventAt};
use crate::model::{Address, Digest, Hash, Timestamp, counted, grouped};
use crate::store::notes::{CopiedAt, RestoredAt};
use crate::store::{AuditedBatch, Inspection, Notes, StoreError};
use crate::{PipelineError, chain_proofs::is_root_in, record_audit};

/// Batches requested at once.
const PAGE: usize = 16;
/// Blocks whose events are read at a time.
const STRIDE: u64 = 2000;
/// Nodes drop receipts of blocks further below the head than this.
const RECEIPTS_KEPT: u64 = 100_000;
/// How far the clocks of a chain and of this machine may be apart, seconds.
const CLOCKS: u64 = 5;

pub(super) fn compare(
    plant: &Plant,
    network: Option<&Network>,
    scope: &Scope,
    runtime: &Handle,
    tally: &mut Tally,
) -> Result<(), StoreError> {
    let inspection = &plant.ledger.inspection;
    let mut asked = network;
    let mut after = 0;
    loop {
        let page = inspection.audit_batches(after, PAGE)?;
        let Some(last) = page.last() else { break };
        after = last.key;
        tally.audit.batches += u64::try_from(page.len()).unwrap_or(0);
        // Of a batch that another ledger closed, only what came here is known: a reader's grant covers some of it, and a
        // record that came twice has its place in the first proof.
        for batch in page.iter().filter(|batch| batch.closed_here && batch.held != batch.count) {
            let text = format!("the ledger has {} of its {}", grouped(batch.held), counted(batch.count, "record"));
            tally.find(FindingKind::Missing, &name(&batch.root), &text);
        }
        if let Some(network) = asked
            && let Some(error) = unanswered(runtime.block_on(compare_page(inspection, network, page, tally)))?
        {
            tally.find(FindingKind::Unreachable, "chain", &format!("not all batches were compared: {error}"));
            asked = None;
        }
    }
    if let Some(network) = asked
        && let Some(error) = unanswered(runtime.block_on(walk(plant, network, scope, tally)))?
    {
        tally.find(FindingKind::Unreachable, "chain", &format!("not all of its events were read: {error}"));
    }
    Ok(())
}

/// What the chain did not answer, for a finding; only the store ends an audit.
fn unanswered(done: Result<(), Stop>) -> Result<Option<ChainError>, StoreError> {
    match done {
        Ok(()) => Ok(None),
        Err(Stop::Chain(error)) => Ok(Some(error)),
        Err(Stop::Store(error)) => Err(error),
    }
}

fn name(root: &Hash) -> String {
    format!("batch {root}")
}

async fn compare_page(
    inspection: &Inspection,
    network: &Network,
    page: Vec<AuditedBatch>,
    tally: &mut Tally,
) -> Result<(), Stop> {
    let mut answers = JoinSet::new();
    for batch in page.into_iter().filter(|batch| batch.block.is_some()) {
        let chain = network.chain.clone();
        answers.spawn(async move { (differs(&chain, &batch).await, batch) });
    }
    while let Some(answer) = answers.join_next().await {
        let Ok((answer, batch)) = answer else { continue };
        if answer?.is_none() {
            continue;
        }
        // The chain may have been replaced below us, or a node that is behind have answered: what both say now counts.
        let now = inspection.audit_batches(batch.key - 1, 1)?.pop().filter(|now| now.key == batch.key).unwrap_or(batch);
        if now.block.is_none() {
            continue;
        }
        if let Some(text) = differs(&network.chain, &now).await? {
            tally.find(FindingKind::Tampered, &name(&now.root), &text);
        }
    }
    Ok(())
}

async fn differs(chain: &Chain, batch: &AuditedBatch) -> Result<Option<String>, ChainError> {
    let (Some(block), Some(account)) = (batch.block, batch.account) else {
        return Ok(Some("the ledger has it in a block but does not say who anchored it".to_owned()));
    };
    match chain.root_anchored(account, batch.root).await? {
        None => return Ok(Some(format!("{account} never anchored this root on the chain"))),
        Some((_, count)) if count != batch.count => {
            return Ok(Some(format!(
                "on the chain it covers {}, in the ledger {}",
                counted(count, "record"),
                grouped(batch.count)
            )));
        }
        // A skipped anchor is followed by another one of the same root.
        Some((found, _)) if found != block && !is_root_in(chain, account, batch.root, batch.count, block).await? => {
            return Ok(Some(format!("the chain has it in block {found}, the ledger in block {block}")));
        }
        Some(_) => {}
    }
    let Some(found) = chain.block(block).await? else {
        return Ok(Some(format!("the chain has no block {block}")));
    };
    if batch.block_hash.is_some_and(|hash| hash != found.hash) {
        return Ok(Some(format!("block {block} has a different hash on the chain than in the ledger")));
    }
    let Some(transaction) = batch.transaction else { return Ok(Some("the ledger names no transaction".to_owned())) };
    match chain.receipt(transaction).await? {
        Some(receipt) if receipt.block == block => Ok(None),
        None if chain.head().await?.number.saturating_sub(block) > RECEIPTS_KEPT => Ok(None),
        _ => Ok(Some(format!("transaction {transaction} is not in block {block}"))),
    }
}

/// Reads all of the contract's events: anchors by this home's accounts, and what the watcher should have taken in.
async fn walk(plant: &Plant, network: &Network, scope: &Scope, tally: &mut Tally) -> Result<(), Stop> {
    let mut own: HashSet<Address> = scope.accounts.iter().copied().collect();
    own.extend(plant.ledger.inspection.signing_accounts()?);
    let mut walk = Walk::new(&plant.ledger.notes, own.clone())?;
    walk.all(plant, network, Some(tally)).await?;
    if !walk.found.findings().is_empty() {
        // Blocks may have been replaced, or a node that is behind have answered, between two reads.
        walk = Walk::new(&plant.ledger.notes, own)?;
        walk.all(plant, network, None).await?;
    }
    if walk.elsewhere > 0 {
        tally.note(&format!(
            "batches or records of these accounts that another home anchored after this one was restored from a backup: {}",
            grouped(walk.elsewhere)
        ));
    }
    tally.join(walk.found);
    Ok(())
}

struct Walk {
    own: HashSet<Address>,
    previous: HashMap<Address, Hash>,
    /// The last block known to the backup that this ledger was restored from.
    copied_at: Option<u64>,
    restored_at: Timestamp,
    /// What the ledger lacks of later blocks, each with its block.
    later: Vec<(String, u64)>,
    elsewhere: u64,
    found: Tally,
}

impl Walk {
    fn new(notes: &Notes, own: HashSet<Address>) -> Result<Self, StoreError> {
        let (previous, copied_at) = (HashMap::new(), notes.read(&CopiedAt {})?);
        let restored_at = notes.read(&RestoredAt {})?.unwrap_or(Timestamp(u64::MAX));
        Ok(Self { own, previous, copied_at, restored_at, later: Vec::new(), elsewhere: 0, found: Tally::default() })
    }

    /// From the contract's first block to the newest; `watched` if all events are to be compared with what the watcher read.
    async fn all(&mut self, plant: &Plant, network: &Network, mut watched: Option<&mut Tally>) -> Result<(), Stop> {
        let head = network.chain.head().await?.number;
        let mut from = network.chain.pin().map_or(0, |pin| pin.deployed_at);
        while from <= head {
            let to = head.min(from + STRIDE - 1);
            let events = network.chain.events(from, to).await?;
            self.take(&plant.ledger.inspection, &events)?;
            if let Some(tally) = watched.as_deref_mut() {
                record_audit::compare(plant, network, (from, to), &events, tally).await?;
            }
            from = to + 1;
        }
        self.judge_later(network).await
    }

    /// What was anchored between the backup and its restoring may be in the home that went on then. What came after is
    /// this home's own, and lost.
    async fn judge_later(&mut self, network: &Network) -> Result<(), Stop> {
        for (subject, block) in std::mem::take(&mut self.later) {
            let time = match network.ask_time(block).await {
                Ok(time) => time.seconds(),
                Err(PipelineError::Chain(error)) => return Err(error.into()),
                Err(_) => 0,
            };
            if time <= self.restored_at.seconds().saturating_add(CLOCKS) {
                self.elsewhere += 1;
            } else {
                self.miss(&subject, Some(block));
            }
        }
        Ok(())
    }

    fn take(&mut self, inspection: &Inspection, events: &[EventAt]) -> Result<(), StoreError> {
        let (mut roots, mut digests): (Vec<Hash>, Vec<Digest>) = (Vec::new(), Vec::new());
        let mut blocks = HashMap::new();
        for at in events {
            match at.event {
                Event::Anchored { account, root, previous, .. } if self.own.contains(&account) => {
                    let expected = self.previous.insert(account, root).unwrap_or(Hash([0; 32]));
                    if expected != previous {
                        let text = format!("{account} anchored it after {previous} instead of after {expected}");
                        self.found.find(FindingKind::Tampered, &name(&root), &text);
                    }
                    blocks.insert(root.0, at.block);
                    roots.push(root);
                }
                Event::DataUploaded { owner, digest, .. } if self.own.contains(&owner) => {
                    blocks.insert(digest.0, at.block);
                    digests.push(digest);
                }
                _ => {}
            }
        }
        for root in inspection.unknown_roots(&roots)? {
            self.unknown(&name(&root), blocks.get(&root.0).copied());
        }
        for digest in inspection.unknown_digests(&digests)? {
            self.unknown(&format!("record {digest}"), blocks.get(&digest.0).copied());
        }
        Ok(())
    }

    fn unknown(&mut self, subject: &str, block: Option<u64>) {
        match (self.copied_at, block) {
            (Some(copied), Some(block)) if block > copied => self.later.push((subject.to_owned(), block)),
            _ => self.miss(subject, block),
        }
    }

    fn miss(&mut self, subject: &str, block: Option<u64>) {
        let block = block.map_or_else(String::new, |block| format!(" in block {block}"));
        let text = format!("this home's account anchored it{block}, but the ledger does not have it");
        self.found.find(FindingKind::Missing, subject, &text);
    }
}
