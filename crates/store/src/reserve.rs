//! Disk space reserved for a full disk: random bytes, which no file system compresses, fsynced so that the space is
//! really allocated; deleted when it is needed.

use std::fs::{self, File};
use std::io::Write as _;
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use serde::{Deserialize, Serialize};
use sm3::{Digest as _, Sm3};

use crate::model::{Address, LossReason, Timestamp};
use crate::{Loss, StoreError, files};

/// For a revoke: its audit line, transaction, keyring and block.
pub const RESERVE_BYTES: u64 = 4 * 1024 * 1024;
/// Bytes drawn at a time.
const PIECE: usize = 64 * 1024;

#[derive(Debug)]
pub struct Reserve {
    path: PathBuf,
    bytes: u64,
    held: Mutex<bool>,
}

impl Reserve {
    /// Refills a missing or truncated reserve; the handle can be used even if that fails.
    pub fn open(path: &Path, bytes: u64) -> (Self, Result<(), StoreError>) {
        let whole = fs::metadata(path).is_ok_and(|about| about.len() == bytes);
        let reserve = Self { path: path.to_owned(), bytes, held: Mutex::new(whole) };
        let filled = reserve.refill();
        (reserve, filled)
    }

    fn held(&self) -> MutexGuard<'_, bool> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn is_held(&self) -> bool {
        *self.held()
    }

    /// Returns whether there was any.
    pub fn release(&self) -> Result<bool, StoreError> {
        let mut held = self.held();
        if !*held {
            return Ok(false);
        }
        fs::remove_file(&self.path).map_err(|error| StoreError::home(&self.path, &error))?;
        *held = false;
        Ok(true)
    }

    pub fn refill(&self) -> Result<(), StoreError> {
        let mut held = self.held();
        if *held {
            return Ok(());
        }
        let filled = files::open_private(&self.path)
            .and_then(|file| fill(file, self.bytes).map_err(|error| StoreError::home(&self.path, &error)));
        if let Err(error) = filled {
            // Half a reserve would take space that others need now.
            drop(fs::remove_file(&self.path));
            return Err(error);
        }
        *held = true;
        Ok(())
    }
}

fn fill(mut file: File, bytes: u64) -> std::io::Result<()> {
    file.set_len(0)?;
    let mut piece = vec![0; PIECE];
    let mut left = bytes;
    while left > 0 {
        let length = usize::try_from(left).unwrap_or(PIECE).min(PIECE);
        let Some(part) = piece.get_mut(..length) else { break };
        getrandom::fill(part).map_err(|error| std::io::Error::other(error.to_string()))?;
        file.write_all(part)?;
        left -= length as u64;
    }
    file.sync_all()
}

// Messages that wait in memory while the disk is full, counted in a file allocated beforehand and overwritten in place.
// Two slots are written in turn, each `number (8) || length (4) || SM3 of number and text (32) || text`: after a crash
// the whole one with the higher number counts.

/// A line of text takes about 200 bytes.
const SLOT: usize = 128 * 1024;
/// Bytes before a slot's text.
const HEAD: usize = 8 + 4 + 32;

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Waiting {
    /// Not counted in the ledger.
    pub lost: Vec<Loss>,
    /// In memory; lost only if the process dies.
    pub waiting: Vec<Loss>,
}

/// For the one process that is the site.
#[derive(Debug)]
pub struct WaitingFile {
    path: PathBuf,
    file: File,
    number: u64,
    is_empty: bool,
}

#[derive(Serialize, Deserialize)]
struct Text {
    lost: Vec<Line>,
    waiting: Vec<Line>,
}

#[derive(Serialize, Deserialize)]
struct Line {
    owner: Address,
    topic: String,
    publisher: String,
    reason: u8,
    count: u64,
    numbers: Option<(u32, u32)>,
    first_at: Timestamp,
    last_at: Timestamp,
}

impl Line {
    fn of(loss: &Loss) -> Self {
        let Loss { owner, topic, publisher, reason, count, numbers, first_at, last_at } = loss.clone();
        Self { owner, topic, publisher, reason: reason.code(), count, numbers, first_at, last_at }
    }

