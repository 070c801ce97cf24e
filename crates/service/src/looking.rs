//! A home that cannot be written, such as a read-only image: commands read a working copy among the temporary files.

use std::fs::{self, File, TryLockError};
use std::io;
use std::os::unix::fs::{DirBuilderExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};

use crate::model::{ByteSize, ErrorKind};
use crate::paths::Home;
use crate::reply::{Failure, Result};
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
pub fn working_copy(home: &Home) -> Result<Option<Home>> {
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
    let pieces = pieces_of(&root, folder.path(), true).map_err(failed)?;
    if let Some(reason) = lacks_room(&pieces, free_bytes(folder.path())?) {
        return Err(uncopied(home, &reason));
    }
    pieces.iter().try_for_each(Piece::make).map_err(failed)?;
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
    let bytes = fs::metadata(copy.ledger()).map_or(0, |about| about.len());
    format!(
        "{} is read-only: it is read in a copy in {} (TMPDIR), {} for its ledger, that is deleted at the end",
        original.display(),
        std::env::temp_dir().display(),
        ByteSize(bytes)
    )
}

/// A part of a working copy: from, to, and bytes.
enum Piece {
    Folder(PathBuf),
    File(PathBuf, PathBuf, u64),
    Link(PathBuf, PathBuf),
}

fn pieces_of(from: &Path, to: &Path, is_home: bool) -> io::Result<Vec<Piece>> {
    let mut pieces = Vec::new();
    for entry in fs::read_dir(from)? {
        let (entry, name) = entry.map(|entry| (entry.path(), entry.file_name()))?;
        let (about, target, name) = (fs::symlink_metadata(&entry)?, to.join(&name), name.to_string_lossy());
        // A passphrase is never copied.
        let is_left_out = if is_home { OWN.contains(&&*name) } else { name == "passphrase" };
        if is_left_out || name.ends_with("-shm") {
            continue;
        }
        let is_needed = !is_home || name.starts_with("ledger.db") || about.len() <= SMALL;
        if about.is_dir() && (!is_home || COPIED.contains(&&*name)) {
            let inside = pieces_of(&entry, &target, false)?;
            pieces.push(Piece::Folder(target));
            pieces.extend(inside);
        } else if about.is_file() && is_needed {
            pieces.push(Piece::File(entry, target, about.len()));
        } else if is_home && (about.is_file() || about.is_dir() || about.is_symlink()) {
            pieces.push(Piece::Link(entry, target));
        }
    }
    Ok(pieces)
}

fn lacks_room(pieces: &[Piece], free: u64) -> Option<String> {
    let bytes = |piece: &Piece| if let Piece::File(_, _, bytes) = piece { *bytes } else { 0 };
    let needed = pieces.iter().map(bytes).sum::<u64>() + LEFT;
    (free < needed).then(|| format!("it needs {} and {} are free", ByteSize(needed), ByteSize(free)))
}

impl Piece {
    fn make(&self) -> io::Result<()> {
        match self {
            Self::Folder(to) => fs::DirBuilder::new().mode(0o700).create(to),
            Self::File(from, to, _) => {
                fs::copy(from, to)?;
                // A file that others can read is refused as in the home; one that nobody can write is not.
                let mode = fs::metadata(from)?.permissions().mode();
                fs::set_permissions(to, fs::Permissions::from_mode(mode & 0o777 | 0o600))
            }
            Self::Link(from, to) => std::os::unix::fs::symlink(from, to),
        }
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
        for name in ["ledger.db", "reserve"] {
            crate::store::atomic_write(&folder.path().join(name), &[7; 1000]).expect("written");
        }
        let pieces = pieces_of(folder.path(), Path::new("/nowhere"), true).expect("read");
        assert_eq!(pieces.len(), 1, "what a site makes for itself costs nothing");
        assert_eq!(lacks_room(&pieces, LEFT + 1000), None);
        let reason = lacks_room(&pieces, LEFT + 999).expect("a reason");
        assert!(reason.starts_with("it needs 64"), "{reason}");
    }
}
