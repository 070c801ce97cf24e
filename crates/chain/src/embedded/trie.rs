//! Merkle-Patricia tries (Yellow Paper, appendix D) whose nodes are stored elsewhere under their hash and read on
//! demand.
//!
//! All keys have one length, or none is a prefix of another, so that no branch holds a value. A change reads only the
//! nodes on its path; the nodes it creates and leaves behind are returned at the end, each once per place.

use std::sync::Arc;

use ethers::types::Bloom;
use ethers::utils::keccak256;
use ethers::utils::rlp::{self, Rlp, RlpStream};

pub use authros_evidence::trie::EMPTY_ROOT;

use super::block::Receipt;
use crate::ChainError;
use crate::model::Hash;
use authros_evidence::trie::{Step, follow, nibbles, unpacked};

/// A node shorter than this is embedded in its parent.
const SHORTEST: usize = 32;

/// The store of nodes.
pub trait Nodes {
    /// The node with this hash.
    ///
    /// # Errors
    /// [`ChainError::Tampered`] naming the node if it is missing or altered, or an error if it cannot be read.
    fn node(&self, hash: Hash) -> Result<Arc<[u8]>, ChainError>;

    /// The error for bytes that are not a trie node.
    fn malformed(&self, hash: Hash) -> ChainError;
}

/// The nodes that a change of a trie created and left behind.
#[derive(Debug, Default)]
pub struct Turnover {
    /// New nodes, hash and bytes; one at several places is listed several times.
    pub made: Vec<(Hash, Vec<u8>)>,
    /// Nodes with one place fewer.
    pub left: Vec<Hash>,
}

#[derive(Debug, Default)]
enum Child {
    #[default]
    Nothing,
    Stored(Hash),
    Open(Box<Node>),
}

#[derive(Debug)]
enum Node {
    Leaf { path: Vec<u8>, value: Vec<u8> },
    Extension { path: Vec<u8>, child: Child },
    Branch(Box<[Child; 16]>),
}

/// A trie, with the changes since it was opened.
pub struct Trie<'a, N: ?Sized> {
    nodes: &'a N,
    root: Child,
    left: Vec<Hash>,
}

impl<'a, N: Nodes + ?Sized> Trie<'a, N> {
    /// The trie with this root.
    pub fn new(nodes: &'a N, root: Hash) -> Self {
        let root = if root == EMPTY_ROOT { Child::Nothing } else { Child::Stored(root) };
        Self { nodes, root, left: Vec::new() }
    }

    /// The value of a key.
    ///
    /// # Errors
    /// Errors of [`Nodes`].
    pub fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>, ChainError> {
        let path = nibbles(key);
        let (mut at, mut rest) = (&self.root, &path[..]);
        loop {
            match at {
                Child::Nothing => return Ok(None),
                Child::Stored(hash) => return look_up(self.nodes, *hash, rest, &mut |_| ()),
                Child::Open(node) => match &**node {
                    Node::Leaf { path, value } => return Ok((path == rest).then(|| value.clone())),
                    Node::Extension { path, child } => match rest.strip_prefix(&path[..]) {
                        Some(after) => (at, rest) = (child, after),
                        None => return Ok(None),
                    },
                    Node::Branch(children) => match rest.split_first() {
                        Some((nibble, after)) => (at, rest) = (&children[usize::from(*nibble)], after),
                        None => return Ok(None),
                    },
                },
            }
        }
    }

    /// Sets the value of a key, or removes the key.
    ///
    /// # Errors
    /// Errors of [`Nodes`].
    pub fn set(&mut self, key: &[u8], value: Option<Vec<u8>>) -> Result<(), ChainError> {
        if self.get(key)? == value {
            return Ok(());
        }
        let path = nibbles(key);
        let root = std::mem::take(&mut self.root);
        self.root = match value {
            Some(value) => self.insert(root, &path, value)?,
            None => self.remove(root, &path)?,
        };
        Ok(())
    }

