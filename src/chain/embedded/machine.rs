//! The EVM of the embedded chain: world state in memory, execution by revm under Istanbul rules.
//!
//! Running a block changes nothing; its changes are applied once the block is on disk.

use std::collections::BTreeMap;

use ethers::types::U256;
use ethers::utils::keccak256;
use ethers::utils::rlp::RlpStream;
use revm::context::result::{EVMError, ExecutionResult, InvalidTransaction, Output};
use revm::context::{BlockEnv, TxEnv};
use revm::database::{CacheDB, EmptyDB};
use revm::primitives::hardfork::SpecId;
use revm::primitives::{Address as EvmAddress, B256, Bytes, KECCAK_EMPTY, TxKind, U256 as Word};
use revm::state::EvmState;
use revm::{Context, DatabaseCommit, DatabaseRef, ExecuteEvm, MainBuilder, MainContext, MainnetEvm};

use super::block::{GAS_LIMIT, Log, Receipt};
use super::transaction::Transaction;
use crate::model::{Address, Hash};

/// The most gas that a call or an estimate may use, so that no caller can stall the chain.
pub const CALL_GAS_LIMIT: u64 = 50_000_000;

type State = CacheDB<EmptyDB>;

/// Where a block or a call takes place.
#[derive(Debug, Clone, Copy)]
pub struct Environment {
    /// Block number.
    pub number: u64,
    /// Seconds since 1970.
    pub timestamp: u64,
    /// Its difficulty, as the DIFFICULTY instruction gives it.
    pub difficulty: u64,
    /// Who gets the fees: the signer or the miner.
    pub beneficiary: Address,
}

/// What running a block gave.
pub struct Outcome {
    /// Those that went in, in order.
    pub included: Vec<Transaction>,
    /// Their receipts.
    pub receipts: Vec<Receipt>,
    /// Those that cannot go into any block, and why.
    pub refused: Vec<(Transaction, String)>,
    /// Commitment to the state after the block.
    pub state_root: Hash,
    changes: Vec<EvmState>,
}

/// A message call without a transaction.
#[derive(Debug, Clone)]
pub struct Message {
    /// Who calls.
    pub from: Address,
    /// Whom; `None` creates a contract.
    pub to: Option<Address>,
    /// Wei sent along.
    pub value: U256,
    /// Call data.
    pub input: Vec<u8>,
    /// The most gas it may use.
    pub gas: u64,
}

/// How a message call ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Answer {
    /// Returned these bytes, having spent so much gas.
    Returned(Vec<u8>, u64),
    /// Reverted with these bytes.
    Reverted(Vec<u8>),
    /// Ended otherwise: out of gas, bad instruction, not payable.
    Failed(String),
}

/// The world state and its rules.
pub struct Machine {
    state: State,
    chain_id: u64,
    state_root: Hash,
}

impl Machine {
    /// An empty world.
    pub fn new(chain_id: u64, state_root: Hash) -> Self {
        Self { state: State::default(), chain_id, state_root }
    }

