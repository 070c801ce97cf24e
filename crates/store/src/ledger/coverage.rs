//! When there are records of a topic: parts of a span of time, each looked up in the index of states, so that the cost
//! depends on the parts and not on the records.

use std::collections::BTreeSet;

use rusqlite::{Connection, OptionalExtension as _, params};

use super::Ledger;
use super::rows::{self, Which, unsigned};
use crate::model::{Address, RecordKind, RecordState, SignerId, Timestamp};
use crate::store::StoreError;
use crate::store::database::whole;

/// The most parts of a span.
pub const MOST_PARTS: usize = 1_000;
/// The most losses examined, the newest.
const MOST_LOSSES: i64 = 10_000;

/// A span of time of one topic, in parts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CoverageQuery {
    /// Whose topic.
    pub owner: Address,
    /// Its name.
    pub topic: String,
    /// Only what these keys signed, as those of one robot, without losses: what is counted here was lost by this
    /// site's own capture. `None` = whoever recorded it.
    pub signers: Option<BTreeSet<SignerId>>,
    /// From this time; `None` = from its first record.
    pub since: Option<Timestamp>,
    /// Before this time.
    pub until: Timestamp,
    /// Divided into this many parts, 1 to [`MOST_PARTS`].
    pub parts: usize,
}

/// The records in a part of the span.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CoveragePart {
    /// Its beginning.
    pub at: Timestamp,
    /// Records that are neither quarantined nor altered.
    pub data: bool,
    /// Records that are quarantined, or were and then discarded.
    pub quarantined: bool,
    /// Records whose stored bytes are wrong.
    pub tampered: bool,
    /// Messages that were lost, as far as noticed in this part; what is spread over several counts in each.
    pub lost: u64,
}

/// When there are records of a topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Coverage {
    /// Beginning of the span.
    pub since: Timestamp,
    /// Its end.
    pub until: Timestamp,
    /// Capture of the first record ever.
    pub first: Option<Timestamp>,
    /// Capture of the last.
    pub last: Option<Timestamp>,
    /// Whose keys signed records of the topic, also others than those asked for.
    pub signers: BTreeSet<SignerId>,
    /// The parts, oldest first, all of the same length.
    pub parts: Vec<CoveragePart>,
}

impl Ledger {
    /// When there are data records of a topic: one lookup for each part and each of its streams and states.
    ///
    /// # Errors
    /// [`StoreError::TooBig`] if a time is not valid, [`StoreError::Database`] and its kin.
    pub fn coverage(&self, query: &CoverageQuery) -> Result<Coverage, StoreError> {
        self.read(|connection| {
            let mut lanes = lanes(connection, query)?;
            let signers = lanes.iter().map(|lane| lane.signer).collect();
            if let Some(wanted) = &query.signers {
                lanes.retain(|lane| wanted.contains(&lane.signer));
            }
            let (first, last) = ends(connection, &lanes)?;
            let since = query.since.or(first).unwrap_or(query.until).min(query.until);
            let mut parts = empty(since, query);
            for lane in &lanes {
                lane.walk(connection, query.until, &mut parts)?;
            }
            if query.signers.is_none() {
                add_losses(connection, query, &mut parts)?;
            }
            Ok(Coverage { since, until: query.until, first, last, signers, parts })
        })
    }
}

/// Records of one stream in one state.
struct Lane {
    stream: i64,
    signer: SignerId,
    state: RecordState,
}

fn lanes(connection: &Connection, query: &CoverageQuery) -> Result<Vec<Lane>, StoreError> {
    let mut streams = rows::streams(connection, &Which::Of(query.owner))?;
    streams.retain(|stream| stream.topic == query.topic && stream.kind == RecordKind::Data);
    let mut statement = connection.prepare_cached("SELECT state FROM counters WHERE stream = ?1 AND records > 0")?;
    let mut lanes = Vec::new();
    for stream in streams {
        let states = statement.query_map([stream.key], |row| rows::state(row, 0))?;
        for state in states {
            lanes.push(Lane { stream: stream.key, signer: stream.signer, state: state? });
        }
    }
    Ok(lanes)
}

