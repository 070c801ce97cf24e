//! Where the ledger is, and its connections for reading. Some idle ones are kept. A server limits their number, so a
//! read may wait for one.

use std::path::{Path, PathBuf};
use std::sync::{Condvar, Mutex, PoisonError};
use std::thread::available_parallelism;

use super::SCHEMA;
use crate::StoreError;
use crate::database;
use crate::sql::Connection;
use crate::sql::postgres::Server;

/// Open to a server at most.
const READERS: usize = 8;
/// Idle ones kept besides one for each core: those that wait for the disk. Each holds half a megabyte, or more after a
/// long list, and opening one takes half a millisecond.
const WAITING: usize = 2;

#[derive(Debug)]
pub(super) enum Place {
    File(PathBuf),
    Server(Box<Server>),
}

impl Place {
    /// For messages; a server's is no path of this machine.
    pub fn path(&self) -> &Path {
        match self {
            Self::File(path) => path,
            Self::Server(server) => server.place(),
        }
    }

    pub fn file(&self) -> Option<&Path> {
        match self {
            Self::File(path) => Some(path),
            Self::Server(_) => None,
        }
    }

    /// A server's database lacks what this home has seen.
    pub fn is_restored(&self) -> bool {
        match self {
            Self::File(_) => false,
            Self::Server(server) => server.is_behind(),
        }
    }

    /// Makes what is missing there.
    pub fn writer(&self) -> Result<Connection, StoreError> {
        match self {
            Self::File(path) => Ok(database::open_writer(path, &SCHEMA)?.into()),
            Self::Server(server) => Ok(server.writer()?.into()),
        }
    }

    fn reader(&self) -> Result<Connection, StoreError> {
        match self {
            Self::File(path) => Ok(database::open_reader(path)?.into()),
            Self::Server(server) => Ok(server.connect()?.into()),
        }
    }
}

#[derive(Debug, Default)]
pub(super) struct Readers {
    state: Mutex<State>,
    freed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    idle: Vec<Connection>,
    busy: usize,
}

/// Given back when it is dropped, if it is as it was.
struct Taken<'a> {
    readers: &'a Readers,
    connection: Option<Connection>,
}

impl Drop for Taken<'_> {
    fn drop(&mut self) {
        let mut state = self.readers.lock();
        state.busy = state.busy.saturating_sub(1);
        let has_room = state.idle.len() < kept();
        state.idle.extend(self.connection.take().filter(|connection| has_room && !connection.is_in_transaction()));
        self.readers.freed.notify_one();
    }
}

impl Readers {
    /// Runs `work` on one snapshot.
    pub fn read<T>(
        &self,
        place: &Place,
        work: impl FnOnce(&Connection) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        let mut taken = self.take(place);
        let begun = snapshot(taken.connection.take(), place)?;
        let connection = taken.connection.insert(begun);
        let result = work(connection);
        // If this fails, it is still in a transaction and not kept.
        drop(connection.end_snapshot());
        result
    }

    fn take(&self, place: &Place) -> Taken<'_> {
        let mut state = self.lock();
        while place.file().is_none() && state.busy >= READERS {
            state = self.freed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        state.busy += 1;
        Taken { readers: self, connection: state.idle.pop() }
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn kept() -> usize {
    available_parallelism().map_or(1, usize::from) + WAITING
}

/// A kept connection may have ended meanwhile, or lead to what is now a standby.
fn snapshot(kept: Option<Connection>, place: &Place) -> Result<Connection, StoreError> {
    if let Some(kept) = kept {
        match kept.begin_snapshot() {
            Ok(()) => return Ok(kept),
            Err(error) if kept.trouble().is_none() => return Err(error.into()),
            Err(_) => {}
        }
    }
    let fresh = place.reader()?;
    fresh.begin_snapshot()?;
    Ok(fresh)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test fails by panicking")]

    use std::sync::Barrier;
    use std::thread;

    use super::*;

    #[test]
    fn after_many_read_at_once_two_readers_more_than_cores_stay_open() {
        let home = tempfile::tempdir().expect("a folder");
        let place = Place::File(home.path().join("ledger.db"));
        let (_writer, readers) = (place.writer().expect("opens"), Readers::default());
        let most = available_parallelism().expect("known").get() + 2;
        let together = Barrier::new(most + 6);
        thread::scope(|scope| {
            for _ in 0..most + 6 {
                let read = || readers.read(&place, |_| Ok(together.wait().is_leader()));
                scope.spawn(move || read().expect("reads"));
            }
        });
        assert_eq!(readers.lock().idle.len(), most);
    }
}
