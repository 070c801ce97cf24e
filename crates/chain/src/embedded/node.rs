//! The chain itself: the pool, assembling blocks and sealing them. Single-threaded, except for the proof-of-work
//! search, which runs beside it, one at a time, for the very block that was assembled.

use std::cell::RefCell;
use std::collections::{HashMap, VecDeque};
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;
use std::time::{Duration, Instant};

use ethers::types::Bloom;
use ethers::utils::rlp;

use super::block::{Header, Transaction};
use super::file::{Auditing, ChainFile, Looked, Sealed};
use super::machine::{Environment, Machine, Outcome};
use super::pool::{BLOCK_GAS, Pool, TRANSACTION_GAS};
use super::proof::{self, Search};
use super::sealing::{self, Authority, Founded, OUT_OF_TURN, Sealing, Turn};
use super::trie::{EMPTY_ROOT, Nodes, below, receipts_root, transactions_root};
use super::world::{Ground, Tries, Written};
use crate::model::{Hash, Timestamp};
use crate::{BlockRef, ChainError, Consensus};

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
        let mut founded = sealing::open(&file, asked)?;
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

// Running blocks from the file again: all of them for an audit, or only the newest when a chain is opened.

/// A chain being run again from its first block.
pub struct Again {
    /// Its state after the last block run.
    pub machine: Machine,
    /// Its sealing, including who sealed the last blocks.
    pub sealing: Sealing,
    /// The last block run.
    pub last: Header,
    chain_id: u64,
    nodes: Rc<Passing>,
}

impl Again {
    /// Before the first block.
    pub fn new(file: &Rc<ChainFile>, founded: Founded) -> Self {
        let Founded { chain_id, sealing, genesis, .. } = founded;
        let nodes = Rc::new(Passing { file: Rc::clone(file), nodes: RefCell::default() });
        let machine = Machine::new(Tries { ground: Rc::clone(&nodes) as _, root: genesis.state_root }, chain_id);
        Self { machine, sealing, last: genesis, chain_id, nodes }
    }

    /// Runs the next block.
    ///
    /// # Errors
    /// [`ChainError::Tampered`] if the result differs from the file, or its seal does not meet the chain's consensus.
    pub fn step(mut self) -> Result<Self, ChainError> {
        let file = Rc::clone(&self.nodes.file);
        let number = self.last.number + 1;
        let blame = |what: &str| file.tampered(number, what);
        let header = header(&file, number)?;
        if header.parent != self.last.hash() {
            return Err(blame("its hash or its parent was changed"));
        }
        let place = self.sealing.accept(&header, self.last.timestamp).map_err(blame)?;
        let outcome = rerun(&file, &self.machine, &self.sealing, &header, &place, self.chain_id)?;
        self.nodes.turn_over(&outcome.written);
        self.machine.tries.root = outcome.state_root;
        self.last = header;
        Ok(self)
    }

    /// The nodes of the state after the last block.
    pub fn state_nodes(&self) -> Vec<Hash> {
        self.nodes.nodes.borrow().keys().copied().collect()
    }
}

/// The state after the newest block, the only one run again, and its header; `founded` learns who sealed the last
/// blocks.
///
/// # Errors
/// See [`Again::step`].
pub fn newest(file: &Rc<ChainFile>, founded: &mut Founded) -> Result<(Machine, Header), ChainError> {
    let number = file.newest_number()?;
    let blame = |what: &str| file.tampered(number, what);
    let last = if number == 0 { founded.genesis.clone() } else { header(file, number)? };
    let over = |root| Machine::new(Tries { ground: Rc::clone(file) as _, root }, founded.chain_id);
    if let Sealing::Authority(authority) = &mut founded.sealing {
        let out_of_turn = file.out_of_turn()?.into_iter().filter(|one| *one < number).collect();
        let mut newest = Vec::new();
        for before in number.saturating_sub(authority.rest()).max(1)..number {
            newest.push(authority.sealer(&header(file, before)?).map_err(|what| file.tampered(before, what))?);
        }
        authority.resume(out_of_turn, newest);
    }
    let mut machine = over(founded.genesis.state_root);
    if number > 0 {
        let parent = if number == 1 { founded.genesis.clone() } else { header(file, number - 1)? };
        if last.parent != parent.hash() {
            return Err(blame("its hash or its parent was changed"));
        }
        let place = founded.sealing.accept(&last, parent.timestamp).map_err(blame)?;
        machine = over(parent.state_root);
        let outcome = rerun(file, &machine, &founded.sealing, &last, &place, founded.chain_id)?;
        machine.tries.root = outcome.state_root;
    }
    founded.sealing.vouches(&last).map_err(blame)?;
    if machine.tries.root != EMPTY_ROOT {
        file.node(machine.tries.root)?;
    }
    Ok((machine, last))
}

