//! Headers of blocks, as on the chain: their hash, and who sealed them.

use std::collections::{BTreeMap, BTreeSet};

use authros_crypto::keccak256;
use authros_model::{Address, Hash};
use rlp::Rlp;

use crate::committed::{Committed, Flaw, MIX, Protocol, recovered, with_extra};
use crate::form::{is_canonical, text};

/// The longest header, bytes; including a list of a hundred validators and the seals of two thirds of them.
pub const LONGEST_HEADER: usize = 8192;
/// The part of the extra data before the seal.
pub(crate) const VANITY: usize = 32;
/// Length of a seal: r, s, parity.
pub(crate) const SEAL: usize = 65;
/// The field with the extra data.
pub(crate) const EXTRA: usize = 12;
/// Length of a signer's address.
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
    /// The data signed by a Clique signer; `None` if it is of another consensus.
    seal_hash: Option<[u8; 32]>,
    /// What QBFT and IBFT 2.0 add to it; `None` if it is of another consensus.
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

    /// What QBFT and IBFT 2.0 add to a header; `None` if it is of another consensus.
    pub fn committed(&self) -> Option<&Committed> {
        self.committed.as_ref()
    }

    /// Who sealed it, in words, whether pinned or not.
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

/// The data signed by a Clique signer: everything except the seal. Between vanity and seal there are whole addresses or
/// nothing.
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

/// The seals on a block. Under QBFT and IBFT 2.0 its own header has them. Under Clique they are those on it and on the
/// blocks that follow it in the bundle, each naming the previous one as its parent; until all pinned signers are found,
/// over at most four headers for each of them and sixteen more.
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
