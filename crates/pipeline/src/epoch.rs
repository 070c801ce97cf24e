//! The keys of one epoch of one owner, with the topic keys derived so far.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, PoisonError};

use crate::crypto::{
    Enrolment, EpochIssue, FilterKey, IndexKey, IssuedTopic, SealingKey, SmKeyPair, TopicKey, filter_id, filter_key,
    signer_id, topic_filter_id, topic_id, topic_key,
};
use crate::importer::{FORMER, MCAP};
use crate::model::{Domain, FilterId, SignerId, Timestamp, Token, TopicId};
use crate::{model::head::SIMULATED, model::header::MOST_FILTERS, store::FilterChoice};

pub struct TopicKeys {
    pub id: TopicId,
    pub key: TopicKey,
    filters: Filters,
}

enum Filters {
    /// IK: the same ids on every topic.
    Index(IndexKey),
    /// The filter key of its topic, all that a device for some topics has.
    Topic(FilterKey),
}

impl Filters {
    fn id(&self, kind: &str, value: &str) -> FilterId {
        match self {
            Self::Index(index) => filter_id(index, kind, value),
            Self::Topic(key) => topic_filter_id(key, kind, value),
        }
    }
}

pub struct EpochKeys {
    pub domain: Domain,
    pub epoch: u64,
    pub token: Token,
    /// When sealing under it must end, if that is known; an owner has the next one ready by then.
    pub ends: Option<Timestamp>,
    pub signing: Arc<SmKeyPair>,
    /// SM3 of the signing key.
    pub signer: SignerId,
    key: SealingKey,
    index: Option<IndexKey>,
    topics: Mutex<HashMap<String, Arc<TopicKeys>>>,
}

impl EpochKeys {
    /// `signing` is the owner's pair or a lent device's; `index` is IK, which a device for some topics does not hold.
    pub fn new(
        domain: Domain,
        (epoch, token): (u64, Token),
        signing: SmKeyPair,
        key: SealingKey,
        index: impl Into<Option<IndexKey>>,
    ) -> Self {
        let signer = signer_id(&signing.public);
        Self {
            domain,
            epoch,
            token,
            ends: None,
            signing: Arc::new(signing),
            signer,
            key,
            index: index.into(),
            topics: Mutex::default(),
        }
    }

    pub fn issued(enrolment: &Enrolment, issue: &EpochIssue) -> Self {
        let (signing, key, index) = (enrolment.device.clone(), issue.key.clone(), enrolment.index.clone());
        let keys = Self::new(enrolment.domain, (issue.epoch, issue.token), signing, key, index);
        Self { ends: issue.ends, ..keys }
    }

    /// The topics they are limited to; `None` if they cover all.
    pub fn names(&self) -> Option<Vec<String>> {
        self.key.topics()
    }

    /// Derived once; `None` for a topic not covered.
    pub fn topic(&self, topic: &str) -> Option<Arc<TopicKeys>> {
        let mut topics = self.topics.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(keys) = topics.get(topic) {
            return Some(Arc::clone(keys));
        }
        let keys = Arc::new(self.derive(topic)?);
        topics.insert(topic.to_owned(), Arc::clone(&keys));
        Some(keys)
    }

    fn derive(&self, topic: &str) -> Option<TopicKeys> {
        match &self.key {
            SealingKey::Epoch(epoch) => {
                let index = self.index.clone()?;
                let id = topic_id(&index, topic);
                Some(TopicKeys { id, key: topic_key(epoch, &id), filters: Filters::Index(index) })
            }
            SealingKey::Topics(topics) => {
                let IssuedTopic { id, filters, key } = topics.get(topic)?.clone();
                Some(TopicKeys { id, key, filters: Filters::Topic(filters) })
            }
        }
    }
}

