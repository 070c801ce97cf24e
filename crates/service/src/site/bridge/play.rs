//! One playback: each record passes the checks of a view, and its owner must still share it.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::time::{Duration, Instant};

use tokio::sync::{oneshot, watch};
use tokio::task::block_in_place;

use super::target::{Form, NO_MESSAGE, NOBODY, Source, Stop, Target, offer};
use super::{Feed, Item};
use super::{Givers, Names, consistent, subject};
use crate::command::{Pace, PlayWishes};
use crate::crypto::sm3::sm3;
use crate::crypto::{CryptoError, OpenedRecord};
use crate::model::{Address, ErrorKind, Hash, Timestamp, TopicId, Verdict, clean, counted};
use crate::pipeline::{Definitions, Network, Opening, Owner, PipelineError, Reader, authority, importer, is_held};
use crate::reply::{Failure, PlayEnd, PlayedView, Result};
use crate::ros::Advertised;
use crate::ros::recording::Encoding;
use crate::ros::recording::tags::CHANNEL;
use crate::ros::ros2::{LONGEST_MESSAGE, Offered, WRITER};
use crate::site::Bridge;
use crate::store::RecordRow;

const LOOK: Duration = Duration::from_millis(200);
/// As in `rosbag play --clock`.
const TICK: Duration = Duration::from_millis(10);

/// In addition, each record's right is checked before it is published.
const RIGHTS: Duration = Duration::from_millis(20);

const NAP: Duration = Duration::from_millis(50);

/// How long a slow subscriber may delay the others before it loses messages.
const CROWD: Duration = Duration::from_secs(5);

const FAREWELL: Duration = Duration::from_secs(5);

const REGISTERING: Duration = Duration::from_secs(5);

const MOST_REASONS: usize = 20;

const NO_RIGHT: &str = "no active grant covers it, or no key of this profile opens it";

#[derive(Default)]
struct Tally {
    published: u64,
    refused: u64,
    missing: u64,
    reasons: BTreeMap<String, u64>,
    topics: BTreeMap<String, u64>,
}

struct Play<'a> {
    bridge: &'a Bridge,
    network: Network,
    owner: &'a Owner,
    givers: Givers,
    granted: HashMap<Address, Hash>,
    wishes: &'a PlayWishes,
    names: Names,
    target: Box<dyn Target>,
    /// Resolves when nobody waits for the answer any more.
    gone: oneshot::Receiver<()>,
    stopped: watch::Receiver<bool>,
    pacer: Pacer,
    clock: Option<String>,
    definitions: Definitions,
    rights_at: Instant,
    keys: Keys,
    registered_at: Instant,
    tally: Tally,
}

impl Bridge {
    pub async fn play(&self, owner: &Owner, wishes: PlayWishes, gone: oneshot::Receiver<()>) -> Result<PlayedView> {
        let names = Names::of(&wishes)?;
        consistent(&wishes)?;
        let network = self.parts.link.network().await?;
        let givers = self.givers(owner, &network, &wishes)?;
        let (target, is_captured) = match wishes.domain {
            Some(domain) => self.domain(domain, &names)?,
            None => self.stage(&wishes, &names).await?,
        };
        let subject = subject(&wishes, target.name());
        let play = Play {
            bridge: self,
            granted: granted_to(owner, &network),
            network,
            owner,
            givers,
            wishes: &wishes,
            names,
            target,
            gone,
            stopped: self.listed(&owner.profile),
            pacer: Pacer::new(wishes.pace),
            clock: None,
            definitions: Definitions::default(),
            rights_at: Instant::now(),
            keys: Keys::default(),
            registered_at: Instant::now(),
            tally: Tally::default(),
        };
        self.parts.log.deed(&owner.profile, "play records", &subject, play.run(is_captured)).await
    }
}

fn granted_to(reader: &Owner, network: &Network) -> HashMap<Address, Hash> {
    let standing = authority::shared_with(&network.directory, reader.address);
    standing.into_iter().map(|grant| (grant.terms.owner, grant.transaction)).collect()
}

