//! The state after a block, as far as the nodes in a bundle show it, and the contract's storage in it.
#![allow(clippy::missing_errors_doc, reason = "`Unproven` says what the nodes do not show")]

use std::collections::BTreeMap;

use authros_crypto::keccak256;
use authros_model::{Address, Hash};
use rlp::{Rlp, RlpStream};

use crate::manifest::{is_canonical, text};
use crate::trie::{EMPTY_ROOT, Step, follow, nibbles};

pub const MOST_NODES: usize = 1_000_000;
/// The longest node, bytes: one with all sixteen branches and a value has less than 700.
pub const LONGEST_NODE: usize = 1024;

/// Why the state does not show the requested value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Unproven {
    /// A node on the path is not in the bundle.
    #[error("the node {0} on its path is not in the bundle")]
    Missing(Hash),
    /// It is in the bundle, but is not a node.
    #[error("the node {0} on its path is not a trie node")]
    Malformed(Hash),
    /// The value in the trie has another form.
    #[error("what the state holds there is not a {0}")]
    Value(&'static str),
    /// There is no such account.
    #[error("the state has no contract at that address")]
    NoContract,
}

/// Nodes of tries by their Keccak-256.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Nodes(BTreeMap<Hash, Vec<u8>>);

impl FromIterator<Vec<u8>> for Nodes {
    fn from_iter<I: IntoIterator<Item = Vec<u8>>>(nodes: I) -> Self {
        Self(nodes.into_iter().map(|node| (Hash(keccak256(&[&node])), node)).collect())
    }
}

impl Nodes {
    /// Their number.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Each with its Keccak-256, by that.
    pub fn into_hashed(self) -> impl Iterator<Item = (Hash, Vec<u8>)> {
        self.0.into_iter()
    }

    /// Adds the nodes of others.
    pub fn extend(&mut self, others: Self) {
        self.0.extend(others.0);
    }

    /// In the bundle's form: the RLP list of the nodes, by their hashes.
    pub fn encode(&self) -> Vec<u8> {
        let mut list = RlpStream::new_list(self.0.len());
        self.0.values().for_each(|node| {
            list.append(&node.as_slice());
        });
        list.out().to_vec()
    }

    /// From those bytes; `None` if they are not exactly such a list.
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        let list = Rlp::new(bytes);
        if !list.is_list() || list.item_count().ok()? > MOST_NODES {
            return None;
        }
        let node = |node: Rlp<'_>| text(&node).filter(|node| node.len() <= LONGEST_NODE).map(<[u8]>::to_vec);
        let nodes = list.iter().map(node).collect::<Option<Self>>()?;
        (nodes.encode() == bytes).then_some(nodes)
    }

    /// The value of a key below a root; `Ok(None)` if the trie proves that there is none.
    pub fn look_up(&self, root: Hash, key: &[u8]) -> Result<Option<Vec<u8>>, Unproven> {
        self.walk(root, key, |_, _| {})
    }

    /// The nodes that show the contract's account and these slots of its storage in the state with this root, each
    /// once; others are left out.
    pub fn proving(&self, state: Hash, contract: Address, slots: &[Slot]) -> Result<Self, Unproven> {
        let mut found = BTreeMap::new();
        let mut take = |hash, node: &[u8]| {
            found.entry(hash).or_insert_with(|| node.to_vec());
        };
        self.walk(state, &contract.0, &mut take)?;
        let storage = Storage::of(self, state, contract)?;
        for slot in slots {
            self.walk(storage.root, &slot.0, &mut take)?;
        }
        Ok(Self(found))
    }

    /// `passed` gets each node on the way.
    fn walk(&self, root: Hash, key: &[u8], mut passed: impl FnMut(Hash, &[u8])) -> Result<Option<Vec<u8>>, Unproven> {
        if root == EMPTY_ROOT {
            return Ok(None);
        }
        // Keys are hashed, as in every trie of a state.
        let path = nibbles(&keccak256(&[key]));
        let (mut hash, mut left) = (root, path.len());
        loop {
            let node = self.0.get(&hash).ok_or(Unproven::Missing(hash))?;
            passed(hash, node);
            let rest = path.get(path.len() - left.min(path.len())..).unwrap_or_default();
            let whole = Some(Rlp::new(node)).filter(|_| is_canonical(node));
            match whole.and_then(|node| follow(&node, rest)).ok_or(Unproven::Malformed(hash))? {
                Step::End(value) => return Ok(value),
                // Only the root may be reached without consuming a step.
                Step::Down(_, length) if length >= left => return Err(Unproven::Malformed(hash)),
                Step::Down(next, length) => (hash, left) = (next, length),
            }
        }
    }
}

/// A word of storage; its fields are packed from the low end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Word(pub [u8; 32]);

impl Word {
    /// Eight bytes, `offset` bytes from the low end.
    fn number(self, offset: usize) -> u64 {
        let end = 32 - offset;
        let bytes = self.0.get(end - 8..end).and_then(|bytes| bytes.try_into().ok());
        bytes.map_or(0, u64::from_be_bytes)
    }
}

/// An anchored root: `anchorOf`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AnchorWord {
    /// The block of its first anchoring.
    pub block: u64,
    /// The number of leaves.
    pub count: u64,
    /// That block's time, seconds.
    pub time: u64,
    /// The version of the anchoring account's keys then.
    pub keys: u64,
}

/// One version of an account's keys: `keysOf`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KeysWord {
    /// Keccak-256 of the identity.
    pub identity: Hash,
    /// The block from which it applies.
    pub block: u64,
}