    /// The root with all changes, and the nodes they created and left behind.
    pub fn finish(self) -> (Hash, Turnover) {
        let mut turnover = Turnover { made: Vec::new(), left: self.left };
        let root = match &self.root {
            Child::Nothing => EMPTY_ROOT,
            Child::Stored(hash) => *hash,
            Child::Open(node) => {
                let bytes = encode(node, &mut turnover.made);
                let hash = Hash(keccak256(&bytes));
                turnover.made.push((hash, bytes));
                hash
            }
        };
        (root, turnover)
    }

    fn load(&self, hash: Hash) -> Result<Node, ChainError> {
        let bytes = self.nodes.node(hash)?;
        decode(&Rlp::new(&bytes)).ok_or_else(|| self.nodes.malformed(hash))
    }

    /// A node about to be changed.
    fn open(&mut self, child: Child) -> Result<Option<Node>, ChainError> {
        match child {
            Child::Nothing => Ok(None),
            Child::Open(node) => Ok(Some(*node)),
            Child::Stored(hash) => {
                let node = self.load(hash)?;
                self.left.push(hash);
                Ok(Some(node))
            }
        }
    }

    fn insert(&mut self, at: Child, path: &[u8], value: Vec<u8>) -> Result<Child, ChainError> {
        let node = match self.open(at)? {
            None => Node::Leaf { path: path.to_vec(), value },
            Some(Node::Leaf { path: own, .. }) if own == path => Node::Leaf { path: own, value },
            Some(Node::Leaf { path: own, value: old }) => {
                let common = common(&own, path);
                let mut children = <[Child; 16]>::default();
                put(&mut children, &own[common..], |rest| open(Node::Leaf { path: rest.to_vec(), value: old }));
                put(&mut children, &path[common..], |rest| open(Node::Leaf { path: rest.to_vec(), value }));
                extended(&path[..common], Node::Branch(Box::new(children)))
            }
            Some(Node::Extension { path: own, child }) => {
                let common = common(&own, path);
                if common == own.len() {
                    let child = self.insert(child, &path[common..], value)?;
                    Node::Extension { path: own, child }
                } else {
                    let mut children = <[Child; 16]>::default();
                    put(&mut children, &own[common..], |rest| match rest {
                        [] => child,
                        _ => open(Node::Extension { path: rest.to_vec(), child }),
                    });
                    put(&mut children, &path[common..], |rest| open(Node::Leaf { path: rest.to_vec(), value }));
                    extended(&path[..common], Node::Branch(Box::new(children)))
                }
            }
            Some(Node::Branch(mut children)) => {
                if let Some((nibble, rest)) = path.split_first() {
                    let place = &mut children[usize::from(*nibble)];
                    *place = self.insert(std::mem::take(place), rest, value)?;
                }
                Node::Branch(children)
            }
        };
        Ok(open(node))
    }

    /// Removes an existing key.
    fn remove(&mut self, at: Child, path: &[u8]) -> Result<Child, ChainError> {
        match self.open(at)? {
            None | Some(Node::Leaf { .. }) => Ok(Child::Nothing),
            Some(Node::Extension { path: own, child }) => {
                let child = self.remove(child, path.get(own.len()..).unwrap_or_default())?;
                self.joined(own, child)
            }
            Some(Node::Branch(mut children)) => {
                if let Some((nibble, rest)) = path.split_first() {
                    let place = &mut children[usize::from(*nibble)];
                    *place = self.remove(std::mem::take(place), rest)?;
                }
                let mut full = children.iter_mut().zip(0u8..).filter(|(child, _)| !matches!(child, Child::Nothing));
                match (full.next(), full.next()) {
                    (Some((child, nibble)), None) => {
                        let only = std::mem::take(child);
                        self.joined(vec![nibble], only)
                    }
                    _ => Ok(open(Node::Branch(children))),
                }
            }
        }
    }

