//! Pool, assembling and sealing on one thread; a proof-of-work search runs beside it, for the assembled block only.

use std::collections::{HashMap, VecDeque};
use std::time::{Duration, Instant};
use std::{cell::RefCell, path::Path, rc::Rc, sync::Arc};

use alloy_primitives::logs_bloom;

use super::block::{Header, Receipt};
use super::file::{Auditing, ChainFile, Looked, Mined};
use super::machine::{Environment, Machine, Outcome};
use super::pool::{BLOCK_GAS, Pool, TRANSACTION_GAS};
use super::sealing::{self, Founded, Sealing, Search};
use super::trie::{EMPTY_ROOT, Nodes, Turnover, below, list_root};
use super::world::Tries;
use crate::model::{Hash, Timestamp};
use crate::{BlockRef, ChainError, Consensus, genesis::noise, transaction::Transaction};

/// Pause after a failed write.
const REST: Duration = Duration::from_secs(1);
/// Transactions in a block, so that sealing never keeps readers waiting long.
const MOST_TRANSACTIONS: usize = 4096;

/// Called with the nonce on the search's thread.
pub type Found = Arc<dyn Fn(u64) + Send + Sync>;

pub struct Node {
    pub machine: Machine,
    pub file: Rc<ChainFile>,
    pub looked: Looked,
    pub pool: Pool,
    pub chain_id: u64,
    pub consensus: Consensus,
    pub sealing: Sealing,
    pub head: BlockRef,
    pub audits: VecDeque<Auditing>,
    /// Why the last block could not be written.
    pub trouble: Option<String>,
    not_before: Instant,
    work: Option<Work>,
    found: Found,
}

struct Work {
    header: Header,
    outcome: Outcome,
    _search: Search,
}

