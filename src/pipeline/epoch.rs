//! The keys of one epoch of one owner, with the topic keys derived so far.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use crate::crypto::{EpochKey, IndexKey, SmKeyPair, TopicKey, filter_id, topic_id, topic_key};
use crate::model::{Domain, FilterId, SignerId, Token, TopicId};

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
    /// EK.
    pub key: EpochKey,
    /// Signs records.
    pub signing: Arc<SmKeyPair>,
    /// SM3 of the signing key.
    pub signer: SignerId,
    /// IK.
    pub index: IndexKey,
    /// Topic keys derived so far.
    pub topics: Mutex<HashMap<String, Arc<TopicKeys>>>,
}

impl EpochKeys {
    /// The keys of a topic, derived once.
    pub fn topic(&self, topic: &str) -> Arc<TopicKeys> {
        let mut topics = self.topics.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(keys) = topics.get(topic) {
            return Arc::clone(keys);
        }
        let id = topic_id(&self.index, topic);
        let keys = Arc::new(TopicKeys { id, key: topic_key(&self.key, &id) });
        topics.insert(topic.to_owned(), Arc::clone(&keys));
        keys
    }

    /// The filter ids of a record: its type, and that it is simulated.
    pub fn filters(&self, type_name: &str, simulated: bool) -> Vec<FilterId> {
        let mut filters = vec![filter_id(&self.index, "type", type_name)];
        if simulated {
            filters.push(filter_id(&self.index, "tag", "simulated=true"));
        }
        filters
    }
}
