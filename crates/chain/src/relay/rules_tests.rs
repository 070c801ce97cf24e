//! The rules of what a gateway passes on to its node.

use super::*;
use crate::crypto::EoaSecret;
use crate::model::bytes::hex;
use crate::model::{Hash, PublicKey, Signature, Token};

const CONTRACT: Address = Address([0xaa; 20]);

fn pin() -> Pin {
    Pin { chain_id: 7, genesis: Hash([1; 32]), contract: CONTRACT, code_hash: Hash([2; 32]), deployed_at: 1_000 }
}

fn ask(asker: Asker, method: &str, parameters: &Value) -> Result<Passed, RelayError> {
    examine(Ground { pin: &pin(), head: 50_000 }, asker, method, parameters)
}

fn code(outcome: Result<Passed, RelayError>) -> i64 {
    match outcome {
        Err(RelayError::Answered { code, .. }) => code,
        Err(RelayError::NotAllowed) => 0,
        other => panic!("passed: {other:?}"),
    }
}

/// Fields of a legacy transaction, signed as Ethereum does it.
fn signed(to: Option<Address>, gas: u64, value: u64, chain: u64, data: &[u8]) -> Value {
    use ethers::types::transaction::eip2718::TypedTransaction;
    use ethers::types::{H160, TransactionRequest};
    use ethers_signers::{LocalWallet, Signer as _};
    let wallet = LocalWallet::from_bytes(&[0x11; 32]).expect("a key").with_chain_id(chain);
    let mut request = TransactionRequest::new().nonce(0).gas(gas).gas_price(0).value(value).chain_id(chain);
    request = request.data(data.to_vec());
    request.to = to.map(|to| H160(to.0).into());
    let typed = TypedTransaction::Legacy(request);
    let signature = wallet.sign_transaction_sync(&typed).expect("signs");
    json!([format!("0x{}", hex(&typed.rlp_signed(&signature)))])
}

fn identity() -> Identity {
    let (signing, envelope) = (PublicKey([2; 64]), PublicKey([3; 64]));
    Identity { token: Token([1; 32]), signing, envelope, proof: Signature([4; 64]) }
}

#[test]
fn a_transaction_goes_to_the_contract_or_nowhere() {
    let sender = EoaSecret::from_slice(&[0x11; 32]).expect("a key").address();
    for asker in [Asker::Visitor, Asker::Registered] {
        let send = |raw: &Value| ask(asker, "eth_sendRawTransaction", raw);
        let passed = send(&signed(Some(CONTRACT), MOST_GAS, 0, 7, &[1, 2, 3, 4]));
        assert_eq!(passed, Ok(Passed::Transaction { sender, registers: None }));
        assert_eq!(code(send(&signed(None, 4_294_967_295, 0, 7, &[0x60, 0]))), -32003, "a creation");
        assert_eq!(code(send(&signed(Some(Address([9; 20])), 100_000, 0, 7, &[]))), -32003, "a precompile");
        assert_eq!(code(send(&signed(Some(CONTRACT), MOST_GAS + 1, 0, 7, &[]))), -32003, "too much gas");
        assert_eq!(code(send(&signed(Some(CONTRACT), 21_000, 1, 7, &[]))), -32003, "with value");
        assert_eq!(code(send(&signed(Some(CONTRACT), 21_000, 0, 8, &[]))), -32000, "another chain");
        for none in [json!([]), json!(["0x"]), json!(["zz"]), json!([7]), json!(["0xf8"])] {
            assert!(code(send(&none)) < 0, "{none}");
        }
    }
}

#[test]
fn a_registration_is_told_from_every_other_call() {
    let data = Call::Register { identity: identity(), envelope: vec![5; 363] }.encode().expect("encodes");
    let registers =
        |data: &[u8]| match ask(Asker::Visitor, "eth_sendRawTransaction", &signed(Some(CONTRACT), 500_000, 0, 7, data))
        {
            Ok(Passed::Transaction { registers, .. }) => registers,
            other => panic!("{other:?}"),
        };
    assert_eq!(registers(&data), Some(Box::new(identity())));
    for length in [0, 1, 32, 4_096] {
        let with = Call::Register { identity: identity(), envelope: vec![6; length] }.encode().expect("encodes");
        assert_eq!(registers(&with), Some(Box::new(identity())), "an envelope of {length} bytes");
    }
    let rotation = Call::RotateKeys { identity: identity(), envelope: Vec::new() }.encode().expect("encodes");
    let (longer, shorter) = ([&data[..], &[0]].concat(), &data[..data.len() - 1]);
    for other in [&rotation[..], &longer, shorter, &[], &data[..4]] {
        assert_eq!(registers(other), None);
    }
    let mut call = json!({ "from": Address([5; 20]).to_string(), "to": CONTRACT.to_string(), "data": format!("0x{}", hex(&data)) });
    let Ok(Passed::Estimate { from, registers }) = ask(Asker::Visitor, "eth_estimateGas", &json!([call])) else {
        panic!("passes")
    };
    assert_eq!((from, registers), (Some(Address([5; 20])), Some(Box::new(identity()))));
    call["to"] = json!(Address([6; 20]).to_string());
    assert_eq!(code(ask(Asker::Registered, "eth_estimateGas", &json!([call]))), -32602);
    assert_eq!(code(ask(Asker::Registered, "eth_estimateGas", &json!([{ "data": "0x60" }]))), -32602, "a creation");
}

