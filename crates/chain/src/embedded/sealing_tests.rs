//! Both kinds of sealing on whole chains: turns, work, restarts, altered seals, what is reported to callers.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use ethers::types::transaction::eip2718::TypedTransaction;
use ethers::types::{H160, TransactionRequest};
use ethers_signers::{LocalWallet, Signer};
use k256::ecdsa::SigningKey;
use serde_json::{Value, json};

use super::Embedded;
use super::block::Header;
use super::node::Node;
use super::rpc::answer;
use super::sealing::{EXTRA, seals};
use crate::model::{Address, ErrorKind};
use crate::{ChainError, Consensus};

const BOUND: Duration = Duration::from_secs(60);

/// A chain, the nonces its searches find, and the account that sends on it.
struct Site {
    node: Node,
    nonces: Receiver<u64>,
    sender: LocalWallet,
    sent: u64,
}

fn poa(signers: u8, milliseconds: u64) -> Consensus {
    Consensus::Poa { signers, period: Duration::from_millis(milliseconds) }
}

fn raw(wallet: &LocalWallet, chain_id: u64, nonce: u64) -> Vec<u8> {
    let request = TransactionRequest::new().to(H160([1; 20])).nonce(nonce).gas(50_000).gas_price(0);
    let request: TypedTransaction = request.data(vec![1, 2]).chain_id(chain_id).into();
    request.rlp_signed(&wallet.sign_transaction_sync(&request).expect("signs")).to_vec()
}

fn try_open(directory: &Path, asked: Option<Consensus>) -> Result<Site, ChainError> {
    let (found, nonces) = channel();
    let node = Node::open(directory, asked, Arc::new(move |nonce| found.send(nonce).unwrap_or_default()))?;
    let sender = LocalWallet::from_bytes(&[7; 32]).expect("key");
    let sent = node.machine.nonce(Address(sender.address().0)).expect("reads");
    Ok(Site { node, nonces, sender, sent })
}

fn open(directory: &Path, asked: Option<Consensus>) -> Site {
    try_open(directory, asked).map_err(|error| error.to_string()).expect("opens")
}

impl Site {
    fn submit(&mut self) {
        let raw = raw(&self.sender, self.node.chain_id, self.sent);
        self.node.submit(&raw).expect("taken");
        self.sent += 1;
    }

    /// Sends a transaction and does the work of the chain's thread until it is in a block.
    fn block(&mut self) -> Header {
        self.submit();
        let (deadline, number) = (Instant::now() + BOUND, self.node.head.number);
        while self.node.head.number == number {
            assert!(Instant::now() < deadline, "no block");
            if self.node.is_mining() {
                self.node.worked(self.nonces.recv_timeout(BOUND).expect("found"));
            } else {
                std::thread::sleep(self.node.due().expect("somebody may seal"));
                self.node.assemble();
            }
        }
        self.header(number + 1)
    }

    fn header(&self, number: u64) -> Header {
        let (hash, bytes) = self.node.file.block(number).expect("reads").expect("a block");
        let header = Header::decode(&bytes).expect("header");
        assert_eq!(header.hash(), hash);
        header
    }

    fn signers(&self) -> Vec<Address> {
        self.node.sealing.addresses()
    }

    fn ask(&mut self, method: &str, parameters: Value) -> Value {
        answer(&mut self.node, method, parameters).expect("answers")
    }
}

/// Closes the chain and opens it again: everything must be as before.
fn reopen(site: Site, directory: &Path) -> Site {
    let (head, signers, consensus) = (site.node.head, site.signers(), site.node.consensus);
    let balance = |site: &Site| site.node.machine.tries.root;
    let state = balance(&site);
    drop(site);
    let site = open(directory, None);
    assert_eq!((site.node.head, site.signers(), site.node.consensus), (head, signers, consensus));
    assert_eq!(balance(&site), state);
    site
}

