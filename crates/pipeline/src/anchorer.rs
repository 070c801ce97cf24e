//! Puts stored records on the chain: as Merkle batches, or one `dataUpload` each; from an owner's further accounts too.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use crate::chain::merkle::{Leaf, MOST_LEAVES, Tree};
use crate::chain::{Call, ChainError, Priced, Shortfall};
use crate::crypto::{CryptoError, EoaSecret, anchoring_secret, fault, prove, random_bytes};
use crate::model::{Address, AnchorMode, Domain, RecordState, Timestamp, Token, Wei};
use crate::pace::{LONGEST_WAIT, Pace};
use crate::store::{Anchors, NewBatch, RecordRow, WaitingBatch};
use crate::{Network, Owner, PipelineError, Plant, Result, Sender, authority, directory::kept, sender::Outgoing};

/// Records per round when uploaded individually: one ledger commit for this many signed transactions.
const ROUND: usize = 128;
/// Batches of one account that may wait for a block; while they do, the next one gets wider.
const MOST_OPEN_BATCHES: usize = 2;
/// Rest of a refused extra account.
const REST: Duration = Duration::from_secs(60);
/// Wait when only the chain can bring news.
const IDLE: Duration = Duration::from_secs(1);
/// Interval of checks for rights that have ended, while nothing is closed or sent.
const LOOK: Duration = Duration::from_millis(500);
/// The most accounts that anchor for one owner, including the owner's own.
pub const MOST_LANES: u8 = 8;
/// The number of anchors an account gets ether for at a time.
const PROVISION: u128 = 500;
/// The gas assumed for one anchor and its share of the registration.
const ANCHOR_GAS: u128 = 120_000;
const PROVISION_PURPOSE: &str = "fund anchoring account";
/// Leaf orders tried to find a root that no batch had before.
const MOST_ORDERS: usize = 16;

/// Anchors the records of one owner; keeps nothing that the ledger does not know.
pub struct Anchorer {
    mode: AnchorMode,
    pace: Pace,
    /// Extra accounts whose anchors the contract refused, and until when they rest.
    resting: HashMap<Address, Instant>,
    /// When rights that ended or began again were last looked for.
    settled: Option<Instant>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Round {
    /// Transactions that were signed and stored.
    pub submitted: usize,
    /// How long until there may be more to do, if nothing is stored and no block comes first.
    pub next: Duration,
}

impl Round {
    fn wait(next: Duration) -> Self {
        Self { submitted: 0, next }
    }
}

/// What a round works with.
#[derive(Clone, Copy)]
struct Bench<'a> {
    plant: &'a Plant,
    network: &'a Network,
    sender: &'a Sender,
    owner: Address,
}

impl Anchorer {
    pub fn new(mode: AnchorMode) -> Self {
        Self { mode, pace: Pace::default(), resting: HashMap::new(), settled: None }
    }

    /// `lanes` anchor batches in parallel, the owner's own account first. Individual records go through the own account
    /// only; where that is absent everything goes in batches. On an error nothing is lost: records stay `stored` or
    /// `batched`.
    pub async fn round(
        &mut self,
        plant: &Plant,
        network: &Network,
        sender: &Sender,
        owner: Address,
        lanes: &[EoaSecret],
    ) -> Result<Round> {
        let bench = Bench { plant, network, sender, owner };
        if network.directory.epoch(owner) == 0 {
            return Ok(Round::wait(IDLE));
        }
        let lately = self.settled.is_some_and(|at| at.elapsed() < LOOK);
        if !lately || self.mode == AnchorMode::Each {
            self.settle(bench)?;
        }
        self.resting.retain(|_, until| Instant::now() < *until);
        let Some((lane, open)) = bench.free_lane(lanes, &self.resting)? else { return Ok(Round::wait(IDLE)) };
        // Batches already closed come first, whatever the mode is now.
        if let Some(batch) = self.waiting(bench, lately)? {
            return self.send(bench, lane, batch).await;
        }
        let own = match self.mode {
            AnchorMode::Each => lanes.iter().find(|lane| lane.address() == owner),
            AnchorMode::Batch => None,
        };
        match own {
            Some(own) => match bench.again()? {
                Some(batch) => self.send(bench, lane, batch).await,
                None => bench.one_by_one(own).await,
            },
            None => match self.close(bench, open == 0)? {
                Ok(batch) => self.send(bench, lane, batch).await,
                Err(due_in) => Ok(Round::wait(due_in)),
            },
        }
    }

