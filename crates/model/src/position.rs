//! What an owner states to a witness about its chain and recorder, and the witness's countersignature over it. Each has
//! one length, so that nothing has to be bounded.

use crate::bytes::{Digest, Hash, PublicKey, RecorderId, Signature};
use crate::wire::{Reader, WireError};
use crate::{Address, Timestamp};

/// The version of the form.
const VERSION: u8 = 1;
/// The most roots of batches under one top.
const MOST_ROOTS: u64 = 1 << 14;
const NO_HASH: Hash = Hash([0; 32]);

/// How far an owner's chain and recorder are, as the owner says: version 1 (1) || chain id (8) || genesis (32) || contract
/// (20) || owner (20) || key (64) || recorder (16) || block (8) || its hash (32) || earlier block (8) || its hash (32) ||
/// top (32) || count (8) || head (32) || head's number (8).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Position {
    /// The chain (EIP-155).
    pub chain_id: u64,
    /// Hash of its block 0.
    pub genesis: Hash,
    /// The contract.
    pub contract: Address,
    /// The account that anchors the batches.
    pub owner: Address,
    /// The key that signs this.
    pub key: PublicKey,
    /// The ledger.
    pub recorder: RecorderId,
    /// The newest confirmed block that anchors one of the batches; not 0.
    pub block: u64,
    /// Its hash.
    pub block_hash: Hash,
    /// The block that the witness countersigned last, and its hash on the chain now: zeros if the chain has no such block.
    /// `None` if the witness countersigned nothing yet.
    pub earlier: Option<(u64, Hash)>,
    /// The root of the tree over the roots of batches anchored since.
    pub top: Hash,
    /// How many there are, 1 to 16,384.
    pub count: u64,
    /// The recorder's newest confirmed head, and its number among the recorder's own statements.
    pub head: Option<(u64, Digest)>,
}

impl Position {
    /// Length of its encoding, bytes.
    pub const LENGTH: usize = 321;

    /// Its encoding.
    pub fn encode(&self) -> Vec<u8> {
        let (earlier, earlier_hash) = self.earlier.unwrap_or((0, NO_HASH));
        let (head_number, head) = self.head.unwrap_or((0, Digest([0; Digest::LENGTH])));
        let parts: [&[u8]; 15] = [
            &[VERSION],
            &self.chain_id.to_be_bytes(),
            &self.genesis.0,
            &self.contract.0,
            &self.owner.0,
            &self.key.0,
            &self.recorder.0,
            &self.block.to_be_bytes(),
            &self.block_hash.0,
            &earlier.to_be_bytes(),
            &earlier_hash.0,
            &self.top.0,
            &self.count.to_be_bytes(),
            &head.0,
            &head_number.to_be_bytes(),
        ];
        parts.concat()
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        if reader.u8("version")? != VERSION {
            return Err(WireError::Value("version"));
        }
        let mut position = Self {
            chain_id: reader.u64("chain id")?,
            genesis: Hash(reader.array("genesis")?),
            contract: Address(reader.array("contract")?),
            owner: Address(reader.array("owner")?),
            key: PublicKey(reader.array("key")?),
            recorder: RecorderId(reader.array("recorder")?),
            block: reader.u64("block")?,
            block_hash: Hash(reader.array("block's hash")?),
            earlier: Some((reader.u64("earlier block")?, Hash(reader.array("earlier block's hash")?))),
            top: Hash(reader.array("top")?),
            count: reader.u64("count")?,
            head: None,
        };
        let (head, number) = (Digest(reader.array("head")?), reader.u64("head's number")?);
        // One spelling of what is not there.
        position.earlier = match position.earlier {
            Some((0, NO_HASH)) => None,
            Some((0, _)) => return Err(WireError::Value("earlier block's hash")),
            earlier => earlier,
        };
        position.head = match (number, head.0 == [0; Digest::LENGTH]) {
            (0, true) => None,
            (0, false) | (_, true) => return Err(WireError::Value("head")),
            (number, false) => Some((number, head)),
        };
        if position.block == 0 {
            return Err(WireError::Value("block"));
        }
        if !(1..=MOST_ROOTS).contains(&position.count) {
            return Err(WireError::Value("count"));
        }
        Ok(position)
    }
}

/// A position with its owner's signature: position (321) || signature (64).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SignedPosition {
    /// What is stated.
    pub position: Position,
    /// SM2 by its key.
    pub signature: Signature,
}

impl SignedPosition {
    /// Length of its encoding, bytes.
    pub const LENGTH: usize = Position::LENGTH + Signature::LENGTH;

    /// Its encoding.
    pub fn encode(&self) -> Vec<u8> {
        [&self.position.encode()[..], &self.signature.0].concat()
    }

