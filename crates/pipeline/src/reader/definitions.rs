//! The definition that a message names. A topic gets a record of it in each epoch and by each recorder, so there may be
//! thousands; the one that a message names was written by its own recorder, shortly before it.

use tokio::task::block_in_place;

use super::Reader;
use crate::crypto::OpenedRecord;
use crate::crypto::sm3::sm3;
use crate::model::{RecordKind, Timestamp};
use crate::pipeline::PipelineError;
use crate::store::{RecordQuery, RecordRow};

/// The most definition records opened at each attempt.
const MOST_OPENED: usize = 200;
/// The most of which the ledger is asked at each attempt.
const MOST_LISTED: usize = 10_000;

impl Reader<'_> {
    /// The text of the definition that an opened message names, from its owner's definition records, as its publisher
    /// gave it.
    ///
    /// # Errors
    /// Errors of the ledger. `None` if no readable record holds it.
    pub async fn definition_text(
        &self,
        row: &RecordRow,
        opened: &OpenedRecord,
    ) -> Result<Option<String>, PipelineError> {
        for query in attempts(row) {
            let listed = block_in_place(|| self.plant.ledger.list(&query))?.rows;
            for candidate in listed.iter().filter(|candidate| candidate.epoch == row.epoch).take(MOST_OPENED) {
                let Ok(found) = self.open(candidate).await else { continue };
                if is_named(opened, &found.body) {
                    return Ok(Some(String::from_utf8_lossy(&found.body).into_owned()));
                }
            }
        }
        Ok(None)
    }

    /// The definition that an opened own message names; `None` if no record that opens holds it. Waits for ledger and
    /// vault.
    ///
    /// # Errors
    /// Errors of ledger and vault.
    pub fn own_definition(&self, row: &RecordRow, opened: &OpenedRecord) -> Result<Option<String>, PipelineError> {
        for query in attempts(row) {
            for candidate in self.plant.ledger.list(&query)?.rows.iter().take(MOST_OPENED) {
                let Some(found) = self.own_contents(candidate)? else { continue };
                if is_named(opened, &found.body) {
                    return Ok(Some(String::from_utf8_lossy(&found.body).into_owned()));
                }
            }
        }
        Ok(None)
    }
}

/// The topic's definition records: those of the message's recorder from before it, all of that recorder, all there are;
/// the newest first.
fn attempts(row: &RecordRow) -> [RecordQuery; 3] {
    let all = RecordQuery {
        owner: Some(row.owner),
        topic_ids: Some(vec![row.topic_id]),
        kind: Some(RecordKind::Definition),
        limit: MOST_LISTED,
        newest_first: true,
        ..RecordQuery::default()
    };
    let of_recorder = RecordQuery { recorder: Some(row.recorder), ..all.clone() };
    let until = Timestamp(row.captured_at.0.saturating_add(1));
    let before = RecordQuery { until: Some(until), limit: MOST_OPENED, ..of_recorder.clone() };
    [before, of_recorder, all]
}

fn is_named(opened: &OpenedRecord, text: &[u8]) -> bool {
    sm3(&[text]) == opened.head.definition.0
}