impl Play<'_> {
    async fn run(mut self, is_captured: bool) -> Result<PlayedView> {
        let begun = Instant::now();
        let mut ended = self.rounds(is_captured).await;
        if let Ok(end) = &mut ended {
            *end = self.farewell(*end).await;
        }
        let by_right = ended.as_ref().map_or(true, |end| end.is_by_right());
        let Tally { published, refused, missing, reasons, topics } = self.tally;
        let (published, dropped, unconfirmed) = self.target.finish(published, by_right);
        let mut reasons: Vec<(String, u64)> = reasons.into_iter().collect();
        reasons.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        Ok(PlayedView {
            published,
            refused,
            missing,
            dropped,
            unconfirmed,
            seconds: begun.elapsed().as_secs_f64(),
            ended_by: ended?,
            reasons,
            topics: topics.into_iter().collect(),
        })
    }

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

    async fn rounds(&mut self, is_captured: bool) -> Result<PlayEnd> {
        self.show_clock(is_captured)?;
        let ledger = &self.bridge.parts.plant.ledger;
        let mut feed = block_in_place(|| Feed::begin(ledger, self.wishes, &self.givers))?;
        loop {
            if let Err(end) = self.end() {
                return Ok(end);
            }
            let (items, is_last) = block_in_place(|| feed.next(ledger, &self.givers))?;
            let is_idle = items.is_empty();
            let mut held = HashSet::new();
            for item in items {
                let stream = (item.row.owner, item.row.topic_id);
                if held.contains(&stream) {
                    feed.again(item);
                    continue;
                }
                match self.take(&item).await {
                    Ok(()) => {}
                    Err(Stop::Refused(why)) => self.refuse(why),
                    Err(Stop::Missing) => self.tally.missing += 1,
                    Err(Stop::Later) => {
                        held.insert(stream);
                        feed.again(item);
                    }
                    Err(Stop::Ended(end)) => return Ok(end),
                    Err(Stop::Failed(failure)) => return Err(failure),
                }
            }
            if is_last {
                return Ok(PlayEnd::Whole);
            }
            if is_idle || self.wishes.pace == Pace::Follow {
                tokio::time::sleep(LOOK).await;
            }
        }
    }

    async fn take(&mut self, item: &Item) -> Result<(), Stop> {
        let row = &item.row;
        if is_held(row) || (row.is_named() && !self.is_wanted(&row.topic)) {
            return Ok(());
        }
        self.connected().await.map_err(Stop::Ended)?;
        self.is_given(row)?;
        if self.keys.looked_for(key_of(row), Instant::now()) {
            return Err(Stop::Later);
        }
        let opened = self.reader().open(row).await;
        let record = opened.map_err(|error| self.judge(row, error))?;
        self.keys.came(key_of(row));
        let is_passed = item.only_latched && !record.head.tags.contains_key(importer::LATCHING);
        if is_passed || !self.is_wanted(&record.head.topic) {
            return Ok(());
        }
        let (form, source) = self.described(item, &record).await?;
        self.play(item, &record, &form, source).await
    }

    async fn play(&mut self, item: &Item, record: &OpenedRecord, form: &Form, source: Source) -> Result<(), Stop> {
        let follows = self.wishes.pace == Pace::Follow;
        match self.target.show(form, source, record.body.len()) {
            // A restarting master or child process is back soon.
            Err(Stop::Failed(_)) if follows => return Err(Stop::Later),
            shown => shown?,
        }
        let due = Some(record.header.captured_at).filter(|_| !item.only_latched);
        self.until_due(due).await.map_err(Stop::Ended)?;
        // It may have been opened a while ago.
        self.is_given(&item.row)?;
        let allowed = self.reader().authorise(&item.row);
        allowed.map_err(|error| self.judge(&item.row, error))?;
        if !self.target.publish(form, source, &record.body) {
            return Err(if follows { Stop::Later } else { Stop::Refused("nobody publishes it now".to_owned()) });
        }
        self.tally.published += 1;
        *self.tally.topics.entry(clean(form.topic(), 255)).or_default() += 1;
        Ok(())
    }

    fn is_given(&self, row: &RecordRow) -> Result<(), Stop> {
        if self.givers.contains_key(&row.owner) { Ok(()) } else { Err(Stop::Refused(NO_RIGHT.to_owned())) }
    }

    fn reader(&self) -> Reader<'_> {
        Reader { plant: &self.bridge.parts.plant, network: &self.network, reader: self.owner }
    }

    fn is_wanted(&self, topic: &str) -> bool {
        self.wishes.topics.is_empty() || self.wishes.topics.iter().any(|pattern| pattern.matches(topic))
    }

    async fn until_due(&mut self, due: Option<Timestamp>) -> Result<(), PlayEnd> {
        let mut crowded_since = None;
        loop {
            self.end()?;
            self.tell_time();
            let left = due.map_or(Duration::ZERO, |due| self.pacer.wait(due, Instant::now()));
            let mut crowded = self.target.is_crowded();
            if crowded && crowded_since.get_or_insert_with(Instant::now).elapsed() >= CROWD {
                self.target.outrun();
                crowded = false;
            }
            if left.is_zero() && !crowded {
                return Ok(());
            }
            let nap = if self.clock.is_some() { TICK } else { NAP };
            tokio::time::sleep(if crowded { TICK } else { left.min(nap) }).await;
        }
    }

    async fn connected(&mut self) -> Result<(), PlayEnd> {
        loop {
            self.end()?;
            if let Some(network) = self.bridge.parts.link.network_now() {
                self.network = network;
                return Ok(());
            }
            tokio::time::sleep(NAP).await;
        }
    }

    fn end(&mut self) -> Result<(), PlayEnd> {
        let is_gone = !matches!(self.gone.try_recv(), Err(oneshot::error::TryRecvError::Empty));
        if *self.stopped.borrow() || is_gone {
            return Err(PlayEnd::Asked);
        }
        let life = &self.bridge.parts.life;
        if life.is_ending() || life.is_stopping() {
            return Err(PlayEnd::Site);
        }
        if self.registered_at.elapsed() >= REGISTERING {
            self.target.come_back();
            self.registered_at = Instant::now();
        }
        self.right_ended().map_or(Ok(()), Err)
    }

    fn judge(&mut self, row: &RecordRow, error: PipelineError) -> Stop {
        let follows = self.wishes.pace == Pace::Follow;
        match (&error, error.kind()) {
            (PipelineError::Missing(_) | PipelineError::Deleted(..) | PipelineError::Erased { .. }, _) => Stop::Missing,
            (PipelineError::Crypto(CryptoError::FalseName(what)), _) => {
                Stop::Refused(format!("its signer wrote a false {what} into it"))
            }
            (_, ErrorKind::Tampered) => Stop::Refused("it differs from what was anchored and signed".to_owned()),
            (_, ErrorKind::Refused) => {
                self.rights_at = Instant::now().checked_sub(RIGHTS).unwrap_or(self.rights_at);
                if let Err(end) = self.end() {
                    return Stop::Ended(end);
                }
                let is_locked_up = matches!(error, PipelineError::Crypto(CryptoError::WrongKey));
                if follows && is_locked_up && self.awaits_key(row) {
                    return Stop::Later;
                }
                Stop::Refused(NO_RIGHT.to_owned())
            }
            (_, ErrorKind::Unreachable | ErrorKind::Incomplete) if follows => Stop::Later,
            _ => Stop::Failed(error.into()),
        }
    }

    fn refuse(&mut self, why: String) {
        self.tally.refused += 1;
        let reasons = &mut self.tally.reasons;
        if reasons.len() < MOST_REASONS || reasons.contains_key(&why) {
            *reasons.entry(why).or_default() += 1;
        }
    }

    fn show_clock(&mut self, is_captured: bool) -> Result<()> {
        if !self.wishes.clock {
            return Ok(());
        }
        // Nodes read the time under this one name; a captured graph would record it.
        let prefixed = if is_captured { self.names.played("/clock") } else { None };
        let topic = prefixed.unwrap_or_else(|| "/clock".to_owned());
        let (form, _) = self.target.clock(&topic, Timestamp::default());
        self.target.show(&form, NOBODY, 0).map_err(Stop::into_failure)?;
        self.clock = Some(topic);
        Ok(())
    }

    fn tell_time(&mut self) {
        if let (Some(topic), Some(now)) = (&self.clock, self.pacer.clock(Instant::now())) {
            let (form, message) = self.target.clock(topic, now);
            self.target.publish(&form, NOBODY, &message);
        }
    }

    async fn described(&mut self, item: &Item, record: &OpenedRecord) -> Result<(Form, Source), Stop> {
        if record.verdict != Verdict::Verified {
            return Err(Stop::Refused("not verified yet".to_owned()));
        }
        let encoding = importer::encoding(&record.head.tags);
        if let Some(why) = self.target.objection(encoding) {
            return Err(Stop::Refused(why.to_owned()));
        }
        let Some(topic) = self.names.played(&record.head.topic) else {
            let topic = clean(&record.head.topic, 255);
            return Err(Stop::Refused(format!("{topic} is not a valid graph name with this prefix")));
        };
        if self.clock.as_ref() == Some(&topic) {
            return Err(Stop::Refused(format!("--clock publishes the time as {topic} instead")));
        }
        let form = match encoding {
            Encoding::Ros1 => self.of_one(item, record, topic).await?,
            Encoding::Cdr { .. } => of_two(record, topic).map_err(Stop::Refused)?,
            Encoding::Beside(_) => return Err(Stop::Refused(NO_MESSAGE.to_owned())),
        };
        // Publishers of one ROS 1 node share its name; those of ROS 2 have ids.
        let writer = record.head.tags.get(&format!("{CHANNEL}{WRITER}")).unwrap_or(&record.head.caller_id);
        let digest = sm3(&[&item.row.owner.0, writer.as_bytes()]);
        let publisher = digest.first_chunk().map_or(0, |first| u64::from_be_bytes(*first));
        Ok((form, (item.row.owner, publisher)))
    }

    async fn of_one(&mut self, item: &Item, record: &OpenedRecord, topic: String) -> Result<Form, Stop> {
        let reader = Reader { plant: &self.bridge.parts.plant, network: &self.network, reader: self.owner };
        let text = self.definitions.text(&reader, &item.row, record, Opening::Anchored).await;
        let Some(definition) = text.map_err(Failure::from)? else {
            return Err(Stop::Refused("no readable record contains the definition of its type".to_owned()));
        };
        let (type_name, md5sum) = (record.head.type_name.clone(), record.head.md5sum.clone());
        let latching = record.head.tags.contains_key(importer::LATCHING);
        Ok(Form::One(Advertised { topic, type_name, md5sum, definition: definition.to_string(), latching }))
    }
}

