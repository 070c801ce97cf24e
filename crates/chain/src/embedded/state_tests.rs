//! The state as tries on whole chains: altered nodes are named, old ones are pruned, proofs verify.

use std::path::Path;
use std::sync::Arc;

use ethers::types::transaction::eip2718::TypedTransaction;
use ethers::types::{H160, TransactionRequest, U256};
use ethers::utils::keccak256;
use ethers_signers::{LocalWallet, Signer};
use rusqlite::{Connection, params};
use serde_json::{Value, json};
use tokio::sync::oneshot;

use super::node::Node;
use super::rpc::answer;
use super::trie::EMPTY_ROOT;
use super::world::KEPT;
use crate::ChainError;
use crate::model::{Address, ErrorKind, Hash};
use crate::transaction::created_address;
use crate::transport::TransportError;

/// SSTORE(calldata\[0\], calldata\[32\]) and LOG0; any call with a third word destroys the contract.
const KEEPER: &str = "6040356013576020356000355560006000a0005b33ff";

/// A chain with an account that writes to it.
pub(super) struct Site {
    node: Node,
    pub wallet: LocalWallet,
    sent: u64,
}

fn try_open(directory: &Path) -> Result<Node, ChainError> {
    Node::open(directory, None, Arc::new(|_| ()))
}

pub(super) fn open(directory: &Path) -> Site {
    let node = try_open(directory).map_err(|error| error.to_string()).expect("opens");
    let wallet = LocalWallet::from_bytes(&[7; 32]).expect("key");
    let sent = node.machine.nonce(Address(wallet.address().0)).expect("reads");
    Site { node, wallet, sent }
}

fn file(directory: &Path) -> Connection {
    Connection::open(directory.join("chain.db")).expect("opens")
}

fn words(values: &[u64]) -> Vec<u8> {
    let word = |value: &u64| {
        let mut word = [0; 32];
        U256::from(*value).to_big_endian(&mut word);
        word
    };
    values.iter().flat_map(word).collect()
}

impl Site {
    /// Sends a transaction and mines it in the next block.
    pub fn block(&mut self, to: Option<Address>, input: Vec<u8>) {
        let request = TransactionRequest::new().nonce(self.sent).gas(2_000_000).gas_price(0).data(input);
        let mut request = request.chain_id(self.node.chain_id);
        request.to = to.map(|to| H160(to.0).into());
        let request: TypedTransaction = request.into();
        let signature = self.wallet.sign_transaction_sync(&request).expect("signs");
        self.node.submit(&request.rlp_signed(&signature)).expect("taken");
        self.sent += 1;
        self.assembled();
    }

    /// Mines a block of what was sent.
    pub fn assembled(&mut self) {
        let number = self.node.head.number;
        self.node.assemble();
        assert_eq!(self.node.head.number, number + 1, "{:?}", self.node.trouble);
    }

    /// Deploys [`KEEPER`].
    fn keeper(&mut self) -> Address {
        self.deployed(KEEPER)
    }

    /// Deploys a contract, from its runtime code.
    pub fn deployed(&mut self, runtime: &str) -> Address {
        let runtime = crate::model::bytes::unhex(runtime).expect("hex");
        let length = u8::try_from(runtime.len()).expect("short");
        let creation = [0x60, length, 0x60, 12, 0x60, 0, 0x39, 0x60, length, 0x60, 0, 0xf3];
        let contract = created_address(Address(self.wallet.address().0), self.sent);
        self.block(None, [&creation[..], &runtime].concat());
        contract
    }

    pub fn ask(&mut self, method: &str, parameters: Value) -> Result<Value, TransportError> {
        answer(&mut self.node, method, parameters)
    }

    fn audit(&mut self) -> Result<u64, ChainError> {
        let (reply, mut heard) = oneshot::channel();
        self.node.begin_audit(reply);
        loop {
            self.node.go_on_auditing();
            if let Ok(answer) = heard.try_recv() {
                return answer;
            }
        }
    }
}

