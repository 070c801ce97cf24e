//! A home that cannot be written, such as a read-only image: commands read a working copy among the temporary files.

use std::fs::{self, File, TryLockError};
use std::io;
use std::os::unix::fs::{DirBuilderExt as _, PermissionsExt as _};
use std::path::Path;

use super::reply::Failure;
use crate::model::{ByteSize, ErrorKind};
use crate::paths::Home;

/// Larger files are linked, not copied.
const SMALL: u64 = 64 << 20;
/// What a site makes for itself.
const OWN: [&str; 6] = ["reserve", "reserve.states", "waiting", "site.lock", "site.sock", "serve.log"];
/// Folders that a site writes to.
const COPIED: [&str; 3] = ["chain", "gateway", "profiles"];

pub fn is_read_only(home: &Home) -> bool {
    let denied =
        |error: &io::Error| matches!(error.kind(), io::ErrorKind::ReadOnlyFilesystem | io::ErrorKind::PermissionDenied);
    home.ledger().exists() && tempfile::tempfile_in(home.root()).is_err_and(|error| denied(&error))
}

/// A private working copy of such a home, for [`forget`] to delete; `None` while another process has the home.
pub fn working_copy(home: &Home) -> Result<Option<Home>, Failure> {
    // If others can write it, it may be in use.
    let lock = File::open(home.site_lock()).ok();
    if lock.as_ref().is_some_and(|lock| matches!(lock.try_lock(), Err(TryLockError::WouldBlock))) {
        return Ok(None);
    }
    let folder = tempfile::Builder::new()
        .prefix("authros-look-")
        .permissions(fs::Permissions::from_mode(0o700))
        .tempdir()
        .map_err(|error| uncopied(home, &error))?;
    let root = std::path::absolute(home.root()).map_err(|error| uncopied(home, &error))?;
    copy_home(&root, folder.path()).map_err(|error| uncopied(home, &error))?;
    Ok(Some(home.copied_to(folder.keep())))
}

/// Deletes a working copy, and nothing else.
pub fn forget(home: &Home) {
    if home.original().is_some() {
        drop(fs::remove_dir_all(home.root()));
    }
}

fn copy_home(from: &Path, to: &Path) -> io::Result<()> {
    for entry in fs::read_dir(from)? {
        let (entry, name) = entry.map(|entry| (entry.path(), entry.file_name()))?;
        let about = fs::symlink_metadata(&entry)?;
        let (is, target) = (|names: &[&str]| names.iter().any(|one| name == *one), to.join(&name));
        let of_the_ledger = name.to_string_lossy().starts_with("ledger.db");
        if is(&OWN) || name.to_string_lossy().ends_with("-shm") {
            continue;
        }
        if about.is_dir() && is(&COPIED) {
            copy_folder(&entry, &target)?;
        } else if about.is_file() && (of_the_ledger || about.len() <= SMALL) {
            copy_file(&entry, &target)?;
        } else if about.is_file() || about.is_dir() || about.is_symlink() {
            std::os::unix::fs::symlink(&entry, &target)?;
        }
    }
    Ok(())
}

fn copy_folder(from: &Path, to: &Path) -> io::Result<()> {
    fs::DirBuilder::new().mode(0o700).create(to)?;
    for entry in fs::read_dir(from)? {
        let (entry, name) = entry.map(|entry| (entry.path(), entry.file_name()))?;
        let (about, target) = (fs::symlink_metadata(&entry)?, to.join(&name));
        // A passphrase is never copied.
        if name == "passphrase" || name.to_string_lossy().ends_with("-shm") {
            continue;
        }
        if about.is_dir() {
            copy_folder(&entry, &target)?;
        } else if about.is_file() {
            copy_file(&entry, &target)?;
        }
    }
    Ok(())
}

fn copy_file(from: &Path, to: &Path) -> io::Result<()> {
    fs::copy(from, to)?;
    // A file that others can read is refused as in the home; one that nobody can write is not.
    let mode = fs::metadata(from)?.permissions().mode();
    fs::set_permissions(to, fs::Permissions::from_mode(mode & 0o777 | 0o600))
}

fn uncopied(home: &Home, error: &io::Error) -> Failure {
    let (root, folder) = (home.root().display(), std::env::temp_dir());
    let bytes = fs::metadata(home.ledger()).map_or(0, |about| about.len());
    Failure::new(
        ErrorKind::Home,
        format!(
            "{root} cannot be written, and no copy to look at could be made in {}: {error}; set TMPDIR to a folder with \
             more room than its ledger and chain take ({} and more), or make the home writable",
            folder.display(),
            ByteSize(bytes)
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
}