/// Capture of the first and of the last record.
fn ends(connection: &Connection, lanes: &[Lane]) -> Result<(Option<Timestamp>, Option<Timestamp>), StoreError> {
    let end = |which: &str| -> Result<Vec<Timestamp>, StoreError> {
        let sql = format!(
            "SELECT {which}(captured_at) FROM records INDEXED BY records_by_state WHERE state = ?1 AND stream = ?2"
        );
        let mut statement = connection.prepare_cached(&sql)?;
        let mut found = Vec::new();
        for lane in lanes {
            let values = params![i64::from(lane.state.code()), lane.stream];
            let at: Option<i64> = statement.query_row(values, |row| row.get(0))?;
            found.extend(at.map(|at| Timestamp(at.cast_unsigned())));
        }
        Ok(found)
    };
    Ok((end("min")?.into_iter().min(), end("max")?.into_iter().max()))
}

/// The parts with nothing in them.
fn empty(since: Timestamp, query: &CoverageQuery) -> Vec<CoveragePart> {
    let count = query.parts.clamp(1, MOST_PARTS) as u64;
    let length = (query.until.0 - since.0).div_ceil(count).max(1);
    let part = |place: u64| CoveragePart {
        at: Timestamp(since.0.saturating_add(place * length)),
        data: false,
        quarantined: false,
        tampered: false,
        lost: 0,
    };
    (0..count).map(part).take_while(|part| part.at < query.until || part.at == since).collect()
}

impl Lane {
    /// Notes the parts in which it has records, from one to the next that has any.
    fn walk(&self, connection: &Connection, until: Timestamp, parts: &mut [CoveragePart]) -> Result<(), StoreError> {
        let mut statement = connection.prepare_cached(
            "SELECT captured_at FROM records INDEXED BY records_by_state
             WHERE state = ?1 AND stream = ?2 AND captured_at >= ?3 AND captured_at < ?4 ORDER BY captured_at LIMIT 1",
        )?;
        let mut from = parts.first().map(|part| part.at);
        while let Some(at) = from {
            let values =
                params![i64::from(self.state.code()), self.stream, whole("time", at.0)?, whole("time", until.0)?];
            let found: Option<i64> = statement.query_row(values, |row| row.get(0)).optional()?;
            let Some(found) = found.map(i64::cast_unsigned) else { return Ok(()) };
            let behind = parts.partition_point(|part| part.at.0 <= found);
            if let Some(part) = behind.checked_sub(1).and_then(|place| parts.get_mut(place)) {
                self.note(part);
            }
            from = parts.get(behind).map(|part| part.at);
        }
        Ok(())
    }

    fn note(&self, part: &mut CoveragePart) {
        match self.state {
            RecordState::Quarantined | RecordState::Dropped => part.quarantined = true,
            RecordState::Tampered => part.tampered = true,
            RecordState::Captured
            | RecordState::Sealed
            | RecordState::Stored
            | RecordState::Batched
            | RecordState::Submitted
            | RecordState::Mined
            | RecordState::Confirmed
            | RecordState::Verified
            | RecordState::RightEnded => part.data = true,
        }
    }
}

fn add_losses(connection: &Connection, query: &CoverageQuery, parts: &mut [CoveragePart]) -> Result<(), StoreError> {
    let Some(since) = parts.first().map(|part| part.at) else { return Ok(()) };
    let mut statement = connection.prepare_cached(
        "SELECT count, first_at, last_at FROM gaps WHERE owner = ?1 AND topic = ?2 AND last_at >= ?3 AND first_at < ?4
         ORDER BY key DESC LIMIT ?5",
    )?;
    let (since, until) = (whole("time", since.0)?, whole("time", query.until.0)?);
    let mut found = statement.query(params![query.owner.0, query.topic, since, until, MOST_LOSSES])?;
    while let Some(row) = found.next()? {
        let (count, first, last) = (unsigned(row, 0)?, unsigned(row, 1)?, unsigned(row, 2)?);
        let from = parts.partition_point(|part| part.at.0 <= first).saturating_sub(1);
        let to = parts.partition_point(|part| part.at.0 <= last);
        for part in parts.iter_mut().take(to).skip(from) {
            part.lost = part.lost.saturating_add(count);
        }
    }
    Ok(())
}
