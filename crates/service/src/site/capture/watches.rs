//! Watch lists: the topics that each profile captures until it unwatches them, across restarts.

use std::sync::Arc;

use tokio::task::block_in_place;

use super::ros::RosSide;
use crate::model::{ProfileName, TopicName, TypeName};
use crate::pipeline::{Owner, Plant, Recorder};
use crate::service::reply::Failure;
use crate::site::parts::Parts;

type List = Vec<(TopicName, Option<TypeName>)>;

/// The watch lists of a home.
pub(in crate::site) struct Watches {
    plant: Plant,
    recorder: Arc<Recorder>,
    ros: Arc<RosSide>,
}

impl Watches {
    /// Lists followed by `recorder`.
    pub fn new(parts: &Parts, recorder: &Arc<Recorder>, ros: &Arc<RosSide>) -> Self {
        Self { plant: parts.plant.clone(), recorder: Arc::clone(recorder), ros: Arc::clone(ros) }
    }

    /// The list of a profile.
    pub fn of(&self, profile: &ProfileName) -> Result<List, Failure> {
        Ok(read(self.plant.ledger.setting(&key(profile))?.as_deref()))
    }

    /// Reads, changes and stores a watch list; of several simultaneous changes none is lost.
    pub fn change(&self, profile: &ProfileName, change: impl FnOnce(&mut List)) -> Result<(), Failure> {
        let changed = |text: Option<&str>| {
            let mut watches = read(text);
            change(&mut watches);
            Ok((serde_json::to_string(&watches).unwrap_or_default(), ()))
        };
        block_in_place(|| self.plant.ledger.change_setting(&key(profile), changed))
    }

    /// The recorder stops watching for the owner, until it is restored.
    pub fn hold(&self, owner: &Arc<Owner>) {
        for (topic, _) in block_in_place(|| self.of(&owner.profile)).unwrap_or_default() {
            self.recorder.unwatch(topic.as_str(), &owner.author);
        }
        self.ros.wishes_changed();
    }

    /// The recorder resumes what the owner watched before.
    pub fn restore(&self, owner: &Arc<Owner>) {
        let watches = block_in_place(|| self.of(&owner.profile)).unwrap_or_default();
        for (topic, type_name) in watches {
            self.recorder.watch(topic.as_str(), &owner.author, type_name);
        }
        self.ros.wishes_changed();
    }
}

fn read(text: Option<&str>) -> List {
    text.and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default()
}

fn key(profile: &ProfileName) -> String {
    format!("watch:{profile}")
}
