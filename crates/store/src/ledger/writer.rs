//! The only writer thread: does waiting work in one transaction, fsyncs once, then answers. Work after the first has a
//! savepoint, so that failures stay apart. Large work starts a transaction: inside a savepoint SQLite copies every
//! changed page and walks all copies after every statement.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, Sender, SyncSender};
use std::sync::{Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use rusqlite::Connection;

use super::append::KnownNames;
use crate::StoreError;
use crate::crypto::fault;
use crate::database::Statements as _;
use crate::database::{self, Checkpoints};

/// Pieces of work in a transaction.
const GROUP: usize = 256;
/// More records start a new transaction: another fsync is negligible then.
pub(super) const MANY: usize = 1_000;

pub(crate) struct Session<'a> {
    /// Inside a transaction: never commit or roll back here.
    pub connection: &'a Connection,
    pub names: &'a mut KnownNames,
}

trait Job: Send {
    fn is_large(&self) -> bool;
    /// Returns whether the work may stay.
    fn run(&mut self, session: &mut Session<'_>) -> bool;
    fn answer(self: Box<Self>, committed: Result<(), StoreError>);
}

struct Task<T, F> {
    records: usize,
    work: Option<F>,
    outcome: Result<T, StoreError>,
    caller: SyncSender<Result<T, StoreError>>,
}

impl<T: Send, F: FnOnce(&mut Session<'_>) -> Result<T, StoreError> + Send> Job for Task<T, F> {
    fn is_large(&self) -> bool {
        self.records > MANY
    }

    fn run(&mut self, session: &mut Session<'_>) -> bool {
        if let Some(work) = self.work.take() {
            // If the work panics.
            self.outcome = Err(failed("a write failed because of a bug and was rolled back; please report it"));
            self.outcome = work(session);
        }
        self.outcome.is_ok()
    }

    fn answer(self: Box<Self>, committed: Result<(), StoreError>) {
        let answer = match (self.work, committed) {
            (Some(_never_tried), Err(error)) => Err(error),
            (_, committed) => self.outcome.and_then(|value| committed.map(|()| value)),
        };
        let _ = self.caller.send(answer);
    }
}

enum Message {
    Work(Box<dyn Job>),
    Close(SyncSender<Result<(), StoreError>>),
    Leave,
}

/// Dropping it ends the thread without marking the file as closed.
#[derive(Debug)]
pub(super) struct Writer {
    messages: Sender<Message>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Writer {
    /// `closed`: the file is marked as cleanly closed.
    pub(super) fn start(connection: Connection, path: &Path, closed: bool) -> Result<Self, StoreError> {
        let (messages, inbox) = mpsc::channel();
        let thread = thread::Builder::new()
            .name("ledger".to_owned())
            .spawn({
                let checkpoints = Checkpoints::new(path);
                let mark = Mark::new(&connection, closed)?;
                move || serve(connection, checkpoints, mark, &inbox)
            })
            .map_err(|error| StoreError::home(path, &error))?;
        Ok(Self { messages, thread: Mutex::new(Some(thread)) })
    }

    /// Returns when the work is durable.
    pub(super) fn write<T: Send + 'static>(
        &self,
        records: usize,
        work: impl FnOnce(&mut Session<'_>) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreError> {
        self.ask(records, work)?.recv().map_err(|_| StoreError::Closed)?
    }

    /// The answer comes when the work is durable.
    pub(super) fn ask<T: Send + 'static>(
        &self,
        records: usize,
        work: impl FnOnce(&mut Session<'_>) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<Receiver<Result<T, StoreError>>, StoreError> {
        let (caller, answer) = mpsc::sync_channel(1);
        let task = Task { records, work: Some(work), outcome: Err(StoreError::Closed), caller };
        self.messages.send(Message::Work(Box::new(task))).map_err(|_| StoreError::Closed)?;
        Ok(answer)
    }

    pub(super) fn close(&self) -> Result<(), StoreError> {
        let (caller, answer) = mpsc::sync_channel(1);
        self.messages.send(Message::Close(caller)).map_err(|_| StoreError::Closed)?;
        let result = answer.recv().map_err(|_| StoreError::Closed)?;
        self.join();
        result
    }

    fn join(&self) {
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(thread) = thread {
            // A panic there was already answered with `Closed`.
            let _ = thread.join();
        }
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        let _ = self.messages.send(Message::Leave);
        self.join();
    }
}

/// Marks the file as open at the first change, and renews the feed's id at its first number.
struct Mark {
    /// As the file says.
    closed: bool,
    is_told: bool,
    has_feed: bool,
    /// `total_changes` at the start.
    untouched: u64,
    /// The feed's last number at the start.
    head: i64,
}

impl Mark {
    fn new(connection: &Connection, closed: bool) -> Result<Self, StoreError> {
        let untouched = connection.total_changes();
        Ok(Self { closed, is_told: false, has_feed: false, untouched, head: head(connection)? })
    }

