//! Pinned publishers of watched topics: shown, accepted and removed by the operator.

#[cfg(test)]
mod tests;

use std::collections::{BTreeSet, HashMap, HashSet};
use std::sync::Arc;

use tokio::task::block_in_place;

use crate::model::{Address, ProfileName, Publisher, TopicPattern, clean};
use crate::pipeline::{Owner, Pins};
use crate::reply::{AlarmView, Part, PinView, PinsView, Result, input};
use crate::site::Parts;
use crate::store::PinRow;

const WIDEST: usize = 400;

fn cleaned(publisher: Publisher) -> Publisher {
    let Publisher { caller_id, host, type_name, md5sum } = publisher;
    Publisher {
        caller_id: clean(&caller_id, 255),
        host: clean(&host, 255),
        type_name: clean(&type_name, 255),
        md5sum: clean(&md5sum, 64),
    }
}

pub(in crate::site) struct Pinning {
    pub parts: Parts,
    pub pins: Arc<Pins>,
}

impl Pinning {
    /// Needs no passphrase.
    pub async fn view(&self, profile: &ProfileName, topic: Option<&TopicPattern>) -> Result<PinsView> {
        let owner = self.parts.owners.address_of(profile)?;
        let wanted = |name: &str| topic.is_none_or(|topic| topic.matches(name));
        let settings = self.pins.all_listed().filter(|(name, _)| wanted(name)).map(|(topic, publisher)| PinView {
            topic: topic.clone(),
            publisher: publisher.clone(),
            source: "settings".to_owned(),
            at: None,
        });
        let mut pins: Vec<PinView> = settings.collect();
        let kept = self.parts.plant.ledger.pins.list(owner, None)?.into_iter().filter(|row| wanted(&row.topic));
        pins.extend(kept.map(|row| PinView {
            topic: clean(&row.topic, 255),
            publisher: cleaned(row.publisher),
            source: row.source,
            at: Some(row.at),
        }));
        let alarms = self.parts.plant.ledger.pins.alarms(owner, None)?;
        let alarms = alarms.into_iter().filter(|row| wanted(&row.topic)).map(|row| AlarmView {
            topic: clean(&row.topic, 255),
            publisher: clean(&row.publisher, WIDEST),
            ..row
        });
        Ok(PinsView { mode: self.pins.mode(), pins, alarms: alarms.collect() })
    }

    /// Accepts publishers of a topic; if none is named, those being read now of every topic that matches.
    pub async fn pin(&self, profile: &ProfileName, topic: &TopicPattern, given: Vec<Publisher>) -> Result<PinsView> {
        let owner = self.parts.owners.address_of(profile)?;
        let wanted: Vec<(String, Publisher)> = match (topic.name(), given.is_empty()) {
            (Some(name), false) => given.into_iter().map(|one| (name.to_string(), one)).collect(),
            (None, false) => {
                return Err(input(format!("name one topic for these publishers; {topic} stands for several")));
            }
            (_, true) => self.live_on(topic),
        };
        if wanted.is_empty() {
            return Err(input(format!(
                "no publisher of {topic} is being read at the moment; give it with --publisher CALLER_ID@HOST:TYPE:MD5"
            )));
        }
        for (name, publisher) in &wanted {
            let (subject, one) = (format!("{name} {publisher}"), std::slice::from_ref(publisher));
            let pinned = async { Ok(block_in_place(|| self.pins.pin(owner, name, one))?) };
            self.parts.log.deed(profile, "pin", &subject, pinned).await?;
        }
        self.parts.hub.changed(Part::Topics);
        self.view(profile, Some(topic)).await
    }

    fn live_on(&self, topic: &TopicPattern) -> Vec<(String, Publisher)> {
        let topics = self.pins.live_topics().into_iter().filter(|name| topic.matches(name));
        let of = |name: String| self.pins.live(&name).into_iter().map(move |one| (name.clone(), one));
        topics.flat_map(of).collect()
    }

    /// No longer accepts a node name on the topics that match.
    pub async fn unpin(&self, profile: &ProfileName, topic: &TopicPattern, caller_id: &str) -> Result<PinsView> {
        let owner = self.parts.owners.address_of(profile)?;
        let name = clean(caller_id, 255);
        let mut listed = self.pins.all_listed();
        if let Some((listed, _)) = listed.find(|(on, one)| topic.matches(on) && one.caller_id == caller_id) {
            return Err(input(format!("{name} is pinned to {listed} by ros.publishers; remove it there")));
        }
        let not_pinned = |topic: &str| {
            input(format!("{name} is not pinned to {topic}; `authros topics pins` lists the pinned publishers"))
        };
        let topics = match topic.name() {
            Some(name) => BTreeSet::from([name.to_string()]),
            None => self.pinned_to(owner, topic, caller_id)?,
        };
        if topics.is_empty() {
            return Err(not_pinned(topic.as_str()));
        }
        for topic in &topics {
            let unpinned = async {
                match block_in_place(|| self.pins.unpin(owner, topic, caller_id))? {
                    0 => Err(not_pinned(topic)),
                    _ => Ok(()),
                }
            };
            self.parts.log.deed(profile, "unpin", &format!("{topic} {name}"), unpinned).await?;
        }
        self.parts.hub.changed(Part::Topics);
        self.view(profile, Some(topic)).await
    }

    fn pinned_to(&self, owner: Address, topic: &TopicPattern, caller_id: &str) -> Result<BTreeSet<String>> {
        let kept = self.parts.plant.ledger.pins.list(owner, None)?.into_iter();
        let is_meant = |row: &PinRow| topic.matches(&row.topic) && row.publisher.caller_id == caller_id;
        Ok(kept.filter(is_meant).map(|row| row.topic).collect())
    }

    /// Topics with an open alarm about a publisher.
    pub fn alarmed_topics(&self, profile: &ProfileName) -> Result<HashSet<String>> {
        let Ok(owner) = self.parts.owners.address_of(profile) else { return Ok(HashSet::new()) };
        let alarms = self.parts.plant.ledger.pins.alarms(owner, None)?;
        Ok(alarms.into_iter().filter(|alarm| alarm.open).map(|alarm| alarm.topic).collect())
    }

    /// Node names pinned to each topic, by the operator, first sight or the settings.
    pub fn pinned_names(&self, profile: &ProfileName) -> Result<HashMap<String, HashSet<String>>> {
        let Ok(owner) = self.parts.owners.address_of(profile) else { return Ok(HashMap::new()) };
        let kept = self.parts.plant.ledger.pins.list(owner, None)?;
        let kept = kept.into_iter().map(|row| (row.topic, row.publisher.caller_id));
        let listed = self.pins.all_listed().map(|(topic, publisher)| (topic.clone(), publisher.caller_id.clone()));
        let mut names: HashMap<String, HashSet<String>> = HashMap::new();
        for (topic, caller_id) in kept.chain(listed) {
            names.entry(clean(&topic, 255)).or_default().insert(clean(&caller_id, 255));
        }
        Ok(names)
    }

    /// Names an owner's publishers by its profile.
    pub fn introduce(&self, owner: &Owner) {
        self.pins.introduce(owner.address, owner.profile.as_str());
    }
}