impl Node {
    /// Runs the newest block again, which must match the file; older blocks are authenticated through it when read.
    pub fn open(directory: &Path, asked: Option<Consensus>, found: Found) -> Result<Self, ChainError> {
        let file = Rc::new(ChainFile::open(directory)?);
        let founded = sealing::open(&file, asked)?;
        let (chain_id, consensus, newest) = (founded.chain_id, founded.consensus, file.newest_number()?);
        let mut again = Again::before(&file, founded, newest)?;
        if newest > 0 {
            again.step()?;
        }
        let Again { machine, sealing, last: head, .. } = again;
        // The newest seal vouches for all blocks below it.
        sealing.vouch(&head).map_err(|what| file.tampered(newest, what))?;
        if machine.tries.root != EMPTY_ROOT {
            file.node(machine.tries.root)?;
        }
        // Keeps the period across a restart, even if the clock changed.
        let due = (head.timestamp + sealing.period.as_secs()).saturating_sub(Timestamp::now().seconds());
        let wait = if head.number == 0 { Duration::ZERO } else { Duration::from_secs(due).min(sealing.period) };
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

    /// `None` while no transaction is ready, or a search runs.
    pub fn due(&self) -> Option<Duration> {
        let ready = self.work.is_none() && self.pool.is_ready();
        ready.then(|| self.not_before.saturating_duration_since(Instant::now()))
    }

    pub fn is_mining(&self) -> bool {
        self.work.is_some()
    }

    pub fn next_place(&self) -> Environment {
        self.sealing.place(self.head.number + 1, self.head.timestamp)
    }

    pub fn assemble(&mut self) {
        let ready = self.pool.ready(MOST_TRANSACTIONS, BLOCK_GAS);
        let place = self.next_place();
        let outcome = match self.machine.run(&place, ready, true) {
            Ok(outcome) => outcome,
            Err(error) => return self.rest(error),
        };
        self.not_before = Instant::now() + self.sealing.period;
        self.pool.forget(outcome.refused.iter().map(|(transaction, _)| transaction));
        if outcome.included.is_empty() {
            return;
        }
        let mut header = assemble(&self.sealing, self.head.hash, &place, &outcome);
        if self.sealing.work.is_some() {
            match self.search(&header) {
                Ok(search) => self.work = Some(Work { header, outcome, _search: search }),
                Err(error) => self.rest(error),
            }
        } else if self.sealing.seal(&mut header).is_some() {
            self.settle(&header, outcome);
        } else {
            self.rest(ChainError::Internal("a block could not be sealed".into()));
        }
    }

    fn search(&self, header: &Header) -> Result<Search, ChainError> {
        let found = Arc::clone(&self.found);
        let first = u64::from_be_bytes(noise()?);
        let search = Search::start(header.work_hash(), header.difficulty, first, move |nonce| found(nonce));
        search.map_err(|error| ChainError::Internal(format!("no work can be done: {error}")))
    }

    pub fn worked(&mut self, nonce: u64) {
        let Some(Work { header, outcome, .. }) = self.work.take() else { return };
        let header = Header { nonce, ..header };
        if sealing::seals(header.work_hash(), nonce, header.difficulty) {
            self.settle(&header, outcome);
        }
    }

    /// A block that cannot be written never happened.
    fn settle(&mut self, header: &Header, outcome: Outcome) {
        if let Err(error) = self.file.append(header, &outcome) {
            return self.rest(error);
        }
        let Outcome { included, receipts, written, state_root, .. } = outcome;
        self.trouble = None;
        self.pool.mined(&included);
        self.file.remember(written.made);
        self.looked.wrote(header.number, included, receipts);
        self.machine.tries.root = state_root;
        self.head = reference(header);
    }

    fn rest(&mut self, error: ChainError) {
        self.trouble = Some(error.to_string());
        self.not_before = Instant::now() + REST;
    }

    /// Seals pending transactions at the end, unless it takes work, or a period that the next block's time would
    /// contradict.
    pub fn finish(&mut self) {
        let brief = self.sealing.work.is_none() && self.sealing.period.as_secs() == 0;
        if brief && self.due().is_some() {
            self.assemble();
        }
    }
}

fn reference(header: &Header) -> BlockRef {
    BlockRef { number: header.number, hash: header.hash(), timestamp: header.timestamp }
}

// Runs blocks of the file again: all for an audit, the newest when a chain is opened.

pub struct Again {
    /// After the last block run.
    pub machine: Machine,
    pub sealing: Sealing,
    /// The last block run.
    pub last: Header,
    file: Rc<ChainFile>,
    /// Set if all blocks are run; otherwise nodes come from the file.
    nodes: Option<Rc<Passing>>,
}

impl Again {
    /// Before the first block.
    pub fn new(file: &Rc<ChainFile>, founded: Founded) -> Self {
        let Founded { chain_id, sealing, genesis, .. } = founded;
        let file = Rc::clone(file);
        let nodes = Rc::new(Passing { file: Rc::clone(&file), nodes: RefCell::default() });
        let tries = Tries { ground: Rc::clone(&nodes) as _, root: genesis.state_root };
        Self { machine: Machine { tries, chain_id }, sealing, last: genesis, file, nodes: Some(nodes) }
    }

    /// Before block `newest`.
    fn before(file: &Rc<ChainFile>, founded: Founded, newest: u64) -> Result<Self, ChainError> {
        let Founded { chain_id, sealing, genesis, .. } = founded;
        let file = Rc::clone(file);
        let last = if newest < 2 { genesis } else { header(&file, newest - 1)? };
        let tries = Tries { ground: Rc::clone(&file) as _, root: last.state_root };
        Ok(Self { machine: Machine { tries, chain_id }, sealing, last, file, nodes: None })
    }

