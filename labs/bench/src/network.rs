//! A network to measure on: a throw-away embedded chain or a node, with a freshly deployed contract and two registered
//! throw-away accounts.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tempfile::TempDir;
use tokio::sync::{Mutex, Semaphore};

use super::account::Account;
use super::foreign::block;
use super::funder::Funder;
use super::storer::Storer;
use authros_chain::{Chain, ChainError, ChainOptions, Consensus, Endpoint, Receipt, Sealing, SignedTransaction};
use authros_crypto::{EoaSecret, Provider};
use authros_model::{ErrorKind, Hash, Wei};
use authros_service::Failure;
use authros_service::reply::internal;

/// How long a single transaction may wait for its block.
pub const PATIENCE: Duration = Duration::from_secs(120);

/// How often removing a directory is tried.
const REMOVALS: u32 = 10;
/// How long to wait in between.
const BETWEEN_REMOVALS: Duration = Duration::from_millis(20);
/// How long a gas price is used.
const PRICE_HOLDS: Duration = Duration::from_secs(1);
/// Simultaneous requests to a node, so that neither side runs out of descriptors.
const MOST_REQUESTS: usize = 64;

/// Where to measure.
#[derive(Debug, Clone)]
pub enum Place {
    /// A chain in a temporary directory.
    Embedded(Consensus),
    /// A node by its URL.
    Node(String),
}

/// A directory removed on drop, even while a chain that is ending closes its files in it.
pub struct Directory(TempDir);

impl Directory {
    /// A new one.
    ///
    /// # Errors
    /// If it cannot be created.
    pub fn new() -> Result<Self, Failure> {
        Self::within(&std::env::temp_dir())
    }

    /// A new one in `parent`.
    ///
    /// # Errors
    /// If it cannot be created.
    pub fn within(parent: &Path) -> Result<Self, Failure> {
        let made = tempfile::Builder::new().prefix("authros-bench-").tempdir_in(parent);
        let made = made.map_err(|error| {
            Failure::new(ErrorKind::Home, format!("no temporary directory can be created: {error}; set TMPDIR"))
        });
        made.map(Self)
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        self.0.path()
    }
}

impl Drop for Directory {
    fn drop(&mut self) {
        for _ in 0..REMOVALS {
            if std::fs::remove_dir_all(self.path()).is_ok() || !self.path().exists() {
                return;
            }
            std::thread::sleep(BETWEEN_REMOVALS);
        }
    }
}

/// A network ready for uploads.
pub struct Network {
    /// `embedded` or `node`.
    pub kind: &'static str,
    /// `poa`, `pow`, `pos` or `dev`.
    pub consensus: String,
    /// The node's name and version.
    pub client: String,
    /// Its period or difficulty, if it says.
    pub sealing: Sealing,
    /// The most gas in a block.
    pub gas_limit: u64,
    /// The chain.
    pub chain: Chain,
    /// The uploaders.
    pub accounts: [Arc<Account>; 2],
    /// The store.
    pub storer: Storer,
    /// Requests in flight.
    pub line: Semaphore,
    price: Mutex<Option<(Instant, u128)>>,
}

impl Network {
    /// Opens it, deploys the contract, registers the accounts, opens a store; the files are in `directory`. On a node
    /// a funder pays, if there is one.
    ///
    /// # Errors
    /// If the node does not answer or gives no ether, or nothing can be written.
    pub async fn open(
        place: &Place,
        provider: &'static dyn Provider,
        directory: &Path,
        funder: Option<&Funder>,
    ) -> Result<Self, Failure> {
        let chain = connect(place, directory).await?;
        let [one, other] = [EoaSecret::generate()?, EoaSecret::generate()?];
        for eoa in [&one, &other] {
            match funder.filter(|_| matches!(place, Place::Node(_))) {
                Some(funder) => funder.lend(&chain, eoa).await?,
                None => chain.fund_from_node(eoa.address()).await.map(drop)?,
            }
        }
        chain.deploy(&one).await.map_err(|error| poor(error, &chain))?;
        let one = join(&chain, one, provider).await?;
        let other = join(&chain, other, provider).await?;
        let status = chain.status(None).await?;
        let head = block(&chain, status.block).await?.ok_or_else(|| internal("the newest block is missing"))?;
        let embedded = matches!(place, Place::Embedded(_));
        Ok(Self {
            kind: if embedded { "embedded" } else { "node" },
            consensus: status.consensus,
            client: status.client,
            sealing: chain.sealing().await?,
            gas_limit: head.gas_limit,
            storer: Storer::open(&directory.join("store"))?,
            line: Semaphore::new(if embedded { Semaphore::MAX_PERMITS } else { MOST_REQUESTS }),
            price: Mutex::default(),
            chain,
            accounts: [Arc::new(one), Arc::new(other)],
        })
    }

