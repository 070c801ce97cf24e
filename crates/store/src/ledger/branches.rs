//! Paths to a batch's root. Sixteen adjacent leaves are a branch: it keeps the nodes of its subtree that others do not
//! imply, and the steps above it, which its leaves share.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use crate::StoreError;
use crate::crypto::merkle::node;
use crate::database::whole;
use crate::model::Hash;
use crate::sql::{self, Connection, Row, params};

const LEVELS: u32 = 4;

#[derive(Clone)]
pub(super) struct Branch {
    number: u64,
    count: u64,
    /// Those with siblings, level by level.
    nodes: Vec<Option<Hash>>,
    above: Vec<Hash>,
}

impl Branch {
    fn new(number: u64, count: u64) -> Self {
        let mut branch = Self { number, count, nodes: Vec::new(), above: Vec::new() };
        branch.nodes = vec![None; branch.first(LEVELS)];
        branch
    }

    /// Its nodes on a level.
    fn width(&self, level: u32) -> usize {
        let (all, most) = (self.count.div_ceil(1 << level), 1 << (LEVELS - level));
        usize::try_from(all.saturating_sub(self.number << (LEVELS - level)).min(most)).unwrap_or_default()
    }

    /// Where a level begins among the nodes; a node alone has no sibling and is not kept.
    fn first(&self, level: u32) -> usize {
        (0..level).map(|level| self.width(level)).filter(|width| *width > 1).sum()
    }

    /// Of a leaf's ancestor.
    fn sibling(&self, index: u64, level: u32) -> Option<usize> {
        let place = usize::try_from((index >> level) & ((1 << (LEVELS - level)) - 1)).ok()? ^ 1;
        (place < self.width(level)).then(|| self.first(level) + place)
    }

    /// The hash of both nodes below, if known.
    fn derived(&self, level: u32, place: usize) -> Option<Hash> {
        let below = level.checked_sub(1)?;
        let at = |place: usize| self.nodes.get(self.first(below) + place).copied().flatten();
        let left = at(2 * place)?;
        if 2 * place + 1 < self.width(below) { Some(node(&left, &at(2 * place + 1)?)) } else { Some(left) }
    }

    /// Level and place of every node, from the leaves up.
    fn places(&self) -> Vec<(u32, usize)> {
        let levels = (0..LEVELS).filter(|level| self.width(*level) > 1);
        levels.flat_map(|level| (0..self.width(level)).map(move |place| (level, place))).collect()
    }

    /// A bit for each node that is known and not derived, these nodes, and the steps above.
    fn to_bytes(&self) -> Vec<u8> {
        let mut bits = 0_u32;
        let mut hashes = Vec::new();
        for (bit, (hash, (level, place))) in self.nodes.iter().zip(self.places()).enumerate() {
            if let Some(hash) = hash.filter(|_| self.derived(level, place).is_none()) {
                bits |= 1 << bit;
                hashes.push(hash);
            }
        }
        let hashes = hashes.iter().chain(&self.above).flat_map(|hash| hash.0);
        bits.to_be_bytes().into_iter().chain(hashes).collect()
    }

    fn from_bytes(number: u64, count: u64, bytes: &[u8]) -> Self {
        let mut branch = Self::new(number, count);
        let Some((bits, hashes)) = bytes.split_first_chunk() else { return branch };
        let bits = u32::from_be_bytes(*bits);
        let mut hashes = hashes.chunks_exact(Hash::LENGTH).filter_map(Hash::from_slice);
        for (bit, (level, place)) in branch.places().into_iter().enumerate() {
            let known = if bits >> bit & 1 == 1 { hashes.next() } else { branch.derived(level, place) };
            branch.nodes.get_mut(bit).into_iter().for_each(|node| *node = known);
        }
        branch.above = hashes.collect();
        branch
    }

    fn add(&mut self, index: u64, path: &[Hash]) {
        let mut steps = path.iter();
        for level in 0..LEVELS {
            let Some(place) = self.sibling(index, level) else { continue };
            if let (Some(node), Some(step)) = (self.nodes.get_mut(place), steps.next()) {
                *node = Some(*step);
            }
        }
        self.above = steps.copied().collect();
    }

    /// Zeros for unknown nodes.
    fn path(&self, index: u64) -> Vec<Hash> {
        let own = (0..LEVELS).filter_map(|level| self.nodes.get(self.sibling(index, level)?));
        let own = own.map(|node| node.unwrap_or(Hash([0; Hash::LENGTH])));
        own.chain(self.above.iter().copied()).collect()
    }

    fn write(&self, connection: &Connection, batch: i64) -> Result<(), StoreError> {
        if self.nodes.is_empty() && self.above.is_empty() {
            return Ok(());
        }
        let sql = "INSERT INTO branches VALUES (?1, ?2, ?3)
            ON CONFLICT (batch, branch) DO UPDATE SET path = excluded.path";
        connection.run(sql, params![batch, whole("branch", self.number)?, self.to_bytes()])
    }
}

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

/// Joins the branch of a row of `leaves`, for [`Branches::path_of`].
pub(super) const JOINED: &str =
    "LEFT JOIN branches ON branches.batch = leaves.batch AND branches.branch = leaves.leaf >> 4";

/// Branches by the roots of their batches, each decoded once for all of its leaves.
#[derive(Default)]
pub(super) struct Branches(HashMap<(Hash, u64), Branch>);

impl Branches {
    pub(super) fn path_of(
        &mut self,
        row: &Row<'_>,
        column: usize,
        root: Hash,
        (index, count): (u64, u64),
    ) -> sql::Result<Vec<Hash>> {
        let number = index >> LEVELS;
        let branch = match self.0.entry((root, number)) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(unknown) => {
                let bytes: Option<Vec<u8>> = row.get(column)?;
                unknown.insert(Branch::from_bytes(number, count, &bytes.unwrap_or_default()))
            }
        };
        Ok(branch.path(index))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::merkle::Tree;

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
                let encoded = branch.to_bytes();
                bytes += encoded.len();
                let again = Branch::from_bytes(number, count, &encoded);
                of_branch.for_each(|index| assert_eq!(again.path(index), path(index), "{index} of {count}"));
            }
            if count == 1_000 {
                assert!(bytes < 46 * 1_000, "{bytes}: a path alone has 320");
            }
        }
        // Damaged bytes are a wrong path, and no panic.
        for length in 0..700 {
            assert!(Branch::from_bytes(0, 9, &vec![0xff; length]).path(3).len() >= 4, "{length}");
        }
    }
}
