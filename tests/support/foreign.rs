//! Another implementation of tries, proofs, Clique and QBFT (@ethereumjs, with @noble's curves), in a process of its own.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

/// What it answers to a request of `tests/peers/foreign.mjs`; what is missing if it is not installed.
pub fn foreign(request: &Value) -> Result<Value, String> {
    // The workspace's root, from the binary's own package or from a crate's.
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().find(|place| place.join("tests/peers").is_dir());
    let root = root.ok_or("no tests/peers above this package")?;
    let peers = std::env::var_os("AUTHROS_PEERS").map_or_else(|| root.join("target/peers"), PathBuf::from);
    if !peers.join("node_modules/@ethereumjs/mpt").is_dir() {
        return Err("no @ethereumjs/mpt; tests/run installs it into target/peers".into());
    }
    let asks = "process.exit(process.versions.node.split('.')[0] >= 18 ? 0 : 1)";
    if !Command::new("node").args(["--eval", asks]).status().is_ok_and(|status| status.success()) {
        return Err("no node 18 or later".into());
    }
    let program = std::fs::read_to_string(root.join("tests/peers/foreign.mjs")).expect("the program");
    let mut file = tempfile::NamedTempFile::new().expect("a file");
    std::io::Write::write_all(&mut file, request.to_string().as_bytes()).expect("written");
    // Its imports are looked for from the current folder.
    let arguments = ["--no-warnings", "--input-type=module", "--eval", &program];
    let output = Command::new("node").args(arguments).arg(file.path()).current_dir(&peers).output().expect("node");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Ok(serde_json::from_slice(&output.stdout).expect("JSON"))
}
