//! The rows of the screen in view: which there are, the cursor among them, pages and marks.

use crate::app::{Feed, Key, Screen, State, Table};
use crate::screens::records::state::Records;

impl State {
    pub fn table(&self) -> Option<&Table> {
        self.table_of(self.screen)
    }

    pub fn table_mut(&mut self) -> Option<&mut Table> {
        self.table_of_mut(self.screen)
    }

    pub fn table_of(&self, screen: Screen) -> Option<&Table> {
        match screen {
            Screen::Topics => Some(&self.topics.table),
            Screen::Records => Some(&self.records.table),
            Screen::Received => Some(&self.received.table),
            Screen::Grants => Some(&self.grants.table),
            Screen::Log => Some(&self.log.table),
            Screen::Robots => Some(&self.gateway.table),
            Screen::Overview | Screen::Keys | Screen::Chain => None,
        }
    }

    pub fn table_of_mut(&mut self, screen: Screen) -> Option<&mut Table> {
        match screen {
            Screen::Topics => Some(&mut self.topics.table),
            Screen::Records => Some(&mut self.records.table),
            Screen::Received => Some(&mut self.received.table),
            Screen::Grants => Some(&mut self.grants.table),
            Screen::Log => Some(&mut self.log.table),
            Screen::Robots => Some(&mut self.gateway.table),
            Screen::Overview | Screen::Keys | Screen::Chain => None,
        }
    }

    pub fn row_keys(&self) -> Vec<String> {
        let ids = |rows: Vec<&crate::service::reply::RecordView>| rows.iter().map(|row| row.id.clone()).collect();
        match self.screen {
            Screen::Topics => self.topics.keys(),
            Screen::Records => ids(self.records.visible(&self.topics.rows)),
            Screen::Received => ids(self.received.visible(&self.topics.rows)),
            Screen::Grants => self.grants.keys(),
            Screen::Log => self.log.keys(),
            Screen::Robots => self.gateway.keys(),
            Screen::Overview | Screen::Keys | Screen::Chain => Vec::new(),
        }
    }

    pub fn has_rows(&self) -> bool {
        let plain = self.table().is_some_and(|table| table.filter.text().is_empty());
        match self.screen {
            Screen::Topics => self.topics.any_visible(),
            Screen::Records if plain => !self.records.rows.is_empty(),
            Screen::Received if plain => !self.received.rows.is_empty(),
            _ => !self.row_keys().is_empty(),
        }
    }

    pub fn row_key(&self) -> Option<String> {
        if self.screen == Screen::Topics {
            return self.topics.selected().map(|row| row.topic.clone());
        }
        let keys = self.row_keys();
        let position = self.table()?.position(&keys);
        keys.into_iter().nth(position)
    }

    /// Or else of the row under the cursor.
    pub fn marked_keys(&self) -> Vec<String> {
        let marks: Vec<String> = self.table().map(|table| table.marks.iter().cloned().collect()).unwrap_or_default();
        if marks.is_empty() { self.row_key().into_iter().collect() } else { marks }
    }

    /// Whether the rows on screen answer an earlier request while the present one is in flight.
    pub fn awaits_rows(&self) -> bool {
        self.records_feed().is_some_and(|feed| {
            let slot = self.feeds.slot(feed);
            let coming = slot.outstanding || slot.loaded && slot.stale && !self.holds(feed);
            coming && slot.failure.is_none() && !slot.is_answered()
        })
    }

    /// Whether the rows on screen answer the present request.
    pub fn rows_are_here(&self) -> bool {
        self.records_feed().is_some_and(|feed| {
            let slot = self.feeds.slot(feed);
            slot.is_answered() && slot.failure.is_none()
        })
    }

    fn records_feed(&self) -> Option<Feed> {
        match self.screen {
            Screen::Records => Some(Feed::Records),
            Screen::Received => Some(Feed::Received),
            _ => None,
        }
    }
}

/// At the edge of a page of records, turns the page.
pub fn step(state: &mut State, by: isize) {
    let keys = state.row_keys();
    let moved = state.table_mut().is_some_and(|table| table.step(&keys, by));
    if moved { stand(state) } else { turn_page(state, by) }
}

/// Keeps the record under the cursor in place.
pub fn stand(state: &mut State) {
    let Some(feed) = state.records_feed() else { return };
    let records = records(state, feed);
    if records.table.is_bound() {
        records.stand();
    }
}

pub fn select(state: &mut State, position: usize) {
    let keys = state.row_keys();
    if let Some(table) = state.table_mut() {
        table.select(&keys, position);
    }
    stand(state);
}

/// For records: the other of their two orders.
pub fn reverse(state: &mut State) {
    if state.records_feed().is_some() {
        return sort(state);
    }
    if let Some(table) = state.table_mut() {
        table.reversed = !table.reversed;
    }
}

/// To the first row of all, or the last of the page.
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

fn records(state: &mut State, feed: Feed) -> &mut Records {
    if feed == Feed::Received { &mut state.received } else { &mut state.records }
}

pub fn sort(state: &mut State) {
    let orders = state.screen.orders().len().max(1);
    if let Some(table) = state.table_mut() {
        table.sort = (table.sort + 1) % orders;
    }
    restart_records(state);
}

pub fn filter_key(state: &mut State, key: Key) {
    if state.table_mut().is_some_and(|table| table.filter_key(key)) {
        restart_records(state);
    }
    let keys = state.row_keys();
    if let Some(table) = state.table_mut().filter(|table| !table.filtering) {
        table.settle(&keys);
    }
}

pub fn filter_paste(state: &mut State, text: &str) {
    if let Some(table) = state.table_mut().filter(|table| table.filtering) {
        table.filter.insert(text);
        restart_records(state);
    }
}

/// The request changed: start at the first page.
pub fn restart_records(state: &mut State) {
    if let Some(feed) = state.records_feed() {
        records(state, feed).restart();
        state.feeds.renew(feed);
    }
}

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

pub fn mark(state: &mut State) {
    let (key, keys) = (state.row_key(), state.row_keys());
    let Some(table) = state.table_mut() else { return };
    if let Some(key) = key.filter(|key| !table.marks.remove(key)) {
        table.marks.insert(key);
    }
    table.step(&keys, 1);
}

pub fn dismiss(state: &mut State) {
    if let Some(toast) = state.toasts.dismiss() {
        return state.log.saw(&toast.text);
    }
    let Some(table) = state.table_mut() else { return };
    if table.filter.text().is_empty() {
        return table.marks.clear();
    }
    table.filter.clear();
    restart_records(state);
}
