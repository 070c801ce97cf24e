//! Proofs, Clique seals and seals of QBFT by another implementation, which shares no line with ours.

use authros_model::bytes::{hex, unhex};
use authros_model::{Address, Hash};
use serde_json::{Value, json};

use super::second::agree;
use super::world::{BLOCK, CODE, CONTRACT, TIME, World, account, genesis, ours};
use crate::archive::Members;
use crate::{BlockHeader, Flaw, Nodes, Outcome, Packing, Protocol, Standing, Unproven, seals};

#[path = "../../../../tests/support/foreign.rs"]
mod peer;

/// `None` if it is not installed, which is said.
fn asked(request: &Value) -> Option<Value> {
    match peer::foreign(request) {
        Ok(answer) => Some(answer),
        Err(why) => {
            println!("SKIPPED another implementation of proofs and seals: {why}");
            None
        }
    }
}

fn list(value: &Value) -> &[Value] {
    value.as_array().expect("a list")
}

fn bytes(value: &Value) -> Vec<u8> {
    unhex(value.as_str().and_then(|text| text.strip_prefix("0x")).expect("0x")).expect("hex")
}

fn hash(value: &Value) -> Hash {
    Hash::from_slice(&bytes(value)).expect("32 bytes")
}

fn text(bytes: &[u8]) -> String {
    format!("0x{}", hex(bytes))
}

/// Their prover, our verifier: half of the keys are there, half are not.
#[test]
fn a_thousand_proofs_of_another_implementation_show_what_it_says() {
    let Some(found) = asked(&json!({ "what": "tries", "seed": 11, "cases": 1000 })) else { return };
    let (mut present, mut absent) = (0, 0);
    for case in list(&found) {
        let (root, key) = (hash(&case["root"]), bytes(&case["key"]));
        let value = (!case["value"].is_null()).then(|| bytes(&case["value"]));
        let proof: Vec<Vec<u8>> = list(&case["proof"]).iter().map(bytes).collect();
        let nodes: Nodes = proof.iter().cloned().collect();
        assert_eq!(nodes.look_up(root, &key), Ok(value.clone()), "{case}");
        if value.is_some() {
            present += 1
        } else {
            absent += 1
        }
        // Each node of it is needed, and none may differ.
        for at in 0..proof.len() {
            let without: Nodes = proof.iter().take(at).chain(proof.iter().skip(at + 1)).cloned().collect();
            assert!(matches!(without.look_up(root, &key), Err(Unproven::Missing(_))), "{case}");
            let mut other = proof.clone();
            let place = (at * 7 + key.len()) % other[at].len();
            other[at][place] ^= 1;
            assert!(other.into_iter().collect::<Nodes>().look_up(root, &key).is_err(), "{case}");
        }
    }
    assert_eq!(present + absent, 1000);
    assert!(present >= 400 && absent >= 400, "{present} present, {absent} absent");
}

/// The world's state in their tries, below headers of a chain that their consensus accepted.
fn on_their_chain(world: &World) -> Option<(Value, Members)> {
    let signers = [1, 2, 3].map(|secret| account(secret).1);
    let mut sorted = signers;
    sorted.sort_unstable();
    let listed: String = sorted.iter().map(|signer| hex(&signer.0)).collect();
    let mut file: Value =
        serde_json::from_str(include_str!("../../../../contracts/genesis/clique.json")).expect("the template");
    file["config"]["chainId"] = 7.into();
    file["config"]["clique"]["period"] = 1.into();
    file["timestamp"] = format!("{:#x}", TIME - BLOCK).into();
    file["gasLimit"] = "0x1000000".into();
    file["extraData"] = format!("0x{}{listed}{}", "00".repeat(32), "00".repeat(65)).into();
    let trimmed = |word: &[u8; 32]| word.iter().copied().skip_while(|byte| *byte == 0).collect::<Vec<u8>>();
    let words: Vec<[String; 2]> = world.slots.iter().map(|(slot, word)| [text(slot), text(&trimmed(word))]).collect();
    let keys = [1u8, 2, 3].map(|secret| text(&[secret; 32]));
    let chain = asked(&json!({
        "what": "clique", "genesis": file, "keys": keys, "length": BLOCK + 4, "at": BLOCK,
        "contract": text(&CONTRACT.0), "code_hash": text(&CODE.0), "words": words,
    }))?;
    let mut members = world.members();
    members.retain(|name, _| !name.starts_with("chain/"));
    Some((chain, members))
}

