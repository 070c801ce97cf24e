//! A table's cursor, filter, order and marks; rows have keys, so that the cursor stays on its row.

use std::collections::BTreeSet;

use crate::app::{form::Field, key::Key};

const MOST_REMEMBERED: usize = 50;

#[derive(Debug, Default)]
pub struct Table {
    selected: Option<String>,
    index: usize,
    follows_top: bool,
    pub filter: Field,
    pub filtering: bool,
    pub sort: usize,
    pub reversed: bool,
    /// In order; empty = the usual ones.
    pub columns: Vec<&'static str>,
    /// Keys of marked rows.
    pub marks: BTreeSet<String>,
    /// Applied filters, newest last.
    history: Vec<String>,
    /// Recalled filter, counted from the newest.
    recalled: Option<usize>,
}

impl Table {
    /// While on the first row, the cursor stays there as rows come in above.
    pub fn following() -> Self {
        Self { follows_top: true, ..Self::default() }
    }

    pub fn position<K: AsRef<str>>(&self, keys: &[K]) -> usize {
        let found = self.selected.as_deref().and_then(|key| keys.iter().position(|other| other.as_ref() == key));
        found.unwrap_or_else(|| self.index.min(keys.len().saturating_sub(1)))
    }

    /// The row under the cursor.
    pub fn chosen<T: Copy, K: AsRef<str>>(&self, rows: Vec<T>, key: impl Fn(&T) -> K) -> Option<T> {
        let keys: Vec<K> = rows.iter().map(key).collect();
        rows.get(self.position(&keys)).copied()
    }

    pub fn select<K: AsRef<str>>(&mut self, keys: &[K], position: usize) {
        self.index = position.min(keys.len().saturating_sub(1));
        let bound = self.index > 0 || !self.follows_top;
        self.selected = keys.get(self.index).filter(|_| bound).map(|key| key.as_ref().to_owned());
    }

    /// Whether the cursor is bound to a row, not to the first place.
    pub fn is_bound(&self) -> bool {
        self.selected.is_some()
    }

    /// Keeps the cursor on its row as rows come in above.
    pub fn settle<K: AsRef<str>>(&mut self, keys: &[K]) {
        if self.selected.is_none() {
            self.select(keys, self.position(keys));
        }
    }

    /// False if the cursor could not move.
    pub fn step<K: AsRef<str>>(&mut self, keys: &[K], by: isize) -> bool {
        let from = self.position(keys);
        let wanted = from.saturating_add_signed(by).min(keys.len().saturating_sub(1));
        self.select(keys, wanted);
        wanted != from
    }

    /// The present filter stays until a character replaces it, and is then among the earlier ones.
    pub fn begin_filter(&mut self) {
        self.remember();
        self.filter = Field::offering(self.filter.text().trim());
        self.filtering = true;
    }

    /// Steps through earlier filters; false if something new is typed, or there is no other.
    pub fn recall(&mut self, earlier: bool) -> bool {
        let offered = self.filter.is_offered();
        let untouched = match self.recalled {
            None => (self.filter.text().is_empty() || offered) && earlier,
            Some(back) => self.past(back) == Some(self.filter.text()),
        };
        if !untouched {
            return false;
        }
        let wanted = match (self.recalled, earlier) {
            // The newest is the one on offer.
            (None, _) => Some(usize::from(offered && self.history.len() > 1)),
            (Some(back), true) => Some((back + 1).min(self.history.len().saturating_sub(1))),
            (Some(back), false) => back.checked_sub(1),
        };
        let text = wanted.and_then(|back| self.past(back)).map(str::to_owned);
        if text.is_none() && self.recalled.is_none() {
            return false;
        }
        (self.recalled, self.selected, self.index) = (wanted, None, 0);
        self.filter = Field::with(text.as_deref().unwrap_or_default());
        true
    }

    fn past(&self, back: usize) -> Option<&str> {
        self.history.iter().rev().nth(back).map(String::as_str)
    }

