//! Many uploaders at once: each seals a message, stores the record, has it anchored, and waits for the
//! receipt. `each` is one `dataUpload` per record; `batch` is one root over the records that wait.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::task::JoinSet;

use super::account::Sealed;
use super::batcher::{self, Batcher};
use super::lane::{Posted, post};
use super::mined::Mined;
use super::network::Network;
use super::progress::Progress;
use crate::chain::Call;
use crate::crypto::random_bytes;
use crate::model::{AnchorMode, ErrorKind};
use crate::service::Failure;
use crate::service::failure::internal;

/// Length of a message, bytes, as in the paper.
pub const MESSAGE: usize = 1024;
/// How often the progress line is renewed.
const TICK: Duration = Duration::from_millis(200);

/// What became of one run.
pub struct Outcome {
    /// How many uploaded.
    pub uploaders: usize,
    /// From each uploader's start to its receipt, of those that got one, milliseconds.
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
    /// Why uploads failed, and how many each.
    pub failures: BTreeMap<String, u64>,
}

/// One upload that succeeded.
struct Done {
    response: Duration,
    sent: Instant,
    received: Instant,
    /// Gas of the transaction, where it was this uploader's own.
    gas: Option<u64>,
}

struct Run {
    network: Arc<Network>,
    mined: Arc<Mined>,
    batchers: Option<[Batcher; 2]>,
}

/// Runs `uploaders` of them to the end.
///
/// # Errors
/// Where the run cannot begin, or the chain's count differs from the receipts; single uploads that fail
/// are in the outcome.
pub async fn run(network: &Arc<Network>, mode: AnchorMode, uploaders: usize) -> Result<Outcome, Failure> {
    let mut progress = Progress::new(format!("{}, {mode}, {uploaders} uploaders", network.name()));
    warm_up(network, mode).await?;
    let counted = counted(network).await?;
    let stored = network.storer.entries()?;
    let mut beside = JoinSet::new();
    let mined = Arc::new(Mined::default());
    let head = network.chain.head().await?.number;
    beside.spawn(Arc::clone(&mined).watch(network.chain.clone(), head, network.is_embedded()));
    let (batchers, roots) = match mode {
        AnchorMode::Each => (None, None),
        AnchorMode::Batch => {
            let (batchers, roots) = batcher::start(network, &mined, &mut beside).await?;
            (Some(batchers), Some(roots))
        }
    };
    let run = Arc::new(Run { network: Arc::clone(network), mined, batchers });
    let begun = Instant::now();
    let done = all(&run, uploaders, begun, &mut progress).await;
    beside.shutdown().await;
    let mut outcome = outcome(uploaders, begun, run.mined.blocks(), done);
    if let Some(roots) = roots {
        let anchored = roots.confirmed(network).await?;
        (outcome.transactions, outcome.gas) = (anchored.transactions, anchored.gas);
        agree(anchored.leaves, &outcome)?;
    } else {
        agree(self::counted(network).await? - counted, &outcome)?;
    }
    agree(network.storer.entries()? - stored, &outcome)?;
    Ok(outcome)
}

/// The lanes begin where the chain stands, and the gas estimate is remembered per account, so that no uploader
/// has to wait for it; nothing is sent.
async fn warm_up(network: &Network, mode: AnchorMode) -> Result<(), Failure> {
    for account in &network.accounts {
        let nonce = network.chain.nonce(account.address, true).await?;
        account.begin_lane(nonce);
        if mode == AnchorMode::Each {
            let Sealed { leaf, captured_at, .. } = account.seal(&message()?)?;
            let call = Call::DataUpload { digest: leaf.digest, token: account.token, timestamp: captured_at };
            network.chain.sign(&account.eoa, nonce, &call).await?;
        }
    }
    Ok(())
}

/// How many digests the contract counts for the accounts.
async fn counted(network: &Network) -> Result<u64, Failure> {
    let mut sum = 0;
    for account in &network.accounts {
        let state = network.chain.account(account.address).await?;
        sum += state.ok_or_else(|| internal("the account is not registered any more"))?.count;
    }
    Ok(sum)
}

/// Chain and vault must hold what the uploaders were told; an upload that ended too early may be there as well.
fn agree(found: u64, outcome: &Outcome) -> Result<(), Failure> {
    let (least, most) = (outcome.responses.len() as u64, outcome.uploaders as u64);
    if (least..=most).contains(&found) {
        return Ok(());
    }
    let text =
        format!("{least} of {most} uploads succeeded, and chain or vault count {found}; this run cannot be trusted");
    Err(Failure::new(ErrorKind::Refused, text))
}

fn message() -> Result<Vec<u8>, Failure> {
    Ok(random_bytes::<MESSAGE>()?.to_vec())
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

/// One uploader, on the account of that place. All begin at once, however late they get a thread.
async fn upload(run: Arc<Run>, place: usize, begun: Instant) -> Result<Done, Failure> {
    let account = &run.network.accounts[place];
    let sealed = account.seal(&message()?)?;
    run.network.storer.put(sealed.leaf.digest, sealed.blob).await?;
    let (sent, gas) = if let Some(batchers) = &run.batchers {
        (batchers[place].anchor(sealed.leaf).await?, None)
    } else {
        let timestamp = sealed.captured_at;
        let call = Call::DataUpload { digest: sealed.leaf.digest, token: account.token, timestamp };
        let Posted { hash, sent, told } = post(&run.network, &run.mined, account, &call).await?;
        let receipt = run.mined.receipt(&run.network.chain, hash, told).await?;
        (sent, Some(receipt.gas_used))
    };
    let received = Instant::now();
    Ok(Done { response: received - begun, sent, received, gas })
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
