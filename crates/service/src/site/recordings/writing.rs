//! The file of an export: private, written beside its destination, and moved there only when it is complete.

use std::fs::{File, OpenOptions};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use crate::crypto::random_bytes;
use crate::model::bytes::hex;
use crate::service::failure::input;
use crate::service::reply::Failure;

/// A file being written; it is removed unless it is moved to its destination.
pub(super) struct Draft {
    target: PathBuf,
    path: PathBuf,
    placed: bool,
}

impl Draft {
    /// A new file (0600) beside `target`, which must not exist.
    pub fn begin(target: &Path) -> Result<(Self, File), Failure> {
        let taken = || input(format!("{} already exists; choose a new file", target.display()));
        if target.symlink_metadata().is_ok() {
            return Err(taken());
        }
        let name = target.file_name().ok_or_else(|| input(format!("{} is not a file", target.display())))?;
        let part = format!(".{}.{}.part", name.to_string_lossy(), hex(&random_bytes::<4>()?));
        let path = target.with_file_name(part);
        let file = OpenOptions::new().write(true).read(true).create_new(true).mode(0o600).open(&path);
        let file = file.map_err(|error| input(format!("{} cannot be written: {error}", path.display())))?;
        Ok((Self { target: target.to_owned(), path, placed: false }, file))
    }

    /// Moves the file to its destination; one that has appeared there meanwhile is not replaced.
    pub fn place(mut self) -> Result<(), Failure> {
        let failed = |error: std::io::Error| input(format!("{} cannot be written: {error}", self.target.display()));
        match std::fs::hard_link(&self.path, &self.target) {
            Ok(()) => Ok(()),
            // Not every file system has links.
            Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => {
                let moved = std::fs::rename(&self.path, &self.target).map_err(failed);
                self.placed = moved.is_ok();
                moved
            }
            Err(error) => Err(failed(error)),
        }
    }
}

impl Drop for Draft {
    fn drop(&mut self) {
        if !self.placed {
            // If it is gone already, that is fine.
            drop(std::fs::remove_file(&self.path));
        }
    }
}