    pub fn step(&mut self) -> Result<(), ChainError> {
        let number = self.last.number + 1;
        let blame = |what: &str| self.file.tampered(number, what);
        let header = header(&self.file, number)?;
        if header.parent != self.last.hash() {
            return Err(blame("its hash or its parent was changed"));
        }
        let place = self.sealing.accept(&header, self.last.timestamp).map_err(blame)?;
        let outcome = rerun(&self.file, &self.machine, &self.sealing, &header, &place)?;
        if let Some(nodes) = &self.nodes {
            nodes.turn_over(&outcome.written);
        }
        self.machine.tries.root = outcome.state_root;
        self.last = header;
        Ok(())
    }

    /// Empty unless all blocks were run.
    pub fn state_nodes(&self) -> Vec<Hash> {
        self.nodes.iter().flat_map(|nodes| nodes.nodes.borrow().keys().copied().collect::<Vec<_>>()).collect()
    }
}

pub fn header(file: &ChainFile, number: u64) -> Result<Header, ChainError> {
    let blame = |what: &str| file.tampered(number, what);
    let (hash, bytes) = file.block(number)?.ok_or_else(|| blame("it is gone"))?;
    let header = Header::decode(&bytes).map_err(|_| blame("its header is not a header"))?;
    if header.hash() != hash || header.number != number {
        return Err(blame("its hash or its parent was changed"));
    }
    Ok(header)
}

/// Compares everything that the header commits to.
fn rerun(
    file: &ChainFile,
    machine: &Machine,
    sealing: &Sealing,
    header: &Header,
    place: &Environment,
) -> Result<Outcome, ChainError> {
    let blame = |what: &str| file.tampered(header.number, what);
    let mined = file.block_transactions(header.number)?;
    let transactions = mined.iter().map(|one| Transaction::decode(&one.raw, machine.chain_id));
    let transactions = transactions.collect::<Result<Vec<_>, _>>().map_err(|what| blame(&what))?;
    let outcome = machine.run(place, transactions, false)?;
    let again = assemble(sealing, header.parent, place, &outcome);
    let sealed = Header { extra: header.extra.clone(), nonce: header.nonce, ..again.clone() };
    // Under proof of work the extra data holds no seal and is always the same.
    if sealed != *header || (sealing.work.is_some() && again.extra != header.extra) {
        return Err(blame("replaying its transactions gives a different block"));
    }
    let same = |(own, one): (&Receipt, &Mined)| own.encode() == one.receipt && own.logs.len() as u64 == one.logs;
    let kept = outcome.receipts.iter().zip(&mined).all(same);
    if kept { Ok(outcome) } else { Err(blame("its receipts were changed")) }
}

/// Unsealed.
fn assemble(sealing: &Sealing, parent: Hash, place: &Environment, outcome: &Outcome) -> Header {
    let (beneficiary, extra) = sealing.dress();
    let sent: Vec<&[u8]> = outcome.included.iter().map(|one| &one.raw[..]).collect();
    Header {
        parent,
        state_root: outcome.state_root,
        transactions_root: list_root(&sent),
        receipts_root: receipts_root(&outcome.receipts),
        bloom: logs_bloom(outcome.receipts.iter().flat_map(|receipt| &receipt.logs)),
        beneficiary,
        difficulty: place.difficulty,
        number: place.number,
        gas_limit: BLOCK_GAS,
        gas_used: outcome.receipts.last().map_or(0, |receipt| receipt.cumulative_gas),
        timestamp: place.timestamp,
        extra,
        nonce: 0,
    }
}

pub fn receipts_root<'a>(receipts: impl IntoIterator<Item = &'a Receipt>) -> Hash {
    list_root(&receipts.into_iter().map(Receipt::committed).collect::<Vec<_>>())
}

/// With the number of their places in the state.
type CountedNodes = HashMap<Hash, (Arc<[u8]>, u64)>;

/// Nodes of a single state, in memory.
struct Passing {
    file: Rc<ChainFile>,
    nodes: RefCell<CountedNodes>,
}

impl Passing {
    fn turn_over(&self, written: &Turnover) {
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

    fn block_hash(&self, number: u64) -> Result<Hash, ChainError> {
        self.file.block_hash(number)
    }
}
