//! The check of an export folder by somebody without home or keys, against a chain that they trust.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::chain::{Chain, ChainError, ChainOptions, Endpoint, Event, Pin};
use crate::crypto::{ProviderName, domain, provider, signer_id};
use crate::model::{Address, Digest, ErrorKind, Timestamp};
use crate::pipeline::Directory;
use crate::pipeline::export_folder::{AnchorWord, ExportFolder, VerifyStep};
use crate::service::failure::input;
use crate::service::reply::Failure;

/// What a check of a folder found.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FolderCheck {
    /// Whether every step was done and holds.
    pub ok: bool,
    /// SM3 of the record.
    pub digest: Digest,
    /// Whose it is.
    pub owner: Address,
    /// When it was captured, as its owner says.
    pub captured_at: Timestamp,
    /// Step by step.
    pub steps: Vec<VerifyStep>,
    /// The kind of error that the exit code follows from; `None` where all holds.
    pub worst: Option<ErrorKind>,
}

/// Checks a folder; `url` is the chain's, `contract` goes before what the folder names.
///
/// # Errors
/// `Input` where the folder is none. That the chain does not answer is told in the steps.
pub async fn verify(folder: &Path, url: Option<&str>, contract: Option<Address>) -> Result<FolderCheck, Failure> {
    let folder =
        tokio::task::block_in_place(|| ExportFolder::read(folder)).map_err(|error| input(error.to_string()))?;
    let provider = provider(ProviderName::RustCrypto);
    let mut steps = folder.check(provider);
    let mut worst = None;
    match url {
        Some(url) => {
            if let Err(error) = ask(&folder, url, contract, &mut steps).await {
                worst = Some(error.kind());
                steps.push(VerifyStep::open("chain", &error.to_string()));
            }
        }
        None => {
            worst = Some(ErrorKind::Incomplete);
            steps.push(VerifyStep::open("chain", "not asked: give --chain URL of a node that you trust"));
        }
    }
    if steps.iter().any(|step| step.ok == Some(false)) {
        worst = Some(ErrorKind::Tampered);
    } else if worst.is_none() && steps.iter().any(|step| step.ok.is_none()) {
        worst = Some(ErrorKind::Incomplete);
    }
    Ok(FolderCheck {
        ok: worst.is_none(),
        digest: folder.digest(provider),
        owner: folder.header.owner,
        captured_at: folder.header.captured_at,
        steps,
        worst,
    })
}

async fn ask(
    folder: &ExportFolder,
    url: &str,
    contract: Option<Address>,
    steps: &mut Vec<VerifyStep>,
) -> Result<(), ChainError> {
    let endpoint = Endpoint::Node { url: url.to_owned() };
    let options = ChainOptions { endpoint, contract: None, pinned: None, confirmations: 1 };
    let chain = Chain::connect(options).await?;
    let proof = &folder.proof;
    let same = (chain.chain_id(), chain.genesis()) == (proof.chain_id, proof.genesis);
    let text = format!("chain id {}, genesis {}", chain.chain_id(), chain.genesis());
    steps.push(VerifyStep::new("chain", same, &text));
    let Some(contract) = contract.or(proof.contract) else {
        steps.push(VerifyStep::open("contract", "proof.json names none: give --contract ADDRESS"));
        return Ok(());
    };
    let pin = match chain.use_contract(contract).await {
        Ok(pin) => pin,
        Err(ChainError::NotTheContract(_)) => {
            let text = format!("what is at {contract} is not the AuthROS contract that this program knows");
            steps.push(VerifyStep::new("contract", false, &text));
            return Ok(());
        }
        Err(error) => return Err(error),
    };
    let bound = domain(pin.chain_id, &pin.genesis, &pin.contract);
    let text = format!("{contract}; the record is bound to this chain and contract");
    steps.push(VerifyStep::new("contract", bound == folder.header.domain, &text));
    if !same || bound != folder.header.domain {
        return Ok(());
    }
    let Some(block) = anchored(folder, &chain, steps).await? else { return Ok(()) };
    registered(folder, &chain, &pin, block, steps).await
}

/// Where the chain has the record's anchor.
async fn anchored(
    folder: &ExportFolder,
    chain: &Chain,
    steps: &mut Vec<VerifyStep>,
) -> Result<Option<u64>, ChainError> {
    let anchor = &folder.proof.anchor;
    let Some(claimed) = anchor.block else {
        steps.push(VerifyStep::open(
            "anchor",
            "the record was in no block when it was exported; ask for a later export",
        ));
        return Ok(None);
    };
    let digest = folder.proof.digest;
    let found = match anchor.mode {
        AnchorWord::Each => chain.uploaded_at(folder.header.owner, digest).await?,
        AnchorWord::Batch => batch_block(folder, chain, claimed).await?,
    };
    let hash = chain.block(claimed).await?.map(|block| block.hash);
    let same_hash = anchor.block_hash.is_none_or(|claimed| hash == Some(claimed));
    let (ok, text) = match found {
        Some(block) if block == claimed && same_hash => (true, format!("the chain has it in block {block}")),
        Some(block) if block == claimed => (false, format!("block {block} is another one than proof.json names")),
        Some(block) => (false, format!("the chain has it in block {block}, proof.json says {claimed}")),
        None => (false, "the chain does not have it".to_owned()),
    };
    steps.push(VerifyStep::new("anchor", ok, &text));
    Ok(found.filter(|_| ok))
}

/// The block in which somebody anchored the record's root over as many leaves as its path was made for.
async fn batch_block(folder: &ExportFolder, chain: &Chain, claimed: u64) -> Result<Option<u64>, ChainError> {
    let Some(inclusion) = folder.proof.inclusion() else { return Ok(None) };
    for at in chain.events(claimed, claimed).await? {
        let Event::Anchored { account, root, count, .. } = at.event else { continue };
        if (root, count) == (inclusion.root, inclusion.count)
            && let Some((block, counted)) = chain.root_anchored(account, root).await?
            && counted == count
        {
            return Ok(Some(block));
        }
    }
    Ok(None)
}

/// Whether the signer could sign for the owner at that block.
async fn registered(
    folder: &ExportFolder,
    chain: &Chain,
    pin: &Pin,
    block: u64,
    steps: &mut Vec<VerifyStep>,
) -> Result<(), ChainError> {
    let directory = Directory::new(folder.header.domain, provider(ProviderName::RustCrypto));
    for at in chain.changes(pin.deployed_at, block).await? {
        directory.apply(&at);
    }
    let (owner, signer) = (folder.header.owner, signer_id(&folder.signer));
    let own = directory.signing_key(owner, signer, Some(block)) == Some(folder.signer);
    let lent = directory.is_lent(owner, signer, Some(block), folder.header.captured_at);
    let text = match (own, lent) {
        (true, _) => format!("the signer's key was {owner}'s at block {block}"),
        (false, true) => format!("the signer is a device that {owner} had lent at block {block}"),
        (false, false) => format!("{owner} had not registered the signer's key at block {block}, nor lent it"),
    };
    steps.push(VerifyStep::new("registration", own || lent, &text));
    Ok(())
}