/// A device's loan: `loanOf`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LoanWord {
    /// Its end, seconds; 0 = no end.
    pub until: u64,
    /// The block from which it applies.
    pub lent: u64,
    /// The block in which it was recalled; 0 = it was not.
    pub recalled: u64,
}

/// The storage slot of a value in the contract (docs/format.md, section 8).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Slot(pub [u8; 32]);

impl Slot {
    fn mapped(key: &[u8; 32], below: &[u8; 32]) -> Self {
        Self(keccak256(&[key, below]))
    }

    fn of_account(account: Address, mapping: u8) -> Self {
        Self::mapped(&padded(&account.0), &padded(&[mapping]))
    }

    /// This many slots further.
    #[must_use]
    pub fn next(mut self, by: u8) -> Self {
        let mut carry = by;
        for byte in self.0.iter_mut().rev() {
            let (sum, over) = byte.overflowing_add(carry);
            (*byte, carry) = (sum, u8::from(over));
        }
        self
    }

    /// `uploadedAt[owner][digest]`.
    pub fn uploaded(owner: Address, digest: &[u8; 32]) -> Self {
        Self::mapped(digest, &Self::of_account(owner, 5).0)
    }

    /// `anchorOf[account][root]`.
    pub fn anchor(account: Address, root: Hash) -> Self {
        Self::mapped(&root.0, &Self::of_account(account, 8).0)
    }

    /// `loanOf[owner][device]`.
    pub fn loan(owner: Address, device: &[u8; 32]) -> Self {
        Self::mapped(device, &Self::of_account(owner, 9).0)
    }

    /// `accounts[account]`, its first word.
    pub fn account(account: Address) -> Self {
        Self::of_account(account, 10)
    }

    /// `keysOf[account][version]`, its first word.
    pub fn keys(account: Address, version: u64) -> Self {
        Self::mapped(&padded(&version.to_be_bytes()), &Self::of_account(account, 15).0)
    }
}

fn padded(bytes: &[u8]) -> [u8; 32] {
    let mut word = [0; 32];
    word.iter_mut().rev().zip(bytes.iter().rev()).for_each(|(to, from)| *to = *from);
    word
}

/// The contract's storage after a block.
#[derive(Debug, Clone, Copy)]
pub struct Storage<'a> {
    nodes: &'a Nodes,
    root: Hash,
    /// Keccak-256 of the contract's code.
    pub code_hash: Hash,
}

impl<'a> Storage<'a> {
    /// The contract's, in the state with this root.
    pub fn of(nodes: &'a Nodes, state: Hash, contract: Address) -> Result<Self, Unproven> {
        let account = nodes.look_up(state, &contract.0)?.ok_or(Unproven::NoContract)?;
        let fields = Rlp::new(&account);
        let hash = |at: usize| fields.at(at).ok().and_then(|hash| Hash::from_slice(text(&hash)?));
        let (root, code) = (hash(2), hash(3));
        if !is_canonical(&account) {
            return Err(Unproven::Value("account"));
        }
        let (Some(root), Some(code_hash), Ok(4)) = (root, code, fields.item_count()) else {
            return Err(Unproven::Value("account"));
        };
        Ok(Self { nodes, root, code_hash })
    }

    /// The content of a slot; zero if the state proves that it is empty.
    pub fn word(&self, slot: Slot) -> Result<Word, Unproven> {
        let Some(value) = self.nodes.look_up(self.root, &slot.0)? else { return Ok(Word([0; 32])) };
        let item = Rlp::new(&value);
        let bytes =
            text(&item).filter(|bytes| bytes.len() <= 32 && is_canonical(&value)).ok_or(Unproven::Value("word"))?;
        Ok(Word(padded(bytes)))
    }

    /// When an account first anchored a root; `None` = never.
    pub fn anchor(&self, account: Address, root: Hash) -> Result<Option<AnchorWord>, Unproven> {
        let word = self.word(Slot::anchor(account, root))?;
        let found =
            AnchorWord { block: word.number(0), count: word.number(8), time: word.number(16), keys: word.number(24) };
        Ok((found.block != 0).then_some(found))
    }

    /// The block in which an owner uploaded a digest; `None` = never.
    pub fn uploaded(&self, owner: Address, digest: &[u8; 32]) -> Result<Option<u64>, Unproven> {
        let block = self.word(Slot::uploaded(owner, digest))?.number(0);
        Ok((block != 0).then_some(block))
    }

    /// A version of an account's keys; `None` if there is none yet.
    pub fn keys(&self, account: Address, version: u64) -> Result<Option<KeysWord>, Unproven> {
        let slot = Slot::keys(account, version);
        let identity = Hash(self.word(slot)?.0);
        if identity == Hash([0; 32]) {
            return Ok(None);
        }
        Ok(Some(KeysWord { identity, block: self.word(slot.next(1))?.number(0) }))
    }

    /// Whether an account is suspended.
    pub fn is_suspended(&self, account: Address) -> Result<bool, Unproven> {
        let Word(word) = self.word(Slot::account(account))?;
        Ok(word.get(7).is_some_and(|flag| *flag != 0))
    }

    /// A device's loan; `None` if it was never lent.
    pub fn loan(&self, owner: Address, device: &[u8; 32]) -> Result<Option<LoanWord>, Unproven> {
        let word = self.word(Slot::loan(owner, device))?;
        let loan = LoanWord { until: word.number(1), lent: word.number(9), recalled: word.number(17) };
        Ok((loan.lent != 0).then_some(loan))
    }
}
