//! A page of records, live, never the whole ledger: Uploads and Shared.

use crate::app::fuzzy;
use crate::app::table::Table;
use crate::app::when;
use crate::model::{Address, Party, RecordState, Timestamp, TopicName, TypeName};
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
    /// Nothing captured after it is shown, so that the row of the cursor stays where it is; `None` = the newest.
    pub anchor: Option<Timestamp>,
}

impl Default for Records {
    fn default() -> Self {
        Self { rows: Vec::new(), next: None, path: Vec::new(), table: Table::following(), anchor: None }
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
    /// Only this message type.
    pub type_name: Option<TypeName>,
    /// Only with these tags.
    pub tags: Vec<(String, String)>,
    /// Captured at or after.
    pub since: Option<Timestamp>,
    /// Captured before.
    pub until: Option<Timestamp>,
    /// Words of topics and types.
    pub words: Vec<String>,
    /// Parts of ids, which only narrow the page on screen.
    pub rest: String,
}

impl Wanted {
    /// Reads a filter: state words, whole or unmistakable topic names, addresses, and `owner:`, `topic:`, `type:`,
    /// `tag:name=value`, `since:1h`, `until:2026-12-31` with what they say.
    pub fn read(filter: &str, topics: &[TopicRow], now: Timestamp) -> Self {
        let mut wanted = Self::default();
        for word in filter.split_whitespace() {
            if word.split_once(':').is_some_and(|(name, value)| wanted.takes(name, value, now)) {
                continue;
            }
            if let Some(state) = RecordState::ALL.into_iter().find(|state| state.word() == word) {
                wanted.state = Some(state);
            } else if let Ok(owner) = word.parse::<Address>() {
                wanted.owner = Some(owner.into());
            } else if let Some(topic) = topic_named(word, topics) {
                wanted.topic = Some(topic);
            } else if !is_of_an_id(word) {
                wanted.words.push(word.to_owned());
            } else {
                wanted.rest.push_str(if wanted.rest.is_empty() { "" } else { " " });
                wanted.rest.push_str(word);
            }
        }
        wanted
    }
}

impl Wanted {
    /// Takes `name:value` over; false where it says nothing that can be asked for.
    fn takes(&mut self, name: &str, value: &str, now: Timestamp) -> bool {
        match name {
            "owner" => self.owner = value.parse().ok(),
            "topic" => self.topic = value.parse().ok(),
            "type" => self.type_name = value.parse().ok(),
            "state" => self.state = RecordState::ALL.into_iter().find(|state| state.word() == value),
            // As the state's own word begins.
            "waits" => self.state = Some(RecordState::RightEnded),
            "since" => self.since = when::past(value, now),
            "until" => self.until = when::past(value, now),
            "tag" => {
                let tag = value.split_once('=').map(|(name, value)| (name.to_owned(), value.to_owned()));
                let known = tag.is_some();
                self.tags.extend(tag);
                return known;
            }
            _ => return false,
        }
        match name {
            "owner" => self.owner.is_some(),
            "topic" => self.topic.is_some(),
            "type" => self.type_name.is_some(),
            "state" => self.state.is_some(),
            "since" => self.since.is_some(),
            _ => self.until.is_some(),
        }
    }
}

/// Whether it can only be a part of an id.
fn is_of_an_id(word: &str) -> bool {
    let hex = word.len() >= 6 && word.bytes().all(|byte| byte.is_ascii_hexdigit());
    hex && word.bytes().any(|byte| byte.is_ascii_digit())
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
    /// The question for the page in view, as of the moment at which the view stands still, if it does.
    pub fn query(&self, topics: &[TopicRow], limit: usize, now: Timestamp, frozen: Option<Timestamp>) -> UploadQuery {
        let Wanted { topic, state, owner, type_name, words, tags, since, until, .. } =
            Wanted::read(self.table.filter.text(), topics, frozen.unwrap_or(now));
        // What is asked for is captured before; the record of that moment itself is still shown.
        let stands = [self.anchor, frozen].into_iter().flatten().map(|at| Timestamp(at.0.saturating_add(1)));
        let until = until.into_iter().chain(stands).min();
        UploadQuery {
            owner,
            words,
            topic,
            type_name,
            tags,
            state,
            since,
            until,
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
    pub fn visible(&self, topics: &[TopicRow], now: Timestamp) -> Vec<&RecordView> {
        if self.table.filter.text().is_empty() {
            return self.rows.iter().collect();
        }
        let rest = Wanted::read(self.table.filter.text(), topics, now).rest;
        fuzzy::narrow(&rest, self.rows.iter().collect(), |row| haystack(row))
    }

    /// Back to the first page, as after a new filter or order.
    pub fn restart(&mut self) {
        self.path.clear();
        self.anchor = None;
        self.table.select::<&str>(&[], 0);
    }

    /// Whether newer records are left out.
    pub fn stands(&self) -> bool {
        self.anchor.is_some()
    }

    /// Where the cursor has left the newest record, nothing newer comes in above it.
    pub fn stand(&mut self) {
        if self.table.sort == 0 {
            self.anchor = self.anchor.or_else(|| self.rows.iter().map(|row| row.captured_at).max());
        }
    }

    /// To the page behind; false where there is none.
    pub fn forward(&mut self) -> bool {
        let Some(next) = self.next.take() else { return false };
        self.stand();
        self.path.push(next);
        self.table.select::<&str>(&[], 0);
        true
    }

    /// To the page before; false on the first.
    pub fn back(&mut self) -> bool {
        self.table.select::<&str>(&[], 0);
        self.path.pop().is_some() || self.anchor.take().is_some()
    }
}

fn haystack(row: &RecordView) -> String {
    let owner = row.owner.map(|owner| owner.to_string()).unwrap_or_default();
    let (state, kind) = (row.state.word(), row.kind.word());
    format!("{} {} {} {state} {kind} {owner}", row.id, row.topic, row.type_name)
}
