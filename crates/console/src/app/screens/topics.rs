//! The Topics screen: rows of the graph, their order and what was transferred lately.

use std::cmp::Ordering;
use std::collections::{HashMap, VecDeque};

use crate::app::fuzzy;
use crate::app::table::Table;
use crate::model::Timestamp;
use crate::service::reply::TopicRow;

/// The most topics kept.
const MOST_TOPICS: usize = 5_000;
/// Samples of a topic's transfer rate kept for its sparkline.
pub const SAMPLES: usize = 8;
/// Time between two samples, nanoseconds.
const SAMPLE_EVERY: u64 = 1_000_000_000;
/// What sorts the table, in the order of `s`.
pub const SORTS: [&str; 4] = ["name", "Hz", "bytes/s", "watched"];

/// Topics of the graph.
#[derive(Debug, Default)]
pub struct Topics {
    /// All rows, by name.
    pub rows: Vec<TopicRow>,
    /// Cursor, filter, order, marks.
    pub table: Table,
    history: HashMap<String, VecDeque<f64>>,
    sampled_at: Timestamp,
    shown: Shown,
}

/// Which rows a filter and an order show, found once for all questions until one of them changes.
#[derive(Debug, Default)]
struct Shown {
    filter: String,
    sort: usize,
    reversed: bool,
    places: Vec<usize>,
}

impl Topics {
    /// Takes new rows over.
    pub fn set(&mut self, mut rows: Vec<TopicRow>, now: Timestamp) {
        rows.truncate(MOST_TOPICS);
        rows.sort_by(|one, other| one.topic.cmp(&other.topic));
        self.rows = rows;
        let rows = &self.rows;
        // Sorted by name above.
        let is_there = |name: &String| rows.binary_search_by(|row| row.topic.cmp(name)).is_ok();
        self.table.marks.retain(is_there);
        self.refresh(true);
        let keys = self.keys();
        self.table.settle(&keys);
        if now.0.saturating_sub(self.sampled_at.0) >= SAMPLE_EVERY {
            self.sampled_at = now;
            self.sample();
        }
    }

    fn sample(&mut self) {
        let rows = &self.rows;
        self.history.retain(|topic, _| rows.binary_search_by(|row| row.topic.cmp(topic)).is_ok());
        for row in &self.rows {
            // Most are there already, and need no name of their own.
            let samples = match self.history.get_mut(&row.topic) {
                Some(samples) => samples,
                None => self.history.entry(row.topic.clone()).or_default(),
            };
            samples.push_back(row.bytes_per_second.unwrap_or(0.0));
            if samples.len() > SAMPLES {
                samples.pop_front();
            }
        }
    }

    /// Bytes a second of a topic, oldest first.
    pub fn samples(&self, topic: &str) -> Vec<f64> {
        self.history.get(topic).map(|samples| samples.iter().copied().collect()).unwrap_or_default()
    }

    /// The rows to show, filtered and in order.
    pub fn visible(&self) -> Vec<&TopicRow> {
        if self.is_fresh() {
            return self.shown.places.iter().filter_map(|place| self.rows.get(*place)).collect();
        }
        self.found().into_iter().map(|(_, row)| row).collect()
    }

    fn is_fresh(&self) -> bool {
        self.shown.filter == self.table.filter.text()
            && self.shown.sort == self.table.sort
            && self.shown.reversed == self.table.reversed
    }

    fn found(&self) -> Vec<(usize, &TopicRow)> {
        let all = self.rows.iter().enumerate().collect();
        let mut rows = fuzzy::narrow(self.table.filter.text(), all, |(_, row)| haystack(row));
        // A stable order: what is equal stays in the order of names.
        rows.sort_by(|(_, one), (_, other)| order(self.table.sort, one, other));
        if self.table.reversed {
            rows.reverse();
        }
        rows
    }

    /// Finds the rows to show anew where filter or order changed, or `rows_changed`.
    pub fn refresh(&mut self, rows_changed: bool) {
        if rows_changed || !self.is_fresh() {
            let places = self.found().into_iter().map(|(place, _)| place).collect();
            self.shown = Shown {
                filter: self.table.filter.text().to_owned(),
                sort: self.table.sort,
                reversed: self.table.reversed,
                places,
            };
        }
    }

    /// Whether any row passes the filter.
    pub fn any_visible(&self) -> bool {
        if self.is_fresh() { !self.shown.places.is_empty() } else { !self.visible().is_empty() }
    }

    /// The names of the rows shown.
    pub fn keys(&self) -> Vec<String> {
        self.visible().into_iter().map(|row| row.topic.clone()).collect()
    }

    /// The busiest, by Hz, then by name.
    pub fn busiest(&self, limit: usize) -> Vec<&TopicRow> {
        let mut rows: Vec<_> = self.rows.iter().collect();
        rows.sort_by(|one, other| descending(one.hz, other.hz));
        rows.truncate(limit);
        rows
    }

    /// When the youngest age shown changes, though nothing arrives; `None` = no age is shown.
    pub fn older_at(&self, now: Timestamp) -> Option<Timestamp> {
        const SECOND: u64 = 1_000_000_000;
        let youngest = self.rows.iter().filter_map(|row| row.last_message).max()?;
        let step = match now.0.saturating_sub(youngest.0) / SECOND {
            0..60 => SECOND,
            60..3_600 => 60 * SECOND,
            _ => 3_600 * SECOND,
        };
        Some(Timestamp((now.0 / step + 1).saturating_mul(step)))
    }

    /// The row of the cursor.
    pub fn selected(&self) -> Option<&TopicRow> {
        let rows = self.visible();
        let keys: Vec<&str> = rows.iter().map(|row| row.topic.as_str()).collect();
        rows.get(self.table.position(&keys)).copied()
    }

    /// The marked rows, else the one of the cursor.
    pub fn targets(&self) -> Vec<&TopicRow> {
        if self.table.marks.is_empty() {
            return self.selected().into_iter().collect();
        }
        self.rows.iter().filter(|row| self.table.marks.contains(&row.topic)).collect()
    }
}

fn haystack(row: &TopicRow) -> String {
    format!("{} {}", row.topic, row.type_name.as_deref().unwrap_or(""))
}

fn order(sort: usize, one: &TopicRow, other: &TopicRow) -> Ordering {
    match sort {
        1 => descending(one.hz, other.hz),
        2 => descending(one.bytes_per_second, other.bytes_per_second),
        3 => other.watched.cmp(&one.watched),
        _ => Ordering::Equal,
    }
}

/// Rates compared in steps of a fifth, so that rows do not swap places at every breath.
fn descending(one: Option<f64>, other: Option<f64>) -> Ordering {
    let step = |rate: Option<f64>| rate.map_or(f64::NEG_INFINITY, |rate| (rate.max(0.01).log2() * 4.0).round());
    step(other).total_cmp(&step(one))
}
