//! How the blocks of a chain are sealed, as far as the chain reveals it.

use std::time::Duration;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::model::{Address, bytes::unhex, counted};
use crate::{Chain, ChainError, Consensus, connect::RawBlock};
use authros_evidence::validators_in;

/// Intervals between the newest blocks that are measured.
const INTERVALS: usize = 2;

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sealing {
    /// Least milliseconds between blocks under proof of authority: as founded, or as seen at a node.
    pub period: Option<u64>,
    /// Of the newest block under proof of work, decimal.
    pub difficulty: Option<String>,
    /// Signers or validators; under the embedded proof of work, the recipient of the fees.
    pub sealers: Vec<Address>,
}

impl Chain {
    /// Leaves out what a node does not report.
    pub async fn sealing(&self) -> Result<Sealing, ChainError> {
        if let Some(chain) = self.transport().embedded() {
            let (period, difficulty) = match chain.line.consensus {
                Consensus::Poa { period, .. } => (u64::try_from(period.as_millis()).ok(), None),
                Consensus::Pow { difficulty } => (None, Some(difficulty.to_string())),
            };
            return Ok(Sealing { period, difficulty, sealers: chain.line.sealers.clone() });
        }
        match self.inner.consensus {
            "pow" => Ok(Sealing { difficulty: self.difficulty().await?, ..Sealing::default() }),
            "poa" => Ok(Sealing { sealers: self.signers().await?, period: self.period().await?, ..Sealing::default() }),
            _ => Ok(Sealing::default()),
        }
    }

    async fn difficulty(&self) -> Result<Option<String>, ChainError> {
        let difficulty = self.newest().await?.difficulty;
        let digits = difficulty.as_ref().and_then(Value::as_str).and_then(|text| text.strip_prefix("0x"));
        Ok(digits.and_then(|hex| u128::from_str_radix(hex, 16).ok()).map(|difficulty| difficulty.to_string()))
    }

    /// Milliseconds. The first block has no time of its own.
    async fn period(&self) -> Result<Option<u64>, ChainError> {
        let mut later = self.head().await?;
        let mut shortest = None;
        for _ in 0..INTERVALS {
            let number = later.number.saturating_sub(1);
            let Some(earlier) = self.block(number).await?.filter(|_| number > 0) else { break };
            let interval = later.timestamp.saturating_sub(earlier.timestamp).saturating_mul(1_000);
            shortest = Some(shortest.map_or(interval, |least: u64| least.min(interval)));
            later = earlier;
        }
        Ok(shortest.filter(|interval| *interval > 0))
    }

    /// As geth, Besu or GoQuorum answers; otherwise from the newest header (QBFT, IBFT) or a Clique genesis block.
    async fn signers(&self) -> Result<Vec<Address>, ChainError> {
        let asked = [
            ("clique_getSigners", json!([])),
            ("qbft_getValidatorsByBlockNumber", json!(["latest"])),
            ("ibft_getValidatorsByBlockNumber", json!(["latest"])),
            ("istanbul_getValidators", json!(["latest"])),
        ];
        for (method, parameters) in asked {
            match self.rpc::<Vec<String>>(method, parameters).await {
                Ok(signers) if !signers.is_empty() => {
                    return Ok(signers.iter().filter_map(|text| text.to_lowercase().parse().ok()).collect());
                }
                Err(error @ ChainError::Unreachable { .. }) => return Err(error),
                Ok(_) | Err(_) => {}
            }
        }
        let extra = |block: RawBlock| block.extra_data.as_deref().and_then(unhex).unwrap_or_default();
        let named = validators_in(&extra(self.newest().await?));
        if !named.is_empty() {
            return Ok(named);
        }
        let genesis = self.raw_block(0).await?.map(extra).unwrap_or_default();
        let named = validators_in(&genesis);
        Ok(if named.is_empty() { listed(&genesis) } else { named })
    }

    pub async fn sealed_by(&self) -> Result<SealedBy, ChainError> {
        let sealing = self.sealing().await?;
        let (client, consensus) = (&self.inner.client, self.inner.consensus);
        Ok(SealedBy::of(client, consensus, sealing.sealers.len(), sealing.difficulty.as_deref()))
    }

