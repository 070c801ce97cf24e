//! Files that hold secrets: read only if nobody else can read them, replaced in one step.

use std::fs::{self, DirBuilder, File};
use std::io::{ErrorKind, Read as _, Write as _};
use std::os::unix::fs::{DirBuilderExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};

use zeroize::Zeroizing;

use super::error::shown;
use super::{CryptoError, Result, fault, unfinished};

/// Permission bits of group and others.
const OTHERS: u32 = 0o077;

/// Reads a file of at most `most` bytes that only its owner may read.
/// # Errors
/// [`CryptoError::Read`], [`CryptoError::OpenToOthers`], or [`CryptoError::TooLong`].
pub fn read_private(path: &Path, most: usize) -> Result<Zeroizing<Vec<u8>>> {
    // Checked before it is opened, because opening a pipe would wait for its writer.
    let metadata = fs::metadata(path).map_err(CryptoError::read(path))?;
    if !metadata.is_file() {
        let found = "it is a directory or a device; give the file itself".to_owned();
        return Err(CryptoError::NotAKey { path: shown(path), wanted: "a regular file", found });
    }
    let file = File::open(path).map_err(CryptoError::read(path))?;
    let metadata = file.metadata().map_err(CryptoError::read(path))?;
    check_mode(path, metadata.permissions().mode() & !shown_as_group(path), 0o600)?;
    let length = usize::try_from(metadata.len()).unwrap_or(usize::MAX);
    // One byte more than expected, so that the buffer never grows and leaves a copy behind.
    let mut bytes = Zeroizing::new(Vec::with_capacity(length.min(most) + 1));
    let limit = u64::try_from(most).unwrap_or(u64::MAX).saturating_add(1);
    file.take(limit).read_to_end(&mut bytes).map_err(CryptoError::read(path))?;
    if bytes.len() > most {
        return Err(CryptoError::TooLong { path: shown(path), found: length.max(bytes.len()), most });
    }
    Ok(bytes)
}

/// Writes a file that only its owner may read, in one step: after a crash it has either the old content or the new.
/// # Errors
/// [`CryptoError::Write`].
pub fn write_private(path: &Path, bytes: &[u8]) -> Result<()> {
    replace(path, bytes, true)
}

/// Like [`write_private`], but never over an existing file.
/// # Errors
/// [`CryptoError::Exists`] if there is one, else [`CryptoError::Write`].
pub fn create_private(path: &Path, bytes: &[u8]) -> Result<()> {
    replace(path, bytes, false)
}

/// Replaces a file by what `change` makes of its bytes (`None`: no file); `None` or an error leaves it as it is. For
/// every file that several processes or tasks change: changes in one directory happen one after the other.
/// # Errors
/// What `change` returns, or those of [`read_private`] and [`write_private`].
pub fn change_private(
    path: &Path,
    most: usize,
    change: impl FnOnce(Option<&[u8]>) -> Result<Option<Vec<u8>>>,
) -> Result<()> {
    let _lock = lock_directory(path)?;
    // What cannot be listed is no reason to write nothing.
    drop(unfinished::sweep(&directory_of(path)));
    let there = match read_private(path, most) {
        Ok(bytes) => Some(bytes),
        Err(CryptoError::Read { source, .. }) if source.kind() == ErrorKind::NotFound => None,
        Err(error) => return Err(error),
    };
    match change(there.as_ref().map(|bytes| bytes.as_slice()))? {
        Some(bytes) => write_private(path, &bytes),
        None => Ok(()),
    }
}

fn replace(path: &Path, bytes: &[u8], over: bool) -> Result<()> {
    let directory = directory_of(path);
    let write = CryptoError::write(path);
    let mut file = unfinished::new_file(&directory).map_err(&write)?;
    file.write_all(bytes).map_err(&write)?;
    file.as_file().sync_all().map_err(&write)?;
    fault::point("file-unfinished");
    let moved = if over { file.persist(path) } else { file.persist_noclobber(path) };
    moved.map_err(|error| match error.error.kind() {
        ErrorKind::AlreadyExists if !over => CryptoError::Exists(shown(path)),
        _ => write(error.error),
    })?;
    File::open(&directory).and_then(|directory| directory.sync_all()).map_err(&write)
}

/// Locks the directory of a file until the handle is dropped or the process ends. Not the file itself, which a write
/// replaces: two processes would then hold the locks of two files of the same name.
fn lock_directory(path: &Path) -> Result<File> {
    let directory = directory_of(path);
    let write = CryptoError::write(path);
    let handle = File::open(&directory).map_err(&write)?;
    loop {
        match handle.lock() {
            Ok(()) => return Ok(handle),
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(write(error)),
        }
    }
}

