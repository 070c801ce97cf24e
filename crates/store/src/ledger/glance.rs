//! A glance at a ledger that may be in use or not: read only, nothing written beside it, and no patience. For shell
//! completion; any problem is for the next command to report.

use std::path::Path;
use std::time::Duration;

use rusqlite::{Connection, OpenFlags, OptionalExtension as _, params};

use super::rows::{self, Which};
use crate::store::StoreError;

/// How long a lock is waited for.
const BUSY: Duration = Duration::from_millis(100);
/// Characters of a record's id.
const ID_LENGTH: usize = 16;

/// A ledger to read a few names from.
#[derive(Debug)]
pub struct Glance(Connection);

impl Glance {
    /// Opens the existing file; none is created.
    ///
    /// # Errors
    /// [`StoreError::Database`] and its kin.
    pub fn at(path: &Path) -> Result<Self, StoreError> {
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX | OpenFlags::SQLITE_OPEN_URI;
        // Without a log nobody has it open, and SQLite would create one to read it.
        let mut log = path.as_os_str().to_owned();
        log.push("-wal");
        let rest = if Path::new(&log).exists() { "" } else { "?immutable=1" };
        let uri = format!("file:{}{rest}", escaped(path));
        Connection::open_with_flags(uri, flags)
            .and_then(|connection| {
                connection.busy_timeout(BUSY)?;
                Ok(Self(connection))
            })
            .map_err(|error| StoreError::from(error).in_file(path))
    }

    /// Names of topics with this prefix, in order, at most `limit`; they are foreign text, so clean them.
    ///
    /// # Errors
    /// [`StoreError::Database`] and its kin.
    pub fn topics(&self, begun: &str, limit: usize) -> Result<Vec<String>, StoreError> {
        let mut names: Vec<String> = rows::streams(&self.0, &Which::All)?
            .into_iter()
            .map(|stream| stream.topic)
            .filter(|name| name.starts_with('/') && name.starts_with(begun))
            .collect();
        names.sort();
        names.dedup();
        names.truncate(limit);
        Ok(names)
    }

    /// Ids of records with this prefix, at most `limit`: the newest if the prefix is empty.
    ///
    /// # Errors
    /// [`StoreError::Database`] and its kin.
    pub fn ids(&self, begun: &str, limit: usize) -> Result<Vec<String>, StoreError> {
        let whole = 2 * crate::model::Digest::LENGTH;
        if begun.len() > whole || !begun.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return Ok(Vec::new());
        }
        let fill = |digit: &str| format!("{}{}", begun.to_ascii_lowercase(), digit.repeat(whole - begun.len()));
        let limit = i64::try_from(limit).unwrap_or(i64::MAX);
        let order = if begun.is_empty() { "n DESC" } else { "digest" };
        let sql = format!(
            "SELECT lower(hex(digest)) FROM records WHERE digest BETWEEN unhex(?1) AND unhex(?2) ORDER BY {order} LIMIT ?3"
        );
        let mut statement = self.0.prepare(&sql)?;
        let found = statement.query_map(params![fill("0"), fill("f"), limit], |row| row.get::<_, String>(0))?;
        let ids: Result<Vec<String>, _> = found.collect();
        // Text beyond an id's length stays as typed.
        let length = ID_LENGTH.max(begun.len());
        Ok(ids?.into_iter().map(|digest| digest.chars().take(length).collect()).collect())
    }

    /// The value under a key of the settings.
    ///
    /// # Errors
    /// [`StoreError::Database`] and its kin.
    pub fn setting(&self, key: &str) -> Result<Option<String>, StoreError> {
        let sql = "SELECT value FROM settings WHERE key = ?1";
        Ok(self.0.query_row(sql, [key], |row| row.get(0)).optional()?)
    }
}

/// A path in the form of a URI.
fn escaped(path: &Path) -> String {
    use std::fmt::Write as _;
    use std::os::unix::ffi::OsStrExt as _;
    let mut text = String::new();
    for byte in path.as_os_str().as_bytes() {
        if byte.is_ascii_alphanumeric() || b"/-_.".contains(byte) {
            text.push(char::from(*byte));
        } else {
            // Writing to a string cannot fail.
            let _ = write!(text, "%{byte:02X}");
        }
    }
    text
}