    /// `None` if nothing is due, or if the newest blocks do not show it.
    pub async fn due_within(&self) -> Result<Option<Duration>, ChainError> {
        // A chain in one program cannot be cut off from itself.
        let is_alone = self.transport().embedded().is_some() || self.inner.client.starts_with("AuthROS/");
        if is_alone || self.inner.consensus == "dev" {
            return Ok(None);
        }
        let head = self.head().await?.number;
        let mut sealed = Vec::new();
        // The time of a genesis block is arbitrary.
        for number in head.saturating_sub(MEASURED).max(1)..=head {
            let Some(block) = self.raw_block(number).await? else { return Ok(None) };
            sealed.push((block.timestamp.as_u64(), block.gas_used.is_none_or(|gas| gas.is_zero())));
        }
        Ok(due(self.inner.consensus, &sealed))
    }
}

/// Between 32 bytes of vanity and 65 of seal.
fn listed(extra: &[u8]) -> Vec<Address> {
    let signers = extra.get(32..extra.len().saturating_sub(65)).unwrap_or_default();
    let (signers, rest) = signers.as_chunks();
    if rest.is_empty() { signers.iter().copied().map(Address).collect() } else { Vec::new() }
}

// The sealers, worded for readers who must trust them: an anchor proves only that they agreed, by their clock.

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SealerKind {
    /// One AuthROS program, with all keys in its home.
    Embedded,
    /// A development node: its operator sets blocks and times.
    Development,
    Authority,
    Work,
    Unknown,
}

/// As reported by the node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SealedBy {
    pub kind: SealerKind,
    /// A single party decides about blocks and their times.
    pub alone: bool,
    pub text: String,
}

impl SealedBy {
    fn embedded() -> Self {
        let text = "an embedded AuthROS chain: a single program seals it, its keys are in the home of the person who \
                    runs it, and block times are that machine's clock";
        Self { kind: SealerKind::Embedded, alone: true, text: text.to_owned() }
    }

    pub fn of(client: &str, consensus: &str, sealers: usize, difficulty: Option<&str>) -> Self {
        if client.starts_with("AuthROS/") {
            return Self::embedded();
        }
        let (kind, alone, text) = match consensus {
            "dev" => (
                SealerKind::Development,
                true,
                format!("a development node ({client}): the person who runs it decides on blocks and their times"),
            ),
            "poa" if sealers == 1 => (
                SealerKind::Authority,
                true,
                "proof of authority by a single account, according to its node".to_owned(),
            ),
            "poa" if sealers > 1 => (
                SealerKind::Authority,
                false,
                format!("proof of authority by {}, according to its node", counted(sealers as u64, "account")),
            ),
            "pow" => {
                let difficulty = difficulty.unwrap_or("unknown");
                (SealerKind::Work, false, format!("proof of work with difficulty {difficulty}, according to its node"))
            }
            _ => (SealerKind::Unknown, false, format!("not stated by its node ({client})")),
        };
        Self { kind, alone, text }
    }
}

// When the next block is due, measured on the newest ones. A chain that seals only transactions owes none.

/// Blocks that are measured, and new ones before measuring again.
pub const MEASURED: u64 = 16;
/// Fewest pauses for a mean.
const LEAST: usize = 8;
/// Under proof of work, a pause of ten means comes once in 22,000 blocks (e^-10).
const LUCK: u32 = 10;
/// Under proof of stake a proposer may miss its turn.
const MISSED: u32 = 2;

