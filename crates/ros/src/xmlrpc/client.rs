//! One XML-RPC call to one peer, ended at its deadline whatever the peer does.

use std::io::Write as _;
use std::net::{Shutdown, TcpStream};
use std::time::{Duration, Instant};

use super::http::{Timed, read_message};
use super::parse::{Response, parse_response};
use super::value::{Value, write_call};
use crate::model::clean;
use crate::ros::address::{Endpoint, connect};

/// The longest response, bytes.
const LONGEST_RESPONSE: usize = 8 << 20;

/// The longest wait for a connection.
const CONNECT: Duration = Duration::from_millis(1500);

/// Why a call failed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum CallError {
    /// No connection could be made.
    #[error("{0}")]
    Connect(String),
    /// The connection broke, or the answer did not come in time.
    #[error("{0}")]
    Broken(String),
    /// The response is not valid.
    #[error("{0}")]
    Protocol(String),
    /// The peer refused.
    #[error("{0}")]
    Refused(String),
}

/// Calls `method` and unwraps ROS's response, `[code, status, value]`.
pub(crate) fn call(peer: &Endpoint, method: &str, params: &[Value], deadline: Instant) -> Result<Value, CallError> {
    let response = forward(peer, &write_call(method, params), deadline)?;
    match parse_response(&response).map_err(|error| CallError::Protocol(error.to_string()))? {
        Response::Value(value) => unwrap_answer(value),
        Response::Fault(words) => Err(CallError::Refused(clean(&words, 200))),
    }
}

/// Hands on the text of a call; returns the text of the response, unread.
pub(crate) fn forward(peer: &Endpoint, body: &str, deadline: Instant) -> Result<String, CallError> {
    let by = deadline.min(Instant::now() + CONNECT);
    let stream = connect(&peer.host, peer.port, by).map_err(|error| CallError::Connect(error.to_string()))?;
    let response = exchange(&stream, peer, body, deadline);
    // The peer may have closed first.
    let _ = stream.shutdown(Shutdown::Both);
    response
}

fn exchange(stream: &TcpStream, peer: &Endpoint, body: &str, deadline: Instant) -> Result<String, CallError> {
    let broken = |error: std::io::Error| match error.kind() {
        std::io::ErrorKind::InvalidData => CallError::Protocol(error.to_string()),
        _ => CallError::Broken(error.to_string()),
    };
    let request = format!(
        "POST {} HTTP/1.1\r\nHost: {}\r\nUser-Agent: authros\r\nConnection: close\r\nContent-Type: text/xml\r\n\
         Content-Length: {}\r\n\r\n{body}",
        peer.path,
        peer.authority(),
        body.len()
    );
    let mut timed = Timed { stream, deadline };
    timed.write_all(request.as_bytes()).map_err(broken)?;
    let (status, body) = read_message(timed, LONGEST_RESPONSE, true).map_err(broken)?;
    if status.split_whitespace().nth(1) != Some("200") {
        return Err(CallError::Protocol(format!("it answered '{}'", clean(&status, 60))));
    }
    Ok(String::from_utf8_lossy(&body).into_owned())
}

fn unwrap_answer(value: Value) -> Result<Value, CallError> {
    let Value::Array(parts) = value else {
        return Err(CallError::Protocol("its answer is not [code, status, value]".into()));
    };
    let Ok([code, status, value]) = <[Value; 3]>::try_from(parts) else {
        return Err(CallError::Protocol("its answer is not [code, status, value]".into()));
    };
    match code.as_int() {
        Some(1) => Ok(value),
        Some(_) => Err(CallError::Refused(clean(status.as_text().unwrap_or("no reason given"), 200))),
        None => Err(CallError::Protocol("its answer has no code".into())),
    }
}
