//! Finding one record by its digest or a prefix of it.

use std::collections::HashMap;

use rusqlite::{Connection, params};

use super::Ledger;
use super::rows::{self, RecordRow};
use crate::model::{Digest, clean};
use crate::store::StoreError;

impl Ledger {
    /// The record with this digest.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn record(&self, digest: Digest) -> Result<Option<RecordRow>, StoreError> {
        Ok(self.records(&[digest])?.pop().flatten())
    }

    /// The records with these digests, in this order, as of one moment.
    ///
    /// # Errors
    /// [`StoreError::Database`] and the like.
    pub fn records(&self, digests: &[Digest]) -> Result<Vec<Option<RecordRow>>, StoreError> {
        self.read(|connection| rows_of(connection, digests))
    }

    /// The record whose digest begins with `id` (4 to 64 hex characters).
    ///
    /// # Errors
    /// [`StoreError::Id`] if `id` is malformed, [`StoreError::Ambiguous`] if several records match.
    pub fn record_by_id(&self, id: &str) -> Result<Option<RecordRow>, StoreError> {
        let (low, high) = bounds(id).ok_or_else(|| StoreError::Id(clean(id, 70)))?;
        self.read(|connection| {
            let found: Vec<i64> = connection
                .prepare_cached("SELECT stream FROM records WHERE digest BETWEEN ?1 AND ?2 LIMIT 2")?
                .query_map(params![low.0, high.0], |row| row.get(0))?
                .collect::<Result<_, _>>()?;
            let by_key = rows::keyed_streams(connection, found)?;
            let sql = format!("SELECT {} FROM records WHERE digest BETWEEN ?1 AND ?2 LIMIT 2", rows::COLUMNS);
            let mut found = connection
                .prepare_cached(&sql)?
                .query_map(params![low.0, high.0], |row| rows::record(row, &by_key))?
                .collect::<Result<Vec<_>, _>>()?;
            if found.len() > 1 { Err(StoreError::Ambiguous(id.to_owned())) } else { Ok(found.pop()) }
        })
    }
}

/// The records with these digests, in this order.
pub(super) fn rows_of(connection: &Connection, digests: &[Digest]) -> Result<Vec<Option<RecordRow>>, StoreError> {
    let mut find = connection.prepare_cached(&format!("SELECT {} FROM records WHERE digest = ?1", rows::COLUMNS))?;
    let mut by_key = HashMap::new();
    let one = |digest: &Digest| {
        let mut found = find.query(params![digest.0])?;
        let Some(row) = found.next()? else { return Ok(None) };
        rows::learn_stream(connection, row, &mut by_key)?;
        Ok(Some(rows::record(row, &by_key)?))
    };
    digests.iter().map(one).collect()
}

/// The fewest characters that may name a record.
const SHORTEST_ID: usize = 4;

/// The lowest and highest digest that begin with `id`.
fn bounds(id: &str) -> Option<(Digest, Digest)> {
    let whole = Digest::LENGTH * 2;
    let valid = (SHORTEST_ID..=whole).contains(&id.len()) && id.bytes().all(|b| b.is_ascii_hexdigit());
    let fill = |digit: &str| format!("{id}{}", digit.repeat(whole - id.len())).parse().ok();
    if valid { fill("0").zip(fill("f")) } else { None }
}