/// Takes block times, seconds, and whether each is empty. Only the pause before an empty block shows how long a chain
/// waits without transactions; proof of work does not wait for them.
fn due(consensus: &str, sealed: &[(u64, bool)]) -> Option<Duration> {
    let pauses = sealed.iter().zip(sealed.iter().skip(1));
    let pauses = pauses.map(|((before, _), (time, empty))| (Duration::from_secs(time.saturating_sub(*before)), *empty));
    if consensus == "pow" {
        let all: Vec<Duration> = pauses.map(|(pause, _)| pause).collect();
        let count = u32::try_from(all.len()).ok().filter(|_| all.len() >= LEAST)?;
        return Some((all.iter().sum::<Duration>() * LUCK / count).max(Duration::from_secs(1)));
    }
    let longest = pauses.filter(|(_, empty)| *empty).map(|(pause, _)| pause).max()?;
    let turns = if consensus == "poa" { 1 } else { MISSED };
    Some((longest * turns).max(Duration::from_secs(1)))
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::time::Duration;

    use super::*;
    use crate::crypto::EoaSecret;
    use crate::{ChainOptions, Endpoint, Pin};

    fn options(directory: &Path, consensus: Option<Consensus>, pinned: Option<Pin>) -> ChainOptions {
        let endpoint = Endpoint::Embedded { directory: directory.to_owned(), consensus };
        ChainOptions { endpoint, contract: None, pinned }
    }

    #[test]
    fn a_clique_genesis_lists_its_signers() {
        let extra = [&[1; 32][..], &[7; 20], &[8; 20], &[0; 65]].concat();
        assert_eq!(listed(&extra), [Address([7; 20]), Address([8; 20])]);
        for other in [0, 31, 32, 96, 97, 98, 136] {
            assert_eq!(listed(&extra[..other]), [], "{other} bytes");
        }
    }

    /// A node that gives blocks with this extra data and mix hash, every second one, and what `method` answers.
    fn foreign(extra: String, mix: String, method: Option<(&'static str, Value)>) -> String {
        use std::io::{BufRead as _, Read as _, Write as _};
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
        let url = format!("http://{}", listener.local_addr().expect("its address"));
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let mut stream = stream.expect("accepted");
                let mut reader = std::io::BufReader::new(stream.try_clone().expect("twice"));
                let (mut length, mut line) = (0, String::new());
                while reader.read_line(&mut line).expect("a head") > 2 {
                    let lower = line.to_lowercase();
                    length =
                        lower.strip_prefix("content-length:").map_or(length, |n| n.trim().parse().expect("a length"));
                    line.clear();
                }
                let mut body = vec![0; length];
                reader.read_exact(&mut body).expect("a body");
                let asked: Value = serde_json::from_slice(&body).expect("JSON");
                let name = asked["method"].as_str().expect("a method");
                let result = match (name, &method) {
                    ("eth_chainId", _) => json!("0x7"),
                    ("web3_clientVersion", _) => json!("Geth/v1.10.3-quorum-v22.7.6"),
                    ("eth_getBlockByNumber", _) => {
                        let text = asked["params"][0].as_str().expect("a block").trim_start_matches("0x");
                        let number = u64::from_str_radix(text, 16).unwrap_or(9);
                        // The newest came late.
                        let time = if number == 0 { 0 } else { 1_000 + number * 5 + if number == 9 { 60 } else { 0 } };
                        json!({ "number": format!("{number:#x}"), "hash": crate::model::Hash([9; 32]).to_string(),
                            "timestamp": format!("{time:#x}"), "difficulty": "0x1", "extraData": extra, "mixHash": mix })
                    }
                    (name, Some((known, answer))) if name == *known => answer.clone(),
                    _ => Value::Null,
                };
                let told = match (name, result) {
                    (_, Value::Null) => json!({ "error": { "code": -32601, "message": "the method does not exist" } }),
                    (_, result) => json!({ "result": result }),
                };
                let mut told = told;
                (told["jsonrpc"], told["id"]) = (json!("2.0"), asked["id"].clone());
                let told = told.to_string();
                let head = "HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nConnection: close\r\nContent-Length: ";
                drop(stream.write_all(format!("{head}{}\r\n\r\n{told}", told.len()).as_bytes()));
            }
        });
        url
    }

    async fn sealing_of(url: String) -> Sealing {
        let options = ChainOptions { endpoint: Endpoint::Node { url, roots: None }, contract: None, pinned: None };
        Chain::connect(options).await.expect("connects").sealing().await.expect("told")
    }

    /// A network of validators is told by a method of its node, or else by its headers; the period by its blocks.
    #[tokio::test(flavor = "multi_thread")]
    async fn validators_and_period_are_read_from_what_there_is() {
        let blocks: Value = serde_json::from_str(include_str!("../../evidence/src/tests/besu.json")).expect("JSON");
        let of = |name: &str, field: &str| blocks[name][field].as_str().expect("text").to_owned();
        for (name, count) in [("ibft2", 4), ("qbft", 1)] {
            let found = sealing_of(foreign(of(name, "extraData"), of(name, "mixHash"), None)).await;
            assert_eq!((found.sealers.len(), found.period), (count, Some(5_000)), "{name}: {found:?}");
        }
        let method =
            Some(("istanbul_getValidators", json!([Address([5; 20]).to_string(), Address([6; 20]).to_string()])));
        let found = sealing_of(foreign(of("qbft", "extraData"), of("qbft", "mixHash"), method)).await;
        assert_eq!(found.sealers, [Address([5; 20]), Address([6; 20])]);
        let clique = format!("0x{}{}{}", "01".repeat(32), "07".repeat(20), "00".repeat(65));
        let found = sealing_of(foreign(clique, crate::model::Hash([0; 32]).to_string(), None)).await;
        assert_eq!((found.sealers, found.period), (vec![Address([7; 20])], Some(5_000)));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn both_kinds_run_the_same_and_tell_what_they_are() {
        let three = Consensus::Poa { signers: 3, period: Duration::from_millis(50) };
        let easy = Consensus::Pow { difficulty: 2000 };
        let mut work = Vec::new();
        for (consensus, word, sealers) in [(Consensus::POA, "poa", 1), (three, "poa", 3), (easy, "pow", 1)] {
            let home = tempfile::tempdir().expect("folder");
            let chain = Chain::connect(options(home.path(), Some(consensus), None)).await.expect("opens");
            let pin = chain.deploy(&EoaSecret::generate().expect("key")).await.expect("deploys");
            work.push(chain.work(0, pin.deployed_at).await.expect("work"));
            let status = chain.status(None).await.expect("status");
            assert_eq!(status.consensus, word);
            assert_eq!(status.client.contains("not ethash"), word == "pow");
            let sealing = chain.sealing().await.expect("sealing");
            assert_eq!(sealing.sealers.len(), sealers);
            assert_eq!((sealing.period.is_some(), sealing.difficulty.is_some()), (word == "poa", word == "pow"));
            let head = chain.head().await;
            drop(chain);
            let chain = Chain::connect(options(home.path(), None, Some(pin))).await.expect("opens again");
            assert_eq!((chain.head().await, chain.sealing().await), (head, Ok(sealing)));
        }
        assert!(
            work.iter().all(|other| *other == work[0]),
            "transactions and gas do not depend on the sealing: {work:?}"
        );
    }
}

