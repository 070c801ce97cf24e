//! Genesis files for private networks: geth (clique, ethash) and Besu (qbft). Chain id and extra data are random, so no
//! other network shares them by accident; the contract needs Istanbul and no later fork.

use std::{collections::HashSet, str::FromStr};

use ethers::types::U256;
use serde_json::{Value, json};

use crate::model::{Address, Timestamp, clean};
use crate::{ChainError, model::bytes::hex, transaction::List};

/// The last part of the manual's page on networks.
pub fn network_guide() -> &'static str {
    let page = include_str!("../../../docs/network.md");
    page.find("## A private network").and_then(|at| page.get(at..)).unwrap_or(page)
}

const CLIQUE: &str = include_str!("../../../contracts/genesis/clique.json");
const ETHASH: &str = include_str!("../../../contracts/genesis/ethash.json");
const QBFT: &str = include_str!("../../../contracts/genesis/qbft.json");

/// Their addresses are in the extra data of the genesis block.
const MOST_SIGNERS: usize = 32;
/// Seconds.
const USUAL_PERIOD: u64 = 2;
/// Seconds.
const LONGEST_PERIOD: u64 = 3600;
/// Highest chain id that every wallet and JSON reader accepts.
const HIGHEST_ID: u64 = (1 << 52) - 1;
const VANITY: usize = 32;
const SEAL: usize = 65;

