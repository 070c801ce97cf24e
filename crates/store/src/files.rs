//! Directories (mode 0700) and files (0600) of a home: locks and atomic writes.

use std::fs::{self, DirBuilder, File, OpenOptions, TryLockError};
use std::io::Write as _;
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _};
use std::path::Path;

use super::StoreError;
use crate::crypto::hands::{self, Fault};
use crate::crypto::unfinished;

const PRIVATE_DIRECTORY: u32 = 0o700;
const PRIVATE_FILE: u32 = 0o600;
const OTHERS: u32 = 0o077;

/// Free for this user.
pub fn free_bytes(path: &Path) -> Result<u64, StoreError> {
    let about = rustix::fs::statvfs(path).map_err(|error| StoreError::home(path, &error.into()))?;
    Ok(about.f_bavail.saturating_mul(about.f_frsize))
}

/// Creates it (mode 0700) if missing, checks its owner and that it is writable. An existing one may be readable by
/// others; see [`mode_advice`].
pub fn private_directory(path: &Path) -> Result<(), StoreError> {
    let unusable = |error| StoreError::home(path, &error);
    DirBuilder::new().recursive(true).mode(PRIVATE_DIRECTORY).create(path).map_err(unusable)?;
    check_hands(path)?;
    tempfile::tempfile_in(path).map(drop).map_err(unusable)
}

/// Nobody but this user and root may be able to put a keyring or socket into a home, or to replace it. Call before
/// sending a passphrase or writing a secret.
pub fn check_hands(path: &Path) -> Result<(), StoreError> {
    let user = rustix::process::geteuid().as_raw();
    match hands::fault_of_home(path, user).map_err(|error| StoreError::home(path, &error))? {
        None => Ok(()),
        Some(Fault::Foreign(path)) => {
            let owner = fs::metadata(&path).map_err(|error| StoreError::home(&path, &error))?.uid();
            Err(StoreError::Foreign { path, owner, user })
        }
        Some(Fault::Open(path)) => Err(StoreError::Open { path }),
    }
}

/// `None` if only the owner has access.
pub fn mode_advice(path: &Path) -> Result<Option<String>, StoreError> {
    let about = fs::metadata(path).map_err(|error| StoreError::home(path, &error))?;
    let advised = if about.is_dir() { PRIVATE_DIRECTORY } else { PRIVATE_FILE };
    Ok(too_open(path, about.permissions().mode(), advised).map(|error| error.to_string()))
}

/// Creates the file (mode 0600) if missing; refuses one that others can access.
pub fn open_private(path: &Path) -> Result<File, StoreError> {
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .mode(PRIVATE_FILE)
        .open(path)
        .map_err(|error| StoreError::home(path, &error))?;
    check_mode(path, &file)?;
    Ok(file)
}

/// Refuses a file that others can access.
pub fn read_private(path: &Path) -> Result<File, StoreError> {
    let file = File::open(path).map_err(|error| StoreError::home(path, &error))?;
    check_mode(path, &file)?;
    Ok(file)
}

fn check_mode(path: &Path, file: &File) -> Result<(), StoreError> {
    let about = file.metadata().map_err(|error| StoreError::home(path, &error))?;
    too_open(path, about.permissions().mode(), PRIVATE_FILE).map_or(Ok(()), Err)
}

fn too_open(path: &Path, mode: u32, advised: u32) -> Option<StoreError> {
    (mode & OTHERS != 0).then(|| StoreError::Mode { path: path.to_owned(), mode: mode & 0o7777, advised })
}

/// With mode 0600; after a crash the file holds the old content or the new.
pub fn atomic_write(path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
    let directory = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    replace(directory, path, bytes).map_err(|error| StoreError::home(path, &error))
}

fn replace(directory: &Path, path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut file = unfinished::new_file(directory)?;
    file.write_all(bytes)?;
    file.as_file().sync_all()?;
    file.persist(path).map_err(|error| error.error)?;
    sync_directory(directory)
}

/// Makes names durable.
pub(super) fn sync_directory(directory: &Path) -> std::io::Result<()> {
    File::open(directory)?.sync_all()
}

