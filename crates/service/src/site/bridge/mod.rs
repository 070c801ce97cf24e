//! Publishes checked, shared records in the reader's ROS.

mod feed;
mod names;
mod pacer;
mod play;
mod second;
mod stage;
mod target;

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::watch;
use tokio::task::block_in_place;

use crate::config::PublishedBy;
use crate::crypto::random_bytes;
use crate::model::bytes::hex;
use crate::model::{Address, ErrorKind, ProfileName, Scope, clean};
use crate::pipeline::{Network, Owner, PipelineError, authority};
use crate::ros::ros2::Ros2Publisher;
use crate::ros::{Graph, GraphPublisher, Publisher, RosError, RosrustPublisher, UNCONFINED};
use crate::service::command::{Pace, PlayWishes};
use crate::service::failure::{input, refused};
use crate::service::reply::Failure;
use crate::site::capture::ros::RosSide;
use crate::site::contacts::Contacts;
use crate::site::parts::Parts;

use names::Names;
use second::Domain;
use stage::Stage;
use target::Target;

const NODE: &str = "/authros_play_";

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

    fn givers(
        &self,
        owner: &Owner,
        network: &Network,
        wishes: &PlayWishes,
    ) -> Result<HashMap<Address, Scope>, Failure> {
        let wanted = wishes.owner.as_ref().map(|party| self.contacts.resolve(party)).transpose()?;
        let granted = authority::shared_with(&network.directory, owner.address);
        let granted = granted.into_iter().map(|grant| (grant.terms.owner, grant.terms.scope));
        let givers: HashMap<Address, Scope> =
            granted.filter(|(giver, _)| wanted.is_none_or(|wanted| wanted == *giver)).collect();
        match (givers.is_empty(), wanted) {
            (false, _) => Ok(givers),
            (true, Some(other)) => {
                let what = "its records".to_owned();
                Err(PipelineError::NotGranted { owner: other, reader: owner.address, what }.into())
            }
            (true, None) => {
                Err(refused("nobody shares records with this profile at the moment; see `authros grants list`"))
            }
        }
    }

    /// Also returns whether this site captures from there, in which case the names must keep apart.
    fn domain(&self, domain: u16, names: &Names) -> Result<(Box<dyn Target>, bool), Failure> {
        let is_captured = self.ros.is_wanted() && self.parts.config.ros_domain == Some(domain);
        if is_captured {
            names.keep_apart().map_err(|why| refused(format!("ROS 2 domain {domain} is {why}")))?;
        }
        let publisher = block_in_place(|| Ros2Publisher::start(domain, self.parts.config.ros2_program.as_deref()))?;
        self.tell_of_walls(publisher.is_confined());
        Ok((Box::new(Domain::new(publisher, names.prefix())), is_captured))
    }

    async fn stage(&self, wishes: &PlayWishes, names: &Names) -> Result<(Box<dyn Target>, bool), Failure> {
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
            let stage: Box<dyn Target> = Box::new(Stage::new(uri.clone(), graph, publisher, names.prefix()));
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

fn consistent(wishes: &PlayWishes) -> Result<(), Failure> {
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
