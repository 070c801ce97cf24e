//! Watch lists: what each profile captures across restarts, by name and by pattern.

use std::collections::HashSet;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::task::block_in_place;

use super::ros::RosSide;
use crate::model::{ProfileName, WatchRules};
use crate::pipeline::{Owner, Recorder};
use crate::service::reply::Result;
use crate::site::parts::Parts;
use crate::store::notes::Watched;

pub(in crate::site) struct Watches {
    parts: Parts,
    recorder: Arc<Recorder>,
    ros: Arc<RosSide>,
    /// Profiles whose capture is paused.
    held: Mutex<HashSet<ProfileName>>,
}

impl Watches {
    pub fn new(parts: &Parts, recorder: &Arc<Recorder>, ros: &Arc<RosSide>) -> Self {
        let (recorder, ros) = (Arc::clone(recorder), Arc::clone(ros));
        Self { parts: parts.clone(), recorder, ros, held: Mutex::default() }
    }

    pub fn of(&self, profile: &ProfileName) -> Result<WatchRules> {
        Ok(self.parts.plant.ledger.notes.read(&Watched { profile: profile.clone() })?.unwrap_or_default())
    }

    pub fn change(&self, profile: &ProfileName, change: impl FnOnce(&mut WatchRules)) -> Result<()> {
        self.parts.plant.ledger.notes.change(&Watched { profile: profile.clone() }, |rules: &mut WatchRules| {
            change(rules);
            Ok(())
        })
    }

    pub fn hold(&self, owner: &Owner) {
        self.held.lock().unwrap_or_else(PoisonError::into_inner).insert(owner.profile.clone());
        self.recorder.set_watches(&owner.author, WatchRules::default());
        self.ros.wishes_changed();
    }

    pub fn restore(&self, owner: &Owner) -> Result<()> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner).remove(&owner.profile);
        self.apply(owner)
    }

    /// Captures what the profile's list says now, unless its capture is paused.
    pub fn apply(&self, owner: &Owner) -> Result<()> {
        if !self.held.lock().unwrap_or_else(PoisonError::into_inner).contains(&owner.profile) {
            let rules = block_in_place(|| self.of(&owner.profile))?;
            self.recorder.set_watches(&owner.author, rules);
        }
        self.ros.wishes_changed();
        Ok(())
    }
}