    /// From its encoding.
    ///
    /// # Errors
    /// [`WireError`] if the bytes are not exactly one.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        let signed = Self::read(&mut reader)?;
        reader.end()?;
        Ok(signed)
    }

    /// From the front of more.
    ///
    /// # Errors
    /// [`WireError`].
    pub fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        Ok(Self { position: Position::read(reader)?, signature: Signature(reader.array("signature")?) })
    }
}

/// A witness's word that it saw a position: signed position (385) || time (8) || account (20) || key (64) || signature (64).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Countersignature {
    /// What the owner stated.
    pub stated: SignedPosition,
    /// When, by the witness's clock.
    pub at: Timestamp,
    /// The witness's account, on whichever chain.
    pub witness: Address,
    /// The witness's key.
    pub key: PublicKey,
    /// SM2 by that key.
    pub signature: Signature,
}

impl Countersignature {
    /// Length of its encoding, bytes.
    pub const LENGTH: usize = SignedPosition::LENGTH + 8 + 20 + PublicKey::LENGTH + Signature::LENGTH;

    /// All but the witness's signature: what it signs.
    pub fn unsigned(&self) -> Vec<u8> {
        [&self.stated.encode()[..], &self.at.0.to_be_bytes(), &self.witness.0, &self.key.0].concat()
    }

    /// Its encoding.
    pub fn encode(&self) -> Vec<u8> {
        [&self.unsigned()[..], &self.signature.0].concat()
    }

    /// From its encoding.
    ///
    /// # Errors
    /// [`WireError`] if the bytes are not exactly one.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(bytes);
        let countersignature = Self {
            stated: SignedPosition::read(&mut reader)?,
            at: Timestamp(reader.u64("time")?),
            witness: Address(reader.array("witness")?),
            key: PublicKey(reader.array("witness's key")?),
            signature: Signature(reader.array("countersignature")?),
        };
        reader.end()?;
        Ok(countersignature)
    }
}

/// What two positions of one owner on one chain say against each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Contradiction {
    /// This block has two hashes.
    TwoBlocks(u64),
    /// This block was there, and is there no longer.
    BlockGone(u64),
    /// The recorder's statement of this number is two.
    TwoHeads(u64),
    /// The recorder had reached this number, and later stated a lower one.
    HeadWentBack(u64),
}

impl std::fmt::Display for Contradiction {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::TwoBlocks(block) => write!(formatter, "block {block} of its chain has two hashes"),
            Self::BlockGone(block) => write!(formatter, "block {block} of its chain was there and is gone"),
            Self::TwoHeads(number) => write!(formatter, "the head number {number} of its recorder is two"),
            Self::HeadWentBack(number) => {
                write!(formatter, "its recorder had stated the head number {number}, and goes back")
            }
        }
    }
}

impl Position {
    /// Whether both are about one chain and contract, by one key.
    pub fn is_beside(&self, other: &Self) -> bool {
        (self.chain_id, self.genesis, self.contract, self.key)
            == (other.chain_id, other.genesis, other.contract, other.key)
    }

