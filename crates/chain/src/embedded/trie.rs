//! Merkle-Patricia tries (Yellow Paper, appendix D) whose nodes are read on demand.
//!
//! No key is a prefix of another, so no branch holds a value. A change reads only the nodes on its path.

use std::sync::Arc;

use alloy_primitives::keccak256;
use alloy_rlp::{EMPTY_STRING_CODE, PayloadView};
use ethers::utils::rlp::Rlp;

pub use authros_evidence::trie::EMPTY_ROOT;

use crate::{ChainError, model::Hash, transaction::List};
use authros_evidence::trie::{Step, follow, nibbles, unpacked};

/// A node shorter than this is embedded in its parent.
const SHORTEST: usize = 32;

pub trait Nodes {
    /// The error names a node that is missing or altered.
    fn node(&self, hash: Hash) -> Result<Arc<[u8]>, ChainError>;

    fn malformed(&self, hash: Hash) -> ChainError;

    /// For BLOCKHASH; zero where there are no blocks.
    fn block_hash(&self, _number: u64) -> Result<Hash, ChainError> {
        Ok(Hash([0; 32]))
    }
}

#[derive(Debug, Default)]
pub struct Turnover {
    /// New nodes and code, once per place.
    pub made: Vec<(Hash, Vec<u8>)>,
    /// Nodes with one place fewer.
    pub left: Vec<Hash>,
    /// Roots of tries that were deleted as a whole.
    pub felled: Vec<Hash>,
}

impl Turnover {
    pub fn add(&mut self, other: Self) {
        self.made.extend(other.made);
        self.left.extend(other.left);
        self.felled.extend(other.felled);
    }
}

#[derive(Debug, Default)]
enum Child {
    #[default]
    Nothing,
    Stored(Hash),
    Open(Box<Node>),
    /// Only at the end of a path.
    Value(Vec<u8>),
}

#[derive(Debug)]
enum Node {
    /// A leaf if its child is a value, otherwise an extension.
    Path(Vec<u8>, Child),
    Branch(Box<[Child; 16]>),
}

pub struct Trie<'a, N: ?Sized> {
    nodes: &'a N,
    root: Child,
    left: Vec<Hash>,
}

impl<'a, N: Nodes + ?Sized> Trie<'a, N> {
    pub fn new(nodes: &'a N, root: Hash) -> Self {
        let root = if root == EMPTY_ROOT { Child::Nothing } else { Child::Stored(root) };
        Self { nodes, root, left: Vec::new() }
    }

    pub fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>, ChainError> {
        self.find(&self.root, &nibbles(key), &mut |_| ())
    }

    /// The value, and every stored node on the way, from the root down (EIP-1186).
    pub fn prove(&self, key: &[u8]) -> Result<Proof, ChainError> {
        let mut way = Vec::new();
        let value = self.find(&self.root, &nibbles(key), &mut |node| way.push(Arc::clone(node)))?;
        Ok((value, way))
    }

    fn find(&self, at: &Child, path: &[u8], seen: &mut impl FnMut(&Arc<[u8]>)) -> Result<Option<Vec<u8>>, ChainError> {
        let node = match at {
            Child::Nothing => return Ok(None),
            Child::Value(value) => return Ok(path.is_empty().then(|| value.clone())),
            Child::Open(node) => &**node,
            Child::Stored(hash) => {
                let bytes = self.nodes.node(*hash)?;
                seen(&bytes);
                return match follow(&Rlp::new(&bytes), path) {
                    Some(Step::End(value)) => Ok(value),
                    Some(Step::Down(next, left)) => self.find(&Child::Stored(next), &path[path.len() - left..], seen),
                    None => Err(self.nodes.malformed(*hash)),
                };
            }
        };
        match node {
            Node::Path(own, child) => path.strip_prefix(&own[..]).map_or(Ok(None), |rest| self.find(child, rest, seen)),
            Node::Branch(children) => match path.split_first() {
                Some((nibble, rest)) => self.find(&children[usize::from(*nibble)], rest, seen),
                None => Ok(None),
            },
        }
    }

    /// `None` removes the key.
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

    pub fn finish(self) -> (Hash, Turnover) {
        let mut turnover = Turnover { left: self.left, ..Turnover::default() };
        let root = match &self.root {
            Child::Stored(hash) => *hash,
            Child::Open(node) => {
                let bytes = encode(node, &mut turnover.made);
                let hash = Hash(keccak256(&bytes).0);
                turnover.made.push((hash, bytes));
                hash
            }
            Child::Nothing | Child::Value(_) => EMPTY_ROOT,
        };
        (root, turnover)
    }

    fn load(&self, hash: Hash) -> Result<Node, ChainError> {
        let bytes = self.nodes.node(hash)?;
        decode(&bytes).ok_or_else(|| self.nodes.malformed(hash))
    }