/// Replaces a block of a closed chain, hash and all.
fn forge(directory: &Path, number: i64, change: impl FnOnce(&mut Header)) {
    let file = rusqlite::Connection::open(directory.join("chain.db")).expect("opens");
    let select = "SELECT header FROM block WHERE number = ?1";
    let bytes: Vec<u8> = file.query_row(select, [number], |row| row.get(0)).expect("a block");
    let mut header = Header::decode(&bytes).expect("header");
    change(&mut header);
    let update = "UPDATE block SET header = ?1, hash = ?2 WHERE number = ?3";
    file.execute(update, rusqlite::params![header.encode(), header.hash().0, number]).expect("writes");
}

fn keys(directory: &Path) -> Vec<SigningKey> {
    let file = rusqlite::Connection::open(directory.join("chain.db")).expect("opens");
    let keys: Vec<u8> = file.query_row("SELECT signer FROM chain", [], |row| row.get(0)).expect("keys");
    let mut keys: Vec<SigningKey> = keys.chunks(32).map(|key| SigningKey::from_slice(key).expect("key")).collect();
    keys.sort_by_key(super::sealing::address_of);
    keys
}

fn tampered(directory: &Path, words: &str) {
    let error = try_open(directory, None).map(drop).expect_err(words);
    assert_eq!(error.kind(), ErrorKind::Tampered, "{error}");
    assert!(error.to_string().contains(words), "{error}");
}

#[test]
fn three_signers_take_turns_over_restarts() {
    let home = tempfile::tempdir().expect("folder");
    let mut site = open(home.path(), Some(poa(3, 0)));
    let genesis = site.header(0);
    let listed: Vec<u8> = site.signers().iter().flat_map(|signer| signer.0).collect();
    assert_eq!(genesis.extra.len(), 32 + 60 + 65);
    assert_eq!(genesis.extra[32..92], listed);
    assert!(site.signers().is_sorted());
    for number in 1..=9u64 {
        let header = site.block();
        let expected = site.signers()[usize::try_from(number % 3).expect("small")];
        assert_eq!((header.sealer(), header.difficulty, header.beneficiary), (Some(expected), 2, Address([0; 20])));
        let block = site.ask("eth_getBlockByNumber", json!(["latest", false]));
        assert_eq!(block["totalDifficulty"], json!(format!("{:#x}", 1 + 2 * number)));
        if number % 4 == 0 {
            site = reopen(site, home.path());
        }
    }
    assert_eq!(site.ask("clique_getSigners", json!([])).as_array().map(Vec::len), Some(3));
}

#[test]
fn the_period_shows_in_the_times_of_the_blocks() {
    let home = tempfile::tempdir().expect("folder");
    let mut site = open(home.path(), Some(poa(1, 1000)));
    let mut times = vec![site.block().timestamp];
    site = reopen(site, home.path());
    times.push(site.block().timestamp);
    site.submit();
    site.node.finish();
    assert_eq!(site.node.head.number, 2, "a block before its time is not sealed at the end either");
    drop(site);
    let mut site = open(home.path(), Some(poa(1, 1000)));
    assert_eq!(site.ask("eth_getTransactionCount", json!([address(&site), "pending"])), json!("0x2"));
    times.push(site.block().timestamp);
    assert!(times.windows(2).all(|pair| pair[1] > pair[0]), "{times:?}");
}

fn address(site: &Site) -> String {
    Address(site.sender.address().0).to_string()
}

