//! Recordings and other homes: imported as records, exported from records; and their progress.

mod export;
mod follow;
mod from_home;
mod import;

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

pub(in crate::site) use self::import::RECORDING;

use crate::model::{Address, ProfileName, locked};
use crate::pipeline::{CapturedMessage, Rings};
use crate::site::parts::{Run, Running};
use crate::site::{Capture, Contacts, Evidence, Parts, Profiles, Reading, SealerThread};

pub(in crate::site) struct Recordings {
    pub parts: Parts,
    pub contacts: Arc<Contacts>,
    pub reading: Arc<Reading>,
    pub capture: Arc<Capture>,
    pub profiles: Arc<Profiles>,
    pub sealer: Arc<SealerThread>,
    pub rings: Arc<Rings<CapturedMessage>>,
    pub evidence: Arc<Evidence>,
    pub claims: Arc<Claims>,
}

impl Recordings {
    fn begin_run(&self, profile: &ProfileName, path: &Path, step: &'static str) -> Running {
        self.parts.runs.begin(profile, &path.display().to_string(), step, "messages")
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Mark {
    /// Device and inode: a file may have other names.
    Place(u64, u64),
    /// A recorder that compresses a file on closing makes another one with the same messages.
    Name(PathBuf),
    /// With all below it.
    Folder(PathBuf),
}

impl Mark {
    fn meets(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Folder(one), Self::Folder(other)) => one.starts_with(other) || other.starts_with(one),
            _ => self == other,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::site) enum Holder {
    Import,
    Follower,
}

/// A file, and who has it.
type Taken = (PathBuf, Holder);

#[derive(Debug, Default)]
pub(in crate::site) struct Claims(Mutex<Vec<(Address, Mark, Holder)>>);

#[derive(Debug)]
pub(in crate::site) struct Claim {
    claims: Arc<Claims>,
    held: Vec<(Address, Mark, Holder)>,
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
    pub fn take(self: &Arc<Self>, owner: Address, files: &[PathBuf], holder: Holder) -> Result<Claim, Taken> {
        let marks = files.iter().flat_map(|file| marks(file).into_iter().map(move |mark| (file.as_path(), mark)));
        self.take_marks(owner, marks.collect(), holder)
    }

    /// Takes a folder for a follower, but not its files.
    pub fn take_folder(self: &Arc<Self>, owner: Address, folder: &Path) -> Result<Claim, Taken> {
        self.take_marks(owner, vec![(folder, Mark::Folder(folder.to_owned()))], Holder::Follower)
    }

    fn take_marks(self: &Arc<Self>, owner: Address, marks: Vec<(&Path, Mark)>, holder: Holder) -> Result<Claim, Taken> {
        let mut all = locked(&self.0);
        for (path, mark) in &marks {
            if let Some((.., holder)) = all.iter().find(|(of, other, _)| *of == owner && other.meets(mark)) {
                return Err(((*path).to_owned(), *holder));
            }
        }
        let held: Vec<_> = marks.into_iter().map(|(_, mark)| (owner, mark, holder)).collect();
        all.extend(held.iter().cloned());
        Ok(Claim { claims: Arc::clone(self), held })
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        let mut all = locked(&self.claims.0);
        all.retain(|claim| !self.held.contains(claim));
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

    #[test]
    fn a_folder_is_followed_once_and_neither_above_nor_below_itself() {
        let (claims, owner) = (Arc::<Claims>::default(), Address([1; 20]));
        let held = claims.take_folder(owner, Path::new("/data/run")).expect("free");
        for other in ["/data/run", "/data", "/data/run/part"] {
            assert!(claims.take_folder(owner, Path::new(other)).is_err(), "{other}");
        }
        assert!(claims.take_folder(owner, Path::new("/data/run2")).is_ok());
        drop(held);
        assert!(claims.take_folder(owner, Path::new("/data")).is_ok());
    }
}
