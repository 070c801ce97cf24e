//! The embedded chain's JSON-RPC over HTTP for tools on this machine (cast, web3, curl): reads, and signed
//! transactions.
//!
//! Loopback only, and only while it is explicitly run: anyone on this machine may connect.

mod rpc;
#[cfg(test)]
mod tests;

use std::net::{IpAddr, SocketAddr};
use std::{convert::Infallible, future::poll_fn, sync::Arc, time::Duration};

use http_body_util::{BodyExt as _, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::{
    ALLOW, CONNECTION, CONTENT_LENGTH, CONTENT_TYPE, HOST, HeaderValue, ORIGIN, TRANSFER_ENCODING,
    X_CONTENT_TYPE_OPTIONS,
};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until, timeout};

use self::rpc::Service;
use crate::{Chain, ChainError};

/// Longest request line with all headers, bytes.
const LONGEST_HEAD: usize = 16 * 1024;
const LONGEST_BODY: usize = 1024 * 1024;

#[derive(Debug, Clone, Copy)]
struct Limits {
    connections: usize,
    /// For a request, from the end of the previous answer, and for receiving an answer.
    patience: Duration,
    /// For the chain to answer.
    work: Duration,
}

const LIMITS: Limits = Limits { connections: 256, patience: Duration::from_secs(15), work: Duration::from_secs(30) };

/// Reason and advice; ends the connection.
#[derive(Debug, Clone, Copy)]
struct Refusal(StatusCode, &'static str);

const BUSY: Refusal = Refusal(StatusCode::SERVICE_UNAVAILABLE, "too many connections; try again");
const SLOW: Refusal = Refusal(StatusCode::REQUEST_TIMEOUT, "the request did not arrive in time");
const LONG: Refusal = Refusal(StatusCode::SERVICE_UNAVAILABLE, "the chain took too long; request less");
const CUT: Refusal = Refusal(StatusCode::BAD_REQUEST, "the body is cut");

pub async fn listen(address: SocketAddr) -> Result<TcpListener, ChainError> {
    if !address.ip().is_loopback() {
        return Err(ChainError::Input(format!(
            "{address} can be reached by other machines, and the chain cannot tell who is asking; listen on 127.0.0.1 \
             and use an ssh tunnel from elsewhere"
        )));
    }
    TcpListener::bind(address).await.map_err(|error| {
        ChainError::Input(format!("the chain cannot be served at {address}: {error}; choose another port"))
    })
}

impl Chain {
    /// All connections end with `stop`.
    pub async fn serve(&self, listener: TcpListener, stop: impl Future<Output = ()> + Send) -> Result<(), ChainError> {
        self.serve_within(LIMITS, listener, stop).await
    }

    async fn serve_within(
        &self,
        limits: Limits,
        listener: TcpListener,
        stop: impl Future<Output = ()> + Send,
    ) -> Result<(), ChainError> {
        let embedded = self.transport().embedded().cloned();
        let Some(embedded) = embedded else {
            return Err(ChainError::Input(format!(
                "this chain is the node at {}; point other tools there",
                self.url()
            )));
        };
        let service = Arc::new(Service::new(embedded));
        let places = Arc::new(Semaphore::new(limits.connections));
        let turned_away = Arc::new(Semaphore::new(limits.connections));
        // Connections end with this set.
        let mut open = JoinSet::new();
        tokio::pin!(stop);
        loop {
            let accepted = tokio::select! {
                () = &mut stop => return Ok(()),
                accepted = listener.accept() => accepted,
                Some(_) = open.join_next() => continue,
            };
            let Ok((stream, _)) = accepted else {
                // Out of descriptors, for example: not a reason to spin.
                tokio::time::sleep(Duration::from_millis(50)).await;
                continue;
            };
            let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
                turn_away(&mut open, &turned_away, stream, limits);
                continue;
            };
            let service = Arc::clone(&service);
            open.spawn(async move {
                let _place = place;
                // A disconnect concerns only the peer.
                drop(connection(stream, &service, limits).await);
            });
        }
    }
}

fn turn_away(open: &mut JoinSet<()>, waiting: &Arc<Semaphore>, stream: TcpStream, limits: Limits) {
    let Ok(place) = Arc::clone(waiting).try_acquire_owned() else {
        // In a flood, callers get no patience.
        drop(stream.try_write(&raw(BUSY)));
        return;
    };
    open.spawn(async move {
        let _place = place;
        drop(refuse(stream, BUSY, limits).await);
    });
}

async fn connection(stream: TcpStream, service: &Service, limits: Limits) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    // An unread answer ends the connection, like silence.
    let until = || Instant::now() + 2 * limits.patience;
    let deadline = watch::Sender::new(until());
    let answering = service_fn(|request| {
        deadline.send_replace(until() + limits.work);
        let answer = answer(request, service, limits);
        Box::pin(async {
            let answer = answer.await;
            deadline.send_replace(until());
            Ok::<_, Infallible>(answer)
        })
    });
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(limits.patience).max_buf_size(LONGEST_HEAD).half_close(true);
    let mut exchanges = http.serve_connection(TokioIo::new(stream), answering);
    let ended = loop {
        let last = *deadline.borrow();
        tokio::select! {
            ended = poll_fn(|context| exchanges.poll_without_shutdown(context)) => break ended,
            () = sleep_until(last) => if *deadline.borrow() == last { return Ok(()) },
        }
    };
    let stream = exchanges.into_parts().io.into_inner();
    match ended {
        Err(error) if error.is_timeout() => refuse(stream, SLOW, limits).await,
        _ => close(stream).await,
    }
}