    fn loss(self) -> Option<Loss> {
        let Self { owner, topic, publisher, reason, count, numbers, first_at, last_at } = self;
        let reason = LossReason::from_code(reason)?;
        Some(Loss { owner, topic, publisher, reason, count, numbers, first_at, last_at })
    }
}

impl WaitingFile {
    /// Opens or allocates the file; returns its contents, without losses that the ledger counted up to text `counted`.
    pub fn open(path: &Path, counted: u64) -> Result<(Self, Waiting), StoreError> {
        let file = files::open_private(path)?;
        let about = file.metadata().map_err(|error| StoreError::home(path, &error))?;
        if about.len() != 2 * SLOT as u64 {
            let allocated = file.write_all_at(&vec![0; 2 * SLOT], 0).and_then(|()| file.sync_all());
            allocated.map_err(|error| StoreError::home(path, &error))?;
        }
        let newest = [0, 1].into_iter().filter_map(|slot| read(&file, slot)).max_by_key(|(number, _)| *number);
        let (number, mut left) = newest.unwrap_or_default();
        if number <= counted {
            left.lost.clear();
        }
        let number = number.max(counted);
        let is_empty = left == Waiting::default();
        Ok((Self { path: path.to_owned(), file, number, is_empty }, left))
    }

    /// Of the text.
    pub fn number(&self) -> u64 {
        self.number
    }

    pub fn is_empty(&self) -> bool {
        self.is_empty
    }

    /// Durable without taking space. What does not fit is left out, the last first.
    pub fn write(&mut self, now: &Waiting) -> Result<(), StoreError> {
        let number = self.number + 1;
        let text = text_of(now);
        let mut slot = Vec::with_capacity(HEAD + text.len());
        slot.extend(number.to_be_bytes());
        slot.extend(u32::try_from(text.len()).unwrap_or(0).to_be_bytes());
        slot.extend(sum(number, &text));
        slot.extend(text);
        let at = (number % 2) * SLOT as u64;
        let written = self.file.write_all_at(&slot, at).and_then(|()| self.file.sync_data());
        written.map_err(|error| StoreError::home(&self.path, &error))?;
        (self.number, self.is_empty) = (number, *now == Waiting::default());
        Ok(())
    }
}

fn sum(number: u64, text: &[u8]) -> [u8; 32] {
    Sm3::new().chain_update(number.to_be_bytes()).chain_update(text).finalize().into()
}

fn text_of(now: &Waiting) -> Vec<u8> {
    let mut most = now.lost.len().max(now.waiting.len());
    loop {
        let lines = |losses: &[Loss]| losses.iter().take(most).map(Line::of).collect();
        let text = serde_json::to_vec(&Text { lost: lines(&now.lost), waiting: lines(&now.waiting) });
        match text.unwrap_or_default() {
            text if text.len() <= SLOT - HEAD || most == 0 => return text,
            _ => most = most * 3 / 4,
        }
    }
}

