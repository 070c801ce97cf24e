//! PostgreSQL's side: a connection that a runtime of its own drives and the door's threads ask. A commit is never cut short,
//! and one of which the server's word is missing or doubtful is reported as unknown.

use std::cell::{Cell, RefCell};
use std::collections::HashMap;
use std::fmt;
use std::future::{Future, poll_fn};
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll, Wake, Waker};
use std::thread::{self, Thread};

use futures_util::TryStreamExt as _;
use tokio_postgres::error::{Severity, SqlState};
use tokio_postgres::{AsyncMessage, Socket, tls};

use super::{Error, Kind, Params, Refusal, Result, dialect};
use crate::model::clean;

mod password;
mod server;
mod values;
mod watermark;

use self::server::Driver;
pub(crate) use self::server::{Server, apart, milliseconds};
pub(super) use self::values::cell;
use self::values::{Bound, has_nul};
pub(crate) use self::watermark::Watermark;

/// Prepared statements that a connection keeps.
const STATEMENTS_KEPT: usize = 256;
/// Statements sent before the first is answered.
const AHEAD: usize = 128;

/// A transaction's changes wait for the standbys that the server names, whatever the server's or the user's own setting.
const BEGIN: &str = "BEGIN ISOLATION LEVEL READ COMMITTED; SET LOCAL synchronous_commit = on";
const BEGIN_SNAPSHOT: &str = "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY";
/// Writes the transaction's counts and numbers it among the home's: a transaction without a change waits for no standby.
const SETTLE: &str = "SELECT settle(?1)";

pub(crate) struct Client {
    line: tokio_postgres::Client,
    statements: RefCell<HashMap<String, tokio_postgres::Statement>>,
    is_in_transaction: Cell<bool>,
    /// A statement failed, so the server refuses all others of this transaction.
    is_failed: Cell<bool>,
    trouble: Cell<Option<Kind>>,
    changes: Cell<u64>,
    /// That the server sent so far.
    warnings: Arc<AtomicU64>,
    watermark: Arc<Watermark>,
    _driver: Arc<Driver>,
}

impl fmt::Debug for Client {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("Client").finish_non_exhaustive()
    }
}

impl Client {
    fn new(
        client: tokio_postgres::Client,
        warnings: Arc<AtomicU64>,
        watermark: Arc<Watermark>,
        driver: Arc<Driver>,
    ) -> Self {
        Self {
            line: client,
            statements: RefCell::default(),
            is_in_transaction: Cell::new(false),
            is_failed: Cell::new(false),
            trouble: Cell::new(None),
            changes: Cell::new(0),
            warnings,
            watermark,
            _driver: driver,
        }
    }

    pub fn is_in_transaction(&self) -> bool {
        self.is_in_transaction.get()
    }

    pub fn total_changes(&self) -> u64 {
        self.changes.get()
    }

    pub fn trouble(&self) -> Option<Kind> {
        self.trouble.get()
    }

    pub fn prepared(&self, sql: &str) -> Result<tokio_postgres::Statement> {
        if let Some(known) = self.statements.borrow().get(sql) {
            return Ok(known.clone());
        }
        let text = dialect::for_postgres(sql);
        let statement = wait(self.line.prepare(&text)).map_err(|error| self.note(&error))?;
        let mut statements = self.statements.borrow_mut();
        if statements.len() >= STATEMENTS_KEPT {
            statements.clear();
        }
        statements.insert(sql.to_owned(), statement.clone());
        Ok(statement)
    }

    pub fn execute(&self, statement: &tokio_postgres::Statement, values: &impl Params) -> Result<u64> {
        let rows = wait(self.line.execute_raw(statement, bound(values)?)).map_err(|error| self.note(&error))?;
        self.changes.set(self.changes.get() + rows);
        Ok(rows)
    }

