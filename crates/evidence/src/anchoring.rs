//! Level (c): the state after a block contains the record's digest or its batch's root, and the pinned signers sealed
//! that block.

use authros_crypto::merkle::Leaf;
use authros_model::{Address, Digest, Header, Timestamp};

use crate::bundle::{AnchorClaim, Anchoring, BundledRecord};
use crate::header::{BlockHeader, Seals};
use crate::report::{Level, Standing};
use crate::state::{Storage, Unproven};
use crate::verify::Check;

/// An anchor shown by the state.
pub(crate) struct Anchored<'a> {
    /// The contract's storage that shows it.
    pub storage: Storage<'a>,
    /// After which block.
    pub shown_at: u64,
    /// The anchoring block.
    pub block: u64,
    /// Its time, seconds, if shown.
    pub time: Option<u64>,
    /// Who anchored it.
    pub account: Address,
    /// The version of that account's keys then, if the contract stores it.
    pub keys: Option<u64>,
    /// The version of the owner's keys named by the exporter.
    pub claimed_keys: u64,
}

/// What the state says about a record's anchor.
enum Found<'a> {
    Shown(Anchored<'a>, &'a BlockHeader),
    Not(Level),
}

/// Level (c), and the anchor if the state shows it.
pub(crate) fn anchored<'a>(
    check: &Check<'a>,
    digest: Digest,
    header: &Header,
    record: &'a BundledRecord,
) -> (Level, Option<Anchored<'a>>) {
    let Some(claim) = &record.anchor else {
        return (Level::new(Standing::Unproven, "it was not on a chain when it was exported"), None);
    };
    match find(check, digest, header, claim) {
        Found::Not(level) => (level, None),
        Found::Shown(anchored, shown_at) => {
            let level = check.known.sealing(&anchored, || sealed(check, &anchored, shown_at));
            (level, Some(anchored))
        }
    }
}

fn refused(text: impl Into<String>) -> Found<'static> {
    Found::Not(Level::new(Standing::Refused, text))
}

fn unproven(text: impl Into<String>) -> Found<'static> {
    Found::Not(Level::new(Standing::Unproven, text))
}

fn find<'a>(check: &Check<'a>, digest: Digest, header: &Header, claim: &'a AnchorClaim) -> Found<'a> {
    let leaf = Leaf::of(header, digest);
    if !check.known.leads(&leaf, claim) {
        return refused("its path does not lead to the root it names");
    }
    let Some(shown_at) = check.bundle.headers.get(&claim.shown_at) else {
        return unproven(format!("the header of block {} is not in the bundle", claim.shown_at));
    };
    let storage = match check.known.storage(check, shown_at) {
        Ok(storage) => storage,
        Err(Unproven::Missing(_)) => {
            return unproven(format!("the state after block {} is not in the bundle", claim.shown_at));
        }
        Err(why) => return refused(format!("after block {}: {why}", claim.shown_at)),
    };
    if let Some(trust) = check.trust
        && trust.chain.code_hash != storage.code_hash
    {
        return refused("the contract's code is not the code you pinned");
    }
    match in_state((check, &storage), digest, header, claim, shown_at) {
        Ok(found) => found.map_or_else(
            || refused(format!("the state after block {} does not contain its anchor", claim.shown_at)),
            |found| compare(found, claim, shown_at),
        ),
        Err(Unproven::Missing(_)) => unproven(format!(
            "the part of the state after block {} that holds its anchor is not in the bundle",
            claim.shown_at
        )),
        Err(why) => refused(format!("after block {}: {why}", claim.shown_at)),
    }
}

/// An anchor with the number of leaves given by the state; `None` if it is a digest by itself.
type Counted<'a> = (Anchored<'a>, Option<u64>);

fn in_state<'a>(
    (check, storage): (&Check<'a>, &Storage<'a>),
    digest: Digest,
    header: &Header,
    claim: &AnchorClaim,
    shown_at: &BlockHeader,
) -> Result<Option<Counted<'a>>, Unproven> {
    // The contract stores no time of a digest by itself: it is known if the block is the one whose state this is.
    let own_time = |block: u64| (block == shown_at.number).then_some(shown_at.timestamp);
    let (storage, shown_at, claimed_keys) = (*storage, shown_at.number, claim.keys);
    let known = &check.known;
    let anchored =
        |block, time, account, keys| Anchored { storage, shown_at, block, time, account, keys, claimed_keys };
    match &claim.anchor {
        Anchoring::Each {} => {
            let block = storage.uploaded(header.owner, &digest.0)?;
            Ok(block.map(|block| (anchored(block, own_time(block), header.owner, None), None)))
        }
        Anchoring::Batch { account, root, .. } => {
            let Some(word) = known.anchor((shown_at, &storage), *account, *root)? else { return Ok(None) };
            // The contract never stores a time of zero: a word without one shows none.
            let time = Some(word.time).filter(|time| *time > 0);
            Ok(Some((anchored(word.block, time, *account, Some(word.keys)), Some(word.count))))
        }
    }
}

