//! How much work blocks hold: transactions and gas.

use serde_json::{Value, json};

use super::{Chain, ChainError};

impl Chain {
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