/// Checks a proof as EIP-1186 says, by hashes alone: each node is named by the one before.
fn proves(root: &Value, way: &Value) -> bool {
    let bytes = |value: &Value| crate::model::bytes::unhex(&value.as_str().expect("hex")[2..]).expect("hex");
    let mut wanted = bytes(root);
    for node in way.as_array().expect("nodes") {
        let node = bytes(node);
        if !wanted.windows(32).any(|window| window == keccak256(&node)) {
            return false;
        }
        wanted = node;
    }
    true
}

#[test]
fn proofs_hold_for_the_last_blocks_and_older_nodes_are_gone() {
    let home = tempfile::tempdir().expect("folder");
    let mut site = open(home.path());
    let contract = site.keeper();
    let place = contract.to_string();
    let blocks = KEPT + 40;
    for number in 1..=blocks {
        site.block(Some(contract), words(&[number % 50, number]));
    }
    let newest = site.node.head.number;
    for number in [newest, newest - 5, newest + 1 - KEPT] {
        let block = format!("{number:#x}");
        let slot = (number - 1) % 50;
        let proof = site.ask("eth_getProof", json!([place, [format!("{slot:#x}")], block])).expect("proven");
        let header = site.ask("eth_getBlockByNumber", json!([block, false])).expect("a block");
        assert!(proves(&header["stateRoot"], &proof["accountProof"]), "{number}");
        assert!(proves(&proof["storageHash"], &proof["storageProof"][0]["proof"]), "{number}");
        assert_eq!(proof["storageProof"][0]["value"], json!(format!("{:#x}", number - 1)));
        assert_eq!(proof["nonce"], json!("0x1"));
    }
    let early = site.ask("eth_getProof", json!([place, [], format!("{:#x}", newest - KEPT)])).expect_err("pruned");
    assert!(early.to_string().contains("is not kept"), "{early}");
    let absent = site.ask("eth_getProof", json!([Address([9; 20]).to_string(), ["0x0"], "latest"])).expect("proven");
    assert_eq!((&absent["balance"], &absent["storageProof"][0]["value"]), (&json!("0x0"), &json!("0x0")));
    assert_eq!(absent["storageHash"], json!(EMPTY_ROOT.to_string()));
    // No more nodes than the kept states can have: each block makes at most a handful.
    let nodes = |site: &Site| site.node.file.all_nodes().expect("reads").len();
    let before = nodes(&site);
    for number in 0..100 {
        site.block(Some(contract), words(&[number % 50, 7_000 + number]));
    }
    let after = nodes(&site);
    assert!(after <= before + 20, "{before} nodes became {after}");
    assert_eq!(site.audit(), Ok(site.node.head.number));
}

#[test]
fn storage_of_a_gone_contract_goes_too() {
    let home = tempfile::tempdir().expect("folder");
    let mut site = open(home.path());
    let contract = site.keeper();
    for number in 1..=60 {
        site.block(Some(contract), words(&[number, number]));
    }
    let proof = site.ask("eth_getProof", json!([contract.to_string(), ["0x5"], "latest"])).expect("proven");
    let storage: Hash = proof["storageHash"].as_str().and_then(|text| text.parse().ok()).expect("a hash");
    assert_eq!(site.node.file.look_at(storage, false), Ok(()));
    site.block(Some(contract), words(&[0, 0, 1]));
    assert_eq!(site.ask("eth_getCode", json!([contract.to_string(), "latest"])), Ok(json!("0x")));
    let slot = site.ask("eth_getStorageAt", json!([contract.to_string(), "0x5", "latest"])).expect("reads");
    assert_eq!(slot, json!(Hash([0; 32]).to_string()));
    for _ in 0..KEPT + 10 {
        site.block(Some(Address([1; 20])), Vec::new());
    }
    assert!(site.node.file.look_at(storage, false).is_err());
    // Only what the kept states need is left: two nodes of the account trie for each block, and the newest state.
    let left = site.node.file.all_nodes().expect("reads").len();
    assert!(left < 3 * 140, "{left} nodes");
    let directory = home.path().to_owned();
    assert_eq!(site.audit(), Ok(site.node.head.number));
    drop(site);
    let counted: i64 = file(&directory).query_row("SELECT count(*) FROM doomed", [], |row| row.get(0)).expect("counts");
    assert_eq!(counted, 0);
}