impl TopicKeys {
    /// The filter ids of a record, at most [`MOST_FILTERS`]: its type, whether it is simulated, then its other tags in
    /// order of their names; not what a recording says beside its messages, nor what they were in another home. A tag's
    /// filter is over `name=value`.
    pub fn filters(&self, type_name: &str, tags: &BTreeMap<String, String>) -> Vec<FilterId> {
        let is_simulated = |tag: &(&String, &String)| (tag.0.as_str(), tag.1.as_str()) == SIMULATED;
        let sought = |(name, _): &(&String, &String)| ![MCAP, FORMER].iter().any(|prefix| name.starts_with(prefix));
        let (first, rest): (Vec<_>, Vec<_>) = tags.iter().filter(sought).partition(is_simulated);
        let tags = first.into_iter().chain(rest).map(|(name, value)| self.filters.id("tag", &tag_text(name, value)));
        std::iter::once(self.filters.id("type", type_name)).chain(tags).take(MOST_FILTERS).collect()
    }
}

fn tag_text(name: &str, value: &str) -> String {
    format!("{name}={value}")
}

/// The ids by which records with a tag are found: that from IK and, for each of `topics`, that from its filter key.
pub fn tag_choice(index: &IndexKey, name: &str, value: &str, topics: &[TopicId]) -> FilterChoice {
    choice(index, "tag", &tag_text(name, value), topics)
}

/// Same, for a type.
pub fn type_choice(index: &IndexKey, type_name: &str, topics: &[TopicId]) -> FilterChoice {
    choice(index, "type", type_name, topics)
}

fn choice(index: &IndexKey, kind: &str, text: &str, topics: &[TopicId]) -> FilterChoice {
    let of_topic = |topic: &TopicId| (*topic, topic_filter_id(&filter_key(index, topic), kind, text));
    FilterChoice { id: filter_id(index, kind, text), by_topic: topics.iter().map(of_topic).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::{EpochKey, ProviderName, provider};

    fn keys(key: SealingKey) -> EpochKeys {
        let signing = SmKeyPair::generate(provider(ProviderName::default())).expect("pair");
        EpochKeys::new(Domain([1; 32]), (1, Token([2; 32])), signing, key, IndexKey::new([3; 32]))
    }

    #[test]
    fn scoped_keys_seal_as_those_of_the_epoch_and_nothing_else() {
        let epoch = EpochKey::new([4; 32]);
        let all = keys(SealingKey::Epoch(epoch.clone()));
        let index = IndexKey::new([3; 32]);
        let id = topic_id(&index, "/a");
        let one = all.topic("/a").expect("covered");
        let issued = IssuedTopic { id, filters: filter_key(&index, &id), key: topic_key(&epoch, &id) };
        let some = EpochKeys { index: None, ..keys(SealingKey::Topics([("/a".to_owned(), issued)].into())) };
        let other = some.topic("/a").expect("covered");
        assert_eq!((one.id, &one.key), (other.id, &other.key));
        assert!(all.topic("/b").is_some() && some.topic("/b").is_none());
        let tags: BTreeMap<String, String> = [("mission".to_owned(), "harbour".to_owned())].into();
        let choice = tag_choice(&index, "mission", "harbour", &[id]);
        for (keys, found) in [(&one, choice.id), (&other, choice.by_topic[&id])] {
            assert_eq!(keys.filters("x/Y", &tags)[1], found, "what readers look for");
        }
        let bare = EpochKeys { index: None, ..keys(SealingKey::Epoch(epoch)) };
        assert!(bare.topic("/a").is_none(), "no name without IK");
    }

    #[test]
    fn type_and_simulated_come_first_and_no_more_than_fit() {
        let keys = keys(SealingKey::Epoch(EpochKey::new([4; 32])));
        let tag = |name: &str, value: &str| tag_choice(&IndexKey::new([3; 32]), name, value, &[]).id;
        let tags: BTreeMap<String, String> = [("a", "1"), ("b", "2"), ("c", "3"), ("simulated", "true")]
            .map(|(name, value)| (name.to_owned(), value.to_owned()))
            .into();
        let expected =
            [filter_id(&IndexKey::new([3; 32]), "type", "x/Y"), tag("simulated", "true"), tag("a", "1"), tag("b", "2")];
        let topic = keys.topic("/a").expect("covered");
        assert_eq!(topic.filters("x/Y", &tags), expected);
        assert_eq!(topic.filters("x/Y", &BTreeMap::new()), &expected[..1]);
        let kept = BTreeMap::from([("mcap.sequence".to_owned(), "7".to_owned())]);
        assert_eq!(topic.filters("x/Y", &kept), &expected[..1], "what MCAP says beside a message is not searched for");
    }
}
