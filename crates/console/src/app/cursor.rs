//! Cursor, filter, order and marks of the table on screen, whichever it is.

use super::feed::Feed;
use super::key::Key;
use super::screen::Screen;
use super::screens::{gateway, grants, topics};
use super::state::State;
use super::table::Table;

impl State {
    /// The table on screen.
    pub fn table(&self) -> Option<&Table> {
        match self.screen {
            Screen::Topics => Some(&self.topics.table),
            Screen::Uploads => Some(&self.uploads.table),
            Screen::Shared => Some(&self.shared.table),
            Screen::Grants => Some(&self.grants.table),
            Screen::Log => Some(&self.log.table),
            Screen::Gateway => Some(&self.gateway.table),
            Screen::Overview | Screen::Keys | Screen::Chain => None,
        }
    }

    /// The table on screen, mutable.
    pub fn table_mut(&mut self) -> Option<&mut Table> {
        match self.screen {
            Screen::Topics => Some(&mut self.topics.table),
            Screen::Uploads => Some(&mut self.uploads.table),
            Screen::Shared => Some(&mut self.shared.table),
            Screen::Grants => Some(&mut self.grants.table),
            Screen::Log => Some(&mut self.log.table),
            Screen::Gateway => Some(&mut self.gateway.table),
            Screen::Overview | Screen::Keys | Screen::Chain => None,
        }
    }

    /// The keys of the rows shown in the table on screen.
    pub fn row_keys(&self) -> Vec<String> {
        let ids = |rows: Vec<&crate::service::reply::RecordView>| rows.iter().map(|row| row.id.clone()).collect();
        match self.screen {
            Screen::Topics => self.topics.keys(),
            Screen::Uploads => ids(self.uploads.visible(&self.topics.rows)),
            Screen::Shared => ids(self.shared.visible(&self.topics.rows)),
            Screen::Grants => self.grants.keys(),
            Screen::Log => self.log.keys(),
            Screen::Gateway => self.gateway.keys(),
            Screen::Overview | Screen::Keys | Screen::Chain => Vec::new(),
        }
    }

    /// Whether the table on screen shows any row.
    pub fn has_rows(&self) -> bool {
        let plain = self.table().is_some_and(|table| table.filter.text().is_empty());
        match self.screen {
            Screen::Topics => self.topics.any_visible(),
            Screen::Uploads if plain => !self.uploads.rows.is_empty(),
            Screen::Shared if plain => !self.shared.rows.is_empty(),
            _ => !self.row_keys().is_empty(),
        }
    }

    /// The key of the row under the cursor.
    pub fn row_key(&self) -> Option<String> {
        if self.screen == Screen::Topics {
            return self.topics.selected().map(|row| row.topic.clone());
        }
        let keys = self.row_keys();
        let position = self.table()?.position(&keys);
        keys.into_iter().nth(position)
    }

    /// Whether the rows of the records on screen answer an earlier request, and those of the present one are on their way.
    pub fn awaits_rows(&self) -> bool {
        self.records_feed().is_some_and(|feed| {
            let slot = self.feeds.slot(feed);
            let coming = slot.outstanding || slot.loaded && slot.stale && !self.holds(feed);
            coming && slot.failure.is_none() && !slot.is_answered()
        })
    }

    /// Whether the rows of the records on screen answer the present request.
    pub fn rows_are_here(&self) -> bool {
        self.records_feed().is_some_and(|feed| {
            let slot = self.feeds.slot(feed);
            slot.is_answered() && slot.failure.is_none()
        })
    }

    fn records_feed(&self) -> Option<Feed> {
        match self.screen {
            Screen::Uploads => Some(Feed::Uploads),
            Screen::Shared => Some(Feed::Shared),
            _ => None,
        }
    }
}

/// Moves the cursor; at the edge of a page of records the next or previous page is requested.
pub fn step(state: &mut State, by: isize) {
    let keys = state.row_keys();
    let moved = state.table_mut().is_some_and(|table| table.step(&keys, by));
    if moved { stand(state) } else { turn_page(state, by) }
}

/// A list of records whose cursor is on one of them keeps that record in its place.
pub fn stand(state: &mut State) {
    let Some(feed) = state.records_feed() else { return };
    let records = records(state, feed);
    if records.table.is_bound() && !records.stands() {
        records.stand();
    }
}

/// Moves the cursor to the row with that number.
pub fn select(state: &mut State, position: usize) {
    let keys = state.row_keys();
    if let Some(table) = state.table_mut() {
        table.select(&keys, position);
    }
    stand(state);
}

/// Reverses the order of the table on screen; for records this is the other of their two orders.
pub fn reverse(state: &mut State) {
    if state.records_feed().is_some() {
        return sort(state);
    }
    if let Some(table) = state.table_mut() {
        table.reversed = !table.reversed;
    }
}

/// To the very first row, or to the last of the page.
pub fn jump(state: &mut State, last: bool) {
    if let (false, Some(feed)) = (last, state.records_feed()) {
        records(state, feed).restart();
        state.feeds.renew(feed);
    }
    select(state, if last { usize::MAX } else { 0 });
}

fn turn_page(state: &mut State, by: isize) {
    let Some(feed) = state.records_feed() else { return };
    let records = records(state, feed);
    let turned = if by > 0 { records.forward() } else { records.back() };
    if turned {
        state.feeds.renew(feed);
    }
}

fn records(state: &mut State, feed: Feed) -> &mut super::screens::records::Records {
    if feed == Feed::Shared { &mut state.shared } else { &mut state.uploads }
}

/// The next order of the table on screen.
pub fn sort(state: &mut State) {
    let orders = match state.screen {
        Screen::Topics => topics::SORTS.len(),
        Screen::Grants => grants::SORTS.len(),
        Screen::Gateway => gateway::SORTS.len(),
        _ => 2,
    };
    if let Some(table) = state.table_mut() {
        table.sort = (table.sort + 1) % orders;
    }
    restart_records(state);
}

/// A key while a filter is typed.
pub fn filter_key(state: &mut State, key: Key) {
    if state.table_mut().is_some_and(|table| table.filter_key(key)) {
        restart_records(state);
    }
    let keys = state.row_keys();
    if let Some(table) = state.table_mut().filter(|table| !table.filtering) {
        table.settle(&keys);
    }
}

/// Text pasted while a filter is typed.
pub fn filter_paste(state: &mut State, text: &str) {
    if let Some(table) = state.table_mut().filter(|table| table.filtering) {
        table.filter.insert(text);
        restart_records(state);
    }
}

/// The request changed, so the visible page begins anew.
pub fn restart_records(state: &mut State) {
    if let Some(feed) = state.records_feed() {
        records(state, feed).restart();
        state.feeds.renew(feed);
    }
}

/// Marks every row shown, or clears all marks.
pub fn mark_all(state: &mut State) {
    let keys = state.row_keys();
    if let Some(table) = state.table_mut() {
        if keys.iter().all(|key| table.marks.contains(key)) {
            table.marks.clear();
        } else {
            table.marks.extend(keys);
        }
    }
}
