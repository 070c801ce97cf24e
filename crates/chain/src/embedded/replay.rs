//! Running blocks from the file again: all of them for an audit, or only the newest when a chain is opened.

use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;
use std::sync::Arc;

use ethers::types::Bloom;
use ethers::utils::rlp;

use super::admission::BLOCK_GAS;
use super::block::Header;
use super::file::ChainFile;
use super::founding::Founded;
use super::machine::{Environment, Machine, Outcome};
use super::roots::{receipts_root, transactions_root};
use super::sealing::Sealing;
use super::transaction::Transaction;
use super::trie::{EMPTY_ROOT, Nodes, below};
use super::world::{Ground, Tries, Written};
use crate::chain::ChainError;
use crate::model::Hash;

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
