//! Paths of leaves to the root of their batch. Eight leaves beside each other are a branch: it has each node of its own small
//! tree once, and the steps from there to the root, which are the same for all of them.

use rusqlite::{Connection, Row, params};

use crate::StoreError;
use crate::database::{Statements as _, whole};
use crate::model::Hash;

/// Levels of a branch's own tree.
const LEVELS: u32 = 3;

/// A branch of a batch of this many leaves, as far as its nodes are known.
pub(super) struct Branch {
    number: u64,
    count: u64,
    /// The nodes that have siblings, level by level; zeros where one is not known.
    nodes: Vec<Hash>,
    above: Vec<Hash>,
}

/// Where the sibling of a leaf's ancestor is among the nodes of its branch; `None` if there is none.
fn sibling(index: u64, count: u64, level: u32) -> Option<usize> {
    let sibling = (index >> level) ^ 1;
    if sibling >= width(count, level) {
        return None;
    }
    let number = index >> LEVELS;
    let below: u64 = (0..level).map(|level| stored(number, count, level)).sum();
    usize::try_from(below + (sibling & ((1 << (LEVELS - level)) - 1))).ok()
}

/// How many nodes a level of the whole tree has.
fn width(count: u64, level: u32) -> u64 {
    count.div_ceil(1 << level)
}

/// How many of them a branch keeps: one alone has no sibling, and is nobody's.
fn stored(number: u64, count: u64, level: u32) -> u64 {
    let first = number << (LEVELS - level);
    let own = width(count, level).saturating_sub(first).min(1 << (LEVELS - level));
    if own > 1 { own } else { 0 }
}

impl Branch {
    fn new(number: u64, count: u64) -> Self {
        let nodes: u64 = (0..LEVELS).map(|level| stored(number, count, level)).sum();
        let nodes = vec![Hash([0; Hash::LENGTH]); usize::try_from(nodes).unwrap_or_default()];
        Self { number, count, nodes, above: Vec::new() }
    }

    fn from_bytes(number: u64, count: u64, bytes: &[u8]) -> Self {
        let mut branch = Self::new(number, count);
        let mut hashes = bytes.chunks_exact(Hash::LENGTH).filter_map(Hash::from_slice);
        branch.nodes.iter_mut().zip(hashes.by_ref()).for_each(|(node, hash)| *node = hash);
        branch.above = hashes.collect();
        branch
    }

    /// Adds what a leaf's path says.
    fn add(&mut self, index: u64, path: &[Hash]) {
        let mut steps = path.iter();
        for level in 0..LEVELS {
            let Some(place) = sibling(index, self.count, level) else { continue };
            if let (Some(node), Some(step)) = (self.nodes.get_mut(place), steps.next()) {
                *node = *step;
            }
        }
        self.above = steps.copied().collect();
    }

    /// A leaf's path.
    fn path(&self, index: u64) -> Vec<Hash> {
        let own = (0..LEVELS).filter_map(|level| self.nodes.get(sibling(index, self.count, level)?).copied());
        own.chain(self.above.iter().copied()).collect()
    }

    fn write(&self, connection: &Connection, batch: i64) -> Result<(), StoreError> {
        let bytes: Vec<u8> = self.nodes.iter().chain(&self.above).flat_map(|node| node.0).collect();
        if !bytes.is_empty() {
            let sql = "REPLACE INTO branches VALUES (?1, ?2, ?3)";
            connection.run(sql, params![batch, whole("branch", self.number)?, bytes])?;
        }
        Ok(())
    }
}

/// Keeps the paths of all leaves of a batch, in their order.
pub(super) fn keep_all<'a>(
    connection: &Connection,
    batch: i64,
    count: u64,
    paths: impl Iterator<Item = &'a [Hash]>,
) -> Result<(), StoreError> {
    let mut branch = Branch::new(0, count);
    for (index, path) in (0..).zip(paths) {
        if index >> LEVELS != branch.number {
            branch.write(connection, batch)?;
            branch = Branch::new(index >> LEVELS, count);
        }
        branch.add(index, path);
    }
    branch.write(connection, batch)
}

/// Keeps the path of one leaf beside those of others.
pub(super) fn keep_one(
    connection: &Connection,
    batch: i64,
    (index, count): (u64, u64),
    path: &[Hash],
) -> Result<(), StoreError> {
    let number = index >> LEVELS;
    let sql = "SELECT path FROM branches WHERE batch = ?1 AND branch = ?2";
    let known: Option<Vec<u8>> = connection.find(sql, params![batch, whole("branch", number)?], |row| row.get(0))?;
    let mut branch =
        known.map_or_else(|| Branch::new(number, count), |known| Branch::from_bytes(number, count, &known));
    branch.add(index, path);
    branch.write(connection, batch)
}

/// What a query joins for [`path_of`]: the branch of a row of `leaves`.
pub(super) const JOINED: &str =
    "LEFT JOIN branches ON branches.batch = leaves.batch AND branches.branch = leaves.leaf >> 3";

/// The path of a leaf, from the column of its branch, see [`JOINED`].
pub(super) fn path_of(row: &Row<'_>, column: usize, (index, count): (u64, u64)) -> rusqlite::Result<Vec<Hash>> {
    let bytes: Option<Vec<u8>> = row.get(column)?;
    Ok(Branch::from_bytes(index >> LEVELS, count, &bytes.unwrap_or_default()).path(index))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chain::merkle::Tree;

    #[test]
    fn every_path_of_every_small_tree_is_kept_whole_alone_and_with_the_others() {
        for count in (1..=70).chain([127, 128, 129, 1_000]) {
            let leaves = (0..count).map(|number: u64| {
                let mut hash = [7; Hash::LENGTH];
                hash[..8].copy_from_slice(&number.to_be_bytes());
                Hash(hash)
            });
            let tree = Tree::new(leaves.collect()).expect("a tree");
            let path = |index: u64| tree.path(usize::try_from(index).expect("small"));
            let mut bytes = 0;
            for number in 0..=(count - 1) >> LEVELS {
                let of_branch = (number << LEVELS)..count.min((number + 1) << LEVELS);
                let mut branch = Branch::new(number, count);
                for index in of_branch.clone() {
                    let mut alone = Branch::new(number, count);
                    alone.add(index, &path(index));
                    assert_eq!(alone.path(index), path(index), "{index} of {count}");
                    branch.add(index, &path(index));
                }
                let encoded: Vec<u8> = branch.nodes.iter().chain(&branch.above).flat_map(|node| node.0).collect();
                bytes += encoded.len();
                let again = Branch::from_bytes(number, count, &encoded);
                of_branch.for_each(|index| assert_eq!(again.path(index), path(index), "{index} of {count}"));
            }
            if count == 1_000 {
                assert!(bytes < 90 * 1_000, "{bytes}: a path alone has 320");
            }
        }
        // Damaged bytes are a wrong path, and no panic.
        assert_eq!(Branch::from_bytes(0, 9, &[1; 33]).path(3).len(), 3);
    }
}
