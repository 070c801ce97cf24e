//! The chain itself: the pool, the assembling of blocks and their sealing. Single-threaded, but for the
//! search of a proof of work: it goes on beside, one at a time, for the very block that was assembled.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::authority::Turn;
use super::block::{GAS_LIMIT, Header};
use super::file::ChainFile;
use super::founding;
use super::machine::{Environment, Machine, Outcome};
use super::pool::Pool;
use super::proof::{self, Search};
use super::replay::{assemble, replay};
use super::sealing::Sealing;
use super::transaction::Transaction;
use crate::chain::{BlockRef, ChainError, Consensus};
use crate::model::{Hash, Timestamp};

/// How long sealing rests after the file could not be written.
const REST: Duration = Duration::from_secs(1);
/// The most transactions in a block, so that sealing never keeps readers waiting long.
const MOST_TRANSACTIONS: usize = 4096;

/// Hears of the nonce that a search found, on the search's thread.
pub type Found = Arc<dyn Fn(u64) + Send + Sync>;

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
    /// What it was founded with.
    pub consensus: Consensus,
    /// Who seals its blocks.
    pub sealing: Sealing,
    /// Its newest block.
    pub head: BlockRef,
    /// Why the last block could not be written.
    pub trouble: Option<String>,
    not_before: Instant,
    work: Option<Work>,
    found: Found,
}

/// A block that waits for its proof of work.
struct Work {
    header: Header,
    outcome: Outcome,
    /// Ends when dropped.
    _search: Search,
}

impl Node {
    /// Opens the chain in `directory`, or founds one with the consensus asked for: draws its chain id
    /// and its keys.
    ///
    /// All blocks are replayed, and their hashes must come out as they are in the file.
    ///
    /// # Errors
    /// [`ChainError::File`], [`ChainError::Tampered`] where the file was changed, or
    /// [`ChainError::OtherConsensus`].
    pub fn open(directory: &Path, asked: Option<Consensus>, found: Found) -> Result<Self, ChainError> {
        let mut file = ChainFile::open(directory)?;
        let (chain_id, consensus, mut sealing, genesis) = founding::open(&mut file, asked)?;
        let mut machine = Machine::new(chain_id, genesis.state_root);
        let head = replay(&file, &mut machine, &mut sealing, chain_id, genesis)?;
        // The period holds over a restart, whatever became of the clock.
        let due = (head.timestamp + sealing.period().as_secs()).saturating_sub(Timestamp::now().seconds());
        let wait = if head.number == 0 { Duration::ZERO } else { Duration::from_secs(due).min(sealing.period()) };
        Ok(Self {
            machine,
            file,
            pool: Pool::default(),
            chain_id,
            consensus,
            sealing,
            head: reference(&head),
            trouble: None,
            not_before: Instant::now() + wait,
            work: None,
            found,
        })
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

    fn turn(&self) -> Option<Turn> {
        match &self.sealing {
            Sealing::Authority(authority) => authority.turn(self.head.number + 1, self.head.hash),
            Sealing::Work { difficulty, .. } => {
                Some(Turn { signer: 0, difficulty: *difficulty, delay: Duration::ZERO })
            }
        }
    }

    /// How long until the next block is to be assembled; `None` while nothing can go into one, while a
    /// proof of work is searched for, and while nobody may seal.
    pub fn due(&self) -> Option<Duration> {
        let ready = self.work.is_none() && self.pool.is_ready(|sender| self.machine.nonce(sender));
        let turn = if ready { self.turn() } else { None };
        turn.map(|turn| (self.not_before + turn.delay).saturating_duration_since(Instant::now()))
    }

    /// Whether a proof of work is being searched for.
    pub fn is_mining(&self) -> bool {
        self.work.is_some()
    }

    /// Where the next block takes place.
    pub fn next_place(&self) -> Environment {
        let signer = self.turn().map(|turn| turn.signer);
        self.sealing.place(self.head.number + 1, self.head.timestamp, signer)
    }

    /// Assembles a block of what waits, and seals it or begins to search for its proof of work.
    pub fn assemble(&mut self) {
        let Some(turn) = self.turn() else { return };
        let ready = self.pool.ready(MOST_TRANSACTIONS, GAS_LIMIT, |sender| self.machine.nonce(sender));
        let place = self.next_place();
        let outcome = self.machine.run(&place, ready);
        self.not_before = Instant::now() + self.sealing.period();
        self.pool.forget(outcome.refused.iter().map(|(transaction, _)| transaction));
        if outcome.included.is_empty() {
            return;
        }
        let mut header = assemble(&self.sealing, self.head.hash, &place, &outcome);
        match &self.sealing {
            Sealing::Authority(authority) => match authority.seal(&mut header, turn.signer) {
                Some(()) => self.settle(&header, outcome, turn.signer),
                None => self.rest(ChainError::Internal("a block could not be sealed".into())),
            },
            Sealing::Work { difficulty, .. } => match self.search(&header, *difficulty) {
                Ok(search) => self.work = Some(Work { header, outcome, _search: search }),
                Err(error) => self.rest(error),
            },
        }
    }

    fn search(&self, header: &Header, difficulty: u64) -> Result<Search, ChainError> {
        let internal = |error: &dyn std::fmt::Display| ChainError::Internal(format!("no work can be done: {error}"));
        let mut first = [0; 8];
        getrandom::fill(&mut first).map_err(|error| internal(&error))?;
        let found = Arc::clone(&self.found);
        let tell = move |nonce| found(nonce);
        let search = Search::start(header.work_hash(), difficulty, u64::from_be_bytes(first), tell);
        search.map_err(|error| internal(&error))
    }

    /// Seals the assembled block with the nonce that its search found.
    pub fn worked(&mut self, nonce: u64) {
        let Some(Work { header, outcome, .. }) = self.work.take() else { return };
        let header = Header { nonce, ..header };
        if proof::seals(header.work_hash(), nonce, header.difficulty) {
            self.settle(&header, outcome, 0);
        }
    }

    /// Writes a sealed block. One that cannot be written has not happened.
    fn settle(&mut self, header: &Header, outcome: Outcome, signer: usize) {
        match self.file.append(header, &outcome.included, &outcome.receipts) {
            Ok(()) => {
                self.trouble = None;
                self.pool.forget(&outcome.included);
                self.machine.apply(outcome);
                self.head = reference(header);
                if let Sealing::Authority(authority) = &mut self.sealing {
                    authority.sealed(header.number, signer);
                }
            }
            Err(error) => self.rest(error),
        }
    }

    fn rest(&mut self, error: ChainError) {
        self.trouble = Some(error.to_string());
        self.not_before = Instant::now() + REST;
    }

    /// Seals what waits where that can be done at once, at the end: work takes its time, and so does a
    /// period of a second or more, which the next block's time would belie.
    pub fn finish(&mut self) {
        let at_once = self.turn().is_some_and(|turn| turn.delay.is_zero());
        let brief = matches!(&self.sealing, Sealing::Authority(authority) if authority.period().as_secs() == 0);
        if at_once && brief && self.due().is_some() {
            self.assemble();
        }
    }
}

fn reference(header: &Header) -> BlockRef {
    BlockRef { number: header.number, hash: header.hash(), timestamp: header.timestamp }
}
