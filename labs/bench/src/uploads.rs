//! Many uploaders at once: each seals a message, stores the record, has it anchored, and waits for the receipt. `each`
//! is one `dataUpload` per record; `batch` is one root over the waiting records; `prototype` stores only on the chain,
//! the ciphertext itself.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::Semaphore;
use tokio::task::JoinSet;

use super::account::{Account, Sealed, message};
use super::batcher::{self, Batcher};
use super::foreign::gas_of;
use super::lane::{Deed, Posted, post};
use super::mined::Mined;
use super::network::Network;
use super::progress::Progress;
use super::prototype::Prototype;
use authros_chain::Call;
use authros_model::{Digest, ErrorKind, Timestamp};
use authros_service::Failure;
use authros_service::reply::internal;

/// Length of a message, bytes, as in the paper.
pub const MESSAGE: usize = 1024;
/// Gas of the prototype's calls that wait for a block at the same time. A node's pool is bounded, by gas too, and refuses
/// what is beyond; its uploaders wait instead, and their wait counts.
const MOST_WAITING: u64 = 500_000_000;
/// How often the progress line is updated.
const TICK: Duration = Duration::from_millis(200);

/// How a record is put on the chain.
#[derive(Debug, Clone)]
pub enum Way {
    /// Under a Merkle root with others.
    Batch,
    /// In its own transaction.
    Each,
    /// Whole, in the prototype's contract.
    Prototype(Arc<Prototype>),
}

impl Way {
    /// Its name in results.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Batch => "batch",
            Self::Each => "each",
            Self::Prototype(_) => "prototype",
        }
    }
}

/// The parameters of one run.
#[derive(Debug, Clone)]
pub struct Load {
    /// The method.
    pub way: Way,
    /// Length of a message.
    pub bytes: usize,
    /// How many upload at once.
    pub uploaders: usize,
}

/// The outcome of one run.
pub struct Outcome {
    /// How many uploaded.
    pub uploaders: usize,
    /// From each uploader's start to its receipt, for those that got one, milliseconds.
    pub responses: Vec<f64>,
    /// From the first uploader's start to the last receipt.
    pub total: Duration,
    /// From the first transaction sent to the last receipt.
    pub on_chain: Duration,
    /// When each block of the run was seen.
    pub blocks: Vec<Instant>,
    /// Transactions that took effect.
    pub transactions: u64,
    /// Gas that they used.
    pub gas: u64,
    /// Why uploads failed, and how many for each reason.
    pub failures: BTreeMap<String, u64>,
}

/// One upload that succeeded.
struct Done {
    response: Duration,
    sent: Instant,
    received: Instant,
    /// Gas of the transaction, if it was this uploader's own.
    gas: Option<u64>,
}

struct Run {
    network: Arc<Network>,
    mined: Arc<Mined>,
    bytes: usize,
    line: Line,
}

/// The path from an uploader to the chain.
enum Line {
    Batch([Batcher; 2]),
    Each,
    /// With the gas that a call may use, and room for calls that wait for a block.
    Prototype(Arc<Prototype>, u64, Semaphore),
}

/// Runs all of its uploaders to the end.
///
/// # Errors
/// If the run cannot begin, or the chain's count differs from the receipts; individual failed uploads are in the
/// outcome.
pub async fn run(network: &Arc<Network>, load: &Load) -> Result<Outcome, Failure> {
    let mut progress = Progress::new(format!("{} {}, {} B", network.name(), load.way.word(), load.bytes));
    let gas = warm_up(network, load).await?;
    let counted = counted(network).await?;
    let stored = network.storer.entries()?;
    let mut beside = JoinSet::new();
    let mined = Arc::new(Mined::default());
    let head = network.chain.head().await?.number;
    beside.spawn(Arc::clone(&mined).watch(network.chain.clone(), head, network.is_embedded()));
    let (line, roots) = match &load.way {
        Way::Each => (Line::Each, None),
        Way::Prototype(prototype) => {
            let room = usize::try_from(MOST_WAITING / gas.max(1)).unwrap_or(Semaphore::MAX_PERMITS);
            let room = Semaphore::new(room.clamp(1, Semaphore::MAX_PERMITS));
            (Line::Prototype(Arc::clone(prototype), gas, room), None)
        }
        Way::Batch => {
            let (batchers, roots) = batcher::start(network, &mined, &mut beside).await?;
            (Line::Batch(batchers), Some(roots))
        }
    };
    let run = Arc::new(Run { network: Arc::clone(network), mined, bytes: load.bytes, line });
    let begun = Instant::now();
    let done = all(&run, load.uploaders, begun, &mut progress).await;
    beside.shutdown().await;
    let mut outcome = outcome(load.uploaders, begun, run.mined.blocks(), done);
    if let Some(roots) = roots {
        let anchored = roots.confirmed(network).await?;
        (outcome.transactions, outcome.gas) = (anchored.transactions, anchored.gas);
        agree(anchored.leaves, &outcome)?;
    } else if matches!(load.way, Way::Each) {
        agree(self::counted(network).await? - counted, &outcome)?;
    }
    if !matches!(load.way, Way::Prototype(_)) {
        agree(network.storer.entries()? - stored, &outcome)?;
    }
    Ok(outcome)
}

