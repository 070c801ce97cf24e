//! Which records come next: all stored ones in the order of their capture, or, followed live, those verified from now
//! on, each stream in its order.

use std::collections::{HashMap, HashSet};
use std::time::{Duration, Instant};

use crate::model::{Address, Digest, RecordKind, RecordState, Scope, Timestamp, TopicId};
use crate::pipeline::reader::is_held;
use crate::service::command::{Pace, PlayWishes};
use crate::service::reply::Failure;
use crate::store::{Counts, Ledger, RecordQuery, RecordRow, Records};

/// Records requested from the ledger at a time.
const PAGE: usize = 500;

/// How far back a live feed, when it begins, looks for records that are not verified yet, nanoseconds.
const BEFORE: u64 = 60_000_000_000;

/// How much later than its neighbours a record may enter the ledger and still be seen at once, nanoseconds.
const SLACK: u64 = 500_000_000;

/// How much later it may come at all, nanoseconds; checked every so often.
const LATE: u64 = 30_000_000_000;
const LATE_LOOK: Duration = Duration::from_secs(10);

/// How often a live feed looks for further topics.
const LISTING: Duration = Duration::from_millis(500);

/// A record that may be played.
pub(super) struct Item {
    pub row: RecordRow,
    /// Played only if its publisher latches: it was verified before a live feed began.
    pub only_latched: bool,
}

/// The next step.
pub(super) struct Round {
    pub items: Vec<Item>,
    /// Nothing comes after it.
    pub is_last: bool,
}

/// The source of records.
pub(super) enum Feed {
    /// Stored records.
    Past(Box<RecordQuery>),
    /// Records verified from now on.
    Live(Live),
}

/// Streams that are followed.
#[derive(Default)]
pub(super) struct Live {
    streams: HashMap<(Address, TopicId), Stream>,
    listed: Option<Instant>,
    looked_late: Option<Instant>,
    /// Records that could not be played yet; their streams wait for them.
    pending: Vec<Item>,
}

#[derive(Default)]
struct Stream {
    /// Nothing captured before this is played.
    floor: Timestamp,
    /// Everything before this was given out.
    low: Timestamp,
    newest: Timestamp,
    done: HashMap<Digest, Timestamp>,
}

impl Feed {
    pub fn begin(ledger: &Ledger, wishes: &PlayWishes, givers: &HashMap<Address, Scope>) -> Result<Self, Failure> {
        if wishes.pace == Pace::Follow {
            return Ok(Self::Live(Live::default()));
        }
        let mut ids = Vec::new();
        for (owner, scope) in givers {
            ids.extend(topics_of(&ledger.counts, *owner, scope)?);
        }
        Ok(Self::Past(Box::new(RecordQuery {
            owners: Some(givers.keys().copied().collect()),
            topic_ids: Some(ids),
            kind: Some(RecordKind::Data),
            since: wishes.since,
            until: wishes.until,
            limit: PAGE,
            ..RecordQuery::default()
        })))
    }

    pub fn next(&mut self, ledger: &Ledger, givers: &HashMap<Address, Scope>) -> Result<Round, Failure> {
        match self {
            Self::Past(query) => {
                let page = ledger.records.list(query)?;
                let items = page.rows.into_iter().map(|row| Item { row, only_latched: false }).collect();
                query.after = page.next;
                Ok(Round { items, is_last: query.after.is_none() })
            }
            Self::Live(live) => live.next(ledger, givers),
        }
    }

    /// A record that could not be played now is given out again.
    pub fn again(&mut self, item: Item) {
        if let Self::Live(live) = self {
            live.pending.push(item);
        }
    }
}

impl Live {
    fn next(&mut self, ledger: &Ledger, givers: &HashMap<Address, Scope>) -> Result<Round, Failure> {
        let mut items = std::mem::take(&mut self.pending);
        items.retain(|item| givers.contains_key(&item.row.owner));
        let held: HashSet<_> = items.iter().map(|item| (item.row.owner, item.row.topic_id)).collect();
        self.streams.retain(|(owner, _), _| givers.contains_key(owner));
        if self.listed.is_none_or(|at| at.elapsed() >= LISTING) {
            items.extend(self.list(ledger, givers)?);
            self.listed = Some(Instant::now());
        }
        let late = self.looked_late.is_none_or(|at| at.elapsed() >= LATE_LOOK);
        if late {
            self.looked_late = Some(Instant::now());
        }
        let mut ready = Vec::new();
        for (key, stream) in self.streams.iter_mut().filter(|(key, _)| !held.contains(key)) {
            stream.take(&ledger.records, *key, late, &mut ready)?;
        }
        // Stable: records of one moment stay in the order of their stream.
        ready.sort_by_key(|row: &RecordRow| row.captured_at);
        items.extend(ready.into_iter().map(|row| Item { row, only_latched: false }));
        Ok(Round { items, is_last: false })
    }

