//! The chain itself: the pool, assembling blocks and sealing them. Single-threaded, except for the proof-of-work
//! search, which runs beside it, one at a time, for the very block that was assembled.

use std::collections::VecDeque;
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::admission::{BLOCK_GAS, TRANSACTION_GAS};
use super::auditing::Auditing;
use super::authority::{Authority, OUT_OF_TURN, Turn};
use super::block::Header;
use super::file::{ChainFile, Sealed};
use super::founding::{self, Founded};
use super::machine::{Environment, Machine, Outcome};
use super::pool::Pool;
use super::proof::{self, Search};
use super::reading::Looked;
use super::replay::{assemble, newest};
use super::sealing::Sealing;
use super::transaction::Transaction;
use crate::chain::{BlockRef, ChainError, Consensus};
use crate::model::{Hash, Timestamp};

/// How long sealing pauses after the file could not be written.
const REST: Duration = Duration::from_secs(1);
/// The most transactions in a block, so that sealing never keeps readers waiting long.
const MOST_TRANSACTIONS: usize = 4096;

/// Receives the nonce that a search found, on the search's thread.
pub type Found = Arc<dyn Fn(u64) + Send + Sync>;

/// One chain, open.
pub struct Node {
    /// Its rules and state.
    pub machine: Machine,
    /// The file.
    pub file: Rc<ChainFile>,
    /// The blocks whose transactions were read or written last.
    pub looked: Looked,
    /// The pending transactions.
    pub pool: Pool,
    /// Its chain id.
    pub chain_id: u64,
    /// Its founding data.
    pub consensus: Consensus,
    /// Its sealing.
    pub sealing: Sealing,
    /// Its newest block.
    pub head: BlockRef,
    /// Audits in progress.
    pub audits: VecDeque<Auditing>,
    /// Why the last block could not be written.
    pub trouble: Option<String>,
    not_before: Instant,
    work: Option<Work>,
    found: Found,
}

/// A block waiting for its proof of work.
struct Work {
    header: Header,
    outcome: Outcome,
    /// Ends when dropped.
    _search: Search,
}

impl Node {
    /// Opens the chain in `directory`, or founds one with the requested consensus, drawing its chain id and keys.
    ///
    /// The newest block is run again and must come out as in the file; older blocks are authenticated through it when
    /// read.
    ///
    /// # Errors
    /// [`ChainError::File`], [`ChainError::Tampered`] if the file was changed, or [`ChainError::OtherConsensus`].
    pub fn open(directory: &Path, asked: Option<Consensus>, found: Found) -> Result<Self, ChainError> {
        let file = Rc::new(ChainFile::open(directory)?);
        let mut founded = founding::open(&file, asked)?;
        let (machine, head) = newest(&file, &mut founded)?;
        let Founded { chain_id, consensus, sealing, .. } = founded;
        // The period is kept across a restart, even if the clock changed.
        let due = (head.timestamp + sealing.period().as_secs()).saturating_sub(Timestamp::now().seconds());
        let wait = if head.number == 0 { Duration::ZERO } else { Duration::from_secs(due).min(sealing.period()) };
        Ok(Self {
            machine,
            file,
            looked: Looked::default(),
            pool: Pool::default(),
            chain_id,
            consensus,
            sealing,
            head: reference(&head),
            audits: VecDeque::new(),
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
        let transaction = Transaction::decode(raw, self.chain_id)?;
        if transaction.gas_limit > TRANSACTION_GAS {
            let limit = transaction.gas_limit;
            return Err(format!("exceeds the gas limit of a transaction: gas {limit}, at most {TRANSACTION_GAS}"));
        }
        let floor = transaction.intrinsic_gas();
        if transaction.gas_limit < floor {
            return Err(format!("intrinsic gas too low: gas {}, minimum needed {floor}", transaction.gas_limit));
        }
        let unread = |error: ChainError| error.to_string();
        if self.machine.balance(transaction.sender).map_err(unread)? < transaction.cost() {
            return Err("insufficient funds for gas * price + value".into());
        }
        let hash = transaction.hash;
        let next = self.machine.nonce(transaction.sender).map_err(unread)?;
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

    /// How long until the next block is to be assembled; `None` while nothing can go into one, while a proof of work is
    /// being searched for, and while no signer may seal.
    pub fn due(&self) -> Option<Duration> {
        let ready = self.work.is_none() && self.pool.is_ready();
        let turn = if ready { self.turn() } else { None };
        turn.map(|turn| (self.not_before + turn.delay).saturating_duration_since(Instant::now()))
    }

    /// Whether a proof of work is being searched for.
    pub fn is_mining(&self) -> bool {
        self.work.is_some()
    }

    /// The context of the next block.
    pub fn next_place(&self) -> Environment {
        let signer = self.turn().map(|turn| turn.signer);
        self.sealing.place(self.head.number + 1, self.head.timestamp, signer)
    }

    /// Assembles a block of pending transactions, and seals it or begins to search for its proof of work.
    pub fn assemble(&mut self) {
        let Some(turn) = self.turn() else { return };
        let ready = self.pool.ready(MOST_TRANSACTIONS, BLOCK_GAS);
        let place = self.next_place();
        let outcome = match self.machine.run(&place, ready, true) {
            Ok(outcome) => outcome,
            Err(error) => return self.rest(error),
        };
        self.not_before = Instant::now() + self.sealing.period();
        self.pool.forget(outcome.refused.iter().map(|(transaction, _)| transaction));
        if outcome.included.is_empty() {
            return;
        }
        let mut header = match assemble(&self.sealing, self.head.hash, &place, &outcome) {
            Ok(header) => header,
            Err(error) => return self.rest(error),
        };
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

    /// Writes a sealed block. One that cannot be written never happened.
    fn settle(&mut self, header: &Header, mut outcome: Outcome, signer: usize) {
        let turn = |authority: &Authority| authority.difficulty(header.number, signer) == OUT_OF_TURN;
        let Outcome { included, receipts, written, .. } = &outcome;
        let out_of_turn = self.sealing.authority().is_some_and(turn);
        match self.file.append(&Sealed { header, sent: included, receipts, written, out_of_turn }) {
            Ok(()) => {
                self.trouble = None;
                self.pool.mined(included);
                self.file.remember(std::mem::take(&mut outcome.written.made));
                let (included, receipts) =
                    (std::mem::take(&mut outcome.included), std::mem::take(&mut outcome.receipts));
                self.looked.wrote(header.number, included, receipts);
                self.machine.tries.root = outcome.state_root;
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

    /// At the end, seals pending transactions if that can be done at once: work takes time, and so does a period of a
    /// second or more, which the next block's time would contradict.
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