#[test]
fn work_is_done_shown_and_checked_again() {
    let home = tempfile::tempdir().expect("folder");
    let mut site = open(home.path(), Some(Consensus::Pow { difficulty: 300 }));
    let miner = site.signers()[0];
    let mut nonces = Vec::new();
    for number in 1..=6 {
        let header = site.block();
        assert!(seals(header.work_hash(), header.nonce, 300));
        assert_eq!((header.difficulty, header.beneficiary, &header.extra[..]), (300, miner, &EXTRA[..]));
        nonces.push(header.nonce);
        if number == 3 {
            site = reopen(site, home.path());
        }
    }
    let before = nonces.len();
    nonces.dedup();
    assert_eq!(nonces.len(), before, "each block has a search of its own");
    let block = site.ask("eth_getBlockByNumber", json!(["0x6", false]));
    assert_eq!((&block["difficulty"], &block["totalDifficulty"]), (&json!("0x12c"), &json!(format!("{:#x}", 7 * 300))));
    assert_eq!(block["nonce"], json!(format!("{:#018x}", nonces[5])));
    assert_eq!(block["miner"], json!(miner.to_string().to_lowercase()));
    assert!(site.ask("web3_clientVersion", json!([])).as_str().is_some_and(|name| name.contains("not ethash")));
    assert_eq!(site.ask("eth_mining", json!([])), json!(false));
}

