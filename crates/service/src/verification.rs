//! Check of an export folder without a home or keys, against a chain that the checker trusts.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::chain::{BlockRef, Chain, ChainError, ChainOptions, Endpoint, Event, Pin, SealedBy};
use crate::crypto::{ProviderName, domain, provider, signer_id};
use crate::model::{Address, Digest, ErrorKind, Hash, Timestamp};
use crate::pipeline::Directory;
use crate::pipeline::authority::{Moment, SigningRight, may_sign};
use crate::pipeline::export_folder::{AnchorWord, ExportFolder, VerifyStep};
use crate::reply::{Result, input};

/// Most anchors of a record examined, and most of those in the block that the folder names.
const MOST_ANCHORS: usize = 256;

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FolderCheck {
    /// Whether every step was done and passed.
    pub ok: bool,
    /// SM3 of the record.
    pub digest: Digest,
    pub owner: Address,
    /// According to its owner.
    pub captured_at: Timestamp,
    /// The earliest anchor at which the signer had the right. If there is none, the one in proof.json; `None` if the
    /// chain lacks that too.
    pub anchored: Option<AnchoredAt>,
    /// According to the chain's node.
    pub sealed_by: Option<SealedBy>,
    /// What the reader must know besides.
    pub warnings: Vec<String>,
    pub steps: Vec<VerifyStep>,
    /// Determines the exit code; `None` if every check passes.
    pub worst: Option<ErrorKind>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct AnchoredAt {
    pub block: u64,
    pub hash: Hash,
    /// To the second, by the sealers' clocks.
    pub time: Timestamp,
}

impl From<BlockRef> for AnchoredAt {
    fn from(block: BlockRef) -> Self {
        Self { block: block.number, hash: block.hash, time: Timestamp::from_seconds(block.timestamp) }
    }
}

/// Facts about the chain from another source; they take precedence over the folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Known {
    pub genesis: Option<Hash>,
    pub contract: Option<Address>,
}

impl Known {
    /// What only the folder vouches for.
    fn missing(self) -> &'static [&'static str] {
        if self.genesis.is_some() || self.contract.is_some() { &[] } else { &["genesis", "contract"] }
    }
}

/// Checks a folder against the chain at `url`. The steps report a chain that does not answer; `Input` if the folder
/// does not exist.
pub async fn verify(folder: &Path, url: Option<&str>, known: Known) -> Result<FolderCheck> {
    let folder =
        tokio::task::block_in_place(|| ExportFolder::read(folder)).map_err(|error| input(error.to_string()))?;
    let provider = provider(ProviderName::default());
    let mut steps = folder.check(provider);
    let (mut worst, mut anchored, mut sealed_by) = (None, None, None);
    match url {
        Some(url) => match ask(&folder, url, known, &mut steps, &mut sealed_by).await {
            Ok(found) => anchored = found,
            Err(error) => {
                worst = Some(error.kind());
                steps.push(VerifyStep::open("chain", &error.to_string()));
            }
        },
        None => {
            worst = Some(ErrorKind::Incomplete);
            steps.push(VerifyStep::open("chain", "not checked: pass --chain with the URL of a node you trust"));
        }
    }
    if steps.iter().any(|step| step.ok == Some(false)) {
        worst = Some(ErrorKind::Tampered);
    } else if worst.is_none() && steps.iter().any(|step| step.ok.is_none()) {
        worst = Some(ErrorKind::Incomplete);
    }
    let (captured_at, missing) = (folder.header.captured_at, if url.is_some() { known.missing() } else { &[] });
    Ok(FolderCheck {
        warnings: warnings(captured_at, anchored, sealed_by.as_ref(), missing),
        sealed_by,
        ok: worst.is_none(),
        digest: folder.digest(provider),
        owner: folder.header.owner,
        captured_at,
        anchored,
        steps,
        worst,
    })
}