    /// Sends some before the first is answered: one after the other they would each wait for the way there and back.
    pub fn execute_each<P: Params>(
        &self,
        statement: &tokio_postgres::Statement,
        each: impl IntoIterator<Item = P>,
    ) -> Result<u64> {
        let (mut each, mut changed) = (each.into_iter(), 0);
        loop {
            let some: Vec<P> = each.by_ref().take(AHEAD).collect();
            if some.is_empty() {
                self.changes.set(self.changes.get() + changed);
                return Ok(changed);
            }
            let asked = some.iter().map(|values| Ok(Box::pin(self.line.execute_raw(statement, bound(values)?))));
            let mut asked = asked.collect::<Result<Vec<_>>>()?;
            let mut answers: Vec<_> = asked.iter().map(|_| None).collect();
            wait(poll_fn(|context| {
                let waiting = asked.iter_mut().zip(&mut answers).filter(|(_, answer)| answer.is_none());
                let still = waiting.fold(false, |still, (asked, answer)| match asked.as_mut().poll(context) {
                    Poll::Ready(rows) => {
                        *answer = Some(rows);
                        still
                    }
                    Poll::Pending => true,
                });
                if still { Poll::Pending } else { Poll::Ready(()) }
            }));
            for rows in answers.into_iter().flatten() {
                // The first failure is the reason of all after it.
                changed += rows.map_err(|error| self.note(&error))?;
            }
        }
    }

    /// Until `work` answers `false`.
    pub fn each_while<E: From<Error>>(
        &self,
        statement: &tokio_postgres::Statement,
        values: &impl Params,
        mut work: impl FnMut(&tokio_postgres::Row) -> std::result::Result<bool, E>,
    ) -> std::result::Result<(), E> {
        // All of them before the first is given to `work`, which may ask this connection something else.
        let values = bound(values)?;
        let asked = async { self.line.query_raw(statement, values).await?.try_collect::<Vec<_>>().await };
        for row in wait(asked).map_err(|error| self.note(&error))? {
            if !work(&row)? {
                break;
            }
        }
        Ok(())
    }

    /// The first of an answer.
    pub fn number(&self, sql: &str) -> Result<Option<i64>> {
        self.first(sql, &[])
    }

    fn first(&self, sql: &str, values: &impl Params) -> Result<Option<i64>> {
        let mut found = None;
        self.each_while(&self.prepared(sql)?, values, |row| {
            found = Some(row.try_get::<_, i64>(0).or_else(|_| row.try_get::<_, i32>(0).map(i64::from)));
            Ok::<_, Error>(false)
        })?;
        found.transpose().map_err(|error| self.note(&error))
    }

    pub fn script(&self, sql: &str) -> Result<()> {
        wait(self.line.batch_execute(sql)).map_err(|error| self.note(&error))
    }

    pub fn begin(&self) -> Result<()> {
        self.begin_with(BEGIN)
    }

    pub fn begin_snapshot(&self) -> Result<()> {
        self.begin_with(BEGIN_SNAPSHOT)
    }

    fn begin_with(&self, sql: &str) -> Result<()> {
        self.trouble.set(None);
        self.is_failed.set(false);
        self.script(sql)?;
        self.is_in_transaction.set(true);
        Ok(())
    }

    pub fn begin_part(&self) -> Result<()> {
        self.script("SAVEPOINT job")
    }

    pub fn end_part(&self) -> Result<()> {
        self.script("RELEASE SAVEPOINT job")
    }

    pub fn undo_part(&self) -> Result<()> {
        self.script("ROLLBACK TO SAVEPOINT job; RELEASE SAVEPOINT job")?;
        self.is_failed.set(false);
        Ok(())
    }

    pub fn undo(&self) -> Result<()> {
        self.script("ROLLBACK")?;
        self.is_in_transaction.set(false);
        self.is_failed.set(false);
        Ok(())
    }

    /// An error other than [`Kind::Unknown`] means that nothing was committed.
    pub fn commit(&self) -> Result<()> {
        // The server would answer COMMIT with a rollback, and call that a success.
        if self.is_failed.get() {
            return Err(Error::new(Kind::Other, "a statement of this transaction failed"));
        }
        let number = self.first(SETTLE, &[self.watermark.id()])?;
        let before = self.warnings.load(Ordering::Acquire);
        let answer = wait(self.line.batch_execute("COMMIT"));
        self.is_in_transaction.set(false);
        let unknown = |detail: String| Err(Error::new(Kind::Unknown, detail));
        match answer {
            Ok(()) if self.warnings.load(Ordering::Acquire) == before => {
                if let Some(number) = number {
                    self.watermark.rise(number);
                }
                Ok(())
            }
            Ok(()) => unknown("the server stopped waiting for its standby".to_owned()),
            // Its refusal of the whole transaction, which other transactions caused.
            Err(error) if error.code().is_some_and(|code| kind_of_state(code) == Kind::Conflict) => {
                Err(self.note(&error))
            }
            Err(error) => unknown(detail_of(&error)),
        }
    }

