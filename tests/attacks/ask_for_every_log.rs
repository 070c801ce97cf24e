//! To make the chain build an answer of any size: transactions that log as much as they can, then one request for all
//! of it.

use std::time::{Duration, Instant};

use serde_json::json;

use crate::support::Home;
use crate::{Outcome, judge, served::Served};

const GAS: u64 = 9_900_000;
/// How many transactions log.
const LOGGED: u64 = 8;
/// An answer of this many bytes is what the attacker wants.
const LARGE: usize = 12 * 1024 * 1024;

/// JUMPDEST, LOG0(0, 32,768), back to the beginning until no gas is left for one more, then STOP.
const LOGS: [u8; 17] = [0x5b, 0x61, 0x80, 0, 0x60, 0, 0xa0, 0x62, 0x05, 0, 0, 0x5a, 0x11, 0x60, 0, 0x57, 0];

#[test]
fn ask_for_every_log() {
    let home = Home::new();
    let chain = Served::start(&home);
    let sent: Vec<_> =
        (0..LOGGED).map(|nonce| chain.send(&chain.signed(1, nonce, GAS, Some(&LOGS))).expect("taken")).collect();
    let deadline = Instant::now() + Duration::from_secs(120);
    for hash in &sent {
        while chain.block_of(hash).is_none() {
            assert!(Instant::now() < deadline, "the logs are not on the chain");
            std::thread::sleep(Duration::from_millis(50));
        }
    }
    let outcome = match chain.ask("eth_getLogs", json!([{ "fromBlock": "0x0", "toBlock": "latest" }])) {
        Err(words) if words.contains("-32005") && words.contains("request fewer blocks per call") => {
            Outcome::Refused(words)
        }
        Err(words) => Outcome::Otherwise(words),
        Ok(logs) => {
            let length = logs.to_string().len();
            assert!(length > LARGE, "the logs are too few to show anything: {length} bytes");
            Outcome::Succeeded(format!("one request gave {length} bytes of logs"))
        }
    };
    judge("ask for every log", outcome);
}
