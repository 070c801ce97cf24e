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
    /// MCAP files and databases, in the order of recording.
    pub files: Vec<PathBuf>,
    /// Databases that the recorder compressed as a whole when it closed them.
    pub packed: Vec<PathBuf>,
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
        } else if kind.is_file() && path.to_string_lossy().ends_with(".db3.zstd") {
            found.packed.push(path);
        }
    }
    Ok(())
}

fn is_recording(name: &str) -> bool {
    let is_one = is_database(Path::new(name)) || Path::new(name).extension().is_some_and(|end| end == "mcap");
    is_one && !name.ends_with(ATTACHED) && !name.starts_with('.')
}

/// Whether a file is a database of rosbag2 by its name.
pub(super) fn is_database(path: &Path) -> bool {
    path.extension().is_some_and(|end| end == "db3")
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
        let names = ["run_1.mcap", "run_0.mcap", "run_0.authros.mcap", ".hidden.mcap", "run_2.db3", "part/deep/x.mcap"];
        names.iter().for_each(|name| fs::write(path.join(name), "").expect("written"));
        fs::write(path.join("part/deep/deeper/y.mcap"), "").expect("written");
        fs::write(path.join("run_3.db3.zstd"), "").expect("written");
        let Look::Files(Found { files, packed, .. }) = folder.look() else { panic!("no files") };
        assert_eq!(packed, [path.join("run_3.db3.zstd")]);
        let found: Vec<_> = files.iter().filter_map(|file| file.strip_prefix(&path).ok()?.to_str()).collect();
        assert_eq!(found, ["part/deep/x.mcap", "run_0.mcap", "run_1.mcap", "run_2.db3"]);
        fs::rename(&path, home.path().join("other")).expect("moved");
        assert!(matches!(folder.look(), Look::Gone));
        fs::create_dir(&path).expect("created");
        assert!(matches!(folder.look(), Look::Gone), "another folder of its name");
    }
}
