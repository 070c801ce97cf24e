//! Publishes checked, shared records in the reader's ROS.

mod feed;
mod play;
mod target;

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::watch;
use tokio::task::block_in_place;

use crate::config::PublishedBy;
use crate::crypto::random_bytes;
use crate::model::bytes::hex;
use crate::model::{Address, ErrorKind, ProfileName, Scope, TopicName, clean};
use crate::pipeline::{Network, Owner, PipelineError, authority};
use crate::ros::ros2::Ros2Publisher;
use crate::ros::{Graph, GraphPublisher, Publisher, RosError, RosrustPublisher, UNCONFINED};
use crate::service::command::{Pace, PlayWishes};
use crate::service::failure::{input, refused};
use crate::service::reply::{Failure, Result};
use crate::site::capture::ros::RosSide;
use crate::site::contacts::Contacts;
use crate::site::parts::Parts;

use target::{Domain, Stage, Target};

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
        let running = self.running.lock().unwrap_or_else(PoisonError::into_inner);
        running.iter().filter(|(owner, _)| owner == profile).for_each(|(_, stop)| {
            stop.send_replace(true);
        });
    }

    fn listed(&self, profile: &ProfileName) -> watch::Receiver<bool> {
        let (stop, stopped) = watch::channel(false);
        let mut running = self.running.lock().unwrap_or_else(PoisonError::into_inner);
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
        _ => Ok(()),
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