async fn answer(request: Request<Incoming>, service: &Service, limits: Limits) -> Response<Full<Bytes>> {
    let answered = async {
        judge(&request)?;
        let body = Limited::new(request.into_body(), LONGEST_BODY).collect();
        let body = timeout(limits.patience, body).await.map_err(|_| SLOW)?.map_err(|_| CUT)?;
        timeout(limits.work, service.answer(&body.to_bytes())).await.map_err(|_| LONG)
    };
    match answered.await {
        Ok(body) => message(StatusCode::OK, "application/json", body),
        Err(Refusal(status, why)) => message(status, "text/plain; charset=utf-8", format!("{why}\n").into()),
    }
}

/// Accepts only JSON-RPC, and none from web pages.
fn judge(request: &Request<Incoming>) -> Result<(), Refusal> {
    let one = |name, missing, twice| {
        let mut values = request.headers().get_all(name).iter();
        match (values.next().map(HeaderValue::to_str), values.next()) {
            (Some(Ok(value)), None) => Ok(value),
            (None, _) => Err(missing),
            _ => Err(Refusal(StatusCode::BAD_REQUEST, twice)),
        }
    };
    if request.method() != Method::POST {
        return Err(Refusal(StatusCode::METHOD_NOT_ALLOWED, "use POST for JSON-RPC"));
    }
    if request.uri() != "/" {
        return Err(Refusal(StatusCode::NOT_FOUND, "JSON-RPC is at /"));
    }
    if request.headers().contains_key(ORIGIN) {
        return Err(Refusal(StatusCode::FORBIDDEN, "requests from web pages are refused"));
    }
    let missing = Refusal(StatusCode::BAD_REQUEST, "the Host header is missing");
    // If an attacker's DNS name resolves to this machine, Host still holds the attacker's name.
    if !is_this_machine(one(HOST, missing, "there are two Host headers")?) {
        let why = "the Host header must name this machine: localhost or 127.0.0.1";
        return Err(Refusal(StatusCode::FORBIDDEN, why));
    }
    // A browser form cannot send this type to another origin without a preflight request, which is refused.
    let unsupported = Refusal(StatusCode::UNSUPPORTED_MEDIA_TYPE, "set Content-Type: application/json");
    let kind = one(CONTENT_TYPE, unsupported, "there are two Content-Types")?;
    if !kind.split(';').next().unwrap_or_default().trim().eq_ignore_ascii_case("application/json") {
        return Err(unsupported);
    }
    let unknown = Refusal(StatusCode::LENGTH_REQUIRED, "send a Content-Length");
    let length = one(CONTENT_LENGTH, unknown, "the Content-Length is not a single number")?;
    if request.headers().contains_key(TRANSFER_ENCODING) {
        return Err(unknown);
    }
    let fits = length.parse().is_ok_and(|length: usize| length <= LONGEST_BODY);
    let long = Refusal(StatusCode::PAYLOAD_TOO_LARGE, "a body may have at most 1 MiB; send smaller batches");
    if fits { Ok(()) } else { Err(long) }
}

pub fn is_this_machine(host: &str) -> bool {
    let parts = match host.strip_prefix('[') {
        Some(bracketed) => bracketed.split_once(']'),
        None => Some(host.split_at(host.find(':').unwrap_or(host.len()))),
    };
    let Some((name, rest)) = parts else { return false };
    let port = rest.strip_prefix(':').unwrap_or(if rest.is_empty() { "0" } else { "" });
    let numeric = !port.is_empty() && port.bytes().all(|byte| byte.is_ascii_digit());
    let loopback = name.parse().is_ok_and(|address: IpAddr| address.is_loopback());
    numeric && (loopback || name.eq_ignore_ascii_case("localhost"))
}

fn message(status: StatusCode, kind: &'static str, body: Vec<u8>) -> Response<Full<Bytes>> {
    let mut message = Response::new(Full::from(body));
    *message.status_mut() = status;
    let headers = message.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    if !status.is_success() {
        headers.insert(CONNECTION, HeaderValue::from_static("close"));
    }
    if status == StatusCode::METHOD_NOT_ALLOWED {
        headers.insert(ALLOW, HeaderValue::from_static("POST"));
    }
    message
}

/// For a request that was not read.
fn raw(Refusal(status, why): Refusal) -> Vec<u8> {
    format!(
        "HTTP/1.1 {status}\r\nContent-Type: text/plain; charset=utf-8\r\nContent-Length: {}\r\nConnection: close\r\n\
         X-Content-Type-Options: nosniff\r\n\r\n{why}\n",
        why.len() + 1
    )
    .into()
}

async fn refuse(mut stream: TcpStream, refusal: Refusal, limits: Limits) -> std::io::Result<()> {
    timeout(limits.patience, stream.write_all(&raw(refusal))).await.map_err(|_| std::io::ErrorKind::TimedOut)??;
    close(stream).await
}

async fn close(mut stream: TcpStream) -> std::io::Result<()> {
    stream.shutdown().await?;
    // Closing with unread bytes would reset the connection and lose the answer.
    let rest = &mut stream.take(4 * LONGEST_BODY as u64);
    drop(timeout(Duration::from_secs(1), tokio::io::copy(rest, &mut tokio::io::sink())).await);
    Ok(())
}
