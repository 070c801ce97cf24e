//! Records page by page in the order of capture. Each stream's records of each state are read in order from an index,
//! and these lanes are merged: a page costs the same whatever the ledger's size.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap, HashMap, HashSet, VecDeque};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::directory;
use super::durability::{self, Durability};
use super::rows::{self, RecordRow, Stream, Which, time, unsigned};
use super::{Counts, LeaseState, Losses, Records, SCHEMA};
use crate::StoreError;
use crate::database::{self, capped, whole};
use crate::model::{
    Address, FilterId, RecordKind, RecordState, RecorderId, SignerId, Timestamp, TopicId, TopicPatterns, clean,
};
use crate::notes::{self, Note};
use crate::sql::postgres::{Server, Watermark};
use crate::sql::{Connection, Row, Statement, Value, params};

const LARGEST_PAGE: usize = 10_000;
const USUAL_PAGE: usize = 100;

/// One filter id for all topics, or another for some.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FilterChoice {
    pub id: FilterId,
    pub by_topic: BTreeMap<TopicId, FilterId>,
}

impl FilterChoice {
    /// Both ids that records of a topic may have.
    fn of(&self, topic: TopicId) -> [FilterId; 2] {
        [self.id, self.by_topic.get(&topic).copied().unwrap_or(self.id)]
    }

    pub fn is_in(&self, topic: TopicId, ids: &[FilterId]) -> bool {
        self.of(topic).iter().any(|id| ids.contains(id))
    }
}

impl From<FilterId> for FilterChoice {
    fn from(id: FilterId) -> Self {
        Self { id, by_topic: BTreeMap::new() }
    }
}

/// All conditions must hold.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RecordQuery {
    pub owner: Option<Address>,
    pub owners: Option<Vec<Address>>,
    pub topic: Option<String>,
    /// The topic's name matches one pattern of each.
    pub topics: Vec<TopicPatterns>,
    pub topic_ids: Option<Vec<TopicId>>,
    pub recorder: Option<RecorderId>,
    /// `None` = any.
    pub signers: Option<BTreeSet<SignerId>>,
    /// One id of each choice.
    pub filters: Vec<FilterChoice>,
    pub type_name: Option<String>,
    /// Each is part of the topic's or the type's name, ignoring case.
    pub words: Vec<String>,
    pub kind: Option<RecordKind>,
    pub state: Option<RecordState>,
    pub since: Option<Timestamp>,
    pub until: Option<Timestamp>,
    /// A page's `next`.
    pub after: Option<String>,
    /// 1 to 10,000; 0 = 100.
    pub limit: usize,
    pub newest_first: bool,
}

