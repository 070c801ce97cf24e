//! A topic's spans held by incidents: exempt from retention, and their bytes not counted in any budget; and the time
//! between them.

use crate::model::Timestamp;
use crate::pipeline::{PipelineError, Plant};
use crate::store::{IncidentRow, IncidentSpan, KeptTopic};

/// A stretch of time: its first moment, and the first one after it.
pub(super) type Span = (Timestamp, Timestamp);

/// Later than any record.
const EVER: Timestamp = Timestamp(i64::MAX.cast_unsigned());

/// A message captured this long ago is in the ledger by now, if it ever gets there, nanoseconds.
const UNSETTLED: u64 = 60_000_000_000;

/// The spans of one topic held by incidents, and their bytes as far as they were counted.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Held {
    /// In order and disjoint.
    pub spans: Vec<Span>,
    bytes: u64,
    /// Everything captured before this is counted.
    counted: Timestamp,
}

impl Held {
    /// For a topic, by its name.
    pub fn of(topic: &str, incidents: &[IncidentRow]) -> Self {
        let about = |span: &&IncidentSpan| span.topics.is_empty() || span.topics.iter().any(|name| name == topic);
        let spans = incidents.iter().map(|incident| &incident.span).filter(about);
        Self { spans: merged(spans.map(|span| (span.since, span.until.unwrap_or(EVER))).collect()), ..Self::default() }
    }

    /// The bytes in the spans that retention has not deleted. What was captured a while ago is summed up only once.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn bytes(&mut self, plant: &Plant, topic: &KeptTopic, now: Timestamp) -> Result<u64, PipelineError> {
        let settled = Timestamp(now.0.saturating_sub(UNSETTLED)).max(self.counted);
        self.bytes += self.between_moments(plant, topic, (self.counted, settled))?;
        self.counted = settled;
        Ok(self.bytes + self.between_moments(plant, topic, (settled, EVER))?)
    }

    fn between_moments(&self, plant: &Plant, topic: &KeptTopic, (from, to): Span) -> Result<u64, PipelineError> {
        let mut bytes = 0;
        for &(since, until) in &self.spans {
            let stretch = (since.max(from), until.min(to));
            if stretch.0 < stretch.1 {
                bytes += plant.ledger.bytes_between(topic.key, stretch)?;
            }
        }
        Ok(bytes)
    }

    /// The time between the spans, within one stretch.
    pub fn between(&self, (since, until): Span) -> Vec<Span> {
        let mut free = Vec::with_capacity(self.spans.len() + 1);
        let mut begin = since;
        for &(from, to) in &self.spans {
            free.push((begin, from.min(until)));
            begin = begin.max(to);
        }
        free.push((begin, until));
        free.retain(|(from, to)| from < to);
        free
    }
}

/// The same time without overlaps, in order.
fn merged(mut spans: Vec<Span>) -> Vec<Span> {
    spans.retain(|(since, until)| since < until);
    spans.sort_unstable();
    let mut merged: Vec<Span> = Vec::with_capacity(spans.len());
    for (since, until) in spans {
        match merged.last_mut().filter(|last| since <= last.1) {
            Some(last) => last.1 = last.1.max(until),
            None => merged.push((since, until)),
        }
    }
    merged
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn at((since, until): (u64, u64)) -> Span {
        (Timestamp(since), Timestamp(until))
    }

    fn covers(spans: &[Span], moment: u64) -> bool {
        spans.iter().any(|(since, until)| (since.0..until.0).contains(&moment))
    }

    proptest! {
        #[test]
        fn every_moment_of_a_stretch_is_either_held_or_free(
            spans in proptest::collection::vec((0_u64..60, 0_u64..60), 0..8),
            stretch in (0_u64..60, 0_u64..60),
        ) {
            let spans: Vec<Span> = spans.into_iter().map(at).collect();
            let held = Held { spans: merged(spans.clone()), ..Held::default() };
            let free = held.between(at(stretch));
            for moment in 0..70 {
                prop_assert_eq!(covers(&held.spans, moment), covers(&spans, moment));
                let asked = (stretch.0..stretch.1).contains(&moment);
                prop_assert_eq!(covers(&free, moment), asked && !covers(&spans, moment));
            }
            prop_assert!(held.spans.windows(2).all(|two| two[0].1 < two[1].0));
        }
    }

    #[test]
    fn an_incident_is_about_the_topics_it_names_or_about_all() {
        let row = |name: &str, topics: &[&str], until| IncidentRow {
            name: name.parse().expect("a name"),
            span: IncidentSpan {
                since: Timestamp(5),
                until,
                topics: topics.iter().map(|&topic| topic.to_owned()).collect(),
            },
            opened_at: Timestamp(5),
            closed_at: None,
            notes: Vec::new(),
        };
        let rows = [row("a", &["/odom"], Some(Timestamp(9))), row("b", &[], Some(Timestamp(7)))];
        assert_eq!(Held::of("/odom", &rows).spans, [at((5, 9))]);
        assert_eq!(Held::of("/scan", &rows).spans, [at((5, 7))]);
        assert_eq!(Held::of("/scan", &[row("c", &["/scan"], None)]).spans, [(Timestamp(5), EVER)]);
    }
}
