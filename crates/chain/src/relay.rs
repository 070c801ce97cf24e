//! A chain reached through another party's connection: what may pass, and the transport for one's own requests.

#[cfg(test)]
mod rules_tests;

use std::{fmt, sync::Arc};

use serde_json::{Value, json};

pub use crate::model::relay::{LONGEST_RAW, Relay, RelayError, check, weight};
use crate::model::{Address, Identity, bytes::unhex, clean};
use crate::transport::{JsonRpcError, TransportError};
use crate::{Chain, Pin, call::Call, transaction::Transaction};

/// Longest error text passed on, characters.
const LONGEST_WORDS: usize = 400;

/// Two are equal if they are the same object.
#[derive(Clone)]
pub struct RelayLine(pub Arc<dyn Relay>);

impl fmt::Debug for RelayLine {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "RelayLine({})", self.0.place())
    }
}

impl PartialEq for RelayLine {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl Eq for RelayLine {}

impl From<RelayError> for TransportError {
    fn from(error: RelayError) -> Self {
        match error {
            RelayError::Answered { code, message, data } => Self::Answered(JsonRpcError { code, message, data }),
            RelayError::NotAllowed => {
                Self::Answered(JsonRpcError { code: -32601, message: RelayError::NotAllowed.to_string(), data: None })
            }
            RelayError::Silent(reason) => Self::Broken(reason),
        }
    }
}

impl From<TransportError> for RelayError {
    fn from(error: TransportError) -> Self {
        match error {
            TransportError::Answered(JsonRpcError { code, message, data }) => {
                Self::Answered { code, message: clean(&message, LONGEST_WORDS), data }
            }
            other => Self::Silent(clean(&other.to_string(), LONGEST_WORDS)),
        }
    }
}

impl Chain {
    /// [`examine`] decides what may pass.
    pub async fn relay(&self, method: &str, parameters: &Value) -> Result<Value, RelayError> {
        check(method, parameters)?;
        Ok(self.transport().request_for_another(method, parameters.clone()).await?)
    }
}

// What may pass: a visitor's reads, and a registered caller's transactions as well; only about the one contract, in
// bounded portions.

/// Several times the gas of the contract's most expensive call.
pub const MOST_GAS: u64 = 10_000_000;
/// Blocks per request: as many as this program's own clients ask for.
const VISITORS_BLOCKS: u64 = 2_000;
const MOST_BLOCKS: u64 = 10_000;
/// That of the longest transaction.
const LONGEST_DATA: usize = LONGEST_RAW;
const MOST_SLOTS: usize = 64;
/// After the selector, two offsets and a length.
const IDENTITY_AT: usize = 4 + 3 * 32;
/// After the identity and a length.
const ENVELOPE_AT: usize = IDENTITY_AT + Identity::LENGTH + 32;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Asker {
    /// Without a transport key.
    Visitor,
    /// With the transport key of a registered account.
    Registered,
}

#[derive(Debug, Clone, Copy)]
pub struct Ground<'a> {
    pub pin: &'a Pin,
    /// Newest block seen; only interprets `latest`.
    pub head: u64,
}

/// Judged from the request alone.
#[derive(Debug, Clone, PartialEq)]
pub enum Passed {
    Read(Value),
    /// Logs of blocks that have none.
    NoLogs,
    Estimate {
        from: Option<Address>,
        registers: Option<Box<Identity>>,
    },
    Transaction {
        sender: Address,
        registers: Option<Box<Identity>>,
    },
}

fn refused<T>(code: i64, words: impl Into<String>) -> Result<T, RelayError> {
    Err(RelayError::Answered { code, message: words.into(), data: None })
}

/// Judges a request by its method, its caller and its bounds.
pub fn examine(ground: Ground<'_>, asker: Asker, method: &str, parameters: &Value) -> Result<Passed, RelayError> {
    check(method, parameters)?;
    let first = parameters.get(0).unwrap_or(&Value::Null);
    match (method, asker) {
        ("eth_getProof" | "eth_feeHistory", Asker::Visitor) => Err(RelayError::NotAllowed),
        ("eth_getProof", _) => {
            let slots = parameters.get(1).and_then(Value::as_array).map_or(0, Vec::len);
            if slots > MOST_SLOTS { refused(-32602, "too many slots in one request") } else { read(parameters) }
        }
        ("eth_sendRawTransaction", _) => transaction(ground.pin, first),
        ("eth_call", _) => message(ground.pin, parameters).and_then(|_| read(parameters)),
        ("eth_estimateGas", _) => {
            let data = message(ground.pin, parameters)?;
            Ok(Passed::Estimate { from: address(first.get("from")), registers: registration(&data) })
        }
        ("eth_getLogs", _) => logs(ground, asker, first),
        ("eth_getBlockByNumber" | "eth_getBlockByHash", Asker::Visitor) => match parameters.get(1) {
            Some(Value::Bool(true)) => refused(-32602, "a visitor may only get blocks without their transactions"),
            _ => read(parameters),
        },
        _ => read(parameters),
    }
}