impl RecordQuery {
    fn wants(&self, stream: &Stream) -> bool {
        let names = [&stream.topic, &stream.type_name];
        let says = |word: &str| names.iter().any(|name| name.to_lowercase().contains(word));
        self.owner.is_none_or(|owner| owner == stream.owner)
            && self.owners.as_ref().is_none_or(|owners| owners.contains(&stream.owner))
            && self.topic.as_ref().is_none_or(|topic| *topic == stream.topic)
            && self.topics.iter().all(|patterns| patterns.matches(&stream.topic))
            && self.signers.as_ref().is_none_or(|signers| signers.contains(&stream.signer))
            && self.topic_ids.as_ref().is_none_or(|ids| ids.contains(&stream.topic_id))
            && self.recorder.is_none_or(|recorder| recorder == stream.recorder)
            && self.type_name.as_ref().is_none_or(|name| *name == stream.type_name)
            && self.kind.is_none_or(|kind| kind == stream.kind)
            && self.words.iter().all(|word| says(&word.to_lowercase()))
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct RecordPage {
    pub rows: Vec<RecordRow>,
    /// `None` on the last page.
    pub next: Option<String>,
}

impl Records {
    /// By capture time, then acknowledgement. Without a state the counters say which states a topic's records are in.
    pub fn list(&self, query: &RecordQuery) -> Result<RecordPage, StoreError> {
        let limit = if query.limit == 0 { USUAL_PAGE } else { query.limit.min(LARGEST_PAGE) };
        let range = Range::of(query)?;
        self.0.read(|connection| {
            let mut streams = candidates(connection, query)?;
            streams.retain(|stream| query.wants(stream));
            let mut wanted: Vec<&Stream> = streams.iter().collect();
            narrow(connection, &mut wanted, &query.filters)?;
            let topics: HashMap<i64, TopicId> = wanted.iter().map(|stream| (stream.key, stream.topic_id)).collect();
            let wanted: Vec<i64> = wanted.iter().map(|stream| stream.key).collect();
            let plain = query.state.is_none() && query.filters.is_empty();
            let recent = if plain { keys(connection, &wanted, range, limit + 1)? } else { None };
            let mut keys = match recent {
                Some(keys) => keys,
                None => Merge::new(connection, (&wanted, &topics), query, range, limit + 1)?.take(limit + 1)?,
            };
            let more = keys.len() > limit;
            keys.truncate(limit);
            let next = keys.last().filter(|_| more).map(|key| key.cursor());
            Ok(RecordPage { rows: fetch(connection, &keys, streams)?, next })
        })
    }

    /// Every page's records; nothing follows a failure.
    pub fn all(&self, query: RecordQuery) -> impl Iterator<Item = Result<RecordRow, StoreError>> {
        let mut query = Some(query);
        let pages = std::iter::from_fn(move || {
            let asked = query.take()?;
            let (rows, failed) = match self.list(&asked) {
                Ok(RecordPage { rows, next }) => {
                    query = next.map(|next| RecordQuery { after: Some(next), ..asked });
                    (rows, None)
                }
                Err(error) => (Vec::new(), Some(Err(error))),
            };
            Some(rows.into_iter().map(Ok).chain(failed))
        });
        pages.flatten()
    }

    /// By capture.
    pub fn in_state(
        &self,
        owner: Option<Address>,
        state: RecordState,
        limit: usize,
    ) -> Result<Vec<RecordRow>, StoreError> {
        let query = RecordQuery { owner, state: Some(state), limit, ..RecordQuery::default() };
        Ok(self.list(&query)?.rows)
    }
}

/// No more than the owner has, or than have records in the state.
fn candidates(connection: &Connection, query: &RecordQuery) -> Result<Vec<Stream>, StoreError> {
    match (query.owner, &query.owners, query.state) {
        (Some(owner), ..) => rows::streams(connection, &Which::Of(owner)),
        (None, Some(owners), _) => {
            let mut found = Vec::new();
            for owner in owners.iter().collect::<BTreeSet<_>>() {
                found.extend(rows::streams(connection, &Which::Of(*owner))?);
            }
            found.sort_by_key(|stream| stream.key);
            Ok(found)
        }
        (None, None, Some(state)) => {
            // Steps from stream to stream along the index; a DISTINCT would read every entry.
            let sql = "WITH RECURSIVE found (stream) AS (
                    SELECT min(stream) FROM records INDEXED BY records_by_state WHERE state = ?1
                    UNION ALL
                    SELECT (SELECT min(r.stream) FROM records r INDEXED BY records_by_state
                            WHERE r.state = ?1 AND r.stream > found.stream)
                    FROM found WHERE found.stream IS NOT NULL)
                SELECT stream FROM found WHERE stream IS NOT NULL";
            let keys: Vec<i64> = connection.list(sql, [state.code()], |row| row.get(0))?;
            let mut found: Vec<Stream> = rows::keyed_streams(connection, keys)?.into_values().collect();
            found.sort_by_key(|stream| stream.key);
            Ok(found)
        }
        (None, None, None) => rows::streams(connection, &Which::All),
    }
}

fn fetch(connection: &Connection, keys: &[Key], streams: Vec<Stream>) -> Result<Vec<RecordRow>, StoreError> {
    let by_key = rows::by_key(streams);
    let sql = format!("SELECT {} FROM records WHERE n = ?1", rows::COLUMNS);
    let mut statement = connection.prepared(&sql)?;
    keys.iter().map(|key| Ok(statement.one([key.n], |row| rows::record(row, &by_key))?)).collect()
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Key {
    pub captured_at: i64,
    pub n: i64,
}

impl Key {
    fn cursor(self) -> String {
        format!("{:016x}{:016x}", self.captured_at, self.n)
    }

    fn parse(cursor: &str) -> Option<Self> {
        let valid = cursor.len() == 32 && cursor.bytes().all(|b| b.is_ascii_hexdigit());
        let (time, n) = cursor.split_at_checked(16).filter(|_| valid)?;
        Some(Self { captured_at: i64::from_str_radix(time, 16).ok()?, n: i64::from_str_radix(n, 16).ok()? })
    }
}

/// Keys strictly between two others.
#[derive(Debug, Clone, Copy)]
pub(super) struct Range {
    pub low: Key,
    pub high: Key,
    pub newest_first: bool,
}

impl Range {
    fn of(query: &RecordQuery) -> Result<Self, StoreError> {
        let end = Key { captured_at: i64::MAX, n: i64::MAX };
        let at = |time: Timestamp| Ok::<_, StoreError>(Key { captured_at: whole("time", time.0)?, n: 0 });
        let low = query.since.map_or(Ok(Key { captured_at: 0, n: 0 }), at)?;
        let high = query.until.map_or(Ok(end), at)?;
        let range = Self { low, high, newest_first: query.newest_first };
        let Some(cursor) = &query.after else { return Ok(range) };
        let key = Key::parse(cursor).ok_or_else(|| StoreError::Cursor(clean(cursor, 40)))?;
        Ok(range.behind(key))
    }

    fn behind(self, key: Key) -> Self {
        match self.newest_first {
            true => Self { high: self.high.min(key), ..self },
            false => Self { low: self.low.max(key), ..self },
        }
    }

    fn sql(self, filters: usize) -> String {
        let order = if self.newest_first { "DESC" } else { "ASC" };
        let filters: String = (0..filters)
            .map(|choice| (8 + 2 * choice, 9 + 2 * choice))
            .map(|(one, other)| {
                format!(
                    " AND EXISTS (SELECT 1 FROM filters WHERE record = n
                      AND filter IN (SELECT key FROM filter_ids WHERE id IN (?{one}, ?{other})))"
                )
            })
            .collect();
        format!(
            "SELECT captured_at, n FROM records INDEXED BY records_by_state WHERE state = ?7 AND stream = ?1{filters}
                AND (captured_at, n) > (?2, ?3) AND (captured_at, n) < (?4, ?5)
                ORDER BY captured_at {order}, n {order} LIMIT ?6"
        )
    }
}

/// Keys of one stream and state, some prefetched.
struct Lane {
    stream: i64,
    state: u8,
    /// Two for each choice.
    filters: Vec<FilterId>,
    ahead: VecDeque<Key>,
    range: Range,
    exhausted: bool,
}

/// Keeps streams that ever had an id of each choice.
fn narrow(connection: &Connection, streams: &mut Vec<&Stream>, choices: &[FilterChoice]) -> Result<(), StoreError> {
    let on_any = "SELECT stream FROM filter_streams JOIN filter_ids ON key = filter WHERE id = ?1";
    let on_one =
        "SELECT EXISTS (SELECT 1 FROM filter_streams JOIN filter_ids ON key = filter WHERE id = ?1 AND stream = ?2)";
    for choice in choices {
        let having: HashSet<i64> = connection.list(on_any, [choice.id.0], |row| row.get(0))?;
        let mut left = Vec::with_capacity(streams.len());
        for stream in streams.iter() {
            let has = match choice.by_topic.get(&stream.topic_id) {
                _ if having.contains(&stream.key) => true,
                Some(id) => connection.one(on_one, params![id.0, stream.key], |row| row.get(0))?,
                None => false,
            };
            if has {
                left.push(*stream);
            }
        }
        *streams = left;
    }
    Ok(())
}

/// Streams and states with records.
fn lanes(connection: &Connection, streams: &[i64], wanted: Option<RecordState>) -> Result<Vec<(i64, u8)>, StoreError> {
    if let Some(state) = wanted {
        return Ok(streams.iter().map(|stream| (*stream, state.code())).collect());
    }
    let lane = |row: &Row<'_>| Ok((row.get(0)?, row.get(1)?));
    if streams.len() >= MANY {
        let wanted: HashSet<i64> = streams.iter().copied().collect();
        let mut lanes: Vec<(i64, u8)> =
            connection.list("SELECT stream, state FROM counters WHERE records > 0", [], lane)?;
        lanes.retain(|(stream, _)| wanted.contains(stream));
        return Ok(lanes);
    }
    let mut lanes = Vec::with_capacity(streams.len());
    for stream in streams {
        let sql = "SELECT stream, state FROM counters WHERE stream = ?1 AND records > 0";
        lanes.extend(connection.list::<_, Vec<_>>(sql, [stream], lane)?);
    }
    Ok(lanes)
}

struct Merge<'a> {
    statement: Statement<'a>,
    lanes: Vec<Lane>,
    heap: BinaryHeap<(Reverse<Key>, usize)>,
    chunk: usize,
}

