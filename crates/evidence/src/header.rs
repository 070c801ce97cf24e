//! Headers of blocks, as on the chain: their hash, and who sealed them.

use std::collections::{BTreeMap, BTreeSet};

use authros_crypto::{AccountSignature, keccak256, recover_account};
use authros_model::{Address, Hash};
use rlp::{Rlp, RlpStream};

/// The longest header, bytes; including a list of a hundred signers.
pub const LONGEST_HEADER: usize = 4096;
/// The part of the extra data before the seal.
const VANITY: usize = 32;
/// Length of a seal: r, s, parity.
const SEAL: usize = 65;
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
}

impl BlockHeader {
    /// From its RLP. Each fork of Ethereum adds fields at the end; they are hashed as they are.
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        let list = Rlp::new(bytes);
        let whole = list.payload_info().ok().and_then(|info| info.header_len.checked_add(info.value_len));
        let fields = list.item_count().ok()?;
        if bytes.len() > LONGEST_HEADER || whole != Some(bytes.len()) || !(15..=32).contains(&fields) {
            return None;
        }
        let hash = |at: usize| list.at(at).ok().and_then(|hash| Hash::from_slice(hash.data().ok()?));
        let extra = list.at(12).ok()?.data().ok()?.to_vec();
        Some(Self {
            hash: Hash(keccak256(&[bytes])),
            parent: hash(0)?,
            state_root: hash(3)?,
            number: list.val_at(8).ok()?,
            timestamp: list.val_at(11).ok()?,
            seal_hash: seal_hash(&list, fields, &extra),
            extra,
        })
    }

    /// Who sealed it, under proof of authority as in Clique (EIP-225); `None` if it has no such seal.
    pub fn sealer(&self) -> Option<Address> {
        let mut seal: [u8; SEAL] = self.extra.get(self.extra.len().checked_sub(SEAL)?..)?.try_into().ok()?;
        let parity = seal.last_mut()?;
        *parity = parity.checked_add(27)?;
        recover_account(&self.seal_hash?, &AccountSignature(seal)).ok()
    }

    /// Whether it says that it is from one of AuthROS's own chains, which one program seals with the keys of one home.
    pub fn is_ours(&self) -> bool {
        self.extra.starts_with(OURS)
    }
}

/// The data signed by a Clique signer: everything except the seal. Its mix hash is zero, and between vanity and seal
/// there are whole addresses or nothing; QBFT and IBFT have other contents there.
fn seal_hash(list: &Rlp<'_>, fields: usize, extra: &[u8]) -> Option<[u8; 32]> {
    let between = extra.len().checked_sub(VANITY + SEAL)?;
    if between % ADDRESS != 0 || list.at(13).ok()?.data().ok()? != [0; 32] {
        return None;
    }
    let unsealed = extra.get(..VANITY + between)?;
    let mut out = RlpStream::new_list(fields);
    for at in 0..fields {
        match at {
            12 => out.append(&unsealed),
            _ => out.append_raw(list.at(at).ok()?.as_raw(), 1),
        };
    }
    Some(keccak256(&[&out.out()]))
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
}

/// The seals on a block and on those that follow it in the bundle, each naming the previous one as its parent; until
/// all pinned signers are found, over at most four headers for each of them and sixteen more.
pub fn seals(headers: &BTreeMap<u64, BlockHeader>, first: u64, pinned: &[Address]) -> Seals {
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