    /// Inside a change's transaction: whether, from its commit on, the file is marked open and the feed has this
    /// process's id.
    fn open(&self, connection: &Connection) -> Result<(bool, bool), StoreError> {
        let is_told = self.is_told || connection.total_changes() != self.untouched;
        if is_told && !self.is_told {
            connection.run("UPDATE about SET clean = 0", [])?;
        }
        let has_feed = self.has_feed || head(connection)? != self.head;
        if has_feed && !self.has_feed {
            super::feed::begin(connection, self.head)?;
        }
        Ok((is_told, has_feed))
    }
}

fn head(connection: &Connection) -> Result<i64, StoreError> {
    Ok(connection.one("SELECT head FROM about", [], |row| row.get(0))?)
}

fn serve(connection: Connection, mut checkpoints: Checkpoints, mut mark: Mark, inbox: &Receiver<Message>) {
    let mut names = KnownNames::default();
    while let Ok(first) = inbox.recv() {
        let mut group = Vec::new();
        let last = gather(first, inbox, &mut group);
        checkpoints.adjust(&connection);
        names.bound();
        commit(&connection, &mut names, &mut mark, group);
        if !connection.is_autocommit() {
            // What could not be rolled back must never be committed; closing the file rolls it back.
            return;
        }
        match last {
            None => {}
            Some(Message::Close(caller)) => {
                let _ = caller.send(finish(connection, &mark));
                return;
            }
            Some(_) => return,
        }
    }
}

/// Returns the message that ends the thread, if one came.
fn gather(first: Message, inbox: &Receiver<Message>, group: &mut Vec<Box<dyn Job>>) -> Option<Message> {
    let mut next = Some(first);
    while let Some(message) = next {
        match message {
            Message::Work(job) => group.push(job),
            end => return Some(end),
        }
        next = if group.len() < GROUP { inbox.try_recv().ok() } else { None };
    }
    None
}

fn commit(connection: &Connection, names: &mut KnownNames, mark: &mut Mark, group: Vec<Box<dyn Job>>) {
    let mut done: Vec<Box<dyn Job>> = Vec::with_capacity(group.len());
    for mut job in group {
        if job.is_large() && !done.is_empty() {
            settle(connection, names, mark, &mut done);
            if !connection.is_autocommit() {
                return;
            }
        }
        match attempt(connection, names, job.as_mut()) {
            Ok(true) => done.push(job),
            Ok(false) => job.answer(Err(StoreError::Closed)),
            Err(error) => {
                job.answer(Err(error));
                // A half-done piece may still be in there.
                if !connection.is_autocommit() && connection.run("ROLLBACK", []).is_err() {
                    answer_all(&mut done, &lost_group());
                    return;
                }
            }
        }
        if connection.is_autocommit() {
            // The transaction is gone (disk full, I/O error), and nobody in it was answered.
            *names = KnownNames::default();
            answer_all(&mut done, &lost_group());
        }
    }
    settle(connection, names, mark, &mut done);
}

fn settle(connection: &Connection, names: &mut KnownNames, mark: &mut Mark, done: &mut Vec<Box<dyn Job>>) {
    let result = if connection.is_autocommit() { Ok(()) } else { end(connection, mark) };
    if result.is_err() {
        *names = KnownNames::default();
    }
    answer_all(done, &result);
}

/// Whether the job did its work; an error if it could not be tried, kept or rolled back.
fn attempt(connection: &Connection, names: &mut KnownNames, job: &mut dyn Job) -> Result<bool, StoreError> {
    let is_first = connection.is_autocommit();
    connection.run(if is_first { "BEGIN IMMEDIATE" } else { "SAVEPOINT job" }, [])?;
    // A fault must end neither this thread nor other work.
    let done = catch_unwind(AssertUnwindSafe(|| job.run(&mut Session { connection, names })));
    if matches!(done, Ok(true)) {
        if !is_first {
            connection.run("RELEASE job", [])?;
        }
        return Ok(true);
    }
    *names = KnownNames::default();
    if !connection.is_autocommit() {
        connection.run(if is_first { "ROLLBACK" } else { "ROLLBACK TO job" }, [])?;
        if !is_first {
            connection.run("RELEASE job", [])?;
        }
    }
    Ok(false)
}

fn failed(detail: &str) -> StoreError {
    StoreError::Database { file: PathBuf::new(), detail: detail.to_owned() }
}

fn end(connection: &Connection, mark: &mut Mark) -> Result<(), StoreError> {
    let opened = mark.open(connection);
    fault::point("commit-begun");
    let result = opened.and_then(|opened| connection.run("COMMIT", []).map(|()| opened));
    fault::point("committed");
    if result.is_err() && !connection.is_autocommit() {
        connection.run("ROLLBACK", [])?;
    }
    (mark.is_told, mark.has_feed) = result?;
    mark.closed &= !mark.is_told;
    Ok(())
}

fn lost_group() -> Result<(), StoreError> {
    Err(failed("the disk refused a write, so the whole group of writes was rolled back"))
}

fn answer_all(done: &mut Vec<Box<dyn Job>>, result: &Result<(), StoreError>) {
    for job in done.drain(..) {
        job.answer(result.clone());
    }
}

fn finish(connection: Connection, mark: &Mark) -> Result<(), StoreError> {
    if !mark.closed {
        connection.execute("UPDATE about SET clean = 1", [])?;
    }
    database::settle(&connection);
    connection.close().map_err(|(_, error)| StoreError::from(error))
}