impl<'a> Merge<'a> {
    fn new(
        connection: &'a Connection,
        (streams, topics): (&[i64], &HashMap<i64, TopicId>),
        query: &RecordQuery,
        range: Range,
        wanted: usize,
    ) -> Result<Self, StoreError> {
        let statement = connection.prepared(&range.sql(query.filters.len()))?;
        let filters = |stream: i64| {
            let topic = topics.get(&stream).copied().unwrap_or(TopicId([0; 16]));
            query.filters.iter().flat_map(|choice| choice.of(topic)).collect()
        };
        let lane = |(stream, state)| {
            let (filters, ahead) = (filters(stream), VecDeque::new());
            Lane { stream, state, filters, ahead, range, exhausted: false }
        };
        let lanes: Vec<Lane> = lanes(connection, streams, query.state)?.into_iter().map(lane).collect();
        let count = lanes.len();
        let chunk = (wanted * 2).div_ceil(count.max(1)).clamp(4, wanted.max(4));
        let mut merge = Self { statement, lanes, heap: BinaryHeap::new(), chunk };
        for index in 0..count {
            merge.offer(index)?;
        }
        Ok(merge)
    }

    fn take(mut self, wanted: usize) -> Result<Vec<Key>, StoreError> {
        let mut keys = Vec::with_capacity(wanted);
        while keys.len() < wanted {
            let Some((Reverse(rank), index)) = self.heap.pop() else { break };
            let is_reversed = self.lanes.first().is_some_and(|lane| lane.range.newest_first);
            keys.push(if is_reversed { flip(rank) } else { rank });
            self.offer(index)?;
        }
        Ok(keys)
    }

