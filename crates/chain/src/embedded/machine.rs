//! The EVM of the embedded chain: revm under Istanbul rules. A block's changes apply once it is on disk.

use std::sync::Arc;

use alloy_primitives::{Address as EvmAddress, Bytes, KECCAK256_EMPTY, TxKind, U256};
use revm::context::result::{EVMError, ExecutionResult, HaltReason, InvalidTransaction, Output};
use revm::context::{BlockEnv, Evm, TxEnv};
use revm::interpreter::interpreter::EthInterpreter;
use revm::{Context, DatabaseCommit, ExecuteEvm, MainBuilder, MainContext, database::CacheDB, handler::EthFrame};
use revm::{handler::instructions::EthInstructions, primitives::hardfork::SpecId};

use super::pool::{BLOCK_GAS, BLOCK_SURPLUS, ESTIMATE_GAS, TRANSACTION_GAS, TRANSACTION_SURPLUS, Weighed};
use super::world::{Tries, Unread};
use super::{block::Receipt, trie::Turnover};
use crate::ChainError;
use crate::model::{Address, Hash};
use crate::transaction::{Transaction, Unsigned};

#[derive(Debug, Clone, Copy)]
pub struct Environment {
    pub number: u64,
    /// Seconds since 1970.
    pub timestamp: u64,
    pub difficulty: u64,
    /// Recipient of the fees.
    pub beneficiary: Address,
}