fn compare<'a>((anchored, counted): Counted<'a>, claim: &AnchorClaim, shown_at: &'a BlockHeader) -> Found<'a> {
    let claimed = match &claim.anchor {
        Anchoring::Each {} => None,
        Anchoring::Batch { count, .. } => Some(*count),
    };
    if counted != claimed {
        return refused("its path was made for a different number of leaves than the chain has");
    }
    let (found, said) = (anchored.block, claim.block);
    if found < said && claimed == Some(1) {
        // The contract stores only a root's first block. A batch of one whose block was skipped has no other root.
        return unproven(format!(
            "the state has it in block {found}; no state shows that it was anchored again in block {said}"
        ));
    }
    if found != said {
        return refused(format!("the chain has it in block {found}, the bundle says {said}"));
    }
    if anchored.block > shown_at.number || anchored.time.is_some_and(|time| time > shown_at.timestamp) {
        return refused("the state dates its anchor to a block later than the state itself");
    }
    Found::Shown(anchored, shown_at)
}

/// Who sealed the block that shows it.
fn sealed(check: &Check<'_>, anchored: &Anchored<'_>, shown_at: &BlockHeader) -> Level {
    let time = anchored
        .time
        .map_or_else(|| "at an unknown time".to_owned(), |time| format!("at {}", Timestamp::from_seconds(time)));
    let what = format!("anchored in block {} {time}", anchored.block);
    let at = if anchored.block == shown_at.number {
        String::new()
    } else {
        format!(", as block {} has it", shown_at.number)
    };
    let Some(trust) = check.trust else {
        let who = shown_at.sealed_by();
        let text = format!("{what}{at}, sealed by {who}: you pinned no signers, so this proves nothing yet");
        return Level::new(Standing::Unproven, text);
    };
    let found = check.known.seals(check, shown_at, &trust.chain.signers);
    let quorum = if found.committed.is_some() { trust.commit_quorum() } else { trust.quorum() };
    let (have, all) = (found.pinned.len(), trust.chain.signers.len());
    let how = found.committed.map_or_else(String::new, |protocol| format!(" in its own header ({protocol})"));
    let text = format!("{what}{at}, sealed by {have} of {all} pinned signers{how}");
    if have < quorum {
        let counted =
            if all > 0 { format!("{text}; {quorum} are required") } else { nobody_pinned(&what, &at, shown_at) };
        return too_few(&found, shown_at, (all, format!("{what}{at}")), counted);
    }
    if trust.chain.sealed_by_exporter || shown_at.is_ours() {
        return Level::new(
            Standing::OwnChain,
            format!("{text}: the exporter's own chain, which proves nothing against the exporter"),
        );
    }
    Level::new(Standing::Proven, text)
}

/// Nothing contradicts a trust file that names nobody, and nothing is proven by it.
fn nobody_pinned(what: &str, at: &str, shown_at: &BlockHeader) -> String {
    let who = shown_at.sealed_by();
    format!("{what}{at}, sealed by {who}: the trust file pins no signers, so this proves nothing")
}

/// Why the seals on a block are not enough; `all` is the number of pinned signers.
fn too_few(found: &Seals, shown_at: &BlockHeader, (all, what): (usize, String), counted: String) -> Level {
    let number = shown_at.number;
    match (found.flaw, found.committed, found.stranger) {
        (Some(flaw), Some(protocol), _) => {
            Level::new(Standing::Refused, format!("block {number} is not sealed as {protocol} demands: {flaw}"))
        }
        _ if all == 0 && !found.unsigned => Level::new(Standing::Unproven, counted),
        (_, _, Some(stranger)) if found.pinned.is_empty() => Level::new(
            Standing::Refused,
            format!("block {number} is sealed by {stranger}, who is not a signer you pinned"),
        ),
        _ if found.unsigned => Level::new(
            Standing::Unproven,
            format!(
                "{what}; its header has no seal that this version can check (it checks those of Clique, QBFT and IBFT 2.0): a \
                 development node, proof of work or another consensus"
            ),
        ),
        _ => Level::new(Standing::Unproven, counted),
    }
}
