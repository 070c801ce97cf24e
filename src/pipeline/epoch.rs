//! The keys of one epoch of one owner, with the topic keys derived so far.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, PoisonError};

use crate::crypto::{
    Enrolment, EpochIssue, IndexKey, SealingKey, SmKeyPair, TopicKey, filter_id, signer_id, topic_id, topic_key,
};
use crate::model::header::MOST_FILTERS;
use crate::model::{Domain, FilterId, SignerId, Timestamp, Token, TopicId};

/// The tag of what simulated robots send.
pub const SIMULATED: (&str, &str) = ("simulated", "true");

/// What sealing a topic's records needs.
pub struct TopicKeys {
    /// The topic's pseudonym.
    pub id: TopicId,
    /// Seals its records in this epoch.
    pub key: TopicKey,
}

/// Everything that seals records in one epoch.
pub struct EpochKeys {
    /// The network.
    pub domain: Domain,
    /// The epoch's number.
    pub epoch: u64,
    /// Its public commitment.
    pub token: Token,
    /// When it must no longer be sealed under, where that is known; an owner has the next one ready by then.
    pub ends: Option<Timestamp>,
    /// Signs records.
    pub signing: Arc<SmKeyPair>,
    /// SM3 of the signing key.
    pub signer: SignerId,
    key: SealingKey,
    index: IndexKey,
    topics: Mutex<HashMap<String, Arc<TopicKeys>>>,
}

impl EpochKeys {
    /// The keys of an epoch; `signing` is the owner's pair or that of a lent device, `index` is IK.
    pub fn new(
        domain: Domain,
        (epoch, token): (u64, Token),
        signing: SmKeyPair,
        key: SealingKey,
        index: IndexKey,
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
            index,
            topics: Mutex::default(),
        }
    }

    /// The keys of an epoch as a device was given them.
    pub fn issued(enrolment: &Enrolment, issue: &EpochIssue) -> Self {
        let (signing, key, index) = (enrolment.device.clone(), issue.key.clone(), enrolment.index.clone());
        let keys = Self::new(enrolment.domain, (issue.epoch, issue.token), signing, key, index);
        Self { ends: issue.ends, ..keys }
    }

    /// The keys of a topic, derived once; `None` for a topic that these keys do not cover.
    pub fn topic(&self, topic: &str) -> Option<Arc<TopicKeys>> {
        let mut topics = self.topics.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(keys) = topics.get(topic) {
            return Some(Arc::clone(keys));
        }
        let id = topic_id(&self.index, topic);
        let key = match &self.key {
            SealingKey::Epoch(key) => topic_key(key, &id),
            SealingKey::Topics(keys) => keys.get(topic)?.clone(),
        };
        let keys = Arc::new(TopicKeys { id, key });
        topics.insert(topic.to_owned(), Arc::clone(&keys));
        Some(keys)
    }

    /// The filter ids of a record, at most [`MOST_FILTERS`]: its type, that it is simulated, then its other
    /// tags in the order of their names. A tag's filter is over `name=value`.
    pub fn filters(&self, type_name: &str, tags: &BTreeMap<String, String>) -> Vec<FilterId> {
        let is_simulated = |tag: &(&String, &String)| (tag.0.as_str(), tag.1.as_str()) == SIMULATED;
        let (first, rest): (Vec<_>, Vec<_>) = tags.iter().partition(is_simulated);
        let tags = first.into_iter().chain(rest).map(|(name, value)| tag_filter(&self.index, name, value));
        std::iter::once(filter_id(&self.index, "type", type_name)).chain(tags).take(MOST_FILTERS).collect()
    }
}

/// The filter id of a tag.
pub fn tag_filter(index: &IndexKey, name: &str, value: &str) -> FilterId {
    filter_id(index, "tag", &format!("{name}={value}"))
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
        let some = keys(SealingKey::Topics(
            [("/a".to_owned(), topic_key(&epoch, &topic_id(&IndexKey::new([3; 32]), "/a")))].into(),
        ));
        let (one, other) = (all.topic("/a").expect("covered"), some.topic("/a").expect("covered"));
        assert_eq!((one.id, &one.key), (other.id, &other.key));
        assert!(all.topic("/b").is_some() && some.topic("/b").is_none());
    }

    #[test]
    fn type_and_simulated_come_first_and_no_more_than_fit() {
        let keys = keys(SealingKey::Epoch(EpochKey::new([4; 32])));
        let tag = |name: &str, value: &str| tag_filter(&IndexKey::new([3; 32]), name, value);
        let tags: BTreeMap<String, String> = [("a", "1"), ("b", "2"), ("c", "3"), ("simulated", "true")]
            .map(|(name, value)| (name.to_owned(), value.to_owned()))
            .into();
        let expected =
            [filter_id(&IndexKey::new([3; 32]), "type", "x/Y"), tag("simulated", "true"), tag("a", "1"), tag("b", "2")];
        assert_eq!(keys.filters("x/Y", &tags), expected);
        assert_eq!(keys.filters("x/Y", &BTreeMap::new()), &expected[..1]);
    }
}