#[expect(clippy::unnecessary_wraps, reason = "one of several outcomes")]
fn read(parameters: &Value) -> Result<Passed, RelayError> {
    Ok(Passed::Read(parameters.clone()))
}

fn address(value: Option<&Value>) -> Option<Address> {
    value?.as_str()?.to_lowercase().parse().ok()
}

fn bytes(value: &Value) -> Option<Vec<u8>> {
    unhex(value.as_str()?)
}

/// Data of a call of the contract; only the block may follow it.
fn message(pin: &Pin, parameters: &Value) -> Result<Vec<u8>, RelayError> {
    const FIELDS: [&str; 5] = ["from", "to", "data", "input", "gas"];
    let Some(call) = parameters.get(0).and_then(Value::as_object) else { return refused(-32602, "no call") };
    if parameters.get(2).is_some() || !call.keys().all(|key| FIELDS.contains(&key.as_str())) {
        return refused(-32602, "a call takes from, to, data and a block; nothing else is forwarded");
    }
    if address(call.get("to")) != Some(pin.contract) {
        return refused(-32602, format!("only calls to the contract {} are forwarded", pin.contract));
    }
    let data = match (call.get("data"), call.get("input")) {
        (Some(_), Some(_)) => None,
        (Some(data), None) | (None, Some(data)) => bytes(data),
        (None, None) => Some(Vec::new()),
    };
    match data.filter(|data| data.len() <= LONGEST_DATA) {
        Some(data) => Ok(data),
        None => refused(-32602, "call data is not hex, or too long"),
    }
}

fn transaction(pin: &Pin, raw: &Value) -> Result<Passed, RelayError> {
    let rejected = |words: String| refused(-32003, words);
    let Some(raw) = bytes(raw) else { return refused(-32602, "no signed transaction") };
    let decoded = match Transaction::decode(&raw, pin.chain_id) {
        Ok(decoded) => decoded,
        Err(reason) => return refused(-32000, reason),
    };
    if decoded.to != Some(pin.contract) || !decoded.value.is_zero() {
        return rejected(format!("only transactions to the contract {} without value are forwarded", pin.contract));
    }
    if decoded.gas_limit > MOST_GAS {
        return rejected(format!("the transaction may use {} gas; at most {MOST_GAS} is forwarded", decoded.gas_limit));
    }
    Ok(Passed::Transaction { sender: decoded.sender, registers: registration(&decoded.input) })
}

/// `None` unless the call data does exactly that.
fn registration(data: &[u8]) -> Option<Box<Identity>> {
    if data.len() > LONGEST_DATA {
        return None;
    }
    let identity = Identity::parse(data.get(IDENTITY_AT..IDENTITY_AT + Identity::LENGTH)?).ok()?;
    let length = u32::from_be_bytes(data.get(ENVELOPE_AT - 4..ENVELOPE_AT)?.try_into().ok()?);
    let envelope = data.get(ENVELOPE_AT..)?.get(..usize::try_from(length).ok()?)?.to_vec();
    // Call data that differs anywhere else is no registration.
    let call = Call::Register { identity, envelope }.encode().ok()?;
    (call == data).then(|| Box::new(identity))
}

/// Logs of the contract alone, for a bounded number of blocks from its deployment on.
fn logs(ground: Ground<'_>, asker: Asker, filter: &Value) -> Result<Passed, RelayError> {
    let Some(fields) = filter.as_object() else { return refused(-32602, "no filter") };
    let place = match fields.get("address") {
        Some(Value::Array(all)) if all.len() == 1 => address(all.first()),
        one => address(one),
    };
    if place != Some(ground.pin.contract) {
        return refused(-32602, format!("only logs of the contract {} are forwarded", ground.pin.contract));
    }
    if fields.contains_key("blockHash") {
        return read(&json!([filter]));
    }
    let bound = |name: &str| match fields.get(name).map(|value| value.as_str()) {
        None | Some(Some("latest" | "pending" | "safe" | "finalized")) => Some(ground.head),
        Some(Some("earliest")) => Some(0),
        Some(Some(number)) => u64::from_str_radix(number.strip_prefix("0x")?, 16).ok(),
        Some(None) => None,
    };
    let (Some(from), Some(to)) = (bound("fromBlock"), bound("toBlock")) else { return refused(-32602, "no blocks") };
    let first = from.max(ground.pin.deployed_at);
    if to < first {
        return Ok(Passed::NoLogs);
    }
    let most = if asker == Asker::Visitor { VISITORS_BLOCKS } else { MOST_BLOCKS };
    if to - first >= most {
        return refused(-32005, format!("logs of more than {most} blocks; request fewer"));
    }
    let mut bounded = fields.clone();
    if first > from {
        bounded.insert("fromBlock".to_owned(), json!(format!("{first:#x}")));
    }
    // Keeps the requested end: the chain may be further than is known here.
    read(&json!([bounded]))
}
