//! Level (c): the state after a block contains the record's digest or its batch's root, and pinned signers sealed that
//! block. Besu's QBFT and IBFT 2.0 keep seals in the extra data, over the header with its round and without seals. The
//! hash of a header covers neither round nor seals.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use authros_crypto::{AccountSignature, keccak256, merkle::Leaf, recover_account};
use authros_model::{Address, Digest, Hash, Header, Timestamp};
use rlp::{Rlp, RlpStream};

use crate::bundle::{AnchorClaim, Anchoring, BundledRecord};
use crate::manifest::{is_canonical, text};
use crate::report::{Level, Reason, Standing};
use crate::state::{Storage, Unproven};
use crate::verify::Check;

const MIX: [u8; 32] = *b"ctical byzantine fault tolerance";
/// Rounds tried if the seals do not fit the header's own, to say what is wrong.
const ROUNDS_TRIED: u32 = 16;

/// How validators agree.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Protocol {
    /// QBFT, of Besu and GoQuorum.
    Qbft,
    /// IBFT 2.0, of Besu.
    Ibft2,
}

impl fmt::Display for Protocol {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Qbft => "QBFT",
            Self::Ibft2 => "IBFT 2.0",
        })
    }
}

/// Why the seals in a header are not those of such a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the variants and their messages name the fields")]
pub enum Flaw {
    #[error("its header has the seals of {have} of the {named} validators that it names, and {needed} are needed")]
    TooFew { have: usize, named: usize, needed: usize },
    #[error("{0} has sealed its header twice")]
    Twice(Address),
    #[error("its seals are of round {sealed}, and its header says round {said}")]
    Round { said: u32, sealed: u32 },
    #[error("a seal in its header is of no validator that it names: it was altered after it was sealed")]
    Altered,
}

/// So many of the validators must seal a block.
pub(crate) fn two_thirds(validators: usize) -> usize {
    validators.saturating_mul(2).div_ceil(3)
}

/// The extra data of such a header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Committed {
    /// The protocol.
    pub protocol: Protocol,
    /// The validators that it names; none if a contract of the network keeps them.
    pub validators: Vec<Address>,
    /// The round in which they agreed.
    pub round: u32,
    seals: Vec<[u8; SEAL]>,
    header: Vec<u8>,
}

impl Committed {
    /// From a header's RLP and its extra data: vanity, validators, vote, round, seals. A missing vote is an empty list
    /// under QBFT, and empty under IBFT 2.0; a round is a number under QBFT, and four bytes under IBFT 2.0.
    pub(crate) fn parse(header: &[u8], extra: &[u8]) -> Option<Self> {
        let list = Rlp::new(extra);
        if !is_canonical(extra) || list.item_count().ok()? != 5 || text(&list.at(0).ok()?)?.len() != VANITY {
            return None;
        }
        let (vote, round) = (list.at(2).ok()?, text(&list.at(3).ok()?)?);
        let without = vote.is_list() && vote.item_count().ok()? == 0;
        let (protocol, digits) = match round {
            [0, digits @ ..] if digits.len() == 3 && !without => (Protocol::Ibft2, digits),
            [0, ..] => return None,
            digits if digits.len() <= 3 && vote.is_list() => (Protocol::Qbft, digits),
            _ => return None,
        };
        let round = digits.iter().fold(0, |number, digit| (number << 8) | u32::from(*digit));
        let address = |item: Rlp<'_>| Some(Address(text(&item)?.try_into().ok()?));
        let seal = |item: Rlp<'_>| text(&item)?.try_into().ok();
        let (validators, seals) = (list.at(1).ok()?, list.at(4).ok()?);
        if !validators.is_list() || !seals.is_list() {
            return None;
        }
        Some(Self {
            protocol,
            validators: validators.iter().map(address).collect::<Option<_>>()?,
            round,
            seals: seals.iter().map(seal).collect::<Option<_>>()?,
            header: header.to_vec(),
        })
    }

    /// The block's hash: without seals, and without the round or with 0 as its round.
    pub(crate) fn block_hash(&self) -> Option<[u8; 32]> {
        self.hash(match self.protocol {
            Protocol::Qbft => Some(0),
            Protocol::Ibft2 => None,
        })
    }

