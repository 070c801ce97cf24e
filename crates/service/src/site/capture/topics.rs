//! Topics of the graph, their rates, and the rules for them.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::time::Duration;

use tokio::task::block_in_place;

use super::Capture;
use super::second::GraphOf;
use crate::model::{ProfileName, Timestamp, TopicName, TopicRule, TypeName, clean, pinned_name};
use crate::service::failure::input;
use crate::service::reply::{Failure, HeldUp, PolicyRow, PolicyView, TopicRow};
use crate::store::TopicCounts;

/// The longest look at the graph, milliseconds.
const LONGEST: u64 = 600_000;

impl Capture {
    pub async fn topics(&self, profile: &ProfileName) -> Result<Vec<TopicRow>, Failure> {
        let link = self.ros.any().await?;
        let watches = block_in_place(|| self.watches.of(profile))?;
        let now = Timestamp::now();
        let of_two = self.ros.second.topics();
        let in_two = |name: &str| of_two.iter().any(|topic| topic.name == name);
        let mut rows: Vec<TopicRow> = link
            .iter()
            .flat_map(|link| link.topics())
            .filter(|info| !(in_two(&info.name) && self.ros.second.graph_of(info) == GraphOf::Two))
            .map(|info| {
                let simulated = info.publishers.iter().any(|publisher| self.recorder.is_simulated(publisher));
                self.topic_row(&info.name, info.type_name.as_deref(), &info.publishers, simulated, now)
            })
            .collect();
        for topic in &of_two {
            if !rows.iter().any(|row| row.topic == topic.name) {
                let row = self.topic_row(&topic.name, Some(&topic.type_name), &topic.publishers, false, now);
                let type_hash = topic.type_hash.as_deref().map(|hash| clean(hash, 80));
                rows.push(TopicRow { ros: 2, type_hash, qos: Some(topic.quality_text()), ..row });
            }
        }
        let published: HashSet<String> = rows.iter().map(|row| row.topic.clone()).collect();
        for (topic, type_name) in &watches {
            if !published.contains(topic.as_str()) {
                let type_name = type_name.as_ref().map(TypeName::as_str);
                rows.push(self.topic_row(topic.as_str(), type_name, &[], false, now));
            }
        }
        let captured = self.captured_by_topic(profile)?;
        let alarms = self.pins.alarmed_topics(profile)?;
        let pins = self.pins.pinned_names(profile)?;
        let sealing = self.parts.owners.get(profile).filter(|owner| owner.sealing().is_some());
        let full = self.parts.plant.ledger.records.takes_records().is_err();
        let watched: HashSet<&str> = watches.iter().map(|(topic, _)| topic.as_str()).collect();
        let mut unreached = self.ros.unreached();
        for row in &mut rows {
            row.unreached = unreached.remove(&row.topic).filter(|_| row.ros == 1).unwrap_or_default();
            if let Some(pinned) = pins.get(&row.topic) {
                row.pins = pinned.len() as u64;
                row.unpinned =
                    row.publishers.iter().filter(|name| !pinned.contains(&*pinned_name(name))).cloned().collect();
            }
            if let Some(counts) = captured.get(&row.topic) {
                (row.messages, row.quarantined) = (counts.captured, counts.quarantined);
                (row.lost_in_transport, row.lost_in_recorder) = (counts.missed, counts.lost);
            }
            row.alarm = alarms.contains(&row.topic);
            row.watched = watched.contains(row.topic.as_str());
            row.held_up = match &sealing {
                _ if !row.watched => None,
                Some(owner) => (full || !self.recorder.is_watched(&row.topic, owner.address)).then_some(HeldUp::Paused),
                None => Some(HeldUp::WaitsForKey),
            };
        }
        rows.sort_by(|one, other| one.topic.cmp(&other.topic));
        Ok(rows)
    }

