//! The prototype's way, as the paper tells it: ciphertexts lie on the chain, in a contract that is deployed for
//! benches alone.

use super::account::{Account, Sealed};
use super::network::settle;
use authros_chain::{Chain, ForeignContract, created_address};
use authros_crypto::{EoaSecret, random_bytes};
use authros_model::Address;
use authros_service::Failure;

const CONTRACT: &str = include_str!("../../../contracts/bench/Prototype.json");
/// Gas of a word of storage that was empty (Istanbul).
const WORD_GAS: u64 = 20_000;

/// Its contract on a chain.
#[derive(Debug)]
pub struct Prototype {
    contract: ForeignContract,
    /// Where it is.
    pub address: Address,
    // In the paper the token is the SM4 key: 16 bytes. This one opens nothing.
    token: [u8; 16],
}

impl Prototype {
    /// Deploys it with the account's nonce.
    ///
    /// # Errors
    /// The chain's.
    pub async fn deploy(chain: &Chain, eoa: &EoaSecret, nonce: u64) -> Result<Self, Failure> {
        let contract = ForeignContract::parse(CONTRACT)?;
        let address = created_address(eoa.address(), nonce);
        settle(chain, chain.sign_bytes(eoa, nonce, None, contract.creation().to_vec()).await?).await?;
        Ok(Self { contract, address, token: random_bytes()? })
    }

    /// Registers an account.
    ///
    /// # Errors
    /// The chain's.
    pub async fn register(&self, chain: &Chain, eoa: &EoaSecret, nonce: u64) -> Result<(), Failure> {
        let data = self.contract.call("register", &[&self.token])?;
        settle(chain, chain.sign_bytes(eoa, nonce, Some(self.address), data).await?).await.map(drop)
    }

    /// A message sealed by the account, and the call that stores its ciphertext, as long as the message, whole.
    ///
    /// # Errors
    /// The random source's.
    pub fn upload(&self, account: &Account, message: &[u8]) -> Result<Vec<u8>, Failure> {
        let Sealed { blob, captured_at, .. } = account.seal(message)?;
        let ciphertext = blob.get(blob.len().saturating_sub(message.len())..).unwrap_or_default();
        let timestamp = captured_at.0.to_be_bytes();
        Ok(self.contract.call("dataUpload", &[ciphertext, &self.token, &timestamp])?)
    }

    /// Gas that storing so many bytes costs at least.
    pub fn least_gas(bytes: usize) -> u64 {
        (bytes as u64).div_ceil(32) * WORD_GAS
    }
}
