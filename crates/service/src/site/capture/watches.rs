//! Watch lists: what each profile captures across restarts.

use std::sync::Arc;

use tokio::task::block_in_place;

use super::ros::RosSide;
use crate::model::{ProfileName, TopicName, TypeName};
use crate::pipeline::{Owner, Recorder};
use crate::service::reply::Failure;
use crate::site::parts::Parts;
use crate::store::notes::Watched;

type List = Vec<(TopicName, Option<TypeName>)>;

pub(in crate::site) struct Watches {
    parts: Parts,
    recorder: Arc<Recorder>,
    ros: Arc<RosSide>,
}

impl Watches {
    pub fn new(parts: &Parts, recorder: &Arc<Recorder>, ros: &Arc<RosSide>) -> Self {
        Self { parts: parts.clone(), recorder: Arc::clone(recorder), ros: Arc::clone(ros) }
    }

    pub fn of(&self, profile: &ProfileName) -> Result<List, Failure> {
        Ok(self.parts.plant.ledger.notes.read(&Watched { profile: profile.clone() })?.unwrap_or_default())
    }

    pub fn change(&self, profile: &ProfileName, change: impl FnOnce(&mut List)) -> Result<(), Failure> {
        self.parts.plant.ledger.notes.change(&Watched { profile: profile.clone() }, |watches: &mut List| {
            change(watches);
            Ok(())
        })
    }

    pub fn hold(&self, owner: &Arc<Owner>) -> Result<(), Failure> {
        for (topic, _) in block_in_place(|| self.of(&owner.profile))? {
            self.recorder.unwatch(topic.as_str(), &owner.author);
        }
        self.ros.wishes_changed();
        Ok(())
    }

    pub fn restore(&self, owner: &Arc<Owner>) -> Result<(), Failure> {
        let watches = block_in_place(|| self.of(&owner.profile))?;
        for (topic, type_name) in watches {
            self.recorder.watch(topic.as_str(), &owner.author, type_name);
        }
        self.ros.wishes_changed();
        Ok(())
    }
}