/// With this many of its headers from the anchoring block on, and their nodes.
fn with_headers(chain: &Value, members: &Members, world: &World, count: u64) -> Members {
    let mut packing = Packing::from(members.clone());
    for header in list(&chain["headers"]) {
        let number = header["number"].as_u64().expect("a number");
        if (BLOCK..BLOCK + count).contains(&number) {
            packing.header(number, bytes(&header["rlp"]));
        }
    }
    packing.nodes(&list(&chain["nodes"]).iter().map(bytes).collect::<Nodes>());
    packing.sign(genesis(), world.owner, &world.keys, ours()).expect("packs")
}

/// Three signers in turn: each block was taken by their Clique consensus when it was put into their chain.
#[test]
fn a_clique_chain_of_another_implementation_proves_up_to_the_anchor() {
    let world = World::new();
    let Some((chain, members)) = on_their_chain(&world) else { return };
    for header in list(&chain["headers"]) {
        let parsed = BlockHeader::parse(&bytes(&header["rlp"])).expect("a header");
        assert_eq!(parsed.hash, hash(&header["hash"]));
        let sealer = parsed.sealer().expect("sealed").to_string().to_lowercase();
        assert_eq!(Some(sealer.as_str()), header["sealer"].as_str());
    }
    agree(&with_headers(&chain, &members, &world, 2), &World::trust(), Outcome::Holds);
    agree(&with_headers(&chain, &members, &world, 1), &World::trust(), Outcome::Incomplete);
    let mut strangers = World::trust();
    strangers.chain.signers = [7, 8, 9].map(|secret| account(secret).1).to_vec();
    agree(&with_headers(&chain, &members, &world, 3), &strangers, Outcome::Refused);
    let mut all = World::trust();
    all.chain.quorum = Some(3);
    let three = with_headers(&chain, &members, &world, 3);
    agree(&three, &all, Outcome::Holds);
    let bundle = crate::Bundle::of_members(&three, ours()).expect("reads");
    let report = crate::verify(&bundle, Some(&all), ours());
    let record = &report.records[0];
    assert_eq!([&record.bytes, &record.key, &record.anchor].map(|level| level.standing), [Standing::Proven; 3]);
    assert!(record.anchor.text.ends_with("sealed by 3 of 3 pinned signers"), "{}", record.anchor.text);
}

/// Headers with random validators, rounds and votes, and fields of later forks.
#[test]
fn headers_sealed_by_another_implementation_are_judged_as_it_made_them() {
    let Some(found) = asked(&json!({ "what": "committed", "seed": 3, "cases": 150 })) else { return };
    let (mut enough, mut too_few) = (0, 0);
    for case in list(&found) {
        let header = BlockHeader::parse(&bytes(&case["rlp"])).expect("a header");
        assert_eq!(header.hash, hash(&case["hash"]), "{case}");
        let addresses = |name: &str| {
            let address = |one: &Value| Address(bytes(one).try_into().expect("20 bytes"));
            list(&case[name]).iter().map(address).collect::<Vec<Address>>()
        };
        let (accounts, sealers) = (addresses("accounts"), addresses("sealers"));
        let committed = header.committed().expect("under one of the two");
        let protocol = if case["is_ibft"] == true { Protocol::Ibft2 } else { Protocol::Qbft };
        assert_eq!((committed.protocol, Some(u64::from(committed.round))), (protocol, case["round"].as_u64()));
        let (number, all) = (header.number, accounts.len());
        let judged = seals(&[(number, header)].into(), number, &accounts);
        // Two thirds, rounded up, counted by hand.
        let needed = [0, 1, 2, 2, 3, 4, 4, 5, 6, 6, 7][all];
        if case["is_kept"] == true || sealers.len() >= needed {
            enough += 1;
            assert_eq!((judged.flaw, judged.stranger), (None, None), "{case}");
            assert_eq!(judged.pinned, sealers.iter().copied().collect(), "{case}");
        } else {
            too_few += 1;
            assert_eq!(judged.flaw, Some(Flaw::TooFew { have: sealers.len(), named: all, needed }), "{case}");
        }
    }
    assert!(enough >= 30 && too_few >= 10, "{enough} with enough, {too_few} with too few");
}