    /// The header's hash with another round in its extra data, or none, and without seals.
    fn hash(&self, round: Option<u32>) -> Option<[u8; 32]> {
        let header = Rlp::new(&self.header);
        let extra = text(&header.at(EXTRA).ok()?)?;
        let list = Rlp::new(extra);
        let items = match (self.protocol, round) {
            (_, None) => 3,
            (Protocol::Ibft2, Some(_)) => 4,
            (Protocol::Qbft, Some(_)) => 5,
        };
        let mut unsealed = RlpStream::new_list(items);
        for at in 0..3 {
            unsealed.append_raw(list.at(at).ok()?.as_raw(), 1);
        }
        match (self.protocol, round) {
            (_, None) => {}
            (Protocol::Qbft, Some(round)) => {
                unsealed.append(&round).begin_list(0);
            }
            (Protocol::Ibft2, Some(round)) => {
                unsealed.append(&&round.to_be_bytes()[..]);
            }
        }
        with_extra(&header, &unsealed.out())
    }

    /// The hash that its validators signed.
    pub fn signed(&self) -> Option<[u8; 32]> {
        self.hash(Some(self.round))
    }

    pub(crate) fn count(&self) -> usize {
        self.seals.len()
    }

    pub(crate) fn seals(&self, pinned: &[Address]) -> Seals {
        let mut found = Seals { committed: Some(self.protocol), ..Seals::default() };
        match self.sealers(pinned) {
            Ok(sealers) => {
                found.stranger = sealers.iter().find(|sealer| !pinned.contains(sealer)).copied();
                found.pinned = sealers.into_iter().filter(|sealer| pinned.contains(sealer)).collect();
            }
            Err(flaw) => found.flaw = Some(flaw),
        }
        found
    }

    fn sealers(&self, pinned: &[Address]) -> Result<BTreeSet<Address>, Flaw> {
        let signed = self.signed().ok_or(Flaw::Altered)?;
        let mut sealers = BTreeSet::new();
        for seal in &self.seals {
            let sealer = recovered(&signed, seal).filter(|sealer| {
                // Nothing tells a stranger from an altered header if it names no validators.
                self.validators.is_empty() || self.validators.contains(sealer)
            });
            let sealer = sealer.ok_or_else(|| self.misfit(seal, &self.validators))?;
            if !sealers.insert(sealer) {
                return Err(Flaw::Twice(sealer));
            }
        }
        let (have, named) = (sealers.len(), self.validators.len());
        let needed = two_thirds(named);
        if have < needed {
            return Err(Flaw::TooFew { have, named, needed });
        }
        match self.seals.first() {
            Some(seal) if self.validators.is_empty() && !sealers.iter().any(|sealer| pinned.contains(sealer)) => {
                match self.misfit(seal, pinned) {
                    flaw @ Flaw::Round { .. } => Err(flaw),
                    Flaw::TooFew { .. } | Flaw::Twice(_) | Flaw::Altered => Ok(sealers),
                }
            }
            _ => Ok(sealers),
        }
    }

    /// Why a seal is by none of these: it was made in another round, or its header was altered.
    fn misfit(&self, seal: &[u8; SEAL], those: &[Address]) -> Flaw {
        let made = |round: &u32| {
            let sealer = self.hash(Some(*round)).and_then(|signed| recovered(&signed, seal));
            sealer.is_some_and(|sealer| those.contains(&sealer))
        };
        let sealed = (0..=ROUNDS_TRIED).filter(|round| *round != self.round).find(made);
        sealed.map_or(Flaw::Altered, |sealed| Flaw::Round { said: self.round, sealed })
    }
}

