//! The path down a Merkle-Patricia trie (Yellow Paper, appendices C and D), one stored node at a time.

use authros_model::Hash;
use rlp::Rlp;

use crate::manifest::text;

/// Root of a trie without keys: Keccak-256 of the RLP of nothing.
pub const EMPTY_ROOT: Hash = Hash([
    0x56, 0xe8, 0x1f, 0x17, 0x1b, 0xcc, 0x55, 0xa6, 0xff, 0x83, 0x45, 0xe6, 0x92, 0xc0, 0xf8, 0x6e, 0x5b, 0x48, 0xe0,
    0x1b, 0x99, 0x6c, 0xad, 0xc0, 0x01, 0x62, 0x2f, 0xb5, 0xe3, 0x63, 0xb4, 0x21,
]);

/// Where a path leads within one stored node.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Step {
    /// To a value, or to its empty place.
    End(Option<Vec<u8>>),
    /// To another stored node, with this many nibbles left.
    Down(Hash, usize),
}

/// Follows `path` within one stored node; `None` if it is not a node.
pub fn follow(node: &Rlp<'_>, path: &[u8]) -> Option<Step> {
    let (child, rest) = match node.item_count().ok()? {
        2 => {
            let (own, leaf) = unpacked(text(&node.at(0).ok()?)?)?;
            let Some(rest) = path.strip_prefix(&own[..]) else { return Some(Step::End(None)) };
            if leaf {
                let value = text(&node.at(1).ok()?)?.to_vec();
                return Some(Step::End(rest.is_empty().then_some(value)));
            }
            // An extension must consume at least one nibble: an empty one could form a loop.
            if own.is_empty() {
                return None;
            }
            (node.at(1).ok()?, rest)
        }
        17 => {
            let Some((nibble, rest)) = path.split_first() else { return Some(Step::End(None)) };
            (node.at(usize::from(*nibble)).ok()?, rest)
        }
        _ => return None,
    };
    if child.is_list() {
        return follow(&child, rest);
    }
    match text(&child)? {
        [] => Some(Step::End(None)),
        hash => Some(Step::Down(Hash::from_slice(hash)?, rest.len())),
    }
}

/// A key's nibbles.
pub fn nibbles(key: &[u8]) -> Vec<u8> {
    key.iter().flat_map(|byte| [byte >> 4, byte & 15]).collect()
}

/// Nibbles from the hex-prefix encoding, and whether they end in a leaf.
pub fn unpacked(bytes: &[u8]) -> Option<(Vec<u8>, bool)> {
    let all = nibbles(bytes);
    let mark = *all.first()?;
    let begin = if mark & 1 == 1 { 1 } else { 2 };
    (mark < 4).then(|| (all.get(begin..).unwrap_or_default().to_vec(), mark & 2 == 2))
}
