//! Which messages of a recording become records, and under which topic.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::import::left_out_list;
use crate::model::{RecordKind, TopicPattern};
use crate::pipeline::importer::{fault, kind_of};
use crate::pipeline::recorded_names::RecordedNames;
use crate::ros::recording::{Findings, RecordedMessage};
use crate::service::reply::LeftOut;

/// Chooses the messages of one recording.
#[derive(Debug)]
pub(super) struct Choosing {
    patterns: Vec<TopicPattern>,
    names: RecordedNames,
    left_out: BTreeMap<(Arc<str>, &'static str), u64>,
}

impl Choosing {
    /// Topics that match any of these patterns; of none, all.
    pub fn new(patterns: &[TopicPattern]) -> Self {
        Self { patterns: patterns.to_vec(), names: RecordedNames::default(), left_out: BTreeMap::new() }
    }

    /// The topic under which a message is sealed; `None` if it is not wanted, or was counted as left out.
    pub fn topic(&mut self, message: &RecordedMessage) -> Option<Arc<str>> {
        let recorded = &message.channel.topic;
        let is_message = kind_of(message.channel.encoding) == RecordKind::Data;
        let named = if is_message { self.names.resolve(recorded) } else { Ok(Arc::clone(recorded)) };
        // Patterns choose topics; what is beside the messages has none, and belongs to the recording as a whole.
        let matches = |name: &Arc<str>| self.patterns.iter().any(|pattern| pattern.matches(name));
        let is_chosen = || is_message && [Some(recorded), named.as_ref().ok()].into_iter().flatten().any(matches);
        if !self.patterns.is_empty() && !is_chosen() {
            return None;
        }
        match (named, fault(message)) {
            (Ok(topic), None) => Some(topic),
            (Err(why), _) | (_, Some(why)) => {
                *self.left_out.entry((Arc::clone(recorded), why)).or_default() += 1;
                None
            }
        }
    }

    /// What was left out, here and by the reader.
    pub fn left_out(&self, findings: &Findings) -> Vec<LeftOut> {
        let mut list = left_out_list(self.left_out.clone());
        list.extend(findings.unusable.iter().map(|row| LeftOut {
            topic: row.topic.clone(),
            why: row.why.clone(),
            messages: row.messages,
        }));
        list
    }
}