    fn remember(&mut self) {
        let text = self.filter.text().trim().to_owned();
        self.recalled = None;
        if !text.is_empty() {
            self.history.retain(|other| *other != text);
            self.history.push(text);
            drop(self.history.drain(..self.history.len().saturating_sub(MOST_REMEMBERED)));
        }
    }

    /// True if the filter's text may have changed.
    pub fn filter_key(&mut self, key: Key) -> bool {
        match key {
            Key::Enter => {
                self.filtering = false;
                self.remember();
            }
            Key::Escape => {
                self.filtering = false;
                self.filter.clear();
                return true;
            }
            _ => {
                // A space can only mean a further word.
                if key == Key::Char(' ') && self.filter.is_offered() {
                    self.filter.key(Key::End);
                }
                // Typing starts a new search: the best match is the first row.
                (self.selected, self.index) = (None, 0);
                return self.filter.key(key);
            }
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cursor_stays_on_its_row_while_others_come_and_go() {
        let mut table = Table::default();
        table.step(&["a", "b", "c"], 1);
        assert_eq!(table.position(&["x", "y", "a", "b"]), 3);
        assert_eq!(table.position(&["x"]), 0);
        assert_eq!(table.position::<&str>(&[]), 0);
        assert!(!table.step::<&str>(&[], 1));
    }

    #[test]
    fn earlier_filters_come_back_and_what_is_typed_is_never_replaced() {
        let mut table = Table::default();
        assert!(!table.recall(true), "there is none");
        for filter in ["odom", "camera", "odom"] {
            table.filter = Field::with(filter);
            table.filter_key(Key::Enter);
        }
        table.filter.clear();
        let mut seen = Vec::new();
        for earlier in [true, true, true, false, false] {
            assert!(table.recall(earlier));
            seen.push(table.filter.text().to_owned());
        }
        assert_eq!(seen, ["odom", "camera", "camera", "odom", ""]);
        table.filter = Field::with("new");
        assert!(!table.recall(true));
        assert_eq!(table.filter.text(), "new");
    }

    #[test]
    fn a_filter_that_stands_is_replaced_by_what_is_typed_or_changed_where_the_cursor_goes_into_it() {
        let standing = || {
            let mut table = Table { filter: Field::with("state:verified"), ..Table::default() };
            table.begin_filter();
            table
        };
        let mut table = standing();
        for character in "topic:".chars() {
            table.filter_key(Key::Char(character));
        }
        assert_eq!(table.filter.text(), "topic:");
        let mut table = standing();
        table.filter_key(Key::Char(' '));
        table.filter_key(Key::Char('x'));
        assert_eq!(table.filter.text(), "state:verified x", "a space adds to it");
        let mut table = standing();
        table.filter_key(Key::Backspace);
        table.filter_key(Key::Char('x'));
        assert_eq!(table.filter.text(), "state:verifiex", "the cursor is in it");
        let mut table = standing();
        table.filter_key(Key::Enter);
        assert_eq!((table.filter.text(), table.filtering), ("state:verified", false));
        // What was replaced is among the earlier ones, and an offered one goes to the one before.
        table.filter = Field::with("odom");
        table.begin_filter();
        assert!(table.recall(true));
        assert_eq!(table.filter.text(), "state:verified");
        let mut table = standing();
        table.filter_key(Key::Char('x'));
        table.filter.clear();
        assert!(table.recall(true));
        assert_eq!(table.filter.text(), "state:verified");
    }

    #[test]
    fn on_the_first_row_a_following_table_stays_with_the_newest() {
        let mut table = Table::following();
        table.select(&["new", "old"], 0);
        assert_eq!(table.position(&["newer", "new", "old"]), 0);
        table.step(&["newer", "new", "old"], 1);
        assert_eq!(table.position(&["newest", "newer", "new", "old"]), 2);
    }
}