fn read(file: &File, slot: u64) -> Option<(u64, Waiting)> {
    let mut bytes = vec![0; SLOT];
    file.read_exact_at(&mut bytes, slot * SLOT as u64).ok()?;
    let (number, rest) = bytes.split_first_chunk::<8>()?;
    let (length, rest) = rest.split_first_chunk::<4>()?;
    let (expected, rest) = rest.split_first_chunk::<32>()?;
    let number = u64::from_be_bytes(*number);
    let text = rest.get(..usize::try_from(u32::from_be_bytes(*length)).ok()?)?;
    if sum(number, text) != *expected {
        return None;
    }
    let Text { lost, waiting } = serde_json::from_slice(text).ok()?;
    let losses = |lines: Vec<Line>| lines.into_iter().filter_map(Line::loss).collect();
    Some((number, Waiting { lost: losses(lost), waiting: losses(waiting) }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn space_is_set_aside_given_up_once_and_set_aside_again() {
        let home = tempfile::tempdir().expect("folder");
        let path = home.path().join("reserve");
        let size = || fs::metadata(&path).map(|about| about.len()).ok();
        let (reserve, opened) = Reserve::open(&path, RESERVE_BYTES);
        assert_eq!((opened, reserve.is_held(), size()), (Ok(()), true, Some(RESERVE_BYTES)));
        assert_eq!((reserve.release(), reserve.release(), size()), (Ok(true), Ok(false), None));
        reserve.refill().expect("there is room");
        assert_eq!(size(), Some(RESERVE_BYTES));
        fs::write(&path, b"cut short").expect("written");
        let (again, opened) = Reserve::open(&path, RESERVE_BYTES);
        assert_eq!((opened, again.is_held(), size()), (Ok(()), true, Some(RESERVE_BYTES)));
        let (none, opened) = Reserve::open(&home.path().join("no/such/folder"), RESERVE_BYTES);
        assert!(opened.is_err() && !none.is_held() && none.release() == Ok(false));
    }
}

#[cfg(test)]
mod waiting_tests {
    use super::*;

    fn loss(topic: &str, count: u64) -> Loss {
        Loss {
            owner: Address([1; 20]),
            topic: topic.to_owned(),
            publisher: "/driver".to_owned(),
            reason: LossReason::End,
            count,
            numbers: Some((3, 9)),
            first_at: Timestamp(5),
            last_at: Timestamp(7),
        }
    }

    fn length(path: &Path) -> u64 {
        std::fs::metadata(path).expect("there").len()
    }

    #[test]
    fn what_waited_is_there_after_a_crash_and_what_was_counted_is_not_counted_twice() {
        let home = tempfile::tempdir().expect("folder");
        let path = home.path().join("waiting");
        let (mut file, left) = WaitingFile::open(&path, 0).expect("allocated");
        assert!(left == Waiting::default() && file.is_empty());
        let allocated = length(&path);
        let first = Waiting { lost: vec![loss("/a", 2)], waiting: vec![loss("/b", 40)] };
        file.write(&first).expect("written");
        let second = Waiting { waiting: vec![loss("/b", 41)], ..first.clone() };
        file.write(&second).expect("written");
        assert_eq!((length(&path), file.number(), file.is_empty()), (allocated, 2, false), "in place");
        drop(file);
        let (file, left) = WaitingFile::open(&path, 0).expect("opened");
        assert_eq!((left, file.number()), (second.clone(), 2));
        let (_, left) = WaitingFile::open(&path, 2).expect("opened");
        assert_eq!(left, Waiting { lost: Vec::new(), ..second }, "the ledger has counted what was lost");

        // Power went while the third text was written.
        std::fs::OpenOptions::new()
            .write(true)
            .open(&path)
            .expect("opened")
            .write_all_at(&[7; 100], SLOT as u64)
            .expect("torn");
        let (mut file, left) = WaitingFile::open(&path, 0).expect("opened");
        assert_eq!((left.waiting, file.number()), (vec![loss("/b", 41)], 2));
        file.write(&Waiting::default()).expect("cleared");
        assert!(file.is_empty() && WaitingFile::open(&path, 0).expect("opened").1 == Waiting::default());
        let (file, _) = WaitingFile::open(&path, 9).expect("of a ledger that has counted more");
        assert_eq!(file.number(), 9);
    }

    #[test]
    fn what_does_not_fit_is_left_out() {
        let home = tempfile::tempdir().expect("folder");
        let (path, many) = (home.path().join("waiting"), (0..5_000).map(|at| loss(&format!("/t{at}"), 1)));
        let (mut file, _) = WaitingFile::open(&path, 0).expect("allocated");
        file.write(&Waiting { lost: many.collect(), waiting: vec![loss("/b", 1)] }).expect("written");
        let left = WaitingFile::open(&path, 0).expect("opened").1;
        assert!((300..5_000).contains(&left.lost.len()) && left.waiting.len() == 1, "{}", left.lost.len());
    }
}
