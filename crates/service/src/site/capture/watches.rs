//! Watch lists: the topics that each profile captures until it unwatches them, across restarts.

use std::sync::{Arc, Mutex, PoisonError};

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
    /// Changes are made one at a time.
    changing: Mutex<()>,
}

impl Watches {
    /// Lists followed by `recorder`.
    pub fn new(parts: &Parts, recorder: &Arc<Recorder>, ros: &Arc<RosSide>) -> Self {
        Self {
            plant: parts.plant.clone(),
            recorder: Arc::clone(recorder),
            ros: Arc::clone(ros),
            changing: Mutex::default(),
        }
    }

    /// The list of a profile.
    pub fn of(&self, profile: &ProfileName) -> Result<List, Failure> {
        let text = self.plant.ledger.setting(&key(profile))?;
        Ok(text.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default())
    }

    /// Reads, changes and stores a watch list; of several simultaneous changes none is lost.
    pub fn change(&self, profile: &ProfileName, change: impl FnOnce(&mut List)) -> Result<(), Failure> {
        block_in_place(|| {
            let _one_at_a_time = self.changing.lock().unwrap_or_else(PoisonError::into_inner);
            let mut watches = self.of(profile)?;
            change(&mut watches);
            let text = serde_json::to_string(&watches).unwrap_or_default();
            Ok(self.plant.ledger.put_setting(&key(profile), &text)?)
        })
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

fn key(profile: &ProfileName) -> String {
    format!("watch:{profile}")
}
