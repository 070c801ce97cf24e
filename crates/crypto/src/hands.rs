//! Who else could change or replace a file: nobody but one user and root should.

use std::fs::Metadata;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

const WRITTEN_BY_OTHERS: u32 = 0o022;
const WRITTEN_BY_ANYBODY: u32 = 0o002;
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
/// # Errors
/// If the file or a folder cannot be examined.
pub fn fault(file: &Path, user: u32) -> std::io::Result<Option<Fault>> {
    find_fault(file, user, WRITTEN_BY_OTHERS)
}

/// Like [`fault`], but the group may write to the folders above: a home put there by somebody else would belong to him.
/// # Errors
/// See [`fault`].
pub fn fault_of_home(home: &Path, user: u32) -> std::io::Result<Option<Fault>> {
    find_fault(home, user, WRITTEN_BY_ANYBODY)
}

/// `above` is what may not be permitted in the folders above.
fn find_fault(file: &Path, user: u32, above: u32) -> std::io::Result<Option<Fault>> {
    let named = file.canonicalize();
    for (depth, (path, about)) in upwards(file)?.into_iter().enumerate() {
        let name = || named.as_ref().ok().and_then(|named| named.ancestors().nth(depth)).unwrap_or(&path).to_owned();
        if about.uid() != user && about.uid() != 0 {
            return Ok(Some(Fault::Foreign(name())));
        }
        // In a folder with the sticky bit nobody can replace another user's files.
        let is_kept_apart = depth > 0 && about.mode() & STICKY != 0;
        let forbidden = if depth == 0 { WRITTEN_BY_OTHERS } else { above };
        if about.mode() & forbidden != 0 && !is_kept_apart {
            return Ok(Some(Fault::Open(name())));
        }
    }
    Ok(None)
}

/// The file or folder and all folders above it. The kernel finds each: in another mount namespace (`/proc/PID/root`) a
/// whole path would lead elsewhere.
fn upwards(file: &Path) -> std::io::Result<Vec<(PathBuf, Metadata)>> {
    let about = std::fs::metadata(file)?;
    let (mut found, mut at) = (Vec::new(), file.to_owned());
    if !about.is_dir() {
        at = file.canonicalize()?;
        found.push((at.clone(), about));
        at.pop();
    }
    loop {
        let about = std::fs::metadata(&at)?;
        let place = (about.dev(), about.ino());
        found.push((at.clone(), about));
        at.push("..");
        let above = std::fs::metadata(&at)?;
        if (above.dev(), above.ino()) == place {
            return Ok(found);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs::{Permissions, create_dir, set_permissions};
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    #[test]
    fn a_home_is_written_by_its_owner_alone_and_its_path_by_no_stranger() {
        let folder = tempfile::tempdir().expect("a folder");
        let (above, home) = (folder.path().join("above"), folder.path().join("above/home"));
        create_dir(&above).and_then(|()| create_dir(&home)).expect("folders");
        let user = std::fs::metadata(&home).expect("there").uid();
        let chmod = |path: &Path, mode| set_permissions(path, Permissions::from_mode(mode)).expect("its mode");
        chmod(&above, 0o755);
        for (mode, is_open) in [(0o700, false), (0o755, false), (0o720, true), (0o702, true), (0o1777, true)] {
            chmod(&home, mode);
            let found = fault_of_home(&home, user).expect("examined");
            assert_eq!(matches!(found, Some(Fault::Open(path)) if path.ends_with("home")), is_open, "{mode:o}");
        }
        chmod(&home, 0o700);
        for (mode, strict, of_home) in [(0o775, true, false), (0o757, true, true), (0o1777, false, false)] {
            chmod(&above, mode);
            assert_eq!(fault(&home, user).expect("examined").is_some(), strict, "{mode:o}");
            assert_eq!(fault_of_home(&home, user).expect("examined").is_some(), of_home, "{mode:o}");
        }
        let other = fault_of_home(&home, user + 1).expect("examined");
        assert_eq!(matches!(other, Some(Fault::Foreign(_))), user != 0, "root's folders are anybody's");
    }
}
