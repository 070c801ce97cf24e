//! Bodies of records that no ROS node sent, for viewing: what was lost, what retention deleted.

use serde_json::{Value, json};

use crate::model::{GapReport, RecordKind, RetentionReport, clean};

/// The widest text from a body, characters.
const WIDEST: usize = 255;

/// The body of a gap or retention record by the names of its fields; `None` for other kinds.
pub(in crate::site) fn view(kind: RecordKind, body: &[u8]) -> Option<Value> {
    match kind {
        RecordKind::Gap => GapReport::parse(body).ok().map(|gap| {
            json!({
                "topic": clean(&gap.topic, WIDEST), "publisher": clean(&gap.publisher, WIDEST), "lost": gap.count,
                "reason": gap.reason.word(), "text": format!("{} messages {}", gap.count, gap.reason.text()),
                "first_number": gap.numbers.map(|(first, _)| first), "last_number": gap.numbers.map(|(_, last)| last),
                "first_at": gap.first_at, "last_at": gap.last_at,
            })
        }),
        RecordKind::Retention => RetentionReport::parse(body).ok().map(|report| {
            json!({
                "topic": clean(&report.topic, WIDEST), "rule": clean(&report.rule, WIDEST), "records": report.count,
                "bytes": report.bytes, "first_seq": report.first_seq, "last_seq": report.last_seq,
                "rolling": report.rolling,
                "text": format!("the ciphertext of {} records was deleted", report.count),
            })
        }),
        _ => None,
    }
}

/// The same as names and values, for screens.
pub(in crate::site) fn fields(view: &Value) -> Vec<(String, String)> {
    let text = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    view.as_object().into_iter().flatten().map(|(name, value)| (name.clone(), text(value))).collect()
}