    /// Joins `path` and `child` into one node.
    fn joined(&mut self, mut path: Vec<u8>, child: Child) -> Result<Child, ChainError> {
        let below = match child {
            Child::Nothing => return Ok(Child::Nothing),
            Child::Open(node) => *node,
            // A branch stays as it is; the others grow by the path.
            Child::Stored(hash) => match self.load(hash)? {
                Node::Branch(_) => return Ok(open(Node::Extension { path, child: Child::Stored(hash) })),
                grown => {
                    self.left.push(hash);
                    grown
                }
            },
        };
        Ok(open(match below {
            Node::Leaf { path: rest, value } => {
                path.extend(rest);
                Node::Leaf { path, value }
            }
            Node::Extension { path: rest, child } => {
                path.extend(rest);
                Node::Extension { path, child }
            }
            branch @ Node::Branch(_) => Node::Extension { path, child: open(branch) },
        }))
    }
}

/// A value, if there is one, and the nodes on the way to it, from the root down.
pub type Proof = (Option<Vec<u8>>, Vec<Arc<[u8]>>);

/// The value of a key, and every stored node on the way to it or to where it would be (EIP-1186).
///
/// # Errors
/// Errors of [`Nodes`].
pub fn prove<N: Nodes + ?Sized>(nodes: &N, root: Hash, key: &[u8]) -> Result<Proof, ChainError> {
    let mut way = Vec::new();
    if root == EMPTY_ROOT {
        return Ok((None, way));
    }
    let value = look_up(nodes, root, &nibbles(key), &mut |node| way.push(Arc::clone(node)))?;
    Ok((value, way))
}

/// Follows `path` from a stored node.
fn look_up<N: Nodes + ?Sized>(
    nodes: &N,
    root: Hash,
    path: &[u8],
    seen: &mut impl FnMut(&Arc<[u8]>),
) -> Result<Option<Vec<u8>>, ChainError> {
    let (mut hash, mut rest) = (root, path);
    loop {
        let bytes = nodes.node(hash)?;
        seen(&bytes);
        match follow(&Rlp::new(&bytes), rest) {
            Some(Step::End(value)) => return Ok(value),
            Some(Step::Down(next, length)) => (hash, rest) = (next, &rest[rest.len() - length..]),
            None => return Err(nodes.malformed(hash)),
        }
    }
}

/// The stored nodes directly below a stored node; `None` if it is not a node.
pub fn below(bytes: &[u8]) -> Option<Vec<Hash>> {
    fn collect(node: &Node, found: &mut Vec<Hash>) {
        let children = match node {
            Node::Leaf { .. } => return,
            Node::Extension { child, .. } => std::slice::from_ref(child),
            Node::Branch(children) => &children[..],
        };
        for child in children {
            match child {
                Child::Nothing => {}
                Child::Stored(hash) => found.push(*hash),
                Child::Open(node) => collect(node, found),
            }
        }
    }
    let mut found = Vec::new();
    collect(&decode(&Rlp::new(bytes))?, &mut found);
    Some(found)
}

fn common(one: &[u8], other: &[u8]) -> usize {
    one.iter().zip(other).take_while(|(one, other)| one == other).count()
}

fn open(node: Node) -> Child {
    Child::Open(Box::new(node))
}

fn put(children: &mut [Child; 16], path: &[u8], child: impl FnOnce(&[u8]) -> Child) {
    if let Some((nibble, rest)) = path.split_first() {
        children[usize::from(*nibble)] = child(rest);
    }
}

fn extended(path: &[u8], branch: Node) -> Node {
    if path.is_empty() { branch } else { Node::Extension { path: path.to_vec(), child: open(branch) } }
}

/// Nibbles in the hex-prefix encoding (appendix C).
fn packed(path: &[u8], leaf: bool) -> Vec<u8> {
    let odd = path.len() % 2;
    let mark = if leaf { 2 } else { 0 } + u8::from(odd == 1);
    let first = (mark << 4) | if odd == 1 { path[0] } else { 0 };
    std::iter::once(first).chain(path[odd..].chunks(2).map(|pair| pair[0] << 4 | pair[1])).collect()
}

