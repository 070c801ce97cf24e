//! Pinned publishers of watched topics: shown, accepted and removed by the operator.

#[cfg(test)]
mod tests;

use crate::pipeline::Pins;
use crate::site::parts::Parts;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use tokio::task::block_in_place;

use crate::model::{ProfileName, Publisher, TopicName, clean};
use crate::pipeline::Owner;
use crate::service::event::Part;
use crate::service::failure::input;
use crate::service::reply::{AlarmView, PinView, PinsView, Result};

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
    pub async fn view(&self, profile: &ProfileName, topic: Option<&TopicName>) -> Result<PinsView> {
        let owner = self.parts.owners.address_of(profile)?;
        let topic = topic.map(|topic| topic.as_str().to_owned());
        let wanted = |name: &str| topic.as_deref().is_none_or(|topic| topic == name);
        let settings = self.pins.all_listed().filter(|(name, _)| wanted(name)).map(|(topic, publisher)| PinView {
            topic: topic.clone(),
            publisher: publisher.clone(),
            source: "settings".to_owned(),
            at: None,
        });
        let mut pins: Vec<PinView> = settings.collect();
        let kept = self.parts.plant.ledger.pins.list(owner, topic.as_deref())?;
        pins.extend(kept.into_iter().map(|row| PinView {
            topic: clean(&row.topic, 255),
            publisher: cleaned(row.publisher),
            source: row.source,
            at: Some(row.at),
        }));
        let alarms = self.parts.plant.ledger.pins.alarms(owner, topic.as_deref())?;
        let alarms = alarms.into_iter().map(|row| AlarmView {
            topic: clean(&row.topic, 255),
            publisher: clean(&row.publisher, WIDEST),
            ..row
        });
        Ok(PinsView { mode: self.pins.mode(), pins, alarms: alarms.collect() })
    }

    /// Accepts publishers of a topic; if none is named, those being read now.
    pub async fn pin(&self, profile: &ProfileName, topic: &TopicName, publishers: Vec<Publisher>) -> Result<PinsView> {
        let owner = self.parts.owners.address_of(profile)?;
        let publishers = if publishers.is_empty() { self.pins.live(topic.as_str()) } else { publishers };
        if publishers.is_empty() {
            return Err(input(format!(
                "no publisher of {topic} is being read at the moment; give it with --publisher CALLER_ID@HOST:TYPE:MD5"
            )));
        }
        for publisher in &publishers {
            let (subject, one) = (format!("{topic} {publisher}"), std::slice::from_ref(publisher));
            let pinned = async { Ok(block_in_place(|| self.pins.pin(owner, topic.as_str(), one))?) };
            self.parts.log.deed(profile, "pin", &subject, pinned).await?;
        }
        self.parts.hub.changed(Part::Topics);
        self.view(profile, Some(topic)).await
    }

    pub async fn unpin(&self, profile: &ProfileName, topic: &TopicName, caller_id: &str) -> Result<PinsView> {
        let owner = self.parts.owners.address_of(profile)?;
        let name = clean(caller_id, 255);
        if self.pins.listed(topic.as_str()).iter().any(|publisher| publisher.caller_id == caller_id) {
            return Err(input(format!("{name} is pinned to {topic} by ros.publishers; remove it there")));
        }
        let unpinned = async {
            match block_in_place(|| self.pins.unpin(owner, topic.as_str(), caller_id))? {
                0 => Err(input(format!(
                    "{name} is not pinned to {topic}; `authros topics pins` lists the pinned publishers"
                ))),
                _ => Ok(()),
            }
        };
        self.parts.log.deed(profile, "unpin", &format!("{topic} {name}"), unpinned).await?;
        self.parts.hub.changed(Part::Topics);
        self.view(profile, Some(topic)).await
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
