//! Pages of a list, as requested by the console.

use super::fill::{BEGIN, OWNER, RARE};
use super::{Figures, timed};
use authros_model::{RecordKind, RecordState, Timestamp};
use authros_service::Failure;
use authros_store::{Ledger, RecordQuery};

/// Rows of a page.
const ROWS: usize = 18;

/// Each query, and microseconds of its rounds.
pub(super) fn time(ledger: &Ledger) -> Result<Figures, Failure> {
    let page = RecordQuery {
        owner: Some(OWNER),
        kind: Some(RecordKind::Data),
        newest_first: true,
        limit: ROWS,
        ..RecordQuery::default()
    };
    let next = RecordQuery { after: ledger.list(&page)?.next, ..page.clone() };
    let topic = RecordQuery { topic: Some("/robot3/sensor0/data".to_owned()), ..page.clone() };
    let held = RecordQuery { state: Some(RecordState::Quarantined), ..page.clone() };
    let none = RecordQuery { state: Some(RecordState::Tampered), ..page.clone() };
    let time = RecordQuery { until: Some(Timestamp(BEGIN + 500_000_000)), ..page.clone() };
    let tag = RecordQuery { filters: vec![RARE.into()], ..page.clone() };
    let asked = [
        ("page", page),
        ("next", next),
        ("topic", topic),
        ("held", held),
        ("none", none),
        ("time", time),
        ("tag", tag),
    ];
    let mut figures = Vec::new();
    for (name, query) in asked {
        figures.push((name, timed(|| ledger.list(&query).map(drop).map_err(Failure::from))?));
    }
    figures.push(("counts", timed(|| ledger.counts(Some(OWNER)).map(drop).map_err(Failure::from))?));
    Ok(figures)
}