/// The validators named in extra data under QBFT, IBFT 2.0 and the first IBFT; none if a contract keeps them.
pub fn validators_in(extra: &[u8]) -> Vec<Address> {
    let address = |item: Rlp<'_>| Some(Address(text(&item)?.try_into().ok()?));
    let named = |list: &[u8], items: usize, at: usize| {
        let list = Rlp::new(list);
        let validators = list.at(at).ok().filter(Rlp::is_list)?;
        let is_such = list.is_list() && list.item_count() == Ok(items);
        if is_such { validators.iter().map(address).collect::<Option<Vec<_>>>() } else { None }
    };
    let whole = is_canonical(extra).then(|| named(extra, 5, 1)).flatten();
    let first = || {
        let rest = extra.get(VANITY..).filter(|rest| is_canonical(rest))?;
        named(rest, 3, 0)
    };
    whole.or_else(first).unwrap_or_default()
}

/// The account whose key made a seal (r, s, parity) over a hash.
fn recovered(signed: &[u8; 32], seal: &[u8; SEAL]) -> Option<Address> {
    let mut seal = *seal;
    let parity = seal.last_mut()?;
    *parity = parity.checked_add(27)?;
    recover_account(signed, &AccountSignature(seal)).ok()
}

fn with_extra(header: &Rlp<'_>, extra: &[u8]) -> Option<[u8; 32]> {
    let fields = header.item_count().ok()?;
    let mut out = RlpStream::new_list(fields);
    for at in 0..fields {
        match at {
            EXTRA => out.append(&extra),
            _ => out.append_raw(header.at(at).ok()?.as_raw(), 1),
        };
    }
    Some(keccak256(&[&out.out()]))
}

/// The longest header, bytes; including a list of a hundred validators and the seals of two thirds of them.
pub const LONGEST_HEADER: usize = 8192;
/// The part of the extra data before the seal.
const VANITY: usize = 32;
const SEAL: usize = 65;
const EXTRA: usize = 12;
const ADDRESS: usize = 20;
/// The vanity of a block of AuthROS's own chain.
const OURS: &[u8] = b"AuthROS chain file version ";

/// A header, parsed as far as evidence needs it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BlockHeader {
    /// Its hash: the block's.
    pub hash: Hash,
    /// The hash of the block before.
    pub parent: Hash,
    /// The root of the state after it.
    pub state_root: Hash,
    /// Its number.
    pub number: u64,
    /// Its time, seconds, by its sealer's clock.
    pub timestamp: u64,
    extra: Vec<u8>,
    seal_hash: Option<[u8; 32]>,
    committed: Option<Committed>,
}

impl BlockHeader {
    /// From its RLP. Each fork of Ethereum adds fields at the end; they are hashed as they are.
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        let list = Rlp::new(bytes);
        let fields = list.item_count().ok()?;
        if bytes.len() > LONGEST_HEADER || !is_canonical(bytes) || !(15..=32).contains(&fields) {
            return None;
        }
        let hash = |at: usize| list.at(at).ok().and_then(|hash| Hash::from_slice(text(&hash)?));
        let extra = text(&list.at(EXTRA).ok()?)?.to_vec();
        let (number, mix) = (list.val_at(8).ok()?, text(&list.at(13).ok()?)?);
        // The genesis block's hash is that of its bytes, whatever its extra data has.
        let committed = if mix == MIX && number > 0 { Committed::parse(bytes, &extra) } else { None };
        let block_hash = match &committed {
            Some(committed) => committed.block_hash()?,
            None => keccak256(&[bytes]),
        };
        Some(Self {
            hash: Hash(block_hash),
            parent: hash(0)?,
            state_root: hash(3)?,
            number,
            timestamp: list.val_at(11).ok()?,
            seal_hash: if mix == [0; 32] { seal_hash(&list, &extra) } else { None },
            extra,
            committed,
        })
    }

    /// Who sealed it, under proof of authority as in Clique (EIP-225); `None` if it has no such seal.
    pub fn sealer(&self) -> Option<Address> {
        let seal = self.extra.get(self.extra.len().checked_sub(SEAL)?..)?.try_into().ok()?;
        recovered(&self.seal_hash?, seal)
    }

    /// The seals of QBFT and IBFT 2.0; `None` under another consensus.
    pub fn committed(&self) -> Option<&Committed> {
        self.committed.as_ref()
    }

    pub(crate) fn sealed_by(&self) -> String {
        match (&self.committed, self.sealer()) {
            (Some(committed), _) => format!("{} validators ({})", committed.count(), committed.protocol),
            (None, Some(sealer)) => sealer.to_string(),
            (None, None) => "no one whose seal can be checked".to_owned(),
        }
    }

    /// Whether it says that it is from one of AuthROS's own chains, which one program seals with the keys of one home.
    pub fn is_ours(&self) -> bool {
        self.extra.starts_with(OURS)
    }
}

