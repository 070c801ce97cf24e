//! The version of the embedded chain's file: an older program refuses a newer file before it touches it.

use std::path::Path;

use rusqlite::Connection;
use rusqlite::config::DbConfig;

use crate::chain::ChainError;

/// A chain of one signer with the usual period, as every chain was at first.
pub const PLAIN: i64 = 1;
/// A chain that states its consensus.
pub const CHOSEN: i64 = 2;
/// One whose state is stored as tries, at least since a certain block.
pub const TRIES: i64 = 3;

/// Refuses a file of a later version, and leaves it as it is when the connection is closed. A file without a version,
/// or of an earlier one, passes, and so does an unreadable one: opening it reports why.
///
/// # Errors
/// [`ChainError::Newer`].
pub fn check(connection: &Connection, path: &Path) -> Result<(), ChainError> {
    let version: rusqlite::Result<i64> = connection.query_row("SELECT version FROM chain", [], |row| row.get(0));
    match version {
        Ok(found) if found > TRIES => {
            leave_log(connection, path);
            Err(ChainError::Newer { path: path.to_owned(), found, known: TRIES })
        }
        _ => Ok(()),
    }
}

/// Makes a waiting log stay beside the file when this connection is closed, instead of being merged into it.
pub fn leave_log(connection: &Connection, path: &Path) {
    let waits = std::fs::metadata(path.with_extension("db-wal")).is_ok_and(|log| log.len() > 0);
    // If that is not supported, the log is merged, which loses nothing.
    drop(connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, waits));
}
