//! Topics of the graph: listed with their rates, watched and unwatched.

use std::collections::{HashMap, HashSet};
use std::sync::{Arc, PoisonError};

use tokio::task::block_in_place;

use super::{RosState, Site};
use crate::model::{ProfileName, Timestamp, TopicName, TypeName, clean};
use crate::pipeline::Owner;
use crate::service::reply::{Failure, HeldUp, TopicRow};
use crate::store::TopicCounts;

type Watches = Vec<(TopicName, Option<TypeName>)>;

impl Site {
    /// Every topic of the graph, and those watched that nobody publishes yet.
    pub(super) async fn topic_rows(self: &Arc<Self>, profile: &ProfileName) -> Result<Vec<TopicRow>, Failure> {
        let link = self.ros_link().await?;
        let watches = block_in_place(|| self.watches(profile))?;
        let now = Timestamp::now();
        let mut rows: Vec<TopicRow> = link
            .topics()
            .iter()
            .map(|info| {
                let simulated = info.publishers.iter().any(|publisher| self.recorder.is_simulated(publisher));
                let publishers = info.publishers.iter().map(|publisher| clean(publisher, 255)).collect();
                self.topic_row(&info.name, info.type_name.as_deref(), publishers, simulated, now)
            })
            .collect();
        let published: HashSet<String> = rows.iter().map(|row| row.topic.clone()).collect();
        for (topic, type_name) in &watches {
            if !published.contains(topic.as_str()) {
                rows.push(self.topic_row(
                    topic.as_str(),
                    type_name.as_ref().map(TypeName::as_str),
                    Vec::new(),
                    false,
                    now,
                ));
            }
        }
        let captured = self.captured_by_topic(profile)?;
        let alarms = self.alarmed_topics(profile)?;
        let pins = self.pinned_names(profile)?;
        let owner = self.owner(profile).filter(|owner| owner.sealing().is_some());
        let full = self.plant.ledger.takes_records().is_err();
        let watched: HashSet<&str> = watches.iter().map(|(topic, _)| topic.as_str()).collect();
        for row in &mut rows {
            if let Some(pinned) = pins.get(&row.topic) {
                row.pins = pinned.len() as u64;
                row.unpinned = row.publishers.iter().filter(|name| !pinned.contains(*name)).cloned().collect();
            }
            if let Some(counts) = captured.get(&row.topic) {
                (row.messages, row.quarantined) = (counts.captured, counts.quarantined);
                (row.lost_in_transport, row.lost_in_recorder) = (counts.missed, counts.lost);
            }
            row.alarm = alarms.contains(&row.topic);
            row.watched = watched.contains(row.topic.as_str());
            row.held_up = match &owner {
                _ if !row.watched => None,
                None => Some(HeldUp::WaitsForKey),
                Some(owner) => (full || !self.records(&row.topic, owner)).then_some(HeldUp::Paused),
            };
        }
        rows.sort_by(|one, other| one.topic.cmp(&other.topic));
        Ok(rows)
    }

    fn topic_row(
        &self,
        topic: &str,
        type_name: Option<&str>,
        publishers: Vec<String>,
        simulated: bool,
        now: Timestamp,
    ) -> TopicRow {
        let rate = self.recorder.meter().rate(topic, now);
        TopicRow {
            topic: clean(topic, 255),
            type_name: type_name.map(|name| clean(name, 255)),
            publishers,
            watched: false,
            held_up: None,
            simulated,
            hz: rate.map(|rate| rate.hz),
            bytes_per_second: rate.map(|rate| rate.bytes_per_second),
            messages: 0,
            lost_in_transport: 0,
            lost_in_recorder: 0,
            left_out: self.recorder.left_out(topic),
            last_message: rate.and_then(|rate| rate.last),
            pins: 0,
            unpinned: Vec::new(),
            quarantined: 0,
            alarm: false,
        }
    }

    /// What became of the profile's messages, by topic.
    fn captured_by_topic(&self, profile: &ProfileName) -> Result<HashMap<String, TopicCounts>, Failure> {
        let Ok(owner) = self.address_of(profile) else { return Ok(HashMap::new()) };
        let counts = block_in_place(|| self.losses.counts(&self.plant, owner))?;
        Ok(counts.topics.into_iter().map(|topic| (topic.topic.clone(), topic)).collect())
    }