#[test]
fn calls_are_of_the_contract_and_change_nothing_of_its_state() {
    let call = |extra: Value| {
        let mut call = json!({ "to": CONTRACT.to_string(), "data": "0x01020304" });
        for (key, value) in extra.as_object().expect("fields") {
            call[key] = value.clone();
        }
        call
    };
    let plain = json!([call(json!({})), "latest"]);
    assert_eq!(ask(Asker::Visitor, "eth_call", &plain), Ok(Passed::Read(plain.clone())));
    let long = format!("0x{}", "00".repeat(LONGEST_DATA + 1));
    for wrong in [
        json!([call(json!({ "to": Address([9; 20]).to_string() })), "latest"]),
        json!([call(json!({ "value": "0x1" })), "latest"]),
        json!([call(json!({ "input": "0x01" })), "latest"]),
        json!([call(json!({ "data": long })), "latest"]),
        json!([call(json!({})), "latest", { CONTRACT.to_string(): { "code": "0x00" } }]),
        json!([{ "data": "0x00" }, "latest"]),
        json!([]),
    ] {
        for asker in [Asker::Visitor, Asker::Registered] {
            assert_eq!(code(ask(asker, "eth_call", &wrong)), -32602, "{asker:?}");
        }
    }
}

#[test]
fn logs_come_in_portions_and_never_from_before_the_contract() {
    let filter = |from: &str, to: &str| json!([{ "address": CONTRACT.to_string(), "fromBlock": from, "toBlock": to }]);
    let visit = |from: &str, to: &str| ask(Asker::Visitor, "eth_getLogs", &filter(from, to));
    // What clients request: 2,000 blocks at once.
    assert_eq!(visit("0x3e8", "0xbb7"), Ok(Passed::Read(filter("0x3e8", "0xbb7"))));
    assert_eq!(visit("0x0", "0x7cf"), Ok(Passed::Read(filter("0x3e8", "0x7cf"))));
    assert_eq!(visit("0x0", "0x3e7"), Ok(Passed::NoLogs));
    let above = filter("0xc351", "0xc360");
    assert_eq!(visit("0xc351", "0xc360"), Ok(Passed::Read(above)), "the chain may be further than was seen");
    assert_eq!(visit("0xc350", "latest"), Ok(Passed::Read(filter("0xc350", "latest"))));
    assert_eq!(visit("latest", "latest"), Ok(Passed::Read(filter("latest", "latest"))));
    assert_eq!(code(visit("0xc350", "0xffffffffffffffff")), -32005);
    assert_eq!(code(visit("0x3e8", "0xbb8")), -32005);
    // Where the contract began: refused, so the client reads from the first block.
    assert_eq!(code(visit("0x0", "latest")), -32005);
    assert!(ask(Asker::Registered, "eth_getLogs", &filter("0x3e8", "0x2af7")).is_ok(), "10,000 for registered callers");
    assert_eq!(code(ask(Asker::Registered, "eth_getLogs", &filter("0x3e8", "0x2af8"))), -32005);
    for (from, to) in [("x", "0x1"), ("0x1", "7"), ("0xg", "latest")] {
        assert_eq!(code(visit(from, to)), -32602, "{from} {to}");
    }
    let elsewhere = json!([{ "fromBlock": "0xc350" }]);
    assert_eq!(code(ask(Asker::Registered, "eth_getLogs", &elsewhere)), -32602, "of every contract");
}

#[test]
fn a_visitor_gets_no_proofs_no_history_of_fees_and_no_whole_blocks() {
    let proof = json!([CONTRACT.to_string(), [], "latest"]);
    assert_eq!(code(ask(Asker::Visitor, "eth_getProof", &proof)), 0);
    assert!(ask(Asker::Registered, "eth_getProof", &proof).is_ok());
    assert_eq!(
        code(ask(Asker::Registered, "eth_getProof", &json!([CONTRACT.to_string(), vec!["0x0"; 65], "latest"]))),
        -32602
    );
    assert_eq!(code(ask(Asker::Visitor, "eth_feeHistory", &json!(["0x400", "latest", []]))), 0);
    assert_eq!(code(ask(Asker::Visitor, "eth_getBlockByNumber", &json!(["latest", true]))), -32602);
    assert!(ask(Asker::Visitor, "eth_getBlockByNumber", &json!(["latest", false])).is_ok());
    assert!(ask(Asker::Registered, "eth_getBlockByNumber", &json!(["latest", true])).is_ok());
}
