//! A ring that came out of a backup: what is in it was captured before, and would fall out by its age the moment it is
//! opened. It ages from the first opening after that instead: there is as much time to ask for it as its limits say.

use std::fs;
use std::path::Path;

use super::segment;
use crate::model::Timestamp;
use crate::store::{StoreError, files};

/// The file that says so: the last number of the files that came out of the backup, and, once the ring was opened, when.
const RESTORED: &str = "restored";

/// Notes that all files of a ring come out of a backup; returns whether there is one.
///
/// # Errors
/// [`StoreError::Home`] if its folder cannot be read or written.
pub fn note_restored(folder: &Path) -> Result<bool, StoreError> {
    if !folder.exists() {
        return Ok(false);
    }
    let Some((last, _)) = segment::list(folder)?.pop() else { return Ok(false) };
    files::atomic_write(&folder.join(RESTORED), format!("{last}\n").as_bytes())?;
    Ok(true)
}

/// The last number that came out of a backup, and from when on all up to it age, where later than their capture.
pub(super) fn ages_from(folder: &Path, now: Timestamp) -> Option<(u64, Timestamp)> {
    let path = folder.join(RESTORED);
    let text = fs::read_to_string(&path).ok()?;
    let mut words = text.split_whitespace();
    let last: u64 = words.next()?.parse().ok()?;
    if let Some(opened) = words.next().and_then(|word| word.parse().ok()) {
        // A clock that was ahead then, and is set right now, keeps nothing for ever.
        return Some((last, Timestamp(opened).min(now)));
    }
    // Without this line the next opening counts as the first: they stay longer, nothing is lost.
    drop(files::atomic_write(&path, format!("{last} {}\n", now.0).as_bytes()));
    Some((last, now))
}