    fn evm<'a>(&'a self, place: &Environment) -> MainnetEvm<EvmContext<'a>> {
        let block = BlockEnv {
            number: Word::from(place.number),
            beneficiary: EvmAddress::from(place.beneficiary.0),
            timestamp: Word::from(place.timestamp),
            gas_limit: GAS_LIMIT,
            basefee: 0,
            difficulty: Word::from(place.difficulty),
            ..BlockEnv::default()
        };
        Context::mainnet()
            .modify_cfg_chained(|cfg| {
                cfg.set_spec_and_mainnet_gas_params(SpecId::ISTANBUL);
                cfg.chain_id = self.chain_id;
            })
            .with_db(CacheDB::new(&self.state))
            .with_block(block)
            .build_mainnet()
    }

    /// Runs transactions one after the other on top of the state, which stays as it is.
    pub fn run(&self, place: &Environment, transactions: Vec<Transaction>) -> Outcome {
        let mut evm = self.evm(place);
        let mut outcome = Outcome {
            included: Vec::with_capacity(transactions.len()),
            receipts: Vec::with_capacity(transactions.len()),
            refused: Vec::new(),
            state_root: self.state_root,
            changes: Vec::with_capacity(transactions.len()),
        };
        let mut cumulative = 0;
        for transaction in transactions {
            match evm.transact(environment_of(&transaction, self.chain_id)) {
                Ok(done) => {
                    cumulative += done.result.tx_gas_used();
                    evm.ctx.journaled_state.database.commit(done.state.clone());
                    outcome.receipts.push(receipt(done.result, cumulative));
                    outcome.changes.push(done.state);
                    outcome.included.push(transaction);
                }
                Err(error) => outcome.refused.push((transaction, refusal(&error))),
            }
        }
        outcome.state_root = commitment(self.state_root, &outcome.changes);
        outcome
    }

    /// Makes the changes of a block that ran on this very state.
    pub fn apply(&mut self, outcome: Outcome) {
        self.state_root = outcome.state_root;
        for change in outcome.changes {
            self.state.commit(change);
        }
    }

    /// Runs a message call; changes nothing.
    pub fn call(&self, place: &Environment, message: &Message) -> Answer {
        let transaction = TxEnv {
            caller: EvmAddress::from(message.from.0),
            gas_limit: message.gas.min(CALL_GAS_LIMIT),
            gas_price: 0,
            kind: kind(message.to),
            value: word(message.value),
            data: Bytes::from(message.input.clone()),
            nonce: self.nonce(message.from),
            chain_id: Some(self.chain_id),
            ..TxEnv::default()
        };
        match self.evm(place).transact(transaction).map(|done| done.result) {
            Ok(ExecutionResult::Success { output, gas, .. }) => {
                Answer::Returned(output.into_data().to_vec(), gas.total_gas_spent())
            }
            Ok(ExecutionResult::Revert { output, .. }) => Answer::Reverted(output.to_vec()),
            Ok(ExecutionResult::Halt { reason, .. }) => Answer::Failed(halted(&format!("{reason:?}"))),
            Err(error) => Answer::Failed(refusal(&error)),
        }
    }

    /// The least gas limit under which a message call returns.
    ///
    /// # Errors
    /// How the call ends where no limit is enough.
    pub fn estimate(&self, place: &Environment, message: &Message) -> Result<u64, Answer> {
        let with = |gas| self.call(place, &Message { gas, ..message.clone() });
        let ceiling = message.gas.min(CALL_GAS_LIMIT);
        let mut low = match with(ceiling) {
            Answer::Returned(_, spent) => spent,
            other => return Err(other),
        };
        let mut high = ceiling;
        if matches!(with(low), Answer::Returned(..)) {
            return Ok(low);
        }
        while low + 1 < high {
            let middle = u64::midpoint(low, high);
            if matches!(with(middle), Answer::Returned(..)) { high = middle } else { low = middle }
        }
        Ok(high)
    }

    /// The next nonce of an account, not counting what waits.
    pub fn nonce(&self, account: Address) -> u64 {
        self.account(account).map_or(0, |info| info.nonce)
    }

    /// Wei held by an account.
    pub fn balance(&self, account: Address) -> U256 {
        self.account(account).map_or(U256::zero(), |info| U256::from_big_endian(&info.balance.to_be_bytes::<32>()))
    }

    /// Code of a contract; empty for other accounts.
    pub fn code(&self, account: Address) -> Vec<u8> {
        let hash = self.account(account).map_or(KECCAK_EMPTY, |info| info.code_hash);
        let Ok(code) = self.state.code_by_hash_ref(hash);
        code.original_byte_slice().to_vec()
    }

    /// One storage slot of a contract.
    pub fn slot(&self, account: Address, slot: U256) -> Hash {
        let Ok(value) = self.state.storage_ref(EvmAddress::from(account.0), word(slot));
        Hash(value.to_be_bytes())
    }

    /// Every storage slot that is not zero, key and value.
    pub fn slots(&self) -> Vec<(Hash, Hash)> {
        let accounts = self.state.cache.accounts.values();
        accounts
            .flat_map(|account| &account.storage)
            .filter(|(_, value)| !value.is_zero())
            .map(|(key, value)| (Hash(key.to_be_bytes()), Hash(value.to_be_bytes())))
            .collect()
    }

    fn account(&self, account: Address) -> Option<revm::state::AccountInfo> {
        let Ok(info) = self.state.basic_ref(EvmAddress::from(account.0));
        info
    }
}

