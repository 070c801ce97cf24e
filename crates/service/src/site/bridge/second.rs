//! Publishes in a ROS 2 domain with the offers of the original publishers.

use std::collections::{BTreeMap, HashMap};

use tokio::task::block_in_place;

use super::target::{Form, NO_MESSAGE, OTHER_ROS, Source, Stop, Target, Topics, clock_message};
use crate::model::{Address, Timestamp, clean};
use crate::pipeline::importer;
use crate::ros::recording::Encoding;
use crate::ros::recording::tags::CHANNEL;
use crate::ros::ros2::{Delivery, Offer, Offered, QUALITY, Ros2Publisher};
use crate::service::reply::Failure;

const MOST_LATCHED: usize = 64;

/// As `ros2 bag play --clock` offers it.
const CLOCK: &str = "rosgraph_msgs/msg/Clock";
const CLOCK_OFFER: Offer = Offer { reliable: false, latched: false, depth: 1 };
const LITTLE: u16 = 1;

/// A latched topic keeps the last messages of each source.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Way {
    topic: String,
    owner: Address,
    source: Option<u64>,
    encoding: u16,
    offer: Offer,
}

pub(super) struct Domain {
    topics: Topics,
    publisher: Ros2Publisher,
    ways: HashMap<Way, u32>,
}

fn way(about: &Offered, (owner, source): Source) -> Way {
    let source = about.offer.latched.then_some(source);
    Way { topic: about.name.clone(), owner, source, encoding: about.encoding, offer: about.offer }
}

impl Domain {
    pub fn new(publisher: Ros2Publisher, prefix: Option<String>) -> Self {
        let topics = Topics::new(format!("ROS 2 domain {}", publisher.domain()), prefix);
        Self { topics, publisher, ways: HashMap::new() }
    }

    fn begin(&mut self, about: &Offered, way: Way, size: usize, alone: bool) -> Result<(), Stop> {
        let publisher = &mut self.publisher;
        match self.topics.announce(|patience| publisher.advertise(about, size, (alone, !patience.is_zero())))? {
            Ok(writer) => {
                self.make_room(&way);
                self.topics.publish(&about.name, (&about.type_name, ""));
                self.ways.insert(way, writer);
                Ok(())
            }
            Err(declined) => {
                let advice = if declined.occupied { "; give a --prefix" } else { "" };
                let why = format!("{}{advice}", clean(&declined.reason, 300));
                if alone {
                    self.topics.declined.insert(about.name.clone(), why.clone());
                }
                Err(Stop::Refused(why))
            }
        }
    }

    /// Each restart of a publisher is a new source: withdraws the oldest.
    fn make_room(&mut self, way: &Way) {
        let alike = |other: &Way| other.source.is_some() && (&other.topic, other.owner) == (&way.topic, way.owner);
        let alike: Vec<u32> = self.ways.iter().filter(|(other, _)| alike(other)).map(|(_, writer)| *writer).collect();
        if let Some(oldest) = alike.iter().min().filter(|_| alike.len() >= MOST_LATCHED) {
            self.publisher.withdraw(*oldest);
            self.ways.retain(|_, writer| writer != oldest);
        }
    }
}

impl Target for Domain {
    fn name(&self) -> &str {
        &self.topics.place
    }