async fn ask(
    folder: &ExportFolder,
    url: &str,
    known: Known,
    steps: &mut Vec<VerifyStep>,
    sealed_by: &mut Option<SealedBy>,
) -> Result<Option<AnchoredAt>, ChainError> {
    let endpoint = Endpoint::Node { url: url.to_owned(), roots: None };
    let options = ChainOptions { endpoint, contract: None, pinned: None };
    let chain = Chain::connect(options).await?;
    let proof = &folder.proof;
    *sealed_by = Some(chain.sealed_by().await?);
    let genesis = known.genesis.unwrap_or(proof.genesis);
    let same = (chain.chain_id(), chain.genesis()) == (proof.chain_id, genesis);
    let text = format!("chain id {}, genesis {}", chain.chain_id(), chain.genesis());
    steps.push(VerifyStep::new("chain", same, &text));
    let Some(contract) = known.contract.or(proof.contract) else {
        steps.push(VerifyStep::open("contract", "proof.json names none: pass --contract ADDRESS"));
        return Ok(None);
    };
    let pin = match chain.use_contract(contract).await {
        Ok(pin) => pin,
        Err(ChainError::NotTheContract(_)) => {
            let text = format!("the code at {contract} is not an AuthROS contract known to this program");
            steps.push(VerifyStep::new("contract", false, &text));
            return Ok(None);
        }
        Err(error) => return Err(error),
    };
    let bound = domain(pin.chain_id, &pin.genesis, &pin.contract);
    let text = format!("{contract}; the record is bound to this chain and contract");
    steps.push(VerifyStep::new("contract", bound == folder.header.domain, &text));
    if !same || bound != folder.header.domain {
        return Ok(None);
    }
    let anchors = anchors(folder, &chain, &pin).await?;
    let Some(claimed) = check_anchor(folder, &chain, &anchors, steps).await? else { return Ok(None) };
    steps.push(timed(folder, claimed.into()));
    judge_signer(folder, &chain, &pin, &anchors, claimed, steps).await.map(Some)
}

/// Whether the time in proof.json is that of its block.
fn timed(folder: &ExportFolder, claimed: AnchoredAt) -> VerifyStep {
    let AnchoredAt { block, time, .. } = claimed;
    let (ok, text) = match folder.proof.anchor.block_time {
        Some(said) if said != time => (false, format!("block {block} is dated {time}, but proof.json says {said}")),
        _ => (true, format!("block {block} is dated {time}, by the clock of this chain's sealers")),
    };
    VerifyStep::new("time", ok, &text)
}

/// Blocks that anchor the record, in order: by its own digest, or by its batch's root over the path's number of leaves
/// under any account.
async fn anchors(folder: &ExportFolder, chain: &Chain, pin: &Pin) -> Result<Vec<u64>, ChainError> {
    if folder.proof.anchor.mode == AnchorWord::Each {
        let uploaded = chain.uploaded_at(folder.header.owner, folder.proof.digest).await?;
        return Ok(uploaded.into_iter().collect());
    }
    let Some(inclusion) = folder.proof.inclusion() else { return Ok(Vec::new()) };
    let head = chain.head().await?.number;
    let told = chain.anchors_of(inclusion.root, pin.deployed_at, head).await?;
    let told = told.iter().filter_map(|at| match &at.event {
        Event::Anchored { account, count, .. } if *count == inclusion.count => Some((*account, at.block)),
        _ => None,
    });
    let (mut standing, mut blocks) = (BTreeMap::new(), BTreeSet::new());
    for (account, block) in chosen(told, folder.proof.anchor.block) {
        // The contract's own state, so that events need no trust; once per account.
        let stands = match standing.get(&account) {
            Some(stands) => *stands,
            None => chain.root_anchored(account, inclusion.root).await?.is_some(),
        };
        standing.insert(account, stands);
        if stands {
            blocks.insert(block);
        }
    }
    Ok(blocks.into_iter().collect())
}

/// The earliest anchors, and those in the block that the folder names: anybody can anchor a root endlessly, and each
/// anchor costs queries.
fn chosen(told: impl Iterator<Item = (Address, u64)>, claimed: Option<u64>) -> BTreeSet<(Address, u64)> {
    let (mut first, mut named) = (BTreeSet::new(), BTreeSet::new());
    for (account, block) in told {
        if first.len() < MOST_ANCHORS {
            first.insert((account, block));
        } else if claimed == Some(block) && named.len() < MOST_ANCHORS {
            named.insert((account, block));
        }
    }
    first.append(&mut named);
    first
}

