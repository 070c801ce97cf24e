//! Publishes checked, shared records in the reader's ROS.

mod play;
mod target;

use std::collections::{HashMap, HashSet, VecDeque};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use target::{Domain, Stage, Target};
use tokio::sync::watch;
use tokio::task::block_in_place;

use crate::command::{Pace, PlayWishes};
use crate::config::PublishedBy;
use crate::crypto::random_bytes;
use crate::model::{
    Address, Digest, ErrorKind, ProfileName, RecordKind, RecordState, Scope, Timestamp, TopicId, TopicName, clean, hex,
    locked,
};
use crate::pipeline::{Network, Owner, PipelineError, authority, is_held};
use crate::reply::{Failure, Result, input, refused};
use crate::ros::ros2::Ros2Publisher;
use crate::ros::{Graph, GraphPublisher, Publisher, RosError, RosrustPublisher, UNCONFINED};
use crate::site::{Contacts, Parts, RosSide};
use crate::store::{Counts, FeedFilter, FeedPlace, FeedRow, Ledger, PlacedRecord, RecordQuery, RecordRow, Records};

const NODE: &str = "/authros_play_";

/// Owners who share, and what.
type Givers = HashMap<Address, Scope>;

pub(in crate::site) struct Bridge {
    parts: Parts,
    contacts: Arc<Contacts>,
    ros: Arc<RosSide>,
    running: Mutex<Vec<(ProfileName, watch::Sender<bool>)>>,
}

impl Bridge {
    pub fn new(parts: &Parts, contacts: &Arc<Contacts>, ros: &Arc<RosSide>) -> Self {
        let (parts, contacts, ros) = (parts.clone(), Arc::clone(contacts), Arc::clone(ros));
        Self { parts, contacts, ros, running: Mutex::default() }
    }

    pub fn stop(&self, profile: &ProfileName) {
        let running = locked(&self.running);
        running.iter().filter(|(owner, _)| owner == profile).for_each(|(_, stop)| {
            stop.send_replace(true);
        });
    }

    fn listed(&self, profile: &ProfileName) -> watch::Receiver<bool> {
        let (stop, stopped) = watch::channel(false);
        let mut running = locked(&self.running);
        running.retain(|(_, stop)| !stop.is_closed());
        running.push((profile.clone(), stop));
        stopped
    }

    fn givers(&self, owner: &Owner, network: &Network, wishes: &PlayWishes) -> Result<Givers> {
        let wanted = wishes.owner.as_ref().map(|party| self.contacts.resolve(party)).transpose()?;
        let granted = authority::shared_with(&network.directory, owner.address);
        let granted = granted.into_iter().map(|grant| (grant.terms.owner, grant.terms.scope));
        let givers: Givers = granted.filter(|(giver, _)| wanted.is_none_or(|wanted| wanted == *giver)).collect();
        if !givers.is_empty() {
            return Ok(givers);
        }
        let Some(other) = wanted else {
            return Err(refused("nobody shares records with this profile now; see `authros grant list`"));
        };
        let what = "its records".to_owned();
        Err(PipelineError::NotGranted { owner: other, reader: owner.address, what }.into())
    }

    /// Also returns whether this site captures from there, in which case the names must keep apart.
    fn domain(&self, domain: u16, names: &Names) -> Result<(Box<dyn Target>, bool)> {
        let is_captured = self.ros.is_wanted() && self.parts.config.ros_domain == Some(domain);
        if is_captured {
            names.keep_apart().map_err(|why| refused(format!("ROS 2 domain {domain} is {why}")))?;
        }
        let publisher = block_in_place(|| Ros2Publisher::start(domain, self.parts.config.ros2_program.as_deref()))?;
        self.tell_of_walls(publisher.is_confined());
        Ok((Box::new(Domain::new(publisher, names.prefix.clone())), is_captured))
    }

