//! To exhaust the disk and memory of everyone who reads the chain: two throw-away accounts, one of which grants the
//! other an envelope and revokes it, over and over.

use authros::chain::Call;
use authros::model::{Address, Identity, PublicKey, Scope, Signature, Token};
use ethers::types::H160;
use serde_json::{Value, json};

use crate::served::{Served, account_of};
use crate::support::{Home, long, text, wait_until};
use crate::{Outcome, judge};

const NAME: &str = "grow_the_directory";
/// The attacker, and the account it grants to.
const STRANGERS: [u8; 2] = [41, 42];
/// Rounds whose transactions are sent together.
const TOGETHER: u64 = 8;
/// How many times as expensive a round may be at the end as at the beginning: the same process seals the chain, whose
/// trees deepen with each token, and a log that is checkpointed falls into one part.
const FACTOR: u64 = 4;
/// How much memory may grow over all rounds, MiB: what the chain caches of its newest blocks.
const ROOM: u64 = 64;

/// The site under attack, and the contract.
struct Field {
    chain: Served,
    contract: H160,
    ledger: std::path::PathBuf,
    /// The next nonce of each stranger.
    nonces: [u64; 2],
    tokens: u64,
}

impl Field {
    fn token(&mut self) -> Token {
        self.tokens += 1;
        Token([self.tokens.to_be_bytes(); 4].concat().try_into().expect("32 bytes"))
    }

    /// One of the strangers makes calls, all of which must succeed.
    fn calls(&mut self, stranger: usize, calls: &[Call]) {
        let mut batch = Vec::new();
        for call in calls {
            let data = call.encode().expect("encodes");
            let nonce = self.nonces[stranger];
            let raw = self.chain.signed_call(STRANGERS[stranger], nonce, self.contract, data);
            batch.push(json!({ "jsonrpc": "2.0", "id": nonce, "method": "eth_sendRawTransaction", "params": [raw] }));
            self.nonces[stranger] += 1;
        }
        let answers = self.chain.post(&Value::Array(batch)).expect("answers");
        let answers = answers.as_array().expect("a batch").clone();
        assert!(answers.iter().all(|answer| answer["result"].is_string()), "{answers:?}");
        let last = &answers.last().expect("some")["result"];
        let block = wait_until(60, "a block", || self.chain.block_of(last));
        for answer in &answers {
            let receipt = self.chain.ask("eth_getTransactionReceipt", json!([answer["result"]])).expect("a receipt");
            assert_eq!(receipt["status"], "0x1", "{receipt}");
        }
        wait_until(60, "the site has read it", || (self.scanned() >= block).then_some(()));
    }

    /// The block up to which the site has read the chain.
    fn scanned(&self) -> u64 {
        let flags = rusqlite::OpenFlags::SQLITE_OPEN_READ_ONLY;
        let ledger = rusqlite::Connection::open_with_flags(&self.ledger, flags).expect("the ledger");
        let block = ledger.query_row("SELECT block FROM cursors WHERE name = 'watcher'", [], |row| row.get(0));
        block.map_or(0, i64::cast_unsigned)
    }

    fn rounds(&mut self, first: u64, count: u64) {
        let grantee = Address(account_of(STRANGERS[1]).0);
        for some in (first..first + count).collect::<Vec<_>>().chunks(usize::try_from(TOGETHER).expect("small")) {
            let mut calls = Vec::new();
            for epoch in some {
                let (scope, envelope) = (Scope::All, vec![7; 4_096]);
                calls.push(Call::AuthorityGrant { grantee, epoch: *epoch, expiry: None, scope, envelope });
                calls.push(Call::AuthorityRevoke { grantee, new_token: self.token() });
            }
            self.calls(0, &calls);
        }
    }

    /// Bytes that the site has written so far, to files and everything else.
    fn written(&self) -> u64 {
        field(&std::fs::read_to_string(format!("/proc/{}/io", self.chain.process())).expect("it runs"), "wchar:")
    }

    /// What it holds in memory, MiB.
    fn held(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.chain.process())).expect("it runs");
        field(&status, "VmRSS:") / 1024
    }
}

fn field(text: &str, name: &str) -> u64 {
    let line = text.lines().find(|line| line.starts_with(name)).expect("the field");
    line.split_whitespace().nth(1).and_then(|number| number.parse().ok()).expect("a number")
}

#[test]
fn grow_the_directory() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    authros.enrol();
    let contract = text(&authros.json(&["chain", "status"]), "contract").parse().expect("an address");
    let ledger = home.path().join("ledger.db");
    let mut field = Field { chain: Served::start(&home), contract, ledger, nonces: [0; 2], tokens: 0 };
    for stranger in [0, 1] {
        let (token, key, proof) = (field.token(), PublicKey([9; 64]), Signature([9; 64]));
        field.calls(stranger, &[Call::Register { identity: Identity { token, signing: key, envelope: key, proof } }]);
    }

    let part = if long() { 1_000 } else { 160 };
    let parts = if long() { 6 } else { 3 };
    let mut costs = Vec::new();
    let mut memory = Vec::new();
    for number in 0..parts {
        let before = field.written();
        field.rounds(1 + number * part, part);
        costs.push((field.written() - before) / part);
        memory.push(field.held());
    }
    let rounds = part * parts;
    let told = format!("{rounds} rounds: bytes written a round {costs:?}, MiB held {memory:?}");
    let (first, last) = (costs[0], *costs.last().expect("some"));
    let held = memory.last().zip(memory.first()).map_or(0, |(last, first)| last.saturating_sub(*first));
    let grows = last > first * FACTOR || held > ROOM;
    judge(NAME, if grows { Outcome::Succeeded(told) } else { Outcome::Refused(told) });
}
