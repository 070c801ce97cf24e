//! Grants given and received.

use crate::app::{matching::narrow, table::Table};
use crate::model::{Address, Timestamp, clean, counted};
use crate::service::reply::{Direction, GrantRow, GrantState};

const MOST_GRANTS: usize = 2_000;

#[derive(Debug, Default)]
pub struct Grants {
    pub rows: Vec<GrantRow>,
    pub table: Table,
}

pub fn is_given(row: &GrantRow) -> bool {
    row.direction == Direction::Given
}

/// Whether a grant opens new records.
pub fn is_active(row: &GrantRow) -> bool {
    row.state == GrantState::Active
}

pub fn other_side(row: &GrantRow) -> Address {
    if is_given(row) { row.grantee } else { row.owner }
}

pub fn key(row: &GrantRow) -> String {
    format!("{}{}{}{}", row.transaction, row.direction.word(), row.grantee, row.epoch)
}

impl Grants {
    pub fn set(&mut self, mut rows: Vec<GrantRow>) {
        rows.truncate(MOST_GRANTS);
        self.rows = rows;
        let keys = self.keys();
        self.table.settle(&keys);
    }

    pub fn visible(&self) -> Vec<&GrantRow> {
        let text = |row: &&GrantRow| {
            let (direction, state) = (row.direction.word(), row.state.word());
            format!("{direction} {state} {} {}", other_side(row), row.topics.join(" "))
        };
        let mut rows = narrow(self.table.filter.text(), self.rows.iter().collect(), text);
        match self.table.sort {
            1 => rows.sort_by_key(|row| (other_side(row), std::cmp::Reverse(row.block))),
            2 => rows.sort_by_key(|row| (row.state.word(), std::cmp::Reverse(row.block))),
            _ => rows.sort_by_key(|row| std::cmp::Reverse(row.block)),
        }
        if self.table.reversed {
            rows.reverse();
        }
        rows
    }

    pub fn keys(&self) -> Vec<String> {
        self.visible().into_iter().map(key).collect()
    }

    pub fn selected(&self) -> Option<&GrantRow> {
        self.table.chosen(self.visible(), |row| key(row))
    }

    /// When the time left of a grant that ends soon changes on screen.
    pub fn nearer_at(&self, now: Timestamp) -> Option<Timestamp> {
        let ends = self.rows.iter().filter(|row| is_active(row)).filter_map(|row| row.expires);
        let next = |end: Timestamp| {
            let left = end.0.checked_sub(now.0).filter(|left| (1..SOON).contains(left))?;
            let unit = if left < 2 * HOUR { MINUTE } else { HOUR };
            Some(Timestamp(end.0 - left / unit * unit + 1))
        };
        ends.filter_map(next).min()
    }
}

pub fn scope(topics: &[String]) -> String {
    match topics {
        [] => "all topics".to_owned(),
        [one] => clean(one, 60),
        many => counted(many.len() as u64, "topic"),
    }
}

/// To follow other words; empty = no, or unknown.
pub fn earlier(row: &GrantRow) -> &'static str {
    if row.from.is_some_and(|from| from < row.epoch) { ", earlier records too" } else { "" }
}

pub fn end(expires: Option<Timestamp>) -> String {
    expires.map_or_else(|| "no end".to_owned(), |moment| format!("until {} UTC", day(moment)))
}

/// Grants ending within this time show the time left, nanoseconds.
const SOON: u64 = 48 * HOUR;

const HOUR: u64 = 3_600_000_000_000;
const MINUTE: u64 = 60_000_000_000;

/// `None` if it does not end soon, or has ended.
pub fn soon(expires: Option<Timestamp>, now: Timestamp) -> Option<String> {
    let left = expires?.0.checked_sub(now.0).filter(|left| *left < SOON)?;
    Some(match left / MINUTE {
        0 => "in under 1 min".to_owned(),
        minutes @ 1..120 => format!("in {minutes} min"),
        minutes => format!("in {} h", minutes / 60),
    })
}

/// `2026-12-31 23:59` UTC.
pub fn day(moment: Timestamp) -> String {
    let text = moment.to_string();
    text.get(..16).map_or_else(|| text.clone(), |text| text.replace('T', " "))
}
