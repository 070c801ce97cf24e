//! Other implementations in processes of their own: of tries, proofs, Clique and QBFT (@ethereumjs, with @noble's curves),
//! and of accounts and transactions (Python's eth-account).

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

/// The workspace's root, from the binary's own package or from a crate's, and the folder with the peers.
fn places() -> Result<(&'static Path, PathBuf), String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().find(|place| place.join("tests/peers").is_dir());
    let root = root.ok_or("no tests/peers above this package")?;
    Ok((root, std::env::var_os("AUTHROS_PEERS").map_or_else(|| root.join("target/peers"), PathBuf::from)))
}

fn written(request: &Value) -> tempfile::NamedTempFile {
    let mut file = tempfile::NamedTempFile::new().expect("a file");
    std::io::Write::write_all(&mut file, request.to_string().as_bytes()).expect("written");
    file
}

fn answer(command: &mut Command) -> Value {
    let output = command.output().expect("it starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// The answer of eth-account to a request of `tests/peers/ethereum_accounts.py`; what is missing if it is not installed.
#[allow(dead_code, reason = "some tests include this file for proofs alone")]
pub fn accounts(request: &Value) -> Result<Value, String> {
    let (root, peers) = places()?;
    let python = peers.join("eth_account/bin/python");
    if !python.is_file() {
        return Err("no eth-account; tests/run installs it into target/peers".into());
    }
    let script = root.join("tests/peers/ethereum_accounts.py");
    Ok(answer(Command::new(python).arg("-B").arg(script).arg(written(request).path())))
}

/// The answer of @ethereumjs to a request of `tests/peers/foreign.mjs`; what is missing if it is not installed.
pub fn foreign(request: &Value) -> Result<Value, String> {
    let (root, peers) = places()?;
    if !peers.join("node_modules/@ethereumjs/mpt").is_dir() {
        return Err("no @ethereumjs/mpt; tests/run installs it into target/peers".into());
    }
    let asks = "process.exit(process.versions.node.split('.')[0] >= 18 ? 0 : 1)";
    if !Command::new("node").args(["--eval", asks]).status().is_ok_and(|status| status.success()) {
        return Err("no node 18 or later".into());
    }
    let program = std::fs::read_to_string(root.join("tests/peers/foreign.mjs")).expect("the program");
    // Its imports are looked up from the current folder.
    let arguments = ["--no-warnings", "--input-type=module", "--eval", &program];
    Ok(answer(Command::new("node").args(arguments).arg(written(request).path()).current_dir(&peers)))
}