#[test]
fn a_flipped_node_is_named_when_it_is_read() {
    let home = tempfile::tempdir().expect("folder");
    let mut site = open(home.path());
    let contract = site.keeper();
    for number in 1..=20 {
        site.block(Some(contract), words(&[number, number]));
    }
    let proof = site.ask("eth_getProof", json!([contract.to_string(), ["0x5"], "latest"])).expect("proven");
    let way = proof["storageProof"][0]["proof"].as_array().expect("nodes").clone();
    let leaf = crate::model::bytes::unhex(&way.last().and_then(Value::as_str).expect("hex")[2..]).expect("hex");
    let hash = Hash(keccak256(&leaf));
    drop(site);
    let mut flipped = leaf.clone();
    *flipped.last_mut().expect("bytes") ^= 1;
    let change = |body: &[u8]| {
        let update = "UPDATE node SET body = ?1 WHERE hash = ?2";
        assert_eq!(file(home.path()).execute(update, params![body, hash.0]).expect("writes"), 1);
    };
    change(&flipped);
    let mut site = open(home.path());
    let answer = site.ask("eth_getStorageAt", json!([contract.to_string(), "0x5", "latest"]));
    let Err(TransportError::Chain(cause)) = answer else { panic!("the chain's own error") };
    assert_eq!(cause.kind(), ErrorKind::Tampered);
    assert!(cause.to_string().contains(&hash.to_string()), "{cause}");
    assert_eq!(site.audit().expect_err("found").kind(), ErrorKind::Tampered);
    // Whatever does not need it continues.
    site.block(Some(contract), words(&[77, 1]));
    drop(site);
    change(&leaf);
    let mut site = open(home.path());
    assert_eq!(site.audit(), Ok(site.node.head.number));
}

#[test]
fn an_altered_block_is_named_when_it_is_read_and_by_an_audit() {
    let home = tempfile::tempdir().expect("folder");
    let mut site = open(home.path());
    let contract = site.keeper();
    (1..=6).for_each(|number| site.block(Some(contract), words(&[number, number])));
    let hash = site.ask("eth_getBlockByNumber", json!(["0x3", false])).expect("a block")["transactions"][0].clone();
    drop(site);
    for (alter, restore) in [
        ("UPDATE sent SET receipt = X'CA018252288252288080C0' WHERE block = 3", "receipt"),
        ("UPDATE sent SET raw = (SELECT raw FROM sent WHERE block = 4) WHERE block = 3", "raw"),
    ] {
        let select = format!("SELECT {restore} FROM sent WHERE block = 3");
        let before: Vec<u8> = file(home.path()).query_row(&select, [], |row| row.get(0)).expect("reads");
        file(home.path()).execute(alter, []).expect("alters");
        let mut site = open(home.path());
        let answer = site.ask("eth_getTransactionReceipt", json!([hash]));
        let Err(TransportError::Chain(cause)) = answer else { panic!("{alter}: the chain's own error") };
        assert_eq!(cause.kind(), ErrorKind::Tampered, "{alter}");
        assert!(site.audit().expect_err(alter).to_string().contains("at block 3"));
        drop(site);
        let update = format!("UPDATE sent SET {restore} = ?1 WHERE block = 3");
        file(home.path()).execute(&update, [before]).expect("restores");
    }
    let mut site = open(home.path());
    assert_eq!(site.audit(), Ok(7));
}