#[test]
fn a_search_holds_nobody_up_and_ends_with_the_chain() {
    let home = tempfile::tempdir().expect("folder");
    let endless = Consensus::Pow { difficulty: Consensus::HIGHEST_DIFFICULTY };
    let mut site = open(home.path(), Some(endless));
    site.submit();
    assert_eq!(site.node.due(), Some(Duration::ZERO));
    site.node.assemble();
    assert_eq!(site.ask("eth_mining", json!([])), json!(true));
    site.submit();
    assert_eq!(site.node.due(), None, "one search at a time");
    assert_eq!(site.ask("eth_blockNumber", json!([])), json!("0x0"));
    assert_eq!(site.ask("eth_getTransactionCount", json!([address(&site), "pending"])), json!("0x2"));
    // A nonce that shows no work is not accepted.
    site.node.worked(0);
    assert_eq!(site.node.head.number, 0);
    site.node.assemble();
    site.node.finish();
    let site = reopen(site, home.path());
    assert_eq!(site.node.head.number, 0, "what waited has to be sent again");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_last_handle_ends_a_search_and_frees_the_file() {
    let home = tempfile::tempdir().expect("folder");
    let endless = Consensus::Pow { difficulty: Consensus::HIGHEST_DIFFICULTY };
    let chain = Embedded::open(home.path().to_owned(), Some(endless)).await.expect("opens");
    assert_eq!((chain.line.consensus, chain.line.sealers.len()), (endless, 1));
    let id = chain.request("eth_chainId", Value::Null).await.expect("id");
    let id = u64::from_str_radix(id.as_str().expect("text").trim_start_matches("0x"), 16).expect("number");
    let wallet = LocalWallet::from_bytes(&[7; 32]).expect("key");
    let raw = format!("0x{}", crate::model::bytes::hex(&raw(&wallet, id, 0)));
    chain.request("eth_sendRawTransaction", json!([raw])).await.expect("taken");
    let deadline = Instant::now() + BOUND;
    while chain.request("eth_mining", Value::Null).await.expect("answers") != json!(true) {
        assert!(Instant::now() < deadline, "no search");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    drop(chain);
    // Opening waits up to 5 s for the file, which the ending chain releases.
    let chain = Embedded::open(home.path().to_owned(), Some(endless)).await.expect("opens again");
    assert_eq!(chain.line.head.borrow().number, 0);
}

#[test]
fn a_forged_seal_is_noticed() {
    let home = tempfile::tempdir().expect("folder");
    let sealed = |consensus| {
        let directory = tempfile::tempdir_in(home.path()).expect("folder");
        let mut site = open(directory.path(), Some(consensus));
        (0..4).for_each(|_| drop(site.block()));
        let nonce = site.header(4).nonce;
        (directory, nonce)
    };
    let (work, nonce) = sealed(Consensus::Pow { difficulty: 500 });
    let idle = |header: &Header| (0..1_000).find(|nonce| !seals(header.work_hash(), *nonce, 500)).expect("most");
    forge(work.path(), 4, |header| header.nonce = idle(header));
    tampered(work.path(), "its nonce does not prove the work");
    forge(work.path(), 4, |header| header.nonce = nonce);
    open(work.path(), None);
    forge(work.path(), 4, |header| (header.difficulty, header.nonce) = (1, 0));
    tampered(work.path(), "its difficulty is not that of the chain");

    let stranger = SigningKey::from_slice(&[99; 32]).expect("key");
    for signers in [1, 3] {
        let (authority, _) = sealed(poa(signers, 0));
        forge(authority.path(), 4, |header| header.seal(&stranger).expect("seals"));
        tampered(authority.path(), "not sealed by a signer");
    }
    let (authority, _) = sealed(poa(3, 0));
    let keys = keys(authority.path());
    forge(authority.path(), 4, |header| header.seal(&keys[2]).expect("seals"));
    tampered(authority.path(), "does not match its signer's turn");
    forge(authority.path(), 4, |header| {
        header.difficulty = 1;
        header.seal(&keys[1]).expect("seals");
    });
    tampered(authority.path(), "does not match its signer's turn");
    forge(authority.path(), 4, |header| {
        header.difficulty = 2;
        header.seal(&keys[1]).expect("seals");
    });
    // The signer is allowed to seal, and its seal is on the block; but the state must be what the transactions make it.
    open(authority.path(), None);
    forge(authority.path(), 4, |header| {
        header.state_root.0[0] ^= 1;
        header.seal(&keys[1]).expect("seals");
    });
    tampered(authority.path(), "gives a different block");
}

#[test]
fn the_founding_binds() {
    let home = tempfile::tempdir().expect("folder");
    drop(open(home.path(), Some(poa(3, 500))));
    for asked in [Consensus::POA, Consensus::POW, poa(3, 501), poa(2, 500)] {
        let error = try_open(home.path(), Some(asked)).map(drop).expect_err("another one");
        assert_eq!(error.kind(), ErrorKind::Input);
        assert!(error.to_string().contains("poa:3:500") && error.to_string().contains(&asked.to_string()), "{error}");
    }
    assert_eq!(open(home.path(), Some(poa(3, 500))).node.consensus, poa(3, 500));
    let change = |sql: &str| {
        let file = rusqlite::Connection::open(home.path().join("chain.db")).expect("opens");
        assert_eq!(file.execute(sql, []).expect(sql), 1);
    };
    change("UPDATE chain SET consensus = 'poa:3:400'");
    tampered(home.path(), "its consensus was changed");
    change("UPDATE chain SET consensus = 'pow:1'");
    tampered(home.path(), "keys were changed");
    change("UPDATE chain SET consensus = 'poa:3:500'");
    let unusable = try_open(&home.path().join("other"), Some(poa(0, 1))).map(drop).expect_err("no signers");
    assert_eq!(unusable.kind(), ErrorKind::Input);
}

#[test]
fn another_version_is_refused_and_the_file_is_not_touched() {
    let home = tempfile::tempdir().expect("folder");
    drop(open(home.path(), None));
    let path = home.path().join("chain.db");
    for version in [0, 2, 255] {
        let file = rusqlite::Connection::open(&path).expect("opens");
        assert_eq!(file.execute("UPDATE chain SET version = ?1", [version]).expect("writes"), 1);
        drop(file);
        let before = std::fs::read(&path).expect("read");
        let error = try_open(home.path(), None).map(drop).expect_err("another version");
        let kind = if version == 0 { ErrorKind::Tampered } else { ErrorKind::Input };
        assert_eq!(error.kind(), kind, "{error}");
        let words = if version == 0 { "which no authros writes" } else { "use a newer authros" };
        assert!(error.to_string().contains(words), "{error}");
        assert!(error.to_string().contains(&version.to_string()), "{error}");
        assert_eq!(super::check_embedded_chain(home.path()), Err(error), "and before it is opened");
        assert!(std::fs::read(&path).expect("read") == before, "it was not touched");
    }
}