    /// Remembers what the door must know of it.
    fn note(&self, error: &tokio_postgres::Error) -> Error {
        self.is_failed.set(true);
        let error = Error::new(self.kind_of(error), detail_of(error));
        if matches!(error.kind, Kind::Conflict | Kind::Standby | Kind::Broken) {
            self.trouble.set(Some(error.kind));
        }
        if error.kind == Kind::Broken {
            self.is_in_transaction.set(false);
        }
        error
    }

    fn kind_of(&self, error: &tokio_postgres::Error) -> Kind {
        match error.code() {
            Some(code) => kind_of_state(code),
            None if error.is_closed() || self.line.is_closed() => Kind::Broken,
            None if std::error::Error::source(error).is_some_and(|cause| cause.is::<std::io::Error>()) => Kind::Broken,
            None => Kind::Other,
        }
    }
}

/// Of what a server says; a connection that it ends is broken.
fn kind_of_state(code: &SqlState) -> Kind {
    match code.code() {
        // The last: another wrote the same row since it was looked for.
        "40001" | "40P01" | "23505" => Kind::Conflict,
        "25006" => Kind::Standby,
        // Shut down, crashed, starting, silent for too long.
        "57P01" | "57P02" | "57P03" | "25P03" | "57P05" => Kind::Broken,
        "42P01" | "42703" | "42883" => Kind::Altered,
        "53100" => Kind::Full,
        "XX001" | "XX002" => Kind::Damaged,
        "28000" | "28P01" => Kind::Refused(Refusal::Login),
        "3D000" => Kind::Refused(Refusal::Database),
        "42P07" => Kind::Refused(Refusal::Taken),
        "42501" => Kind::Refused(Refusal::Rights),
        "53300" => Kind::Crowded,
        _ => Kind::Other,
    }
}

/// The server's words, without values of rows.
fn detail_of(error: &tokio_postgres::Error) -> String {
    let text = match error.as_db_error() {
        Some(said) => said.message().to_owned(),
        None => match std::error::Error::source(error) {
            Some(cause) => format!("{error}: {cause}"),
            None => error.to_string(),
        },
    };
    clean(&text, 200)
}

fn bound(values: &impl Params) -> Result<impl ExactSizeIterator<Item = Bound<'_>>> {
    let all = 0..values.count();
    if all.clone().any(|place| has_nul(values.at(place))) {
        let detail = "a text with a NUL character, which PostgreSQL cannot store";
        return Err(Error::new(Kind::Nul, detail));
    }
    Ok(all.map(|place| Bound(values.at(place))))
}

/// Blocks this thread alone; the connection is driven elsewhere.
fn wait<F: Future>(future: F) -> F::Output {
    struct Unpark(Thread);
    impl Wake for Unpark {
        fn wake(self: Arc<Self>) {
            self.0.unpark();
        }
    }
    let waker = Waker::from(Arc::new(Unpark(thread::current())));
    let (mut future, mut context) = (pin!(future), Context::from_waker(&waker));
    loop {
        if let Poll::Ready(value) = future.as_mut().poll(&mut context) {
            return value;
        }
        thread::park();
    }
}

/// Until it ends. Counts warnings before the answer that they precede is handed on.
async fn drive<T: tls::TlsStream + Unpin>(
    mut connection: tokio_postgres::Connection<Socket, T>,
    warnings: Arc<AtomicU64>,
) {
    while let Some(Ok(message)) = poll_fn(|context| connection.poll_message(context)).await {
        if let AsyncMessage::Notice(notice) = message
            && notice.parsed_severity() == Some(Severity::Warning)
        {
            warnings.fetch_add(1, Ordering::AcqRel);
        }
    }
}
