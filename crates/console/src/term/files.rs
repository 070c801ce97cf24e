//! The operator's files (never overwritten, readable by the owner alone), names in folders, clipboard, kept settings.

use std::fs::{DirBuilder, OpenOptions};
use std::io::{self, ErrorKind, Read as _, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use crate::app::completion::{Candidate, Found, Sought};
use crate::app::kept::Kept;
use crate::app::{Contents, PathKind};
use crate::model::{clean, natural};
use crate::service::command::LONGEST_POLICY;
use crate::store::files;

/// Entries read to complete a path.
const MOST_READ: usize = 20_000;
const MOST_FOUND: usize = 5_000;
const TRIES: u32 = 1_000;

/// Writes into a new `directory` if one is named; returns the place, or a sentence for the operator.
pub fn write_all(base: &Path, directory: Option<&str>, files: &[Contents]) -> Result<String, String> {
    // What the operator named is made, for the operator alone.
    let made = DirBuilder::new().recursive(true).mode(0o700).create(base);
    made.map_err(|error| cannot(base, &error))?;
    let place = match directory {
        Some(name) => fresh(&base.join(file_name(name)), |path| DirBuilder::new().mode(0o700).create(path))?.0,
        None => base.to_owned(),
    };
    let mut written = place.clone();
    for file in files {
        written = write_one(&place, file)?;
    }
    let shown = if directory.is_some() || files.len() != 1 { place } else { written };
    Ok(shown.display().to_string())
}

/// Sorted; a bounded part of a large folder.
pub fn find(sought: &Sought) -> Result<Found, String> {
    let cannot = |error: io::Error| format!("{} cannot be read: {error}", clean(&sought.folder.to_string_lossy(), 200));
    let mut entries = std::fs::read_dir(&sought.folder).map_err(cannot)?;
    let mut found = Found::default();
    for entry in entries.by_ref().take(MOST_READ).filter_map(Result::ok) {
        // A name that is not UTF-8 cannot be typed.
        let Ok(name) = entry.file_name().into_string() else { continue };
        let wanted = name.starts_with(&sought.begun) && (sought.begun.starts_with('.') || !name.starts_with('.'));
        if !wanted {
            continue;
        }
        // Follows links to folders.
        let folder = std::fs::metadata(entry.path()).is_ok_and(|metadata| metadata.is_dir());
        if !folder && sought.kind == PathKind::Folder {
            continue;
        }
        if found.names.len() == MOST_FOUND {
            found.more = true;
            break;
        }
        found.names.push(Candidate { name, folder });
    }
    found.more |= entries.next().is_some();
    found.names.sort_by(|one, other| natural(&one.name, &other.name));
    Ok(found)
}

/// Reads no further than a robot's policy may be long.
pub fn read_text(path: &Path) -> Result<String, String> {
    let shown = clean(&path.to_string_lossy(), 200);
    let cannot = |error: io::Error| format!("{shown} cannot be read: {error}");
    // A device may never end.
    if !std::fs::metadata(path).map_err(cannot)?.is_file() {
        return Err(format!("{shown} is not a file; enter the path of one"));
    }
    let mut bytes = Vec::new();
    let most = LONGEST_POLICY as u64 + 1;
    std::fs::File::open(path).map_err(cannot)?.take(most).read_to_end(&mut bytes).map_err(cannot)?;
    if bytes.len() > LONGEST_POLICY {
        return Err(format!("{shown} has more than {LONGEST_POLICY} bytes, the limit of a policy"));
    }
    String::from_utf8(bytes).map_err(|_| format!("{shown} is not text in UTF-8; a policy is a TOML file"))
}

fn write_one(place: &Path, file: &Contents) -> Result<PathBuf, String> {
    let wanted = place.join(file_name(&file.name));
    let options = |path: &Path| OpenOptions::new().write(true).create_new(true).mode(0o600).open(path);
    let (path, mut open) = fresh(&wanted, options)?;
    open.write_all(&file.bytes).and_then(|()| open.sync_all()).map_err(|error| cannot(&path, &error))?;
    Ok(path)
}

/// Tries `name`, `name-2`, `name-3` …
fn fresh<T>(wanted: &Path, make: impl Fn(&Path) -> io::Result<T>) -> Result<(PathBuf, T), String> {
    for number in 1..TRIES {
        let path = if number == 1 { wanted.to_owned() } else { numbered(wanted, number) };
        match make(&path) {
            Ok(made) => return Ok((path, made)),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(cannot(&path, &error)),
        }
    }
    Err(format!("{} and similar files already exist; move them away", wanted.display()))
}

fn numbered(path: &Path, number: u32) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let extension = path.extension().map(|extension| format!(".{}", extension.to_string_lossy())).unwrap_or_default();
    path.with_file_name(format!("{stem}-{number}{extension}"))
}

