//! The chain itself: founding, replay, the pool and the sealing of blocks. Single-threaded.

use std::path::Path;
use std::time::{Duration, Instant};

use ethers::types::Bloom;
use ethers::utils::rlp;
use k256::ecdsa::SigningKey;

use super::block::{GAS_LIMIT, Header, receipts_root, transactions_root, unsealed_extra};
use super::file::{ChainFile, Founding, Mined};
use super::machine::{Environment, Machine, Outcome};
use super::pool::Pool;
use super::transaction::Transaction;
use crate::chain::{BlockRef, ChainError, Consensus};
use crate::model::{Address, Hash, Timestamp};

/// The least time between two blocks.
pub const PERIOD: Duration = Duration::from_millis(100);
/// How long sealing rests after the file could not be written.
const REST: Duration = Duration::from_secs(1);
/// The most transactions in a block, so that sealing never keeps readers waiting long.
const MOST_TRANSACTIONS: usize = 4096;

/// One chain, open.
pub struct Node {
    /// Its rules and state.
    pub machine: Machine,
    /// Where it lies.
    pub file: ChainFile,
    /// What waits.
    pub pool: Pool,
    /// Its chain id.
    pub chain_id: u64,
    /// Its newest block.
    pub head: BlockRef,
    /// Why the last block could not be written.
    pub trouble: Option<String>,
    signer: SigningKey,
    beneficiary: Address,
    not_before: Instant,
}

impl Node {
    /// Opens the chain in `directory`, or founds one: draws its chain id and its signer.
    ///
    /// All blocks are replayed, and their hashes must come out as they are in the file.
    ///
    /// # Errors
    /// [`ChainError::File`], or [`ChainError::Tampered`] where the file was changed.
    pub fn open(directory: &Path, asked: Option<Consensus>) -> Result<Self, ChainError> {
        let mut file = ChainFile::open(directory)?;
        if let Some(asked) = asked.filter(|asked| *asked != Consensus::POA) {
            let path = directory.join("chain.db");
            return Err(ChainError::OtherConsensus { path, founded: Consensus::POA, asked });
        }
        let founding = match file.founding()? {
            Some(founding) => founding,
            None => found(&mut file)?,
        };
        let genesis = genesis(&file, &founding)?;
        let beneficiary = address_of(&founding.signer);
        let mut node = Self {
            machine: Machine::new(founding.chain_id, genesis.state_root),
            file,
            pool: Pool::default(),
            chain_id: founding.chain_id,
            head: reference(&genesis),
            trouble: None,
            signer: founding.signer,
            beneficiary,
            not_before: Instant::now(),
        };
        node.replay(genesis)?;
        Ok(node)
    }

    fn replay(&mut self, genesis: Header) -> Result<(), ChainError> {
        let (file, chain_id, beneficiary) = (&self.file, self.chain_id, self.beneficiary);
        let machine = &mut self.machine;
        let mut last = genesis;
        file.replay(|number, hash, header, mined| {
            if number == 0 {
                return Ok(());
            }
            let blame = |what: &str| file.tampered(number, what);
            let header = Header::decode(&header).map_err(|_| blame("its header is not a header"))?;
            if header.hash() != hash || header.parent != last.hash() || header.number != number {
                return Err(blame("its hash or its parent is not what it was"));
            }
            let outcome = rerun(machine, &header, beneficiary, chain_id, &mined).map_err(|what| blame(&what))?;
            machine.apply(outcome);
            last = header;
            Ok(())
        })?;
        if last.sealer() != Some(beneficiary) {
            return Err(file.tampered(last.number, "it is not sealed by the chain's signer"));
        }
        self.head = reference(&last);
        Ok(())
    }

    /// Takes a raw transaction into the pool.
    ///
    /// # Errors
    /// Why it is refused, in geth's words.
    pub fn submit(&mut self, raw: &[u8]) -> Result<Hash, String> {
        if let Some(trouble) = &self.trouble {
            return Err(format!("no block can be written: {trouble}"));
        }
        let transaction = Transaction::decode(raw, self.chain_id, None)?;
        if transaction.gas_limit > GAS_LIMIT {
            return Err("exceeds block gas limit".into());
        }
        let floor = transaction.intrinsic_gas();
        if transaction.gas_limit < floor {
            return Err(format!("intrinsic gas too low: gas {}, minimum needed {floor}", transaction.gas_limit));
        }
        if self.machine.balance(transaction.sender) < transaction.cost() {
            return Err("insufficient funds for gas * price + value".into());
        }
        let hash = transaction.hash;
        let next = self.machine.nonce(transaction.sender);
        self.pool.add(transaction, next)?;
        Ok(hash)
    }

    /// How long until the next block is due; `None` while nothing can go into one.
    pub fn due(&self) -> Option<Duration> {
        let ready = self.pool.is_ready(|sender| self.machine.nonce(sender));
        ready.then(|| self.not_before.saturating_duration_since(Instant::now()))
    }

    /// Where the next block takes place.
    pub fn next_place(&self) -> Environment {
        let timestamp = Timestamp::now().seconds().max(self.head.timestamp);
        Environment { number: self.head.number + 1, timestamp, difficulty: 2, beneficiary: self.beneficiary }
    }

