//! A JSON-RPC request, and what an answer to it says.

use std::error::Error;

use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::address::Server;
use super::{MIB, TransportError};
use crate::web;

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

// Plain words for a server that refuses before its node gets to see the request.

/// The setting that names authorities.
const ROOTS: &str = "`chain.roots`";

/// An answer of HTTP that is none of JSON-RPC.
pub(super) struct Refused<'a> {
    pub status: u16,
    pub location: Option<&'a str>,
    /// The beginning of its text.
    pub page: &'a [u8],
}

impl Refused<'_> {
    /// What it means, and what to do.
    pub(super) fn words(&self, server: &Server) -> TransportError {
        let (what, advice) = match self.status {
            401 if server.credentials.is_some() => (
                "does not accept the user name and password in its URL",
                "correct them in `chain.url`; write characters other than letters and digits as %40 and the like",
            ),
            401 => {
                ("wants a user name and password", "write them into `chain.url`, as https://USER:PASSWORD@HOST:PORT")
            }
            403 => ("forbids the request", "ask who runs it to allow this machine and this host name"),
            404 => ("serves nothing at this path", "correct the path in `chain.url`"),
            405 | 426 => (
                "does not take requests of this kind at this path",
                "check the path in `chain.url`, and whether it is ws:// (wss://) or http:// (https://)",
            ),
            413 => (
                "finds the request too large",
                "raise the limit of what stands before the node (nginx: client_max_body_size)",
            ),
            429 => ("limits how often it may be asked", "wait, or ask who runs it for a higher limit"),
            502..=504 => {
                ("cannot be reached by the server that stands before it", "start the node, or give it more time there")
            }
            500..=599 => ("has a fault", "look into its log, or into that of what stands before it"),
            301..=303 | 307 | 308 => return self.redirect(server),
            400 if self.is_plain_to_tls() => ("speaks TLS at this port", "write https:// or wss:// in `chain.url`"),
            _ => ("answers with a page instead of JSON-RPC", "check that `chain.url` is an Ethereum node"),
        };
        TransportError::Unusable { reason: format!("{what} (HTTP {})", self.status), advice: advice.to_owned() }
    }

    fn redirect(&self, server: &Server) -> TransportError {
        let place = web::redirected(&server.url, self.location);
        let reason = format!("points at {place} (HTTP {}), which is not followed", self.status);
        TransportError::Unusable { reason, advice: "write that address into `chain.url`".to_owned() }
    }

    /// nginx and Go's servers say so in words only.
    fn is_plain_to_tls(&self) -> bool {
        let text = String::from_utf8_lossy(self.page).to_lowercase();
        text.contains("https port") || text.contains("https server")
    }
}

/// A connection that broke: by TLS, or by something else.
pub(super) fn broken(error: &(dyn Error + 'static)) -> TransportError {
    match web::tls_fault(error, ROOTS) {
        Some(fault) => TransportError::Unusable { reason: fault.reason, advice: fault.advice },
        None => TransportError::Broken(web::innermost(error)),
    }
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
