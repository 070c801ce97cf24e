//! What a server says that decides what an acknowledgement is worth there.

use super::{Inspection, unsigned};
use crate::StoreError;
use crate::sql::Connection;
use crate::sql::postgres::{apart, milliseconds};

/// As the server says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Durability {
    /// Of PostgreSQL.
    pub version: String,
    /// `synchronous_commit` of this user; what this program acknowledges is committed with `on`.
    pub commits: String,
    /// `synchronous_standby_names`; empty = a commit waits for none.
    pub standbys: String,
    pub fsync: bool,
    /// It takes no writes.
    pub is_standby: bool,
    /// Synchronous standbys that are connected now; `None` if this user may not see them.
    pub connected: Option<u64>,
    /// Milliseconds that the server's clock is ahead of this machine's.
    pub ahead: i64,
}

impl Durability {
    /// `1 h ahead of`, if the server's clock and this machine's differ too much to open the store.
    pub fn clocks_apart(&self) -> Option<String> {
        apart(self.ahead)
    }
}

impl Inspection {
    /// `None` for a file, where an acknowledgement is an fsync.
    pub fn durability(&self) -> Result<Option<Durability>, StoreError> {
        self.0.read(of)
    }
}

pub(super) fn of(connection: &Connection) -> Result<Option<Durability>, StoreError> {
    if connection.file().is_some() {
        return Ok(None);
    }
    let setting = |name: &str| format!("current_setting('{name}')");
    let [version, commits, standbys, fsync] =
        ["server_version", "synchronous_commit", "synchronous_standby_names", "fsync"].map(setting);
    let sql = format!(
        "SELECT {version}, {commits}, {standbys}, {fsync} = 'on', pg_is_in_recovery(),
            CASE WHEN pg_has_role(current_user, 'pg_read_all_stats', 'USAGE') THEN
                (SELECT count(*) FROM pg_stat_replication WHERE sync_state IN ('sync', 'quorum')) END,
            (extract(epoch FROM clock_timestamp()) * 1000)::BIGINT"
    );
    let found = connection.one(&sql, [], |row| {
        let (version, commits, standbys) = (row.get(0)?, row.get(1)?, row.get(2)?);
        let (fsync, is_standby) = (row.get(3)?, row.get(4)?);
        let connected = row.get::<Option<i64>>(5)?.map(|_| unsigned(row, 5)).transpose()?;
        let ahead = row.get::<i64>(6)? - milliseconds();
        Ok(Durability { version, commits, standbys, fsync, is_standby, connected, ahead })
    });
    Ok(Some(found?))
}
