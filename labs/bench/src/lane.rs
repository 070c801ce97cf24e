//! Sends calls in an account's nonce lane, shared by many uploaders. A node that does not answer is asked again: the
//! nonce is taken, and a gap would hold up everything after it.

use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use super::account::Account;
use super::foreign;
use super::mined::Mined;
use super::network::Network;
use authros_chain::{Call, Chain, ChainError, Offered, SignedTransaction};
use authros_model::{Address, Hash};
use authros_service::Failure;
use authros_service::reply::internal;

/// How often a silent node is asked.
const ATTEMPTS: u32 = 8;
/// How long to wait in between.
const PAUSE: Duration = Duration::from_millis(500);

/// The action of a transaction.
#[derive(Debug, Clone, Copy)]
pub enum Deed<'a> {
    /// A call of our contract.
    Call(&'a Call),
    /// A call of another one, with known gas.
    Foreign {
        /// The contract.
        to: Address,
        /// Call data.
        data: &'a [u8],
        /// The most gas it may use.
        gas: u64,
    },
}

/// A transaction in flight.
pub struct Posted {
    /// Its hash.
    pub hash: Hash,
    /// When it was sent.
    pub sent: Instant,
    /// Resolves when it is in a block.
    pub told: oneshot::Receiver<()>,
}

/// Signs a call with the lane's next nonce and sends it.
///
/// # Errors
/// Errors of the chain.
pub async fn post(network: &Network, mined: &Mined, account: &Account, deed: Deed<'_>) -> Result<Posted, Failure> {
    let _turn = network.line.acquire().await.map_err(|_| internal("the line is closed"))?;
    let nonce = account.next_nonce();
    let signed = sign(network, account, nonce, deed).await?;
    let told = mined.expect(signed.hash);
    let sent = Instant::now();
    broadcast(&network.chain, &signed.raw).await?;
    Ok(Posted { hash: signed.hash, sent, told })
}

async fn sign(network: &Network, account: &Account, nonce: u64, deed: Deed<'_>) -> Result<SignedTransaction, Failure> {
    let price = patiently(|| network.price()).await?;
    match deed {
        Deed::Call(call) => {
            let sign = || network.chain.sign_at(&account.eoa, nonce, call, price);
            Ok(patiently(sign).await?)
        }
        Deed::Foreign { to, data, gas } => foreign::sign(
            &network.chain,
            &account.eoa,
            nonce,
            Some(to),
            data.to_vec(),
            Offered { price, gas, value: 0 },
        ),
    }
}

/// Asks a silent node again.
async fn patiently<T, F>(ask: impl Fn() -> F) -> Result<T, ChainError>
where
    F: Future<Output = Result<T, ChainError>>,
{
    let mut attempt = 1;
    loop {
        match ask().await {
            Err(ChainError::Unreachable { .. }) if attempt < ATTEMPTS => tokio::time::sleep(PAUSE).await,
            answered => return answered,
        }
        attempt += 1;
    }
}

async fn broadcast(chain: &Chain, raw: &[u8]) -> Result<(), ChainError> {
    let mut attempt = 1;
    loop {
        match chain.broadcast(raw).await {
            Ok(_) => return Ok(()),
            // An attempt whose answer was lost had arrived after all.
            Err(ChainError::AlreadyKnown | ChainError::NonceTooLow) if attempt > 1 => return Ok(()),
            Err(ChainError::Unreachable { .. }) if attempt < ATTEMPTS => tokio::time::sleep(PAUSE).await,
            Err(error) => return Err(error),
        }
        attempt += 1;
    }
}