/// Held by the site of a home until dropped.
#[derive(Debug)]
pub struct SiteLock {
    _file: File,
}

impl SiteLock {
    /// `None` if it is held already.
    pub fn acquire(path: &Path) -> Result<Option<Self>, StoreError> {
        let file = open_private(path)?;
        match file.try_lock() {
            Ok(()) => Ok(Some(Self { _file: file })),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(error)) => Err(StoreError::home(path, &error)),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs::Permissions;

    use super::*;
    use crate::model::ErrorKind;

    fn mode(path: &Path) -> u32 {
        fs::metadata(path).expect("exists").permissions().mode() & 0o7777
    }

    #[test]
    fn new_directories_and_files_are_private() {
        let home = tempfile::tempdir().expect("temporary directory");
        let deep = home.path().join("a/b");
        private_directory(&deep).expect("made");
        assert_eq!(mode(&deep), 0o700);
        let file = deep.join("keyring");
        atomic_write(&file, b"one").expect("written");
        atomic_write(&file, b"two").expect("replaced");
        assert_eq!(fs::read(&file).expect("read"), b"two");
        assert_eq!(mode(&file), 0o600);
        assert_eq!(fs::read_dir(&deep).expect("list").count(), 1, "no temporary file is left behind");
        assert_eq!(mode_advice(&file), Ok(None));
    }

    #[test]
    fn a_file_that_others_can_read_is_refused_with_advice() {
        let home = tempfile::tempdir().expect("temporary directory");
        let file = home.path().join("key");
        atomic_write(&file, b"secret").expect("written");
        fs::set_permissions(&file, Permissions::from_mode(0o644)).expect("chmod");
        let error = read_private(&file).expect_err("refused");
        assert_eq!(error.kind(), ErrorKind::Input);
        assert!(error.to_string().contains("0644") && error.to_string().contains("chmod 600"), "{error}");
        assert!(open_private(&file).is_err());
    }

    #[test]
    fn a_home_that_others_can_write_is_refused_with_the_remedy() {
        let folder = tempfile::tempdir().expect("temporary directory");
        let home = folder.path().join("home");
        private_directory(&home).expect("made");
        for mode in [0o777, 0o770, 0o702] {
            fs::set_permissions(&home, Permissions::from_mode(mode)).expect("chmod");
            let error = private_directory(&home).expect_err("refused");
            assert_eq!(error.kind(), ErrorKind::Refused);
            assert!(error.to_string().contains("chmod go-w"), "{error}");
        }
        fs::set_permissions(&home, Permissions::from_mode(0o755)).expect("chmod");
        private_directory(&home).expect("others may look at its names");
        fs::set_permissions(folder.path(), Permissions::from_mode(0o757)).expect("chmod");
        let error = check_hands(&home).expect_err("it could be replaced");
        assert!(
            matches!(error, StoreError::Open { path } if folder.path().canonicalize().is_ok_and(|folder| folder == path))
        );
    }

    #[test]
    fn a_home_that_cannot_be_made_names_its_path() {
        let home = tempfile::tempdir().expect("temporary directory");
        let file = home.path().join("file");
        atomic_write(&file, b"").expect("written");
        let error = private_directory(&file.join("home")).expect_err("a file is in the way");
        assert_eq!(error.kind(), ErrorKind::Home);
        assert!(error.to_string().contains("file/home"), "{error}");
        assert_eq!(atomic_write(&home.path().join("none/x"), b"").expect_err("no directory").kind(), ErrorKind::Home);
        assert_eq!(private_directory(Path::new("/proc/none")).expect_err("read-only").kind(), ErrorKind::Home);
    }

    #[test]
    fn a_lock_has_one_holder_at_a_time() {
        let home = tempfile::tempdir().expect("temporary directory");
        let path = home.path().join("site.lock");
        let first = SiteLock::acquire(&path).expect("works").expect("free");
        assert!(SiteLock::acquire(&path).expect("works").is_none());
        drop(first);
        assert!(SiteLock::acquire(&path).expect("works").is_some());
    }
}
