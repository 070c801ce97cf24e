//! To exhaust the disk and memory of everyone who reads the chain: two throw-away accounts, one of which grants the
//! other an envelope and revokes it, over and over.

use authros::chain::Call;
use authros::model::{Address, Identity, PublicKey, Scope, Signature, Token};
use ethers::types::H160;
use serde_json::{Value, json};

use crate::served::{Line, Served, account_of};
use crate::support::process::own_memory;
use crate::support::{Anvil, Home, Running, long, skipped, text, wait_until};
use crate::{Outcome, judge};

const NAME: &str = "grow_the_directory";
/// The attacker, and the account it grants to.
const STRANGERS: [u8; 2] = [41, 42];
/// Rounds whose transactions are sent together.
const TOGETHER: u64 = 8;
/// The gas price if gas is not free, wei.
const PRICE: u64 = 2_000_000_000;

/// How much more the last part may cost than the first.
struct Bounds {
    /// Of bytes per round, as a factor.
    factor: u64,
    /// Of memory over all rounds, MiB.
    room: u64,
}

/// If the site seals the chain itself: its trees deepen with each token, a log that is merged into its file falls into
/// one part, and it keeps its newest blocks at hand.
const SEALING: Bounds = Bounds { factor: 4, room: 64 };
/// If somebody else does: what is left is the directory, which forgets what has ended.
const READING: Bounds = Bounds { factor: 2, room: 12 };

/// Who seals the chain.
enum Sealer {
    Site(Served),
    Node { line: Line, site: Running },
}

/// The site under attack, and the contract.
struct Field {
    sealer: Sealer,
    contract: H160,
    ledger: std::path::PathBuf,
    /// The next nonce of each stranger.
    nonces: [u64; 2],
    tokens: u64,
}

impl Field {
    fn new(sealer: Sealer, home: &Home, contract: H160) -> Self {
        Self { sealer, contract, ledger: home.path().join("ledger.db"), nonces: [0; 2], tokens: 0 }
    }

    fn line(&self) -> &Line {
        match &self.sealer {
            Sealer::Site(served) => served,
            Sealer::Node { line, .. } => line,
        }
    }

    /// The process of the site.
    fn process(&self) -> u32 {
        match &self.sealer {
            Sealer::Site(served) => served.process(),
            Sealer::Node { site, .. } => site.id(),
        }
    }

    /// Both strangers register.
    fn register(&mut self) {
        for stranger in [0, 1] {
            let (token, key, proof) = (self.token(), PublicKey([9; 64]), Signature([9; 64]));
            self.calls(
                stranger,
                &[Call::Register {
                    identity: Identity { token, signing: key, envelope: key, proof },
                    envelope: Vec::new(),
                }],
            );
        }
    }

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
            let raw = self.line().signed_call(STRANGERS[stranger], nonce, self.contract, data);
            batch.push(json!({ "jsonrpc": "2.0", "id": nonce, "method": "eth_sendRawTransaction", "params": [raw] }));
            self.nonces[stranger] += 1;
        }
        let answers = self.line().post(&Value::Array(batch)).expect("answers");
        let answers = answers.as_array().expect("a batch").clone();
        assert!(answers.iter().all(|answer| answer["result"].is_string()), "{answers:?}");
        let last = &answers.last().expect("some")["result"];
        let block = wait_until(60, "a block", || self.line().block_of(last));
        for answer in &answers {
            let receipt = self.line().ask("eth_getTransactionReceipt", json!([answer["result"]])).expect("a receipt");
            assert_eq!(receipt["status"], "0x1", "{receipt}");
        }
        wait_until(60, "the site has read it", || (self.scanned() >= block).then_some(()));
    }

    /// The block up to which the site has read the chain.
    fn scanned(&self) -> u64 {
        let flags = rusqlite::OpenFlags::SQLITE_OPEN_READ_ONLY;
        let ledger = rusqlite::Connection::open_with_flags(&self.ledger, flags).expect("the ledger");
        let block = ledger.query_row("SELECT block FROM cursor", [], |row| row.get(0));
        block.map_or(0, i64::cast_unsigned)
    }

    fn rounds(&mut self, first: u64, count: u64) {
        let grantee = Address(account_of(STRANGERS[1]).0);
        for some in (first..first + count).collect::<Vec<_>>().chunks(usize::try_from(TOGETHER).expect("small")) {
            let mut calls = Vec::new();
            for epoch in some {
                let (scope, envelope) = (Scope::All, vec![7; 4_096]);
                calls.push(Call::AuthorityGrant { grantee, epoch: *epoch, expiry: None, scope, envelope });
                calls.push(Call::AuthorityRevoke { grantee, new_token: self.token(), envelope: vec![7; 4_096] });
            }
            self.calls(0, &calls);
        }
    }

    /// Bytes that the site has written so far, to files and everything else.
    fn written(&self) -> u64 {
        let counters = std::fs::read_to_string(format!("/proc/{}/io", self.process())).expect("it runs");
        let line = counters.lines().find_map(|line| line.strip_prefix("wchar:")).expect("the field");
        line.trim().parse().expect("a number")
    }

    /// Several parts with this many rounds each, and whether the last costs more than the first.
    fn judge(&mut self, name: &str, bounds: &Bounds, parts: u64, part: u64) {
        let (mut costs, mut memory) = (Vec::new(), Vec::new());
        for number in 0..parts {
            let before = self.written();
            self.rounds(1 + number * part, part);
            costs.push((self.written() - before) / part);
            memory.push(own_memory(self.process()) / 1024);
        }
        let told = format!("{} rounds: bytes written a round {costs:?}, MiB held {memory:?}", part * parts);
        let (first, last) = (costs[0], *costs.last().expect("some"));
        let held = memory.last().zip(memory.first()).map_or(0, |(last, first)| last.saturating_sub(*first));
        let grows = last > first * bounds.factor || held > bounds.room;
        judge(name, if grows { Outcome::Succeeded(told) } else { Outcome::Refused(told) });
    }
}

#[test]
fn grow_the_directory() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0"]);
    authros.enrol();
    let contract = text(&authros.json(&["chain", "status"]), "contract").parse().expect("an address");
    let mut field = Field::new(Sealer::Site(Served::start(&home)), &home, contract);
    field.register();
    let (parts, part) = if long() { (6, 1_000) } else { (3, 160) };
    field.judge(NAME, &SEALING, parts, part);
}

/// The site alone, with a chain that another process seals.
#[test]
fn grow_the_directory_of_a_site_beside_its_chain() {
    let Some(node) = Anvil::start(&[]) else { skipped!("no anvil: npm install in tests/peers") };
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "0", "--chain", &node.http()]);
    let site = authros.serve(&home);
    let contract = text(&authros.json(&["chain", "status"]), "contract").parse().expect("an address");
    for stranger in STRANGERS {
        node.fund(&format!("{:?}", account_of(stranger)));
    }
    let line = Line::to(([127, 0, 0, 1], node.port()).into(), PRICE);
    let mut field = Field::new(Sealer::Node { line, site }, &home, contract);
    field.register();
    let (parts, part) = if long() { (6, 1_000) } else { (3, 48) };
    field.judge("grow_the_directory_of_a_site_beside_its_chain", &READING, parts, part);
}