    /// Pushes a lane's next key, reading on if none is prefetched.
    fn offer(&mut self, index: usize) -> Result<(), StoreError> {
        let Some(lane) = self.lanes.get_mut(index) else { return Ok(()) };
        if lane.ahead.is_empty() && !lane.exhausted {
            lane.read(&mut self.statement, self.chunk)?;
        }
        if let Some(key) = lane.ahead.pop_front() {
            let rank = if lane.range.newest_first { flip(key) } else { key };
            self.heap.push((Reverse(rank), index));
        }
        Ok(())
    }
}

impl Lane {
    fn read(&mut self, statement: &mut Statement<'_>, chunk: usize) -> Result<(), StoreError> {
        let Range { low, high, .. } = self.range;
        let state = i64::from(self.state);
        let bounds =
            [self.stream, low.captured_at, low.n, high.captured_at, high.n, capped(chunk), state].map(Value::Integer);
        let filters = self.filters.iter().map(|filter| Value::Blob(&filter.0));
        let values: Vec<Value<'_>> = bounds.into_iter().chain(filters).collect();
        self.ahead = statement.list(values, |row| Ok(Key { captured_at: row.get(0)?, n: row.get(1)? }))?;
        self.exhausted = self.ahead.len() < chunk;
        if let Some(last) = self.ahead.back() {
            self.range = self.range.behind(*last);
        }
        Ok(())
    }
}

/// Reverses the order; its own inverse.
fn flip(key: Key) -> Key {
    Key { captured_at: !key.captured_at, n: !key.n }
}

// Ages and last arrivals: a few look-ups per stream in the index of states, whatever the number of records.

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LastSeen {
    pub signer: SignerId,
    /// Arrival here, by this site's clock.
    pub at: Timestamp,
}