type Overlay<'a> = CacheDB<&'a State>;
type EvmContext<'a> = revm::handler::MainnetContext<Overlay<'a>>;

fn environment_of(transaction: &Transaction, chain_id: u64) -> TxEnv {
    TxEnv {
        caller: EvmAddress::from(transaction.sender.0),
        gas_limit: transaction.gas_limit,
        gas_price: transaction.gas_price,
        kind: kind(transaction.to),
        value: word(transaction.value),
        data: Bytes::from(transaction.input.clone()),
        nonce: transaction.nonce,
        chain_id: Some(chain_id),
        ..TxEnv::default()
    }
}

fn kind(to: Option<Address>) -> TxKind {
    to.map_or(TxKind::Create, |to| TxKind::Call(EvmAddress::from(to.0)))
}

fn word(value: U256) -> Word {
    let mut bytes = [0; 32];
    value.to_big_endian(&mut bytes);
    Word::from_be_bytes(bytes)
}

fn refusal<E: std::fmt::Display>(error: &EVMError<E>) -> String {
    match error {
        EVMError::Transaction(InvalidTransaction::LackOfFundForMaxFee { .. }) => {
            "insufficient funds for gas * price + value".into()
        }
        EVMError::Transaction(invalid) => invalid.to_string(),
        other => other.to_string(),
    }
}

fn halted(reason: &str) -> String {
    if reason.starts_with("OutOfGas") { "out of gas".into() } else { format!("execution failed: {reason}") }
}

fn receipt(result: ExecutionResult, cumulative_gas: u64) -> Receipt {
    let gas_used = result.tx_gas_used();
    let success = result.is_success();
    let (contract, output, logs) = match result {
        ExecutionResult::Success { output: Output::Create(_, address), logs, .. } => (address, Bytes::new(), logs),
        ExecutionResult::Success { logs, .. } => (None, Bytes::new(), logs),
        ExecutionResult::Revert { output, .. } => (None, output, Vec::new()),
        ExecutionResult::Halt { .. } => (None, Bytes::new(), Vec::new()),
    };
    Receipt {
        success,
        gas_used,
        cumulative_gas,
        contract: contract.map(|address| Address(address.into_array())),
        output: output.to_vec(),
        logs: logs.into_iter().map(log).collect(),
    }
}

fn log(log: revm::primitives::Log) -> Log {
    Log {
        address: Address(log.address.into_array()),
        topics: log.data.topics().iter().map(|topic| Hash(topic.0)).collect(),
        data: log.data.data.to_vec(),
    }
}

type Changed = BTreeMap<EvmAddress, (Word, u64, B256, BTreeMap<Word, Word>)>;

/// Keccak-256 over the parent's commitment and the block's changes, sorted by address and slot.
fn commitment(parent: Hash, changes: &[EvmState]) -> Hash {
    let mut all = Changed::new();
    for (address, account) in changes.iter().flatten().filter(|(_, account)| account.is_touched()) {
        let entry = all.entry(*address).or_default();
        entry.0 = account.info.balance;
        entry.1 = account.info.nonce;
        entry.2 = account.info.code_hash;
        entry.3.extend(account.changed_storage_slots().map(|(slot, value)| (*slot, value.present_value)));
    }
    let mut list = RlpStream::new_list(all.len() + 1);
    list.append(&&parent.0[..]);
    for (address, (balance, nonce, code, slots)) in &all {
        list.begin_list(4 + 2 * slots.len()).append(&&address[..]).append(&&balance.to_be_bytes::<32>()[..]);
        list.append(nonce).append(&&code[..]);
        for (slot, value) in slots {
            list.append(&&slot.to_be_bytes::<32>()[..]).append(&&value.to_be_bytes::<32>()[..]);
        }
    }
    Hash(keccak256(list.out()))
}
