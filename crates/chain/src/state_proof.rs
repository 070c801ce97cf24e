//! What an evidence bundle needs from a chain: block headers as they were hashed, and proofs of the contract's storage.

use serde_json::{Value, json};

use crate::model::{Address, Hash, bytes::unhex};
use crate::{Chain, ChainError, transaction::List};
use authros_evidence::{BlockHeader, Slot};

/// Slots per request; nodes limit it.
const MOST_SLOTS: usize = 32;
/// Bytes, generous: a branch of sixteen hashes, or a leaf.
const LONGEST_NODE: usize = 1024;

/// Header fields in order, numbers after `#`. Those of later forks come last; if one is missing, so are all after it.
const FIELDS: &str = "parentHash sha3Uncles miner stateRoot transactionsRoot receiptsRoot logsBloom #difficulty #number \
    #gasLimit #gasUsed #timestamp extraData mixHash nonce #baseFeePerGas withdrawalsRoot #blobGasUsed #excessBlobGas \
    parentBeaconBlockRoot requestsHash";

impl Chain {
    /// RLP, exactly as hashed.
    pub async fn header_rlp(&self, number: u64) -> Result<Option<Vec<u8>>, ChainError> {
        let block: Value = self.rpc("eth_getBlockByNumber", json!([format!("{number:#x}"), false])).await?;
        if block.is_null() {
            return Ok(None);
        }
        let wrong = || self.misunderstood("eth_getBlockByNumber", "its fields do not match its hash");
        header_of(&block).map(Some).ok_or_else(wrong)
    }

    /// Proof nodes of storage slots after a block (EIP-1186), unchecked.
    pub async fn storage_nodes(&self, number: u64, slots: &[Slot]) -> Result<Vec<Vec<u8>>, ChainError> {
        let contract = self.contract()?.to_string();
        let mut nodes = Vec::new();
        for some in slots.chunks(MOST_SLOTS) {
            let keys: Vec<String> = some.iter().map(|slot| Hash(slot.0).to_string()).collect();
            let answer: Value = self.rpc("eth_getProof", json!([contract, keys, format!("{number:#x}")])).await?;
            let wrong = || self.misunderstood("eth_getProof", "it is not a proof");
            let storage = answer.get("storageProof").and_then(Value::as_array).ok_or_else(wrong)?;
            let ways = std::iter::once(answer.get("accountProof")).chain(storage.iter().map(|one| one.get("proof")));
            for way in ways {
                for node in way.and_then(Value::as_array).ok_or_else(wrong)? {
                    let bytes = node.as_str().and_then(unhex).filter(|bytes| bytes.len() <= LONGEST_NODE);
                    nodes.push(bytes.ok_or_else(wrong)?);
                }
            }
        }
        Ok(nodes)
    }
}

/// `None` if the fields do not give the hash.
fn header_of(block: &Value) -> Option<Vec<u8>> {
    let named: Hash = block.get("hash")?.as_str()?.parse().ok()?;
    let of_hash = |header: &Vec<u8>| BlockHeader::parse(header).is_some_and(|parsed| parsed.hash == named);
    encode(block).filter(of_hash).or_else(|| encode(&without_miner(block)?).filter(of_hash))
}

/// geth 1.10.6 to 1.10.8 shows a Clique block's signer as its miner; the hashed header has no account there.
fn without_miner(block: &Value) -> Option<Value> {
    let mut block = block.clone();
    *block.get_mut("miner")? = json!(Address([0; 20]).to_string());
    Some(block)
}

fn encode(block: &Value) -> Option<Vec<u8>> {
    let (mut list, mut there) = (List::default(), 0);
    for field in FIELDS.split(' ') {
        let name = field.trim_start_matches('#');
        let Some(text) = block.get(name).and_then(Value::as_str) else { break };
        list = list.add(&if name == field { unhex(text)? } else { number(text)? }[..]);
        there += 1;
    }
    (there >= 15).then(|| list.end())
}

fn number(text: &str) -> Option<Vec<u8>> {
    let digits = text.strip_prefix("0x")?;
    let even = if digits.len() % 2 == 0 { digits.to_owned() } else { format!("0{digits}") };
    let bytes = unhex(&even)?;
    Some(bytes.into_iter().skip_while(|byte| *byte == 0).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Such a block, as one version of geth shows it and as another one does.
    #[test]
    fn a_clique_block_shown_with_its_signer_as_miner_gives_its_hash() {
        let blocks: Value = serde_json::from_str(include_str!("../../evidence/src/tests/besu.json")).expect("JSON");
        let mut block = blocks["qbft"].clone();
        block["mixHash"] = json!(Hash([0; 32]).to_string());
        block["extraData"] = json!(format!("0x{}", "07".repeat(97)));
        block["miner"] = json!(format!("0x{}", "00".repeat(20)));
        let header = encode(&block).expect("a header");
        block["hash"] = json!(BlockHeader::parse(&header).expect("parses").hash.to_string());
        assert_eq!(header_of(&block).as_ref(), Some(&header));
        block["miner"] = json!(format!("0x{}", "5a".repeat(20)));
        assert_eq!(header_of(&block).as_ref(), Some(&header), "its signer is shown");
        block["gasUsed"] = json!("0x7");
        assert_eq!(header_of(&block), None, "nothing else may differ");
    }

    /// Their hash covers neither seals nor round: it is not that of their bytes.
    #[test]
    fn blocks_of_real_networks_of_besu_give_their_hash() {
        let blocks: Value = serde_json::from_str(include_str!("../../evidence/src/tests/besu.json")).expect("JSON");
        for name in ["qbft", "ibft2"] {
            let header = header_of(&blocks[name]).expect("its hash");
            let committed = BlockHeader::parse(&header).expect("a header");
            assert!(committed.committed().is_some(), "{name}");
            for field in ["stateRoot", "gasUsed", "timestamp", "parentHash"] {
                let mut other = blocks[name].clone();
                let text = other[field].as_str().expect("text").to_owned();
                let last = if text.ends_with('7') { "8" } else { "7" };
                other[field] = format!("{}{last}", &text[..text.len() - 1]).into();
                assert_eq!(header_of(&other), None, "{name}, {field}");
            }
        }
    }
}
