//! Founding a new chain, and recognising an existing one: chain id, keys, genesis block.

use ethers::utils::keccak256;
use k256::ecdsa::SigningKey;
use zeroize::Zeroizing;

use super::block::Header;
use super::file::{ChainFile, Founding, keys_of};
use super::sealing::Sealing;
use crate::chain::{ChainError, Consensus};
use crate::model::{Hash, Timestamp};

/// Length of the random part of a genesis block, which also commits to the consensus.
const RANDOM: usize = 16;

/// The founding data of a chain.
pub struct Founded {
    /// Its chain id.
    pub chain_id: u64,
    /// How its blocks are sealed.
    pub consensus: Consensus,
    /// The same, with its keys.
    pub sealing: Sealing,
    /// Its first block.
    pub genesis: Header,
}

/// The chain in the file, or a new one.
///
/// # Errors
/// [`ChainError::OtherConsensus`] if a different consensus is requested from the one the chain was founded with,
/// [`ChainError::Tampered`] if the founding data do not match the genesis block.
pub fn open(file: &ChainFile, asked: Option<Consensus>) -> Result<Founded, ChainError> {
    let Founding { chain_id, consensus, keys } = match file.founding()? {
        Some(founding) => founding,
        None => found(file, asked.unwrap_or_default())?,
    };
    if let Some(asked) = asked.filter(|asked| *asked != consensus) {
        return Err(ChainError::OtherConsensus { path: file.path().to_owned(), founded: consensus, asked });
    }
    let sealing = Sealing::new(&consensus, keys);
    let genesis = genesis(file, &consensus, &sealing)?;
    Ok(Founded { chain_id, consensus, sealing, genesis })
}

fn found(file: &ChainFile, consensus: Consensus) -> Result<Founding, ChainError> {
    if !consensus.is_usable() {
        return Err(ChainError::Input(format!("'{consensus}' is not a usable consensus; see `chain.consensus`")));
    }
    let id = u64::from_be_bytes(noise()?);
    let keys = (0..keys_of(&consensus)).map(|_| draw_key()).collect::<Result<Vec<_>, _>>()?;
    let sealing = Sealing::new(&consensus, keys.clone());
    let mut genesis = sealing.genesis(commitment(noise()?, &consensus), Timestamp::now().seconds());
    if let Sealing::Authority(authority) = &sealing {
        let sealed = authority.seal(&mut genesis, 0);
        sealed.ok_or_else(|| ChainError::Internal("the genesis block could not be sealed".into()))?;
    }
    let founding = Founding { chain_id: (1 << 40) + id % (1 << 47), consensus, keys };
    file.found(&founding, &genesis)?;
    Ok(founding)
}

/// 16 random bytes, and 16 bytes of the Keccak-256 of them and the consensus, which therefore cannot be changed later.
fn commitment(random: [u8; RANDOM], consensus: &Consensus) -> Hash {
    let mut unique = keccak256([&random[..], consensus.to_string().as_bytes()].concat());
    unique[..RANDOM].copy_from_slice(&random);
    Hash(unique)
}

fn noise<const N: usize>() -> Result<[u8; N], ChainError> {
    let mut noise = [0; N];
    getrandom::fill(&mut noise).map_err(|error| ChainError::Internal(format!("no randomness: {error}")))?;
    Ok(noise)
}

fn draw_key() -> Result<SigningKey, ChainError> {
    let mut scalar = Zeroizing::new([0; 32]);
    loop {
        getrandom::fill(&mut scalar[..]).map_err(|error| ChainError::Internal(format!("no randomness: {error}")))?;
        if let Ok(key) = SigningKey::from_slice(&scalar[..]) {
            return Ok(key);
        }
    }
}

fn genesis(file: &ChainFile, consensus: &Consensus, sealing: &Sealing) -> Result<Header, ChainError> {
    let blame = |what: &str| file.tampered(0, what);
    let (hash, header) = file.block(0)?.ok_or_else(|| blame("the genesis block is missing"))?;
    let header = Header::decode(&header).map_err(|_| blame("its header is not a header"))?;
    if header.hash() != hash || !sealing.founded(&header) {
        return Err(blame("its hash or its signers were changed"));
    }
    let committed = Sealing::unique(&header).is_some_and(|unique| {
        let random = unique.0.first_chunk().copied().unwrap_or_default();
        commitment(random, consensus) == unique
    });
    if !committed {
        return Err(blame("its consensus was changed"));
    }
    Ok(header)
}
