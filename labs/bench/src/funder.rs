//! Who pays on a network whose new accounts hold nothing: an account of the operator's lends ether to the bench's
//! accounts and gets back what is left, also when the bench fails or is interrupted.

use std::time::{Duration, Instant};

use tokio::sync::Mutex;

use super::all;
use super::args::Bench;
use super::network::{PATIENCE, receipt, settle};
use authros_chain::{Chain, SignedTransaction};
use authros_crypto::{EoaSecret, keyfile};
use authros_model::{Address, ErrorKind};
use authros_service::Failure;

/// Gas of a transfer without data.
const TRANSFER: u128 = 21_000;
/// Gas for the contracts and the registrations of one account.
const FOUNDING: u64 = 20_000_000;
/// Gas of one account for each uploader of `consensus`, one by one and in batches.
const EACH_UPLOADER: u64 = 100_000;
/// Gas of one account for each run of `size`: all sizes, also with all bytes on the chain.
const EACH_RUN: u64 = 16_000_000;
/// What is lent for each unit of gas, in prices of now: prices rise under load.
const ROOM: u128 = 2;
/// How often taking back is tried: what the bench sent last may still arrive.
const ATTEMPTS: u32 = 5;

/// An account that was lent ether.
struct Lent {
    chain: Chain,
    eoa: EoaSecret,
    gift: SignedTransaction,
}

/// The operator's account, and what it lent.
pub struct Funder {
    purse: EoaSecret,
    /// Gas that one account may need.
    gas: u64,
    lent: Mutex<Vec<Lent>>,
}

impl Funder {
    /// The one that the arguments name, if they do.
    ///
    /// # Errors
    /// If its key file cannot be used.
    pub fn of(bench: &Bench) -> Result<Option<Self>, Failure> {
        let of_uploaders = |uploaders: &[u32]| {
            uploaders.iter().map(|count| u64::from(*count)).sum::<u64>().saturating_mul(EACH_UPLOADER)
        };
        let of_runs = |runs: u32| u64::from(runs).saturating_mul(EACH_RUN);
        let (node, gas) = match bench {
            Bench::Consensus(asked) => (&asked.network.node, of_uploaders(&asked.uploaders)),
            Bench::Size(asked) => (&asked.network.node, of_runs(asked.runs)),
            // Of the two benches on a node, size needs more.
            Bench::All(asked) => (&asked.node, of_runs(all::uploads(asked))),
            Bench::Sm2(_)
            | Bench::Sm3(_)
            | Bench::Sm4(_)
            | Bench::Record(_)
            | Bench::Gas
            | Bench::Gateway(_)
            | Bench::Pipeline(_)
            | Bench::Pages(_) => return Ok(None),
        };
        let Some(file) = &node.funder else { return Ok(None) };
        let purse = keyfile::load_eoa(file, None)?;
        Ok(Some(Self { purse, gas: gas.saturating_add(FOUNDING), lent: Mutex::default() }))
    }

    /// Lends an account what its uploads may cost. On a network without fees that is nothing.
    ///
    /// # Errors
    /// If it has too little itself, or the node refuses the transfer.
    pub async fn lend(&self, chain: &Chain, eoa: &EoaSecret) -> Result<(), Failure> {
        let price = chain.market().await?.offer();
        let wei = price.saturating_mul(ROOM).saturating_mul(u128::from(self.gas));
        if wei == 0 {
            return Ok(());
        }
        let (purse, needed) = (self.purse.address(), wei.saturating_add(price.saturating_mul(TRANSFER)));
        let wealth = chain.wealth(purse).await?;
        if wealth < needed {
            return Err(poor(purse, wealth, needed));
        }
        let gift = chain.sign_transfer(&self.purse, chain.nonce(purse, true).await?, eoa.address(), wei, price)?;
        // Kept before it is sent: whatever happens from here on, it is taken back.
        self.lent.lock().await.push(Lent { chain: chain.clone(), eoa: eoa.clone(), gift: gift.clone() });
        settle(chain, gift).await.map(drop)
    }

    /// Takes back what is left of all that was lent, but for the fee of doing so.
    ///
    /// # Errors
    /// If something was not given back: names the account.
    pub async fn take_back(&self) -> Result<(), Failure> {
        let mut problem = Ok(());
        for lent in self.lent.lock().await.drain(..) {
            let mut swept = self.sweep(&lent).await;
            for _ in 1..ATTEMPTS {
                if swept.is_ok() {
                    break;
                }
                tokio::time::sleep(Duration::from_secs(1)).await;
                swept = self.sweep(&lent).await;
            }
            problem = problem.and(swept.map_err(|failure| kept(lent.eoa.address(), &failure)));
        }
        problem
    }

    async fn sweep(&self, lent: &Lent) -> Result<(), Failure> {
        let Lent { chain, eoa, gift } = lent;
        let (account, purse) = (eoa.address(), self.purse.address());
        if chain.nonce(purse, true).await? <= gift.nonce {
            // The bench ended before it was sent.
            return Ok(());
        }
        receipt(chain, gift.hash).await?;
        let nonce = settled(chain, account).await?;
        let price = chain.market().await?.offer();
        let left = chain.wealth(account).await?.saturating_sub(price.saturating_mul(TRANSFER));
        if left == 0 {
            return Ok(());
        }
        let back = chain.sign_transfer(eoa, nonce, purse, left, price)?;
        settle(chain, back).await.map(drop)
    }
}

/// The account's next nonce, once none of its transactions waits for a block.
async fn settled(chain: &Chain, account: Address) -> Result<u64, Failure> {
    let begun = Instant::now();
    loop {
        let head = chain.head().await?.number;
        let (sent, mined) = (chain.nonce(account, true).await?, chain.nonce(account, false).await?);
        if sent <= mined || begun.elapsed() > PATIENCE {
            return Ok(mined);
        }
        chain.next_block(head, Duration::from_secs(1)).await?;
    }
}

fn poor(purse: Address, wealth: u128, needed: u128) -> Failure {
    let text = format!(
        "the account {purse} of --funder has {wealth} wei, and each of the benchmark's two accounts is lent {needed}: \
         give it more, or measure fewer uploads"
    );
    Failure::new(ErrorKind::Refused, text)
}

fn kept(account: Address, failure: &Failure) -> Failure {
    let text = format!(
        "what is left of the ether lent to {account} was not given back to --funder, and its key was never written \
         down: {}",
        failure.message
    );
    Failure::new(failure.kind, text)
}
