//! Which publisher a message is from. Messages wait here until their publisher has a name and, where another participant
//! has a publisher of the same name, until it shows whether that one still runs: then the newcomer is a rival, else a restart.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use super::publisher::Publisher;
use crate::model::{Timestamp, pinned_name};
use crate::ros::Rival;

/// How long a message waits for the name of a publisher whose participant announces names.
pub const NAMING: Duration = Duration::from_secs(30);
/// The same where no names are announced; the announcement of names itself may be a moment late.
const UNNAMED: Duration = Duration::from_secs(1);
/// The messages of a dead publisher may still arrive this long after its successor was discovered.
const GRACE: Duration = Duration::from_secs(1);
/// A publisher in full flow that says nothing for this long, and for four of its own intervals, has ended.
const SILENCE: Duration = Duration::from_secs(3);
/// A participant that is still listed after this time is alive: Fast DDS and Cyclone DDS give up a silent one after 20 s
/// and 10 s.
const LEASE: Duration = Duration::from_secs(30);
/// Characters of a writer's id that its participant's writers share.
const PARTICIPANT: usize = 24;

/// A message that waits.
pub struct Held {
    /// The publisher's number for it, and when it was published.
    pub sent: (i64, Option<u64>),
    /// When it arrived.
    pub at: Timestamp,
    /// Its bytes.
    pub body: Vec<u8>,
}

/// When a publisher was heard.
#[derive(Default)]
pub struct Pulse {
    last: Option<Instant>,
    /// The longest of its recent intervals.
    interval: Option<Duration>,
}

impl Pulse {
    /// A message of it arrived then.
    pub fn beat(&mut self, at: Instant) {
        if let Some(last) = self.last {
            let former = self.interval.map_or(Duration::ZERO, |interval| interval * 7 / 8);
            self.interval = Some(former.max(at.saturating_duration_since(last)));
        }
        self.last = Some(self.last.map_or(at, |last| last.max(at)));
    }

    /// The silence that shows it has ended, if it was in full flow at that time.
    fn telling(&self, at: Instant) -> Option<Duration> {
        let enough = SILENCE.max(self.interval? * 4);
        (at.saturating_duration_since(self.last?) < enough).then_some(enough)
    }
}

/// The place of a publisher among those of its name.
#[derive(Debug, PartialEq, Eq)]
pub enum Place {
    /// Not known yet.
    Open,
    /// It is the only one, or the successor of one that ended.
    Alone,
    /// It came while this one was there, and that one goes on.
    Beside(Rival),
}

/// Whether `elder` ran on after a newcomer was discovered; `None` if that does not show yet.
fn lives_beside(elder: &Publisher, came: Instant, now: Instant) -> Option<bool> {
    if elder.pulse.last.is_some_and(|last| last > came + GRACE) {
        return Some(true);
    }
    if elder.gone.is_some() {
        return Some(false);
    }
    let quiet = now.saturating_duration_since(elder.pulse.last.map_or(came, |last| last.max(came)));
    if now.saturating_duration_since(came) >= LEASE {
        return Some(true);
    }
    elder.pulse.telling(came).is_some_and(|enough| quiet >= enough).then_some(false)
}

/// The place of a publisher now.
pub fn place(publisher: &Publisher, all: &BTreeMap<String, Publisher>, now: Instant) -> Place {
    let patience = if publisher.writer.naming { NAMING } else { UNNAMED };
    let waited = now.saturating_duration_since(publisher.came);
    if publisher.writer.node.is_none() && publisher.gone.is_none() && waited < patience {
        return Place::Open;
    }
    let mut place = Place::Alone;
    for elder in publisher.elders.iter().filter_map(|id| all.get(id)) {
        match lives_beside(elder, publisher.came, now) {
            Some(true) => {
                let uri = elder.origin.uri.clone();
                return Place::Beside(Rival { number: elder.origin.number, uri });
            }
            Some(false) => {}
            None => place = Place::Open,
        }
    }
    place
}

/// Whether two publishers of different participants claim to be the same node on the same topic.
fn are_namesakes(one: &Publisher, other: &Publisher) -> bool {
    let participant = |publisher: &Publisher| publisher.writer.id.get(..PARTICIPANT).map(str::to_owned);
    one.writer.topic == other.writer.topic
        && one.writer.node.is_some()
        && other.writer.node.is_some()
        && pinned_name(&one.origin.caller_id) == pinned_name(&other.origin.caller_id)
        && participant(one) != participant(other)
}

/// Enters who came before whom among the publishers of a topic. In what order those came that were there at first, before
/// `ordered`, is not known.
pub fn relate(topic: &str, ordered: Instant, all: &mut BTreeMap<String, Publisher>) {
    let of_topic: Vec<&Publisher> = all.values().filter(|known| known.writer.topic == topic).collect();
    let mut elders = Vec::new();
    for younger in of_topic.iter().filter(|known| known.came >= ordered && known.origin.rival.is_none()) {
        let before = of_topic.iter().filter(|known| known.came < younger.came && are_namesakes(known, younger));
        let before: Vec<String> = before.map(|known| known.writer.id.clone()).collect();
        elders.push((younger.writer.id.clone(), before));
    }
    for (id, before) in elders {
        if let Some(publisher) = all.get_mut(&id) {
            publisher.elders = before;
        }
    }
}
