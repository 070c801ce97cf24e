//! What is in a followed folder, in the order of recording, and who writes it.

use std::cmp::Ordering;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use crate::ros::rosbag2::ATTACHED;

/// The most entries that are looked at.
const MOST_ENTRIES: usize = 16 * 1024;

/// How deep folders in the folder are looked into: a recorder makes one for each recording.
const DEEPEST: usize = 2;

/// What was found of the folder.
pub(super) enum Look {
    /// It is not there yet.
    NotYet,
    /// It was there, and is no more, or another one is in its place.
    Gone,
    /// It cannot be read now.
    Unreadable(String),
    /// Its recordings.
    Files(Found),
}

/// What is in a folder.
#[derive(Default)]
pub(super) struct Found {
    /// MCAP files, in the order of recording.
    pub files: Vec<PathBuf>,
    /// A recording that is a database, which is not opened while somebody may write it.
    pub database: Option<PathBuf>,
    entries: usize,
}

/// A folder, known by its place on the disk once it was there.
pub(super) struct Folder {
    pub path: PathBuf,
    seen: Option<(u64, u64)>,
}

impl Folder {
    /// One that need not be there yet.
    pub fn new(path: PathBuf) -> Self {
        Self { path, seen: None }
    }

    /// Looks for recordings.
    pub fn look(&mut self) -> Look {
        let here = match fs::metadata(&self.path) {
            Ok(metadata) => (metadata.dev(), metadata.ino()),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return if self.seen.is_some() { Look::Gone } else { Look::NotYet };
            }
            Err(error) => return Look::Unreadable(error.to_string()),
        };
        if *self.seen.get_or_insert(here) != here {
            return Look::Gone;
        }
        let mut found = Found::default();
        match gather(&self.path, DEEPEST, &mut found) {
            Ok(()) => {
                found.files.sort_by(|one, other| in_order(&one.to_string_lossy(), &other.to_string_lossy()));
                Look::Files(found)
            }
            Err(error) => Look::Unreadable(error.to_string()),
        }
    }
}

fn gather(folder: &Path, deeper: usize, found: &mut Found) -> std::io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        found.entries += 1;
        if found.entries > MOST_ENTRIES {
            return Err(std::io::Error::other(format!("it has more than {MOST_ENTRIES} entries")));
        }
        // A file that vanishes meanwhile is searched for again in the next round.
        let Ok(kind) = entry.file_type() else { continue };
        let path = entry.path();
        if kind.is_dir() && deeper > 0 {
            drop(gather(&path, deeper - 1, found));
        } else if kind.is_file() && is_recording(&entry.file_name().to_string_lossy()) {
            found.files.push(path);
        } else if path.extension().is_some_and(|end| end == "db3") {
            found.database = Some(path);
        }
    }
    Ok(())
}

fn is_recording(name: &str) -> bool {
    Path::new(name).extension().is_some_and(|end| end == "mcap") && !name.ends_with(ATTACHED) && !name.starts_with('.')
}

/// Compares names so that numbers in them count as numbers: `run_9` is before `run_10`.
pub(super) fn in_order(one: &str, other: &str) -> Ordering {
    parts(one).cmp(&parts(other)).then_with(|| one.cmp(other))
}

/// Text and the number behind it, without its zeros in front, by length and then by digits.
fn parts(name: &str) -> Vec<(&str, usize, &str)> {
    let (mut rest, mut parts) = (name, Vec::new());
    while !rest.is_empty() {
        let digits = rest.find(|letter: char| letter.is_ascii_digit()).unwrap_or(rest.len());
        let (text, tail) = rest.split_at(digits);
        let end = tail.find(|letter: char| !letter.is_ascii_digit()).unwrap_or(tail.len());
        let (number, tail) = tail.split_at(end);
        let number = number.trim_start_matches('0');
        parts.push((text, number.len(), number));
        rest = tail;
    }
    parts
}

