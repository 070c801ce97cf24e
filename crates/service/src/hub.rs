//! Collects the workers' news and passes it on, at most four notes a second per part.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use tokio::sync::{Notify, broadcast, watch};

use crate::model::{Digest, Timestamp, clean, locked};
use crate::pipeline::Observer;
use crate::pipeline::session::Sessions;
use crate::pipeline::stages::Stages;
use crate::pipeline::watcher::foreign;
use crate::reply::{Event, NoticeLevel, Part};
use crate::store::notes::ForeignAnchors;

const PACE: Duration = Duration::from_millis(250);
/// Pause before the same alert is repeated.
const REPEAT: Duration = Duration::from_secs(30);
const MOST_ALERTS: usize = 200;
/// Of a notice, in characters.
const LONGEST: usize = 600;

const ACCOUNT: &str = "account";

const PARTS: [Part; 6] = [Part::Topics, Part::Uploads, Part::Grants, Part::Chain, Part::Health, Part::Identity];

pub struct Hub {
    events: broadcast::Sender<Event>,
    dirty: [AtomicBool; PARTS.len()],
    wake: Notify,
    /// When each text was sent last, and its subject.
    told: Mutex<HashMap<String, (Instant, Option<String>)>>,
    /// Captures that wait for records.
    pub sessions: Arc<Sessions>,
    /// Rings when stored records wait to be anchored.
    pub stored: Notify,
    /// Rings when records are deep enough to be verified.
    pub confirmed: Notify,
    pub stages: Stages,
    /// Counts changes of what readers may be told: rows of the feed, and rights, even if only announced.
    pub feed: watch::Sender<u64>,
}

impl Hub {
    pub fn new(events: broadcast::Sender<Event>) -> Self {
        Self {
            events,
            dirty: Default::default(),
            wake: Notify::new(),
            told: Mutex::default(),
            sessions: Arc::default(),
            stored: Notify::new(),
            confirmed: Notify::new(),
            stages: Stages::default(),
            feed: watch::channel(0).0,
        }
    }

    pub fn events(&self) -> &broadcast::Sender<Event> {
        &self.events
    }

    pub fn changed(&self, part: Part) {
        if let Some(index) = PARTS.iter().position(|other| *other == part) {
            self.dirty[index].store(true, Ordering::Release);
            self.wake.notify_one();
        }
    }

    pub fn feed_changed(&self) {
        self.feed.send_modify(|count| *count += 1);
    }

    pub fn inform(&self, text: &str) {
        self.notice(NoticeLevel::Info, text);
    }

    pub fn warn(&self, text: &str) {
        self.notice(NoticeLevel::Warning, text);
    }

    pub fn alarm(&self, text: &str) {
        self.notice(NoticeLevel::Error, text);
    }

    /// Sends a notice, unless the same text was sent within [`REPEAT`].
    pub fn notice(&self, level: NoticeLevel, text: &str) {
        self.tell_once(level, text, None);
    }

    /// Sends a lasting notice: it replaces the previous one about the same; an informational one clears it.
    pub fn notice_about(&self, about: &str, level: NoticeLevel, text: &str) {
        if level == NoticeLevel::Info {
            // What begins again is news.
            let mut told = locked(&self.told);
            told.retain(|_, (_, other)| other.as_deref() != Some(about));
        }
        self.tell_once(level, text, Some(about.to_owned()));
    }

    fn tell_once(&self, level: NoticeLevel, text: &str, about: Option<String>) {
        let text = clean(text, LONGEST);
        let mut told = locked(&self.told);
        if told.get(&text).is_some_and(|(at, _)| at.elapsed() < REPEAT) {
            return;
        }
        if told.len() >= MOST_ALERTS {
            told.clear();
        }
        told.insert(text.clone(), (Instant::now(), about.clone()));
        drop(told);
        // Having no listeners is not an error.
        drop(self.events.send(Event::Notice { at: Timestamp::now(), level, text, about }));
    }

    pub async fn run(self: Arc<Self>) {
        loop {
            self.wake.notified().await;
            for (index, part) in PARTS.into_iter().enumerate() {
                if self.dirty[index].swap(false, Ordering::AcqRel) {
                    drop(self.events.send(Event::Changed { part }));
                }
            }
            tokio::time::sleep(PACE).await;
        }
    }
}

impl Observer for Hub {
    fn records_changed(&self) {
        self.changed(Part::Uploads);
        self.stored.notify_waiters();
        self.confirmed.notify_one();
    }

    fn verified(&self, digests: &[Digest]) {
        self.sessions.settle(digests, true);
        self.feed_changed();
    }

    fn erased(&self) {
        self.feed_changed();
    }

    fn tampered(&self, digests: &[Digest]) {
        self.sessions.settle(digests, false);
    }

    fn directory_changed(&self) {
        self.feed_changed();
        for part in [Part::Grants, Part::Identity, Part::Chain] {
            self.changed(part);
        }
        self.stored.notify_waiters();
    }

    fn stages(&self) -> Option<&Stages> {
        Some(&self.stages)
    }

    fn publishers_doubted(&self) {
        self.changed(Part::Topics);
    }

    fn foreign_anchors(&self, found: &ForeignAnchors) {
        self.changed(Part::Health);
        // The first immediately, then ever fewer; the account's health keeps the count.
        if found.count.is_power_of_two() {
            self.notice_about(ACCOUNT, NoticeLevel::Error, &foreign::text(found));
        }
    }

    fn alert(&self, urgent: bool, text: String) {
        self.notice(if urgent { NoticeLevel::Error } else { NoticeLevel::Info }, &text);
    }
}
