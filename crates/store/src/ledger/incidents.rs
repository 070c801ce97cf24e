//! Incidents: spans of time and topics with notes. Retention keeps records in them.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::rows::{LEARNED_NAME, TOPIC_NAME, optional, time, unsigned};
use super::{Incidents, Session};
use crate::StoreError;
use crate::database::{capped, whole};
use crate::model::{Address, IncidentName, RecordKind, RecordState, Timestamp, TopicPatterns};
use crate::sql::{self, Connection, Row, params};

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct IncidentSpan {
    /// First capture.
    pub since: Timestamp,
    /// Captured before; `None` = still open.
    pub until: Option<Timestamp>,
    /// By name or pattern; empty = all.
    pub topics: TopicPatterns,
}

impl IncidentSpan {
    pub fn is_about(&self, topic: &str) -> bool {
        self.topics.0.is_empty() || self.topics.matches(topic)
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct IncidentNote {
    pub at: Timestamp,
    /// As written: clean it.
    pub text: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct IncidentRow {
    pub name: IncidentName,
    pub span: IncidentSpan,
    pub opened_at: Timestamp,
    pub closed_at: Option<Timestamp>,
    pub notes: Vec<IncidentNote>,
}

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct SpanCoverage {
    pub topic: String,
    /// Captured messages except quarantined ones.
    pub records: u64,
    pub bytes: u64,
    /// First capture.
    pub first: Option<Timestamp>,
    /// Last capture.
    pub last: Option<Timestamp>,
    /// Those without ciphertext.
    pub deleted: u64,
    pub quarantined: u64,
    /// Lost in stretches that overlap the span.
    pub lost: u64,
}

impl SpanCoverage {
    fn add(&mut self, part: &Self) {
        self.records += part.records;
        self.bytes += part.bytes;
        self.deleted += part.deleted;
        self.quarantined += part.quarantined;
        self.lost += part.lost;
        self.first = [self.first, part.first].into_iter().flatten().min();
        self.last = self.last.max(part.last);
    }
}

impl Incidents {
    /// `false` if the owner has one of this name.
    pub fn open(
        &self,
        owner: Address,
        name: &IncidentName,
        span: &IncidentSpan,
        note: Option<&str>,
    ) -> Result<bool, StoreError> {
        let (name, span, note) = (name.clone(), span.clone(), note.map(str::to_owned));
        self.0.write(move |Session { connection, .. }| {
            let now = whole("time", Timestamp::now().0)?;
            let until = span.until.map(|until| whole("time", until.0)).transpose()?;
            let since = whole("time", span.since.0)?;
            let sql = "INSERT INTO incidents (owner, name, since, until, opened_at) VALUES (?1, ?2, ?3, ?4, ?5)
                ON CONFLICT DO NOTHING";
            if connection.changed(sql, params![owner.0, name.as_str(), since, until, now])? == 0 {
                return Ok(false);
            }
            let sql = "SELECT key FROM incidents WHERE owner = ?1 AND name = ?2";
            let key: i64 = connection.one(sql, params![owner.0, name.as_str()], |row| row.get(0))?;
            for topic in &span.topics.0 {
                let sql = "INSERT OR IGNORE INTO incident_topics VALUES (?1, ?2)";
                connection.run(sql, params![key, topic.as_str()])?;
            }
            if let Some(text) = &note {
                connection.run("INSERT INTO incident_notes VALUES (?1, 1, ?2, ?3)", params![key, now, text])?;
            }
            Ok(true)
        })
    }

    /// The newest span last.
    pub fn list(&self, owner: Address) -> Result<Vec<IncidentRow>, StoreError> {
        self.0.read(|connection| {
            let sql = "SELECT key, name, since, until, opened_at, closed_at FROM incidents WHERE owner = ?1
                ORDER BY since, key";
            let rows: Vec<_> = connection.list(sql, [owner.0], incident)?;
            rows.into_iter().map(|row| whole_of(connection, row)).collect()
        })
    }

    pub fn find(&self, owner: Address, name: &IncidentName) -> Result<Option<IncidentRow>, StoreError> {
        self.0.read(|connection| {
            let sql = "SELECT key, name, since, until, opened_at, closed_at FROM incidents
                WHERE owner = ?1 AND name = ?2";
            let found = connection.find(sql, params![owner.0, name.as_str()], incident)?;
            found.map(|row| whole_of(connection, row)).transpose()
        })
    }

    /// `false` if there is none of this name.
    pub fn note(&self, owner: Address, name: &IncidentName, text: &str) -> Result<bool, StoreError> {
        let (name, now) = (name.as_str().to_owned(), whole("time", Timestamp::now().0)?);
        let sql = "INSERT INTO incident_notes SELECT key,
                (SELECT coalesce(max(number), 0) + 1 FROM incident_notes WHERE incident = key), ?3, ?4
            FROM incidents WHERE owner = ?1 AND name = ?2";
        Ok(self.0.changed(sql, (owner.0, name, now, text.to_owned()))? > 0)
    }

    /// Ends its span now, unless it ended before. `false` if none of this name is open.
    pub fn close(&self, owner: Address, name: &IncidentName) -> Result<bool, StoreError> {
        let (name, now) = (name.as_str().to_owned(), whole("time", Timestamp::now().0)?);
        let sql = "UPDATE incidents SET closed_at = ?3, until = min(coalesce(until, ?3), ?3)
            WHERE owner = ?1 AND name = ?2 AND closed_at IS NULL";
        Ok(self.0.changed(sql, (owner.0, name, now))? > 0)
    }

    /// Retention may delete its records again. `false` if there is none of this name.
    pub fn remove(&self, owner: Address, name: &IncidentName) -> Result<bool, StoreError> {
        let name = name.clone();
        self.0.write(move |Session { connection, .. }| {
            let whose = params![owner.0, name.as_str()];
            for table in ["incident_topics", "incident_notes"] {
                let sql = format!(
                    "DELETE FROM {table} WHERE incident IN (SELECT key FROM incidents WHERE owner = ?1 AND name = ?2)"
                );
                connection.run(&sql, whose)?;
            }
            Ok(connection.changed("DELETE FROM incidents WHERE owner = ?1 AND name = ?2", whose)? > 0)
        })
    }

    /// Of the topics with records, and of each name or pattern without any.
    pub fn span_coverage(&self, owner: Address, span: &IncidentSpan) -> Result<Vec<SpanCoverage>, StoreError> {
        self.0.read(|connection| {
            let mut found: BTreeMap<String, SpanCoverage> = BTreeMap::new();
            let parts = counted(connection, owner, span)?.into_iter().chain(losses(connection, owner, span)?);
            for part in parts.filter(|part| span.is_about(&part.topic)) {
                found.entry(part.topic.clone()).or_default().add(&part);
            }
            for pattern in &span.topics.0 {
                if !found.keys().any(|topic| pattern.matches(topic)) {
                    found.insert(pattern.to_string(), SpanCoverage::default());
                }
            }
            Ok(found.into_iter().map(|(topic, coverage)| SpanCoverage { topic, ..coverage }).collect())
        })
    }

    /// Captured bytes with ciphertext.
    pub fn bytes_between(&self, topic: i64, (since, until): (Timestamp, Timestamp)) -> Result<u64, StoreError> {
        let sql = "SELECT coalesce(sum(r.bytes), 0) FROM streams s JOIN counters c ON c.stream = s.key
            JOIN records r INDEXED BY records_by_state ON r.state = c.state AND r.stream = s.key
            WHERE s.topic = ?1 AND s.kind = ?2 AND c.records > 0 AND c.state <> ?3
            AND r.captured_at >= ?4 AND r.captured_at < ?5
            AND NOT EXISTS (SELECT 1 FROM retained WHERE record = r.n)";
        let (kind, dropped) = (RecordKind::Data.code(), RecordState::Dropped.code());
        let values = params![topic, kind, dropped, capped(since.0), capped(until.0)];
        self.0.one(sql, values, |row| unsigned(row, 0))
    }
}

fn parsed<T: FromStr<Err: Display>>(row: &Row<'_>, column: usize) -> sql::Result<T> {
    row.get::<String>(column)?.parse().map_err(|error: T::Err| sql::Error::altered(column, &error.to_string()))
}

fn incident(row: &Row<'_>) -> sql::Result<(i64, IncidentRow)> {
    let name = parsed(row, 1)?;
    let (since, until) = (time(row, 2)?, optional(row, 3)?.map(Timestamp));
    let (opened_at, closed_at) = (time(row, 4)?, optional(row, 5)?.map(Timestamp));
    let span = IncidentSpan { since, until, topics: TopicPatterns::default() };
    Ok((row.get(0)?, IncidentRow { name, span, opened_at, closed_at, notes: Vec::new() }))
}

fn whole_of(connection: &Connection, (key, mut row): (i64, IncidentRow)) -> Result<IncidentRow, StoreError> {
    let sql = "SELECT topic FROM incident_topics WHERE incident = ?1 ORDER BY topic";
    row.span.topics = TopicPatterns(connection.list(sql, [key], |row| parsed(row, 0))?);
    let sql = "SELECT at, text FROM incident_notes WHERE incident = ?1 ORDER BY number";
    row.notes = connection.list(sql, [key], |row| Ok(IncidentNote { at: time(row, 0)?, text: row.get(1)? }))?;
    Ok(row)
}

fn counted(connection: &Connection, owner: Address, span: &IncidentSpan) -> Result<Vec<SpanCoverage>, StoreError> {
    let sql = format!(
        "SELECT {TOPIC_NAME}, r.state, count(*), sum(r.bytes), min(r.captured_at), max(r.captured_at),
                count(r.deleted_at)
            FROM topics t {LEARNED_NAME} JOIN streams s ON s.topic = t.key JOIN counters c ON c.stream = s.key
            JOIN records r INDEXED BY records_by_state ON r.state = c.state AND r.stream = s.key
            WHERE t.owner = ?1 AND s.kind = ?2 AND c.records > 0 AND c.state <> ?3
            AND r.captured_at >= ?4 AND r.captured_at < ?5 GROUP BY 1, r.state"
    );
    let (kind, dropped) = (RecordKind::Data.code(), RecordState::Dropped.code());
    Ok(connection.list(&sql, params![owner.0, kind, dropped, capped(span.since.0), end(span)], |row| {
        let (topic, records) = (row.get(0)?, unsigned(row, 2)?);
        if row.get::<u8>(1)? == RecordState::Quarantined.code() {
            return Ok(SpanCoverage { topic, quarantined: records, ..SpanCoverage::default() });
        }
        let (bytes, deleted) = (unsigned(row, 3)?, unsigned(row, 6)?);
        let (first, last) = (Some(time(row, 4)?), Some(time(row, 5)?));
        Ok(SpanCoverage { topic, records, bytes, first, last, deleted, ..SpanCoverage::default() })
    })?)
}

fn losses(connection: &Connection, owner: Address, span: &IncidentSpan) -> Result<Vec<SpanCoverage>, StoreError> {
    let sql = "SELECT topic, sum(count) FROM gaps WHERE owner = ?1 AND last_at >= ?2 AND first_at < ?3 GROUP BY topic";
    Ok(connection.list(sql, params![owner.0, capped(span.since.0), end(span)], |row| {
        Ok(SpanCoverage { topic: row.get(0)?, lost: unsigned(row, 1)?, ..SpanCoverage::default() })
    })?)
}

fn end(span: &IncidentSpan) -> i64 {
    span.until.map_or(i64::MAX, |until| capped(until.0))
}
