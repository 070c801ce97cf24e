//! Disk space reserved for what must succeed on a full disk: a file of random bytes, deleted when the space is needed.
//!
//! Random, so that no file system compresses it; written and fsynced, so that the space is really allocated.

use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::{StoreError, files};

/// Bytes reserved for a revoke: enough for it with its audit line, its transaction, the keyring and a block.
pub const RESERVE_BYTES: u64 = 4 * 1024 * 1024;
/// Random bytes drawn at a time.
const PIECE: usize = 64 * 1024;

/// The reserve of a home.
#[derive(Debug)]
pub struct Reserve {
    path: PathBuf,
    bytes: u64,
    /// Whether the space is reserved.
    held: Mutex<bool>,
}

impl Reserve {
    /// The reserve of this many bytes at `path`; it is [`Self::refill`]ed if it is missing or truncated.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`], [`StoreError::Home`]; there is no reserve then, but the handle can still be used.
    pub fn open(path: &Path, bytes: u64) -> (Self, Result<(), StoreError>) {
        let whole = fs::metadata(path).is_ok_and(|about| about.len() == bytes);
        let reserve = Self { path: path.to_owned(), bytes, held: Mutex::new(whole) };
        let filled = reserve.refill();
        (reserve, filled)
    }

    fn held(&self) -> MutexGuard<'_, bool> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether the space is currently reserved.
    pub fn is_held(&self) -> bool {
        *self.held()
    }

    /// Releases the space; returns whether there was any.
    ///
    /// # Errors
    /// [`StoreError::Home`] if the file cannot be removed.
    pub fn release(&self) -> Result<bool, StoreError> {
        let mut held = self.held();
        if !*held {
            return Ok(false);
        }
        fs::remove_file(&self.path).map_err(|error| StoreError::home(&self.path, &error))?;
        *held = false;
        Ok(true)
    }

    /// Reserves the space again, if it is not.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`], [`StoreError::Home`]; nothing is reserved then.
    pub fn refill(&self) -> Result<(), StoreError> {
        let mut held = self.held();
        if *held {
            return Ok(());
        }
        let filled = files::open_private(&self.path).and_then(|file| {
            fill(file, self.bytes).map_err(|error| StoreError::home(&self.path, &error))?;
            Ok(())
        });
        if let Err(error) = filled {
            // Half a reserve would take space that others need now.
            drop(fs::remove_file(&self.path));
            return Err(error);
        }
        *held = true;
        Ok(())
    }
}

fn fill(mut file: File, bytes: u64) -> std::io::Result<()> {
    file.set_len(0)?;
    let mut piece = vec![0; PIECE];
    let mut left = bytes;
    while left > 0 {
        let length = usize::try_from(left).unwrap_or(PIECE).min(PIECE);
        let Some(part) = piece.get_mut(..length) else { break };
        getrandom::fill(part).map_err(|error| std::io::Error::other(error.to_string()))?;
        file.write_all(part)?;
        left -= length as u64;
    }
    file.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn space_is_set_aside_given_up_once_and_set_aside_again() {
        let home = tempfile::tempdir().expect("folder");
        let path = home.path().join("reserve");
        let size = || fs::metadata(&path).map(|about| about.len()).ok();
        let (reserve, opened) = Reserve::open(&path, RESERVE_BYTES);
        assert_eq!((opened, reserve.is_held(), size()), (Ok(()), true, Some(RESERVE_BYTES)));
        assert_eq!((reserve.release(), reserve.release(), size()), (Ok(true), Ok(false), None));
        reserve.refill().expect("there is room");
        assert_eq!(size(), Some(RESERVE_BYTES));
        fs::write(&path, b"cut short").expect("written");
        let (again, opened) = Reserve::open(&path, RESERVE_BYTES);
        assert_eq!((opened, again.is_held(), size()), (Ok(()), true, Some(RESERVE_BYTES)));
        let (none, opened) = Reserve::open(&home.path().join("no/such/folder"), RESERVE_BYTES);
        assert!(opened.is_err() && !none.is_held() && none.release() == Ok(false));
    }
}
