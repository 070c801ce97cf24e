//! Who else could change or replace a file: nobody but one user and root should.

use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

/// Write permission for group and others.
const WRITTEN_BY_OTHERS: u32 = 0o022;
/// The mode bit of a folder in which users can change only their own files.
const STICKY: u32 = 0o1000;

/// Why somebody else could replace a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Fault {
    /// This belongs to another user.
    Foreign(PathBuf),
    /// Others can write to this.
    Open(PathBuf),
}

/// How somebody other than `user` and root could change a file or folder, or replace it through a folder above it.
///
/// # Errors
/// If the file or a folder cannot be examined.
pub fn fault(file: &Path, user: u32) -> std::io::Result<Option<Fault>> {
    let whole = file.canonicalize()?;
    for (depth, path) in whole.ancestors().enumerate() {
        let about = std::fs::metadata(path)?;
        if about.uid() != user && about.uid() != 0 {
            return Ok(Some(Fault::Foreign(path.to_owned())));
        }
        // In a folder with the sticky bit nobody can replace another user's files.
        let is_kept_apart = depth > 0 && about.mode() & STICKY != 0;
        if about.mode() & WRITTEN_BY_OTHERS != 0 && !is_kept_apart {
            return Ok(Some(Fault::Open(path.to_owned())));
        }
    }
    Ok(None)
}
