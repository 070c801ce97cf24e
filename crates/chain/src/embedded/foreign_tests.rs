//! The proofs of `eth_getProof` for random slots and accounts, and transactions, checked by other implementations.

use std::collections::BTreeMap;

use ethers::types::U256;
use ethers::utils::rlp::{self, RlpStream};
use ethers_signers::Signer;
use serde_json::{Value, json};

use super::state_tests::{Site, open};
use crate::model::Address;
use crate::model::bytes::{hex, unhex};

#[path = "../../../../tests/support/foreign.rs"]
mod peer;

/// SSTORE(calldata\[i\], calldata\[i + 32\]) for every pair of words.
const FILLER: &str = "60005b8036111560185780602001358135556040016002565b00";

/// Random draws from a seed.
struct Draws(u64);

impl Draws {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        self.0 >> 33
    }

    fn bytes<const N: usize>(&mut self) -> [u8; N] {
        std::array::from_fn(|_| self.next().to_be_bytes()[7])
    }
}

fn bytes(value: &Value) -> Vec<u8> {
    let digits = value.as_str().and_then(|text| text.strip_prefix("0x")).expect("0x");
    unhex(&format!("{}{digits}", "0".repeat(digits.len() % 2))).expect("hex")
}

/// A number in RLP.
fn number(value: &Value) -> Vec<u8> {
    rlp::encode(&U256::from_big_endian(&bytes(value))).to_vec()
}

/// What proofs are said to show, beside each: the value in the trie, `None` where there is none.
type Shown = Vec<(Value, Option<Vec<u8>>)>;

fn accounts(site: &mut Site, those: &[Address], root: &Value, shown: &mut Shown) {
    for account in those {
        let proof = site.ask("eth_getProof", json!([account.to_string(), [], "latest"])).expect("proven");
        let exists = proof["nonce"] != "0x0" || proof["codeHash"] != codeless();
        let value = exists.then(|| {
            let mut list = RlpStream::new_list(4);
            list.append_raw(&number(&proof["nonce"]), 1).append_raw(&number(&proof["balance"]), 1);
            list.append(&bytes(&proof["storageHash"])).append(&bytes(&proof["codeHash"]));
            list.out().to_vec()
        });
        let key = format!("0x{}", hex(&account.0));
        shown.push((json!({ "root": root, "key": key, "proof": proof["accountProof"] }), value));
    }
}

fn codeless() -> Value {
    format!("0x{}", hex(&ethers::utils::keccak256([]))).into()
}

fn slots(site: &mut Site, contract: Address, those: &BTreeMap<[u8; 32], Option<Vec<u8>>>, shown: &mut Shown) {
    let all: Vec<String> = those.keys().map(|slot| format!("0x{}", hex(slot))).collect();
    let mut expected = those.values();
    for some in all.chunks(200) {
        let answer = site.ask("eth_getProof", json!([contract.to_string(), some, "latest"])).expect("proven");
        for (slot, proof) in some.iter().zip(answer["storageProof"].as_array().expect("proofs")) {
            let value = expected.next().expect("as many").as_ref().map(|value| rlp::encode(value).to_vec());
            let said = U256::from_big_endian(&bytes(&proof["value"]));
            assert_eq!(rlp::encode(&said).to_vec(), value.clone().unwrap_or_else(|| vec![0x80]));
            shown.push((json!({ "root": answer["storageHash"], "key": slot, "proof": proof["proof"] }), value));
        }
    }
}