/// ROS 2 needs no definition: the bytes pass unchanged.
fn of_two(record: &OpenedRecord, name: String) -> Result<Form, String> {
    let Some(([high, low, options @ ..], _)) = record.body.split_first_chunk::<4>() else {
        return Err("its message is shorter than the header of one".to_owned());
    };
    if record.body.len() > LONGEST_MESSAGE as usize {
        return Err(format!("its message is longer than the {} MiB that are published", LONGEST_MESSAGE >> 20));
    }
    if options != &[0, 0] {
        return Err("the header of its message has options, which cannot be published unchanged".to_owned());
    }
    let (type_name, encoding) = (record.head.type_name.clone(), u16::from_be_bytes([*high, *low]));
    Ok(Form::Two(Offered { name, type_name, encoding, offer: offer(&record.head.tags) }))
}

struct Pacer {
    thousandths: Option<u64>,
    begun: Option<(Timestamp, Instant)>,
}

impl Pacer {
    pub fn new(pace: Pace) -> Self {
        let thousandths = match pace {
            Pace::Rated { thousandths } => Some(thousandths.max(1)),
            Pace::AtOnce | Pace::Follow => None,
        };
        Self { thousandths, begun: None }
    }

    pub fn wait(&mut self, at: Timestamp, now: Instant) -> Duration {
        let Some(thousandths) = self.thousandths else { return Duration::ZERO };
        let (first, begun) = *self.begun.get_or_insert((at, now));
        let after = u128::from(at.0.saturating_sub(first.0)) * 1000 / u128::from(thousandths);
        let after = Duration::from_nanos(u64::try_from(after).unwrap_or(u64::MAX));
        after.saturating_sub(now.saturating_duration_since(begun))
    }