async fn check_anchor(
    folder: &ExportFolder,
    chain: &Chain,
    anchors: &[u64],
    steps: &mut Vec<VerifyStep>,
) -> Result<Option<BlockRef>, ChainError> {
    let anchor = &folder.proof.anchor;
    let Some(claimed) = anchor.block else {
        let text = "the record was not in a block when it was exported; ask for a later export";
        steps.push(VerifyStep::open("anchor", text));
        return Ok(None);
    };
    let block = chain.block(claimed).await?;
    let same = anchor.block_hash.is_none_or(|hash| block.is_some_and(|block| block.hash == hash));
    let (ok, text) = match anchors.first() {
        Some(_) if anchors.contains(&claimed) && same => (true, format!("the chain has it in block {claimed}")),
        Some(_) if anchors.contains(&claimed) => {
            (false, format!("block {claimed} is not the block that proof.json names"))
        }
        Some(first) => (false, format!("the chain has it in block {first}, but proof.json says {claimed}")),
        None => (false, "the chain does not have it".to_owned()),
    };
    steps.push(VerifyStep::new("anchor", ok, &text));
    Ok(block.filter(|_| ok))
}

/// Whether the signer had the right to sign, at the earliest anchor where it did. Others are skipped: an anchor during
/// the owner's suspension neither proves nor spoils anything.
async fn judge_signer(
    folder: &ExportFolder,
    chain: &Chain,
    pin: &Pin,
    anchors: &[u64],
    claimed: BlockRef,
    steps: &mut Vec<VerifyStep>,
) -> Result<AnchoredAt, ChainError> {
    let directory = Directory::new(folder.header.domain, provider(ProviderName::default()));
    let last = anchors.last().copied().unwrap_or(claimed.number);
    for at in chain.changes(pin.deployed_at, last).await? {
        directory.apply(&at);
    }
    let (owner, signer) = (folder.header.owner, signer_id(&folder.signer));
    let mut refused = None;
    for number in anchors {
        let Some(block) = chain.block(*number).await? else { continue };
        let at = Moment::of_block(*number, Timestamp::from_seconds(block.timestamp));
        let text = match may_sign(&directory, owner, signer, at) {
            Ok(SigningRight::Owner(_)) => format!("the signer's key belonged to {owner} at block {number}"),
            Ok(SigningRight::Device(_)) => format!(
                "the signer is a device that {owner} had authorised at block \
                                                    {number}"
            ),
            Err(why) => {
                refused = refused.or(Some(why));
                continue;
            }
        };
        steps.push(VerifyStep::new("registration", true, &text));
        return Ok(block.into());
    }
    let text = refused.map_or_else(|| "the chain has no block of its anchor".to_owned(), |why| why.to_string());
    steps.push(VerifyStep::new("registration", false, &text));
    Ok(claimed.into())
}

/// Seconds between claimed capture and anchor that need no comment.
const USUAL: u64 = 10 * 60;
/// Seconds that a capture may claim to be after its anchor: clocks differ, and block times are whole seconds.
const AFTER: u64 = 15;

fn warnings(
    captured_at: Timestamp,
    anchored: Option<AnchoredAt>,
    sealed_by: Option<&SealedBy>,
    folders_word: &[&str],
) -> Vec<String> {
    let mut warnings = Vec::new();
    if let Some(sealed_by) = sealed_by.filter(|sealed_by| sealed_by.alone) {
        warnings.push(format!(
            "its anchor proves nothing against the person who runs this chain: {}; they could have created it at any \
             time and dated its blocks as they like",
            sealed_by.text
        ));
    }
    if let Some(anchored) = anchored {
        let (claimed, block) = (captured_at.seconds(), anchored.time.seconds());
        if block > claimed.saturating_add(USUAL) {
            let late = span(block - claimed);
            warnings.push(format!(
                "it was anchored {late} after its owner claims it was captured; nothing proves that time"
            ));
        } else if claimed > block.saturating_add(AFTER) {
            let late = span(claimed - block);
            warnings
                .push(format!("its owner claims it was captured {late} after it was anchored, so that time is wrong"));
        }
    }
    if !folders_word.is_empty() {
        let given: Vec<String> = folders_word.iter().map(|word| format!("--{word}")).collect();
        warnings.push(format!(
            "relying on the folder's own claim for {}: its maker could have made a chain for it, too; pass {}",
            folders_word.join(" and "),
            given.join(" or ")
        ));
    }
    warnings
}