/// Whether rosbag2 has closed the recording that a file is of, or a later file of it is there.
pub(super) fn is_followed_by(path: &Path, files: &[PathBuf]) -> bool {
    let Some(folder) = path.parent() else { return false };
    let is_later = |other: &PathBuf| {
        other.parent() == Some(folder) && in_order(&path.to_string_lossy(), &other.to_string_lossy()) == Ordering::Less
    };
    has_description(path) || files.iter().any(is_later)
}

/// Whether the description that rosbag2 writes last is beside a file.
pub(super) fn has_description(path: &Path) -> bool {
    path.parent().is_some_and(|folder| folder.join("metadata.yaml").exists())
}

/// Whether a process that may be looked at has the file open for writing.
pub(super) fn has_writer(device: u64, inode: u64) -> bool {
    let Ok(processes) = fs::read_dir("/proc") else { return false };
    processes.flatten().any(|process| {
        let Ok(open) = fs::read_dir(process.path().join("fd")) else { return false };
        open.flatten().any(|descriptor| {
            let is_it = fs::metadata(descriptor.path())
                .is_ok_and(|file| file.is_file() && file.dev() == device && file.ino() == inode);
            is_it && is_for_writing(&process.path().join("fdinfo").join(descriptor.file_name()))
        })
    })
}

fn is_for_writing(about: &Path) -> bool {
    let text = fs::read_to_string(about).unwrap_or_default();
    let flags = text.lines().find_map(|line| line.strip_prefix("flags:"));
    let flags = flags.and_then(|flags| u32::from_str_radix(flags.trim(), 8).ok());
    // The way of access is in the lowest two bits; 0 is reading.
    flags.is_some_and(|flags| flags & 0b11 != 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_taken_in_the_order_of_their_numbers() {
        let mut names = ["r/run_10.mcap", "r/run_9.mcap", "r/run_0.mcap", "q/b_2026.mcap", "r/run_010.mcap"];
        names.sort_by(|one, other| in_order(one, other));
        assert_eq!(names, ["q/b_2026.mcap", "r/run_0.mcap", "r/run_9.mcap", "r/run_010.mcap", "r/run_10.mcap"]);
    }

    #[test]
    fn a_folder_is_looked_into_and_its_end_is_noticed() {
        let home = tempfile::tempdir().expect("a folder");
        let path = home.path().join("run");
        let mut folder = Folder::new(path.clone());
        assert!(matches!(folder.look(), Look::NotYet));
        fs::create_dir_all(path.join("part/deep/deeper")).expect("created");
        let names = ["run_1.mcap", "run_0.mcap", "run_0.authros.mcap", ".hidden.mcap", "old.db3", "part/deep/x.mcap"];
        names.iter().for_each(|name| fs::write(path.join(name), "").expect("written"));
        fs::write(path.join("part/deep/deeper/y.mcap"), "").expect("written");
        let Look::Files(Found { files, database, .. }) = folder.look() else { panic!("no files") };
        assert_eq!(database, Some(path.join("old.db3")));
        let found: Vec<_> = files.iter().filter_map(|file| file.strip_prefix(&path).ok()?.to_str()).collect();
        assert_eq!(found, ["part/deep/x.mcap", "run_0.mcap", "run_1.mcap"]);
        assert!(is_followed_by(&path.join("run_0.mcap"), &files) && !is_followed_by(&path.join("run_1.mcap"), &files));
        fs::write(path.join("metadata.yaml"), "").expect("written");
        assert!(is_followed_by(&path.join("run_1.mcap"), &files));
        fs::rename(&path, home.path().join("other")).expect("moved");
        assert!(matches!(folder.look(), Look::Gone));
        fs::create_dir(&path).expect("created");
        assert!(matches!(folder.look(), Look::Gone), "another folder of its name");
    }

    #[test]
    fn who_writes_a_file_is_found() {
        let home = tempfile::tempdir().expect("a folder");
        let path = home.path().join("run.mcap");
        let writing = fs::File::create(&path).expect("created");
        let metadata = fs::metadata(&path).expect("there");
        let reading = fs::File::open(&path).expect("open");
        assert!(has_writer(metadata.dev(), metadata.ino()));
        drop(writing);
        assert!(!has_writer(metadata.dev(), metadata.ino()), "who only reads is none");
        drop(reading);
    }
}
