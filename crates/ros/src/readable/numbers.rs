//! Numbers from decoded values, and numbers in readable form.

use super::MOST_ROWS;
use super::Table;
use crate::model::{Timestamp, clean};
use crate::ros::message::Value;

/// The message's bytes, for arrays that were not expanded.
pub(super) struct Body<'a>(pub &'a [u8]);

/// A field as a float.
pub(super) fn float(value: &Value, path: &str) -> Option<f64> {
    as_float(value.get(path)?)
}

/// A plain value as a float.
#[allow(clippy::cast_precision_loss, reason = "for the eye")]
pub(super) fn as_float(value: &Value) -> Option<f64> {
    match value {
        Value::Float(number) => Some(*number),
        Value::Integer(number) => Some(*number as f64),
        Value::Unsigned(number) => Some(*number as f64),
        Value::Bool(flag) => Some(f64::from(u8::from(*flag))),
        _ => None,
    }
}

/// A field as a count.
pub(super) fn count(value: &Value, path: &str) -> Option<usize> {
    match value.get(path)? {
        Value::Unsigned(number) => usize::try_from(*number).ok(),
        Value::Integer(number) => usize::try_from(*number).ok(),
        Value::Bool(flag) => Some(usize::from(*flag)),
        _ => None,
    }
}

/// A field as a clean text.
pub(super) fn text(value: &Value, path: &str) -> String {
    match value.get(path) {
        Some(Value::Text(text)) => clean(text, 120),
        Some(stamp @ Value::Message(_)) if seconds(stamp).is_some() => seconds(stamp).unwrap_or_default(),
        Some(other) => other.flatten(1).into_iter().next().map(|(_, text)| text).unwrap_or_default(),
        None => String::from("-"),
    }
}

/// The header's stamp as a date and as it was sent.
pub(super) fn stamp(value: &Value) -> String {
    let sent = text(value, "header.stamp");
    let dated = sent.split_once('.').and_then(|(seconds, rest)| {
        let date = Timestamp::from_seconds(seconds.parse::<u32>().ok()?.into()).to_string();
        Some(format!("{}.{}Z ({sent})", date.trim_end_matches('Z'), rest.get(..3)?))
    });
    dated.unwrap_or(sent)
}

/// A time or duration of ROS 2, written like those of ROS 1.
fn seconds(value: &Value) -> Option<String> {
    let (Value::Integer(seconds), Value::Unsigned(nanoseconds)) = (value.get("sec")?, value.get("nanosec")?) else {
        return None;
    };
    Some(format!("{seconds}.{nanoseconds:09}"))
}

/// A field as a readable number.
pub(super) fn shown(value: &Value, path: &str) -> String {
    float(value, path).map_or_else(|| String::from("-"), number)
}

/// x, y, z of a field.
pub(super) fn triple(value: &Value, path: &str) -> String {
    let part = |name: &str| shown(value, &format!("{path}.{name}"));
    format!("x {}  y {}  z {}", part("x"), part("y"), part("z"))
}

/// A readable number: four decimals, very small and very large ones with an exponent.
pub(super) fn number(number: f64) -> String {
    let size = number.abs();
    if size != 0.0 && !(1e-4..1e7).contains(&size) {
        return format!("{number:.3e}");
    }
    let text = format!("{number:.4}");
    let short = text.trim_end_matches('0').trim_end_matches('.');
    if short == "-0" { String::from("0") } else { short.to_owned() }
}

/// The floats of a field, expanded or not; at most `most`, evenly spread.
pub(super) fn floats(value: &Value, path: &str, body: &Body, most: usize) -> Vec<(usize, f64)> {
    match value.get(path) {
        Some(Value::Array(items)) => {
            let step = items.len().div_ceil(most.max(1)).max(1);
            items.iter().enumerate().step_by(step).filter_map(|(at, item)| Some((at, as_float(item)?))).collect()
        }
        Some(Value::Large { element, count, bytes, big_endian }) => {
            large((element, *big_endian), *count, body.0.get(bytes.clone()), most)
        }
        _ => Vec::new(),
    }
}

fn large((element, big_endian): (&str, bool), count: usize, bytes: Option<&[u8]>, most: usize) -> Vec<(usize, f64)> {
    let size = match element {
        "float32" => 4,
        "float64" => 8,
        _ => return Vec::new(),
    };
    let data = bytes.unwrap_or_default();
    let step = count.div_ceil(most.max(1)).max(1);
    let read = |chunk: &[u8]| match (chunk.first_chunk::<8>(), chunk.first_chunk::<4>()) {
        (Some(eight), _) if size == 8 && big_endian => Some(f64::from_be_bytes(*eight)),
        (Some(eight), _) if size == 8 => Some(f64::from_le_bytes(*eight)),
        (_, Some(four)) if size == 4 && big_endian => Some(f64::from(f32::from_be_bytes(*four))),
        (_, Some(four)) if size == 4 => Some(f64::from(f32::from_le_bytes(*four))),
        _ => None,
    };
    let numbered = data.chunks_exact(size).enumerate().step_by(step);
    numbered.filter_map(|(at, chunk)| Some((at, read(chunk)?))).collect()
}

/// A covariance as a square table, if it is one.
pub(super) fn square(title: &str, names: &[&str], value: &Value, path: &str) -> Option<Table> {
    let Some(Value::Array(items)) = value.get(path) else { return None };
    let side = names.len();
    if items.len() != side * side {
        return None;
    }
    let cell = |item: &Value| as_float(item).map_or_else(|| String::from("-"), number);
    let rows = items
        .chunks(side)
        .zip(names)
        .map(|(row, name)| std::iter::once((*name).to_owned()).chain(row.iter().map(cell)).collect());
    let head = std::iter::once(String::new()).chain(names.iter().map(|name| (*name).to_owned()));
    Some(Table { title: title.to_owned(), head: head.collect(), rows: rows.collect() })
}

/// A table of an array's items; its title counts those left out.
pub(super) fn listed(
    title: &str,
    head: &[&str],
    value: &Value,
    path: &str,
    row: impl Fn(&Value) -> Vec<String>,
) -> Table {
    let (rows, all) = match value.get(path) {
        Some(Value::Array(items)) => (items.iter().take(MOST_ROWS).map(row).collect(), items.len()),
        Some(Value::Large { count, .. }) => (Vec::new(), *count),
        _ => (Vec::new(), 0),
    };
    let left: Vec<Vec<String>> = rows;
    let title = if left.len() < all { format!("{title} ({} of {all})", left.len()) } else { title.to_owned() };
    Table { title, head: head.iter().map(|name| (*name).to_owned()).collect(), rows: left }
}

/// Roll, pitch and yaw of a quaternion field, in degrees.
pub(super) fn angles(value: &Value, path: &str) -> Option<(f64, f64, f64)> {
    let part = |name: &str| float(value, &format!("{path}.{name}"));
    let (x, y, z, w) = (part("x")?, part("y")?, part("z")?, part("w")?);
    let roll = (2.0 * (w * x + y * z)).atan2(1.0 - 2.0 * (x * x + y * y));
    let pitch = (2.0 * (w * y - z * x)).clamp(-1.0, 1.0).asin();
    let yaw = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
    Some((roll.to_degrees(), pitch.to_degrees(), yaw.to_degrees()))
}

/// The angles of a quaternion field in readable form.
pub(super) fn turned(value: &Value, path: &str) -> String {
    match angles(value, path) {
        Some((roll, pitch, yaw)) => {
            format!("roll {}°  pitch {}°  yaw {}°", number(roll), number(pitch), number(yaw))
        }
        None => String::from("-"),
    }
}
