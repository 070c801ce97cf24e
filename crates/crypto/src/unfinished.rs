//! Temporary names are made here alone, so that what a killed process leaves is found again. Their maker holds a lock,
//! which a sweep takes first: it never removes what a living process writes.
#![allow(clippy::missing_errors_doc, reason = "errors of the file system")]

use std::fs::{self, File, Permissions, TryLockError};
use std::io;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::path::Path;

use tempfile::{NamedTempFile, TempDir};

/// What every temporary name begins with.
pub const PREFIX: &str = ".authros-new-";
/// How often a name is tried again that a sweep took before it was locked.
const TRIES: usize = 16;

/// A new file (mode 0600) in a folder; removed on drop, unless it was moved to its place.
pub fn new_file(folder: &Path) -> io::Result<NamedTempFile> {
    for _ in 0..TRIES {
        let permissions = Permissions::from_mode(0o600);
        let file = tempfile::Builder::new().prefix(PREFIX).permissions(permissions).tempfile_in(folder)?;
        if holds(file.as_file())? {
            return Ok(file);
        }
    }
    Err(io::Error::other("a new file in it is removed again and again by another process"))
}

/// A new folder (mode 0700); removed with its contents on drop, unless it was moved to its place.
#[derive(Debug)]
pub struct UnfinishedFolder {
    folder: TempDir,
    _lock: File,
}

impl UnfinishedFolder {
    /// In `parent`.
    pub fn new(parent: &Path) -> io::Result<Self> {
        for _ in 0..TRIES {
            let permissions = Permissions::from_mode(0o700);
            let folder = tempfile::Builder::new().prefix(PREFIX).permissions(permissions).tempdir_in(parent)?;
            let lock = File::open(folder.path());
            if let Ok(lock) = lock
                && holds(&lock)?
            {
                return Ok(Self { folder, _lock: lock });
            }
        }
        Err(io::Error::other("a new folder in it is removed again and again by another process"))
    }

    /// Removes it with its contents.
    pub fn close(self) -> io::Result<()> {
        self.folder.close()
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }
}

/// Locks what was just made; `false` if a sweep was faster. A file system without locks has no sweeps either.
fn holds(made: &File) -> io::Result<bool> {
    match made.try_lock() {
        Err(TryLockError::WouldBlock) => Ok(false),
        Ok(()) | Err(TryLockError::Error(_)) => Ok(made.metadata()?.nlink() > 0),
    }
}

/// Removes what killed processes left unfinished in a folder; returns how many files and folders. What cannot be removed
/// stays until the next sweep.
pub fn sweep(folder: &Path) -> io::Result<usize> {
    let mut removed = 0;
    for entry in fs::read_dir(folder)?.flatten() {
        let ours = entry.file_name().to_str().is_some_and(|name| name.starts_with(PREFIX));
        if ours && remove_dead(&entry.path()).unwrap_or(false) {
            removed += 1;
        }
    }
    Ok(removed)
}

/// Like [`sweep`], also in the folders below it, as deep as a home is; what cannot be listed is left out.
pub fn sweep_below(folder: &Path) -> usize {
    fn below(folder: &Path, depth: u8) -> usize {
        let mut removed = sweep(folder).unwrap_or(0);
        if depth > 0 {
            for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
                if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                    removed += below(&entry.path(), depth - 1);
                }
            }
        }
        removed
    }
    below(folder, 4)
}

fn remove_dead(path: &Path) -> io::Result<bool> {
    let kind = fs::symlink_metadata(path)?.file_type();
    if !kind.is_file() && !kind.is_dir() {
        return Ok(false);
    }
    let handle = File::open(path)?;
    if handle.try_lock().is_err() {
        return Ok(false);
    }
    if kind.is_dir() {
        fs::remove_dir_all(path)?
    } else {
        fs::remove_file(path)?
    }
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sweep_removes_what_the_dead_left_and_nothing_of_the_living() {
        let home = tempfile::tempdir().expect("a folder");
        let place = home.path();
        let deep = place.join("profiles/alice");
        fs::create_dir_all(&deep).expect("folders");
        let dead = deep.join(format!("{PREFIX}dead01"));
        fs::write(&dead, b"keys").expect("written");
        let copy = place.join(format!("{PREFIX}dead02"));
        fs::create_dir(&copy).expect("a folder");
        fs::write(copy.join("copy.db"), b"records").expect("written");
        std::os::unix::fs::symlink("/", place.join(format!("{PREFIX}link00"))).expect("a link");
        fs::write(place.join("kept"), b"").expect("written");
        let (file, folder) = (new_file(place).expect("made"), UnfinishedFolder::new(place).expect("made"));

        assert_eq!(sweep_below(place), 2);
        assert!(!dead.exists() && !copy.exists(), "what was left is gone");
        assert!(file.path().exists() && folder.path().exists() && place.join("kept").exists());
        let target = place.join("placed");
        file.persist(&target).expect("moved to its place");
        drop(folder);
        assert_eq!(sweep_below(place), 0);
        assert!(target.exists());
        assert_eq!(fs::metadata(&target).expect("there").permissions().mode() & 0o777, 0o600);
    }

    #[test]
    fn a_file_that_is_swept_before_it_is_locked_is_made_again() {
        let home = tempfile::tempdir().expect("a folder");
        let place = home.path().to_owned();
        let stop = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(false));
        let sweeping = std::thread::spawn({
            let (place, stop) = (place.clone(), std::sync::Arc::clone(&stop));
            move || {
                while !stop.load(std::sync::atomic::Ordering::Acquire) {
                    drop(sweep(&place));
                }
            }
        });
        for number in 0..500 {
            let file = new_file(&place).expect("made");
            file.persist(place.join(number.to_string())).expect("still there");
        }
        stop.store(true, std::sync::atomic::Ordering::Release);
        sweeping.join().expect("ends");
        assert_eq!(fs::read_dir(&place).expect("listed").count(), 500);
    }
}
