//! A home that cannot be written, such as a read-only image: commands read a working copy among the temporary files.

use std::fs::{self, File, TryLockError};
use std::io;
use std::os::unix::fs::{DirBuilderExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};

use super::reply::Failure;
use crate::model::{ByteSize, ErrorKind};
use crate::paths::Home;
use crate::store::files::free_bytes;

/// Larger files are linked, not copied.
const SMALL: u64 = 64 << 20;
/// Room that a copy leaves to others.
const LEFT: u64 = 64 << 20;
/// What a site makes for itself.
const OWN: [&str; 6] = ["reserve", "reserve.states", "waiting", "site.lock", "site.sock", "serve.log"];
/// Folders that a site writes to.
const COPIED: [&str; 3] = ["chain", "gateway", "profiles"];

pub fn is_read_only(home: &Home) -> bool {
    let denied =
        |error: &io::Error| matches!(error.kind(), io::ErrorKind::ReadOnlyFilesystem | io::ErrorKind::PermissionDenied);
    home.ledger().exists() && tempfile::tempfile_in(home.root()).is_err_and(|error| denied(&error))
}

/// A private working copy of such a home, for [`forget`] to delete; `None` while another process has the home. Nothing is
/// copied unless all of it has room: the folder may be a machine's memory.
pub fn working_copy(home: &Home) -> Result<Option<Home>, Failure> {
    // If others can write it, it may be in use.
    let lock = File::open(home.site_lock()).ok();
    if lock.as_ref().is_some_and(|lock| matches!(lock.try_lock(), Err(TryLockError::WouldBlock))) {
        return Ok(None);
    }
    let failed = |error: io::Error| uncopied(home, &error.to_string());
    let folder = tempfile::Builder::new()
        .prefix("authros-look-")
        .permissions(fs::Permissions::from_mode(0o700))
        .tempdir()
        .map_err(failed)?;
    let root = std::path::absolute(home.root()).map_err(failed)?;
    let mut plan = Plan::default();
    plan.home(&root, folder.path()).map_err(failed)?;
    let free = free_bytes(folder.path())?;
    if let Some(reason) = plan.lacks_room(free) {
        return Err(uncopied(home, &reason));
    }
    plan.carry_out().map_err(failed)?;
    Ok(Some(home.copied_to(folder.keep())))
}

/// Deletes a working copy, and nothing else.
pub fn forget(home: &Home) {
    if home.original().is_some() {
        drop(fs::remove_dir_all(home.root()));
    }
}

/// What a working copy is and costs, for the person who waits for it.
pub fn about(copy: &Home, original: &Path) -> String {
    let (bytes, folder) = (bytes_below(copy.root()), std::env::temp_dir());
    format!(
        "{} is read-only: it is read in a copy that takes {} in {} (TMPDIR) and is deleted at the end",
        original.display(),
        ByteSize(bytes),
        folder.display()
    )
}

fn bytes_below(folder: &Path) -> u64 {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let bytes = entries.map(|entry| match entry.metadata() {
        Ok(about) if about.is_dir() => bytes_below(&entry.path()),
        Ok(about) if about.is_file() => about.len(),
        _ => 0,
    });
    bytes.sum()
}

/// What is made of a home, from and to.
#[derive(Default)]
struct Plan {
    folders: Vec<PathBuf>,
    files: Vec<(PathBuf, PathBuf)>,
    links: Vec<(PathBuf, PathBuf)>,
    bytes: u64,
}

impl Plan {
    fn home(&mut self, from: &Path, to: &Path) -> io::Result<()> {
        for entry in fs::read_dir(from)? {
            let (entry, name) = entry.map(|entry| (entry.path(), entry.file_name()))?;
            let about = fs::symlink_metadata(&entry)?;
            let (is, target) = (|names: &[&str]| names.iter().any(|one| name == *one), to.join(&name));
            let of_the_ledger = name.to_string_lossy().starts_with("ledger.db");
            if is(&OWN) || name.to_string_lossy().ends_with("-shm") {
                continue;
            }
            if about.is_dir() && is(&COPIED) {
                self.folder(&entry, target)?;
            } else if about.is_file() && (of_the_ledger || about.len() <= SMALL) {
                self.file(entry, target, about.len());
            } else if about.is_file() || about.is_dir() || about.is_symlink() {
                self.links.push((entry, target));
            }
        }
        Ok(())
    }

