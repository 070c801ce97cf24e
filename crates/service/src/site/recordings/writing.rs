//! The file of an export: private, written beside its destination, and moved there only when it is complete.

use std::fs::File;
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use crate::crypto::{private_file, unfinished};
use crate::service::failure::input;
use crate::service::reply::Failure;

/// A file being written; it is removed unless it is moved to its destination.
pub(super) struct Draft {
    target: PathBuf,
    file: NamedTempFile,
}

impl Draft {
    /// A new file (0600) beside `target`, which must not exist. What a killed export left there is removed.
    pub fn begin(target: &Path) -> Result<(Self, File), Failure> {
        let taken = || input(format!("{} already exists; choose a new file", target.display()));
        if target.symlink_metadata().is_ok() {
            return Err(taken());
        }
        if target.file_name().is_none() {
            return Err(input(format!("{} is not a file", target.display())));
        }
        let folder = target.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let failed = |error: std::io::Error| input(format!("{} cannot be written: {error}", target.display()));
        unfinished::sweep(folder).map_err(failed)?;
        let file = unfinished::new_file(folder).map_err(failed)?;
        let open = file.as_file().try_clone().map_err(failed)?;
        Ok((Self { target: target.to_owned(), file }, open))
    }

    /// Moves the file to its destination; one that has appeared there meanwhile is not replaced.
    pub fn place(self) -> Result<(), Failure> {
        let failed = |error: std::io::Error| input(format!("{} cannot be written: {error}", self.target.display()));
        match std::fs::hard_link(self.file.path(), &self.target) {
            Ok(()) => Ok(()),
            // Not every file system has links.
            Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => {
                std::fs::rename(self.file.path(), &self.target).map_err(failed)
            }
            Err(error) => Err(failed(error)),
        }
    }

    /// Moves the file into a new folder at its destination, with a description beside it that is made from the file's name
    /// there. The folder appears whole.
    pub fn place_in_folder(self, description: &str, describe: impl FnOnce(&str) -> String) -> Result<(), Failure> {
        let failed = |error: std::io::Error| input(format!("{} cannot be written: {error}", self.target.display()));
        let parent = self.target.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let folder = unfinished::UnfinishedFolder::new(parent).map_err(failed)?;
        let name = format!("{}_0.mcap", self.target.file_name().unwrap_or_default().to_string_lossy());
        std::fs::rename(self.file.path(), folder.path().join(&name)).map_err(failed)?;
        private_file::create_private(&folder.path().join(description), describe(&name).as_bytes())?;
        if self.target.symlink_metadata().is_ok() {
            return Err(input(format!("{} already exists; choose a new folder", self.target.display())));
        }
        std::fs::rename(folder.path(), &self.target).map_err(failed)
    }
}
