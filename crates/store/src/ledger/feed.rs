//! The feed: what readers may have, in order. Triggers write it in the commit that verifies or erases a record.

use std::collections::HashMap;
use std::path::PathBuf;

use super::batches::placed_in;
use super::rows::{out_of_range, unsigned};
use super::{Feed, PlacedRecord};
use crate::StoreError;
use crate::model::{Address, Digest, Fact, RecordKind, RecorderId, TopicId};
use crate::sql::{Connection, params};

/// Rows read for a page, so that a narrow filter does not hold the ledger for long.
const MOST_LOOKED_AT: i64 = 20_000;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FeedPlace {
    pub owner: Address,
    /// Rows up to this number are not wanted.
    pub after: u64,
    pub topics: Option<Vec<TopicId>>,
}

/// Of any of these owners, with all other conditions.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct FeedFilter {
    pub places: Vec<FeedPlace>,
    pub kind: Option<RecordKind>,
    /// Whose numbers; empty = any.
    pub recorders: Vec<RecorderId>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FeedRow {
    pub number: u64,
    pub fact: Fact,
    pub placed: PlacedRecord,
}

/// As of one moment.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct FeedPage {
    /// Random for every process that numbers, every lease and every restore: places belong to it.
    pub id: [u8; 16],
    /// The places are of another feed, or beyond its end: the page starts at the beginning.
    pub is_anew: bool,
    /// The highest number so far.
    pub head: u64,
    /// Every wanted row up to this number is on this page or before it.
    pub upto: u64,
    pub rows: Vec<FeedRow>,
}

impl Feed {
    pub fn head(&self) -> Result<u64, StoreError> {
        self.0.one("SELECT head FROM about", [], |row| unsigned(row, 0))
    }

    /// Numbers what other processes left for the holder of the lease, which any of its changes does.
    pub fn number_waiting(&self) -> Result<(), StoreError> {
        match self.has_unnumbered()? {
            true => self.0.held().write(|_| Ok(())),
            false => Ok(()),
        }
    }

    pub(super) fn has_unnumbered(&self) -> Result<bool, StoreError> {
        self.0.read(|connection| match connection.server() {
            Some(_) => Ok(connection.has("SELECT 1 FROM unnumbered LIMIT 1", [])?),
            None => Ok(false),
        })
    }

    /// After places of the feed `id`.
    pub fn page(&self, id: &[u8; 16], filter: &FeedFilter, limit: usize) -> Result<FeedPage, StoreError> {
        self.0.read(|connection| page(connection, id, filter, limit))
    }
}

/// Ids known of a feed; places of older ones start over.
const MOST_IDS: i64 = 4096;

/// Gives the feed a new id: a copy of the file that falls behind `after` would give the same numbers again.
pub(super) fn begin(connection: &Connection, after: i64) -> Result<(), StoreError> {
    let mut id = [0_u8; 16];
    getrandom::fill(&mut id)
        .map_err(|error| StoreError::Database { file: PathBuf::new(), detail: error.to_string() })?;
    connection.run("INSERT INTO feeds (id, after) VALUES (?1, ?2)", params![id, after])?;
    connection.run("DELETE FROM feeds WHERE key <= (SELECT max(key) FROM feeds) - ?1", [MOST_IDS])
}

/// Adds an owner's notice. On a server the holder of the lease numbers it.
pub(super) fn note(connection: &Connection, record: i64, topic: i64) -> Result<(), StoreError> {
    if connection.server().is_some() {
        return connection.run("INSERT INTO unnumbered (record) VALUES (?1)", [record]);
    }
    connection.run("UPDATE about SET head = head + 1", [])?;
    let sql = "INSERT INTO feed SELECT head, ?1, ?2, ?3 FROM about";
    connection.run(sql, params![record, topic, Fact::Stored.code()])
}

fn page(connection: &Connection, id: &[u8; 16], filter: &FeedFilter, limit: usize) -> Result<FeedPage, StoreError> {
    let sql = "SELECT id, head FROM feeds, about ORDER BY key DESC LIMIT 1";
    let (own, head): ([u8; 16], u64) = connection.one(sql, [], |row| Ok((row.get(0)?, unsigned(row, 1)?)))?;
    // The last number under the id.
    let sql = "SELECT coalesce((SELECT min(later.after) FROM feeds later WHERE later.key > feeds.key), head)
             FROM feeds, about WHERE id = ?1";
    let last: Option<u64> = connection.find(sql, [id], |row| unsigned(row, 0))?;
    let is_anew = last.is_none_or(|last| filter.places.iter().any(|wanted| wanted.after > last));
    let place = |after: u64| if is_anew { 0 } else { after };
    let topics = topics(connection, filter, place)?;
    let first = filter.places.iter().map(|wanted| place(wanted.after)).min().unwrap_or(head);
    let (mut upto, mut found, mut looked_at) = (first, Vec::new(), 0);
    let sql = "SELECT number, record, topic, fact FROM feed WHERE number > ?1 ORDER BY number LIMIT ?2";
    let values = params![first.cast_signed(), if limit > 0 { MOST_LOOKED_AT } else { 0 }];
    connection.prepared(sql)?.each_while(values, |row| {
        (upto, looked_at) = (unsigned(row, 0)?, looked_at + 1);
        if topics.get(&row.get(2)?).is_some_and(|after| upto > *after) {
            let fact = Fact::from_code(row.get(3)?).ok_or_else(|| out_of_range(3))?;
            found.push((upto, fact, row.get(1)?));
        }
        Ok::<_, StoreError>(found.len() < limit)
    })?;
    if looked_at < MOST_LOOKED_AT && found.len() < limit {
        upto = head;
    }
    Ok(FeedPage { id: own, is_anew, head, upto, rows: filled(connection, found, filter.kind)? })
}

/// Wanted topics by key, each with the number to start after.
fn topics(
    connection: &Connection,
    filter: &FeedFilter,
    place: impl Fn(u64) -> u64,
) -> Result<HashMap<i64, u64>, StoreError> {
    let sql = "SELECT t.key, t.topic_id, r.id FROM topics t JOIN recorders r ON r.key = t.recorder WHERE t.owner = ?1";
    let mut found = HashMap::new();
    for FeedPlace { owner, after, topics } in &filter.places {
        connection.each(sql, [owner.0], |row| {
            let (topic, recorder) = (TopicId(row.get(1)?), RecorderId(row.get(2)?));
            let is_wanted = topics.as_ref().is_none_or(|topics| topics.contains(&topic))
                && (filter.recorders.is_empty() || filter.recorders.contains(&recorder));
            if is_wanted {
                found.insert(row.get(0)?, place(*after));
            }
            Ok(())
        })?;
    }
    Ok(found)
}

fn filled(
    connection: &Connection,
    found: Vec<(u64, Fact, i64)>,
    kind: Option<RecordKind>,
) -> Result<Vec<FeedRow>, StoreError> {
    let mut digest = connection.prepared("SELECT digest FROM records WHERE n = ?1")?;
    let digests = found.iter().map(|(_, _, record)| digest.one([record], |row| row.get(0).map(Digest)));
    let placed = placed_in(connection, &digests.collect::<Result<Vec<_>, _>>()?)?;
    let rows = found.into_iter().zip(placed).filter_map(|((number, fact, _), placed)| {
        let placed = placed.filter(|placed| kind.is_none_or(|kind| placed.row.kind == kind))?;
        Some(FeedRow { number, fact, placed })
    });
    Ok(rows.collect())
}
