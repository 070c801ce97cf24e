//! How long it takes to open a chain that has grown old.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use ethers::types::transaction::eip2718::TypedTransaction;
use ethers::types::{H160, TransactionRequest};
use ethers_signers::{LocalWallet, Signer};

use super::node::Node;
use crate::Call;
use crate::call::artefact;
use crate::model::{Address, Hash, Identity, PublicKey, Signature, Token};
use crate::transaction::created_address;

/// One block in this many anchors.
const ANCHOR_EVERY: u64 = 20;

struct Writer {
    node: Node,
    wallet: LocalWallet,
    sent: u64,
}

impl Writer {
    fn open(directory: &Path) -> Self {
        let node = Node::open(directory, None, Arc::new(|_| ())).map_err(|error| error.to_string()).expect("opens");
        node.file.in_a_hurry();
        Self { node, wallet: LocalWallet::from_bytes(&[7; 32]).expect("key"), sent: 0 }
    }

    fn block(&mut self, to: Option<Address>, input: Vec<u8>) {
        let request = TransactionRequest::new().nonce(self.sent).gas(9_000_000).gas_price(0).data(input);
        let mut request = request.chain_id(self.node.chain_id);
        request.to = to.map(|to| H160(to.0).into());
        let request: TypedTransaction = request.into();
        let signature = self.wallet.sign_transaction_sync(&request).expect("signs");
        self.node.submit(&request.rlp_signed(&signature)).expect("taken");
        self.sent += 1;
        self.node.assemble();
    }
}

/// A chain of this many blocks with an anchor in every twentieth.
fn grown(directory: &Path, blocks: u64) {
    let mut writer = Writer::open(directory);
    let contract = created_address(Address(writer.wallet.address().0), 0);
    writer.block(None, artefact().expect("artefact").creation(true, 86_400).expect("code"));
    let (signing, envelope) = (PublicKey([1; 64]), PublicKey([2; 64]));
    let identity = Identity { token: Token([1; 32]), signing, envelope, proof: Signature([3; 64]) };
    writer.block(Some(contract), Call::Register { identity, envelope: Vec::new() }.encode().expect("encodes"));
    let root = |number: u64| {
        let mut root = [1; 32];
        root[..8].copy_from_slice(&number.to_be_bytes());
        Hash(root)
    };
    let mut previous = Hash([0; 32]);
    while writer.node.head.number < blocks {
        let number = writer.node.head.number + 1;
        if number.is_multiple_of(ANCHOR_EVERY) {
            let anchor = Call::Anchor { root: root(number), count: 5, previous };
            writer.block(Some(contract), anchor.encode().expect("encodes"));
            previous = root(number);
        } else {
            writer.block(Some(Address([1; 20])), Vec::new());
        }
    }
}

/// How often each chain is opened: one opening takes a few milliseconds, which a busy machine can multiply.
const OPENINGS: usize = 40;

fn opening(directory: &Path) -> Duration {
    let begun = Instant::now();
    drop(Node::open(directory, None, Arc::new(|_| ())).map_err(|error| error.to_string()).expect("opens"));
    begun.elapsed()
}

/// The median of each chain's openings. They take turns, so that other load on the machine affects all of them.
fn medians(directories: &[&Path]) -> Vec<Duration> {
    let mut times = vec![Vec::new(); directories.len()];
    for _ in 0..OPENINGS {
        for (times, directory) in times.iter_mut().zip(directories) {
            times.push(opening(directory));
        }
    }
    let median = |times: &mut Vec<Duration>| {
        times.sort_unstable();
        times[times.len() / 2]
    };
    times.iter_mut().map(median).collect()
}

/// `cargo test --lib old_chain -- --ignored --nocapture`; `AUTHROS_CHAIN_BLOCKS` sets the number of blocks.
#[test]
#[allow(clippy::print_stdout, reason = "a measurement")]
fn an_old_chain_opens_as_fast_as_a_young_one() {
    if std::env::var_os("AUTHROS_LONG").is_none() {
        return; // It writes 200,000 blocks: `tests/run --long`.
    }
    let asked = std::env::var("AUTHROS_CHAIN_BLOCKS").ok().and_then(|blocks| blocks.parse().ok());
    let ages: [u64; 2] = [200, asked.unwrap_or(200_000)];
    let homes = ages.map(|blocks| {
        let home = tempfile::tempdir().expect("folder");
        grown(home.path(), blocks);
        home
    });
    let times = medians(&homes.each_ref().map(tempfile::TempDir::path));
    for ((blocks, home), time) in ages.iter().zip(&homes).zip(&times) {
        let length = home.path().join("chain.db").metadata().expect("a file").len();
        println!("{blocks} blocks, {} anchors, {length} bytes: opened in {time:?}", blocks / ANCHOR_EVERY);
    }
    assert!(times[1] <= times[0] * 2, "medians of {OPENINGS}: {times:?}");
}