    /// An extra account that the contract refuses rests; a refusal of the owner's own account is an error.
    async fn send(&mut self, bench: Bench<'_>, lane: &EoaSecret, batch: WaitingBatch) -> Result<Round> {
        match bench.send(lane, batch).await {
            Err(PipelineError::Chain(ChainError::Reverted { .. })) if lane.address() != bench.owner => {
                self.resting.insert(lane.address(), Instant::now() + REST);
                Ok(Round::wait(Duration::ZERO))
            }
            other => other,
        }
    }

    /// This looks at all topics, so it runs before a batch is closed or sent, and otherwise only now and then.
    fn settle(&mut self, bench: Bench<'_>) -> Result<()> {
        block_in_place(|| authority::settle_waiting(bench.plant, bench.network, bench.owner))?;
        self.settled = Some(Instant::now());
        Ok(())
    }

    /// A closed batch that no transaction anchors.
    fn waiting(&mut self, bench: Bench<'_>, look: bool) -> Result<Option<WaitingBatch>> {
        let first = || bench.plant.ledger.batches.waiting(bench.owner, 1).map(|found| found.first().copied());
        let found = first()?;
        if found.is_none() || !look {
            return Ok(found);
        }
        self.settle(bench)?;
        Ok(first()?)
    }

    /// Closes a batch if one is due; otherwise returns how long until then.
    fn close(&mut self, bench: Bench<'_>, idle: bool) -> Result<Result<WaitingBatch, Duration>> {
        let (plant, owner) = (bench.plant, bench.owner);
        block_in_place(|| {
            let (waiting, oldest) = plant.ledger.batches.unbatched(owner)?;
            let Some(oldest) = oldest.filter(|_| waiting > 0) else { return Ok(Err(LONGEST_WAIT)) };
            let age = Duration::from_nanos(Timestamp::now().0.saturating_sub(oldest.0));
            let due_in = self.pace.due_in(usize::try_from(waiting).unwrap_or(usize::MAX), age, idle, Instant::now());
            if !due_in.is_zero() {
                return Ok(Err(due_in));
            }
            self.settle(bench)?;
            let leaves = plant.ledger.batches.stored_leaves(owner, MOST_LEAVES)?;
            let count = leaves.len();
            let Some(batch) = close_batch(plant, owner, leaves)? else { return Ok(Err(LONGEST_WAIT)) };
            self.pace.closed(count, Instant::now());
            Ok(Ok(batch))
        })
    }
}

pub(super) fn close_batch(plant: &Plant, owner: Address, mut leaves: Vec<Leaf>) -> Result<Option<WaitingBatch>> {
    let Some(tree) = tree_of_another_root(plant, &mut leaves)? else { return Ok(None) };
    let places = leaves.iter().enumerate();
    let leaves: Vec<_> = places.map(|(index, leaf)| (leaf.digest, tree.path(index))).collect();
    let batch = WaitingBatch { root: tree.root(), count: leaves.len() as u64 };
    fault::point("batch-due");
    plant.ledger.batches.close(NewBatch { owner, root: batch.root, leaves })?;
    fault::point("batch-closed");
    plant.observer.records_changed();
    Ok(Some(batch))
}

