//! JSON-RPC 2.0 over the embedded chain: single requests and bounded batches, reads and raw transactions.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::transport::{TransportError, refused};
use crate::{embedded::Embedded, model::bytes::unhex, transaction::Transaction};

const LONGEST_BATCH: usize = 100;
/// Bytes per HTTP request.
const LONGEST_ANSWER: usize = 32 * 1024 * 1024;

pub struct Service {
    chain: Embedded,
    heavy: Heavy,
}

impl Service {
    pub fn new(chain: Embedded) -> Self {
        Self { chain, heavy: Heavy::new(Instant::now()) }
    }

    /// Empty if no answer is due.
    pub async fn answer(&self, body: &[u8]) -> Vec<u8> {
        let answer = match serde_json::from_slice::<Value>(body) {
            Err(_) => Some(failure(&Value::Null, &refused(-32700, "the body is not JSON"))),
            Ok(Value::Array(batch)) => return self.batch(batch).await,
            Ok(one) => self.single(one).await,
        };
        answer.map(|answer| written(&answer, &Value::Null)).unwrap_or_default()
    }

    async fn batch(&self, batch: Vec<Value>) -> Vec<u8> {
        if batch.is_empty() || batch.len() > LONGEST_BATCH {
            let what = format!("a batch has 1 to {LONGEST_BATCH} requests, this one {}", batch.len());
            return written(&failure(&Value::Null, &refused(-32600, what)), &Value::Null);
        }
        let mut all: Vec<u8> = Vec::new();
        for request in batch {
            let id = request.get("id").cloned().unwrap_or_default();
            let Some(answer) = self.single(request).await else { continue };
            let mut next = written(&answer, &id);
            if all.len() + next.len() > LONGEST_ANSWER {
                next = written(&failure(&id, &too_long()), &id);
            }
            all.push(if all.is_empty() { b'[' } else { b',' });
            all.append(&mut next);
        }
        if !all.is_empty() {
            all.push(b']');
        }
        all
    }

    /// `None` for a notification.
    async fn single(&self, request: Value) -> Option<Value> {
        let Value::Object(mut request) = request else {
            return Some(failure(&Value::Null, &refused(-32600, "a request is an object")));
        };
        let id = request.remove("id");
        let known = id.clone().filter(|id| id.is_string() || id.is_number()).unwrap_or_default();
        let result = match (request.get("jsonrpc"), request.get("method"), request.get("params")) {
            (Some(Value::String(version)), Some(Value::String(method)), params) if version == "2.0" => {
                self.call(method, params.cloned()).await
            }
            _ => Err(refused(-32600, "a request has jsonrpc \"2.0\", a method and an id")),
        };
        id?;
        Some(match result {
            Ok(result) => json!({ "jsonrpc": "2.0", "id": known, "result": result }),
            Err(fault) => failure(&known, &fault),
        })
    }

    async fn call(&self, method: &str, parameters: Option<Value>) -> Result<Value, TransportError> {
        let parameters = match parameters {
            None | Some(Value::Null) => Vec::new(),
            Some(Value::Array(all)) => all,
            Some(_) => return Err(refused(-32602, "parameters come as an array")),
        };
        if method == "eth_sendRawTransaction" {
            let counted = self.heavy.count(parameters.first(), Instant::now());
            counted.map_err(|pause| too_heavy(pause.as_secs() + 1))?;
        }
        self.chain.request(method, Value::Array(parameters)).await
    }
}

fn too_heavy(seconds: u64) -> TransportError {
    refused(-32005, format!("transactions of more than a million gas are rate-limited; send it again in {seconds} s"))
}

fn too_long() -> TransportError {
    refused(-32005, format!("the answer is longer than {LONGEST_ANSWER} bytes; request less"))
}

