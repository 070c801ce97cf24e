//! The version of the embedded chain's file: an older program refuses a newer file before it touches it.

use std::path::Path;

use rusqlite::Connection;
use rusqlite::config::DbConfig;

use crate::chain::ChainError;

/// A chain of one signer with the usual period, as every chain was at first.
pub const PLAIN: i64 = 1;
/// A chain that says its consensus.
pub const CHOSEN: i64 = 2;
/// One whose state lies in it as tries, at least since a certain block.
pub const TRIES: i64 = 3;

/// Refuses a file of a later version; whoever closes the connection leaves it as it is. A file without a version, or of
/// an earlier one, passes, and so does what cannot be read: whoever opens it says why.
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

/// Has a log that waits stay beside the file when this connection is closed, instead of being worked in.
pub fn leave_log(connection: &Connection, path: &Path) {
    let waits = std::fs::metadata(path.with_extension("db-wal")).is_ok_and(|log| log.len() > 0);
    // Where it cannot be said, the log is worked in, which loses nothing.
    drop(connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, waits));
}
