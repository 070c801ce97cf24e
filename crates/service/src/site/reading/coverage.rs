//! When there are own records of a topic.

use super::Reading;
use std::sync::Arc;

use crate::model::{ProfileName, Timestamp, TopicName};
use crate::service::failure::input;
use crate::service::reply::{CoveragePart, CoverageView, Failure};
use crate::site::blocking;
use crate::store::CoverageQuery;

/// The most parts of one answer.
const MOST_PARTS: usize = 1_000;

impl Reading {
    /// A span of time of one of the profile's topics, in parts; according to the ledger, and without a passphrase.
    ///
    /// # Errors
    /// A span that ends before it begins, or too many parts.
    pub(in crate::site) async fn coverage(
        self: &Arc<Self>,
        profile: &ProfileName,
        topic: TopicName,
        span: (Option<Timestamp>, Option<Timestamp>),
        parts: usize,
    ) -> Result<CoverageView, Failure> {
        let owner = self.owners.address_of(profile)?;
        let (since, until) = (span.0, span.1.unwrap_or_else(Timestamp::now));
        if since.is_some_and(|since| since >= until) {
            return Err(input("the span ends before it begins; --since must be earlier than --until"));
        }
        if !(1..=MOST_PARTS).contains(&parts) {
            return Err(input(format!("a span can have 1 to {MOST_PARTS} parts, not {parts}")));
        }
        let query = CoverageQuery { owner, topic: topic.to_string(), since, until, parts };
        let found = blocking(self, move |reading| Ok(reading.plant.ledger.coverage(&query)?)).await?;
        let parts = found.parts.into_iter().map(|part| CoveragePart {
            at: part.at,
            data: part.data,
            quarantined: part.quarantined,
            tampered: part.tampered,
            lost: part.lost,
        });
        let parts = parts.collect();
        Ok(CoverageView { topic, since: found.since, until, first: found.first, last: found.last, parts })
    }
}