/// Our prover, their verifier: 500 slots that were set, 500 that were not, 20 accounts; and each proof once more with a
/// bit of one of its nodes flipped.
#[test]
fn another_implementation_accepts_every_proof_and_no_altered_one() {
    let home = tempfile::tempdir().expect("folder");
    let mut site = open(home.path());
    let contract = site.deployed(FILLER);
    let mut draws = Draws(5);
    let mut those: BTreeMap<[u8; 32], Option<Vec<u8>>> = BTreeMap::new();
    for _ in 0..5 {
        let mut input = Vec::new();
        for _ in 0..50 {
            for length in [1 + usize::try_from(draws.next() % 32).expect("small"), 32] {
                let (slot, mut value) = (draws.bytes::<32>(), draws.bytes::<32>());
                value[32 - length] |= 1;
                value[..32 - length].fill(0);
                input.extend([slot, value].concat());
                those.insert(slot, Some(value[32 - length..].to_vec()));
            }
        }
        // A transaction's gas here is enough for eighty slots.
        for some in input.chunks(64 * 50) {
            site.block(Some(contract), some.to_vec());
        }
    }
    assert_eq!(those.len(), 500);
    while those.len() < 1000 {
        those.insert(draws.bytes(), None);
    }
    let header = site.ask("eth_getBlockByNumber", json!(["latest", false])).expect("a block");
    let mut shown = Shown::new();
    let wallet = Address(site.wallet.address().0);
    let strangers: Vec<Address> = (0..18).map(|_| Address(draws.bytes())).collect();
    slots(&mut site, contract, &those, &mut shown);
    accounts(&mut site, &[&[contract, wallet][..], &strangers].concat(), &header["stateRoot"], &mut shown);
    let altered: Vec<Value> = shown.iter().map(|(proof, _)| flipped(proof, &mut draws)).collect();
    let proofs: Vec<&Value> = shown.iter().map(|(proof, _)| proof).chain(&altered).collect();
    let answers = match peer::foreign(&json!({ "what": "verify", "proofs": proofs })) {
        Ok(answers) => answers,
        Err(why) => {
            println!("SKIPPED another implementation of proofs: {why}");
            return;
        }
    };
    let (taken, refused) = answers.as_array().expect("answers").split_at(shown.len());
    for ((proof, value), answer) in shown.iter().zip(taken) {
        let said = (!answer["value"].is_null()).then(|| bytes(&answer["value"]));
        assert!(answer.get("error").is_none(), "{answer}: {proof}");
        assert_eq!(said, *value, "{proof}");
    }
    assert_eq!(refused.len(), shown.len());
    assert!(refused.iter().all(|answer| answer["error"].is_string()), "an altered proof was taken");
    assert_eq!(shown.iter().filter(|(_, value)| value.is_some()).count(), 502);
}

/// With one bit of one of its nodes flipped.
fn flipped(proof: &Value, draws: &mut Draws) -> Value {
    let mut other = proof.clone();
    let nodes = other["proof"].as_array_mut().expect("nodes");
    let place = usize::try_from(draws.next()).expect("small") % nodes.len();
    let mut node = bytes(&nodes[place]);
    let at = usize::try_from(draws.next()).expect("small") % node.len();
    node[at] ^= 1 << (draws.next() % 8);
    nodes[place] = format!("0x{}", hex(&node)).into();
    other
}

/// Their signatures in our blocks, and ours (by ethers) as eth-account reads what the chain lists: hashes and senders agree.
#[test]
fn another_implementation_agrees_on_hashes_and_senders_of_transactions() {
    let home = tempfile::tempdir().expect("folder");
    let mut site = open(home.path());
    let mut draws = Draws(9);
    let contract = site.deployed(FILLER);
    let chain_id =
        u64::from_str_radix(&site.ask("eth_chainId", json!([])).expect("told").as_str().expect("text")[2..], 16);
    let chain_id = chain_id.expect("a number");
    let unsigned: Vec<Value> = (0..30)
        .map(|count| {
            let length = usize::try_from(draws.next() % 200).expect("small");
            let input: Vec<u8> = (0..length).map(|_| draws.bytes::<1>()[0]).collect();
            let mut one = json!({
                "secret": format!("0x{}", hex(&[11 + count % 3; 32])), "nonce": count / 3, "gas": 200_000, "gasPrice": 0,
                "chainId": chain_id, "value": 0, "data": format!("0x{}", hex(&input)),
            });
            if count % 2 == 0 {
                one["to"] = checksummed(contract).into();
            }
            one
        })
        .collect();
    let theirs = match peer::accounts(&json!({ "what": "sign", "transactions": unsigned })) {
        Ok(theirs) => theirs,
        Err(why) => {
            println!("SKIPPED another implementation of transactions: {why}");
            return;
        }
    };
    for one in theirs.as_array().expect("a list") {
        assert_eq!(site.ask("eth_sendRawTransaction", json!([one["raw"]])).expect("accepted"), one["hash"]);
    }
    site.assembled();
    let ours = site.ask("eth_getBlockByNumber", json!(["0x1", true])).expect("a block")["transactions"].clone();
    let mut listed: Vec<Value> = ours.as_array().expect("a list").clone();
    assert_eq!(listed.len(), 1, "ours, by ethers");
    for one in theirs.as_array().expect("a list") {
        let sent = site.ask("eth_getTransactionByHash", json!([one["hash"]])).expect("known");
        let receipt = site.ask("eth_getTransactionReceipt", json!([one["hash"]])).expect("mined");
        assert_eq!((&sent["from"], &receipt["from"]), (&one["account"], &one["account"]), "{sent}");
        listed.push(sent);
    }
    let read = peer::accounts(&json!({ "what": "read", "transactions": listed })).expect("asked before");
    let read = read.as_array().expect("a list");
    assert_eq!(read.len(), 31);
    for (listed, read) in listed.iter().zip(read) {
        assert_eq!((&listed["hash"], &listed["from"]), (&read["hash"], &read["account"]));
    }
}

/// As EIP-55 writes it: eth-account accepts no other spelling.
fn checksummed(account: Address) -> String {
    ethers::utils::to_checksum(&ethers::types::H160(account.0), None)
}