    pub fn clock(&self, now: Instant) -> Option<Timestamp> {
        let (first, begun) = self.begun?;
        let since = now.saturating_duration_since(begun).as_nanos() * u128::from(self.thousandths?) / 1000;
        Some(Timestamp(first.0.saturating_add(u64::try_from(since).unwrap_or(u64::MAX))))
    }
}

const UNTOLD: Duration = Duration::from_secs(10);
const RIGHTS_EVERY: Duration = Duration::from_millis(500);

/// Wait for a key that may never come: anybody who signs for the owner can name an epoch unknown to the chain.
const UNSURE: Duration = Duration::from_secs(120);

/// Wait where keys exist: those of the newest block may have come after the record was opened.
const JUST_COME: Duration = Duration::from_secs(5);

/// After a key `Came` and opened a record, one that it does not open belongs to somebody else.
pub(super) enum TopicKeyState {
    Came,
    Awaited { since: Instant, looked: Instant, has_begun: bool },
}

type Which = (Address, TopicId, u64);

pub(super) fn key_of(row: &RecordRow) -> Which {
    (row.owner, row.topic_id, row.epoch)
}

#[derive(Default)]
pub(super) struct Keys {
    states: HashMap<Which, TopicKeyState>,
    told: HashSet<(Address, u64)>,
}