    /// What this position says against one that was stated before it; `None` if both can be true.
    pub fn contradicts(&self, before: &Self) -> Option<Contradiction> {
        if !self.is_beside(before) {
            return None;
        }
        let known = [Some((before.block, before.block_hash)), before.earlier.filter(|(_, hash)| *hash != NO_HASH)];
        for (block, hash) in known.into_iter().flatten() {
            for (stated, found) in [Some((self.block, self.block_hash)), self.earlier].into_iter().flatten() {
                match stated == block && found != hash {
                    true if found == NO_HASH => return Some(Contradiction::BlockGone(block)),
                    true => return Some(Contradiction::TwoBlocks(block)),
                    false => {}
                }
            }
        }
        let ((before_number, before_head), (number, head)) = before.head.zip(self.head)?;
        match number.cmp(&before_number) {
            _ if self.recorder != before.recorder => None,
            std::cmp::Ordering::Equal if head != before_head => Some(Contradiction::TwoHeads(number)),
            // Only by referring to the other one it says that it was stated later: an old statement can be brought again.
            std::cmp::Ordering::Less if self.earlier.is_some_and(|(block, _)| block == before.block) => {
                Some(Contradiction::HeadWentBack(before_number))
            }
            std::cmp::Ordering::Less | std::cmp::Ordering::Equal | std::cmp::Ordering::Greater => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn position() -> Position {
        Position {
            chain_id: 7,
            genesis: Hash([1; 32]),
            contract: Address([2; 20]),
            owner: Address([3; 20]),
            key: PublicKey([4; 64]),
            recorder: RecorderId([5; 16]),
            block: 100,
            block_hash: Hash([6; 32]),
            earlier: Some((90, Hash([7; 32]))),
            top: Hash([8; 32]),
            count: 3,
            head: Some((4, Digest([9; 32]))),
        }
    }

    fn signed(position: &Position) -> SignedPosition {
        SignedPosition { position: *position, signature: Signature([10; 64]) }
    }

    fn countersigned() -> Countersignature {
        let (at, witness) = (Timestamp(11), Address([12; 20]));
        Countersignature {
            stated: signed(&position()),
            at,
            witness,
            key: PublicKey([13; 64]),
            signature: Signature([14; 64]),
        }
    }

    #[test]
    fn a_countersignature_has_one_length_and_one_spelling() {
        let bytes = countersigned().encode();
        assert_eq!((bytes.len(), Countersignature::LENGTH, SignedPosition::LENGTH), (541, 541, 385));
        assert_eq!(Countersignature::parse(&bytes), Ok(countersigned()));
        assert_eq!(SignedPosition::parse(&bytes[..385]), Ok(signed(&position())));
        let long = [&bytes[..], &[0]].concat();
        assert_eq!(Countersignature::parse(&long), Err(WireError::Long(1)), "oversized");
        assert_eq!(Countersignature::parse(&bytes[..540]), Err(WireError::Short("countersignature")));
        let bare = signed(&Position { earlier: None, head: None, ..position() });
        assert_eq!(SignedPosition::parse(&bare.encode()), Ok(bare));
        let with = |change: fn(&mut Position)| {
            let mut changed = position();
            change(&mut changed);
            SignedPosition::parse(&signed(&changed).encode())
        };
        assert_eq!(with(|position| position.block = 0), Err(WireError::Value("block")));
        assert_eq!(with(|position| position.count = 0), Err(WireError::Value("count")));
        assert_eq!(with(|position| position.count = 16_385), Err(WireError::Value("count")));
        assert_eq!(
            with(|position| position.earlier = Some((0, Hash([1; 32])))),
            Err(WireError::Value("earlier block's hash"))
        );
        assert_eq!(with(|position| position.head = Some((0, Digest([1; 32])))), Err(WireError::Value("head")));
        assert_eq!(with(|position| position.head = Some((1, Digest([0; 32])))), Err(WireError::Value("head")));
        let mut newer = signed(&position()).encode();
        newer[0] = 2;
        assert_eq!(SignedPosition::parse(&newer), Err(WireError::Value("version")));
    }

    #[test]
    fn what_contradicts_an_earlier_position_is_named() {
        let before = position();
        let next = Position { block: 120, block_hash: Hash([20; 32]), earlier: Some((100, Hash([6; 32]))), ..before };
        let later = |change: fn(&mut Position)| {
            let mut changed = next;
            change(&mut changed);
            changed.contradicts(&before)
        };
        assert_eq!((next.contradicts(&before), before.contradicts(&before)), (None, None));
        let rewritten = later(|position| position.earlier = Some((100, Hash([21; 32]))));
        assert_eq!(rewritten, Some(Contradiction::TwoBlocks(100)));
        assert_eq!(later(|position| position.earlier = Some((100, NO_HASH))), Some(Contradiction::BlockGone(100)));
        assert_eq!(later(|position| position.earlier = Some((90, Hash([21; 32])))), Some(Contradiction::TwoBlocks(90)));
        let shorter = later(|position| (position.block, position.earlier) = (100, None));
        assert_eq!(shorter, Some(Contradiction::TwoBlocks(100)));
        assert_eq!(later(|position| position.head = Some((4, Digest([1; 32])))), Some(Contradiction::TwoHeads(4)));
        assert_eq!(later(|position| position.head = Some((3, Digest([1; 32])))), Some(Contradiction::HeadWentBack(4)));
        assert_eq!(later(|position| position.head = Some((5, Digest([1; 32])))), None);
        let brought_again = Position { head: Some((3, Digest([1; 32]))), earlier: Some((80, Hash([1; 32]))), ..next };
        assert_eq!(brought_again.contradicts(&before), None, "it does not say that it is the later one");
        let moved = later(|position| {
            (position.recorder, position.head) = (RecorderId([1; 16]), Some((1, Digest([1; 32]))));
        });
        assert_eq!(moved, None, "a restored home has another recorder");
        let elsewhere = later(|position| (position.chain_id, position.earlier) = (8, Some((100, NO_HASH))));
        assert_eq!(elsewhere, None, "another chain has its own blocks");
    }

    proptest! {
        #[test]
        fn nothing_but_its_own_spelling_is_read(noise: Vec<u8>, at in 0usize..541, byte: u8) {
            prop_assert!(Countersignature::parse(&noise).is_err());
            let mut changed = countersigned().encode();
            changed[at] = byte;
            if let Ok(read) = Countersignature::parse(&changed) {
                prop_assert_eq!(read.encode(), changed);
            }
        }
    }
}
