//! Pages over many streams at once, read from the index of capture times: when most records match, a few rows tell as
//! much as a look into each of thousands of streams. When few match, `query` merges the streams instead.

use std::collections::HashSet;

use rusqlite::{Connection, params};

use super::query::{Key, Range};
use crate::store::StoreError;

/// With fewer streams than this, a merge is as fast.
pub(super) const MANY: usize = 24;
/// The most rows examined for each row wanted.
const PATIENCE: usize = 8;

/// The first `wanted` keys of these streams within a range; nothing if the streams are few, or their records so rare
/// that the rows examined did not contain enough of them.
pub(super) fn keys(
    connection: &Connection,
    streams: &[i64],
    range: Range,
    wanted: usize,
) -> Result<Option<Vec<Key>>, StoreError> {
    if streams.len() < MANY {
        return Ok(None);
    }
    let streams: HashSet<i64> = streams.iter().copied().collect();
    let most = wanted.saturating_mul(PATIENCE);
    let order = if range.newest_first { "DESC" } else { "ASC" };
    let mut statement = connection.prepare_cached(&format!(
        "SELECT captured_at, n, stream FROM records
         WHERE (captured_at, n) > (?1, ?2) AND (captured_at, n) < (?3, ?4)
         ORDER BY captured_at {order}, n {order} LIMIT ?5"
    ))?;
    let (low, high, limit) = (range.low, range.high, i64::try_from(most).unwrap_or(i64::MAX));
    let mut rows = statement.query(params![low.captured_at, low.n, high.captured_at, high.n, limit])?;
    let (mut keys, mut seen) = (Vec::with_capacity(wanted), 0);
    while let Some(row) = rows.next()? {
        seen += 1;
        if streams.contains(&row.get(2)?) {
            keys.push(Key { captured_at: row.get(0)?, n: row.get(1)? });
            if keys.len() == wanted {
                return Ok(Some(keys));
            }
        }
    }
    Ok((seen < most).then_some(keys))
}