impl Keys {
    pub fn looked_for(&self, which: Which, now: Instant) -> bool {
        let state = self.states.get(&which);
        matches!(state, Some(TopicKeyState::Awaited { looked, .. }) if now.duration_since(*looked) < RIGHTS_EVERY)
    }

    pub fn came(&mut self, which: Which) {
        self.states.insert(which, TopicKeyState::Came);
    }

    /// The wait so far; `None` if the key came, or `longest` is over.
    fn awaited(&mut self, which: Which, begun: bool, longest: Duration, now: Instant) -> Option<Duration> {
        let fresh = || TopicKeyState::Awaited { since: now, looked: now, has_begun: begun };
        let state = self.states.entry(which).or_insert_with(fresh);
        if matches!(state, TopicKeyState::Awaited { has_begun, .. } if begun && !*has_begun) {
            *state = fresh();
        }
        let TopicKeyState::Awaited { since, looked, .. } = state else { return None };
        let waited = now.duration_since(*since);
        if waited >= longest {
            return None;
        }
        *looked = now;
        Some(waited)
    }
}

impl Play<'_> {
    pub(super) fn awaits_key(&mut self, row: &RecordRow) -> bool {
        let directory = &self.network.directory;
        let (epoch, newest_epoch, now) = (row.epoch, directory.epoch(row.owner), Instant::now());
        let Some(grant) = directory.grant_between(row.owner, self.owner.address) else { return false };
        let has_begun = epoch <= newest_epoch;
        if epoch < grant.terms.epoch || epoch > newest_epoch + 1 {
            return false;
        }
        let is_due = has_begun && grant.newest_wrapped().is_some_and(|newest| newest < epoch);
        let longest = match is_due {
            true => Duration::MAX,
            false if grant.is_wrapped(epoch) => JUST_COME,
            false => UNSURE,
        };
        let Some(waited) = self.keys.awaited(key_of(row), has_begun, longest, now) else { return false };
        if waited >= UNTOLD && self.keys.told.insert((row.owner, epoch)) {
            let (target, owner) = (self.target.name(), self.name_of(row.owner));
            self.bridge.parts.hub.warn(&format!(
                "playback into {target} waits: the key of epoch {epoch} of {owner} has not arrived yet; the owner's \
                 site sends it once it reaches the chain"
            ));
        }
        true
    }

    pub(super) fn right_ended(&mut self) -> Option<PlayEnd> {
        if self.owner.is_locked() {
            self.tell("the keyring was locked");
            return Some(PlayEnd::Locked);
        }
        if let Some(network) = self.bridge.parts.link.network_now() {
            self.network = network;
        }
        if self.rights_at.elapsed() < RIGHTS {
            return None;
        }
        self.rights_at = Instant::now();
        let standing = granted_to(self.owner, &self.network);
        // A grant that was revoked and given again, perhaps for less, differs.
        let is_over = |giver: &&Address| standing.get(giver).is_none_or(|now| self.granted.get(giver) != Some(now));
        let ended: Vec<Address> = self.givers.keys().filter(is_over).copied().collect();
        let mut end = None;
        for giver in ended {
            end = Some(self.take_back(giver));
        }
        end.filter(|_| self.givers.is_empty())
    }

    pub(super) fn take_back(&mut self, giver: Address) -> PlayEnd {
        self.givers.remove(&giver);
        self.target.silence(giver);
        let grant = self.network.directory.grant_between(giver, self.owner.address);
        let is_same = |transaction| self.granted.get(&giver) == Some(&transaction);
        let is_expired = grant.is_some_and(|grant| grant.revoked.is_none() && is_same(grant.transaction));
        let (end, why) = if is_expired { (PlayEnd::Expired, "has expired") } else { (PlayEnd::Revoked, "was revoked") };
        self.tell(&format!("the grant of {} {why}", self.name_of(giver)));
        end
    }

    fn name_of(&self, account: Address) -> String {
        let names = self.bridge.contacts.names().unwrap_or_default();
        names.get(&account).map_or_else(|| account.to_string(), ToString::to_string)
    }

    fn tell(&self, why: &str) {
        let (target, count) = (self.target.name(), counted(self.tally.published, "message"));
        self.bridge.parts.hub.warn(&format!("playback into {target} ended: {why}; published: {count}"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;

    #[test]
    fn messages_wait_as_long_as_they_were_apart_by_the_rate() {
        let now = Instant::now();
        let mut double = Pacer::new(Pace::Rated { thousandths: 2000 });
        assert_eq!(double.wait(Timestamp(100 * SECOND), now), Duration::ZERO);
        assert_eq!(double.wait(Timestamp(110 * SECOND), now), Duration::from_secs(5));
        assert_eq!(double.wait(Timestamp(110 * SECOND), now + Duration::from_secs(4)), Duration::from_secs(1));
        assert_eq!(double.wait(Timestamp(90 * SECOND), now), Duration::ZERO, "never back");
        assert_eq!(double.clock(now + Duration::from_secs(4)), Some(Timestamp(108 * SECOND)));
        let mut at_once = Pacer::new(Pace::AtOnce);
        assert_eq!(at_once.wait(Timestamp(100 * SECOND), now), Duration::ZERO);
        assert_eq!(at_once.wait(Timestamp(900 * SECOND), now), Duration::ZERO);
        assert_eq!(at_once.clock(now), None);
    }
}

#[cfg(test)]
mod rights_tests {
    use super::*;

    fn which(topic: u8) -> Which {
        (Address([1; 20]), TopicId([topic; 16]), 3)
    }

    #[test]
    fn a_key_that_does_not_come_holds_its_own_topic_for_a_while_only() {
        let (mut keys, begin) = (Keys::default(), Instant::now());
        let after = |seconds: u64| begin + Duration::from_secs(seconds);
        assert_eq!(keys.awaited(which(1), true, UNSURE, begin), Some(Duration::ZERO));
        assert!(keys.looked_for(which(1), begin) && !keys.looked_for(which(2), begin), "another topic is looked at");
        assert!(!keys.looked_for(which(1), after(1)), "the key is searched for again");
        assert_eq!(keys.awaited(which(1), true, UNSURE, after(119)), Some(Duration::from_secs(119)));
        for moment in [120, 121] {
            assert_eq!(keys.awaited(which(1), true, UNSURE, after(moment)), None, "given up");
            assert!(!keys.looked_for(which(1), after(moment)), "and those after it are not held");
        }
        // One that is sure to come is awaited for as long as it takes.
        assert!(keys.awaited(which(1), true, Duration::MAX, after(9_999)).is_some());
        keys.came(which(2));
        assert_eq!(keys.awaited(which(2), true, UNSURE, after(1)), None, "what it does not open is another's");
    }

    #[test]
    fn an_epoch_that_begins_later_is_awaited_anew() {
        let (mut keys, begin) = (Keys::default(), Instant::now());
        let after = |seconds: u64| begin + Duration::from_secs(seconds);
        assert!(keys.awaited(which(1), false, UNSURE, begin).is_some());
        assert_eq!(keys.awaited(which(1), false, UNSURE, after(500)), None);
        assert_eq!(keys.awaited(which(1), true, UNSURE, after(501)), Some(Duration::ZERO));
        assert_eq!(keys.awaited(which(1), true, UNSURE, after(502)), Some(Duration::from_secs(1)));
    }
}