/// What a Clique signer signs: all but the seal. Between vanity and seal there are whole addresses or nothing.
fn seal_hash(list: &Rlp<'_>, extra: &[u8]) -> Option<[u8; 32]> {
    let between = extra.len().checked_sub(VANITY + SEAL)?;
    if between % ADDRESS != 0 {
        return None;
    }
    with_extra(list, extra.get(..VANITY + between)?)
}

/// The pinned signers who sealed a block or built on it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Seals {
    /// The pinned ones.
    pub pinned: BTreeSet<Address>,
    /// The first one not pinned.
    pub stranger: Option<Address>,
    /// Whether the block itself has no verifiable seal.
    pub unsigned: bool,
    /// The protocol, if the seals are in the block's own header.
    pub committed: Option<Protocol>,
    /// What is wrong with these.
    pub flaw: Option<Flaw>,
}

/// Under QBFT and IBFT 2.0 the seals in the block's own header. Under Clique those on it and on its successors in the
/// bundle, until all pinned signers are found, over at most four headers for each of them and sixteen more.
pub fn seals(headers: &BTreeMap<u64, BlockHeader>, first: u64, pinned: &[Address]) -> Seals {
    if let Some(committed) = headers.get(&first).and_then(BlockHeader::committed) {
        return committed.seals(pinned);
    }
    let mut found = Seals::default();
    let mut parent = None;
    let most = pinned.len().saturating_mul(4).saturating_add(16);
    for (number, header) in headers.range(first..).take(most) {
        let follows = match parent {
            None => *number == first,
            Some((number_before, hash)) => header.parent == hash && Some(*number) == u64::checked_add(number_before, 1),
        };
        if !follows {
            break;
        }
        match header.sealer() {
            Some(sealer) if pinned.contains(&sealer) => {
                found.pinned.insert(sealer);
            }
            Some(sealer) => {
                found.stranger = Some(sealer);
                break;
            }
            None => {
                found.unsigned = parent.is_none();
                break;
            }
        }
        if found.pinned.len() >= pinned.len() {
            break;
        }
        parent = Some((*number, header.hash));
    }
    found
}

pub(crate) struct Anchored<'a> {
    pub storage: Storage<'a>,
    pub shown_at: u64,
    pub block: u64,
    /// Its time, seconds, if shown.
    pub time: Option<u64>,
    pub account: Address,
    /// The version of that account's keys then, if the contract stores it.
    pub keys: Option<u64>,
    /// The version of the owner's keys named by the exporter.
    pub claimed_keys: u64,
}

type Found<'a> = Result<(Anchored<'a>, &'a BlockHeader), Level>;

pub(crate) fn anchored<'a>(
    check: &Check<'a>,
    digest: Digest,
    header: &Header,
    record: &'a BundledRecord,
) -> (Level, Option<Anchored<'a>>) {
    let Some(claim) = &record.anchor else {
        return (Level::unproven(Reason::NotAnchored, "it was not on a chain when it was exported"), None);
    };
    match find(check, digest, header, claim) {
        Err(level) => (level, None),
        Ok((anchored, shown_at)) => {
            let place = (anchored.shown_at, anchored.block, anchored.time);
            let level = check.known.sealings.get(place, || sealed(check, &anchored, shown_at));
            (level, Some(anchored))
        }
    }
}

