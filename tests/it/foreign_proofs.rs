//! Another implementation reads the chain's part of a bundle: header, account, storage, from the proofs of the embedded
//! chain's `eth_getProof`.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::evidence::{Exported, export, unzipped};
use crate::support::{skipped, system_program};

use authros::crypto::{ProviderName, provider};
use authros::evidence::{AnchorClaim, Anchoring, BlockHeader, Bundle, Slot, Trust};
use authros::model::bytes::{hex, unhex};
use authros::model::{Address, Hash};
use serde_json::{Value, json};

#[path = "../support/foreign.rs"]
mod peer;

fn text(bytes: &[u8]) -> String {
    format!("0x{}", hex(bytes))
}

/// A number of eight bytes, this many bytes from the low end of a word.
fn number(word: &Value, offset: usize) -> u64 {
    let bytes = unhex(word.as_str().and_then(|text| text.strip_prefix("0x")).expect("a word")).expect("hex");
    let all = [vec![0; 32 - bytes.len()], bytes].concat();
    u64::from_be_bytes(all[24 - offset..32 - offset].try_into().expect("eight bytes"))
}

/// As @ethereumjs reads them: the block's hash, who sealed it (it is in Clique's form), the contract's code, and for each
/// record its anchor's block and leaves.
#[test]
fn another_implementation_reads_the_same_anchors_from_a_bundle() {
    if system_program("python3").is_none() {
        skipped!("no python3");
    }
    let Exported { home: _home, bundle, trust, .. } = export();
    let read = Bundle::read(&bundle, provider(ProviderName::default())).expect("reads");
    let pins = Trust::parse(&std::fs::read(&trust).expect("read")).expect("pins");
    let claims: Vec<&AnchorClaim> = read.records.values().filter_map(|record| record.anchor.as_ref()).collect();
    assert!(claims.len() >= 3, "{} anchors", claims.len());
    for claim in claims {
        let Anchoring::Batch { account, root, count, .. } = &claim.anchor else { panic!("a batch: {claim:?}") };
        let header = unzipped(&bundle, &format!("chain/{}.rlp", claim.shown_at));
        let slots = [Slot::anchor(*account, *root), Slot::account(*account), Slot::keys(*account, claim.keys)];
        let request = json!({
            "what": "words", "genesis": genesis(&pins.chain.signers), "header": text(&header),
            "nodes": text(&unzipped(&bundle, "chain/nodes.rlp")), "contract": text(&pins.chain.contract.0),
            "slots": slots.map(|slot| text(&slot.0)),
        });
        let theirs = match peer::foreign(&request) {
            Ok(answer) => answer,
            Err(why) => skipped!(why),
        };
        let ours = BlockHeader::parse(&header).expect("a header");
        assert_eq!(theirs["hash"], text(&ours.hash.0));
        assert_eq!(theirs["sealer"], text(&ours.sealer().expect("sealed").0));
        assert_eq!(theirs["code_hash"], text(&pins.chain.code_hash.0));
        let word = &theirs["words"][0];
        assert_eq!((number(word, 0), number(word, 8)), (claim.block, *count), "{theirs}");
        let identity = theirs["words"][2].as_str().expect("a hash").trim_start_matches("0x").to_owned();
        let is_it = |hash: &Hash| hex(&hash.0) == format!("{identity:0>64}");
        assert!(read.identities.keys().any(is_it), "{theirs}");
    }
}

/// What their library wants to know of a chain: that it is one of proof of authority, by these signers.
fn genesis(signers: &[Address]) -> Value {
    let template = concat!(env!("CARGO_MANIFEST_DIR"), "/contracts/genesis/clique.json");
    let mut file: Value = serde_json::from_slice(&std::fs::read(template).expect("read")).expect("JSON");
    let listed: String = signers.iter().map(|signer| hex(&signer.0)).collect();
    file["config"]["chainId"] = 1337.into();
    file["config"]["clique"]["period"] = 1.into();
    file["extraData"] = format!("0x{}{listed}{}", "00".repeat(32), "00".repeat(65)).into();
    file
}
