//! One playback: each record is opened with the same checks as for viewing, and published only while its owner still
//! shares it.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::{oneshot, watch};
use tokio::task::block_in_place;

mod described;
mod rights;

use super::Bridge;
use super::feed::{Feed, Item};
use super::names::Names;
use super::pacer::{Pacer, TICK};
use super::target::{Form, Target};
use crate::crypto::{CryptoError, OpenedRecord};
use crate::model::{Address, ErrorKind, Hash, Scope, Timestamp, clean};
use crate::pipeline::reader::{Definitions, Reader, is_held};
use crate::pipeline::{Network, Owner, PipelineError, authority, importer};
use crate::service::command::{Pace, PlayWishes};
use crate::service::reply::{Failure, PlayEnd, PlayedView};
use crate::site::lifetime::Lifetime;
use crate::store::RecordRow;
use rights::{Keys, key_of};

/// Interval between looks for newly verified records.
const LOOK: Duration = Duration::from_millis(200);

/// Interval between looks at the rights; in addition, the right to each record is checked just before it is published.
const RIGHTS: Duration = Duration::from_millis(20);

/// The longest sleep without a look at what may end the playback.
const NAP: Duration = Duration::from_millis(50);

/// How long a subscriber that is far behind is waited for before it loses messages.
const CROWD: Duration = Duration::from_secs(5);

/// How long subscribers get for the rest of their queues at an orderly end.
const FAREWELL: Duration = Duration::from_secs(5);

/// Interval between registrations at the master, and between looks at the child process.
const REGISTERING: Duration = Duration::from_secs(5);

/// The most reasons of refusals reported.
const MOST_REASONS: usize = 20;

const NO_RIGHT: &str = "no active grant covers it, or no key of this profile opens it";

/// What may end it from outside.
pub(super) struct Ends {
    gone: oneshot::Receiver<()>,
    stopped: watch::Receiver<bool>,
    life: Arc<Lifetime>,
}

impl Ends {
    pub fn new(gone: oneshot::Receiver<()>, stopped: watch::Receiver<bool>, life: &Arc<Lifetime>) -> Self {
        Self { gone, stopped, life: Arc::clone(life) }
    }

    fn now(&mut self) -> Option<PlayEnd> {
        let is_gone = !matches!(self.gone.try_recv(), Err(oneshot::error::TryRecvError::Empty));
        if *self.stopped.borrow() || is_gone {
            return Some(PlayEnd::Asked);
        }
        (self.life.is_ending() || self.life.is_stopping()).then_some(PlayEnd::Site)
    }
}

/// The outcome for a record.
enum Taken {
    /// Played, or counted, or not requested.
    Done,
    /// It cannot be checked now.
    Later,
    /// The playback is over.
    Ended(PlayEnd),
}

/// A record that passed every check, with its source and name for playing.
struct Checked {
    record: OpenedRecord,
    form: Form,
    source: u64,
}

/// A running playback.
pub(super) struct Play<'a> {
    bridge: &'a Bridge,
    network: Network,
    owner: &'a Arc<Owner>,
    givers: HashMap<Address, Scope>,
    /// The transaction by which each owner granted what is played.
    granted: HashMap<Address, Hash>,
    wishes: &'a PlayWishes,
    names: Names,
    target: Target,
    ends: Ends,
    pacer: Pacer,
    clock: Option<String>,
    definitions: Definitions,
    rights_at: Instant,
    keys: Keys,
    registered_at: Instant,
    published: u64,
    refused: u64,
    missing: u64,
    reasons: BTreeMap<String, u64>,
    topics: BTreeMap<String, u64>,
}

impl<'a> Play<'a> {
    #[allow(clippy::too_many_arguments, reason = "its parts, created one by one")]
    pub fn new(
        bridge: &'a Bridge,
        network: &Network,
        owner: &'a Arc<Owner>,
        givers: HashMap<Address, Scope>,
        wishes: &'a PlayWishes,
        names: Names,
        target: Target,
        ends: Ends,
    ) -> Self {
        let now = Instant::now();
        let standing = authority::shared_with(&network.directory, owner.address);
        let granted = standing.into_iter().map(|grant| (grant.terms.owner, grant.transaction)).collect();
        Self {
            bridge,
            network: network.clone(),
            owner,
            givers,
            granted,
            wishes,
            names,
            target,
            ends,
            pacer: Pacer::new(wishes.pace),
            clock: None,
            definitions: Definitions::default(),
            rights_at: now,
            keys: Keys::default(),
            registered_at: now,
            published: 0,
            refused: 0,
            missing: 0,
            reasons: BTreeMap::new(),
            topics: BTreeMap::new(),
        }
    }