    async fn stage(&self, wishes: &PlayWishes, names: &Names) -> Result<(Box<dyn Target>, bool)> {
        let own = match (self.ros.is_wanted(), &self.parts.config.ros_master) {
            (false, _) => None,
            // The site captures from it again as soon as it is back.
            (true, Some(named)) => Some(named.clone()),
            (true, None) => Some(self.ros.uri().await?),
        };
        let uri = wishes.master.clone().or_else(|| own.clone()).or_else(|| self.parts.config.ros_master.clone());
        let uri = uri.ok_or_else(|| {
            let advice = "choose the graph to play into with --to http://HOST:11311, or set ros.master";
            Failure::new(ErrorKind::Usage, advice)
        })?;
        let node = format!("{NODE}{}", hex(&random_bytes::<4>()?));
        let graph = Graph::new(&uri, &node)?;
        block_in_place(|| {
            graph.ping()?;
            let is_captured = own.is_some_and(|own| graph.is_at(&own));
            if is_captured {
                names.keep_apart().map_err(|why| refused(format!("{} is {why}", clean(&uri, 120))))?;
            }
            let publisher = self.publisher(&uri, &node)?;
            let stage: Box<dyn Target> = Box::new(Stage::new(uri.clone(), graph, publisher, names.prefix.clone()));
            Ok((stage, is_captured))
        })
    }

    fn tell_of_walls(&self, is_confined: bool) {
        if !is_confined {
            self.parts.hub.warn(UNCONFINED);
        }
    }

    fn publisher(&self, uri: &str, node: &str) -> Result<Box<dyn GraphPublisher>, RosError> {
        let host = self.parts.config.ros_host.as_deref();
        match self.parts.config.publisher {
            PublishedBy::Own => Ok(Box::new(Publisher::start(uri, host, node)?)),
            PublishedBy::Rosrust => {
                let program = self.parts.config.rosrust_program.as_deref();
                let publisher = RosrustPublisher::start(uri, host, node, program)?;
                self.tell_of_walls(publisher.is_confined());
                Ok(Box::new(publisher))
            }
        }
    }
}

fn consistent(wishes: &PlayWishes) -> Result<()> {
    if wishes.domain.is_some() && wishes.master.is_some() {
        return Err(input(
            "messages are played into a ROS 1 graph or a ROS 2 domain; leave out one of --to and --ros2",
        ));
    }
    match wishes.pace {
        Pace::Follow if wishes.since.is_some() || wishes.until.is_some() => {
            Err(input("--follow plays records verified from now on; omit --since and --until"))
        }
        Pace::AtOnce | Pace::Follow if wishes.clock => {
            Err(input("/clock gives the capture time, so it needs --as-captured or --rate"))
        }
        Pace::AtOnce | Pace::Follow | Pace::Rated { .. } => Ok(()),
    }
}

fn subject(wishes: &PlayWishes, uri: &str) -> String {
    let owner = wishes.owner.as_ref().map_or_else(|| "all owners".to_owned(), ToString::to_string);
    let topics: Vec<String> = wishes.topics.iter().map(ToString::to_string).collect();
    let topics = if topics.is_empty() { "all topics".to_owned() } else { topics.join(" ") };
    clean(&format!("{topics} of {owner} into {uri}"), 300)
}

/// The names of played topics, and whether they stay apart from captured ones.
struct Names {
    prefix: Option<String>,
    remaps: HashMap<String, String>,
}

impl Names {
    pub fn of(wishes: &PlayWishes) -> Result<Self> {
        let mut remaps = HashMap::new();
        for remap in &wishes.remaps {
            if remaps.insert(remap.from.to_string(), remap.to.to_string()).is_some() {
                return Err(input(format!("{} is remapped twice; give it a single name", remap.from)));
            }
        }
        let prefix = wishes.prefix.as_ref().map(TopicName::to_string);
        Ok(Self { prefix, remaps })
    }

    pub fn played(&self, topic: &str) -> Option<String> {
        if let Some(name) = self.remaps.get(topic) {
            return Some(name.clone());
        }
        let name = format!("{}{topic}", self.prefix.as_deref().unwrap_or_default());
        name.parse::<TopicName>().ok().map(|name| name.to_string())
    }

