//! One running `capture`: how many messages of which topics it took, and what happened to them.

use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use tokio::sync::Notify;

use crate::model::Digest;

#[derive(Debug, Default)]
struct TopicTally {
    captured: AtomicU64,
    verified: AtomicU64,
    tampered: AtomicU64,
    quarantined: AtomicU64,
    lost: AtomicU64,
    skipped: AtomicU64,
    type_name: OnceLock<String>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TopicFigures {
    pub topic: String,
    pub type_name: Option<String>,
    /// Messages taken, including quarantined ones.
    pub captured: u64,
    pub verified: u64,
    /// Of these tampered or missing.
    pub tampered: u64,
    pub quarantined: u64,
    /// Lost in transport or in the recorder.
    pub lost: u64,
    /// Of another type than requested, and not taken.
    pub skipped: u64,
}

#[derive(Debug)]
pub struct CaptureSession {
    topics: BTreeMap<String, TopicTally>,
    limit: Option<u64>,
    tags: Vec<(String, String)>,
    /// Whether the outcome of its records is followed.
    followed: bool,
    acknowledged: AtomicU64,
    closed: AtomicBool,
    changed: Notify,
}

impl CaptureSession {
    /// A session for `topics`, which ends after `limit` messages of each.
    pub fn new(topics: &[String], limit: Option<u64>, tags: Vec<(String, String)>) -> Self {
        let topics = topics.iter().map(|topic| (topic.clone(), TopicTally::default())).collect();
        let closed = AtomicBool::new(limit == Some(0));
        let acknowledged = AtomicU64::new(0);
        Self { topics, limit, tags, followed: true, acknowledged, closed, changed: Notify::new() }
    }

    /// One that may last for months: the outcome of its records is read from the ledger, not kept in memory.
    pub fn unfollowed(topics: &[String], limit: Option<u64>, tags: Vec<(String, String)>) -> Self {
        Self { followed: false, ..Self::new(topics, limit, tags) }
    }

    pub fn tags(&self) -> &[(String, String)] {
        &self.tags
    }

    /// Counts a message; `false` if the session is closed or has enough of the topic.
    pub fn take(&self, topic: &str, type_name: &str) -> bool {
        let Some(tally) = self.topics.get(topic) else { return false };
        if self.closed.load(Ordering::Acquire) {
            return false;
        }
        let below = |count: u64| self.limit.is_none_or(|limit| count < limit).then_some(count + 1);
        if tally.captured.fetch_update(Ordering::AcqRel, Ordering::Acquire, below).is_err() {
            return false;
        }
        tally.type_name.get_or_init(|| type_name.to_owned());
        if self.is_full() {
            self.close();
        }
        true
    }

    /// Counts a message of a doubted publisher, which does not use up the limit; `false` if the session is closed.
    pub fn hold(&self, topic: &str) -> bool {
        let Some(tally) = self.topics.get(topic).filter(|_| !self.closed.load(Ordering::Acquire)) else { return false };
        tally.quarantined.fetch_add(1, Ordering::AcqRel);
        true
    }

    pub fn skip(&self, topic: &str) {
        if let Some(tally) = self.topics.get(topic).filter(|_| !self.closed.load(Ordering::Acquire)) {
            tally.skipped.fetch_add(1, Ordering::AcqRel);
        }
    }

    /// A counted message (`held`: as a doubted one) had to be dropped.
    pub fn dropped(&self, topic: &str, held: bool) {
        if let Some(tally) = self.topics.get(topic) {
            let counter = if held { &tally.quarantined } else { &tally.captured };
            counter.fetch_sub(1, Ordering::AcqRel);
            tally.lost.fetch_add(1, Ordering::AcqRel);
        }
        self.changed.notify_waiters();
    }

    pub fn lost_in_transport(&self, topic: &str, count: u64) {
        if let Some(tally) = self.topics.get(topic).filter(|_| !self.closed.load(Ordering::Acquire)) {
            tally.lost.fetch_add(count, Ordering::AcqRel);
        }
    }

    fn settle(&self, topic: &str, verified: bool) {
        if let Some(tally) = self.topics.get(topic) {
            let counter = if verified { &tally.verified } else { &tally.tampered };
            counter.fetch_add(1, Ordering::AcqRel);
        }
        self.changed.notify_waiters();
    }

    pub(crate) fn acknowledge(&self, messages: u64) {
        self.acknowledged.fetch_add(messages, Ordering::AcqRel);
        self.changed.notify_waiters();
    }

    pub fn is_acknowledged(&self) -> bool {
        let acknowledged = self.acknowledged.load(Ordering::Acquire);
        self.figures().iter().map(|topic| topic.captured).sum::<u64>() <= acknowledged
    }