#[cfg(test)]
mod sealed_by_tests {
    use super::*;

    #[test]
    fn one_who_decides_alone_is_told_from_several() {
        for (client, consensus, sealers, kind, alone) in [
            ("AuthROS/v0.1.0/embedded (proof of authority)", "poa", 3, SealerKind::Embedded, true),
            ("AuthROS/v0.1.0/embedded (proof of work by Keccak-256, not ethash)", "pow", 0, SealerKind::Embedded, true),
            ("anvil/v1.0", "dev", 0, SealerKind::Development, true),
            ("Geth/v1.10", "poa", 1, SealerKind::Authority, true),
            ("Geth/v1.10", "poa", 4, SealerKind::Authority, false),
            ("Geth/v1.10", "poa", 0, SealerKind::Unknown, false),
            ("Geth/v1.10", "pow", 0, SealerKind::Work, false),
            ("Geth/v1.13", "pos", 0, SealerKind::Unknown, false),
        ] {
            let found = SealedBy::of(client, consensus, sealers, None);
            assert_eq!((found.kind, found.alone), (kind, alone), "{client} {consensus}");
            assert!(!found.text.is_empty());
        }
    }
}

#[cfg(test)]
mod rhythm_tests {
    use super::*;

    /// Blocks with these pauses, each empty or not.
    fn blocks(pauses: &[(u64, bool)]) -> Vec<(u64, bool)> {
        let mut time = 1_700_000_000;
        let mut sealed = vec![(time, true)];
        for (pause, empty) in pauses {
            time += pause;
            sealed.push((time, *empty));
        }
        sealed
    }

    fn seconds(consensus: &str, pauses: &[(u64, bool)]) -> Option<u64> {
        due(consensus, &blocks(pauses)).map(|due| due.as_secs())
    }

    #[test]
    fn what_a_chain_owes_shows_in_its_empty_blocks() {
        assert_eq!(seconds("poa", &[(5, true), (5, false), (5, true)]), Some(5));
        assert_eq!(seconds("poa", &[(1, false), (1, false), (60, true), (1, false)]), Some(60), "empty ones come late");
        assert_eq!(seconds("pos", &[(12, true), (12, false)]), Some(24), "one turn may be missed");
        assert_eq!(seconds("poa", &[(0, true), (0, true)]), Some(1));
        // Busy, or sealing only what is sent: that cannot be told apart, so nothing is due.
        assert_eq!(seconds("poa", &[(1, false), (1, false), (900, false)]), None);
        assert_eq!(seconds("poa", &[]), None);
    }

    #[test]
    fn proof_of_work_is_given_ten_mean_pauses_whatever_is_in_its_blocks() {
        assert_eq!(seconds("pow", &[(12, false); 8]), Some(120));
        assert_eq!(
            seconds(
                "pow",
                &[(3, false), (45, true), (1, false), (7, true), (2, true), (30, true), (4, false), (4, true)]
            ),
            Some(120)
        );
        assert_eq!(seconds("pow", &[(12, true); 7]), None, "too few to tell");
    }
}
