//! Nodes of our own that answer too much, too little, in other words, or behind another certificate.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::time::Duration;

use serde_json::json;

use super::*;

/// A server that gives `answer` the stream after the head of each request.
fn server(answer: impl Fn(TcpStream) + Send + Sync + 'static) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("binds");
    let port = listener.local_addr().expect("an address").port();
    let answer = std::sync::Arc::new(answer);
    std::thread::spawn(move || {
        for stream in listener.incoming().map_while(Result::ok) {
            let answer = std::sync::Arc::clone(&answer);
            std::thread::spawn(move || answer(stream));
        }
    });
    port
}

/// The head of a request.
fn head(stream: &mut TcpStream) -> String {
    let mut text = Vec::new();
    let mut byte = [0];
    while !text.ends_with(b"\r\n\r\n") && stream.read(&mut byte).is_ok_and(|length| length == 1) {
        text.push(byte[0]);
    }
    String::from_utf8(text).expect("text")
}

/// A server that answers every request with these lines and this body.
fn saying(lines: &'static str, body: &'static str) -> u16 {
    server(move |mut stream| {
        head(&mut stream);
        let length = body.len();
        let answer = format!("HTTP/1.1 {lines}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n{body}");
        drop(stream.write_all(answer.as_bytes()));
        drop(stream.read(&mut [0; 4096]));
    })
}

async fn asked(url: &str, method: &str) -> Result<Value, TransportError> {
    let transport = Transport::to_node(url, None).expect("a URL");
    transport.request(method, json!([])).await
}

async fn words(url: &str, method: &str) -> String {
    let error = asked(url, method).await.expect_err("refused");
    error.explained(url, method).to_string()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_status_of_http_is_told_and_what_to_do() {
    for (lines, said) in [
        ("401 Unauthorized", ["requires a user name and password", "HTTP 401", "https://USER:PASSWORD@"]),
        ("403 Forbidden", ["forbids", "HTTP 403", "host name"]),
        ("404 Not Found", ["nothing at this path", "HTTP 404", "chain.url"]),
        ("413 Payload Too Large", ["too large", "HTTP 413", "client_max_body_size"]),
        ("429 Too Many Requests", ["how often", "HTTP 429", "limit"]),
        ("502 Bad Gateway", ["cannot be reached by the proxy", "HTTP 502", "start the node"]),
        ("301 Moved\r\nLocation: https://new.example/KEY", ["https://new.example/…", "HTTP 301", "chain.url"]),
    ] {
        let port = saying(lines, "<html>a page</html>");
        let text = words(&format!("http://127.0.0.1:{port}"), "eth_chainId").await;
        assert!(said.iter().all(|part| text.contains(part)), "{lines}: {text}");
        assert!(!text.contains("KEY"), "{text}");
    }
    let port = saying("401 Unauthorized", "");
    let text = words(&format!("http://me:SECRET@127.0.0.1:{port}"), "eth_chainId").await;
    assert!(text.contains("does not accept the user name and password"), "{text}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_error_of_json_rpc_counts_whatever_the_status() {
    let port = saying("400 Bad Request", r#"{"error":{"code":-32000,"message":"no"}}"#);
    let error = asked(&format!("http://127.0.0.1:{port}"), "eth_call").await.expect_err("refused");
    assert!(matches!(error, TransportError::Answered(JsonRpcError { code: -32000, .. })), "{error}");
    let port = saying("200 OK", "<html>a page</html>");
    let error = asked(&format!("http://127.0.0.1:{port}"), "eth_call").await.expect_err("a page");
    assert!(matches!(&error, TransportError::Malformed(text) if text.contains("a web page")), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn user_name_and_password_are_sent() {
    let (sender, heads) = std::sync::mpsc::channel();
    let port = server(move |mut stream| {
        drop(sender.send(head(&mut stream).to_lowercase()));
    });
    drop(asked(&format!("http://op:geheim@127.0.0.1:{port}/x"), "eth_chainId").await);
    let head = heads.recv_timeout(Duration::from_secs(10)).expect("a request");
    // python3: base64.b64encode(b"op:geheim")
    assert!(head.contains("authorization: basic b3a6z2vozwlt\r\n") && head.contains(" /x http/1.1"), "{head}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_endless_answer_is_cut_at_its_limit() {
    let port = server(|mut stream| {
        head(&mut stream);
        drop(stream.write_all(b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\n\r\n{\"result\":\""));
        let piece = vec![b'0'; 1 << 16];
        while stream.write_all(&piece).is_ok() {}
    });
    let url = format!("http://127.0.0.1:{port}");
    assert_eq!(asked(&url, "eth_chainId").await, Err(TransportError::TooLong(USUAL.bytes)));
    assert_eq!(asked(&url, "eth_getLogs").await, Err(TransportError::TooLong(WIDE.bytes)));
    let text = words(&url, "eth_getBlockByNumber").await;
    assert!(text.contains("sent more than 4 MiB, which no answer of eth_getBlockByNumber has"), "{text}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_local_socket_is_kept_and_its_answers_have_a_longest() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("node.ipc");
    let listener = std::os::unix::net::UnixListener::bind(&path).expect("binds");
    let node = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().expect("a connection");
        for answer in [r#"{"id":1,"result":"0x}1"}"#, "\n{\"id\":1,\"result\":\"0x2\"}\n"] {
            let length = stream.read(&mut [0; 4096]).expect("a request");
            assert!(length > 0, "over the same connection");
            // In two pieces.
            let (one, other) = answer.split_at(9);
            stream.write_all(one.as_bytes()).expect("sends");
            std::thread::sleep(Duration::from_millis(50));
            stream.write_all(other.as_bytes()).expect("sends");
        }
        drop(stream.read(&mut [0; 4096]));
        let piece = vec![b'['; 1 << 16];
        while stream.write_all(&piece).is_ok() {}
    });
    let transport = Transport::to_node(&format!("ipc:{}", path.display()), None).expect("a path");
    for expected in ["0x}1", "0x2"] {
        assert_eq!(transport.request::<Value>("eth_chainId", json!([])).await, Ok(json!(expected)));
    }
    let endless = transport.request::<Value>("eth_chainId", json!([])).await;
    assert_eq!(endless, Err(TransportError::TooLong(USUAL.bytes)));
    node.join().expect("ends");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_port_without_tls_is_named_as_such() {
    let port = server(|mut stream| {
        drop(stream.write_all(b"HTTP/1.1 400 Bad Request\r\n\r\n"));
        drop(stream.read(&mut [0; 4096]));
    });
    let text = words(&format!("https://127.0.0.1:{port}"), "eth_chainId").await;
    assert!(text.contains("does not speak TLS"), "{text}");
    let port = saying("400 Bad Request", "<html>The plain HTTP request was sent to HTTPS port</html>");
    let text = words(&format!("http://127.0.0.1:{port}"), "eth_chainId").await;
    assert!(text.contains("speaks TLS at this port") && text.contains("https://"), "{text}");
}

#[test]
fn what_is_printed_for_debugging_has_no_credentials() {
    let transport = Transport::to_node("http://me:SECRET@127.0.0.1:1/KEY", None).expect("a URL");
    let text = format!("{transport:?}");
    assert!(text.contains("127.0.0.1:1") && !text.contains("SECRET") && !text.contains("KEY"), "{text}");
    let endpoint = Endpoint::Node { url: "http://me:SECRET@127.0.0.1:1/KEY".to_owned(), roots: None };
    let text = format!("{endpoint:?}");
    assert!(text.contains("127.0.0.1:1") && !text.contains("SECRET") && !text.contains("KEY"), "{text}");
}