    /// Plays to the end.
    ///
    /// # Errors
    /// If chain, store, master or child process fail; what was queued is not sent then.
    pub async fn run(mut self) -> Result<PlayedView, Failure> {
        let begun = Instant::now();
        let mut ended = self.rounds().await;
        if let Ok(end) = &mut ended {
            *end = self.farewell(*end).await;
        }
        let by_right = ended.as_ref().map_or(true, |end| end.is_by_right());
        let (published, dropped, unconfirmed) = self.target.finish(self.published, by_right);
        let mut reasons: Vec<(String, u64)> = self.reasons.into_iter().collect();
        reasons.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        Ok(PlayedView {
            published,
            refused: self.refused,
            missing: self.missing,
            dropped,
            unconfirmed,
            seconds: begun.elapsed().as_secs_f64(),
            ended_by: ended?,
            reasons,
            topics: self.topics.into_iter().collect(),
        })
    }

    /// Sends subscribers the rest of their queues, as long as the right lasts.
    async fn farewell(&mut self, end: PlayEnd) -> PlayEnd {
        if end.is_by_right() {
            return end;
        }
        self.target.leave();
        let begun = Instant::now();
        while begun.elapsed() < FAREWELL && !self.target.is_sent() {
            if let Some(end) = self.right_ended() {
                return end;
            }
            tokio::time::sleep(TICK).await;
        }
        end
    }

    async fn rounds(&mut self) -> Result<PlayEnd, Failure> {
        self.show_clock()?;
        let ledger = &self.bridge.plant.ledger;
        let mut feed = block_in_place(|| Feed::begin(ledger, self.wishes, &self.givers))?;
        loop {
            if let Some(end) = self.end() {
                return Ok(end);
            }
            let round = block_in_place(|| feed.next(ledger, &self.givers))?;
            let is_idle = round.items.is_empty();
            let mut held = HashSet::new();
            for item in round.items {
                let stream = (item.row.owner, item.row.topic_id);
                if held.contains(&stream) {
                    feed.again(item);
                    continue;
                }
                match self.take(&item).await? {
                    Taken::Done => {}
                    Taken::Later => {
                        held.insert(stream);
                        feed.again(item);
                    }
                    Taken::Ended(end) => return Ok(end),
                }
            }
            if round.is_last {
                return Ok(PlayEnd::Whole);
            }
            if is_idle || self.wishes.pace == Pace::Follow {
                tokio::time::sleep(LOOK).await;
            }
        }
    }

    /// Checks one record, and plays it when it is due.
    async fn take(&mut self, item: &Item) -> Result<Taken, Failure> {
        let row = &item.row;
        if is_held(row) || (row.is_named() && !self.is_wanted(&row.topic)) {
            return Ok(Taken::Done);
        }
        if let Some(end) = self.connected().await {
            return Ok(Taken::Ended(end));
        }
        if !self.givers.contains_key(&row.owner) {
            return Ok(self.refuse(NO_RIGHT.to_owned()));
        }
        if self.keys.looked_for(key_of(row), Instant::now()) {
            return Ok(Taken::Later);
        }
        let opened = self.reader().open(row).await;
        let record = match opened {
            Ok(record) => record,
            Err(error) => return self.judge(row, error),
        };
        self.keys.came(key_of(row));
        if !self.is_wanted(&record.head.topic) {
            return Ok(Taken::Done);
        }
        let latching = record.head.tags.contains_key(importer::LATCHING);
        if item.only_latched && !latching {
            return Ok(Taken::Done);
        }
        match self.described(item, record, latching).await? {
            Ok(checked) => self.play(item, &checked).await,
            Err(why) => Ok(self.refuse(why)),
        }
    }

    async fn play(&mut self, item: &Item, checked: &Checked) -> Result<Taken, Failure> {
        let Checked { record, form, source } = checked;
        let source = (item.row.owner, *source);
        match self.target.show(form, source, record.body.len()) {
            Ok(Ok(())) => {}
            Ok(Err(why)) => return Ok(self.refuse(why)),
            // A master or a child process that restarts is back soon.
            Err(_) if self.wishes.pace == Pace::Follow => return Ok(Taken::Later),
            Err(failure) => return Err(failure),
        }
        let due = if item.only_latched { None } else { Some(record.header.captured_at) };
        if let Some(end) = self.until_due(due).await {
            return Ok(Taken::Ended(end));
        }
        // It may have been opened a while ago: the right is checked again.
        if !self.givers.contains_key(&item.row.owner) {
            return Ok(self.refuse(NO_RIGHT.to_owned()));
        }
        let allowed = self.reader().authorise(&item.row);
        if let Err(error) = allowed {
            return self.judge(&item.row, error);
        }
        if !self.target.publish(form, source, &record.body) {
            let follows = self.wishes.pace == Pace::Follow;
            return Ok(if follows { Taken::Later } else { self.refuse("nobody publishes it now".to_owned()) });
        }
        self.published += 1;
        *self.topics.entry(clean(form.topic(), 255)).or_default() += 1;
        Ok(Taken::Done)
    }

