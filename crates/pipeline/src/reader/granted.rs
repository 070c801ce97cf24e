//! What a reader's grants say of an owner's topics, beside the keys: which ones, since when, and their names.

use std::collections::{BTreeMap, BTreeSet};

use super::Reader;
use crate::crypto::{GrantedKeys, topic_id};
use crate::model::{Address, Scope, TopicId};
use crate::pipeline::PipelineError;
use crate::pipeline::authority::ReadingRight;

impl Reader<'_> {
    /// The topics of an owner that this reader may read now; `None` = none.
    pub fn scope(&self, owner: Address) -> Option<Scope> {
        self.right(owner, None).ok().map(|right| right.scope().clone())
    }

    /// The first epoch of a topic that this reader was given a key of; `None` = there is none.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn first_epoch(&self, owner: Address, topic: TopicId) -> Result<Option<u64>, PipelineError> {
        let grant = match self.right(owner, Some(topic)) {
            Ok(ReadingRight::Own) => return Ok(Some(0)),
            Ok(ReadingRight::Granted(grant)) => grant,
            Err(_) => return Ok(None),
        };
        let first = |keys: &GrantedKeys| match keys {
            GrantedKeys::All { epochs, .. } => epochs.iter().map(|(epoch, _)| *epoch).min(),
            GrantedKeys::Topics { keys } => {
                keys.iter().filter(|(_, _, id, _)| *id == topic).map(|(epoch, ..)| *epoch).min()
            }
        };
        Ok(self.envelopes(&grant)?.iter().filter_map(|wrapped| first(&wrapped.keys)).min())
    }

    /// The pseudonyms that a topic of an owner has, as far as this reader's keys tell.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn ids_of(&self, owner: Address, topic: &str) -> Result<BTreeSet<TopicId>, PipelineError> {
        if owner == self.reader.address {
            return Ok([topic_id(&self.reader.index(), topic)].into());
        }
        let Ok(ReadingRight::Granted(grant)) = self.right(owner, None) else { return Ok(BTreeSet::new()) };
        let mut ids = BTreeSet::new();
        for wrapped in self.envelopes(&grant)? {
            match &wrapped.keys {
                GrantedKeys::All { index_key, .. } => ids.extend([topic_id(index_key, topic)]),
                GrantedKeys::Topics { keys } => {
                    ids.extend(keys.iter().filter(|(_, name, ..)| name == topic).map(|(_, _, id, _)| *id));
                }
            }
        }
        Ok(ids)
    }

    /// The names of an owner's topics that a grant of some topics tells.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn granted_names(&self, owner: Address) -> Result<BTreeMap<TopicId, String>, PipelineError> {
        let Ok(ReadingRight::Granted(grant)) = self.right(owner, None) else { return Ok(BTreeMap::new()) };
        let mut names = BTreeMap::new();
        for wrapped in self.envelopes(&grant)? {
            if let GrantedKeys::Topics { keys } = &wrapped.keys {
                names.extend(keys.iter().map(|(_, name, id, _)| (*id, name.clone())));
            }
        }
        Ok(names)
    }
}