/// The tree over the leaves, in an order whose root no batch had before. The contract keeps only a root's first block,
/// so after a skipped anchor the same root would show the wrong block forever. A single leaf has only one order.
fn tree_of_another_root(plant: &Plant, leaves: &mut [Leaf]) -> Result<Option<Tree>> {
    for _ in 1..leaves.len().min(MOST_ORDERS) {
        let Some(tree) = Tree::new(Leaf::hashes(leaves)) else { return Ok(None) };
        if !plant.ledger.inspection.unknown_roots(&[tree.root()])?.is_empty() {
            return Ok(Some(tree));
        }
        leaves.rotate_left(1);
    }
    Ok(Tree::new(Leaf::hashes(leaves)))
}

impl Bench<'_> {
    /// Records whose own uploads were skipped: the contract accepts a digest once, so they go into a batch.
    fn again(&self) -> Result<Option<WaitingBatch>> {
        block_in_place(|| {
            let leaves = self.plant.ledger.batches.passed_over_leaves(self.owner, MOST_LEAVES)?;
            close_batch(self.plant, self.owner, leaves)
        })
    }

    /// The account with the fewest open batches, and how many; `None` if all are full or paused.
    fn free_lane<'k>(
        &self,
        lanes: &'k [EoaSecret],
        resting: &HashMap<Address, Instant>,
    ) -> Result<Option<(&'k EoaSecret, usize)>> {
        block_in_place(|| {
            let (mut best, mut fewest) = (None, MOST_OPEN_BATCHES);
            for lane in lanes.iter().filter(|lane| !resting.contains_key(&lane.address())) {
                let open = self.plant.ledger.batches.open_roots(lane.address())?.len();
                if open < fewest && self.sender.room(lane.address())? > 0 {
                    (best, fewest) = (Some(lane), open);
                }
            }
            Ok(best.map(|lane| (lane, fewest)))
        })
    }

    async fn send(&self, lane: &EoaSecret, batch: WaitingBatch) -> Result<Round> {
        // Held from checking what is open until the next one is signed, so that the chain of roots does not fork.
        let held = self.sender.lane(&self.network.chain, lane).await;
        let open = self.plant.ledger.batches.open_roots(lane.address())?;
        let previous = match open.last() {
            Some(root) => *root,
            None => self.network.chain.anchor_head(lane.address()).await?,
        };
        let call = Call::Anchor { root: batch.root, count: batch.count, previous };
        let outgoing = Outgoing { call, purpose: "anchor".to_owned(), anchors: Anchors::Batch(batch.root) };
        match held.submit(vec![outgoing]).await {
            Ok(hashes) => Ok(Round { submitted: hashes.len(), next: Duration::ZERO }),
            // If its gas must be estimated again, the root before it has to be mined first.
            Err(PipelineError::Chain(ChainError::Reverted { .. })) if !open.is_empty() => Ok(Round::wait(IDLE)),
            Err(error) => Err(error),
        }
    }

    /// Up to [`ROUND`] stored records, one transaction each; those of an epoch that the chain does not know yet wait.
    async fn one_by_one(&self, own: &EoaSecret) -> Result<Round> {
        let Bench { plant, network, sender, owner } = *self;
        let room = sender.room(owner)?.min(ROUND);
        if room == 0 {
            return Ok(Round::wait(IDLE));
        }
        let rows = plant.ledger.records.in_state(Some(owner), RecordState::Stored, room)?;
        let mut uploads = Vec::with_capacity(rows.len());
        for row in &rows {
            let token = block_in_place(|| kept::token(&plant.ledger.rights, &network.directory, row.owner, row.epoch))?;
            uploads.extend(token.map(|token| upload(row, token)));
        }
        if uploads.is_empty() {
            return Ok(Round::wait(IDLE));
        }
        let submitted = sender.lane(&network.chain, own).await.submit(uploads).await?.len();
        Ok(Round { submitted, next: Duration::ZERO })
    }
}

fn upload(row: &RecordRow, token: Token) -> Outgoing {
    let call = Call::DataUpload { digest: row.digest, token, timestamp: row.captured_at };
    Outgoing { call, purpose: "dataUpload".to_owned(), anchors: Anchors::Digests(vec![row.digest]) }
}

