//! Bodies of records that no ROS node sent, for viewing: what was lost, what retention deleted, what a recording holds
//! beside its messages.

use serde_json::{Value, json};

use crate::model::{GapReport, RecordKind, RetentionReport, clean};
use crate::ros::recording::{Beside, BesideContent};

/// The widest text from a body, characters.
const WIDEST: usize = 255;

/// The longest value of metadata that is shown, characters.
const LONGEST_VALUE: usize = 64 * 1024;

/// The body of a gap, retention or attachment record by the names of its fields; `None` for other kinds.
pub(in crate::site) fn view(kind: RecordKind, type_name: &str, body: &[u8]) -> Option<Value> {
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
        RecordKind::Attachment => beside(type_name, body),
        _ => None,
    }
}

fn beside(type_name: &str, body: &[u8]) -> Option<Value> {
    Some(match Beside::of_type(type_name)?.parse(body)? {
        BesideContent::File(file) => json!({
            "name": clean(&file.name, WIDEST), "media_type": clean(&file.media_type, WIDEST), "bytes": file.data.len(),
            "logged_at": file.logged_at, "created_at": file.created_at, "crc32": file.checksum,
        }),
        BesideContent::Metadata { name, entries } => {
            let entries: Vec<_> =
                entries.iter().map(|(key, value)| json!([clean(key, WIDEST), clean(value, LONGEST_VALUE)])).collect();
            json!({ "name": clean(&name, WIDEST), "entries": entries })
        }
    })
}

/// The file that an attachment is, or the bytes of metadata; `None` if it is neither.
pub(in crate::site) fn content<'a>(type_name: &str, body: &'a [u8]) -> Option<&'a [u8]> {
    Some(match Beside::of_type(type_name)?.parse(body)? {
        BesideContent::File(file) => file.data,
        BesideContent::Metadata { .. } => body,
    })
}

/// The same as names and values, for screens.
pub(in crate::site) fn fields(view: &Value) -> Vec<(String, String)> {
    let text = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    view.as_object().into_iter().flatten().map(|(name, value)| (name.clone(), text(value))).collect()
}