    /// Seals a block of what waits. A block that cannot be written has not happened.
    pub fn seal(&mut self) {
        let ready = self.pool.ready(MOST_TRANSACTIONS, GAS_LIMIT, |sender| self.machine.nonce(sender));
        let place = self.next_place();
        let outcome = self.machine.run(&place, ready);
        self.not_before = Instant::now() + PERIOD;
        self.pool.forget(outcome.refused.iter().map(|(transaction, _)| transaction));
        if outcome.included.is_empty() {
            return;
        }
        match self.write(&place, &outcome) {
            Ok(head) => {
                self.trouble = None;
                self.pool.forget(&outcome.included);
                self.machine.apply(outcome);
                self.head = head;
            }
            Err(error) => {
                self.trouble = Some(error.to_string());
                self.not_before = Instant::now() + REST;
            }
        }
    }

    fn write(&mut self, place: &Environment, outcome: &Outcome) -> Result<BlockRef, ChainError> {
        let mut header = header(self.head.hash, place.number, place.timestamp, outcome);
        header.seal(&self.signer).ok_or_else(|| ChainError::Internal("a block could not be sealed".into()))?;
        self.file.append(&header, &outcome.included, &outcome.receipts)?;
        Ok(reference(&header))
    }
}

fn found(file: &mut ChainFile) -> Result<Founding, ChainError> {
    let mut noise = [0; 40];
    let blame = |error: &dyn std::fmt::Display| ChainError::Internal(format!("no randomness: {error}"));
    getrandom::fill(&mut noise).map_err(|error| blame(&error))?;
    let (unique, id) = noise.split_at(32);
    let id = id.iter().fold(0u64, |id, byte| id << 8 | u64::from(*byte));
    let founding = Founding { chain_id: (1 << 40) + id % (1 << 47), signer: draw_signer()? };
    let unique = Hash::from_slice(unique).ok_or_else(|| ChainError::Internal("no randomness".into()))?;
    let mut genesis = Header::genesis(address_of(&founding.signer), unique, Timestamp::now().seconds());
    genesis
        .seal(&founding.signer)
        .ok_or_else(|| ChainError::Internal("the genesis block could not be sealed".into()))?;
    file.found(&founding, &genesis)?;
    Ok(founding)
}

fn draw_signer() -> Result<SigningKey, ChainError> {
    let mut scalar = zeroize::Zeroizing::new([0; 32]);
    loop {
        getrandom::fill(&mut scalar[..]).map_err(|error| ChainError::Internal(format!("no randomness: {error}")))?;
        if let Ok(signer) = SigningKey::from_slice(&scalar[..]) {
            return Ok(signer);
        }
    }
}

fn genesis(file: &ChainFile, founding: &Founding) -> Result<Header, ChainError> {
    let blame = |what: &str| file.tampered(0, what);
    let (hash, header) = file.block(0)?.ok_or_else(|| blame("the genesis block is gone"))?;
    let header = Header::decode(&header).map_err(|_| blame("its header is not a header"))?;
    if header.hash() != hash || header.sealer() != Some(address_of(&founding.signer)) {
        return Err(blame("its hash or its signer is not what it was"));
    }
    Ok(header)
}

/// Runs a block of the file again and compares all that its header commits to.
fn rerun(
    machine: &Machine,
    header: &Header,
    beneficiary: Address,
    chain_id: u64,
    mined: &[Mined],
) -> Result<Outcome, String> {
    let decode = |one: &Mined| Transaction::decode(&one.raw, chain_id, Some(one.sender));
    let transactions = mined.iter().map(decode).collect::<Result<Vec<_>, _>>()?;
    let place =
        Environment { number: header.number, timestamp: header.timestamp, difficulty: header.difficulty, beneficiary };
    let outcome = machine.run(&place, transactions);
    let again = Header {
        extra: header.extra.clone(),
        ..self::header(header.parent, header.number, header.timestamp, &outcome)
    };
    if again != *header {
        return Err("running its transactions again gives another block".into());
    }
    let kept = outcome.receipts.iter().zip(mined).all(|(receipt, one)| rlp::encode(receipt)[..] == one.receipt[..]);
    if kept { Ok(outcome) } else { Err("its receipts are not what they were".into()) }
}

fn header(parent: Hash, number: u64, timestamp: u64, outcome: &Outcome) -> Header {
    let mut bloom = Bloom::zero();
    for receipt in &outcome.receipts {
        receipt.accrue(&mut bloom);
    }
    Header {
        parent,
        state_root: outcome.state_root,
        transactions_root: transactions_root(&outcome.included),
        receipts_root: receipts_root(&outcome.receipts),
        bloom,
        difficulty: 2,
        number,
        gas_used: outcome.receipts.last().map_or(0, |receipt| receipt.cumulative_gas),
        timestamp,
        extra: unsealed_extra(),
    }
}

fn reference(header: &Header) -> BlockRef {
    BlockRef { number: header.number, hash: header.hash(), timestamp: header.timestamp }
}

fn address_of(signer: &SigningKey) -> Address {
    let point = signer.verifying_key().to_encoded_point(false);
    let mut xy = [0; 64];
    xy.copy_from_slice(&point.as_bytes()[1..65]);
    Address::from_public_key(&xy)
}
