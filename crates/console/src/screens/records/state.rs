//! Pages of records, and what their filter asks for.

use crate::app::{matching::narrow, table::Table};
use crate::model::{Address, Clock, RecordState, Timestamp, TopicPattern};
use crate::service::reply::{Caveat, RecordPage, RecordView, ShownState, TopicRow};
use crate::service::{Failure, UploadQuery, command::Term, command::filter::words};

#[derive(Debug, Default)]
pub struct Records {
    pub rows: Vec<RecordView>,
    /// Cursor of the next page.
    pub next: Option<String>,
    /// Cursors that led here; empty = first page.
    pub path: Vec<String>,
    /// Sort 0 = newest first, 1 = oldest first.
    pub table: Table,
    /// Hides younger records, so that the row of the cursor stays in place.
    pub anchor: Option<Timestamp>,
    /// The filter and when it was typed: `since:1m` counts from there, so that it stays the same request.
    pub typed: (String, Clock),
    /// Whether more records are on their way from the gateway.
    pub arriving: bool,
}

#[derive(Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// Without its page.
    pub asked: UploadQuery,
    /// Parts of ids, which only narrow the page on screen.
    pub rest: String,
}

impl Wanted {
    /// State words, topic names and patterns, addresses, and terms such as `owner:bob`.
    pub fn read(filter: &str, topics: &[TopicRow], clock: &Clock) -> Result<Self, Failure> {
        let mut wanted = Self::default();
        for word in words(filter) {
            let word = word.as_str();
            if let Some((term, text)) = Term::split(word)? {
                wanted.asked.take(term, text, clock)?;
                continue;
            }
            if wanted.asked.take(Term::State, word, clock).is_ok() {
                continue;
            }
            if let Ok(owner) = word.parse::<Address>() {
                wanted.asked.owner = Some(owner.into());
            } else if word.starts_with('/') && word.contains(['*', '?']) {
                wanted.asked.take(Term::Topic, word, clock)?;
            } else if let Some(topic) = topic_named(word, topics) {
                wanted.asked.topic = Some(topic);
            } else if !is_of_an_id(word) {
                wanted.asked.words.push(word.to_owned());
            } else {
                wanted.rest.push_str(if wanted.rest.is_empty() { "" } else { " " });
                wanted.rest.push_str(word);
            }
        }
        Ok(wanted)
    }
}

fn is_of_an_id(word: &str) -> bool {
    let hex = word.len() >= 6 && word.bytes().all(|byte| byte.is_ascii_hexdigit());
    hex && word.bytes().any(|byte| byte.is_ascii_digit())
}

fn topic_named(word: &str, topics: &[TopicRow]) -> Option<TopicPattern> {
    if let Some(whole) = topics.iter().find(|row| row.topic == word) {
        return whole.topic.parse().ok();
    }
    let mut within = topics.iter().filter(|row| row.topic.contains(word));
    let only = within.next().filter(|_| within.next().is_none())?;
    only.topic.parse().ok()
}

impl Records {
    /// Notes when the filter was typed, if it changed.
    pub fn note_filter(&mut self, clock: &Clock) {
        let text = self.table.filter.text();
        if text != self.typed.0 {
            self.typed = (text.to_owned(), clock.clone());
        }
    }

    /// What the filter says, or why it says nothing.
    pub fn wanted(&self, topics: &[TopicRow]) -> Result<Wanted, Failure> {
        Wanted::read(self.table.filter.text(), topics, &self.typed.1)
    }

    /// As of the moment of the freeze, if frozen.
    /// `None` while the filter says nothing.
    pub fn query(&self, topics: &[TopicRow], limit: usize, frozen: Option<Timestamp>) -> Option<UploadQuery> {
        let asked = self.wanted(topics).ok()?.asked;
        // The query's end is exclusive; the record of that very moment still shows.
        let stands = [self.anchor, frozen].into_iter().flatten().map(|at| Timestamp(at.0.saturating_add(1)));
        Some(UploadQuery {
            until: asked.until.into_iter().chain(stands).min(),
            after: self.path.last().cloned(),
            limit: limit.clamp(1, 1_000),
            newest_first: self.table.sort == 0,
            ..asked
        })
    }

    pub fn set(&mut self, page: RecordPage, limit: usize) {
        self.arriving = page.arriving.is_some();
        self.rows = page.records;
        self.rows.truncate(limit.max(1));
        self.next = page.next;
    }

    pub fn visible(&self, topics: &[TopicRow]) -> Vec<&RecordView> {
        if self.table.filter.text().is_empty() {
            return self.rows.iter().collect();
        }
        // Nothing is shown by a filter that cannot be read.
        let Ok(wanted) = self.wanted(topics) else { return Vec::new() };
        narrow(&wanted.rest, self.rows.iter().collect(), |row| haystack(row))
    }

    pub fn restart(&mut self) {
        self.path.clear();
        self.anchor = None;
        self.table.select::<&str>(&[], 0);
    }

    /// Once the cursor has left the newest record, nothing comes in above it.
    pub fn stand(&mut self) {
        if self.table.sort == 0 {
            self.anchor = self.anchor.or_else(|| self.rows.iter().map(|row| row.captured_at).max());
        }
    }

    /// False on the last page.
    pub fn forward(&mut self) -> bool {
        let Some(next) = self.next.take() else { return false };
        self.stand();
        self.path.push(next);
        self.table.select::<&str>(&[], 0);
        true
    }

    /// False on the first page.
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

pub fn is_settled(state: ShownState) -> bool {
    matches!(
        state,
        ShownState::Kept(RecordState::Verified) | ShownState::Verified(Caveat::NamesUnchecked) | ShownState::Refused(_)
    )
}