/// A block's header, checked against its hash in the file.
///
/// # Errors
/// [`ChainError::Tampered`] if it is missing or another one.
pub fn header(file: &ChainFile, number: u64) -> Result<Header, ChainError> {
    let blame = |what: &str| file.tampered(number, what);
    let (hash, bytes) = file.block(number)?.ok_or_else(|| blame("it is gone"))?;
    let header = Header::decode(&bytes).map_err(|_| blame("its header is not a header"))?;
    if header.hash() != hash || header.number != number {
        return Err(blame("its hash or its parent was changed"));
    }
    Ok(header)
}

/// Runs a block from the file again and compares everything its header commits to.
fn rerun(
    file: &ChainFile,
    machine: &Machine,
    sealing: &Sealing,
    header: &Header,
    place: &Environment,
    chain_id: u64,
) -> Result<Outcome, ChainError> {
    let blame = |what: &str| file.tampered(header.number, what);
    let mined = file.block_transactions(header.number)?;
    let transactions = mined.iter().map(|one| Transaction::decode(&one.raw, chain_id));
    let transactions = transactions.collect::<Result<Vec<_>, _>>().map_err(|what| blame(&what))?;
    let outcome = machine.run(place, transactions, false)?;
    let again = assemble(sealing, header.parent, place, &outcome)?;
    let sealed = Header { extra: header.extra.clone(), nonce: header.nonce, ..again.clone() };
    // Under proof of work the extra data holds no seal and is always the same.
    if sealed != *header || (matches!(sealing, Sealing::Work { .. }) && again.extra != header.extra) {
        return Err(blame("replaying its transactions gives a different block"));
    }
    let kept = outcome
        .receipts
        .iter()
        .zip(&mined)
        .all(|(receipt, one)| rlp::encode(receipt)[..] == one.receipt[..] && receipt.logs.len() as u64 == one.logs);
    if kept { Ok(outcome) } else { Err(blame("its receipts were changed")) }
}

/// The header of a block that has run, before its seal.
///
/// # Errors
/// Only for a fault of this program.
pub fn assemble(sealing: &Sealing, parent: Hash, place: &Environment, outcome: &Outcome) -> Result<Header, ChainError> {
    let mut bloom = Bloom::zero();
    for receipt in &outcome.receipts {
        receipt.accrue(&mut bloom);
    }
    let (beneficiary, extra) = sealing.dress();
    Ok(Header {
        parent,
        state_root: outcome.state_root,
        transactions_root: transactions_root(outcome.included.iter().map(|one| &one.raw[..]))?,
        receipts_root: receipts_root(&outcome.receipts)?,
        bloom,
        beneficiary,
        difficulty: place.difficulty,
        number: place.number,
        gas_limit: BLOCK_GAS,
        gas_used: outcome.receipts.last().map_or(0, |receipt| receipt.cumulative_gas),
        timestamp: place.timestamp,
        extra,
        nonce: 0,
    })
}

/// Nodes by their hash, with the number of their places in the state.
type CountedNodes = HashMap<Hash, (Arc<[u8]>, u64)>;

/// The nodes of a single state, in memory.
struct Passing {
    file: Rc<ChainFile>,
    nodes: RefCell<CountedNodes>,
}

impl Passing {
    fn turn_over(&self, written: &Written) {
        let mut nodes = self.nodes.borrow_mut();
        for (hash, body) in &written.made {
            nodes.entry(*hash).or_insert_with(|| (body.as_slice().into(), 0)).1 += 1;
        }
        let mut take_out = |hash: Hash| {
            let (body, places) = nodes.get_mut(&hash)?;
            *places -= 1;
            let body = Arc::clone(body);
            if *places == 0 {
                nodes.remove(&hash);
            }
            Some(body)
        };
        for hash in &written.left {
            take_out(*hash);
        }
        let mut felled = written.felled.clone();
        while let Some(hash) = felled.pop() {
            felled.extend(take_out(hash).and_then(|body| below(&body)).unwrap_or_default());
        }
    }
}

impl Nodes for Passing {
    fn node(&self, hash: Hash) -> Result<Arc<[u8]>, ChainError> {
        let found = self.nodes.borrow().get(&hash).map(|(body, _)| Arc::clone(body));
        found.ok_or_else(|| ChainError::Internal(format!("node {hash} of a replayed state is missing")))
    }

    fn malformed(&self, hash: Hash) -> ChainError {
        ChainError::Internal(format!("node {hash} of a replayed state is not a node"))
    }
}

impl Ground for Passing {
    fn block_hash(&self, number: u64) -> Result<Hash, ChainError> {
        self.file.block_hash(number)
    }
}
