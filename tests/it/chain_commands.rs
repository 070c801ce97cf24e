//! The chain's commands: served to other tools, deployed by command, founded with a consensus, genesis files.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use serde_json::{Value, json};
use support::{Home, Running, list, text, wait_until};

/// The address in the output of `chain serve --json`.
fn address(serving: &mut Running) -> SocketAddr {
    let line = serving.wait_for_text("serving", 60);
    let document: Value = line.lines().find_map(|line| serde_json::from_str(line).ok()).expect("one JSON line");
    text(&document["serving"], "url").trim_start_matches("http://").parse().expect("an address")
}

/// One JSON-RPC request, as sent by any other tool.
fn ask(address: SocketAddr, method: &str, parameters: Value) -> Value {
    let body = json!({ "jsonrpc": "2.0", "id": 1, "method": method, "params": parameters }).to_string();
    let request = format!(
        "POST / HTTP/1.1\r\nHost: {address}\r\nContent-Type: application/json\r\nConnection: close\r\n\
         Content-Length: {}\r\n\r\n{body}",
        body.len()
    );
    let mut stream = TcpStream::connect(address).expect("connects");
    stream.set_read_timeout(Some(Duration::from_secs(30))).expect("a time limit");
    stream.write_all(request.as_bytes()).expect("writes");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("reads");
    let (_, body) = answer.split_once("\r\n\r\n").expect("a body");
    serde_json::from_str::<Value>(body).expect("JSON")["result"].clone()
}

#[test]
fn a_chain_is_served_by_a_site_of_its_own_or_by_the_running_one() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0", "--consensus", "pow:2000"]);
    let mut own = authros.with(&["--json"]).spawn(&["chain", "serve", "--listen", "127.0.0.1:0"]);
    let first = address(&mut own);
    let id = ask(first, "eth_chainId", json!([]));
    assert!(ask(first, "web3_clientVersion", json!([])).as_str().is_some_and(|name| name.contains("not ethash")));

    // Everything else joins this site, and a second server may run beside the first.
    let deployed = authros.json(&["chain", "deploy"]);
    let contract = text(&deployed, "contract");
    let code = ask(first, "eth_getCode", json!([contract, "latest"]));
    assert!(code.as_str().is_some_and(|code| code.len() > 1000), "{code}");
    let message = authros.fails(3, &["chain", "deploy"]);
    assert!(message.contains(&contract) && message.contains("already"), "{message}");
    let status = authros.json(&["chain", "status"]);
    assert_eq!(
        (&status["consensus"], &status["difficulty"], &status["period"]),
        (&json!("pow"), &json!("2000"), &Value::Null)
    );
    assert_eq!((&status["contract"], list(&status, "sealers").len()), (&json!(contract), 1));

    let mut joined = authros.with(&["--json"]).spawn(&["chain", "serve", "--listen", "127.0.0.1:0"]);
    let second = address(&mut joined);
    assert_ne!(first, second);
    assert_eq!(ask(second, "eth_chainId", json!([])), id);
    joined.stop("INT", 30).expect_code(0);
    wait_until(30, "the second door closes with who asked for it", || {
        TcpStream::connect(second).is_err().then_some(())
    });
    assert_eq!(ask(first, "eth_chainId", json!([])), id);

    // A killed one cannot say goodbye, but its listener closes all the same.
    let mut killed = authros.with(&["--json"]).spawn(&["chain", "serve", "--listen", "127.0.0.1:0"]);
    let third = address(&mut killed);
    killed.signal("KILL");
    wait_until(30, "the third door closes", || TcpStream::connect(third).is_err().then_some(()));
    drop(killed);

    // And one whose site ends says so.
    let mut orphan = authros.with(&["--json"]).spawn(&["chain", "serve", "--listen", "127.0.0.1:0"]);
    address(&mut orphan);
    own.stop("TERM", 60).expect_code(0);
    orphan.wait(60).expect_code(4);
}

