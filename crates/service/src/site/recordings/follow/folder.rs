//! The recordings of a followed folder, in order, and whether a recorder is done with one. A database is opened only
//! then: a second process that opens it can kill its recorder (rosbag2 #602, #1140).

use std::cmp::Ordering;
use std::fs;
use std::io::{ErrorKind, Read};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::model::natural;
use crate::ros::rosbag2::{METADATA, has_journal};

const MOST_ENTRIES: usize = 16 * 1024;

/// Depth of folders searched: a recorder makes one for each recording.
const DEEPEST: usize = 2;

pub(super) enum Look {
    NotYet,
    /// Gone after it was there, or replaced.
    Gone,
    Unreadable(String),
    Files(Found),
}

#[derive(Default)]
pub(super) struct Found {
    pub files: Vec<PathBuf>,
    /// Databases that the recorder compressed as a whole on closing.
    pub packed: Vec<PathBuf>,
    entries: usize,
}

/// Identified by its place on the disk once it was there.
pub(super) struct Folder {
    pub path: PathBuf,
    seen: Option<(u64, u64)>,
}

impl Folder {
    pub fn new(path: PathBuf) -> Self {
        Self { path, seen: None }
    }

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
                sort(&mut found.files);
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
        // A file that vanishes meanwhile is found in the next round.
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
    is_one && !name.starts_with('.')
}

/// By its name.
pub(super) fn is_database(path: &Path) -> bool {
    path.extension().is_some_and(|end| end == "db3")
}

pub(super) fn sort(paths: &mut [PathBuf]) {
    paths.sort_by(|one, other| natural(&one.to_string_lossy(), &other.to_string_lossy()));
}

/// Without changes and a visible writer for this long, a file is no longer written.
pub(super) const QUIET: Duration = Duration::from_secs(10);

/// The same for a database with a later file or a description: a recorder opens the next file before it closes the
/// former.
const SETTLED: Duration = Duration::from_secs(1);

/// Bytes of a description that are searched.
const LONGEST_DESCRIPTION: u64 = 4 << 20;

/// Whether rosbag2 has closed the file's recording, or a later file of it exists.
pub(super) fn is_followed_by(path: &Path, files: &[PathBuf]) -> bool {
    has_description(path) || has_later(path, files)
}

fn has_later(path: &Path, files: &[PathBuf]) -> bool {
    let is_later = |other: &PathBuf| {
        other.parent() == path.parent()
            && other.extension() == path.extension()
            && natural(&path.to_string_lossy(), &other.to_string_lossy()) == Ordering::Less
    };
    files.iter().any(is_later)
}

/// rosbag2 writes the description last.
pub(super) fn has_description(path: &Path) -> bool {
    path.parent().is_some_and(|folder| folder.join(METADATA).exists())
}

