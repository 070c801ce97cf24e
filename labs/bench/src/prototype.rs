//! The prototype's method, as described in the paper: ciphertexts are stored on the chain, in a contract deployed only
//! for benches.

use super::account::{Account, Sealed};
use super::foreign::{ForeignContract, created_address, sign_estimated};
use super::network::settle;
use authros_chain::Chain;
use authros_crypto::{EoaSecret, random_bytes};
use authros_model::Address;
use authros_service::Failure;

const CONTRACT: &str = include_str!("../../../contracts/bench/Prototype.json");
/// Gas for a word of storage that was empty (Istanbul).
const WORD_GAS: u64 = 20_000;

/// Its contract on a chain.
#[derive(Debug)]
pub struct Prototype {
    contract: ForeignContract,
    /// Its address.
    pub address: Address,
    // In the paper the token is the SM4 key: 16 bytes. This one opens nothing.
    token: [u8; 16],
}

impl Prototype {
    /// Deploys it with the account's nonce.
    ///
    /// # Errors
    /// Errors of the chain.
    pub async fn deploy(chain: &Chain, eoa: &EoaSecret, nonce: u64) -> Result<Self, Failure> {
        let contract = ForeignContract::parse(CONTRACT)?;
        let address = created_address(eoa.address(), nonce);
        settle(chain, sign_estimated(chain, eoa, nonce, None, contract.creation().to_vec()).await?).await?;
        Ok(Self { contract, address, token: random_bytes()? })
    }

    /// Registers an account.
    ///
    /// # Errors
    /// Errors of the chain.
    pub async fn register(&self, chain: &Chain, eoa: &EoaSecret, nonce: u64) -> Result<(), Failure> {
        let data = self.contract.call("register", &[&self.token])?;
        settle(chain, sign_estimated(chain, eoa, nonce, Some(self.address), data).await?).await.map(drop)
    }

    /// A message sealed by the account, and the call that stores its whole ciphertext, which is as long as the message.
    ///
    /// # Errors
    /// Errors of the random source.
    pub fn upload(&self, account: &Account, message: &[u8]) -> Result<Vec<u8>, Failure> {
        let Sealed { blob, captured_at, .. } = account.seal(message)?;
        let ciphertext = blob.get(blob.len().saturating_sub(message.len())..).unwrap_or_default();
        let timestamp = captured_at.0.to_be_bytes();
        self.contract.call("dataUpload", &[ciphertext, &self.token, &timestamp])
    }

    /// The least gas for storing this many bytes.
    pub fn least_gas(bytes: usize) -> u64 {
        (bytes as u64).div_ceil(32) * WORD_GAS
    }
}