    fn objection(&self, encoding: Encoding) -> Option<&'static str> {
        match encoding {
            Encoding::Ros1 => Some("a message of ROS 1 is not translated into ROS 2"),
            Encoding::Beside(_) => Some(NO_MESSAGE),
            Encoding::Cdr { .. } => None,
        }
    }

    fn show(&mut self, form: &Form, source: Source, size: usize) -> Result<(), Stop> {
        let Form::Two(about) = form else { return Err(Stop::Refused(OTHER_ROS.to_owned())) };
        block_in_place(|| self.publisher.revive()).map_err(Failure::from)?;
        let is_new = self.topics.admit(&about.name, (&about.type_name, ""))?;
        let way = way(about, source);
        if self.ways.contains_key(&way) {
            return Ok(());
        }
        let alone = is_new && !self.topics.is_inside(&about.name);
        block_in_place(|| self.begin(about, way, size, alone))
    }

    fn publish(&mut self, form: &Form, source: Source, message: &[u8]) -> bool {
        let Form::Two(about) = form else { return false };
        let Some(writer) = self.ways.get(&way(about, source)).copied() else { return false };
        block_in_place(|| self.publisher.publish(writer, message))
    }

    fn clock(&self, topic: &str, now: Timestamp) -> (Form, Vec<u8>) {
        let (name, type_name) = (topic.to_owned(), CLOCK.to_owned());
        let message = [LITTLE.to_be_bytes().as_slice(), &[0, 0], &clock_message(now)].concat();
        (Form::Two(Offered { name, type_name, encoding: LITTLE, offer: CLOCK_OFFER }), message)
    }

    fn is_crowded(&self) -> bool {
        self.publisher.is_crowded()
    }

    fn outrun(&self) {
        self.publisher.outrun();
    }

    fn come_back(&mut self) {
        drop(block_in_place(|| self.publisher.revive()));
    }

    fn silence(&mut self, owner: Address) {
        let (publisher, ways) = (&mut self.publisher, &mut self.ways);
        block_in_place(|| {
            ways.extract_if(|way, _| way.owner == owner).for_each(|(_, writer)| publisher.withdraw(writer));
        });
        self.topics.types.retain(|topic, _| ways.keys().any(|way| way.topic == *topic));
    }

    fn leave(&self) {
        block_in_place(|| self.publisher.leave());
    }

    fn is_sent(&self) -> bool {
        self.publisher.is_sent()
    }

    /// Subscribers acknowledge: what was dropped was not published.
    fn finish(self: Box<Self>, handed_out: u64, by_right: bool) -> (u64, u64, u64) {
        let Delivery { missed, unconfirmed } = block_in_place(|| self.publisher.end(by_right));
        let published = handed_out.saturating_sub(missed);
        (published, missed, unconfirmed.min(published))
    }
}

const USUAL: u32 = 10;
const LATCHED: u32 = 1;
const DEEPEST: u32 = 1000;

/// DDS publishers do not announce their depth; recordings do.
pub(super) fn offer(tags: &BTreeMap<String, String>) -> Offer {
    let profiles = tags.get(&format!("{CHANNEL}{QUALITY}")).map(String::as_str).unwrap_or_default();
    let said = |name: &str| first(profiles, name);
    let latched = match said("durability") {
        Some("transient_local" | "1") => true,
        Some("volatile" | "2") => false,
        _ => tags.contains_key(importer::LATCHING),
    };
    let reliable = !matches!(said("reliability"), Some("best_effort" | "2"));
    let usual = if latched { LATCHED } else { USUAL };
    let depth = match (said("history"), said("depth").and_then(|depth| depth.parse().ok())) {
        (Some("keep_all" | "2"), _) => DEEPEST,
        (_, Some(depth)) if depth > 0 => depth,
        _ => usual,
    };
    Offer { reliable, latched, depth: depth.min(DEEPEST) }
}

/// Profiles are a YAML list; only the first counts.
fn first<'a>(profiles: &'a str, name: &str) -> Option<&'a str> {
    let lines = profiles.lines().enumerate();
    let own = lines.take_while(|(place, line)| *place == 0 || !line.starts_with('-')).map(|(_, line)| line);
    own.filter_map(|line| line.trim_start_matches(['-', ' ']).split_once(':'))
        .find(|(key, _)| key.trim() == name)
        .map(|(_, value)| value.trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(profiles: &str, latching: bool) -> Offer {
        let mut tags = BTreeMap::from([("mcap.channel.offered_qos_profiles".to_owned(), profiles.to_owned())]);
        if latching {
            tags.insert("latching".into(), "yes".into());
        }
        offer(&tags)
    }

    #[test]
    fn profiles_of_recorders_old_and_new_are_understood() {
        // As rosbag2 writes them since Iron, and as it did before.
        let new = "- history: keep_last\n  depth: 5\n  reliability: best_effort\n  durability: volatile\n  deadline:\n    sec: \
                   9223372036\n    nsec: 854775807\n- history: keep_last\n  depth: 7\n  reliability: reliable\n";
        assert_eq!(of(new, false), Offer { reliable: false, latched: false, depth: 5 });
        let old = "- history: 1\n  depth: 3\n  reliability: 1\n  durability: 1\n  deadline:\n    sec: 0\n";
        assert_eq!(of(old, false), Offer { reliable: true, latched: true, depth: 3 });
        assert_eq!(of("- history: keep_all\n  depth: 0\n", false).depth, 1000);
        assert_eq!(of("- depth: 99999999\n", false).depth, 1000);
    }

    #[test]
    fn what_is_not_said_is_what_a_node_does() {
        let unknown = "- history: unknown\n  depth: 0\n  reliability: reliable\n  durability: transient_local\n";
        assert_eq!(of(unknown, true), Offer { reliable: true, latched: true, depth: 1 });
        assert_eq!(of("", false), Offer { reliable: true, latched: false, depth: 10 });
        assert_eq!(of("depth: x\nreliability: no", true), Offer { reliable: true, latched: true, depth: 1 });
    }
}