/// The verdict in words; never "verified" without the time shown by the anchor.
pub fn verdict(check: &FolderCheck) -> String {
    let first = match (check.worst, check.anchored) {
        (None, Some(anchored)) => format!(
            "VERIFIED: unaltered, and signed with a key that was its owner's or authorised by them; it existed no \
             later than {} (block {}), by the clock of this chain's sealers; captured {} is the owner's claim",
            anchored.time, anchored.block, check.captured_at
        ),
        (None, None) => "NOT VERIFIED: the chain did not give the time of its anchor".to_owned(),
        (Some(ErrorKind::Tampered), _) => "NOT VERIFIED: do not trust this record".to_owned(),
        (Some(_), _) => "NOT VERIFIED: not all of it was checked against the chain".to_owned(),
    };
    let sealed = check.sealed_by.iter().map(|sealed_by| format!("sealed by: {}", sealed_by.text));
    let warnings = check.warnings.iter().map(|warning| format!("WARNING: {warning}"));
    std::iter::once(first).chain(sealed).chain(warnings).collect::<Vec<_>>().join("\n")
}

/// In its two largest units.
fn span(seconds: u64) -> String {
    let units = [(86_400, "d"), (3_600, "h"), (60, "min"), (1, "s")];
    let mut rest = seconds;
    let mut parts = Vec::new();
    for (length, unit) in units {
        if rest >= length && parts.len() < 2 {
            parts.push(format!("{} {unit}", rest / length));
        }
        rest %= length;
    }
    if parts.is_empty() { "0 s".to_owned() } else { parts.join(" ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stranger_who_anchors_a_root_again_and_again_costs_a_bounded_number_of_questions() {
        let (owner, stranger) = (Address([1; 20]), Address([2; 20]));
        let again = (10..100_000).map(|block| (stranger, block));
        let told = || std::iter::once((owner, 9)).chain(again.clone()).chain([(owner, 100_000)]);
        let found = chosen(told(), Some(100_000));
        assert!(found.len() <= 2 * MOST_ANCHORS, "{}", found.len());
        assert!(
            found.contains(&(owner, 9)) && found.contains(&(owner, 100_000)),
            "the first, and the one that is named"
        );
        let crowd = (0..5_000u16).map(|number| (Address([number.to_be_bytes()[1]; 20]), u64::from(number)));
        assert_eq!(chosen(crowd, None).len(), MOST_ANCHORS);
    }
}

#[cfg(test)]
mod verdict_tests {
    use super::*;
    use crate::chain::SealerKind;

    #[test]
    fn each_doubt_has_its_own_words() {
        let at = |seconds| AnchoredAt { block: 3, hash: Hash([0; 32]), time: Timestamp::from_seconds(seconds) };
        let captured = Timestamp::from_seconds(1_000_000);
        let alone = SealedBy { kind: SealerKind::Embedded, alone: true, text: "one program".to_owned() };
        let many = SealedBy { alone: false, ..alone.clone() };
        let of =
            |seconds, sealed: &SealedBy, words: &[&str]| warnings(captured, Some(at(seconds)), Some(sealed), words);
        assert!(of(1_000_100, &many, &[]).is_empty());
        assert!(of(1_000_000, &alone, &[])[0].contains("one program"));
        assert!(of(1_093_784, &many, &[])[0].contains("1 d 2 h after its owner claims"));
        assert!(of(999_900, &many, &[])[0].contains("1 min 40 s after it was anchored"));
        assert!(of(1_000_000, &many, &["genesis", "contract"])[0].contains("--genesis or --contract"));
        assert!(warnings(captured, None, None, &[]).is_empty());
        assert_eq!((span(0), span(59), span(3_601)), ("0 s".into(), "59 s".into(), "1 h 1 s".into()));
    }
}
