//! Many roots of batches under one stamp: a tree over them, its imprint, and `stamps/` of a bundle.

use std::collections::BTreeMap;

use authros_crypto::merkle::{LONGEST_PATH, MOST_LEAVES, Tree, root_of, stamp_hash};
use authros_model::Hash;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::der::LARGEST_DER;
use crate::BundleError;

/// The folder of stamps in a bundle.
const STAMPS: &str = "stamps";
/// The most roots under one stamp.
pub const MOST_ROOTS: usize = MOST_LEAVES;
/// The most tokens over the same roots: one from each authority.
pub const MOST_TOKENS: usize = 4;
/// The format name in `roots.json`, which also separates the imprint from any other use of SHA-256.
const FORMAT: &str = "authros-stamp/1";
const LABEL: &[u8] = b"AuthROS/stamp/1";
const ROOTS: &str = "roots.json";
const TOKEN_DIGITS: usize = 32;

/// SHA-256(`AuthROS/stamp/1` || top || count, 8 bytes big endian): the data that an authority stamps.
fn imprint_of(top: &Hash, count: u64) -> [u8; 32] {
    Sha256::new().chain_update(LABEL).chain_update(top.0).chain_update(count.to_be_bytes()).finalize().into()
}

/// The tree over roots of batches.
#[derive(Debug, Clone)]
pub struct StampTree {
    tree: Tree,
    roots: Vec<Hash>,
}

impl StampTree {
    /// Over these roots in this order; `None` if there are none, or more than [`MOST_ROOTS`].
    pub fn new(roots: Vec<Hash>) -> Option<Self> {
        Some(Self { tree: Tree::new(roots.iter().map(stamp_hash).collect())?, roots })
    }

    /// The data that an authority stamps.
    pub fn imprint(&self) -> [u8; 32] {
        imprint_of(&self.tree.root(), self.count())
    }

    fn count(&self) -> u64 {
        self.roots.len() as u64
    }

    /// The member `roots.json` of these roots, and the imprint under which it is filed; roots that are not in the tree
    /// are left out.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(crate) fn listed(&self, wanted: &[Hash]) -> Result<(Hash, Vec<u8>), BundleError> {
        let places: BTreeMap<&Hash, usize> = self.roots.iter().enumerate().map(|(at, root)| (root, at)).collect();
        let wanted: std::collections::BTreeSet<&Hash> = wanted.iter().collect();
        let roots = wanted.into_iter().filter_map(|root| {
            let index = *places.get(root)?;
            Some(StampedRoot { root: *root, index: index as u64, path: self.tree.path(index) })
        });
        let listed =
            Listed { format: FORMAT.to_owned(), top: self.tree.root(), count: self.count(), roots: roots.collect() };
        Ok((Hash(self.imprint()), places_text(&listed)?))
    }
}

/// A root under a stamp.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StampedRoot {
    /// The batch's root.
    pub root: Hash,
    /// Its place, from 0.
    pub index: u64,
    /// Hashes from it up to the top.
    pub path: Vec<Hash>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Listed {
    format: String,
    top: Hash,
    count: u64,
    roots: Vec<StampedRoot>,
}

fn places_text(listed: &Listed) -> Result<Vec<u8>, BundleError> {
    serde_json::to_vec_pretty(listed).map_err(|error| BundleError::of(ROOTS, &error.to_string()))
}

/// The name of a token's file: half of its SHA-256, since names of members are no longer than 120 bytes.
fn token_name(token: &[u8]) -> String {
    let digits = Hash(Sha256::digest(token).into()).to_hex();
    format!("{}.der", digits.get(..TOKEN_DIGITS).unwrap_or_default())
}

/// The members of one stamp.
pub(crate) fn members(
    tree: &StampTree,
    wanted: &[Hash],
    tokens: &[Vec<u8>],
) -> Result<Vec<(String, Vec<u8>)>, BundleError> {
    let (imprint, text) = tree.listed(wanted)?;
    let folder = format!("{STAMPS}/{}", imprint.to_hex());
    let tokens =
        tokens.iter().take(MOST_TOKENS).map(|token| (format!("{folder}/{}", token_name(token)), token.clone()));
    Ok(std::iter::once((format!("{folder}/{ROOTS}"), text)).chain(tokens).collect())
}

/// A stamp in a bundle: roots, each with its path to the stamped data, and the tokens over it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BundledStamp {
    /// The root of the tree over the roots.
    pub top: Hash,
    /// The number of roots under it.
    pub count: u64,
    /// Those shown by the bundle, each once, in their order.
    pub roots: Vec<StampedRoot>,
    /// One or more, DER; none is checked yet.
    pub tokens: Vec<Vec<u8>>,
}

impl BundledStamp {
    /// Whether a root's path leads to the stamped data.
    pub(crate) fn leads(&self, place: &StampedRoot) -> bool {
        root_of(stamp_hash(&place.root), place.index, self.count, &place.path) == Some(self.top)
    }
}

/// A stamp whose files are read one by one.
#[derive(Default)]
pub(crate) struct DraftStamp {
    listed: Option<Listed>,
    tokens: Vec<Vec<u8>>,
}

impl DraftStamp {
    pub fn take(&mut self, name: &str, part: &str, bytes: &[u8]) -> Result<(), BundleError> {
        let wrong = |why: &str| BundleError::of(name, why);
        if part == ROOTS {
            let listed: Listed = crate::form::from_json(bytes).map_err(|error| wrong(&error))?;
            if listed.format != FORMAT {
                return Err(wrong(&format!("its format is not {FORMAT}")));
            }
            if listed.count > MOST_ROOTS as u64 || listed.roots.len() > MOST_ROOTS {
                return Err(wrong(&format!("it has more than {MOST_ROOTS} roots")));
            }
            if !listed.roots.is_sorted_by(|one, next| one.root < next.root) {
                return Err(wrong("its roots are not in order, each once"));
            }
            if listed.roots.iter().any(|place| place.path.len() > LONGEST_PATH) {
                return Err(wrong("a path is longer than in any stamp"));
            }
            self.listed = Some(listed);
            return Ok(());
        }
        if bytes.len() > LARGEST_DER || part != token_name(bytes) {
            return Err(wrong("is not a token named by its SHA-256"));
        }
        if self.tokens.len() >= MOST_TOKENS {
            return Err(wrong(&format!("exceeds the limit of {MOST_TOKENS} tokens")));
        }
        self.tokens.push(bytes.to_vec());
        Ok(())
    }

    pub fn finish(self, imprint: &Hash) -> Result<BundledStamp, BundleError> {
        let name = format!("{STAMPS}/{}/{ROOTS}", imprint.to_hex());
        let listed = self.listed.ok_or_else(|| BundleError::of(&name, "is missing"))?;
        if imprint_of(&listed.top, listed.count) != imprint.0 {
            return Err(BundleError::of(&name, "is filed under another stamp's imprint"));
        }
        if self.tokens.is_empty() {
            return Err(BundleError::of(&name, "has no token with it"));
        }
        let Listed { top, count, roots, .. } = listed;
        Ok(BundledStamp { top, count, roots, tokens: self.tokens })
    }
}
