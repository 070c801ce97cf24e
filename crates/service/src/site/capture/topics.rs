//! Topics of the graph, their rates, and the rules for them.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::sync::Arc;
use std::time::Duration;

use tokio::task::block_in_place;

use super::Capture;
use super::second::GraphOf;
use crate::model::{
    ProfileName, Sampling, Timestamp, TopicName, TopicPattern, TopicRule, TypeName, WatchRule, clean, natural,
    pinned_name,
};
use crate::service::failure::input;
use crate::service::reply::{HeldUp, PolicyRow, PolicyView, Result, TopicRow};
use crate::store::TopicCounts;

/// The longest look at the graph, milliseconds.
const LONGEST: u64 = 600_000;

impl Capture {
    pub async fn topics(&self, profile: &ProfileName) -> Result<Vec<TopicRow>> {
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
        for WatchRule { pattern, type_name, .. } in watches.named() {
            if !published.contains(pattern.as_str()) {
                let type_name = type_name.as_ref().map(TypeName::as_str);
                rows.push(self.topic_row(pattern.as_str(), type_name, &[], false, now));
            }
        }
        let captured = self.captured_by_topic(profile)?;
        let alarms = self.pins.alarmed_topics(profile)?;
        let pins = self.pins.pinned_names(profile)?;
        let sealing = self.parts.owners.get(profile).filter(|owner| owner.sealing().is_some());
        let full = self.parts.plant.ledger.records.takes_records().is_err();
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
            let rule = watches.of(&row.topic);
            row.watched = rule.is_some();
            row.watched_type = rule.and_then(|rule| rule.type_name.clone());
            let of_settings = self.parts.config.topic_rules.of(&row.topic).map(|rule| rule.sampling());
            row.sampling = rule.and_then(|rule| rule.sampling).or(of_settings).unwrap_or_default();
            row.watched_by = rule.filter(|rule| !rule.pattern.is_plain()).map(|rule| rule.pattern.to_string());
            row.held_up = match &sealing {
                _ if !row.watched => None,
                Some(owner) => (full || !self.recorder.is_watched(&row.topic, owner.address)).then_some(HeldUp::Paused),
                None => Some(HeldUp::WaitsForKey),
            };
        }
        rows.sort_by(|one, other| natural(&one.topic, &other.topic));
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

    fn captured_by_topic(&self, profile: &ProfileName) -> Result<HashMap<String, TopicCounts>> {
        let Ok(owner) = self.parts.owners.address_of(profile) else { return Ok(HashMap::new()) };
        let counts = block_in_place(|| self.losses.counts(&self.parts.plant, owner))?;
        Ok(counts.topics.into_iter().map(|topic| (topic.topic.clone(), topic)).collect())
    }

    pub async fn watch(
        &self,
        profile: &ProfileName,
        topic: TopicPattern,
        type_name: Option<TypeName>,
        sampling: Option<Sampling>,
    ) -> Result<()> {
        let listed = async { self.watches.change(profile, |rules| rules.watch(topic.clone(), type_name, sampling)) };
        let subject = sampling.map_or_else(|| topic.to_string(), |sampling| format!("{topic}: {sampling}"));
        self.parts.log.deed(profile, "watch", &subject, listed).await?;
        if let Some(owner) = self.parts.owners.get(profile) {
            if self.ros.is_wanted() && owner.sealing().is_none() {
                self.profiles.register(&owner).await?;
            }
            self.watches.apply(&owner)?;
        }
        Ok(())
    }

    pub async fn unwatch(&self, profile: &ProfileName, topic: &TopicPattern) -> Result<()> {
        let removed = async {
            let mut found = false;
            self.watches.change(profile, |rules| found = rules.unwatch(topic))?;
            if found || topic.is_plain() {
                return Ok(());
            }
            Err(input(format!("nothing that is watched matches {topic}; `authros topics list` shows what is")))
        };
        self.parts.log.deed(profile, "unwatch", topic.as_str(), removed).await?;
        if let Some(owner) = self.parts.owners.get(profile) {
            let wanted = self.recorder.wanted();
            let ended = wanted.iter().filter(|name| topic.matches(name));
            ended.for_each(|name| self.ros.second.settle(Some(name)));
            self.watches.apply(&owner)?;
        }
        Ok(())
    }

    /// Topics of the graphs and those watched by name, and those with own records if `recorded`.
    pub async fn known(&self, profile: &ProfileName, recorded: bool) -> Result<BTreeSet<TopicName>> {
        let watches = block_in_place(|| self.watches.of(profile))?;
        let mut known: BTreeSet<TopicName> = watches.named().filter_map(|rule| rule.pattern.name()).collect();
        if self.ros.is_wanted() {
            self.ros.any().await?;
            known.extend(self.ros.names());
        }
        let kept = if recorded { self.captured_by_topic(profile)? } else { HashMap::new() };
        known.extend(kept.keys().filter_map(|name| name.parse().ok()));
        Ok(known)
    }

    /// Names as they are, and what matches the patterns: see [`Self::known`].
    pub async fn named(
        &self,
        profile: &ProfileName,
        topics: &[TopicPattern],
        recorded: bool,
    ) -> Result<Vec<TopicName>> {
        let known = match topics.iter().all(TopicPattern::is_plain) {
            true => BTreeSet::new(),
            false => self.known(profile, recorded).await?,
        };
        let mut names = Vec::new();
        for topic in topics {
            let before = names.len();
            match topic.name() {
                Some(name) => names.push(name),
                None => names.extend(known.iter().filter(|name| topic.matches(name.as_str())).cloned()),
            }
            if names.len() == before {
                return Err(input(format!(
                    "no topic matches {topic} now; `authros topics list` shows those of the graph"
                )));
            }
        }
        let mut once = HashSet::new();
        names.retain(|name| once.insert(name.clone()));
        Ok(names)
    }

    pub fn hold(&self, profile: &ProfileName, hold: bool) -> Result<()> {
        let Some(owner) = self.parts.owners.get(profile) else { return Ok(()) };
        if !hold {
            return self.watches.restore(&owner);
        }
        self.ros.second.settle(None);
        self.watches.hold(&owner);
        Ok(())
    }

    pub async fn learn_policy(&self, profile: &ProfileName, milliseconds: u64) -> Result<PolicyView> {
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

    pub async fn policy_view(&self, profile: &ProfileName, learned: bool) -> Result<PolicyView> {
        let rules = &self.parts.config.topic_rules;
        let row = |row: TopicRow| PolicyRow {
            sampling: row.sampling,
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
