//! A page of records, live, never the whole ledger: Uploads and Shared.

use crate::app::palette;
use crate::app::table::Table;
use crate::model::{Address, RecordState, Timestamp, TopicName};
use crate::service::UploadQuery;
use crate::service::command::Term;
use crate::service::reply::{RecordPage, RecordView, TopicRow};

/// The page in view.
#[derive(Debug)]
pub struct Records {
    /// The rows of the page.
    pub rows: Vec<RecordView>,
    /// Cursor of the page after this one.
    pub next: Option<String>,
    /// Cursors that led here; empty = first page.
    pub path: Vec<String>,
    /// Cursor in the table, filter; sort 0 = newest first, 1 = oldest first.
    pub table: Table,
    /// Nothing captured after it is shown, so that the row of the cursor stays in place; `None` = the newest.
    pub anchor: Option<Timestamp>,
    /// The filter, and the moment when it was typed: `since:1m` is a minute before it, to the nanosecond, for as long as
    /// the filter stays, so that it stays the same request too.
    typed: (String, Timestamp),
    /// Whether more records are on their way from the gateway.
    pub arriving: bool,
}

impl Default for Records {
    fn default() -> Self {
        Self {
            rows: Vec::new(),
            next: None,
            path: Vec::new(),
            table: Table::following(),
            anchor: None,
            typed: (String::new(), Timestamp(0)),
            arriving: false,
        }
    }
}

/// The part of a filter that the site answers, and the part applied to the page.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// The query; its page is not set here.
    pub asked: UploadQuery,
    /// Parts of ids, which only narrow the page on screen.
    pub rest: String,
}

impl Wanted {
    /// Parses a filter: state words, complete or unambiguous topic names, addresses, and the terms of the command line
    /// with their values: `owner:bob`, `tag:name=value`, `since:1h`, `until:2026-12-31`. Spans count back from `now`.
    pub fn read(filter: &str, topics: &[TopicRow], now: Timestamp) -> Self {
        let mut wanted = Self::default();
        for word in filter.split_whitespace() {
            if word.split_once(':').is_some_and(|(name, value)| wanted.takes(name, value, now)) {
                continue;
            }
            if wanted.asked.take(Term::State, word, now).is_ok() {
                continue;
            }
            if let Ok(owner) = word.parse::<Address>() {
                wanted.asked.owner = Some(owner.into());
            } else if let Some(topic) = topic_named(word, topics) {
                wanted.asked.topic = Some(topic);
            } else if !is_of_an_id(word) {
                wanted.asked.words.push(word.to_owned());
            } else {
                wanted.rest.push_str(if wanted.rest.is_empty() { "" } else { " " });
                wanted.rest.push_str(word);
            }
        }
        wanted
    }

    /// Adds `name:value`; false if the site cannot be asked for it.
    fn takes(&mut self, name: &str, value: &str, now: Timestamp) -> bool {
        // A prefix of the state's word.
        if name == "waits" {
            self.asked.state = Some(RecordState::RightEnded);
            return true;
        }
        Term::named(name).is_some_and(|term| self.asked.take(term, value, now).is_ok())
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
    /// Notes when the filter was typed, if it is another one than before.
    pub fn note_filter(&mut self, now: Timestamp) {
        let text = self.table.filter.text();
        if text != self.typed.0 {
            self.typed = (text.to_owned(), now);
        }
    }

    /// What the filter asks for.
    pub fn wanted(&self, topics: &[TopicRow]) -> Wanted {
        Wanted::read(self.table.filter.text(), topics, self.typed.1)
    }

    /// The request for the visible page, as of the moment of the freeze, if there is one.
    pub fn query(&self, topics: &[TopicRow], limit: usize, frozen: Option<Timestamp>) -> UploadQuery {
        let asked = self.wanted(topics).asked;
        // The query's end is exclusive; the record of that very moment is still shown.
        let stands = [self.anchor, frozen].into_iter().flatten().map(|at| Timestamp(at.0.saturating_add(1)));
        UploadQuery {
            until: asked.until.into_iter().chain(stands).min(),
            after: self.path.last().cloned(),
            limit: limit.clamp(1, 1_000),
            newest_first: self.table.sort == 0,
            ..asked
        }
    }

    /// Takes over a page.
    pub fn set(&mut self, page: RecordPage, limit: usize) {
        self.arriving = page.arriving.is_some();
        self.rows = page.records;
        self.rows.truncate(limit.max(1));
        self.next = page.next;
    }

    /// The rows to show.
    pub fn visible(&self, topics: &[TopicRow]) -> Vec<&RecordView> {
        if self.table.filter.text().is_empty() {
            return self.rows.iter().collect();
        }
        let rest = self.wanted(topics).rest;
        palette::narrow(&rest, self.rows.iter().collect(), |row| haystack(row))
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

    /// If the cursor has left the newest record, nothing newer comes in above it.
    pub fn stand(&mut self) {
        if self.table.sort == 0 {
            self.anchor = self.anchor.or_else(|| self.rows.iter().map(|row| row.captured_at).max());
        }
    }

    /// To the next page; false if there is none.
    pub fn forward(&mut self) -> bool {
        let Some(next) = self.next.take() else { return false };
        self.stand();
        self.path.push(next);
        self.table.select::<&str>(&[], 0);
        true
    }

    /// To the previous page; false on the first.
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
