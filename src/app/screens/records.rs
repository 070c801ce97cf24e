//! A page of records, live, never the whole ledger: Uploads and Shared.

use crate::app::fuzzy;
use crate::app::table::Table;
use crate::model::{Address, Party, RecordState, TopicName};
use crate::service::UploadQuery;
use crate::service::reply::{RecordPage, RecordView, TopicRow};

/// The page in view.
#[derive(Debug)]
pub struct Records {
    /// The rows of the page.
    pub rows: Vec<RecordView>,
    /// Cursor of the page behind this one.
    pub next: Option<String>,
    /// Cursors that led here; empty = first page.
    pub path: Vec<String>,
    /// Cursor in the table, filter; sort 0 = newest first, 1 = oldest first.
    pub table: Table,
}

impl Default for Records {
    fn default() -> Self {
        Self { rows: Vec::new(), next: None, path: Vec::new(), table: Table::following() }
    }
}

/// What a filter asks of the site, and what is left for the page.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// Only this topic.
    pub topic: Option<TopicName>,
    /// Only this state.
    pub state: Option<RecordState>,
    /// Only this owner.
    pub owner: Option<Party>,
    /// Words that only narrow the page on screen.
    pub rest: String,
}

impl Wanted {
    /// Reads a filter: state words, whole or unmistakable topic names, addresses.
    pub fn read(filter: &str, topics: &[TopicRow]) -> Self {
        let mut wanted = Self::default();
        for word in filter.split_whitespace() {
            if let Some(state) = RecordState::ALL.into_iter().find(|state| state.word() == word) {
                wanted.state = Some(state);
            } else if let Ok(owner) = word.parse::<Address>() {
                wanted.owner = Some(owner.into());
            } else if let Some(topic) = topic_named(word, topics) {
                wanted.topic = Some(topic);
            } else {
                wanted.rest.push_str(if wanted.rest.is_empty() { "" } else { " " });
                wanted.rest.push_str(word);
            }
        }
        wanted
    }
}

fn topic_named(word: &str, topics: &[TopicRow]) -> Option<TopicName> {
    if let Some(whole) = topics.iter().find(|row| row.topic == word) {
        return whole.topic.parse().ok();
    }
    let mut within = topics.iter().filter(|row| row.topic.contains(word));
    let only = within.next().filter(|_| within.next().is_none())?;
    only.topic.parse().ok()
}

impl Records {
    /// The question for the page in view.
    pub fn query(&self, topics: &[TopicRow], limit: usize) -> UploadQuery {
        let Wanted { topic, state, owner, .. } = Wanted::read(self.table.filter.text(), topics);
        UploadQuery {
            owner,
            topic,
            state,
            after: self.path.last().cloned(),
            limit: limit.clamp(1, 1_000),
            newest_first: self.table.sort == 0,
            ..UploadQuery::default()
        }
    }

    /// Takes a page over.
    pub fn set(&mut self, page: RecordPage, limit: usize) {
        self.rows = page.records;
        self.rows.truncate(limit.max(1));
        self.next = page.next;
    }

    /// The rows to show.
    pub fn visible(&self, topics: &[TopicRow]) -> Vec<&RecordView> {
        let rest = Wanted::read(self.table.filter.text(), topics).rest;
        fuzzy::narrow(&rest, self.rows.iter().collect(), |row| haystack(row))
    }

    /// Back to the first page, as after a new filter or order.
    pub fn restart(&mut self) {
        self.path.clear();
        self.table.select::<&str>(&[], 0);
    }

    /// To the page behind; false where there is none.
    pub fn forward(&mut self) -> bool {
        let Some(next) = self.next.take() else { return false };
        self.path.push(next);
        self.table.select::<&str>(&[], 0);
        true
    }

    /// To the page before; false on the first.
    pub fn back(&mut self) -> bool {
        self.table.select::<&str>(&[], 0);
        self.path.pop().is_some()
    }
}

fn haystack(row: &RecordView) -> String {
    let owner = row.owner.map(|owner| owner.to_string()).unwrap_or_default();
    format!("{} {} {} {} {} {owner}", row.id, row.topic, row.type_name, row.state, row.kind)
}