    fn reader(&self) -> Reader<'_> {
        Reader { plant: &self.bridge.plant, network: &self.network, reader: self.owner }
    }

    fn is_wanted(&self, topic: &str) -> bool {
        self.wishes.topics.is_empty() || self.wishes.topics.iter().any(|pattern| pattern.matches(topic))
    }

    /// Waits until a message is due, and for subscribers that are far behind.
    async fn until_due(&mut self, due: Option<Timestamp>) -> Option<PlayEnd> {
        let mut crowded_since = None;
        loop {
            if let Some(end) = self.end() {
                return Some(end);
            }
            self.tell_time();
            let left = due.map_or(Duration::ZERO, |due| self.pacer.wait(due, Instant::now()));
            let mut crowded = self.target.is_crowded();
            if crowded && crowded_since.get_or_insert_with(Instant::now).elapsed() >= CROWD {
                self.target.outrun();
                crowded = false;
            }
            if left.is_zero() && !crowded {
                return None;
            }
            let nap = if self.clock.is_some() { TICK } else { NAP };
            tokio::time::sleep(if crowded { TICK } else { left.min(nap) }).await;
        }
    }

    /// Waits for the chain: without it nobody knows who may read what.
    async fn connected(&mut self) -> Option<PlayEnd> {
        loop {
            if let Some(end) = self.end() {
                return Some(end);
            }
            if let Some(network) = self.bridge.link.network_now() {
                self.network = network;
                return None;
            }
            tokio::time::sleep(NAP).await;
        }
    }

    /// The reason to end the playback, if there is one by now.
    fn end(&mut self) -> Option<PlayEnd> {
        if let Some(end) = self.ends.now() {
            return Some(end);
        }
        if self.registered_at.elapsed() >= REGISTERING {
            self.target.come_back();
            self.registered_at = Instant::now();
        }
        self.right_ended()
    }

    /// A record that does not open is counted; a failure that is not the record's ends the playback, or is retried.
    fn judge(&mut self, row: &RecordRow, error: PipelineError) -> Result<Taken, Failure> {
        let follows = self.wishes.pace == Pace::Follow;
        match (&error, error.kind()) {
            (PipelineError::Missing(_) | PipelineError::Deleted(..) | PipelineError::Erased { .. }, _) => {
                self.missing += 1;
                Ok(Taken::Done)
            }
            (PipelineError::Crypto(CryptoError::FalseName(what)), _) => {
                Ok(self.refuse(format!("its signer wrote a false {what} into it")))
            }
            (_, ErrorKind::Tampered) => Ok(self.refuse("it differs from what was anchored and signed".to_owned())),
            (_, ErrorKind::Refused) => {
                self.rights_at = Instant::now().checked_sub(RIGHTS).unwrap_or(self.rights_at);
                if let Some(end) = self.end() {
                    return Ok(Taken::Ended(end));
                }
                let is_locked_up = matches!(error, PipelineError::Crypto(CryptoError::WrongKey));
                if follows && is_locked_up && self.awaits_key(row) {
                    return Ok(Taken::Later);
                }
                Ok(self.refuse(NO_RIGHT.to_owned()))
            }
            (_, ErrorKind::Unreachable | ErrorKind::Incomplete) if follows => Ok(Taken::Later),
            _ => Err(error.into()),
        }
    }

    fn refuse(&mut self, why: String) -> Taken {
        self.refused += 1;
        if self.reasons.len() < MOST_REASONS || self.reasons.contains_key(&why) {
            *self.reasons.entry(why).or_default() += 1;
        }
        Taken::Done
    }

    fn show_clock(&mut self) -> Result<(), Failure> {
        if !self.wishes.clock {
            return Ok(());
        }
        // Nodes read the time under this one name; on a graph this site captures from, it would be captured.
        let prefixed = if self.target.is_captured() { self.names.played("/clock") } else { None };
        let topic = prefixed.unwrap_or_else(|| "/clock".to_owned());
        let shown = self.target.show_clock(&topic)?;
        shown.map_err(|why| Failure::new(ErrorKind::Refused, why))?;
        self.clock = Some(topic);
        Ok(())
    }

    fn tell_time(&mut self) {
        if let (Some(topic), Some(now)) = (&self.clock, self.pacer.clock(Instant::now())) {
            self.target.tell_time(topic, now);
        }
    }
}
