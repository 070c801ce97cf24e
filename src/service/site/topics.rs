//! Topics of the graph: listed with their rates, watched and unwatched.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use tokio::task::block_in_place;

use super::{RosState, Site};
use crate::model::{ProfileName, Timestamp, TopicName, TypeName, clean};
use crate::pipeline::Owner;
use crate::service::reply::{Failure, Reply, TopicRow};

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
        for (topic, type_name) in &watches {
            if !rows.iter().any(|row| row.topic == topic.as_str()) {
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
        for row in &mut rows {
            (row.messages, row.quarantined) = captured.get(&row.topic).copied().unwrap_or_default();
            row.alarm = alarms.contains(&row.topic);
            row.watched = watches.iter().any(|(topic, _)| topic.as_str() == row.topic);
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
        let losses = self.recorder.losses(topic);
        TopicRow {
            topic: clean(topic, 255),
            type_name: type_name.map(|name| clean(name, 255)),
            publishers,
            watched: false,
            simulated,
            hz: rate.map(|rate| rate.hz),
            bytes_per_second: rate.map(|rate| rate.bytes_per_second),
            messages: 0,
            lost_in_transport: losses.in_transport,
            lost_in_recorder: losses.in_recorder,
            left_out: losses.left_out,
            last_message: rate.and_then(|rate| rate.last),
            quarantined: 0,
            alarm: false,
        }
    }

    /// Messages captured, and those of them in quarantine.
    fn captured_by_topic(&self, profile: &ProfileName) -> Result<HashMap<String, (u64, u64)>, Failure> {
        let Some(owner) = self.owner(profile) else { return Ok(HashMap::new()) };
        let counts = block_in_place(|| self.plant.ledger.counts(Some(owner.address)))?;
        Ok(counts.topics.into_iter().map(|topic| (topic.topic, (topic.captured, topic.quarantined))).collect())
    }

    /// Topics with an open alarm about a publisher.
    fn alarmed_topics(&self, profile: &ProfileName) -> Result<HashSet<String>, Failure> {
        let Some(owner) = self.owner(profile) else { return Ok(HashSet::new()) };
        let alarms = block_in_place(|| self.plant.ledger.alarms(owner.address, None))?;
        Ok(alarms.into_iter().filter(|alarm| alarm.open).map(|alarm| alarm.topic).collect())
    }

    fn watches(&self, profile: &ProfileName) -> Result<Watches, Failure> {
        let text = self.plant.ledger.setting(&key(profile))?;
        Ok(text.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default())
    }

    fn save_watches(&self, profile: &ProfileName, watches: &Watches) -> Result<(), Failure> {
        let text = serde_json::to_string(watches).unwrap_or_default();
        Ok(self.plant.ledger.put_setting(&key(profile), &text)?)
    }

    /// Captures a topic until it is unwatched, over restarts.
    pub(super) async fn watch_topic(
        self: &Arc<Self>,
        profile: &ProfileName,
        topic: TopicName,
        type_name: Option<TypeName>,
    ) -> Result<Reply, Failure> {
        block_in_place(|| {
            let mut watches = self.watches(profile)?;
            watches.retain(|(watched, _)| *watched != topic);
            watches.push((topic.clone(), type_name.clone()));
            self.save_watches(profile, &watches)
        })?;
        self.record_audit(profile, "watch", topic.as_str(), "done").await?;
        if let Some(owner) = self.owner(profile) {
            if !matches!(&*self.ros.borrow(), RosState::Off) && owner.sealing().is_none() {
                self.register(&owner).await?;
            }
            self.recorder.watch(topic.as_str(), &owner.author, type_name);
            self.wishes_changed();
        }
        Ok(Reply::Done)
    }

    /// Stops capturing a topic.
    pub(super) async fn unwatch_topic(
        self: &Arc<Self>,
        profile: &ProfileName,
        topic: &TopicName,
    ) -> Result<Reply, Failure> {
        block_in_place(|| {
            let mut watches = self.watches(profile)?;
            watches.retain(|(watched, _)| watched != topic);
            self.save_watches(profile, &watches)
        })?;
        self.record_audit(profile, "unwatch", topic.as_str(), "done").await?;
        if let Some(owner) = self.owner(profile) {
            self.recorder.unwatch(topic.as_str(), &owner.author);
            self.wishes_changed();
        }
        Ok(Reply::Done)
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
