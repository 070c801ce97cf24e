//! Into the reader's ROS: records shared by others, each checked first, published in a graph or domain as they were
//! captured.

mod feed;
mod names;
mod offer;
mod pacer;
mod play;
mod second;
mod stage;
mod target;

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{oneshot, watch};
use tokio::task::block_in_place;

use crate::config::{Config, PublishedBy};
use crate::crypto::random_bytes;
use crate::model::bytes::hex;
use crate::model::{Address, ErrorKind, ProfileName, Scope, clean};
use crate::pipeline::{Network, Owner, PipelineError, Plant, authority};
use crate::ros::ros2::Ros2Publisher;
use crate::ros::{Graph, GraphPublisher, Publisher, RosError, RosrustPublisher, UNCONFINED};
use crate::service::command::{Pace, PlayWishes};
use crate::service::event::NoticeLevel;
use crate::service::failure::{input, refused};
use crate::service::hub::Hub;
use crate::service::reply::{Failure, PlayedView};
use crate::site::audit::Log;
use crate::site::capture::ros::RosSide;
use crate::site::chain::link::Link;
use crate::site::contacts::Contacts;
use crate::site::lifetime::Lifetime;
use crate::site::parts::Parts;

use names::Names;
use play::{Ends, Play};
use second::Domain;
use stage::Stage;
use target::Target;

/// The name prefix of nodes that play; nodes that capture have another.
const NODE: &str = "/authros_play_";

/// A playback, and how to end it.
type Running = Mutex<Vec<(ProfileName, Arc<watch::Sender<bool>>)>>;

/// Shared records on their way into ROS graphs.
pub(in crate::site) struct Bridge {
    config: Arc<Config>,
    plant: Plant,
    hub: Arc<Hub>,
    log: Arc<Log>,
    link: Arc<Link>,
    life: Arc<Lifetime>,
    contacts: Arc<Contacts>,
    ros: Arc<RosSide>,
    running: Running,
}

/// Removes a playback from the list when it ends, however it ends.
struct Listed<'a> {
    running: &'a Running,
    stop: Arc<watch::Sender<bool>>,
}

impl Drop for Listed<'_> {
    fn drop(&mut self) {
        let mut running = self.running.lock().unwrap_or_else(PoisonError::into_inner);
        running.retain(|(_, other)| !Arc::ptr_eq(other, &self.stop));
    }
}

impl Bridge {
    /// From the shared parts.
    pub fn new(parts: &Parts, contacts: &Arc<Contacts>, ros: &Arc<RosSide>) -> Self {
        let Parts { config, plant, hub, log, link, life, .. } = parts.clone();
        let (contacts, ros) = (Arc::clone(contacts), Arc::clone(ros));
        Self { config, plant, hub, log, link, life, contacts, ros, running: Running::default() }
    }

    /// Ends a profile's playback; the answers follow.
    pub(in crate::site) fn stop(&self, profile: &ProfileName) {
        let running = self.running.lock().unwrap_or_else(PoisonError::into_inner);
        running.iter().filter(|(owner, _)| owner == profile).for_each(|(_, stop)| {
            stop.send_replace(true);
        });
    }

    /// Plays until all is played, a right ends, or somebody ends it; `gone` resolves when nobody waits any more.
    pub(in crate::site) async fn play(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        wishes: PlayWishes,
        gone: oneshot::Receiver<()>,
    ) -> Result<PlayedView, Failure> {
        let names = Names::of(&wishes)?;
        consistent(&wishes)?;
        let network = self.link.network().await?;
        let givers = self.givers(owner, &network, &wishes)?;
        let target = match wishes.domain {
            Some(domain) => Target::Domain(Box::new(self.domain(domain, &names)?)),
            None => Target::Graph(Box::new(self.stage(&wishes, &names).await?)),
        };
        let subject = subject(&wishes, target.name());
        self.log.begin(owner, "play records", &subject).await?;
        let (stop, stopped) = watch::channel(false);
        let stop = Arc::new(stop);
        let profile = owner.profile.clone();
        self.running.lock().unwrap_or_else(PoisonError::into_inner).push((profile, Arc::clone(&stop)));
        let _listed = Listed { running: &self.running, stop };
        let ends = Ends::new(gone, stopped, &self.life);
        let played = Play::new(self, &network, owner, givers, &wishes, names, target, ends).run().await;
        self.log.end(owner, "play records", &subject, played).await
    }

    /// Those who share with the reader now, limited to the request.
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

    /// The participant that will publish, once it is certain that there is no loop.
    fn domain(&self, domain: u16, names: &Names) -> Result<Domain, Failure> {
        let is_captured = self.ros.is_wanted() && self.config.ros_domain == Some(domain);
        if is_captured {
            names.keep_apart().map_err(|why| refused(format!("ROS 2 domain {domain} is {why}")))?;
        }
        let publisher = block_in_place(|| Ros2Publisher::start(domain, self.config.ros2_program.as_deref()))?;
        self.tell_of_walls(publisher.is_confined());
        Ok(Domain::new(publisher, names.prefix(), is_captured))
    }

    /// The node that will publish, once it is certain that there is no loop.
    async fn stage(&self, wishes: &PlayWishes, names: &Names) -> Result<Stage, Failure> {
        let own = match (self.ros.is_wanted(), &self.config.ros_master) {
            (false, _) => None,
            // While it is away, the site will still capture from it as soon as it is back.
            (true, Some(named)) => Some(named.clone()),
            (true, None) => Some(self.ros.uri().await?),
        };
        let uri = wishes.master.clone().or_else(|| own.clone()).or_else(|| self.config.ros_master.clone());
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
            Ok(Stage::new(uri.clone(), graph, publisher, names.prefix(), is_captured))
        })
    }

    fn tell_of_walls(&self, is_confined: bool) {
        if !is_confined {
            self.hub.notice(NoticeLevel::Warning, UNCONFINED);
        }
    }

    /// The node that publishes, by whom the settings say.
    fn publisher(&self, uri: &str, node: &str) -> Result<GraphPublisher, RosError> {
        let host = self.config.ros_host.as_deref();
        match self.config.publisher {
            PublishedBy::Own => Ok(Box::new(Publisher::start(uri, host, node)?)),
            PublishedBy::Rosrust => {
                let program = self.config.rosrust_program.as_deref();
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
