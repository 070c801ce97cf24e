//! Filters: what is new since a caller last asked. There are only a few, and they expire when unused.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use serde_json::{Map, Value, json};
use tokio::sync::Mutex;

use super::rpc::{MOST_BLOCKS, fault, logs};
use crate::chain::embedded::{Embedded, Fault};

/// The most filters at a time.
const MOST: usize = 64;
/// How long an unused filter lives.
const LIFE: Duration = Duration::from_secs(300);
/// The most block hashes returned at once; the rest follows with the next request.
const MOST_HASHES: u64 = 1000;

#[derive(Clone)]
enum Kind {
    Blocks,
    Logs(Map<String, Value>),
}

struct Filter {
    kind: Kind,
    next: u64,
    asked: Instant,
}

/// The filters of all connections.
#[derive(Default)]
pub struct Filters {
    open: Mutex<(u64, HashMap<u64, Filter>)>,
}

fn number(value: u64) -> Value {
    Value::String(format!("{value:#x}"))
}

fn id(parameters: &[Value]) -> Option<u64> {
    u64::from_str_radix(parameters.first()?.as_str()?.strip_prefix("0x")?, 16).ok()
}

fn unknown() -> Fault {
    fault(-32000, "filter not found")
}

impl Filters {
    /// Creates a filter for what comes from now on; returns its id.
    ///
    /// # Errors
    /// For a malformed filter, or if there are too many.
    pub async fn install(&self, chain: &Embedded, method: &str, parameters: Vec<Value>) -> Result<Value, Fault> {
        let next = chain.head().borrow().number + 1;
        let kind = if method == "eth_newFilter" {
            let Some(Value::Object(filter)) = parameters.into_iter().next() else {
                return Err(fault(-32602, "missing or invalid value for argument 0"));
            };
            // The chain reports what is wrong with it, if anything.
            logs(chain, vec![within(&filter, next, next)]).await?;
            Kind::Logs(filter)
        } else {
            Kind::Blocks
        };
        let mut open = self.open.lock().await;
        let now = Instant::now();
        open.1.retain(|_, filter| now.duration_since(filter.asked) < LIFE);
        if open.1.len() >= MOST {
            return Err(fault(-32005, format!("there are {MOST} filters already; uninstall some")));
        }
        open.0 += 1;
        let id = open.0;
        open.1.insert(id, Filter { kind, next, asked: now });
        Ok(number(id))
    }

    /// What is new since the last time.
    ///
    /// # Errors
    /// For an unknown filter.
    pub async fn changes(&self, chain: &Embedded, parameters: &[Value]) -> Result<Value, Fault> {
        let mut open = self.open.lock().await;
        let filter = id(parameters).and_then(|id| open.1.get_mut(&id)).ok_or_else(unknown)?;
        filter.asked = Instant::now();
        let head = chain.head().borrow().number;
        if filter.next > head {
            return Ok(json!([]));
        }
        let most = if matches!(filter.kind, Kind::Blocks) { MOST_HASHES } else { MOST_BLOCKS };
        let last = head.min(filter.next + most - 1);
        let news = match &filter.kind {
            Kind::Logs(wanted) => logs(chain, vec![within(wanted, filter.next, last)]).await?,
            Kind::Blocks => hashes(chain, filter.next, last).await?,
        };
        filter.next = last + 1;
        Ok(news)
    }

    /// All logs that match a filter, including old ones.
    ///
    /// # Errors
    /// For an unknown filter, or one of blocks.
    pub async fn logs(&self, chain: &Embedded, parameters: &[Value]) -> Result<Value, Fault> {
        let wanted = {
            let open = self.open.lock().await;
            id(parameters).and_then(|id| open.1.get(&id)).map(|filter| filter.kind.clone())
        };
        match wanted {
            Some(Kind::Logs(filter)) => logs(chain, vec![Value::Object(filter)]).await,
            _ => Err(unknown()),
        }
    }

    /// Removes a filter; returns whether there was one.
    ///
    /// # Errors
    /// Never; the signature matches the other methods.
    pub async fn uninstall(&self, parameters: &[Value]) -> Result<Value, Fault> {
        let found = match id(parameters) {
            Some(id) => self.open.lock().await.1.remove(&id).is_some(),
            None => false,
        };
        Ok(Value::Bool(found))
    }
}

/// A filter with other bounds.
fn within(filter: &Map<String, Value>, first: u64, last: u64) -> Value {
    let mut filter = filter.clone();
    filter.remove("blockHash");
    filter.insert("fromBlock".into(), number(first));
    filter.insert("toBlock".into(), number(last));
    Value::Object(filter)
}

async fn hashes(chain: &Embedded, first: u64, last: u64) -> Result<Value, Fault> {
    let mut all = Vec::new();
    for block in first..=last {
        let block = chain.request("eth_getBlockByNumber", json!([number(block), false])).await?;
        all.push(block.get("hash").cloned().unwrap_or_default());
    }
    Ok(Value::Array(all))
}
