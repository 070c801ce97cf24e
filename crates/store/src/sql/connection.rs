//! A connection to either engine, with what the stores do on it. Statements are prepared once and kept by the connection.

use super::postgres::Client;
use super::{Error, Kind, Params, Result, Row, sqlite};
use crate::StoreError;

#[derive(Debug)]
pub(crate) struct Connection(Engine);

#[derive(Debug)]
enum Engine {
    Sqlite(rusqlite::Connection),
    Postgres(Box<Client>),
}

impl From<rusqlite::Connection> for Connection {
    fn from(file: rusqlite::Connection) -> Self {
        Self(Engine::Sqlite(file))
    }
}

impl From<Client> for Connection {
    fn from(client: Client) -> Self {
        Self(Engine::Postgres(Box::new(client)))
    }
}

pub(crate) enum Statement<'a> {
    Sqlite(rusqlite::CachedStatement<'a>),
    Postgres(&'a Client, tokio_postgres::Statement),
}

impl Statement<'_> {
    /// Returns the number of changed rows.
    pub fn execute(&mut self, values: impl Params) -> Result<u64> {
        match self {
            Self::Sqlite(statement) => {
                sqlite::bind(statement, &values)?;
                Ok(crate::database::count(statement.raw_execute()?))
            }
            Self::Postgres(client, statement) => client.execute(statement, &values),
        }
    }

    /// Until `work` answers `false`.
    pub fn each_while<E: From<Error>>(
        &mut self,
        values: impl Params,
        mut work: impl FnMut(&Row<'_>) -> std::result::Result<bool, E>,
    ) -> std::result::Result<(), E> {
        match self {
            Self::Sqlite(statement) => {
                sqlite::bind(statement, &values)?;
                let mut rows = statement.raw_query();
                while let Some(row) = rows.next().map_err(Error::from)? {
                    if !work(&Row::Sqlite(row))? {
                        break;
                    }
                }
                Ok(())
            }
            Self::Postgres(client, statement) => client.each_while(statement, &values, |row| work(&Row::Postgres(row))),
        }
    }

    pub fn find<T>(&mut self, values: impl Params, read: impl FnOnce(&Row<'_>) -> Result<T>) -> Result<Option<T>> {
        let (mut read, mut found) = (Some(read), None);
        self.each_while(values, |row| {
            found = read.take().map(|read| read(row)).transpose()?;
            Ok::<_, Error>(false)
        })?;
        Ok(found)
    }

    pub fn one<T>(&mut self, values: impl Params, read: impl FnOnce(&Row<'_>) -> Result<T>) -> Result<T> {
        self.find(values, read)?.ok_or_else(Error::missing)
    }

    pub fn has(&mut self, values: impl Params) -> Result<bool> {
        Ok(self.find(values, |_| Ok(()))?.is_some())
    }

    pub fn list<T, All: FromIterator<T>>(
        &mut self,
        values: impl Params,
        mut read: impl FnMut(&Row<'_>) -> Result<T>,
    ) -> Result<All> {
        let mut found = Vec::new();
        self.each_while(values, |row| {
            found.push(read(row)?);
            Ok::<_, Error>(true)
        })?;
        Ok(found.into_iter().collect())
    }
}

impl Connection {
    /// `None` on a server.
    pub fn file(&self) -> Option<&rusqlite::Connection> {
        match &self.0 {
            Engine::Sqlite(file) => Some(file),
            Engine::Postgres(_) => None,
        }
    }

    /// `None` on a file.
    pub fn server(&self) -> Option<&Client> {
        match &self.0 {
            Engine::Sqlite(_) => None,
            Engine::Postgres(client) => Some(client),
        }
    }

    pub fn prepared(&self, sql: &str) -> Result<Statement<'_>> {
        match &self.0 {
            Engine::Sqlite(file) => {
                #[cfg(test)]
                crate::ledger::tests::statements::note(file, sql);
                Ok(Statement::Sqlite(file.prepare_cached(sql)?))
            }
            Engine::Postgres(client) => Ok(Statement::Postgres(client, client.prepared(sql)?)),
        }
    }

    pub fn run(&self, sql: &str, values: impl Params) -> std::result::Result<(), StoreError> {
        self.changed(sql, values)?;
        Ok(())
    }

    /// Returns the number of changed rows.
    pub fn changed(&self, sql: &str, values: impl Params) -> Result<u64> {
        self.prepared(sql)?.execute(values)
    }

    /// Runs an INSERT of one row; returns its `key`, the column of a table's numbers.
    pub fn inserted(&self, sql: &str, key: &str, values: impl Params) -> Result<i64> {
        match &self.0 {
            Engine::Sqlite(file) => {
                self.changed(sql, values)?;
                Ok(file.last_insert_rowid())
            }
            Engine::Postgres(_) => self.one(&format!("{sql} RETURNING {key}"), values, |row| row.get(0)),
        }
    }

    pub fn run_each<P: Params>(&self, sql: &str, each: impl IntoIterator<Item = P>) -> Result<u64> {
        match self.prepared(sql)? {
            Statement::Postgres(client, statement) => client.execute_each(&statement, each),
            mut statement @ Statement::Sqlite(_) => {
                each.into_iter().try_fold(0, |changed, values| Ok(changed + statement.execute(values)?))
            }
        }
    }

    /// Values for which a query has a row (`has`), or has none.
    pub fn among<T: Copy, P: Params>(
        &self,
        sql: &str,
        all: &[T],
        values: impl Fn(T) -> std::result::Result<P, StoreError>,
        has: bool,
    ) -> std::result::Result<Vec<T>, StoreError> {
        let mut statement = self.prepared(sql)?;
        let mut found = Vec::new();
        for one in all {
            if statement.has(values(*one)?)? == has {
                found.push(*one);
            }
        }
        Ok(found)
    }

    pub fn each(
        &self,
        sql: &str,
        values: impl Params,
        mut work: impl FnMut(&Row<'_>) -> std::result::Result<(), StoreError>,
    ) -> std::result::Result<(), StoreError> {
        self.prepared(sql)?.each_while(values, |row| work(row).map(|()| true))
    }

    pub fn one<T>(&self, sql: &str, values: impl Params, read: impl FnOnce(&Row<'_>) -> Result<T>) -> Result<T> {
        self.prepared(sql)?.one(values, read)
    }

    pub fn find<T>(
        &self,
        sql: &str,
        values: impl Params,
        read: impl FnOnce(&Row<'_>) -> Result<T>,
    ) -> Result<Option<T>> {
        self.prepared(sql)?.find(values, read)
    }

    pub fn list<T, All: FromIterator<T>>(
        &self,
        sql: &str,
        values: impl Params,
        read: impl FnMut(&Row<'_>) -> Result<T>,
    ) -> Result<All> {
        self.prepared(sql)?.list(values, read)
    }

    pub fn has(&self, sql: &str, values: impl Params) -> Result<bool> {
        self.prepared(sql)?.has(values)
    }

    /// Several statements without parameters.
    pub fn script(&self, sql: &str) -> Result<()> {
        match &self.0 {
            Engine::Sqlite(file) => Ok(file.execute_batch(sql)?),
            Engine::Postgres(client) => client.script(sql),
        }
    }

    /// At most `length` bytes of a record's ciphertext, in its row `record`, that was just found.
    pub fn front(&self, record: i64, length: usize) -> Result<Vec<u8>> {
        match &self.0 {
            Engine::Sqlite(file) => sqlite::front(file, record, length),
            Engine::Postgres(_) => {
                let sql = "SELECT substr(bytes, 1, ?2) FROM ciphertext WHERE record = ?1";
                self.one(sql, [record, crate::database::capped(length).min(i64::from(i32::MAX))], |row| row.get(0))
            }
        }
    }
}

// Transactions: begun and ended by the door alone.

impl Connection {
    pub fn is_in_transaction(&self) -> bool {
        match &self.0 {
            Engine::Sqlite(file) => !file.is_autocommit(),
            Engine::Postgres(client) => client.is_in_transaction(),
        }
    }

    /// Rows changed since the connection was opened.
    pub fn total_changes(&self) -> u64 {
        match &self.0 {
            Engine::Sqlite(file) => file.total_changes(),
            Engine::Postgres(client) => client.total_changes(),
        }
    }

    pub fn begin(&self) -> Result<()> {
        self.control("BEGIN IMMEDIATE", Client::begin)
    }

    /// Work of which a failure leaves what was done before it.
    pub fn begin_part(&self) -> Result<()> {
        self.control("SAVEPOINT job", Client::begin_part)
    }

    pub fn end_part(&self) -> Result<()> {
        self.control("RELEASE job", Client::end_part)
    }

    pub fn undo_part(&self) -> Result<()> {
        self.control("ROLLBACK TO job", Client::undo_part)?;
        // The server's was released with it.
        self.control("RELEASE job", |_| Ok(()))
    }

    pub fn undo(&self) -> Result<()> {
        self.control("ROLLBACK", Client::undo)
    }

    /// Returns when what was done is durable. [`Kind::Unknown`] if nobody knows.
    pub fn commit(&self) -> Result<()> {
        self.control("COMMIT", Client::commit)
    }

    /// All queries until its end see the same moment.
    pub fn begin_snapshot(&self) -> Result<()> {
        self.control("BEGIN", Client::begin_snapshot)
    }

    pub fn end_snapshot(&self) -> Result<()> {
        self.undo()
    }

    fn control(&self, sql: &str, on_server: impl FnOnce(&Client) -> Result<()>) -> Result<()> {
        match &self.0 {
            Engine::Sqlite(_) => self.changed(sql, []).map(drop),
            Engine::Postgres(client) => on_server(client),
        }
    }

    /// The conflict or broken connection by which the transaction failed: the same work may succeed in another one.
    pub fn trouble(&self) -> Option<Kind> {
        self.server().and_then(Client::trouble)
    }

    pub fn close(self) -> Result<()> {
        match self.0 {
            Engine::Sqlite(file) => file.close().map_err(|(_, error)| error.into()),
            Engine::Postgres(_) => Ok(()),
        }
    }
}
