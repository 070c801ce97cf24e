//! The only writer thread: does waiting work in one transaction, fsyncs once, then answers. Work after the first has a
//! savepoint, so that failures stay apart. Large work starts a transaction: inside a savepoint SQLite copies every
//! changed page and walks all copies after every statement. On a server, a group that another transaction was in the way
//! of is done again; one whose commit is in doubt is not.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::mpsc::{self, Receiver, Sender, SyncSender};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use super::append::KnownNames;
use super::lease::Tenure;
use super::readers::Place;
use crate::StoreError;
use crate::crypto::fault;
use crate::database::{self, Checkpoints};
use crate::sql::{Connection, Kind};

/// Pieces of work in a transaction.
const GROUP: usize = 256;
/// More records start a new transaction: another fsync is negligible then.
pub(super) const MANY: usize = 1_000;
/// Milliseconds before a group is done again; a standby is promoted meanwhile. Nobody waits for a file.
const PAUSES: [u64; 9] = [20, 100, 300, 1_000, 1_500, 2_000, 3_000, 3_000, 3_000];

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
    work: F,
    is_tried: bool,
    outcome: Result<T, StoreError>,
    caller: SyncSender<Result<T, StoreError>>,
}

impl<T: Send, F: Fn(&mut Session<'_>) -> Result<T, StoreError> + Send> Job for Task<T, F> {
    fn is_large(&self) -> bool {
        self.records > MANY
    }

    fn run(&mut self, session: &mut Session<'_>) -> bool {
        self.is_tried = true;
        // If the work panics.
        self.outcome = Err(failed("a write failed because of a bug and was rolled back; please report it"));
        self.outcome = (self.work)(session);
        self.outcome.is_ok()
    }

    fn answer(self: Box<Self>, committed: Result<(), StoreError>) {
        let answer = match (self.is_tried, committed) {
            (false, Err(error)) => Err(error),
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
    pub(super) fn start(
        connection: Connection,
        place: Arc<Place>,
        tenure: Arc<Tenure>,
        closed: bool,
    ) -> Result<Self, StoreError> {
        let (messages, inbox) = mpsc::channel();
        let thread = thread::Builder::new()
            .name("ledger".to_owned())
            .spawn({
                let (mark, place) = (Mark::new(&connection, closed)?, Arc::clone(&place));
                move || Door { commits: 0, connection, place, tenure, names: KnownNames::default(), mark }.serve(&inbox)
            })
            .map_err(|error| StoreError::home(place.path(), &error))?;
        Ok(Self { messages, thread: Mutex::new(Some(thread)) })
    }

    /// Returns when the work is durable.
    pub(super) fn write<T: Send + 'static>(
        &self,
        records: usize,
        work: impl Fn(&mut Session<'_>) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreError> {
        self.ask(records, work)?.recv().map_err(|_| StoreError::Closed)?
    }

    /// The answer comes when the work is durable.
    pub(super) fn ask<T: Send + 'static>(
        &self,
        records: usize,
        work: impl Fn(&mut Session<'_>) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<Receiver<Result<T, StoreError>>, StoreError> {
        let (caller, answer) = mpsc::sync_channel(1);
        let task = Task { records, work, is_tried: false, outcome: Err(StoreError::Closed), caller };
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

/// Marks a file as open at the first change, and renews the feed's id at its first number. On a server a lease renews it.
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
        let (untouched, is_server) = (connection.total_changes(), connection.server().is_some());
        let closed = closed || is_server;
        Ok(Self { closed, is_told: is_server, has_feed: is_server, untouched, head: head(connection)? })
    }

    /// Inside a change's transaction: whether, from its commit on, the file is marked open and the feed has this
    /// process's id.
    fn open(&self, connection: &Connection) -> Result<(bool, bool), StoreError> {
        if self.is_told && self.has_feed {
            return Ok((true, true));
        }
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

pub(super) fn head(connection: &Connection) -> Result<i64, StoreError> {
    Ok(connection.one("SELECT head FROM about", [], |row| row.get(0))?)
}

/// Commits after which a server's counts are folded.
const FOLD_AFTER: u32 = 256;

struct Door {
    /// Since the counts were folded.
    commits: u32,
    connection: Connection,
    place: Arc<Place>,
    tenure: Arc<Tenure>,
    names: KnownNames,
    mark: Mark,
}

impl Door {
    fn serve(mut self, inbox: &Receiver<Message>) {
        let mut checkpoints = self.place.file().map(Checkpoints::new);
        while let Ok(first) = inbox.recv() {
            let mut group = VecDeque::new();
            let last = gather(first, inbox, &mut group);
            if let Some((checkpoints, file)) = checkpoints.as_mut().zip(self.connection.file()) {
                checkpoints.adjust(file);
            }
            self.names.bound();
            self.commit(group);
            self.fold();
            if self.connection.is_in_transaction() {
                // What could not be rolled back must never be committed; closing the connection rolls it back.
                return;
            }
            match last {
                None => {}
                Some(Message::Close(caller)) => {
                    let _ = caller.send(finish(self.connection, &self.mark, &self.tenure));
                    return;
                }
                Some(_) => return,
            }
        }
    }

    /// If it fails, the next time does it.
    fn fold(&mut self) {
        let Ok(Some(fence)) = self.tenure.fence() else { return };
        if self.commits < FOLD_AFTER {
            return;
        }
        self.commits = 0;
        let connection = &self.connection;
        let fold = || {
            connection.begin()?;
            fence.check(connection)?;
            connection.script("SELECT fold()")?;
            Ok::<_, StoreError>(connection.commit()?)
        };
        if fold().is_err() {
            drop(connection.undo());
        }
    }

    /// Answers every job.
    fn commit(&mut self, mut group: VecDeque<Box<dyn Job>>) {
        let mut reason = failed("other transactions were in the way each time");
        for pause in PAUSES {
            self.attempt_all(&mut group);
            if group.is_empty() {
                return;
            }
            self.names = KnownNames::default();
            thread::sleep(Duration::from_millis(pause));
            if self.connection.trouble() != Some(Kind::Conflict) {
                match self.place.writer() {
                    Ok(fresh) => self.connection = fresh,
                    Err(error) => {
                        reason = error;
                        if self.place.is_restored() {
                            break;
                        }
                    }
                }
            }
        }
        answer_all(&mut group.into(), &Err(reason));
    }

    /// Leaves what must be done again in the group.
    fn attempt_all(&mut self, group: &mut VecDeque<Box<dyn Job>>) {
        let mut done: Vec<Box<dyn Job>> = Vec::with_capacity(group.len());
        while let Some(mut job) = group.pop_front() {
            if job.is_large() && !done.is_empty() {
                self.settle(&mut done);
                if self.connection.trouble().is_some() {
                    group.push_front(job);
                    break;
                }
                if self.connection.is_in_transaction() {
                    return group.clear();
                }
            }
            match self.attempt(job.as_mut()) {
                _ if self.connection.trouble().is_some() => {
                    done.push(job);
                    break;
                }
                Ok(true) => done.push(job),
                Ok(false) => job.answer(Err(StoreError::Closed)),
                Err(error) => {
                    job.answer(Err(error));
                    // A half-done piece may still be in there.
                    if self.connection.is_in_transaction() && self.connection.undo().is_err() {
                        answer_all(&mut done, &lost_group());
                        return group.clear();
                    }
                }
            }
            if !self.connection.is_in_transaction() {
                // The transaction is gone (disk full, I/O error), and nobody in it was answered.
                self.names = KnownNames::default();
                answer_all(&mut done, &lost_group());
            }
        }
        if self.connection.trouble().is_none() {
            self.settle(&mut done);
        }
        if self.connection.trouble().is_some() {
            // If this fails, the connection is of no use and is replaced.
            drop(self.connection.undo());
            done.into_iter().rev().for_each(|job| group.push_front(job));
        }
    }

    /// Leaves the jobs where they must be done again.
    fn settle(&mut self, done: &mut Vec<Box<dyn Job>>) {
        let result = if self.connection.is_in_transaction() { self.end() } else { Ok(()) };
        if result.is_err() {
            self.names = KnownNames::default();
        }
        if self.connection.trouble().is_none() {
            answer_all(done, &result);
        }
    }

    /// Whether the job did its work; an error if it could not be tried, kept or rolled back.
    fn attempt(&mut self, job: &mut dyn Job) -> Result<bool, StoreError> {
        let (connection, names) = (&self.connection, &mut self.names);
        let is_first = !connection.is_in_transaction();
        if is_first { connection.begin() } else { connection.begin_part() }?;
        // A fault must end neither this thread nor other work.
        let done = catch_unwind(AssertUnwindSafe(|| job.run(&mut Session { connection, names })));
        if matches!(done, Ok(true)) {
            if !is_first {
                connection.end_part()?;
            }
            return Ok(true);
        }
        *names = KnownNames::default();
        if connection.is_in_transaction() && connection.trouble().is_none() {
            if is_first { connection.undo() } else { connection.undo_part() }?;
        }
        Ok(false)
    }

    fn end(&mut self) -> Result<(), StoreError> {
        let opened = self.tenure.number_waiting(&self.connection).and_then(|()| self.mark.open(&self.connection));
        fault::point("commit-begun");
        let result = opened.and_then(|opened| Ok(self.connection.commit().map(|()| opened)?));
        fault::point("committed");
        if result.is_err() && self.connection.is_in_transaction() {
            self.connection.undo()?;
        }
        (self.mark.is_told, self.mark.has_feed) = result?;
        self.mark.closed &= !self.mark.is_told || self.connection.server().is_some();
        self.commits = self.commits.saturating_add(1);
        Ok(())
    }
}

/// Returns the message that ends the thread, if one came.
fn gather(first: Message, inbox: &Receiver<Message>, group: &mut VecDeque<Box<dyn Job>>) -> Option<Message> {
    let mut next = Some(first);
    while let Some(message) = next {
        match message {
            Message::Work(job) => group.push_back(job),
            end => return Some(end),
        }
        next = if group.len() < GROUP { inbox.try_recv().ok() } else { None };
    }
    None
}

fn failed(detail: &str) -> StoreError {
    StoreError::Database { file: PathBuf::new(), detail: detail.to_owned() }
}

fn lost_group() -> Result<(), StoreError> {
    Err(failed("the disk refused a write, so the whole group of writes was rolled back"))
}

fn answer_all(done: &mut Vec<Box<dyn Job>>, result: &Result<(), StoreError>) {
    for job in done.drain(..) {
        job.answer(result.clone());
    }
}

fn finish(connection: Connection, mark: &Mark, tenure: &Tenure) -> Result<(), StoreError> {
    // Else others wait until its time is over.
    drop(tenure.release(&connection));
    if !mark.closed {
        connection.begin()?;
        connection.run("UPDATE about SET clean = 1", [])?;
        connection.commit()?;
    }
    if let Some(file) = connection.file() {
        database::settle(file);
    }
    Ok(connection.close()?)
}