    fn topic_row(
        &self,
        topic: &str,
        type_name: Option<&str>,
        publishers: &[String],
        simulated: bool,
        now: Timestamp,
    ) -> TopicRow {
        let rate = self.recorder.meter().rate(topic, now);
        TopicRow {
            topic: clean(topic, 255),
            ros: 1,
            type_name: type_name.map(|name| clean(name, 255)),
            publishers: publishers.iter().map(|publisher| clean(publisher, 255)).collect(),
            simulated,
            hz: rate.map(|rate| rate.hz),
            bytes_per_second: rate.map(|rate| rate.bytes_per_second),
            left_out: self.recorder.left_out(topic),
            last_message: rate.and_then(|rate| rate.last),
            ..TopicRow::default()
        }
    }

    fn captured_by_topic(&self, profile: &ProfileName) -> Result<HashMap<String, TopicCounts>, Failure> {
        let Ok(owner) = self.parts.owners.address_of(profile) else { return Ok(HashMap::new()) };
        let counts = block_in_place(|| self.losses.counts(&self.parts.plant, owner))?;
        Ok(counts.topics.into_iter().map(|topic| (topic.topic.clone(), topic)).collect())
    }

    pub async fn watch(
        &self,
        profile: &ProfileName,
        topic: TopicName,
        type_name: Option<TypeName>,
    ) -> Result<(), Failure> {
        let listed = async {
            self.watches.change(profile, |watches| {
                watches.retain(|(watched, _)| *watched != topic);
                watches.push((topic.clone(), type_name.clone()));
            })
        };
        self.parts.log.deed(profile, "watch", topic.as_str(), listed).await?;
        if let Some(owner) = self.parts.owners.get(profile) {
            if self.ros.is_wanted() && owner.sealing().is_none() {
                self.profiles.register(&owner).await?;
            }
            self.recorder.watch(topic.as_str(), &owner.author, type_name);
            self.ros.wishes_changed();
        }
        Ok(())
    }

    pub async fn unwatch(&self, profile: &ProfileName, topic: &TopicName) -> Result<(), Failure> {
        let removed = async { self.watches.change(profile, |watches| watches.retain(|(watched, _)| watched != topic)) };
        self.parts.log.deed(profile, "unwatch", topic.as_str(), removed).await?;
        if let Some(owner) = self.parts.owners.get(profile) {
            self.ros.second.settle(Some(topic.as_str()));
            self.recorder.unwatch(topic.as_str(), &owner.author);
            self.ros.wishes_changed();
        }
        Ok(())
    }

    pub fn hold(&self, profile: &ProfileName, hold: bool) -> Result<(), Failure> {
        let Some(owner) = self.parts.owners.get(profile) else { return Ok(()) };
        if hold {
            self.ros.second.settle(None);
        }
        if hold { self.watches.hold(&owner) } else { self.watches.restore(&owner) }
    }

    pub async fn learn_policy(&self, profile: &ProfileName, milliseconds: u64) -> Result<PolicyView, Failure> {
        if !(1000..=LONGEST).contains(&milliseconds) {
            return Err(input("observe the topics for 1 second to 10 minutes, as with `--for 5s`"));
        }
        self.ros.any().await?;
        let learning = Arc::clone(&self.ros.learning);
        self.ros.wishes_changed();
        tokio::select! {
            () = tokio::time::sleep(Duration::from_millis(milliseconds)) => {}
            () = self.parts.life.stopped() => {}
        }
        let view = self.policy_view(profile, true).await;
        drop(learning);
        self.ros.wishes_changed();
        view
    }

    pub async fn policy_view(&self, profile: &ProfileName, learned: bool) -> Result<PolicyView, Failure> {
        let rules = &self.parts.config.topic_rules;
        let row = |row: TopicRow| PolicyRow {
            rule: rules.of(&row.topic).map(|rule| TopicRule::clone(rule)),
            left_out: row.left_out,
            largest: self.recorder.meter().largest(&row.topic),
            hz: row.hz,
            bytes_per_second: row.bytes_per_second,
            watched: row.watched,
            type_name: row.type_name,
            topic: row.topic,
        };
        let topics: Vec<PolicyRow> = self.topics(profile).await?.into_iter().map(row).collect();
        let followed = |rule: &TopicRule| topics.iter().any(|row| row.rule.as_ref() == Some(rule));
        let idle = rules.0.iter().filter(|rule| !followed(rule)).map(|rule| TopicRule::clone(rule)).collect();
        Ok(PolicyView { topics, idle, learned })
    }
}