/// Strips any path.
fn file_name(name: &str) -> String {
    let plain = |character: char| if matches!(character, '/' | '\\' | '\0') { '_' } else { character };
    let name: String = clean(name, 120).chars().map(plain).collect();
    let name = name.trim_start_matches('.');
    if name.is_empty() { "record".to_owned() } else { name.to_owned() }
}

fn cannot(path: &Path, error: &io::Error) -> String {
    format!("{} cannot be written: {error}; choose a directory you can write to", path.display())
}

/// Bytes; longer texts belong into files.
const MOST: usize = 4_096;

/// OSC 52.
pub fn sequence(text: &str) -> String {
    let text = &text[..text.floor_char_boundary(MOST)];
    format!("\x1b]52;c;{}\x07", STANDARD.encode(text))
}

/// Bytes.
const LONGEST: u64 = 64 * 1024;

pub(super) fn read(path: &Path) -> Option<Kept> {
    let mut text = String::new();
    std::fs::File::open(path).ok()?.take(LONGEST).read_to_string(&mut text).ok()?;
    serde_json::from_str(&text).ok()
}

pub(super) fn write(path: &Path, kept: &Kept) {
    let Some(directory) = path.parent() else { return };
    let Ok(text) = serde_json::to_vec_pretty(kept) else { return };
    // An unwritable home has been reported before.
    if files::private_directory(directory).is_ok() {
        drop(files::atomic_write(path, &text));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;
    use zeroize::Zeroizing;

    fn file(name: &str, bytes: &[u8]) -> Contents {
        Contents { name: name.to_owned(), bytes: Zeroizing::new(bytes.to_vec()) }
    }

    #[test]
    fn a_file_is_never_overwritten_and_belongs_to_its_owner_alone() {
        let base = tempfile::tempdir().expect("a directory");
        let first = write_all(base.path(), None, &[file("a.jpg", b"1")]).expect("written");
        let second = write_all(base.path(), None, &[file("a.jpg", b"2")]).expect("written");
        assert!(first.ends_with("a.jpg") && second.ends_with("a-2.jpg"), "{first} {second}");
        assert_eq!(std::fs::read(&first).expect("read"), b"1");
        let mode = std::fs::metadata(&second).expect("metadata").permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
    }

    #[test]
    fn a_folder_that_does_not_exist_is_made_for_the_operator_alone() {
        let base = tempfile::tempdir().expect("a directory");
        let folder = base.path().join("new/inner");
        let written = write_all(&folder, None, &[file("a.jpg", b"1")]).expect("written");
        assert!(Path::new(&written).starts_with(&folder), "{written}");
        let mode = std::fs::metadata(&folder).expect("metadata").permissions().mode();
        assert_eq!(mode & 0o777, 0o700);
        let error = write_all(Path::new(&written), None, &[file("b.jpg", b"1")]).expect_err("a file is no folder");
        assert!(error.contains("choose a directory you can write to"), "{error}");
    }

    #[test]
    fn no_name_leads_out_of_its_directory() {
        let base = tempfile::tempdir().expect("a directory");
        let place = write_all(base.path(), Some("../up"), &[file("../../x", b"1"), file("..", b"2")]).expect("written");
        assert!(Path::new(&place).starts_with(base.path()), "{place}");
        assert_eq!(std::fs::read_dir(&place).expect("listed").count(), 2);
        assert_eq!(std::fs::read_dir(base.path()).expect("listed").count(), 1);
    }

    fn sought(folder: &Path, begun: &str, kind: PathKind) -> Sought {
        Sought { typed: begun.to_owned(), folder: folder.to_owned(), begun: begun.to_owned(), kind }
    }

    fn names(found: &Found) -> Vec<String> {
        let shown = |one: &Candidate| format!("{}{}", one.name, if one.folder { "/" } else { "" });
        found.names.iter().map(shown).collect()
    }

    #[test]
    fn names_are_found_by_their_beginning_and_hidden_ones_only_on_request() {
        let base = tempfile::tempdir().expect("a directory");
        for name in ["keys.pem", "keys.old", ".keyring", "other", "evil\u{1b}[2J\u{202e}"] {
            std::fs::write(base.path().join(name), b"").expect("written");
        }
        std::fs::create_dir(base.path().join("keyrings")).expect("a folder");
        std::os::unix::fs::symlink(base.path().join("keyrings"), base.path().join("key-link")).expect("a link");
        std::os::unix::fs::symlink("nowhere", base.path().join("key-gone")).expect("a link");
        let found = |begun, kind| names(&find(&sought(base.path(), begun, kind)).expect("read"));
        let keys = ["key-gone", "key-link/", "keyrings/", "keys.old", "keys.pem"];
        assert_eq!(found("key", PathKind::File), keys);
        assert_eq!(found("key", PathKind::Folder), ["key-link/", "keyrings/"]);
        assert_eq!(found(".k", PathKind::File), [".keyring"]);
        assert_eq!(found("", PathKind::File).len(), 7, "all but the hidden one");
        let error = find(&sought(&base.path().join("none\u{1b}[2J"), "", PathKind::File)).expect_err("there is none");
        assert!(error.contains("cannot be read") && !error.contains('\u{1b}'), "{error}");
    }

    #[test]
    fn a_text_is_read_as_far_as_a_policy_may_be_long_and_what_is_none_is_refused_in_words() {
        let base = tempfile::tempdir().expect("a directory");
        let file = |name: &str, bytes: &[u8]| {
            let path = base.path().join(name);
            std::fs::write(&path, bytes).expect("written");
            path
        };
        assert_eq!(read_text(&file("a", b"[ring]\n")).as_deref(), Ok("[ring]\n"));
        assert!(read_text(&file("b", &vec![b'#'; LONGEST_POLICY])).is_ok());
        let told = |path: &Path, word: &str| {
            let error = read_text(path).expect_err(word);
            assert!(error.contains(word) && !error.contains('\u{1b}'), "{error}");
        };
        told(&file("c", &vec![b'#'; LONGEST_POLICY + 1]), "more than 65536 bytes");
        told(&file("d", &[0xff, 0xfe]), "not text");
        told(&base.path().join("none\u{1b}[2J"), "cannot be read");
        told(base.path(), "not a file");
        told(Path::new("/dev/zero"), "not a file");
    }

    #[test]
    fn of_a_large_folder_a_bounded_part_is_read_and_said_to_be_one() {
        let base = tempfile::tempdir().expect("a directory");
        for number in 0..=MOST_FOUND {
            std::fs::write(base.path().join(format!("f{number}")), b"").expect("written");
        }
        let found = find(&sought(base.path(), "f", PathKind::File)).expect("read");
        assert!(found.more && found.names.len() == MOST_FOUND);
        assert!(!find(&sought(base.path(), "f77", PathKind::File)).expect("read").more);
    }

    #[test]
    fn what_cannot_be_written_says_so() {
        let error = write_all(Path::new("/proc/none"), None, &[file("a", b"")]).expect_err("refused");
        assert!(
            error.contains("/proc/none cannot be written") && error.contains("directory you can write to"),
            "{error}"
        );
    }
}

#[cfg(test)]
mod clipboard_tests {
    use super::*;

    #[test]
    fn rfc4648_examples() {
        let pairs = [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")];
        for (text, wanted) in pairs {
            assert_eq!(sequence(text), format!("\x1b]52;c;{wanted}\x07"));
        }
        assert!(sequence(&"é".repeat(5_000)).len() < 6_000);
    }
}

#[cfg(test)]
mod kept_tests {
    use super::*;

    #[test]
    fn what_is_left_is_read_back_and_rubbish_is_nothing() {
        let home = tempfile::tempdir().expect("a directory");
        let path = home.path().join("console").join("default.json");
        assert_eq!(read(&path), None);
        let kept = Kept { screen: "Grants".to_owned(), local_time: true, ..Kept::default() };
        write(&path, &kept);
        assert_eq!(read(&path), Some(kept));
        std::fs::write(&path, "{ not json").expect("written");
        assert_eq!(read(&path), None);
    }
}
