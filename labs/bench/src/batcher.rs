//! Anchors the records of one account as Merkle batches, closed like the pipeline's (`pipeline::pace`). Every record's
//! proof is checked before its uploader is notified.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinSet;

use super::account::Account;
use super::lane::{Deed, Posted, post};
use super::mined::Mined;
use super::network::Network;
use authros_chain::Call;
use authros_chain::merkle::{Inclusion, Leaf, Tree};
use authros_model::{Address, Hash};
use authros_pipeline::pace::Pace;
use authros_service::Failure;
use authros_service::reply::internal;

type Told = Result<(Instant, Inclusion), Failure>;

struct Item {
    leaf: Leaf,
    told: oneshot::Sender<Told>,
}

/// The input of one account's batches.
pub struct Batcher(mpsc::UnboundedSender<Item>);

impl Batcher {
    /// Has a record anchored; returns when its batch was sent. Returns after the batch's receipt.
    ///
    /// # Errors
    /// Errors of the chain, or if the proof is wrong.
    pub async fn anchor(&self, leaf: Leaf) -> Result<Instant, Failure> {
        let (told, answer) = oneshot::channel();
        let gone = || internal("the batcher has ended");
        self.0.send(Item { leaf, told }).map_err(|_| gone())?;
        let (sent, inclusion) = answer.await.map_err(|_| gone())??;
        if inclusion.proves(&leaf) { Ok(sent) } else { Err(internal("a record's proof does not lead to its root")) }
    }
}

/// The anchors of a run.
#[derive(Debug, Clone, Copy, Default)]
pub struct Anchored {
    /// Roots.
    pub transactions: u64,
    /// Total gas.
    pub gas: u64,
    /// Leaves, as the contract counts them.
    pub leaves: u64,
}

/// The anchored roots: account, root, gas.
#[derive(Clone, Default)]
pub struct Roots(Arc<Mutex<Vec<(Address, Hash, u64)>>>);

impl Roots {
    fn add(&self, account: Address, root: Hash, gas: u64) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push((account, root, gas));
    }

    /// Asks the contract for every one of them.
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn confirmed(&self, network: &Network) -> Result<Anchored, Failure> {
        let roots = self.0.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let mut sum = Anchored::default();
        for (account, root, gas) in roots {
            let (_, leaves) = network.chain.root_anchored(account, root).await?.unwrap_or_default();
            sum.transactions += 1;
            sum.gas += gas;
            sum.leaves += leaves;
        }
        Ok(sum)
    }
}

/// Starts one batcher for each account, as tasks of `beside`.
///
/// # Errors
/// Errors of the node.
pub async fn start(
    network: &Arc<Network>,
    mined: &Arc<Mined>,
    beside: &mut JoinSet<()>,
) -> Result<([Batcher; 2], Roots), Failure> {
    let roots = Roots::default();
    let mut batchers = Vec::new();
    for account in &network.accounts {
        let (items, inbox) = mpsc::unbounded_channel();
        let line = Line {
            network: Arc::clone(network),
            account: Arc::clone(account),
            mined: Arc::clone(mined),
            roots: roots.clone(),
            previous: network.chain.anchor_head(account.address).await?,
        };
        beside.spawn(line.run(inbox));
        batchers.push(Batcher(items));
    }
    let batchers = batchers.try_into().map_err(|_| internal("two accounts, two batchers"))?;
    Ok((batchers, roots))
}

struct Line {
    network: Arc<Network>,
    account: Arc<Account>,
    mined: Arc<Mined>,
    roots: Roots,
    previous: Hash,
}

impl Line {
    async fn run(mut self, mut inbox: mpsc::UnboundedReceiver<Item>) {
        let mut pace = Pace::default();
        let mut sending = JoinSet::new();
        while let Some(first) = inbox.recv().await {
            let oldest = Instant::now();
            let mut items = vec![first];
            loop {
                let due_in = pace.due_in(items.len(), oldest.elapsed(), sending.is_empty(), Instant::now());
                if due_in.is_zero() {
                    break;
                }
                tokio::select! {
                    item = inbox.recv() => match item {
                        Some(item) => items.push(item),
                        None => break,
                    },
                    Some(_) = sending.join_next() => {}
                    () = tokio::time::sleep(due_in) => {}
                }
            }
            pace.closed(items.len(), Instant::now());
            self.close(items, &mut sending).await;
        }
    }

    /// Batches are sent one after the other, because they are chained; receipts are awaited in parallel.
    async fn close(&mut self, items: Vec<Item>, sending: &mut JoinSet<()>) {
        let Some(tree) = Tree::new(items.iter().map(|item| item.leaf.hash()).collect()) else { return };
        let call = Call::Anchor { root: tree.root(), count: items.len() as u64, previous: self.previous };
        let posted = post(&self.network, &self.mined, &self.account, Deed::Call(&call)).await;
        if posted.is_ok() {
            self.previous = tree.root();
        }
        let (network, mined, roots) = (Arc::clone(&self.network), Arc::clone(&self.mined), self.roots.clone());
        let account = self.account.address;
        sending.spawn(async move {
            let sent = finish(&network, &mined, posted).await;
            if let Ok((_, gas)) = sent {
                roots.add(account, tree.root(), gas);
            }
            tell(items, &tree, &sent.map(|(sent, _)| sent));
        });
    }
}

/// When a batch was sent, and its gas.
async fn finish(network: &Network, mined: &Mined, posted: Result<Posted, Failure>) -> Result<(Instant, u64), Failure> {
    let Posted { hash, sent, told } = posted?;
    let receipt = mined.receipt(&network.chain, hash, told).await?;
    Ok((sent, receipt.gas_used))
}

fn tell(items: Vec<Item>, tree: &Tree, sent: &Result<Instant, Failure>) {
    let count = items.len();
    for (index, item) in items.into_iter().enumerate() {
        let place = |sent: Instant| {
            let inclusion =
                Inclusion { index: index as u64, count: count as u64, path: tree.path(index), root: tree.root() };
            (sent, inclusion)
        };
        // An uploader that was ended waits no more.
        drop(item.told.send(sent.clone().map(place)));
    }
}
