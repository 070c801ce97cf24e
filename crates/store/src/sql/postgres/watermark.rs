//! How far a home has seen its database: the number of its own newest commit there, kept in a file of the home. A database
//! that counts fewer was restored to an earlier time, or a standby was promoted that lacked some.

use std::fs::{self, File};
use std::io::ErrorKind;
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};

use super::Client;
use crate::sql::Result;
use crate::{StoreError, files};

const COMMITS: &str = "SELECT commits FROM homes WHERE id = ?1";
const RAISE: &str = "INSERT INTO homes VALUES (?1, ?2) ON CONFLICT (id) DO UPDATE SET commits = excluded.commits";
/// Where the number is in the file, behind the id.
const NUMBER: u64 = 16;

#[derive(Debug)]
pub(crate) struct Watermark {
    id: [u8; 16],
    commits: AtomicI64,
    is_behind: AtomicBool,
    /// Without one, only this process remembers.
    file: Option<File>,
}

impl Watermark {
    pub fn in_memory() -> std::result::Result<Self, StoreError> {
        Ok(Self {
            id: random(Path::new(""))?,
            commits: AtomicI64::new(0),
            is_behind: AtomicBool::new(false),
            file: None,
        })
    }

    /// What the file remembers; nothing is written there.
    pub fn look(path: &Path) -> std::result::Result<Self, StoreError> {
        let found = match fs::read(path) {
            Ok(bytes) => Some(bytes),
            Err(error) if error.kind() == ErrorKind::NotFound => None,
            Err(error) => return Err(StoreError::home(path, &error)),
        };
        let (id, commits) = match found.as_deref().map(parsed) {
            Some(Some(known)) => known,
            // A damaged file may have seen anything: by one commit of a new id, every database is behind it.
            other => (random(path)?, i64::from(other.is_some())),
        };
        Ok(Self { id, commits: AtomicI64::new(commits), is_behind: AtomicBool::new(false), file: None })
    }

    /// Creates the file if it is missing.
    pub fn in_file(path: &Path) -> std::result::Result<Self, StoreError> {
        let mark = Self::look(path)?;
        let bytes = [&mark.id[..], &mark.commits().to_be_bytes()].concat();
        if fs::read(path).ok().as_ref() != Some(&bytes) {
            path.parent().map_or(Ok(()), files::private_directory)?;
            files::atomic_write(path, &bytes)?;
        }
        Ok(Self { file: Some(files::open_private(path)?), ..mark })
    }

    pub fn id(&self) -> [u8; 16] {
        self.id
    }

    /// The newest that this home has seen.
    pub fn commits(&self) -> i64 {
        self.commits.load(Ordering::Acquire)
    }

    /// This commit is durable there.
    pub fn rise(&self, commits: i64) {
        self.commits.store(commits, Ordering::Release);
        // A file that cannot be written has an earlier number; what is committed stays committed.
        if let Some(file) = &self.file {
            drop(file.write_all_at(&commits.to_be_bytes(), NUMBER));
        }
    }

    /// Whether a database lacks commits that this home has seen. `is_made`: it has the store's tables.
    pub fn check(&self, client: &Client, is_made: bool) -> Result<bool> {
        let there = if is_made { client.first(COMMITS, &[self.id])?.unwrap_or(0) } else { 0 };
        let is_behind = there < self.commits();
        self.is_behind.store(is_behind, Ordering::Release);
        Ok(is_behind)
    }

    /// As the last [`Self::check`] said.
    pub fn is_behind(&self) -> bool {
        self.is_behind.load(Ordering::Acquire)
    }

    /// Inside a transaction: from its commit on, the database has all that this home has seen.
    pub fn accept(&self, client: &Client) -> Result<()> {
        let values = (self.id, self.commits());
        client.execute(&client.prepared(RAISE)?, &values).map(drop)
    }
}

fn parsed(bytes: &[u8]) -> Option<([u8; 16], i64)> {
    let (id, number) = bytes.split_first_chunk()?;
    let commits = i64::from_be_bytes(number.try_into().ok()?);
    (commits >= 0).then_some((*id, commits))
}

fn random(path: &Path) -> std::result::Result<[u8; 16], StoreError> {
    let mut id = [0; 16];
    let failed = |error: getrandom::Error| StoreError::Home { path: PathBuf::from(path), detail: error.to_string() };
    getrandom::fill(&mut id).map_err(failed)?;
    Ok(id)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_remembers_the_newest_commit_and_a_damaged_one_has_seen_more_than_any_database() {
        let home = tempfile::tempdir().expect("a folder");
        let path = home.path().join("watermark");
        let new = Watermark::in_file(&path).expect("made");
        new.rise(7);
        let again = Watermark::in_file(&path).expect("read");
        assert_eq!((again.id, again.commits()), (new.id, 7));
        new.rise(300);
        assert_eq!(Watermark::in_file(&path).expect("read").commits(), 300);

        for damaged in [&b""[..], &[1; 23], &[1; 25], &[0xff; 24]] {
            fs::write(&path, damaged).expect("damaged");
            assert_eq!(Watermark::look(&path).expect("read").commits(), 1);
            assert_eq!(fs::read(&path).expect("there"), damaged, "a look writes nothing");
            let other = Watermark::in_file(&path).expect("made anew");
            assert_ne!(other.id, new.id);
            assert_eq!(other.commits(), 1, "no database has a commit of this id");
        }
    }
}