/// Here, but in no block.
const UNANCHORED: [RecordState; 3] = [RecordState::Stored, RecordState::Batched, RecordState::Submitted];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NewestRecord {
    pub epoch: u64,
    /// By its recorder's clock.
    pub captured_at: Timestamp,
    pub acknowledged_at: Timestamp,
}

pub(super) const OWNERS: &str = "SELECT DISTINCT owner FROM topics LIMIT ?1";
/// Of one kind and state.
pub(super) const OLDEST: &str = "SELECT min((SELECT min(captured_at) FROM records WHERE state = ?3 AND stream = s.key))
    FROM streams s JOIN topics t ON t.key = s.topic WHERE t.owner = ?1 AND s.kind = ?2";
/// Without a gap record.
pub(super) const UNTOLD: &str = "SELECT count(*) FROM gaps WHERE report IS NULL";

/// Signers with the arrival of their newest record: the highest number of each topic came last.
pub(super) const LAST_SEEN: &str = "SELECT signer, max(newest) AS at FROM (
        SELECT r.signer, (SELECT acknowledged_at FROM records WHERE topic = t.key ORDER BY seq DESC LIMIT 1) AS newest
        FROM topics t JOIN recorders r ON r.key = t.recorder
    ) each_topic WHERE newest IS NOT NULL GROUP BY signer ORDER BY at DESC LIMIT ?1";

impl Counts {
    pub fn owners(&self, limit: usize) -> Result<Vec<Address>, StoreError> {
        self.0.list(OWNERS, [capped(limit)], |row| Ok(Address(row.get(0)?)))
    }

    /// In no block yet.
    pub fn oldest_unanchored(&self, owner: Address) -> Result<Option<Timestamp>, StoreError> {
        self.0.read(|connection| {
            let mut oldest: Option<i64> = None;
            for state in UNANCHORED {
                let values = params![owner.0, RecordKind::Data.code(), i64::from(state.code())];
                let found: Option<i64> = connection.one(OLDEST, values, |row| row.get(0))?;
                oldest = oldest.into_iter().chain(found).min();
            }
            Ok(oldest.and_then(|at| u64::try_from(at).ok()).map(Timestamp))
        })
    }

    /// For the `limit` most recent signers.
    pub fn last_seen(&self, limit: usize) -> Result<Vec<LastSeen>, StoreError> {
        self.0.list(LAST_SEEN, [capped(limit)], |row| Ok(LastSeen { signer: SignerId(row.get(0)?), at: time(row, 1)? }))
    }

    /// Among the highest numbers of its topics.
    pub fn newest_of(&self, owner: Address, signer: SignerId) -> Result<Option<NewestRecord>, StoreError> {
        let sql = "SELECT x.epoch, x.captured_at, x.acknowledged_at FROM topics t
            JOIN recorders r ON r.key = t.recorder
            JOIN records x ON x.topic = t.key AND x.seq = (SELECT max(seq) FROM records WHERE topic = t.key)
            WHERE t.owner = ?1 AND r.signer = ?2 ORDER BY x.captured_at DESC LIMIT 1";
        self.0.find(sql, params![owner.0, signer.0], |row| {
            Ok(NewestRecord { epoch: unsigned(row, 0)?, captured_at: time(row, 1)?, acknowledged_at: time(row, 2)? })
        })
    }
}

impl Losses {
    /// Entries without a gap record, by place and reason, not messages.
    pub fn untold(&self) -> Result<u64, StoreError> {
        self.0.one(UNTOLD, [], |row| unsigned(row, 0))
    }
}

// Shell completion and `doctor` read ledgers that may be in use: they write nothing beside them and do not wait.

const ID_LENGTH: usize = 16;

#[derive(Debug)]
pub struct Glance {
    connection: Connection,
    path: PathBuf,
}

impl Glance {
    /// Opens an existing file.
    pub fn at(path: &Path) -> Result<Self, StoreError> {
        Ok(Self { connection: database::open_glance(path, &SCHEMA)?.into(), path: path.to_owned() })
    }

