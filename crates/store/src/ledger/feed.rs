//! The feed: what readers may be given, in the order in which it came to be so. Rows are written by triggers, in the very
//! commit that verifies or erases a record; here they are read.

use std::collections::HashMap;

use rusqlite::{Connection, params};

use super::batches::placed_in;
use super::rows::{out_of_range, unsigned};
use super::{Feed, PlacedRecord};
use crate::StoreError;
use crate::database::Statements as _;
use crate::model::{Address, Digest, Fact, RecordKind, RecorderId, TopicId};

/// The most rows looked at for one page: a filter that fits few of them must not hold the ledger for long.
const MOST_LOOKED_AT: i64 = 20_000;

/// An owner whose records are wanted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FeedPlace {
    pub owner: Address,
    /// Rows up to this number are not wanted.
    pub after: u64,
    /// Only of these topics.
    pub topics: Option<Vec<TopicId>>,
}

/// Which rows are wanted: of any of these owners, and with all of the other conditions.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct FeedFilter {
    /// The owners, each with its place.
    pub places: Vec<FeedPlace>,
    /// Of one kind only.
    pub kind: Option<RecordKind>,
    /// Numbered by one of these; empty for any.
    pub recorders: Vec<RecorderId>,
}

/// A row with its record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FeedRow {
    pub number: u64,
    pub fact: Fact,
    /// The record, with its place in its batch.
    pub placed: PlacedRecord,
}

/// A page of the feed, as of one moment.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct FeedPage {
    /// Random, made by every process that gives numbers and by every restore of the file: places belong to it.
    pub id: [u8; 16],
    /// Whether the places asked from are not of this feed, or beyond its end: all of them count as its beginning.
    pub is_anew: bool,
    /// The highest number given so far.
    pub head: u64,
    /// Every wanted row up to this number is on this page or before it.
    pub upto: u64,
    /// The rows, by number.
    pub rows: Vec<FeedRow>,
}

impl Feed {
    /// The next rows, at most `limit`, after places that were told under `id`.
    pub fn page(&self, id: &[u8; 16], filter: &FeedFilter, limit: usize) -> Result<FeedPage, StoreError> {
        self.0.read(|connection| page(connection, id, filter, limit))
    }
}

/// How many ids of a feed are known: who has an older one reads it anew.
const MOST_IDS: i64 = 4096;

/// The feed has another id from now on. A copy of this file that goes back behind `after`, and is used from there, gives the numbers
/// after it once more.
pub(super) fn begin(connection: &Connection, after: i64) -> Result<(), StoreError> {
    connection.run("INSERT INTO feeds (id, after) VALUES (randomblob(16), ?1)", [after])?;
    connection.run("DELETE FROM feeds WHERE key <= (SELECT max(key) FROM feeds) - ?1", [MOST_IDS])?;
    Ok(())
}

/// An owner's notice was stored: a row for it.
pub(super) fn note(connection: &Connection, record: i64, topic: i64) -> Result<(), StoreError> {
    connection.run("UPDATE about SET head = head + 1", [])?;
    let sql = "INSERT INTO feed SELECT head, ?1, ?2, ?3 FROM about";
    connection.run(sql, params![record, topic, Fact::Stored.code()])?;
    Ok(())
}

fn page(connection: &Connection, id: &[u8; 16], filter: &FeedFilter, limit: usize) -> Result<FeedPage, StoreError> {
    let sql = "SELECT id, head FROM feeds, about ORDER BY key DESC LIMIT 1";
    let (own, head): ([u8; 16], u64) = connection.one(sql, [], |row| Ok((row.get(0)?, unsigned(row, 1)?)))?;
    // The last number that was given under the id.
    let sql = "SELECT coalesce((SELECT min(later.after) FROM feeds later WHERE later.key > feeds.key), head)
             FROM feeds, about WHERE id = ?1";
    let last: Option<u64> = connection.find(sql, [id], |row| unsigned(row, 0))?;
    let is_anew = last.is_none_or(|last| filter.places.iter().any(|wanted| wanted.after > last));
    let place = |after: u64| if is_anew { 0 } else { after };
    let topics = topics(connection, filter, place)?;
    let first = filter.places.iter().map(|wanted| place(wanted.after)).min().unwrap_or(head);
    let mut found = Found { upto: first, rows: Vec::new() };
    let looked_at = found.look(connection, &topics, limit)?;
    if looked_at < MOST_LOOKED_AT && found.rows.len() < limit {
        found.upto = head;
    }
    Ok(FeedPage { id: own, is_anew, head, upto: found.upto, rows: filled(connection, found.rows, filter.kind)? })
}

/// Rows before their records are read: number, fact and record.
struct Found {
    upto: u64,
    rows: Vec<(u64, Fact, i64)>,
}

impl Found {
    /// Reads on; returns how many rows were looked at.
    fn look(&mut self, connection: &Connection, topics: &HashMap<i64, u64>, limit: usize) -> Result<i64, StoreError> {
        let mut statement = connection.prepare_cached(
            "SELECT number, record, topic, fact FROM feed WHERE number > ?1 ORDER BY number LIMIT ?2",
        )?;
        let mut rows = statement.query(params![self.upto.cast_signed(), MOST_LOOKED_AT])?;
        let mut looked_at = 0;
        while self.rows.len() < limit
            && let Some(row) = rows.next()?
        {
            (self.upto, looked_at) = (unsigned(row, 0)?, looked_at + 1);
            if topics.get(&row.get(2)?).is_some_and(|after| self.upto > *after) {
                let fact = Fact::from_code(row.get(3)?).ok_or_else(|| out_of_range(3))?;
                self.rows.push((self.upto, fact, row.get(1)?));
            }
        }
        Ok(looked_at)
    }
}

/// The topics whose rows are wanted, by their keys, each with the number after which.
fn topics(
    connection: &Connection,
    filter: &FeedFilter,
    place: impl Fn(u64) -> u64,
) -> Result<HashMap<i64, u64>, StoreError> {
    let mut statement = connection.prepare_cached(
        "SELECT t.key, t.topic_id, r.id FROM topics t JOIN recorders r ON r.key = t.recorder WHERE t.owner = ?1",
    )?;
    let mut found = HashMap::new();
    for FeedPlace { owner, after, topics } in &filter.places {
        let mut rows = statement.query([owner.0])?;
        while let Some(row) = rows.next()? {
            let (topic, recorder) = (TopicId(row.get(1)?), RecorderId(row.get(2)?));
            let is_wanted = topics.as_ref().is_none_or(|topics| topics.contains(&topic))
                && (filter.recorders.is_empty() || filter.recorders.contains(&recorder));
            if is_wanted {
                found.insert(row.get(0)?, place(*after));
            }
        }
    }
    Ok(found)
}

fn filled(
    connection: &Connection,
    found: Vec<(u64, Fact, i64)>,
    kind: Option<RecordKind>,
) -> Result<Vec<FeedRow>, StoreError> {
    let mut digest = connection.prepare_cached("SELECT digest FROM records WHERE n = ?1")?;
    let digests: Vec<Digest> = found
        .iter()
        .map(|(_, _, record)| digest.query_row([record], |row| row.get(0).map(Digest)))
        .collect::<Result<_, _>>()?;
    let placed = placed_in(connection, &digests)?;
    let rows = found.into_iter().zip(placed).filter_map(|((number, fact, _), placed)| {
        let placed = placed.filter(|placed| kind.is_none_or(|kind| placed.row.kind == kind))?;
        Some(FeedRow { number, fact, placed })
    });
    Ok(rows.collect())
}