    /// Follows the streams not followed yet. At the very beginning, records already verified are not played again, but
    /// the newest of each stream may be latched.
    fn list(&mut self, ledger: &Ledger, givers: &HashMap<Address, Scope>) -> Result<Vec<Item>, Failure> {
        let is_first = self.listed.is_none();
        let low = Timestamp(Timestamp::now().0.saturating_sub(BEFORE));
        let mut latched = Vec::new();
        for (owner, scope) in givers {
            for topic in topics_of(&ledger.counts, *owner, scope)? {
                if self.streams.contains_key(&(*owner, topic)) {
                    continue;
                }
                let mut stream = Stream { floor: low, low, ..Stream::default() };
                if is_first {
                    latched.extend(stream.skip_verified(&ledger.records, (*owner, topic))?);
                }
                self.streams.insert((*owner, topic), stream);
            }
        }
        Ok(latched)
    }
}

impl Stream {
    /// Marks verified records as done; returns the newest of them.
    fn skip_verified(&mut self, records: &Records, key: (Address, TopicId)) -> Result<Option<Item>, Failure> {
        let verified = RecordQuery { state: Some(RecordState::Verified), ..of_stream(key) };
        let mut query = RecordQuery { since: Some(self.low), ..verified.clone() };
        loop {
            let page = records.list(&query)?;
            self.done.extend(page.rows.iter().map(|row| (row.digest, row.captured_at)));
            query.after = page.next;
            if query.after.is_none() {
                break;
            }
        }
        let newest = records.list(&RecordQuery { newest_first: true, limit: 1, ..verified })?;
        Ok(newest.rows.into_iter().next().map(|row| Item { row, only_latched: true }))
    }

    /// Gives out settled records, up to the first that is not settled yet: later ones wait behind it, so that their
    /// order stays.
    fn take(
        &mut self,
        records: &Records,
        key: (Address, TopicId),
        late: bool,
        ready: &mut Vec<RecordRow>,
    ) -> Result<(), Failure> {
        let since = if late { self.low.min(Timestamp(self.newest.0.saturating_sub(LATE))) } else { self.low };
        let mut query = RecordQuery { since: Some(since.max(self.floor)), ..of_stream(key) };
        let (mut waiting, begun, now) = (None, ready.len(), Timestamp::now());
        'pages: loop {
            let page = records.list(&query)?;
            for row in page.rows {
                if self.done.contains_key(&row.digest) || is_held(&row) || row.state == RecordState::RightEnded {
                    continue;
                }
                if is_on_its_way(row.state) {
                    waiting = Some(row.captured_at);
                    break 'pages;
                }
                self.done.insert(row.digest, row.captured_at);
                // A clock that is ahead does not put the others' records behind any more than ours.
                self.newest = self.newest.max(row.captured_at.min(now));
                ready.push(row);
            }
            query.after = page.next;
            if query.after.is_none() || ready.len() - begun >= PAGE {
                break;
            }
        }
        let settled = Timestamp(self.newest.0.saturating_sub(SLACK)).max(self.low);
        self.low = waiting.map_or(settled, |waiting| settled.min(waiting));
        let kept = self.low.min(Timestamp(self.newest.0.saturating_sub(LATE)));
        self.done.retain(|_, at| *at >= kept);
        Ok(())
    }
}

fn of_stream((owner, topic): (Address, TopicId)) -> RecordQuery {
    RecordQuery {
        owner: Some(owner),
        topic_ids: Some(vec![topic]),
        kind: Some(RecordKind::Data),
        limit: PAGE,
        ..RecordQuery::default()
    }
}

fn is_on_its_way(state: RecordState) -> bool {
    use RecordState::{Batched, Captured, Confirmed, Mined, Stored, Submitted};
    matches!(state, Captured | Stored | Batched | Submitted | Mined | Confirmed)
}

fn topics_of(counts: &Counts, owner: Address, scope: &Scope) -> Result<Vec<TopicId>, Failure> {
    Ok(match scope {
        Scope::Topics(topics) => Vec::clone(topics),
        Scope::All => counts.by_state(Some(owner))?.topics.iter().filter_map(|topic| topic.topic_id).collect(),
    })
}