    pub fn keep_apart(&self) -> Result<(), String> {
        let why = "the graph that this site captures from; anything played there would be captured again as new:";
        let Some(prefix) = &self.prefix else {
            return Err(format!("{why} give a --prefix such as /shared/alice, or another graph with --to or --ros2"));
        };
        match self.remaps.values().find(|name| !is_under(prefix, name)) {
            Some(name) => Err(format!("{why} remap to a name under {prefix}, unlike {name}")),
            None => Ok(()),
        }
    }
}

fn is_under(prefix: &str, name: &str) -> bool {
    name.strip_prefix(prefix).is_some_and(|rest| rest.starts_with('/'))
}

const PAGE: usize = 500;

/// How far back a live feed looks for unverified records at its start, nanoseconds.
const BEFORE: u64 = 60_000_000_000;

/// How much later than its neighbours a record may enter the ledger and still be seen, nanoseconds.
const SLACK: u64 = 500_000_000;

/// Interval between looks for records later than [`SLACK`].
const LATE_LOOK: Duration = Duration::from_secs(1);
const MOST_PASSED: usize = 20_000;

const LISTING: Duration = Duration::from_millis(500);

pub(super) struct Item {
    pub row: RecordRow,
    /// Verified before a live feed began: played only if its publisher latches.
    pub only_latched: bool,
}

pub(super) enum Feed {
    Past(Box<RecordQuery>),
    Live(Live),
}

#[derive(Default)]
pub(super) struct Live {
    streams: HashMap<(Address, TopicId), Stream>,
    listed: Option<Instant>,
    looked_late: Option<Instant>,
    place: Option<([u8; 16], u64)>,
    /// The newest records given out behind their streams; if verified again, they are not repeated.
    passed: VecDeque<Digest>,
    /// Records that must wait; their streams wait for them.
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
    pub fn begin(ledger: &Ledger, wishes: &PlayWishes, givers: &Givers) -> Result<Self> {
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

    /// The next records, and whether they are the last.
    pub fn next(&mut self, ledger: &Ledger, givers: &Givers) -> Result<(Vec<Item>, bool)> {
        match self {
            Self::Past(query) => {
                let page = ledger.records.list(query)?;
                let items = page.rows.into_iter().map(|row| Item { row, only_latched: false }).collect();
                query.after = page.next;
                Ok((items, query.after.is_none()))
            }
            Self::Live(live) => live.next(ledger, givers),
        }
    }

    pub fn again(&mut self, item: Item) {
        if let Self::Live(live) = self {
            live.pending.push(item);
        }
    }
}

impl Live {
    fn next(&mut self, ledger: &Ledger, givers: &Givers) -> Result<(Vec<Item>, bool)> {
        if self.place.is_none() {
            let page = ledger.feed.page(&[0; 16], &FeedFilter::default(), 1)?;
            self.place = Some((page.id, page.head));
        }
        let mut items = std::mem::take(&mut self.pending);
        items.retain(|item| givers.contains_key(&item.row.owner));
        let held: HashSet<_> = items.iter().map(|item| (item.row.owner, item.row.topic_id)).collect();
        self.streams.retain(|(owner, _), _| givers.contains_key(owner));
        if self.listed.is_none_or(|at| at.elapsed() >= LISTING) {
            items.extend(self.list(ledger, givers)?);
            self.listed = Some(Instant::now());
        }
        let mut ready = Vec::new();
        if self.looked_late.is_none_or(|at| at.elapsed() >= LATE_LOOK) {
            self.looked_late = Some(Instant::now());
            self.look_late(ledger, givers, &mut ready)?;
        }
        for (key, stream) in self.streams.iter_mut().filter(|(key, _)| !held.contains(key)) {
            stream.take(&ledger.records, *key, &mut ready)?;
        }
        // Stable sort: records of one moment keep the order of their stream.
        ready.sort_by_key(|row: &RecordRow| row.captured_at);
        items.extend(ready.into_iter().map(|row| Item { row, only_latched: false }));
        Ok((items, false))
    }