#[derive(Debug, Clone, Copy, PartialEq, Eq, strum::Display, strum::EnumString)]
#[strum(serialize_all = "lowercase", parse_err_fn = unknown_kind, parse_err_ty = ChainError)]
pub enum GenesisKind {
    /// Proof of authority in geth (and in Besu until it was removed there).
    Clique,
    /// Proof of work in geth before 1.12.
    Ethash,
    Qbft,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Allocation {
    account: Address,
    wei: U256,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Genesis {
    pub kind: GenesisKind,
    /// EIP-155; random if `None`.
    pub chain_id: Option<u64>,
    /// None for ethash.
    pub signers: Vec<Address>,
    /// Seconds; not for ethash.
    pub period: Option<u64>,
    pub allocations: Vec<Allocation>,
}

fn unknown_kind(text: &str) -> ChainError {
    ChainError::Input(format!("'{}' is not clique, ethash or qbft", clean(text, 40)))
}

impl FromStr for Allocation {
    type Err = ChainError;

    fn from_str(text: &str) -> Result<Self, ChainError> {
        let wrong = || {
            ChainError::Input(format!("'{}' is not ADDRESS=WEI (0x and 40 hex digits, =, a number)", clean(text, 120)))
        };
        let (account, wei) = text.split_once('=').ok_or_else(wrong)?;
        let plain = !wei.is_empty() && wei.bytes().all(|byte| byte.is_ascii_digit());
        let wei = plain.then(|| U256::from_dec_str(wei).ok()).flatten().ok_or_else(wrong)?;
        Ok(Self { account: account.parse().map_err(|_| wrong())?, wei })
    }
}

impl Genesis {
    pub fn file(&self) -> Result<Value, ChainError> {
        let signers = self.sorted_signers()?;
        let vanity: [u8; VANITY] = noise()?;
        let mut file: Value = serde_json::from_str(match self.kind {
            GenesisKind::Clique => CLIQUE,
            GenesisKind::Ethash => ETHASH,
            GenesisKind::Qbft => QBFT,
        })
        .map_err(|error| ChainError::Internal(format!("the template of {}: {error}", self.kind)))?;
        let extra = match self.kind {
            GenesisKind::Ethash => vanity.to_vec(),
            // In ascending order, with an empty seal (EIP-225).
            GenesisKind::Clique => {
                [&vanity[..], &signers.iter().flat_map(|one| one.0).collect::<Vec<_>>(), &[0; SEAL]].concat()
            }
            GenesisKind::Qbft => qbft_extra(&vanity, &signers),
        };
        file["config"]["chainId"] = self.chosen_id()?.into();
        file["extraData"] = format!("0x{}", hex(&extra)).into();
        file["timestamp"] = format!("{:#x}", Timestamp::now().seconds()).into();
        file["alloc"] = self.alloc()?;
        self.set_period(&mut file)?;
        Ok(file)
    }

    fn chosen_id(&self) -> Result<u64, ChainError> {
        match self.chain_id {
            Some(id) if (1..=HIGHEST_ID).contains(&id) => Ok(id),
            Some(id) => Err(ChainError::Input(format!("chain id {id} is not between 1 and {HIGHEST_ID}"))),
            None => Ok((1 << 40) + u64::from_be_bytes(noise()?) % (1 << 47)),
        }
    }

    fn sorted_signers(&self) -> Result<Vec<Address>, ChainError> {
        let mut signers = self.signers.clone();
        signers.sort();
        signers.dedup();
        let wrong = match (self.kind, signers.len()) {
            (GenesisKind::Ethash, 0) => None,
            (GenesisKind::Ethash, _) => Some("ethash has no signers; omit --signer".to_owned()),
            (kind, 0) => Some(format!("{kind} needs signers; give each with --signer")),
            (_, count) if count > MOST_SIGNERS => {
                Some(format!("at most {MOST_SIGNERS} signers are possible, not {count}"))
            }
            (_, number) if number < self.signers.len() => Some("a signer is named twice".to_owned()),
            _ => None,
        };
        wrong.map_or(Ok(signers), |wrong| Err(ChainError::Input(wrong)))
    }

    fn set_period(&self, file: &mut Value) -> Result<(), ChainError> {
        let period = self.period.unwrap_or(USUAL_PERIOD);
        if !(1..=LONGEST_PERIOD).contains(&period) {
            return Err(ChainError::Input(format!("a period of {period} s is not between 1 and {LONGEST_PERIOD}")));
        }
        let config = &mut file["config"];
        match self.kind {
            GenesisKind::Clique => {
                config["clique"]["period"] = period.into();
                config["clique"]["blockperiodseconds"] = period.into();
            }
            GenesisKind::Qbft => {
                config["qbft"]["blockperiodseconds"] = period.into();
                config["qbft"]["requesttimeoutseconds"] = (2 * period).into();
            }
            GenesisKind::Ethash if self.period.is_some() => {
                return Err(ChainError::Input("ethash has no period; omit --period".into()));
            }
            GenesisKind::Ethash => {}
        }
        Ok(())
    }

    fn alloc(&self) -> Result<Value, ChainError> {
        let mut seen = HashSet::new();
        let mut alloc = serde_json::Map::new();
        for Allocation { account, wei } in &self.allocations {
            if !seen.insert(*account) {
                return Err(ChainError::Input(format!("{account} is given ether twice; give the sum once")));
            }
            alloc.insert(account.to_string().to_lowercase(), json!({ "balance": format!("{wei:#x}") }));
        }
        Ok(Value::Object(alloc))
    }
}

/// RLP of \[vanity, \[validators\], no votes, round 0, no seals\].
fn qbft_extra(vanity: &[u8; VANITY], validators: &[Address]) -> Vec<u8> {
    let nothing: [u64; 0] = [];
    let validators = validators.iter().fold(List::default(), |list, validator| list.add(&validator.0)).end();
    List::default().add(vanity).add_encoded(&validators).add(&nothing.to_vec()).add(&0u8).add(&nothing.to_vec()).end()
}

pub fn noise<const N: usize>() -> Result<[u8; N], ChainError> {
    let mut noise = [0; N];
    getrandom::fill(&mut noise).map_err(|error| ChainError::Internal(format!("no randomness: {error}")))?;
    Ok(noise)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::bytes::unhex;
    use ethers::utils::rlp::Rlp;

    fn genesis(kind: GenesisKind, signers: &[u8]) -> Genesis {
        let signers = signers.iter().map(|number| Address([*number; 20])).collect();
        Genesis { kind, chain_id: None, signers, period: None, allocations: Vec::new() }
    }

    fn extra(file: &Value) -> Vec<u8> {
        unhex(file["extraData"].as_str().expect("text")).expect("hex")
    }

    fn keys(value: &Value) -> Vec<&str> {
        value.as_object().expect("an object").keys().map(String::as_str).collect()
    }

    /// The part shared by all three.
    fn check_common(file: &Value) {
        let config = &file["config"];
        for fork in ["homestead", "eip150", "eip155", "eip158", "byzantium", "constantinople", "petersburg", "istanbul"]
        {
            assert_eq!(config[format!("{fork}Block")], json!(0), "{fork}");
        }
        let id = config["chainId"].as_u64().expect("a number");
        assert!((1 << 40..=HIGHEST_ID).contains(&id));
        assert_eq!(file["gasLimit"], json!("0xffffffff"));
        for zero in ["number", "gasUsed"] {
            assert_eq!(file[zero], json!("0x0"));
        }
        assert_eq!(file["coinbase"], json!(format!("0x{}", "0".repeat(40))));
        assert_eq!(file["parentHash"], json!(format!("0x{}", "0".repeat(64))));
        let time = file["timestamp"].as_str().and_then(|text| u64::from_str_radix(&text[2..], 16).ok());
        assert!(time.is_some_and(|time| time.abs_diff(Timestamp::now().seconds()) < 600));
    }

    const ROOT: [&str; 12] = [
        "alloc",
        "coinbase",
        "config",
        "difficulty",
        "extraData",
        "gasLimit",
        "gasUsed",
        "mixHash",
        "nonce",
        "number",
        "parentHash",
        "timestamp",
    ];

    #[test]
    fn clique() {
        let given = Genesis { period: Some(5), ..genesis(GenesisKind::Clique, &[9, 3, 7]) };
        let file = given.file().expect("a file");
        check_common(&file);
        assert_eq!(keys(&file), ROOT);
        let clique = json!({ "period": 5, "epoch": 30000, "blockperiodseconds": 5, "epochlength": 30000 });
        assert_eq!(file["config"]["clique"], clique);
        assert_eq!(keys(&file["config"]).len(), 10, "no fork after Istanbul, so no base fee");
        assert_eq!((&file["difficulty"], &file["nonce"]), (&json!("0x1"), &json!("0x0")));
        assert_eq!(file["mixHash"], json!(format!("0x{}", "0".repeat(64))));
        let extra = extra(&file);
        let (vanity, rest) = extra.split_at(32);
        let (signers, seal) = rest.split_at(60);
        assert_ne!(vanity, [0; 32]);
        assert_eq!(signers, [[3; 20], [7; 20], [9; 20]].concat(), "in ascending order");
        assert_eq!(seal, [0; 65]);
    }

    #[test]
    fn ethash() {
        let file = genesis(GenesisKind::Ethash, &[]).file().expect("a file");
        check_common(&file);
        assert_eq!(keys(&file), ROOT);
        assert_eq!(file["config"]["ethash"], json!({ "fixeddifficulty": 0x4c_ccc8 }));
        assert_eq!(keys(&file["config"]).len(), 10);
        assert_eq!((&file["difficulty"], &file["nonce"]), (&json!("0x4cccc8"), &json!("0x42")));
        assert_eq!(extra(&file).len(), 32, "geth takes no more");
        assert_ne!(file["extraData"], genesis(GenesisKind::Ethash, &[]).file().expect("a file")["extraData"]);
    }

    #[test]
    fn qbft() {
        let file = genesis(GenesisKind::Qbft, &[9, 3, 7, 1]).file().expect("a file");
        check_common(&file);
        assert_eq!(file["baseFeePerGas"], json!("0x0"));
        assert_eq!(keys(&file).len(), ROOT.len() + 1);
        let config = &file["config"];
        assert_eq!(
            (&config["berlinBlock"], &config["londonBlock"], &config["zeroBaseFee"]),
            (&json!(0), &json!(0), &json!(true))
        );
        let qbft = json!({ "blockperiodseconds": 2, "epochlength": 30000, "requesttimeoutseconds": 4 });
        assert_eq!(config["qbft"], qbft);
        assert_eq!(keys(config).len(), 13);
        assert_eq!((&file["difficulty"], &file["nonce"]), (&json!("0x1"), &json!("0x0")));
        let byzantine = format!("0x{}", hex(b"ctical byzantine fault tolerance"));
        assert_eq!(file["mixHash"], json!(byzantine));
        let extra = extra(&file);
        let list = Rlp::new(&extra);
        assert_eq!(list.payload_info().expect("a list").total(), extra.len());
        assert_eq!(list.item_count(), Ok(5));
        assert_eq!(list.at(0).and_then(|vanity| vanity.data()).map(<[u8]>::len), Ok(32));
        let validators = list.at(1).expect("validators");
        let addresses: Vec<&[u8]> = validators.iter().map(|item| item.data().expect("bytes")).collect();
        assert_eq!(addresses, [[1; 20], [3; 20], [7; 20], [9; 20]]);
        for (index, nothing) in [(2, 0xc0), (3, 0x80), (4, 0xc0)] {
            assert_eq!(list.at(index).map(|item| item.as_raw().to_vec()), Ok(vec![nothing]), "{index}");
        }
    }

    /// The example from Besu's QBFT documentation.
    #[test]
    fn the_extra_data_is_besus() {
        let validators = [
            "0x4592c8e45706cc08b8f44b11e43cba0cfc5892cb",
            "0x06e23768a0f59cf365e18c2e0c89e151bcdedc70",
            "0xc5327f96ee02d7bcbc1bf1236b8c15148971e1de",
            "0xab5e7f4061c605820d3744227eed91ff8e2c8908",
        ]
        .map(|text| text.parse().expect("address"));
        let expected = "f87aa00000000000000000000000000000000000000000000000000000000000000000f854944592c8e45706cc08b8f4\
                        4b11e43cba0cfc5892cb9406e23768a0f59cf365e18c2e0c89e151bcdedc7094c5327f96ee02d7bcbc1bf1236b8c15148\
                        971e1de94ab5e7f4061c605820d3744227eed91ff8e2c8908c080c0";
        assert_eq!(hex(&qbft_extra(&[0; 32], &validators)), expected);
    }

    #[test]
    fn ether_and_ids() {
        let allocations: Vec<Allocation> =
            ["0x0101010101010101010101010101010101010101=255"].map(|text| text.parse().expect("an allocation")).into();
        let given = Genesis { chain_id: Some(77), allocations, ..genesis(GenesisKind::Ethash, &[]) };
        let file = given.file().expect("a file");
        assert_eq!(file["config"]["chainId"], json!(77));
        assert_eq!(file["alloc"], json!({ "0x0101010101010101010101010101010101010101": { "balance": "0xff" } }));
        let twice = Genesis { allocations: [given.allocations[0]; 2].into(), ..given };
        assert!(twice.file().expect_err("twice").to_string().contains("twice"));
        for bad in
            ["", "0x01=1", "0x0101010101010101010101010101010101010101", "0x0101010101010101010101010101010101010101="]
        {
            assert!(bad.parse::<Allocation>().is_err(), "{bad}");
        }
        let above = format!("0x0101010101010101010101010101010101010101=1{}", "0".repeat(80));
        assert!(above.parse::<Allocation>().is_err(), "more than 256 bits");
    }

    #[test]
    fn what_does_not_fit_is_said() {
        let of = |kind, signers: &[u8]| genesis(kind, signers);
        for (given, words) in [
            (of(GenesisKind::Clique, &[]), "--signer"),
            (of(GenesisKind::Qbft, &[1, 1]), "twice"),
            (of(GenesisKind::Qbft, &(1..=33).collect::<Vec<u8>>()), "at most 32"),
            (of(GenesisKind::Ethash, &[1]), "no signers"),
            (Genesis { period: Some(1), ..of(GenesisKind::Ethash, &[]) }, "no period"),
            (Genesis { period: Some(0), ..of(GenesisKind::Clique, &[1]) }, "period"),
            (Genesis { chain_id: Some(0), ..of(GenesisKind::Ethash, &[]) }, "chain id"),
            (Genesis { chain_id: Some(u64::MAX), ..of(GenesisKind::Ethash, &[]) }, "chain id"),
        ] {
            let error = given.file().expect_err(words);
            assert!(error.to_string().contains(words), "{error}");
        }
    }
}