/// The lanes begin at the chain's nonces, and gas is estimated once, so that no uploader has to wait for it; nothing is
/// sent. Returns the gas of the prototype's call.
async fn warm_up(network: &Network, load: &Load) -> Result<u64, Failure> {
    let mut most = 0;
    for account in &network.accounts {
        let nonce = network.chain.nonce(account.address, true).await?;
        account.begin_lane(nonce);
        match &load.way {
            Way::Batch => {}
            Way::Each => {
                let Sealed { leaf, captured_at, .. } = account.seal(&message(load.bytes)?)?;
                let call = Call::DataUpload { digest: leaf.digest, token: account.token, timestamp: captured_at };
                network.chain.sign(&account.eoa, nonce, &call).await?;
            }
            Way::Prototype(prototype) => {
                let data = prototype.upload(account, &message(load.bytes)?)?;
                most = most.max(gas_of(&network.chain, account.address, Some(prototype.address), &data).await?);
            }
        }
    }
    Ok(most)
}

/// How many digests the contract counts for the accounts.
async fn counted(network: &Network) -> Result<u64, Failure> {
    let mut sum = 0;
    for account in &network.accounts {
        let answer = network.chain.data_query(account.address, account.token, account.address).await?;
        if !answer.authorised {
            return Err(internal("the account is no longer registered"));
        }
        sum += answer.count;
    }
    Ok(sum)
}

/// Chain and store must hold what was reported to the uploaders; an upload that ended too early may be there as well.
fn agree(found: u64, outcome: &Outcome) -> Result<(), Failure> {
    let (least, most) = (outcome.responses.len() as u64, outcome.uploaders as u64);
    if (least..=most).contains(&found) {
        return Ok(());
    }
    let text =
        format!("{least} of {most} uploads succeeded, but chain or store count {found}; this run cannot be trusted");
    Err(Failure::new(ErrorKind::Refused, text))
}

async fn all(run: &Arc<Run>, uploaders: usize, begun: Instant, progress: &mut Progress) -> Vec<Result<Done, Failure>> {
    let mut tasks = JoinSet::new();
    for index in 0..uploaders {
        tasks.spawn(upload(Arc::clone(run), index % 2, begun));
    }
    let mut done = Vec::with_capacity(uploaders);
    let mut tick = tokio::time::interval(TICK);
    loop {
        tokio::select! {
            joined = tasks.join_next() => match joined {
                Some(ended) => done.push(ended.unwrap_or_else(|error| Err(internal(error.to_string())))),
                None => return done,
            },
            _ = tick.tick() => {}
        }
        progress.at(done.len(), uploaders);
    }
}

/// One uploader, on the account with that index. All begin at once, however late they get a thread.
async fn upload(run: Arc<Run>, place: usize, begun: Instant) -> Result<Done, Failure> {
    let account = &run.network.accounts[place];
    let message = message(run.bytes)?;
    let (sent, gas) = if let Line::Prototype(prototype, gas, room) = &run.line {
        let _room = room.acquire().await.map_err(|_| internal("the line is closed"))?;
        run.put_on_chain(account, &message, prototype, *gas).await?
    } else {
        let sealed = account.seal(&message)?;
        run.network.storer.put(sealed.leaf, sealed.captured_at, sealed.blob).await?;
        match &run.line {
            Line::Batch(batchers) => (batchers[place].anchor(sealed.leaf).await?, None),
            _ => run.put_digest(account, sealed.leaf.digest, sealed.captured_at).await?,
        }
    };
    let received = Instant::now();
    Ok(Done { response: received - begun, sent, received, gas })
}

/// When a transaction was sent, and its gas if it was for this record alone.
type Settled = Result<(Instant, Option<u64>), Failure>;

impl Run {
    async fn put_digest(&self, account: &Account, digest: Digest, timestamp: Timestamp) -> Settled {
        let call = Call::DataUpload { digest, token: account.token, timestamp };
        self.settle(account, Deed::Call(&call)).await
    }

    async fn put_on_chain(&self, account: &Account, message: &[u8], prototype: &Prototype, gas: u64) -> Settled {
        let data = prototype.upload(account, message)?;
        let (sent, used) = self.settle(account, Deed::Foreign { to: prototype.address, data: &data, gas }).await?;
        if used < Some(Prototype::least_gas(message.len())) {
            return Err(internal("the prototype's contract used less gas than storing the message takes"));
        }
        Ok((sent, used))
    }

    async fn settle(&self, account: &Account, deed: Deed<'_>) -> Settled {
        let Posted { hash, sent, told } = post(&self.network, &self.mined, account, deed).await?;
        Ok((sent, Some(self.mined.receipt(&self.network.chain, hash, told).await?.gas_used)))
    }
}

fn outcome(uploaders: usize, begun: Instant, blocks: Vec<Instant>, done: Vec<Result<Done, Failure>>) -> Outcome {
    let mut failures = BTreeMap::new();
    let mut succeeded = Vec::new();
    for one in done {
        match one {
            Ok(done) => succeeded.push(done),
            Err(failure) => *failures.entry(failure.message).or_default() += 1,
        }
    }
    let last = succeeded.iter().map(|done| done.received).max().unwrap_or(begun);
    let first = succeeded.iter().map(|done| done.sent).min().unwrap_or(last);
    let own = succeeded.iter().filter_map(|done| done.gas);
    Outcome {
        uploaders,
        responses: succeeded.iter().map(|done| done.response.as_secs_f64() * 1000.0).collect(),
        total: last - begun,
        on_chain: last - first,
        blocks,
        transactions: own.clone().count() as u64,
        gas: own.sum(),
        failures,
    }
}