    fn look_late(&mut self, ledger: &Ledger, givers: &Givers, ready: &mut Vec<RecordRow>) -> Result<()> {
        let mut passed: Option<HashSet<Digest>> = None;
        loop {
            let (id, after) = self.place.unwrap_or_default();
            let places = givers.keys().map(|owner| FeedPlace { owner: *owner, after, topics: None }).collect();
            let filter = FeedFilter { places, kind: Some(RecordKind::Data), recorders: Vec::new() };
            let page = ledger.feed.page(&id, &filter, PAGE)?;
            for FeedRow { placed: PlacedRecord { row, .. }, .. } in page.rows {
                let stream = self.streams.get_mut(&(row.owner, row.topic_id));
                let is_late = |one: &&mut Stream| row.captured_at >= one.floor && row.captured_at < one.low;
                if let Some(stream) = stream.filter(is_late)
                    && !passed.get_or_insert_with(|| self.passed.iter().copied().collect()).contains(&row.digest)
                    && stream.done.insert(row.digest, row.captured_at).is_none()
                {
                    ready.push(row);
                }
            }
            self.place = Some((page.id, page.upto));
            if page.upto == page.head {
                break;
            }
        }
        // Records behind the stream's place cannot recur, unless a reorganisation verifies them again.
        for stream in self.streams.values_mut() {
            self.passed.extend(stream.done.extract_if(|_, at| *at < stream.low).map(|(digest, _)| digest));
        }
        self.passed.drain(..self.passed.len().saturating_sub(MOST_PASSED));
        Ok(())
    }