fn find<'a>(check: &Check<'a>, digest: Digest, header: &Header, claim: &'a AnchorClaim) -> Found<'a> {
    let (leaf, at) = (Leaf::of(header, digest), claim.shown_at);
    if !check.known.leads(&leaf, claim) {
        return Err(Level::refused(Reason::WrongPath, "its path does not lead to the root it names"));
    }
    let no_header = || Level::unproven(Reason::HeaderMissing, format!("the header of block {at} is not in the bundle"));
    let shown_at = check.bundle.headers.get(&at).ok_or_else(no_header)?;
    let unshown = |why: Unproven, what: String| match why {
        Unproven::Missing(_) => Level::unproven(Reason::StateMissing, format!("{what} is not in the bundle")),
        why => Level::refused(Reason::StateBroken, format!("after block {at}: {why}")),
    };
    let storage = || Storage::of(&check.bundle.nodes, shown_at.state_root, check.contract);
    let storage = check.known.storages.get(shown_at.number, storage);
    let storage = storage.map_err(|why| unshown(why, format!("the state after block {at}")))?;
    if check.trust.is_some_and(|trust| trust.chain.code_hash != storage.code_hash) {
        return Err(Level::refused(Reason::OtherCode, "the contract's code is not the code you pinned"));
    }
    let found = in_state((check, &storage), digest, header, claim, shown_at)
        .map_err(|why| unshown(why, format!("the part of the state after block {at} that holds its anchor")))?;
    let nothing =
        || Level::refused(Reason::AnchorMissing, format!("the state after block {at} does not contain its anchor"));
    compare(found.ok_or_else(nothing)?, claim, shown_at)
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
            let word = known.anchors.get((shown_at, *account, *root), || storage.anchor(*account, *root))?;
            let Some(word) = word else { return Ok(None) };
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
        let text = "its path was made for a different number of leaves than the chain has";
        return Err(Level::refused(Reason::OtherAnchor, text));
    }
    let (found, said) = (anchored.block, claim.block);
    if found < said && claimed == Some(1) {
        // The contract stores only a root's first block. A batch of one whose block was skipped has no other root.
        let text =
            format!("the state has it in block {found}; no state shows that it was anchored again in block {said}");
        return Err(Level::unproven(Reason::FirstBlockOnly, text));
    }
    if found != said {
        let text = format!("the chain has it in block {found}, the bundle says {said}");
        return Err(Level::refused(Reason::OtherAnchor, text));
    }
    if anchored.block > shown_at.number || anchored.time.is_some_and(|time| time > shown_at.timestamp) {
        let text = "the state dates its anchor to a block later than the state itself";
        return Err(Level::refused(Reason::OtherAnchor, text));
    }
    Ok((anchored, shown_at))
}

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
        return Level::unproven(Reason::NoTrust, text);
    };
    let found = || seals(&check.bundle.headers, shown_at.number, &trust.chain.signers);
    let found = check.known.seals.get(shown_at.number, found);
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
            format!("{text}: the exporter's self-sealed chain, which proves nothing against the exporter"),
        );
    }
    Level::proven(text)
}

/// Nothing contradicts a trust file that names nobody, and nothing is proven by it.
fn nobody_pinned(what: &str, at: &str, shown_at: &BlockHeader) -> String {
    let who = shown_at.sealed_by();
    format!("{what}{at}, sealed by {who}: the trust file pins no signers, so this proves nothing")
}

fn too_few(found: &Seals, shown_at: &BlockHeader, (all, what): (usize, String), counted: String) -> Level {
    let number = shown_at.number;
    match (found.flaw, found.committed, found.stranger) {
        (Some(flaw), Some(protocol), _) => {
            let text = format!("block {number} is not sealed as {protocol} demands: {flaw}");
            Level::refused(Reason::BrokenSeals, text)
        }
        _ if all == 0 && !found.unsigned => Level::unproven(Reason::NoSigners, counted),
        (_, _, Some(stranger)) if found.pinned.is_empty() => {
            let text = format!("block {number} is sealed by {stranger}, who is not a signer you pinned");
            Level::refused(Reason::OtherSigner, text)
        }
        _ if found.unsigned => {
            let text = format!(
                "{what}; its header has no seal that this version can check (it checks those of Clique, QBFT and IBFT \
                 2.0): a development node, proof of work or another consensus"
            );
            Level::unproven(Reason::NoSeal, text)
        }
        _ => Level::unproven(Reason::FewSigners, counted),
    }
}