    /// A server's store, as `watermark` remembers it; `None` if its tables are not made yet.
    pub fn on_server(
        url: &str,
        roots: Option<&Path>,
        watermark: Option<&Path>,
    ) -> Result<(Option<Self>, Durability), StoreError> {
        let mut server = Server::at(url, roots)?;
        if let Some(file) = watermark {
            server = server.remembered_by(Watermark::look(file)?);
        }
        let path = server.place().to_owned();
        let looked = || {
            let client = server.connect()?;
            let is_made = server.check(&client)?;
            let connection = Connection::from(client);
            let durability = durability::of(&connection)?.ok_or(StoreError::Closed)?;
            Ok((is_made.then_some(connection), durability))
        };
        let (connection, durability) = looked().map_err(|error: StoreError| error.in_file(&path))?;
        Ok((connection.map(|connection| Self { connection, path }), durability))
    }

    /// Where it is, for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// In order; untrusted text: clean it.
    pub fn topics(&self, begun: &str, limit: usize) -> Result<Vec<String>, StoreError> {
        let mut names: Vec<String> = rows::streams(&self.connection, &Which::All)?
            .into_iter()
            .map(|stream| stream.topic)
            .filter(|name| name.starts_with('/') && name.starts_with(begun))
            .collect();
        names.sort();
        names.dedup();
        names.truncate(limit);
        Ok(names)
    }

    /// The newest if the prefix is empty.
    pub fn ids(&self, begun: &str, limit: usize) -> Result<Vec<String>, StoreError> {
        let whole = 2 * crate::model::Digest::LENGTH;
        if begun.len() > whole || !begun.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return Ok(Vec::new());
        }
        let fill = |digit: &str| format!("{}{}", begun.to_ascii_lowercase(), digit.repeat(whole - begun.len()));
        let order = if begun.is_empty() { "n DESC" } else { "digest" };
        let sql = format!(
            "SELECT lower(hex(digest)) FROM records WHERE digest BETWEEN unhex(?1) AND unhex(?2) ORDER BY {order} LIMIT ?3"
        );
        let values = params![fill("0"), fill("f"), capped(limit)];
        let ids: Vec<String> = self.connection.list(&sql, values, |row| row.get(0))?;
        // Text beyond an id's length stays as typed.
        let length = ID_LENGTH.max(begun.len());
        Ok(ids.into_iter().map(|digest| digest.chars().take(length).collect()).collect())
    }

    /// Returns how many it read.
    pub fn check_notes(&self) -> Result<u64, StoreError> {
        notes::check(&self.connection).map_err(|error| self.named(error))
    }

    pub fn note<N: Note>(&self, note: &N) -> Result<Option<N::Value>, StoreError> {
        notes::read_in(&self.connection, note).map_err(|error| self.named(error))
    }

    /// `None` on a file.
    pub fn lease(&self) -> Result<Option<LeaseState>, StoreError> {
        super::lease::state(&self.connection, &[]).map_err(|error| self.named(error))
    }

    pub fn contract_pin(&self) -> Result<Option<String>, StoreError> {
        self.connection.find(directory::PIN, [], |row| row.get(0)).map_err(|error| self.named(error.into()))
    }

    fn named(&self, error: StoreError) -> StoreError {
        error.in_file(&self.path)
    }
}

// Pages over many streams read the index of capture times: if most records match, a few rows tell as much as thousands
// of streams.

/// A merge is as fast over fewer streams.
pub(super) const MANY: usize = 24;
/// Rows read for each row wanted.
const PATIENCE: usize = 8;

/// `None` if the streams are few, or too few of their records are among the rows read.
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
    let mut statement = connection.prepared(&format!(
        "SELECT captured_at, n, stream FROM records
            WHERE (captured_at, n) > (?1, ?2) AND (captured_at, n) < (?3, ?4)
            ORDER BY captured_at {order}, n {order} LIMIT ?5"
    ))?;
    let (low, high, limit) = (range.low, range.high, capped(most));
    let (mut keys, mut seen) = (Vec::with_capacity(wanted), 0);
    statement.each_while(params![low.captured_at, low.n, high.captured_at, high.n, limit], |row| {
        seen += 1;
        if streams.contains(&row.get(2)?) {
            keys.push(Key { captured_at: row.get(0)?, n: row.get(1)? });
        }
        Ok::<_, StoreError>(keys.len() < wanted)
    })?;
    Ok((keys.len() >= wanted || seen < most).then_some(keys))
}