    /// At the start, only the newest verified record of each stream is given out, to be latched.
    fn list(&mut self, ledger: &Ledger, givers: &Givers) -> Result<Vec<Item>> {
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
    fn skip_verified(&mut self, records: &Records, key: (Address, TopicId)) -> Result<Option<Item>> {
        let verified = RecordQuery { state: Some(RecordState::Verified), ..of_stream(key) };
        for row in records.all(RecordQuery { since: Some(self.low), ..verified.clone() }) {
            let row = row?;
            self.done.insert(row.digest, row.captured_at);
        }
        let newest = records.list(&RecordQuery { newest_first: true, limit: 1, ..verified })?;
        Ok(newest.rows.into_iter().next().map(|row| Item { row, only_latched: true }))
    }

    /// Stops at the first unsettled record, to preserve the order.
    fn take(&mut self, records: &Records, key: (Address, TopicId), ready: &mut Vec<RecordRow>) -> Result<()> {
        let query = RecordQuery { since: Some(self.low.max(self.floor)), ..of_stream(key) };
        let (mut waiting, most, now) = (None, ready.len() + PAGE, Timestamp::now());
        for row in records.all(query) {
            let row = row?;
            if self.done.contains_key(&row.digest) || is_held(&row) || row.state == RecordState::RightEnded {
                continue;
            }
            if row.state.is_pending() || ready.len() >= most {
                waiting = Some(row.captured_at);
                break;
            }
            self.done.insert(row.digest, row.captured_at);
            // A publisher's clock that is ahead must not push other records behind.
            self.newest = self.newest.max(row.captured_at.min(now));
            ready.push(row);
        }
        let settled = Timestamp(self.newest.0.saturating_sub(SLACK)).max(self.low);
        self.low = waiting.map_or(settled, |waiting| settled.min(waiting));
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

fn topics_of(counts: &Counts, owner: Address, scope: &Scope) -> Result<Vec<TopicId>> {
    Ok(match scope {
        Scope::Topics(topics) => Vec::clone(topics),
        Scope::All => counts.by_state(Some(owner))?.topics.iter().filter_map(|topic| topic.topic_id).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(prefix: Option<&str>, remaps: &[&str]) -> Result<Names> {
        Names::of(&PlayWishes {
            prefix: prefix.map(|prefix| prefix.parse().expect("a name")),
            remaps: remaps.iter().map(|remap| remap.parse().expect("a remapping")).collect(),
            ..PlayWishes::default()
        })
    }

    #[test]
    fn a_prefix_stands_before_every_name_that_is_not_remapped() {
        let names = names(Some("/shared/alice"), &["/odom:=/shared/alice/position"]).expect("names");
        assert_eq!(names.played("/imu").as_deref(), Some("/shared/alice/imu"));
        assert_eq!(names.played("/odom").as_deref(), Some("/shared/alice/position"));
        assert_eq!(names.played("no name"), None);
        assert_eq!(names.keep_apart(), Ok(()));
    }

    #[test]
    fn without_a_prefix_or_with_a_remapping_beside_it_the_captured_graph_is_refused() {
        assert!(names(None, &[]).expect("names").keep_apart().is_err());
        for beside in ["/odom:=/odom", "/odom:=/shared/alicex", "/odom:=/shared"] {
            assert!(names(Some("/shared/alice"), &[beside]).expect("names").keep_apart().is_err(), "{beside}");
        }
        assert_eq!(names(None, &[]).expect("names").played("/odom").as_deref(), Some("/odom"));
    }

    #[test]
    fn one_topic_has_one_name() {
        assert!(names(None, &["/a:=/b", "/a:=/c"]).is_err());
    }
}

#[cfg(test)]
mod feed_tests {
    #![allow(clippy::expect_used, reason = "a test fails by panicking")]

    use super::*;
    use crate::model::{Signature, SignerId};
    use crate::store::{KeptReceipt, NewRecord};

    const OWNER: Address = Address([1; 20]);

    fn keep(ledger: &Ledger, seq: u64, captured_at: Timestamp) {
        let digest = Digest([u8::try_from(seq).expect("small"); 32]);
        let record = NewRecord {
            digest,
            owner: OWNER,
            topic_id: TopicId([2; 16]),
            seq,
            foreign: None,
            epoch: 1,
            kind: RecordKind::Data,
            signer: SignerId([3; 32]),
            signature: Signature([4; 64]),
            filters: Vec::new(),
            topic: "/odom".to_owned(),
            type_name: "nav_msgs/Odometry".to_owned(),
            bytes: 5,
            captured_at,
            simulated: false,
            state: RecordState::Stored,
            blob: None,
        };
        ledger.records.append(vec![record]).expect("acknowledged");
        let receipt = KeptReceipt { time: captured_at, digests: vec![digest], signature: Signature([5; 64]) };
        assert_eq!(ledger.forwarding.accept(receipt), Ok(1));
        assert_eq!(ledger.forwarding.settle(&[digest], RecordState::Verified), Ok(1));
    }

    #[test]
    fn what_comes_far_behind_its_stream_is_played_once() {
        let home = tempfile::tempdir().expect("folder");
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("opens");
        let begun = Timestamp::now().0;
        let at = |seconds: u64| Timestamp(begun - 59_000_000_000 + seconds * 1_000_000_000);
        let (mut live, givers) = (Live::default(), [(OWNER, Scope::All)].into());
        let played = |live: &mut Live| -> Vec<u64> {
            live.looked_late = None;
            let (items, _) = live.next(&ledger, &givers).expect("read");
            items.iter().map(|item| item.row.seq).collect()
        };
        assert_eq!(played(&mut live), [0; 0]);
        keep(&ledger, 1, at(1));
        live.listed = None;
        // The newest of what was there when it is listed first may be latched.
        played(&mut live);
        keep(&ledger, 2, at(50));
        assert_eq!(played(&mut live), [2]);
        assert_eq!(played(&mut live), [0; 0]);
        keep(&ledger, 3, at(2));
        assert_eq!(played(&mut live), [3], "48 seconds behind its stream");
        assert_eq!(played(&mut live), [0; 0]);
        // Verified again after a reorganisation: another number, the same record.
        live.place = live.place.map(|(id, _)| (id, 0));
        assert_eq!(played(&mut live), [0; 0]);
    }
}
