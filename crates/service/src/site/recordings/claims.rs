//! Which recordings are being sealed now. There is one site of a home, so this holds for the home: an import and a follower,
//! or two of either, never seal one file at the same time.

use std::collections::HashMap;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use crate::model::Address;

/// What a file is known by while it is sealed.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
enum Mark {
    /// Its device and inode: it may have other names.
    Place(u64, u64),
    /// Its name. A recorder makes another file of one that it compresses when it is closed, with the same messages.
    Name(PathBuf),
}

/// Who seals a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Holder {
    /// `bag import`.
    Import,
    /// `bag follow`.
    Follower,
}

/// The files that are being sealed, each for its owner.
#[derive(Debug, Default)]
pub(super) struct Claims(Mutex<HashMap<(Address, Mark), Holder>>);

/// Some of them, until this is dropped.
#[derive(Debug)]
pub(super) struct Claim {
    claims: Arc<Claims>,
    held: Vec<(Address, Mark)>,
}

fn marks(path: &Path) -> Vec<Mark> {
    let place = fs::metadata(path).ok().map(|found| Mark::Place(found.dev(), found.ino()));
    let name = path.canonicalize().ok().map(|mut name| {
        if name.extension().is_some_and(|end| end == "zstd") {
            name.set_extension("");
        }
        Mark::Name(name)
    });
    place.into_iter().chain(name).collect()
}

impl Claims {
    /// Takes all of these files, or none.
    ///
    /// # Errors
    /// A file that is being sealed already, and who seals it.
    pub fn take(
        self: &Arc<Self>,
        owner: Address,
        files: &[PathBuf],
        holder: Holder,
    ) -> Result<Claim, (PathBuf, Holder)> {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut held = Vec::new();
        for file in files {
            for mark in marks(file) {
                if let Some(holder) = all.get(&(owner, mark.clone())) {
                    return Err((file.clone(), *holder));
                }
                held.push((owner, mark));
            }
        }
        all.extend(held.iter().cloned().map(|mark| (mark, holder)));
        Ok(Claim { claims: Arc::clone(self), held })
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        let mut all = self.claims.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|mark, _| !self.held.contains(mark));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_sealed_by_one_at_a_time_whatever_it_is_called() {
        let home = tempfile::tempdir().expect("a folder");
        let path = |name: &str| home.path().join(name);
        for name in ["run_0.mcap", "run_1.mcap", "run_0.mcap.zstd", "run_2.mcap"] {
            fs::write(path(name), name).expect("written");
        }
        fs::hard_link(path("run_1.mcap"), path("other.mcap")).expect("linked");
        let (claims, alice, bob) = (Arc::<Claims>::default(), Address([1; 20]), Address([2; 20]));
        let take = |owner, names: &[&str], holder| {
            let files: Vec<_> = names.iter().map(|name| path(name)).collect();
            claims.take(owner, &files, holder)
        };
        let held = take(alice, &["run_0.mcap", "run_1.mcap"], Holder::Follower).expect("free");
        for name in ["run_0.mcap", "run_0.mcap.zstd", "other.mcap"] {
            let refused = take(alice, &["run_2.mcap", name], Holder::Import).expect_err("held");
            assert_eq!(refused, (path(name), Holder::Follower));
        }
        let others = (take(alice, &["run_2.mcap"], Holder::Import), take(bob, &["run_0.mcap"], Holder::Import));
        assert!(others.0.is_ok() && others.1.is_ok(), "what was refused took nothing");
        drop(held);
        assert!(take(alice, &["run_0.mcap.zstd", "other.mcap"], Holder::Import).is_ok());
    }
}
