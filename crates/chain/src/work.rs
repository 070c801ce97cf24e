//! How much work blocks hold: transactions and gas.

use serde_json::{Value, json};

use super::{Chain, ChainError};
use crate::model::Hash;

/// What a block holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BlockWork {
    /// Its transactions, in order.
    pub transactions: Vec<Hash>,
    /// Gas they used.
    pub gas_used: u64,
    /// The most gas that a block of this network may use.
    pub gas_limit: u64,
}

impl Chain {
    /// What a block holds; `None` above the head.
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn block_work(&self, number: u64) -> Result<Option<BlockWork>, ChainError> {
        const METHOD: &str = "eth_getBlockByNumber";
        let block: Value = self.rpc(METHOD, json!([format!("{number:#x}"), false])).await?;
        if block.is_null() {
            return Ok(None);
        }
        let field = |name: &str| block.get(name).and_then(Value::as_str).map_or(0, quantity);
        let listed = block.get("transactions").and_then(Value::as_array);
        let hashes = listed.map(|all| all.iter().map(|hash| hash.as_str()?.parse().ok()).collect::<Option<Vec<_>>>());
        let transactions =
            hashes.flatten().ok_or_else(|| self.misunderstood(METHOD, "its transactions are not hashes"))?;
        Ok(Some(BlockWork { transactions, gas_used: field("gasUsed"), gas_limit: field("gasLimit") }))
    }

    /// Transactions and gas of blocks `from` to `to`, inclusive.
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn work(&self, from: u64, to: u64) -> Result<(u64, u64), ChainError> {
        let (mut transactions, mut gas) = (0, 0);
        for number in from..=to {
            let block: Value = self.rpc("eth_getBlockByNumber", json!([format!("{number:#x}"), false])).await?;
            transactions += block.get("transactions").and_then(Value::as_array).map_or(0, |list| list.len() as u64);
            gas += block.get("gasUsed").and_then(Value::as_str).map_or(0, quantity);
        }
        Ok((transactions, gas))
    }
}

fn quantity(text: &str) -> u64 {
    u64::from_str_radix(text.trim_start_matches("0x"), 16).unwrap_or(0)
}
