//! A JSON-RPC request, and what an answer to it says.

use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{MIB, TransportError};

/// The longest answer that is an error, bytes; the largest known one has the data of a revert.
const LONGEST_ERROR: usize = MIB;

/// An error that a node answers with.
#[derive(Debug, Clone, PartialEq, Deserialize, thiserror::Error)]
#[error("{message} (code {code})")]
pub struct JsonRpcError {
    /// JSON-RPC's code; nodes do not agree on them.
    pub code: i64,
    /// The node's words.
    #[serde(default)]
    pub message: String,
    /// More: revert data, in whatever shape this node likes.
    #[serde(default)]
    pub data: Option<Value>,
}

#[derive(Serialize)]
struct Request<'a> {
    jsonrpc: &'static str,
    /// Over one connection there is one request at a time.
    id: u64,
    method: &'a str,
    params: &'a Value,
}

/// The text of a request.
pub(super) fn request(method: &str, params: &Value) -> String {
    serde_json::to_string(&Request { jsonrpc: "2.0", id: 1, method, params }).unwrap_or_default()
}

/// Whether it is an error, without building what is in it.
#[derive(Deserialize)]
struct Kind {
    #[serde(default)]
    error: Option<IgnoredAny>,
}

#[derive(Deserialize)]
struct Failed {
    error: JsonRpcError,
}

#[derive(Deserialize)]
#[serde(bound = "R: DeserializeOwned")]
struct Succeeded<R> {
    #[serde(deserialize_with = "R::deserialize")]
    result: R,
}

/// The result in an answer, read as what was asked for: what is not that is never built.
///
/// # Errors
/// [`TransportError::Answered`] and [`TransportError::Malformed`].
pub(super) fn read<R: DeserializeOwned>(bytes: &[u8]) -> Result<R, TransportError> {
    let malformed = |error: serde_json::Error| TransportError::Malformed(error.to_string());
    let kind: Kind = serde_json::from_slice(bytes).map_err(malformed)?;
    if kind.error.is_none() {
        return serde_json::from_slice(bytes).map(|answer: Succeeded<R>| answer.result).map_err(malformed);
    }
    if bytes.len() > LONGEST_ERROR {
        return Err(TransportError::TooLong(LONGEST_ERROR));
    }
    let failed: Failed = serde_json::from_slice(bytes).map_err(malformed)?;
    Err(TransportError::Answered(failed.error))
}

/// Whether these bytes are an answer of JSON-RPC, whatever it says.
pub(super) fn is_one(bytes: &[u8]) -> bool {
    #[derive(Deserialize)]
    struct Either {
        #[serde(default)]
        error: Option<IgnoredAny>,
        #[serde(default)]
        result: Option<IgnoredAny>,
    }
    serde_json::from_slice(bytes).is_ok_and(|answer: Either| answer.error.is_some() || answer.result.is_some())
}

/// A value in the shape that was asked for.
pub(super) fn shaped<R: DeserializeOwned>(value: Value) -> Result<R, TransportError> {
    serde_json::from_value(value).map_err(|error| TransportError::Malformed(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn read_as<R: DeserializeOwned>(answer: &Value) -> Result<R, TransportError> {
        read(answer.to_string().as_bytes())
    }

    #[test]
    fn an_answer_is_a_result_or_an_error() {
        assert_eq!(read_as(&json!({"jsonrpc": "2.0", "id": 1, "result": "0x1"})), Ok("0x1".to_owned()));
        assert_eq!(read_as::<Option<String>>(&json!({"id": 7, "result": null, "error": null})), Ok(None));
        let error = json!({"result": null, "error": {"code": -32000, "message": "no", "data": ["x"]}});
        let told = JsonRpcError { code: -32000, message: "no".to_owned(), data: Some(json!(["x"])) };
        assert_eq!(read_as::<String>(&error), Err(TransportError::Answered(told)));
        assert!(read_as::<Option<String>>(&json!({"id": 1})).is_err(), "no result is not the result null");
        for other in [json!({"result": 5}), json!({}), json!([]), json!("text"), json!({"error": "text"})] {
            assert!(matches!(read_as::<String>(&other), Err(TransportError::Malformed(_))), "{other}");
        }
    }

    #[test]
    fn an_error_is_not_as_long_as_logs_may_be() {
        let error = json!({"error": {"code": 1, "message": "x", "data": "y".repeat(LONGEST_ERROR)}});
        assert_eq!(read_as::<String>(&error), Err(TransportError::TooLong(LONGEST_ERROR)));
    }

    #[test]
    fn a_request_has_all_four_members() {
        let text = request("eth_call", &json!([1, "latest"]));
        let value: Value = serde_json::from_str(&text).expect("JSON");
        assert_eq!(value, json!({"jsonrpc": "2.0", "id": 1, "method": "eth_call", "params": [1, "latest"]}));
    }
}
