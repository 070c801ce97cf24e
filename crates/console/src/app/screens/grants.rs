//! The Grants screen, and the answer to *who can read this now?*

use crate::app::palette;
use crate::app::table::Table;
use crate::model::{Address, Timestamp, clean};
use crate::service::reply::{Direction, GrantRow, GrantState};

/// The sort columns, in the order of `s`.
pub const SORTS: [&str; 3] = ["newest", "account", "state"];
/// The most grants kept.
const MOST_GRANTS: usize = 2_000;

/// Grants given and received.
#[derive(Debug, Default)]
pub struct Grants {
    /// All rows, as they came.
    pub rows: Vec<GrantRow>,
    /// Cursor, filter, order.
    pub table: Table,
}

/// Whether a grant was given by this profile.
pub fn is_given(row: &GrantRow) -> bool {
    row.direction == Direction::Given
}

/// Whether a grant opens new records.
pub fn is_active(row: &GrantRow) -> bool {
    row.state == GrantState::Active
}

/// The other side of a grant.
pub fn other_side(row: &GrantRow) -> Address {
    if is_given(row) { row.grantee } else { row.owner }
}

/// The key of a row.
pub fn key(row: &GrantRow) -> String {
    format!("{}{}{}{}", row.transaction, row.direction.word(), row.grantee, row.epoch)
}

impl Grants {
    /// Takes over new rows.
    pub fn set(&mut self, mut rows: Vec<GrantRow>) {
        rows.truncate(MOST_GRANTS);
        self.rows = rows;
        let keys = self.keys();
        self.table.settle(&keys);
    }

    /// The rows to show, filtered and in order.
    pub fn visible(&self) -> Vec<&GrantRow> {
        let text = |row: &&GrantRow| {
            let (direction, state) = (row.direction.word(), row.state.word());
            format!("{direction} {state} {} {}", other_side(row), row.topics.join(" "))
        };
        let mut rows = palette::narrow(self.table.filter.text(), self.rows.iter().collect(), text);
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

    /// The keys of the rows shown.
    pub fn keys(&self) -> Vec<String> {
        self.visible().into_iter().map(key).collect()
    }

    /// The row of the cursor.
    pub fn selected(&self) -> Option<&GrantRow> {
        let rows = self.visible();
        let keys: Vec<String> = rows.iter().map(|row| key(row)).collect();
        rows.get(self.table.position(&keys)).copied()
    }

    /// When the displayed time left of a grant that ends soon changes without news; `None` = never.
    pub fn nearer_at(&self, now: Timestamp) -> Option<Timestamp> {
        let ends = self.rows.iter().filter(|row| is_active(row)).filter_map(|row| row.expires);
        let next = |end: Timestamp| {
            let left = end.0.checked_sub(now.0).filter(|left| (1..SOON).contains(left))?;
            let unit = if left < 2 * HOUR { MINUTE } else { HOUR };
            Some(Timestamp(end.0 - left / unit * unit + 1))
        };
        ends.filter_map(next).min()
    }

    /// Whether anything was ever given.
    pub fn any_given(&self) -> bool {
        self.rows.iter().any(is_given)
    }

    /// Who can read now, one line each; `but` is left out.
    pub fn readers(&self, but: Option<Address>) -> Vec<String> {
        let active = self.rows.iter().filter(|row| is_given(row) && is_active(row) && Some(row.grantee) != but);
        let line =
            |row: &GrantRow| format!("{}  {}  {}{}", row.grantee, scope(&row.topics), end(row.expires), earlier(row));
        active.map(line).collect()
    }
}

/// What a grant covers, in words.
pub fn scope(topics: &[String]) -> String {
    match topics {
        [] => "all topics".to_owned(),
        [one] => clean(one, 60),
        many => format!("{} topics", many.len()),
    }
}

/// Whether older records are shared too, in words to follow others; empty = no, or not known.
pub fn earlier(row: &GrantRow) -> &'static str {
    if row.earlier == Some(true) { ", earlier records too" } else { "" }
}

/// When a grant ends, in words.
pub fn end(expires: Option<Timestamp>) -> String {
    expires.map_or_else(|| "no end".to_owned(), |moment| format!("until {}", day(moment)))
}

/// Grants that end within this time are shown with the time left, nanoseconds.
const SOON: u64 = 48 * HOUR;
const HOUR: u64 = 3_600_000_000_000;
const MINUTE: u64 = 60_000_000_000;

/// The time left of what ends soon, in words; `None` = it does not, or has ended.
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
