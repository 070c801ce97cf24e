//! `eth_getLogs`: bounded in blocks, in bytes searched and in bytes returned, before any of it is built.

use serde_json::Value;

use super::json::{self, Mining, read_address, read_hash};
use super::node::Node;
use super::rpc::{Fault, Parameters, Reply, block_number};
use crate::model::{Address, Hash};

/// The most blocks of one request.
pub const MOST_BLOCKS: u64 = 10_000;
/// The most bytes of transactions and receipts searched for one request.
const MOST_READ: usize = 32 * 1024 * 1024;
/// The most bytes in the answer, counted roughly as JSON.
const MOST_GIVEN: usize = 8 * 1024 * 1024;
/// The JSON size of a log without its data and topics, bytes.
const FRAME: usize = 500;

/// The parameters of eth_getLogs.
struct Filter {
    from: u64,
    to: u64,
    addresses: Vec<Address>,
    topics: Vec<Vec<Hash>>,
}

fn read_filter(node: &Node, value: &Value) -> Option<Filter> {
    let alternatives = |value: &Value| -> Vec<Value> {
        match value {
            Value::Null => Vec::new(),
            Value::Array(all) => all.clone(),
            one => vec![one.clone()],
        }
    };
    let bound = |name: &str| value.get(name).map_or(Some(node.head.number), |tag| block_number(node, tag));
    let topics = value.get("topics").map(alternatives).unwrap_or_default();
    let addresses = value.get("address").map(alternatives).unwrap_or_default();
    let hashes = |position: &Value| alternatives(position).iter().map(read_hash).collect::<Option<Vec<_>>>();
    let mut filter = Filter {
        from: bound("fromBlock")?,
        to: bound("toBlock")?,
        addresses: addresses.iter().map(read_address).collect::<Option<_>>()?,
        topics: topics.iter().map(hashes).collect::<Option<_>>()?,
    };
    if let Some(hash) = value.get("blockHash").and_then(read_hash) {
        filter.from = node.file.number_of(hash).ok().flatten()?;
        filter.to = filter.from;
    }
    Some(filter)
}

impl Filter {
    fn matches(&self, log: &super::block::Log) -> bool {
        let place = self.addresses.is_empty() || self.addresses.contains(&log.address);
        let wanted = |(index, any): (usize, &Vec<Hash>)| {
            any.is_empty() || log.topics.get(index).is_some_and(|topic| any.contains(topic))
        };
        place && self.topics.len() <= log.topics.len() && self.topics.iter().enumerate().all(wanted)
    }
}

fn too_many(what: &str) -> Fault {
    Fault::new(-32005, format!("{what}; ask for fewer blocks at once"))
}

/// The logs that match a filter.
///
/// # Errors
/// [`Fault`] -32005 if that is more than one answer holds, or for a malformed filter.
pub fn answer(node: &Node, parameters: &Parameters) -> Reply {
    let named = parameters.at(0, |filter| Some(filter.get("blockHash").and_then(read_hash)))?;
    if let Some(hash) = named
        && node.file.number_of(hash)?.is_none()
    {
        return Err(Fault::new(-32000, "unknown block"));
    }
    let filter = parameters.at(0, |value| read_filter(node, value))?;
    let to = filter.to.min(node.head.number);
    if (to + 1).saturating_sub(filter.from) > MOST_BLOCKS {
        return Err(too_many(&format!("logs of more than {MOST_BLOCKS} blocks")));
    }
    let (mut found, mut read, mut given) = (Vec::new(), 0, 0);
    for number in node.file.with_logs(filter.from, to)? {
        let Some(header) = node.header(number)? else { break };
        let mut index = 0;
        for (place, done) in node.done(&header)?.iter().enumerate() {
            read +=
                FRAME + done.transaction.raw.len() + done.receipt.logs.iter().map(|log| log.data.len()).sum::<usize>();
            if read > MOST_READ {
                return Err(too_many("there is too much to search"));
            }
            for log in &done.receipt.logs {
                if filter.matches(log) {
                    given += FRAME + 2 * log.data.len() + 70 * log.topics.len();
                    if given > MOST_GIVEN {
                        return Err(too_many("there are too many logs"));
                    }
                    found.push(json::log(log, done.transaction.hash, Mining::at(&header, place), index));
                }
                index += 1;
            }
        }
    }
    Ok(Value::Array(found))
}