fn failure(id: &Value, fault: &TransportError) -> Value {
    let (code, message, data) = match fault {
        TransportError::Answered(answer) => (answer.code, answer.message.clone(), answer.data.as_ref()),
        other => (-32603, other.to_string(), None),
    };
    let mut error = json!({ "code": code, "message": message });
    if let Some(data) = data {
        error["data"] = data.clone();
    }
    json!({ "jsonrpc": "2.0", "id": id, "error": error })
}

fn written(answer: &Value, id: &Value) -> Vec<u8> {
    let bytes = serde_json::to_vec(answer).unwrap_or_default();
    if bytes.len() <= LONGEST_ANSWER {
        return bytes;
    }
    serde_json::to_vec(&failure(answer.get("id").unwrap_or(id), &too_long())).unwrap_or_default()
}

// Heavy transactions. Gas is free here, and every user of the machine may send some: a burst passes, then one now and
// then.

/// Several times the gas of an anchor, a registration or a grant.
const HEAVY: u64 = 1_000_000;
/// Burst, for all callers together.
const AT_ONCE: u32 = 40;
/// Time until one more passes.
const PAUSE: Duration = Duration::from_secs(10);

#[derive(Debug)]
pub struct Heavy {
    /// How many are left, as of when.
    left: Mutex<(u32, Instant)>,
}

impl Heavy {
    pub fn new(now: Instant) -> Self {
        Self { left: Mutex::new((AT_ONCE, now)) }
    }

    /// Counts a heavy transaction, in hex; the error is the time to wait.
    pub fn count(&self, raw: Option<&Value>, now: Instant) -> Result<(), Duration> {
        let raw = raw.and_then(Value::as_str).and_then(unhex).unwrap_or_default();
        // The chain refuses what is no transaction.
        let gas = Transaction::parse(&raw).map_or(0, |parsed| parsed.gas_limit);
        if gas <= HEAVY { Ok(()) } else { self.take(now) }
    }

    fn take(&self, now: Instant) -> Result<(), Duration> {
        let mut left = self.left.lock().unwrap_or_else(PoisonError::into_inner);
        let (mut number, mut since) = *left;
        while number < AT_ONCE && now.saturating_duration_since(since) >= PAUSE {
            (number, since) = (number + 1, since + PAUSE);
        }
        if number == AT_ONCE {
            since = now;
        }
        let taken = number.checked_sub(1);
        *left = (taken.unwrap_or(0), since);
        taken.map(drop).ok_or_else(|| PAUSE.saturating_sub(now.saturating_duration_since(since)))
    }
}

#[cfg(test)]
mod heavy_tests {
    use super::*;
    use crate::model::bytes::hex;

    /// A transaction that may use this much gas; nobody signed it.
    fn raw(gas: u64) -> Value {
        let list = crate::transaction::List::default().add(&1u64).add(&0u64).add(&gas);
        Value::String(format!("0x{}", hex(&list.add_encoded(&[0x80; 6]).end())))
    }

    #[test]
    fn heavy_ones_are_few_and_the_usual_ones_are_not_counted() {
        let begun = Instant::now();
        let heavy = Heavy::new(begun);
        let count = |gas: u64, after: Duration| heavy.count(Some(&raw(gas)), begun + after);
        for _ in 0..AT_ONCE {
            assert_eq!(count(HEAVY + 1, Duration::ZERO), Ok(()));
        }
        assert_eq!(count(10_000_000, Duration::from_secs(3)), Err(Duration::from_secs(7)));
        assert_eq!(count(HEAVY, Duration::ZERO), Ok(()), "a usual one");
        assert_eq!(heavy.count(Some(&Value::Null), begun), Ok(()), "the chain refuses it");
        assert_eq!(heavy.count(None, begun), Ok(()));
        assert_eq!(count(HEAVY + 1, PAUSE), Ok(()));
        assert!(count(HEAVY + 1, PAUSE).is_err(), "one in ten seconds");
        let later = PAUSE * (2 * AT_ONCE);
        assert_eq!((0..2 * AT_ONCE).filter(|_| count(HEAVY + 1, later).is_ok()).count(), 40);
    }
}