/// Makes a directory with mode 0700, or checks that an existing one is closed to others.
/// # Errors
/// [`CryptoError::Write`] or [`CryptoError::OpenToOthers`].
pub fn make_private_directory(directory: &Path) -> Result<()> {
    DirBuilder::new().recursive(true).mode(0o700).create(directory).map_err(CryptoError::write(directory))?;
    check_private_directory(directory)
}

/// Checks that group and others have no permission on a directory.
/// # Errors
/// [`CryptoError::Read`] or [`CryptoError::OpenToOthers`].
pub fn check_private_directory(directory: &Path) -> Result<()> {
    let metadata = fs::metadata(directory).map_err(CryptoError::read(directory))?;
    check_mode(directory, metadata.permissions().mode(), 0o700)
}

pub(super) fn directory_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent.to_owned(),
        _ => PathBuf::from("."),
    }
}

/// systemd lets a service read its credentials through an access list, which shows as a group permission.
fn shown_as_group(path: &Path) -> u32 {
    let credentials = std::env::var_os("CREDENTIALS_DIRECTORY").filter(|directory| !directory.is_empty());
    if credentials.is_some_and(|directory| path.starts_with(directory)) { 0o040 } else { 0 }
}

fn check_mode(path: &Path, mode: u32, wanted: u32) -> Result<()> {
    if mode & OTHERS == 0 {
        return Ok(());
    }
    Err(CryptoError::OpenToOthers { path: shown(path), mode: mode & 0o7777, wanted })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::ErrorKind as Kind;

    #[test]
    fn written_files_are_private_and_replaced_whole() {
        let home = tempfile::tempdir().expect("directory");
        let path = home.path().join("keys").join("a.bin");
        make_private_directory(&directory_of(&path)).expect("makes");
        write_private(&path, b"one").expect("writes");
        write_private(&path, b"two").expect("writes");
        assert_eq!(&**read_private(&path, 10).expect("reads"), b"two");
        assert_eq!(fs::metadata(&path).expect("there").permissions().mode() & 0o777, 0o600);
        assert_eq!(fs::metadata(home.path().join("keys")).expect("there").permissions().mode() & 0o777, 0o700);
        assert_eq!(fs::read_dir(home.path().join("keys")).expect("lists").count(), 1, "no temporary file stays");
        assert!(matches!(create_private(&path, b"three"), Err(CryptoError::Exists(_))));
        assert!(matches!(read_private(&path, 2), Err(CryptoError::TooLong { .. })));
    }

    #[test]
    fn changes_of_a_file_come_one_after_the_other() {
        let home = tempfile::tempdir().expect("directory");
        let path = home.path().join("count");
        write_private(&path, &[0]).expect("writes");
        let count = || change_private(&path, 10, |there| Ok(there.map(|there| vec![there[0] + 1])));
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| (0..20).for_each(|_| count().expect("changes")));
            }
        });
        assert_eq!(&**read_private(&path, 10).expect("reads"), &[160]);
        assert!(change_private(&path, 10, |_| Err(CryptoError::Random)).is_err());
        change_private(&path, 10, |_| Ok(None)).expect("nothing to do");
        assert_eq!(&**read_private(&path, 10).expect("reads"), &[160]);
        let made = |there: Option<&[u8]>| Ok(there.is_none().then(|| vec![7]));
        change_private(&home.path().join("new"), 10, made).expect("makes");
        assert_eq!(&**read_private(&home.path().join("new"), 10).expect("reads"), &[7]);
    }

    #[test]
    fn open_files_and_directories_are_refused_with_the_command_that_helps() {
        let home = tempfile::tempdir().expect("directory");
        let path = home.path().join("a.bin");
        write_private(&path, b"one").expect("writes");
        fs::set_permissions(&path, fs::Permissions::from_mode(0o644)).expect("chmod");
        let error = read_private(&path, 10).expect_err("refused");
        assert_eq!(error.kind(), Kind::Input);
        assert!(error.to_string().contains(&format!("chmod 600 {}", path.display())), "{error}");
        fs::set_permissions(home.path(), fs::Permissions::from_mode(0o755)).expect("chmod");
        let error = make_private_directory(home.path()).expect_err("refused");
        assert!(error.to_string().contains("chmod 700"), "{error}");
        assert!(matches!(read_private(home.path(), 10), Err(CryptoError::NotAKey { .. })));
        assert!(matches!(read_private(&home.path().join("none"), 10), Err(CryptoError::Read { .. })));
    }
}