/// The extra anchoring accounts of an owner on one network, for `lanes` accounts in total.
pub fn extra(owner: &EoaSecret, domain: &Domain, lanes: u8) -> Result<Vec<EoaSecret>, CryptoError> {
    (1..lanes.min(MOST_LANES)).map(|index| anchoring_secret(owner, domain, index)).collect()
}

/// Funds an extra account where needed, and registers it. Returns whether it is ready; call again until it is.
pub async fn ensure_ready(
    plant: &Plant,
    network: &Network,
    sender: &Sender,
    owner: &Owner,
    key: &EoaSecret,
) -> Result<bool> {
    let account = key.address();
    let (state, is_registered) = (sender.state_of(account)?, network.directory.identity(account).is_ok());
    if !is_registered && state.open > 0 {
        // Its registration is on the way, perhaps since before a restart.
        return Ok(false);
    }
    if !is_registered || state.paused.is_some() {
        provide(plant, network, sender, owner, key).await?;
    }
    if is_registered {
        return Ok(true);
    }
    let (signing, (_, envelope)) = (owner.signing(), owner.public_keys());
    // A token of its own that belongs to no key: these accounts seal nothing.
    let token = Token(random_bytes()?);
    let identity = prove(plant.provider, &network.domain, &account, &signing, &envelope, token)?;
    let call = Call::Register { identity, envelope: Vec::new() };
    sender.send(&network.chain, key, call, "register anchoring account").await?;
    Ok(false)
}

/// Gives an extra account ether for its next anchors: from a development node, otherwise from the owner.
async fn provide(plant: &Plant, network: &Network, sender: &Sender, owner: &Owner, key: &EoaSecret) -> Result<()> {
    let (chain, account) = (&network.chain, key.address());
    // A transfer still waiting for its block is not in the balance yet.
    if plant.ledger.lanes.open_lane(owner.address)?.iter().any(|row| row.purpose == PROVISION_PURPOSE) {
        return Ok(());
    }
    let price = match sender.policy().fresh(&chain.market().await?) {
        Priced::At(price) => price,
        Priced::Capped { needed, .. } => needed,
    };
    let provision = price.saturating_mul(ANCHOR_GAS * PROVISION);
    let held = chain.wealth(account).await?;
    if held >= provision / 4 || chain.fund_from_node(account).await? {
        return Ok(());
    }
    let (means, needed) = (chain.wealth(owner.address).await?, provision.saturating_mul(2));
    if means < needed {
        let account = owner.address;
        return Err(PipelineError::NoEther(Shortfall { account, held: Wei(means), needed: Wei(needed) }));
    }
    sender.transfer(chain, &owner.eoa(), account, provision - held, PROVISION_PURPOSE).await
}

#[cfg(test)]
mod anchoring_accounts_tests {
    use super::*;

    #[test]
    fn extra_accounts_are_distinct_and_follow_from_the_owner_and_the_network() {
        let owner = EoaSecret::from_slice(&[7; 32]).expect("key");
        let domain = Domain([1; 32]);
        let seven = extra(&owner, &domain, 200).expect("keys");
        assert_eq!(seven.len(), 7);
        let mut addresses: Vec<_> = seven.iter().map(EoaSecret::address).chain([owner.address()]).collect();
        addresses.sort();
        addresses.dedup();
        assert_eq!(addresses.len(), 8);
        assert_eq!(extra(&owner, &domain, 3).expect("keys"), seven[..2]);
        assert_ne!(extra(&owner, &Domain([2; 32]), 2).expect("keys"), seven[..1]);
        let other = EoaSecret::from_slice(&[8; 32]).expect("key");
        assert_ne!(extra(&other, &domain, 2).expect("keys"), seven[..1]);
        assert!(extra(&owner, &domain, 1).expect("none").is_empty());
    }
}