    fn folder(&mut self, from: &Path, to: PathBuf) -> io::Result<()> {
        for entry in fs::read_dir(from)? {
            let (entry, name) = entry.map(|entry| (entry.path(), entry.file_name()))?;
            let (about, target) = (fs::symlink_metadata(&entry)?, to.join(&name));
            // A passphrase is never copied.
            if name == "passphrase" || name.to_string_lossy().ends_with("-shm") {
                continue;
            }
            if about.is_dir() {
                self.folder(&entry, target)?;
            } else if about.is_file() {
                self.file(entry, target, about.len());
            }
        }
        self.folders.push(to);
        Ok(())
    }

    fn file(&mut self, from: PathBuf, to: PathBuf, bytes: u64) {
        self.files.push((from, to));
        self.bytes = self.bytes.saturating_add(bytes);
    }

    fn lacks_room(&self, free: u64) -> Option<String> {
        let needed = self.bytes.saturating_add(LEFT);
        (free < needed).then(|| format!("it needs {} and {} are free", ByteSize(needed), ByteSize(free)))
    }

    fn carry_out(self) -> io::Result<()> {
        for folder in &self.folders {
            fs::DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
        }
        for (from, to) in &self.files {
            fs::copy(from, to)?;
            // A file that others can read is refused as in the home; one that nobody can write is not.
            let mode = fs::metadata(from)?.permissions().mode();
            fs::set_permissions(to, fs::Permissions::from_mode(mode & 0o777 | 0o600))?;
        }
        self.links.iter().try_for_each(|(from, to)| std::os::unix::fs::symlink(from, to))
    }
}

fn uncopied(home: &Home, reason: &str) -> Failure {
    let (root, folder) = (home.root().display(), std::env::temp_dir());
    Failure::new(
        ErrorKind::Home,
        format!(
            "set TMPDIR to a folder on a disk with more room, or make {root} writable: it cannot be written, and no copy \
             to look at could be made in {}: {reason}",
            folder.display(),
        ),
    )
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test fails by panicking")]

    use super::*;

    #[test]
    fn a_copy_has_all_but_secrets_and_goes_again() {
        let folder = tempfile::tempdir().expect("a folder");
        let home = Home::new(folder.path().join("home"));
        assert!(!is_read_only(&home), "there is none");
        for name in ["chain", "profiles/alice", "ring", "back-ups"] {
            fs::create_dir_all(home.root().join(name)).expect("made");
        }
        let files = ["ledger.db", "ledger.db-wal", "ledger.db-shm", "reserve"];
        for name in files.into_iter().chain(["chain/chain.db", "profiles/alice/keyring", "profiles/alice/passphrase"]) {
            crate::store::atomic_write(&home.root().join(name), name.as_bytes()).expect("written");
        }
        assert!(!is_read_only(&home), "it can be written");
        let copy = working_copy(&home).expect("copied").expect("free");
        let is_there = |name: &str| fs::read(copy.root().join(name)).is_ok_and(|bytes| bytes == name.as_bytes());
        let kept = ["ledger.db", "ledger.db-wal", "chain/chain.db"];
        assert!(kept.into_iter().chain(["profiles/alice/keyring"]).all(is_there));
        assert!(!["ledger.db-shm", "reserve", "profiles/alice/passphrase"].into_iter().any(is_there));
        let is_link = |name: &str| fs::symlink_metadata(copy.root().join(name)).expect("there").is_symlink();
        assert!(is_link("ring") && !is_link("ledger.db"));
        assert_eq!((copy.original(), home.original()), (Some(home.root()), None));
        forget(&home);
        forget(&copy);
        assert!(home.ledger().exists() && !copy.root().exists());
    }
    #[test]
    fn a_copy_that_would_fill_its_folder_is_not_begun() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut plan = Plan::default();
        crate::store::atomic_write(&folder.path().join("ledger.db"), &[7; 1000]).expect("written");
        crate::store::atomic_write(&folder.path().join("reserve"), &[7; 1000]).expect("written");
        plan.home(folder.path(), Path::new("/nowhere")).expect("read");
        assert_eq!(plan.bytes, 1000, "what a site makes for itself costs nothing");
        assert_eq!(plan.lacks_room(LEFT + 1000), None);
        let reason = plan.lacks_room(LEFT + 999).expect("a reason");
        assert!(reason.starts_with("it needs 64"), "{reason}");
    }
}
