//! Ledger rows as people see them: untrusted text cleaned.

use super::super::reply::{RecordPage, RecordView};
use crate::model::{RecordKind, clean};
use crate::service::command::UploadQuery;
use crate::store::{RecordQuery, RecordRow};

/// Widest topic or type shown, characters (ROS names are shorter than this).
const WIDEST: usize = 255;

/// One row; `with_owner` for lists of other owners' records.
pub(super) fn record_view(row: &RecordRow, with_owner: bool) -> RecordView {
    RecordView {
        id: row.id.clone(),
        owner: with_owner.then_some(row.owner),
        owner_name: None,
        seq: row.seq,
        topic: clean(&row.topic, WIDEST),
        type_name: clean(&row.type_name, WIDEST),
        kind: row.kind.word().to_owned(),
        state: if row.deleted_at.is_some() { "deleted" } else { row.state.word() }.to_owned(),
        digest: row.digest,
        bytes: row.bytes,
        captured_at: row.captured_at,
        epoch: row.epoch,
        simulated: row.simulated,
        transaction: row.transaction,
        block: row.block,
    }
}

/// A page of rows.
pub fn record_page(page: crate::store::RecordPage, with_owner: bool) -> RecordPage {
    RecordPage { records: page.rows.iter().map(|row| record_view(row, with_owner)).collect(), next: page.next }
}

/// A person's query as the ledger's; captured messages unless another kind is asked for.
pub(super) fn record_query(query: UploadQuery) -> RecordQuery {
    RecordQuery {
        topic: query.topic.map(|topic| topic.to_string()),
        type_name: query.type_name.map(|name| name.to_string()),
        kind: Some(query.kind.unwrap_or(RecordKind::Data)),
        state: query.state,
        since: query.since,
        until: query.until,
        after: query.after,
        limit: query.limit.clamp(1, 1000),
        newest_first: query.newest_first,
        ..RecordQuery::default()
    }
}