    /// The gas price, wei, requested again every second: the embedded chain's is zero, a node's may rise.
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn price(&self) -> Result<u128, ChainError> {
        let mut known = self.price.lock().await;
        if let Some((_, price)) = known.filter(|(asked, _)| asked.elapsed() < PRICE_HOLDS) {
            return Ok(price);
        }
        let price = self.chain.market().await?.offer();
        *known = Some((Instant::now(), price));
        Ok(price)
    }

    /// Whether its chain is in this process.
    pub fn is_embedded(&self) -> bool {
        self.kind == "embedded"
    }

    /// Its kind and settings, in one line.
    pub fn preset(&self) -> String {
        let sealing = match (self.sealing.period, &self.sealing.difficulty) {
            (Some(period), _) => format!("block period at least {period} ms"),
            (None, Some(difficulty)) => match difficulty.parse::<u64>() {
                Ok(difficulty) => format!("difficulty {difficulty:#x}, no fixed period"),
                Err(_) => format!("difficulty {difficulty}, no fixed period"),
            },
            (None, None) => "period as set by the node".to_owned(),
        };
        format!("{}: {}, {sealing}, gas limit {:#x}", self.name(), self.client, self.gas_limit)
    }

    /// Its name.
    pub fn name(&self) -> String {
        format!("{} {}", self.kind, self.consensus)
    }
}

async fn connect(place: &Place, directory: &Path) -> Result<Chain, Failure> {
    let endpoint = match place {
        Place::Embedded(consensus) => {
            Endpoint::Embedded { directory: directory.join("chain"), consensus: Some(*consensus) }
        }
        Place::Node(url) => Endpoint::Node { url: url.clone(), roots: None },
    };
    let options = ChainOptions { endpoint, contract: None, pinned: None };
    // This error's advice names a setting; here it is an argument.
    Chain::connect(options).await.map_err(|error| match error {
        ChainError::Unreachable { url, reason, .. } => {
            let text = format!("the node at {url} {reason}; start it or correct --node");
            Failure::new(ErrorKind::Unreachable, text)
        }
        other => other.into(),
    })
}

fn poor(error: ChainError, chain: &Chain) -> Failure {
    match error {
        ChainError::InsufficientFunds | ChainError::NoEther(_) => {
            let text = format!(
                "the benchmark's temporary accounts have no ether on {}; name an account that lends it \
                 with --funder, or use a development node such as anvil, or a network without fees",
                chain.url()
            );
            Failure::new(ErrorKind::Refused, text)
        }
        other => other.into(),
    }
}

/// A registered account with these keys.
///
/// # Errors
/// Errors of the chain.
pub async fn join(chain: &Chain, eoa: EoaSecret, provider: &'static dyn Provider) -> Result<Account, Failure> {
    let nonce = chain.nonce(eoa.address(), true).await?;
    let account = Account::new(chain, eoa, nonce, provider)?;
    let signed = chain.sign(&account.eoa, account.next_nonce(), &account.registration()?).await;
    settle(chain, signed.map_err(|error| poor(error, chain))?).await?;
    Ok(account)
}

/// Sends one signed transaction and waits until it took effect.
///
/// # Errors
/// Errors of the chain, or why it failed.
pub async fn settle(chain: &Chain, signed: SignedTransaction) -> Result<Receipt, Failure> {
    chain.broadcast(&signed.raw).await.map_err(|error| poor(error, chain))?;
    let receipt = receipt(chain, signed.hash).await?;
    if receipt.success {
        return Ok(receipt);
    }
    Err(Failure::new(
        ErrorKind::Refused,
        receipt.reason.unwrap_or_else(|| "a transaction failed on the chain".to_owned()),
    ))
}

/// Waits for the block of a transaction.
///
/// # Errors
/// Errors of the chain, or that it is in none after two minutes.
pub async fn receipt(chain: &Chain, hash: Hash) -> Result<Receipt, Failure> {
    let begun = Instant::now();
    while begun.elapsed() < PATIENCE {
        let head = chain.head().await?.number;
        if let Some(receipt) = chain.receipt(hash).await? {
            return Ok(receipt);
        }
        chain.next_block(head, Duration::from_secs(1)).await?;
    }
    Err(ChainError::NotMined { seconds: PATIENCE.as_secs(), blocks: 0, price: Wei::default() }.into())
}