    /// Reads a node to change it.
    fn open(&mut self, child: Child) -> Result<Option<Node>, ChainError> {
        match child {
            Child::Nothing | Child::Value(_) => Ok(None),
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
            None => Node::Path(path.to_vec(), Child::Value(value)),
            Some(Node::Path(own, child)) => {
                let common = own.iter().zip(path).take_while(|(one, other)| one == other).count();
                if common == own.len() {
                    let child = match child {
                        Child::Value(_) => Child::Value(value),
                        other => self.insert(other, &path[common..], value)?,
                    };
                    Node::Path(own, child)
                } else {
                    let mut children = <[Child; 16]>::default();
                    put(&mut children, &own[common..], child);
                    put(&mut children, &path[common..], Child::Value(value));
                    let branch = Node::Branch(Box::new(children));
                    if common == 0 { branch } else { Node::Path(path[..common].to_vec(), open(branch)) }
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

    /// The key must exist.
    fn remove(&mut self, at: Child, path: &[u8]) -> Result<Child, ChainError> {
        match self.open(at)? {
            None | Some(Node::Path(_, Child::Value(_))) => Ok(Child::Nothing),
            Some(Node::Path(own, child)) => {
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

    fn joined(&mut self, mut path: Vec<u8>, child: Child) -> Result<Child, ChainError> {
        let below = match child {
            Child::Nothing => return Ok(Child::Nothing),
            Child::Value(_) => return Ok(open(Node::Path(path, child))),
            Child::Open(node) => *node,
            // A branch stays as it is; a path grows.
            Child::Stored(hash) => match self.load(hash)? {
                Node::Branch(_) => return Ok(open(Node::Path(path, child))),
                grown @ Node::Path(..) => {
                    self.left.push(hash);
                    grown
                }
            },
        };
        Ok(open(match below {
            Node::Path(rest, child) => {
                path.extend(rest);
                Node::Path(path, child)
            }
            branch @ Node::Branch(_) => Node::Path(path, open(branch)),
        }))
    }
}

pub type Proof = (Option<Vec<u8>>, Vec<Arc<[u8]>>);

/// Stored nodes directly below; `None` if it is not a node.
pub fn below(bytes: &[u8]) -> Option<Vec<Hash>> {
    fn collect(node: &Node, found: &mut Vec<Hash>) {
        let children = match node {
            Node::Path(_, child) => std::slice::from_ref(child),
            Node::Branch(children) => &children[..],
        };
        for child in children {
            match child {
                Child::Nothing | Child::Value(_) => {}
                Child::Stored(hash) => found.push(*hash),
                Child::Open(node) => collect(node, found),
            }
        }
    }
    let mut found = Vec::new();
    collect(&decode(bytes)?, &mut found);
    Some(found)
}

fn open(node: Node) -> Child {
    Child::Open(Box::new(node))
}

fn put(children: &mut [Child; 16], path: &[u8], end: Child) {
    if let Some((nibble, rest)) = path.split_first() {
        let is_direct = rest.is_empty() && !matches!(end, Child::Value(_));
        children[usize::from(*nibble)] = if is_direct { end } else { open(Node::Path(rest.to_vec(), end)) };
    }
}

/// Hex-prefix encoding (appendix C).
fn packed(path: &[u8], leaf: bool) -> Vec<u8> {
    let odd = path.len() % 2;
    let mark = if leaf { 2 } else { 0 } + u8::from(odd == 1);
    let first = (mark << 4) | if odd == 1 { path[0] } else { 0 };
    std::iter::once(first).chain(path[odd..].chunks(2).map(|pair| pair[0] << 4 | pair[1])).collect()
}

fn decode(bytes: &[u8]) -> Option<Node> {
    let PayloadView::List(items) = whole(bytes)? else { return None };
    match items[..] {
        [path, below] => {
            let (path, leaf) = unpacked(text(path)?)?;
            // An extension must consume at least one nibble: an empty one could form a loop.
            if !leaf && path.is_empty() {
                return None;
            }
            Some(Node::Path(path, if leaf { Child::Value(text(below)?.to_vec()) } else { child(below)? }))
        }
        [ref below @ .., _] if below.len() == 16 => {
            let mut children = <[Child; 16]>::default();
            for (place, below) in children.iter_mut().zip(below) {
                *place = child(below)?;
            }
            Some(Node::Branch(Box::new(children)))
        }
        _ => None,
    }
}

fn child(rlp: &[u8]) -> Option<Child> {
    match whole(rlp)? {
        PayloadView::List(_) => decode(rlp).map(open),
        PayloadView::String([]) => Some(Child::Nothing),
        PayloadView::String(hash) => Hash::from_slice(hash).map(Child::Stored),
    }
}

fn text(rlp: &[u8]) -> Option<&[u8]> {
    if let PayloadView::String(text) = whole(rlp)? { Some(text) } else { None }
}

fn whole(mut rlp: &[u8]) -> Option<PayloadView<'_>> {
    alloy_rlp::Header::decode_raw(&mut rlp).ok().filter(|_| rlp.is_empty())
}

/// Adds child nodes that are long enough to `made`.
fn encode(node: &Node, made: &mut Vec<(Hash, Vec<u8>)>) -> Vec<u8> {
    let list = List::default();
    let list = match node {
        Node::Path(path, child) => append(list.add(&packed(path, matches!(child, Child::Value(_)))[..]), child, made),
        Node::Branch(children) => {
            children.iter().fold(list, |list, child| append(list, child, made)).add_encoded(&[EMPTY_STRING_CODE])
        }
    };
    list.end()
}

fn append(list: List, child: &Child, made: &mut Vec<(Hash, Vec<u8>)>) -> List {
    match child {
        Child::Nothing => list.add_encoded(&[EMPTY_STRING_CODE]),
        Child::Stored(hash) => list.add(&hash.0),
        Child::Value(value) => list.add(&value[..]),
        Child::Open(node) => {
            let bytes = encode(node, made);
            if bytes.len() < SHORTEST {
                return list.add_encoded(&bytes);
            }
            let hash = Hash(keccak256(&bytes).0);
            made.push((hash, bytes));
            list.add(&hash.0)
        }
    }
}

/// The trie maps RLP of the index to the item (Yellow Paper, 4.3.2).
pub fn list_root(items: &[impl AsRef<[u8]>]) -> Hash {
    Hash(alloy_trie::root::ordered_trie_root_encoded(items).0)
}