    fn is_full(&self) -> bool {
        let full = |tally: &TopicTally| self.limit.is_some_and(|limit| tally.captured.load(Ordering::Acquire) >= limit);
        self.topics.values().all(full)
    }

    pub fn close(&self) {
        self.closed.store(true, Ordering::Release);
        self.changed.notify_waiters();
    }

    pub fn is_closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }

    pub async fn closed(&self) {
        self.wait_for(Self::is_closed).await;
    }

    /// Waits until it is closed and the outcome of every captured message is known.
    pub async fn settled(&self) {
        self.wait_for(|session| session.is_closed() && session.is_settled()).await;
    }

    async fn wait_for(&self, condition: impl Fn(&Self) -> bool) {
        loop {
            let notified = self.changed.notified();
            tokio::pin!(notified);
            notified.as_mut().enable();
            if condition(self) {
                return;
            }
            notified.await;
        }
    }

    fn is_settled(&self) -> bool {
        self.figures().iter().all(|topic| topic.verified + topic.tampered + topic.quarantined >= topic.captured)
    }

    pub fn figures(&self) -> Vec<TopicFigures> {
        let figures = |(topic, tally): (&String, &TopicTally)| TopicFigures {
            topic: topic.clone(),
            type_name: tally.type_name.get().cloned(),
            captured: tally.captured.load(Ordering::Acquire) + tally.quarantined.load(Ordering::Acquire),
            verified: tally.verified.load(Ordering::Acquire),
            tampered: tally.tampered.load(Ordering::Acquire),
            quarantined: tally.quarantined.load(Ordering::Acquire),
            lost: tally.lost.load(Ordering::Acquire),
            skipped: tally.skipped.load(Ordering::Acquire),
        };
        self.topics.iter().map(figures).collect()
    }
}

type Waiting = Vec<(Arc<CaptureSession>, Arc<str>)>;

#[derive(Debug, Default)]
pub struct Sessions {
    waiting: Mutex<HashMap<Digest, Waiting>>,
}

impl Sessions {
    pub fn wait(&self, digest: Digest, topic: &Arc<str>, sessions: &[Arc<CaptureSession>]) {
        let mut followed = sessions.iter().filter(|session| session.followed).peekable();
        if followed.peek().is_none() {
            return;
        }
        let entries = followed.map(|session| (Arc::clone(session), Arc::clone(topic)));
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner).entry(digest).or_default().extend(entries);
    }

    pub fn settle(&self, digests: &[Digest], verified: bool) {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        for (session, topic) in digests.iter().filter_map(|digest| waiting.remove(digest)).flatten() {
            session.settle(&topic, verified);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn ends_after_the_count_and_settles_when_all_is_verified() {
        let session = Arc::new(CaptureSession::new(&["/a".into()], Some(2), Vec::new()));
        let sessions = Sessions::default();
        assert!(session.take("/a", "x/Y"));
        assert!(!session.take("/b", "x/Y"));
        assert!(session.take("/a", "x/Y"));
        assert!(!session.take("/a", "x/Y"));
        session.closed().await;
        let topic: Arc<str> = "/a".into();
        for byte in [1, 2] {
            sessions.wait(Digest([byte; 32]), &topic, &[Arc::clone(&session)]);
        }
        sessions.settle(&[Digest([1; 32]), Digest([9; 32])], true);
        assert!(!session.is_settled());
        sessions.settle(&[Digest([2; 32])], false);
        session.settled().await;
        let figures = &session.figures()[0];
        assert_eq!((figures.captured, figures.verified, figures.tampered), (2, 1, 1));
    }

    #[test]
    fn a_dropped_message_is_lost_not_captured() {
        let session = CaptureSession::new(&["/a".into()], None, Vec::new());
        assert!(session.take("/a", "x/Y"));
        session.dropped("/a", false);
        session.lost_in_transport("/a", 3);
        let figures = &session.figures()[0];
        assert_eq!((figures.captured, figures.lost), (0, 4));
    }

    #[tokio::test]
    async fn held_messages_fill_no_quota_and_are_waited_for_by_nobody() {
        let session = CaptureSession::new(&["/a".into()], Some(1), Vec::new());
        assert!(session.hold("/a") && session.hold("/a") && !session.hold("/b"));
        session.dropped("/a", true);
        assert!(session.take("/a", "x/Y"));
        assert!(!session.hold("/a"), "closed");
        let figures = &session.figures()[0];
        assert_eq!((figures.captured, figures.quarantined, figures.lost), (2, 1, 1));
        assert!(!session.is_settled());
        session.settle("/a", true);
        session.settled().await;
    }
}