fn decode(rlp: &Rlp<'_>) -> Option<Node> {
    let child = |rlp: Rlp<'_>| {
        if rlp.is_list() {
            return decode(&rlp).map(open);
        }
        match rlp.data().ok()? {
            [] => Some(Child::Nothing),
            hash => Hash::from_slice(hash).map(Child::Stored),
        }
    };
    match rlp.item_count().ok()? {
        2 => {
            let (path, leaf) = unpacked(rlp.at(0).ok()?.data().ok()?)?;
            let below = rlp.at(1).ok()?;
            if leaf {
                return Some(Node::Leaf { path, value: below.data().ok()?.to_vec() });
            }
            Some(Node::Extension { path, child: child(below)? })
        }
        17 => {
            let mut children = <[Child; 16]>::default();
            for (place, below) in children.iter_mut().zip(rlp.iter()) {
                *place = child(below)?;
            }
            Some(Node::Branch(Box::new(children)))
        }
        _ => None,
    }
}

/// A node's RLP; child nodes that are long enough go to `made`.
fn encode(node: &Node, made: &mut Vec<(Hash, Vec<u8>)>) -> Vec<u8> {
    let mut list = RlpStream::new();
    match node {
        Node::Leaf { path, value } => {
            list.begin_list(2).append(&packed(path, true)).append(value);
        }
        Node::Extension { path, child } => {
            list.begin_list(2).append(&packed(path, false));
            append(&mut list, child, made);
        }
        Node::Branch(children) => {
            list.begin_list(17);
            children.iter().for_each(|child| append(&mut list, child, made));
            list.append_empty_data();
        }
    }
    list.out().to_vec()
}

fn append(list: &mut RlpStream, child: &Child, made: &mut Vec<(Hash, Vec<u8>)>) {
    match child {
        Child::Nothing => {
            list.append_empty_data();
        }
        Child::Stored(hash) => {
            list.append(&&hash.0[..]);
        }
        Child::Open(node) => {
            let bytes = encode(node, made);
            if bytes.len() < SHORTEST {
                list.append_raw(&bytes, 1);
            } else {
                let hash = Hash(keccak256(&bytes));
                list.append(&&hash.0[..]);
                made.push((hash, bytes));
            }
        }
    }
}

// What a header commits to besides the state: its transactions and receipts, as Ethereum's tries.

/// A trie built only in memory.
struct Nowhere;

impl Nodes for Nowhere {
    fn node(&self, hash: Hash) -> Result<Arc<[u8]>, ChainError> {
        Err(self.malformed(hash))
    }

    fn malformed(&self, hash: Hash) -> ChainError {
        ChainError::Internal(format!("node {hash} of a list was asked for"))
    }
}

/// Root of the trie of a list: RLP of the index to the item (Yellow Paper, 4.3.2).
fn list_root(items: impl IntoIterator<Item = Vec<u8>>) -> Result<Hash, ChainError> {
    let mut trie = Trie::new(&Nowhere, EMPTY_ROOT);
    for (place, item) in (0u64..).zip(items) {
        trie.set(&rlp::encode(&place), Some(item))?;
    }
    Ok(trie.finish().0)
}

/// Root of the trie of transactions, given as their raw bytes.
///
/// # Errors
/// Only for a fault of this program.
pub fn transactions_root<'a>(sent: impl IntoIterator<Item = &'a [u8]>) -> Result<Hash, ChainError> {
    list_root(sent.into_iter().map(<[u8]>::to_vec))
}

/// Root of the trie of receipts.
///
/// # Errors
/// Only for a fault of this program.
pub fn receipts_root(receipts: &[Receipt]) -> Result<Hash, ChainError> {
    list_root(receipts.iter().map(ethereums))
}

/// A receipt as Ethereum commits to it since Byzantium (EIP-658): status, gas so far, bloom, logs.
fn ethereums(receipt: &Receipt) -> Vec<u8> {
    let mut bloom = Bloom::zero();
    receipt.accrue(&mut bloom);
    let mut list = RlpStream::new_list(4);
    list.append(&receipt.success).append(&receipt.cumulative_gas).append(&bloom).append_list(&receipt.logs);
    list.out().to_vec()
}