pub struct Outcome {
    pub included: Vec<Transaction>,
    pub receipts: Vec<Receipt>,
    /// Those that no block can include, and why.
    pub refused: Vec<(Transaction, String)>,
    pub state_root: Hash,
    pub written: Turnover,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Answer {
    /// Output, and gas used.
    Returned(Vec<u8>, u64),
    /// Revert data.
    Reverted(Vec<u8>),
    /// Out of gas, a bad instruction, not payable.
    Failed(String),
}

pub struct Machine {
    pub tries: Tries,
    pub chain_id: u64,
}

impl Machine {
    fn evm<'a>(&'a self, place: &Environment, surplus: u64) -> WeighedEvm<'a> {
        let block = BlockEnv {
            number: U256::from(place.number),
            beneficiary: EvmAddress::from(place.beneficiary.0),
            timestamp: U256::from(place.timestamp),
            gas_limit: BLOCK_GAS,
            basefee: 0,
            difficulty: U256::from(place.difficulty),
            ..BlockEnv::default()
        };
        Context::mainnet()
            .modify_cfg_chained(|cfg| {
                cfg.set_spec_and_mainnet_gas_params(SpecId::ISTANBUL);
                cfg.chain_id = self.chain_id;
            })
            .with_db(CacheDB::new(&self.tries))
            .with_block(block)
            .build_mainnet()
            .with_precompiles(Weighed::new(surplus))
    }

    /// Runs transactions without changing the state. By the rules of admission (`new`), refuses those with too much
    /// surplus, and starts none beyond the block's limit.
    pub fn run(&self, place: &Environment, transactions: Vec<Transaction>, new: bool) -> Result<Outcome, ChainError> {
        let most = if new { TRANSACTION_SURPLUS } else { u64::MAX };
        let mut evm = self.evm(place, most);
        let mut surplus = 0;
        let (included, receipts, refused, written) = (Vec::new(), Vec::new(), Vec::new(), Turnover::default());
        let mut outcome = Outcome { included, receipts, refused, state_root: self.tries.root, written };
        let mut changes = Vec::with_capacity(transactions.len());
        let mut cumulative = 0;
        for transaction in transactions {
            if new && surplus >= BLOCK_SURPLUS {
                break;
            }
            evm.precompiles = Weighed::new(most);
            let result = evm.transact(self.environment(transaction.sender, &transaction));
            surplus += evm.precompiles.surplus;
            match result {
                Ok(done) => {
                    cumulative += done.result.tx_gas_used();
                    evm.ctx.journaled_state.database.commit(done.state.clone());
                    outcome.receipts.push(receipt(done.result, cumulative));
                    changes.push(done.state);
                    outcome.included.push(transaction);
                }
                Err(EVMError::Database(Unread(error))) => return Err(error),
                Err(error) => outcome.refused.push((transaction, refusal(&error))),
            }
        }
        (outcome.state_root, outcome.written) = self.tries.after(&changes)?;
        Ok(outcome)
    }

    /// Ignores the nonce and changes nothing.
    pub fn call(&self, place: &Environment, from: Address, message: &Unsigned) -> Result<Answer, ChainError> {
        let gas_limit = message.gas_limit.min(TRANSACTION_GAS);
        let message = Unsigned { nonce: self.nonce(from)?, gas_limit, ..message.clone() };
        let transaction = self.environment(from, &message);
        Ok(match self.evm(place, TRANSACTION_SURPLUS).transact(transaction).map(|done| done.result) {
            Ok(ExecutionResult::Success { output, gas, .. }) => {
                Answer::Returned(output.into_data().to_vec(), gas.total_gas_spent())
            }
            Ok(ExecutionResult::Revert { output, .. }) => Answer::Reverted(output.to_vec()),
            Ok(ExecutionResult::Halt { reason: HaltReason::OutOfGas(_), .. }) => Answer::Failed("out of gas".into()),
            Ok(ExecutionResult::Halt { reason, .. }) => Answer::Failed(format!("execution failed: {reason:?}")),
            Err(EVMError::Database(Unread(error))) => return Err(error),
            Err(error) => Answer::Failed(refusal(&error)),
        })
    }

    /// Returned with the least gas limit that suffices, or a higher one where [`ESTIMATE_GAS`] does not suffice to find it;
    /// otherwise how the call ends if no limit is enough.
    pub fn estimate(&self, place: &Environment, from: Address, message: &Unsigned) -> Result<Answer, ChainError> {
        let with = |gas_limit| self.call(place, from, &Unsigned { gas_limit, ..message.clone() });
        let ceiling = message.gas_limit.min(TRANSACTION_GAS);
        let mut low = match with(ceiling)? {
            Answer::Returned(_, spent) => spent,
            other => return Ok(other),
        };
        let mut high = ceiling;
        if matches!(with(low)?, Answer::Returned(..)) {
            return Ok(Answer::Returned(Vec::new(), low));
        }
        let mut spent = ceiling + low;
        while low + 1 < high {
            let middle = u64::midpoint(low, high);
            spent += middle;
            if spent > ESTIMATE_GAS {
                break;
            }
            if matches!(with(middle)?, Answer::Returned(..)) { high = middle } else { low = middle }
        }
        Ok(Answer::Returned(Vec::new(), high))
    }

    /// Without pending transactions.
    pub fn nonce(&self, account: Address) -> Result<u64, ChainError> {
        Ok(self.tries.account(account)?.map_or(0, |account| account.nonce))
    }

    pub fn balance(&self, account: Address) -> Result<U256, ChainError> {
        Ok(self.tries.account(account)?.map_or(U256::ZERO, |account| account.balance))
    }

    pub fn code(&self, account: Address) -> Result<Arc<[u8]>, ChainError> {
        self.tries.code(self.tries.account(account)?.map_or(KECCAK256_EMPTY, |account| account.code_hash))
    }

    fn environment(&self, sender: Address, transaction: &Unsigned) -> TxEnv {
        TxEnv {
            caller: EvmAddress::from(sender.0),
            gas_limit: transaction.gas_limit,
            gas_price: transaction.gas_price,
            kind: transaction.to.map_or(TxKind::Create, |to| TxKind::Call(to.0.into())),
            value: transaction.value,
            data: Bytes::copy_from_slice(&transaction.input),
            nonce: transaction.nonce,
            chain_id: Some(self.chain_id),
            ..TxEnv::default()
        }
    }
}

type Overlay<'a> = CacheDB<&'a Tries>;
type EvmContext<'a> = revm::handler::MainnetContext<Overlay<'a>>;
type WeighedEvm<'a> =
    Evm<EvmContext<'a>, (), EthInstructions<EthInterpreter, EvmContext<'a>>, Weighed, EthFrame<EthInterpreter>>;

fn refusal<E: std::fmt::Display>(error: &EVMError<E>) -> String {
    match error {
        EVMError::Transaction(InvalidTransaction::LackOfFundForMaxFee { .. }) => {
            "insufficient funds for gas * price + value".into()
        }
        EVMError::Transaction(invalid) => invalid.to_string(),
        other => other.to_string(),
    }
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
    let contract = contract.map(|address| Address(address.into_array()));
    Receipt { success, gas_used, cumulative_gas, contract, output: output.to_vec(), logs }
}