#[test]
fn who_may_ask_and_where() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    for place in ["0.0.0.0:8545", "192.0.2.1:8545", "[::]:0"] {
        let message = authros.fails(3, &["chain", "serve", "--listen", place]);
        assert!(message.contains("127.0.0.1"), "{message}");
    }
    authros.run(&["chain", "serve", "--listen", "8545"]).expect_code(2);
    assert!(!home.path().join("chain").exists(), "no chain was founded for a refused request");
}

#[test]
fn a_home_keeps_the_consensus_it_was_founded_with() {
    let home = Home::new();
    let plain = home.authros().with(&["--robots", "0"]);
    plain.json(&["identity", "create"]);
    let founded = plain.with(&["--consensus", "poa:3:50"]).json(&["chain", "status"]);
    assert_eq!(
        (&founded["consensus"], &founded["period"], &founded["difficulty"]),
        (&json!("poa"), &json!(50), &Value::Null)
    );
    assert_eq!(list(&founded, "sealers").len(), 3);
    let again = plain.json(&["chain", "status"]);
    assert_eq!((&again["genesis"], &again["sealers"]), (&founded["genesis"], &founded["sealers"]));
    let message = plain.with_variable("AUTHROS_CONSENSUS", "pow").fails(3, &["chain", "status"]);
    assert!(message.contains("poa:3:50") && message.contains("pow:5033160"), "{message}");
    let message = plain.with(&["--consensus", "pos"]).fails(3, &["chain", "status"]);
    assert!(message.contains("pow:DIFFICULTY"), "{message}");
    let shown = plain.run(&["chain", "status"]).expect_code(0).stdout;
    assert!(shown.contains("at least 50 ms between blocks"), "{shown}");
}

#[test]
fn genesis_files_are_written_once() {
    let home = Home::new();
    let authros = home.authros();
    let signer = format!("0x{}", "ab".repeat(20));
    let directory = home.root().join("net");
    let out = directory.to_str().expect("UTF-8");
    let clique = ["chain", "genesis", "--consensus", "clique", "--signer", &signer, "--period", "3", "--out", out];
    let written = authros.json(&clique);
    let genesis: Value =
        serde_json::from_slice(&fs::read(directory.join("genesis.json")).expect("a file")).expect("JSON");
    assert_eq!(genesis["config"]["chainId"], written["chain_id"]);
    assert_eq!(genesis["config"]["clique"]["period"], json!(3));
    assert!(text(&genesis, "extraData").contains(&"ab".repeat(20)));
    assert!(fs::read_to_string(directory.join("README.md")).expect("a guide").contains("NOT tried"));
    assert!(authros.fails(3, &clique).contains("genesis.json already exists"));

    let alloc = format!("{signer}=1000");
    let arguments = ["chain", "genesis", "--consensus", "ethash", "--chain-id", "99", "--alloc", &alloc];
    let document = authros.json(&arguments);
    assert_eq!(document["genesis"]["config"]["chainId"], json!(99));
    let printed: Value = serde_json::from_str(&authros.run(&arguments).expect_code(0).stdout).expect("JSON alone");
    assert_eq!(printed["alloc"], document["genesis"]["alloc"]);
    assert_ne!(printed["extraData"], document["genesis"]["extraData"], "each file is one of its kind");

    let qbft = authros.json(&["chain", "genesis", "--consensus", "qbft", "--signer", &signer]);
    assert_eq!(qbft["genesis"]["config"]["zeroBaseFee"], json!(true));
    assert!(authros.fails(3, &["chain", "genesis", "--consensus", "qbft"]).contains("--signer"));
    authros.run(&["chain", "genesis"]).expect_code(2);
    let guide = authros.run(&["chain", "genesis", "--guide"]).expect_code(0).stdout;
    assert!(guide.contains("1.13.15") && guide.contains("NOT tried"), "{guide}");
    assert!(!home.path().exists(), "no home is needed for this");
}