    /// Topics with an open alarm about a publisher.
    fn alarmed_topics(&self, profile: &ProfileName) -> Result<HashSet<String>, Failure> {
        let Ok(owner) = self.address_of(profile) else { return Ok(HashSet::new()) };
        let alarms = block_in_place(|| self.plant.ledger.alarms(owner, None))?;
        Ok(alarms.into_iter().filter(|alarm| alarm.open).map(|alarm| alarm.topic).collect())
    }

    /// Node names pinned to each topic, by the operator, by first sight or by the settings.
    fn pinned_names(&self, profile: &ProfileName) -> Result<HashMap<String, HashSet<String>>, Failure> {
        let Ok(owner) = self.address_of(profile) else { return Ok(HashMap::new()) };
        let kept = block_in_place(|| self.plant.ledger.pins(owner, None))?;
        let kept = kept.into_iter().map(|row| (row.topic, row.publisher.caller_id));
        let listed = self.pins.all_listed().map(|(topic, publisher)| (topic.clone(), publisher.caller_id.clone()));
        let mut names: HashMap<String, HashSet<String>> = HashMap::new();
        for (topic, caller_id) in kept.chain(listed) {
            names.entry(clean(&topic, 255)).or_default().insert(clean(&caller_id, 255));
        }
        Ok(names)
    }

    fn watches(&self, profile: &ProfileName) -> Result<Watches, Failure> {
        let text = self.plant.ledger.setting(&key(profile))?;
        Ok(text.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default())
    }

    /// Reads, changes and keeps a watch list; of several changes at once none is lost.
    fn change_watches(&self, profile: &ProfileName, change: impl FnOnce(&mut Watches)) -> Result<(), Failure> {
        block_in_place(|| {
            let _one_at_a_time = self.watching.lock().unwrap_or_else(PoisonError::into_inner);
            let mut watches = self.watches(profile)?;
            change(&mut watches);
            let text = serde_json::to_string(&watches).unwrap_or_default();
            Ok(self.plant.ledger.put_setting(&key(profile), &text)?)
        })
    }

    /// Captures a topic until it is unwatched, over restarts.
    pub(super) async fn watch_topic(
        self: &Arc<Self>,
        profile: &ProfileName,
        topic: TopicName,
        type_name: Option<TypeName>,
    ) -> Result<(), Failure> {
        self.change_watches(profile, |watches| {
            watches.retain(|(watched, _)| *watched != topic);
            watches.push((topic.clone(), type_name.clone()));
        })?;
        self.record_audit(profile, "watch", topic.as_str(), "done").await?;
        if let Some(owner) = self.owner(profile) {
            if !matches!(&*self.ros.borrow(), RosState::Off) && owner.sealing().is_none() {
                self.register(&owner).await?;
            }
            self.recorder.watch(topic.as_str(), &owner.author, type_name);
            self.wishes_changed();
        }
        Ok(())
    }

    /// Stops capturing a topic.
    pub(super) async fn unwatch_topic(
        self: &Arc<Self>,
        profile: &ProfileName,
        topic: &TopicName,
    ) -> Result<(), Failure> {
        self.change_watches(profile, |watches| watches.retain(|(watched, _)| watched != topic))?;
        self.record_audit(profile, "unwatch", topic.as_str(), "done").await?;
        if let Some(owner) = self.owner(profile) {
            self.recorder.unwatch(topic.as_str(), &owner.author);
            self.wishes_changed();
        }
        Ok(())
    }

    fn records(&self, topic: &str, owner: &Owner) -> bool {
        self.recorder.is_watched(topic, owner.address)
    }

    /// Holds the capture of everything that the profile watches, or lets it go on; what is watched stays so.
    pub(super) fn hold_capture(&self, profile: &ProfileName, hold: bool) {
        let Some(owner) = self.owner(profile) else { return };
        if !hold {
            return self.restore_watches(&owner);
        }
        for (topic, _) in block_in_place(|| self.watches(profile)).unwrap_or_default() {
            self.recorder.unwatch(topic.as_str(), &owner.author);
        }
        self.wishes_changed();
    }

    /// The recorder takes up what the owner watched before.
    pub(super) fn restore_watches(&self, owner: &Arc<Owner>) {
        let watches = block_in_place(|| self.watches(&owner.profile)).unwrap_or_default();
        for (topic, type_name) in watches {
            self.recorder.watch(topic.as_str(), &owner.author, type_name);
        }
        self.wishes_changed();
    }
}

fn key(profile: &ProfileName) -> String {
    format!("watch:{profile}")
}