fn is_described(path: &Path) -> bool {
    let (Some(folder), Some(name)) = (path.parent(), path.file_name()) else { return false };
    let Ok(file) = fs::File::open(folder.join(METADATA)) else { return false };
    let mut text = String::new();
    file.take(LONGEST_DESCRIPTION).read_to_string(&mut text).is_ok() && text.contains(&*name.to_string_lossy())
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Writers {
    /// A process has it open for writing.
    Seen,
    Nobody,
    /// Some processes may not be examined.
    Unknown,
}

fn writers(device: u64, inode: u64) -> Writers {
    let Ok(processes) = fs::read_dir("/proc") else { return Writers::Unknown };
    let mut found = Writers::Nobody;
    for process in processes.flatten() {
        let open = match fs::read_dir(process.path().join("fd")) {
            Ok(open) => open,
            // No process, or one that has just ended.
            Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => continue,
            Err(_) => {
                found = Writers::Unknown;
                continue;
            }
        };
        let is_writing = open.flatten().any(|descriptor| {
            let is_it = fs::metadata(descriptor.path())
                .is_ok_and(|file| file.is_file() && file.dev() == device && file.ino() == inode);
            is_it && is_for_writing(&process.path().join("fdinfo").join(descriptor.file_name()))
        });
        if is_writing {
            return Writers::Seen;
        }
    }
    found
}

/// Whether a process that may be examined has the file open for writing.
pub(super) fn has_writer(device: u64, inode: u64) -> bool {
    writers(device, inode) == Writers::Seen
}

fn is_for_writing(about: &Path) -> bool {
    let text = fs::read_to_string(about).unwrap_or_default();
    let flags = text.lines().find_map(|line| line.strip_prefix("flags:"));
    let flags = flags.and_then(|flags| u32::from_str_radix(flags.trim(), 8).ok());
    // The access mode is in the lowest two bits; 0 is reading.
    flags.is_some_and(|flags| flags & 0b11 != 0)
}

/// Length and time of change, which show that a file was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Stamp(u64, i64, i64);

impl Stamp {
    /// `None` if it does not exist.
    pub fn of(path: &Path) -> Option<Self> {
        fs::metadata(path).ok().as_ref().map(Self::from)
    }
}

impl From<&fs::Metadata> for Stamp {
    fn from(found: &fs::Metadata) -> Self {
        Self(found.len(), found.mtime(), found.mtime_nsec())
    }
}

#[derive(Debug)]
pub(super) struct Waiting {
    stamp: Option<Stamp>,
    since: Instant,
    settled: Duration,
    quiet: Duration,
}

impl Default for Waiting {
    fn default() -> Self {
        Self { stamp: None, since: Instant::now(), settled: SETTLED, quiet: QUIET }
    }
}

impl Waiting {
    /// Checks, without opening the file, whether its recorder is done with it.
    pub fn is_over(&mut self, path: &Path, files: &[PathBuf]) -> bool {
        let Ok(found) = fs::metadata(path) else { return false };
        let stamp = Some(Stamp::from(&found));
        if self.stamp != stamp {
            (self.stamp, self.since) = (stamp, Instant::now());
        }
        let quiet = self.since.elapsed();
        if quiet < self.settled {
            return false;
        }
        let is_followed = has_later(path, files) || is_described(path);
        let is_clear = is_followed && !has_journal(path);
        if quiet < self.quiet && !is_clear {
            return false;
        }
        match writers(found.dev(), found.ino()) {
            Writers::Nobody => true,
            Writers::Unknown => is_followed && quiet >= self.quiet,
            Writers::Seen => {
                self.since = Instant::now();
                false
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_taken_in_the_order_of_their_numbers() {
        let mut names = ["r/run_10.mcap", "r/run_9.mcap", "r/run_0.mcap", "q/b_2026.mcap", "r/run_010.mcap"];
        names.sort_by(|one, other| natural(one, other));
        assert_eq!(names, ["q/b_2026.mcap", "r/run_0.mcap", "r/run_9.mcap", "r/run_10.mcap", "r/run_010.mcap"]);
    }

    #[test]
    fn a_folder_is_looked_into_and_its_end_is_noticed() {
        let home = tempfile::tempdir().expect("a folder");
        let path = home.path().join("run");
        let mut folder = Folder::new(path.clone());
        assert!(matches!(folder.look(), Look::NotYet));
        fs::create_dir_all(path.join("part/deep/deeper")).expect("created");
        let names = ["run_1.mcap", "run_0.mcap", ".hidden.mcap", "run_2.db3", "part/deep/x.mcap"];
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

    #[test]
    fn the_next_file_or_the_description_follows_a_file() {
        let home = tempfile::tempdir().expect("a folder");
        let [zero, one, database] = ["run_0.mcap", "run_1.mcap", "run_2.db3"].map(|name| home.path().join(name));
        let files = [zero.clone(), one.clone(), database.clone()];
        assert!(is_followed_by(&zero, &files) && !is_followed_by(&one, &files) && !is_followed_by(&database, &files));
        fs::write(home.path().join(METADATA), "").expect("written");
        assert!(files.iter().all(|path| is_followed_by(path, &files)) && !is_described(&one));
        fs::write(home.path().join(METADATA), "  - run_1.mcap\n").expect("written");
        assert!(is_described(&one) && !is_described(&zero));
    }

    #[test]
    fn a_database_is_closed_when_it_is_followed_and_nobody_writes_it() {
        let home = tempfile::tempdir().expect("a folder");
        let [zero, one] = ["run_0.db3", "run_1.db3"].map(|name| home.path().join(name));
        let writing = fs::File::create(&zero).expect("created");
        let files = [zero.clone(), one];
        let soon = Duration::from_millis(20);
        let mut waiting = Waiting { settled: soon, quiet: soon, ..Waiting::default() };
        let is_over = |waiting: &mut Waiting, files: &[PathBuf]| {
            waiting.is_over(&zero, files);
            std::thread::sleep(2 * soon);
            waiting.is_over(&zero, files)
        };
        assert!(!is_over(&mut waiting, &files), "it is open for writing");
        drop(writing);
        assert!(is_over(&mut waiting, &files));
        fs::write(home.path().join(METADATA), "  - run_7.db3\n").expect("written");
        waiting.quiet = Duration::from_secs(3_600);
        assert!(!is_over(&mut waiting, &files[..1]), "the description does not name it");
        fs::write(home.path().join(METADATA), "  - run_0.db3\n").expect("written");
        let journal = home.path().join("run_0.db3-journal");
        fs::write(&journal, "pages").expect("written");
        assert!(!is_over(&mut waiting, &files[..1]), "a journal is beside it");
        fs::remove_file(&journal).expect("gone");
        waiting.quiet = soon;
        assert!(is_over(&mut waiting, &files[..1]));
    }
}
